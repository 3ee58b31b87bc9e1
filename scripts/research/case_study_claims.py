"""What the paper claims of its case study, what our numbers say to it, and the verdict that intervals come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from case_study import PUBLISHED, SENSORS
from case_study_distance import of_band

LIKELY, UNLIKELY = 0.9, 0.1  # probabilities from and up to which an order is taken as shown or as refuted
REPRODUCED, IN_PART, REFUTED = "reproduced", "reproduced in part", "not reproduced"
UNDECIDED, TIED, NO_LOSS = "undecided", "not shown: ties", "no loss here"
NEAR, FAR = "0-20 m", "120-140 m"


class Claim(NamedTuple):
    """What the paper says, and where; what we find; the verdict."""

    text: str
    ours: str
    verdict: str


def claims(result: Mapping) -> list[Claim]:
    """The paper's claims in its own order, each with our finding and a verdict."""
    judges = (
        *(_heights, _tilts, _values, _improvement, _largest),
        *(_everywhere, _distant, _far_band, _near_loss, _spacing),
    )
    return [judge(result) for judge in judges]


# --- intervals and probabilities --------------------------------------------------------------------------------------


def sign(interval: Sequence[float] | None) -> int | None:
    """1 or -1 where an interval lies above or below 0, 0 where it holds 0; None without an interval."""
    return None if interval is None else int(interval[0] > 0.0) - int(interval[1] < 0.0)


def by_probability(strict: float, with_ties: float) -> str:
    """Of an order, from how often it holds strictly and with ties."""
    if strict >= LIKELY:
        return REPRODUCED
    if with_ties <= UNLIKELY:
        return REFUTED
    return TIED if with_ties - strict >= LIKELY else UNDECIDED


def by_signs(signs: Sequence[int | None]) -> str:
    """All above 0, some, none; undecided where intervals are missing or all hold 0."""
    if None in signs:
        return UNDECIDED
    if min(signs) > 0:
        return REPRODUCED
    if min(signs) == 0:
        return IN_PART if max(signs) > 0 else UNDECIDED
    return REFUTED


def with_interval(found: Mapping, digits: int = 3, scale: float = 1.0) -> str:
    """A mean and its interval as text."""
    mean = f"{scale * found['mean']:+.{digits}f}"
    if found["interval_90"] is None:
        return f"{mean} (too few blocks for an interval)"
    low, high = (scale * end for end in found["interval_90"])
    return f"{mean} ({low:+.{digits}f} to {high:+.{digits}f})"


def points(found: Mapping) -> str:
    """A change of the detectable share and its interval in points."""
    return with_interval(found, 0, 100.0)


# --- the optima: Tables II and III ------------------------------------------------------------------------------------


def _heights(result):
    text = "Heights rise with the number of beams: 4.1, 4.2, 4.4 m (Table II)"
    of = result["sensors"]
    ours = "optima at " + ", ".join(f"{of[sensor]['height_m']:.1f}" for sensor in SENSORS) + " m"
    if bound := [sensor for sensor in SENSORS if of[sensor]["height_on_bound"]]:
        ours += f"; on the upper bound: {', '.join(bound)}"
    if result["order"] is None:
        return Claim(text, ours, UNDECIDED)
    order = result["order"]["height"]
    return Claim(text, f"{ours}; rising in {_shares(order)}", by_probability(order["strict"], order["with_ties"]))


def _tilts(result):
    text = "Tilts fall with the number of beams: 19, 13, 9 degrees (Table II)"
    ours = "optima at " + ", ".join(f"{result['sensors'][sensor]['tilt_deg']:.0f}" for sensor in SENSORS) + " degrees"
    if result["order"] is None:
        return Claim(text, ours, UNDECIDED)
    order = result["order"]["tilt"]
    ours += f"; falling in {_shares(order)}"
    for pair in order["pairs"]:
        above, equal = (100.0 * pair[key] for key in ("above", "equal"))
        ours += f"; {pair['first']} above {pair['second']} in {above:.0f} %, equal {equal:.0f} %"
    verdict = by_probability(order["strict"], order["with_ties"])
    sure = any(pair["above"] >= LIKELY for pair in order["pairs"])
    return Claim(text, ours, IN_PART if sure and verdict != REPRODUCED else verdict)


def _shares(order):
    strict, with_ties = (100.0 * order[key] for key in ("strict", "with_ties"))
    return f"{strict:.0f} % of resamples, {with_ties:.0f} % if ties count"


def _values(result):
    text = "Table II's mountings are the optima"
    inside, parts = [], []
    for sensor, of in result["sensors"].items():
        if of["tilt_interval_90"] is None:
            return Claim(text, "too few blocks for intervals", UNDECIDED)
        held = {}
        for axis, value in (("height", PUBLISHED[sensor].height_m), ("tilt", PUBLISHED[sensor].tilt_deg)):
            low, high = of[f"{axis}_interval_90"]
            held[axis] = low <= value <= high
        inside.append(all(held.values()))
        said = " and ".join(f"{axis} {'inside' if within else 'outside'}" for axis, within in held.items())
        gains = {name: of["judged"][name]["holdout"]["gain_over_baseline"] for name in ("grid", "paper")}
        worth = (
            f", worth {100 * gains['paper'] / gains['grid']:.0f} % of our held-out gain" if gains["grid"] > 0 else ""
        )
        parts.append(f"{sensor}: {said} our intervals{worth}")
    verdict = REPRODUCED if all(inside) else IN_PART if any(inside) else REFUTED
    return Claim(text, "; ".join(parts), verdict)


