"""What the paper claims by distance, in its Fig. 9 and its section V.B, and what our numbers say to it."""

from __future__ import annotations

from collections.abc import Mapping

from .distance import of_band
from .verdicts import IN_PART, NO_LOSS, REFUTED, REPRODUCED, UNDECIDED, Claim, by_signs, sign, with_interval

NEAR = "0-20 m"
FAR = "120-140 m"


def distance_claims(result: Mapping) -> list[Claim]:
    """The paper's claims by distance, each with our finding and a verdict."""
    return [_everywhere(result), _distant(result), _far_band(result), _near_loss(result), _spacing(result)]


def fig9_row(result: Mapping, sensor: str, band: str, measure: str) -> Mapping | None:
    """A row of Fig. 9; None where the band holds no vehicle."""
    return of_band([row for row in result["fig9"] if row["sensor"] == sensor], band, measure)


def _everywhere(result):
    text = "RS-16 improves at all distances (Fig. 9)"
    rows = [row for row in result["fig9"] if _is_band(row, "RS-16", "detectable")]
    ours = _listed(rows)
    signs = [sign(row["change"]["interval_90"]) for row in rows]
    return Claim(text, ours, by_signs(signs))


def _distant(result):
    text = "RS-32 and RS-80 improve mainly far away (Fig. 9)"
    rows = {
        row["sensor"]: row
        for row in result["fig9_halves"]
        if row["measure"] == "detectable" and row["sensor"] in ("RS-32", "RS-80")
    }
    if any(row["near"] is None for row in rows.values()):
        return Claim(text, "no two bands of distance with vehicles", UNDECIDED)
    ours = "points detectable, " + "; ".join(
        f"{sensor} nearer half of the bands {100 * row['near']:+.0f}, farther half {100 * row['far']:+.0f}, difference "
        f"{with_interval(row['far_less_near'], 0, 100.0)}"
        for sensor, row in rows.items()
    )
    return Claim(text, ours, by_signs([sign(row["far_less_near"]["interval_90"]) for row in rows.values()]))


def _far_band(result):
    text = "RS-80: close to +40 points at 120 to 140 m (Fig. 9)"
    row = fig9_row(result, "RS-80", FAR, "detectable")
    if row is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    interval = row["change"]["interval_90"]
    verdict = UNDECIDED if interval is None else REPRODUCED if interval[0] <= 0.4 <= interval[1] else REFUTED
    return Claim(text, f"{with_interval(row['change'], 0, 100.0)} points detectable", verdict)


def _near_loss(result):
    """The detectable share decides, as it is nearest to the paper's recall; the entropy is told."""
    text = "RS-80: the baseline is better at 0 to 20 m (Fig. 9)"
    share, bits = (fig9_row(result, "RS-80", NEAR, measure) for measure in ("detectable", "entropy_bits"))
    if share is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    ours = (
        f"detectable share {with_interval(share['change'], 0, 100.0)} points on {share['vehicles']} vehicles "
        f"(entropy {with_interval(bits['change'])} bits)"
    )
    verdict = {None: UNDECIDED, 0: UNDECIDED, -1: REPRODUCED, 1: REFUTED}[sign(share["change"]["interval_90"])]
    return Claim(text, ours, verdict)


def _spacing(result):
    """A loss has to be shown, again on the detectable share, before there is a cause of it to ask for."""
    text = "That loss comes from RS-80's uneven beams (section V.B)"
    share, bits = (of_band(result["spacing"], NEAR, measure) for measure in ("detectable", "entropy_bits"))
    if share is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    ours = (
        f"uneven less even beams at 0 to 20 m: detectable share "
        f"{with_interval(share['spacing_at_baseline'], 0, 100.0)} points at the baseline, "
        f"{with_interval(share['spacing_at_optimum'], 0, 100.0)} at the optimum, change of all "
        f"{with_interval(share['change'], 0, 100.0)} (entropy {with_interval(bits['spacing_at_baseline'])}, "
        f"{with_interval(bits['spacing_at_optimum'])} and {with_interval(bits['change'])} bits)"
    )
    return Claim(text, ours, _cause_of_loss({effect: sign(of["interval_90"]) for effect, of in _means(share)}))


def _cause_of_loss(signs):
    """The uneven beams are the cause where they are worse at the optimum, became so, and even ones do not lose."""
    change, at_optimum = signs["change"], signs["spacing_at_optimum"]
    if change in (None, 0):
        return UNDECIDED
    if change > 0:
        return NO_LOSS
    if at_optimum in (None, 0):
        return UNDECIDED
    if at_optimum > 0:
        return REFUTED
    return REPRODUCED if signs["spacing"] < 0 and signs["change_evenly_spaced"] >= 0 else IN_PART


def _means(row):
    return ((name, found) for name, found in row.items() if isinstance(found, Mapping))


def _is_band(row, sensor, measure):
    return row["sensor"] == sensor and row["measure"] == measure and row["band"] != "all"


def _listed(rows):
    return ", ".join(f"{row['band']} {with_interval(row['change'], 0, 100.0)}" for row in rows) + " points detectable"