def _improvement(result):
    text = "Optimising improves every sensor: recall +8 to +25 points (Table III)"
    rows = {sensor: _fig9_row(result, sensor, "all", "detectable") for sensor in SENSORS}
    ours = ", ".join(f"{sensor} {points(row['change'])}" for sensor, row in rows.items())
    return Claim(text, f"detectable share, points: {ours}", _by_changes(rows.values()))


def _largest(result):
    text = "RS-32 gains most: +25, RS-16 +17, RS-80 +10 points at confidence 0.1 (Table III)"
    change = {sensor: _fig9_row(result, sensor, "all", "detectable")["change"] for sensor in SENSORS}
    largest = max(change, key=lambda sensor: change[sensor]["mean"])
    ours = f"the largest change of the detectable share is that of {largest}"
    ends = {sensor: of["interval_90"] for sensor, of in change.items()}
    if None in ends.values():
        return Claim(text, f"{ours}; too few blocks for intervals", UNDECIDED)
    if any(ends[sensor][1] >= ends[largest][0] for sensor in SENSORS if sensor != largest):
        return Claim(text, f"{ours}, but the intervals overlap", UNDECIDED)
    return Claim(text, ours, REPRODUCED if largest == "RS-32" else REFUTED)


# --- by distance: Fig. 9 and section V.B ------------------------------------------------------------------------------


def _fig9_row(result, sensor, band, measure):
    """A row of Fig. 9; None where the band holds no vehicle."""
    return of_band([row for row in result["fig9"] if row["sensor"] == sensor], band, measure)


def _by_changes(rows):
    return by_signs([sign(row["change"]["interval_90"]) for row in rows])


def _everywhere(result):
    text = "RS-16 improves at all distances (Fig. 9)"
    rows = [row for row in result["fig9"] if (row["sensor"], row["measure"]) == ("RS-16", "detectable")]
    rows = [row for row in rows if row["band"] != "all"]
    ours = ", ".join(f"{row['band']} {points(row['change'])}" for row in rows)
    return Claim(text, f"{ours} points detectable", _by_changes(rows))


def _distant(result):
    text = "RS-32 and RS-80 improve mainly far away (Fig. 9)"
    rows = [row for row in result["fig9_halves"] if row["measure"] == "detectable"]
    rows = {row["sensor"]: row for row in rows if row["sensor"] in ("RS-32", "RS-80")}
    if any(row["near"] is None for row in rows.values()):
        return Claim(text, "no two bands of distance with vehicles", UNDECIDED)
    ours = "points detectable, " + "; ".join(
        f"{sensor} nearer half of the bands {100 * row['near']:+.0f}, farther half {100 * row['far']:+.0f}, difference "
        f"{points(row['far_less_near'])}"
        for sensor, row in rows.items()
    )
    return Claim(text, ours, by_signs([sign(row["far_less_near"]["interval_90"]) for row in rows.values()]))


def _far_band(result):
    text = "RS-80: close to +40 points at 120 to 140 m (Fig. 9)"
    row = _fig9_row(result, "RS-80", FAR, "detectable")
    if row is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    interval = row["change"]["interval_90"]
    verdict = UNDECIDED if interval is None else REPRODUCED if interval[0] <= 0.4 <= interval[1] else REFUTED
    return Claim(text, f"{points(row['change'])} points detectable", verdict)


def _near_loss(result):
    """The detectable share decides, as it is nearest to the paper's recall; the entropy is given."""
    text = "RS-80: the baseline is better at 0 to 20 m (Fig. 9)"
    share, bits = (_fig9_row(result, "RS-80", NEAR, measure) for measure in ("detectable", "entropy_bits"))
    if share is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    ours = (
        f"detectable share {points(share['change'])} points on {share['vehicles']} vehicles "
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
    lines = [with_interval(bits[name]) for name in ("spacing_at_baseline", "spacing_at_optimum", "change")]
    ours = (
        f"uneven less even beams at 0 to 20 m: detectable share {points(share['spacing_at_baseline'])} points at the "
        f"baseline, {points(share['spacing_at_optimum'])} at the optimum, change of all {points(share['change'])} "
        f"(entropy {lines[0]}, {lines[1]} and {lines[2]} bits)"
    )
    return Claim(text, ours, _cause_of_loss(share))


def _cause_of_loss(share):
    """The uneven beams are the cause where they are worse at the optimum, became so, and even ones do not lose."""
    change, at_optimum, spacing, even = (
        sign(share[name]["interval_90"]) for name in ("change", "spacing_at_optimum", "spacing", "change_evenly_spaced")
    )
    if change in (None, 0):
        return UNDECIDED
    if change > 0:
        return NO_LOSS
    if at_optimum in (None, 0):
        return UNDECIDED
    if at_optimum > 0:
        return REFUTED
    return REPRODUCED if spacing < 0 and even >= 0 else IN_PART
