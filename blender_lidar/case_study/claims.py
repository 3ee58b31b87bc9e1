"""What the paper claims of its case study, and what our numbers say to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from .distance import of_band
from .published import PUBLISHED, SENSORS

LIKELY, UNLIKELY = 0.9, 0.1  # probabilities from and up to which an order is taken as shown or as refuted
REPRODUCED, IN_PART, REFUTED = "reproduced", "reproduced in part", "not reproduced"
UNDECIDED, TIED = "undecided", "not shown: ties"
NEAR = "0-20 m"
FAR = "120-140 m"


class Claim(NamedTuple):
    """One claim of the paper's.

    Attributes
    ----------
    text : str
        What the paper says, and where.
    ours : str
        What we find.
    verdict : str
    """

    text: str
    ours: str
    verdict: str


def claims(result: Mapping) -> list[Claim]:
    """The paper's claims in its own order, each with our finding and a verdict."""
    return [
        _heights(result),
        _tilts(result),
        _values(result),
        _improvement(result),
        _largest(result),
        _everywhere(result),
        _distant(result),
        _far_band(result),
        _near_loss(result),
        _spacing(result),
    ]


def sign(interval: Sequence[float] | None) -> int | None:
    """1 or -1 where an interval lies above or below 0, 0 where it holds 0; None without an interval."""
    if interval is None:
        return None
    return int(interval[0] > 0.0) - int(interval[1] < 0.0)


def with_interval(found: Mapping, digits: int = 3, scale: float = 1.0) -> str:
    """A mean and its interval as text."""
    mean = f"{scale * found['mean']:+.{digits}f}"
    if found["interval_90"] is None:
        return f"{mean} (too few blocks for an interval)"
    low, high = (scale * end for end in found["interval_90"])
    return f"{mean} ({low:+.{digits}f} to {high:+.{digits}f})"


def fig9_row(result: Mapping, sensor: str, band: str, measure: str) -> Mapping | None:
    """A row of Fig. 9; None where the band holds no vehicle."""
    return of_band([row for row in result["fig9"] if row["sensor"] == sensor], band, measure)


def _heights(result):
    text = "Heights rise with the number of beams: 4.1, 4.2, 4.4 m (Table II)"
    of = result["sensors"]
    ours = "optima at " + ", ".join(f"{of[sensor]['height_m']:.1f}" for sensor in SENSORS) + " m"
    bound = [sensor for sensor in SENSORS if of[sensor]["height_on_bound"]]
    if bound:
        ours += f"; on the upper bound: {', '.join(bound)}"
    if result["order"] is None:
        return Claim(text, ours, UNDECIDED)
    order = result["order"]["height"]
    ours += f"; rising in {_shares(order)}"
    return Claim(text, ours, _by_probability(order["strict"], order["with_ties"]))


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
    verdict = _by_probability(order["strict"], order["with_ties"])
    sure = [pair for pair in order["pairs"] if pair["above"] >= LIKELY]
    return Claim(text, ours, IN_PART if sure and verdict != REPRODUCED else verdict)


def _values(result):
    text = "Table II's mountings are the optima"
    inside, parts = [], []
    for sensor, of in result["sensors"].items():
        if of["tilt_interval_90"] is None:
            return Claim(text, "too few blocks for intervals", UNDECIDED)
        published = PUBLISHED[sensor]
        held = {"height": published.height_m, "tilt": published.tilt_deg}
        held = {axis: low <= value <= high for axis, value in held.items() for low, high in [of[f"{axis}_interval_90"]]}
        inside.append(all(held.values()))
        said = " and ".join(f"{axis} {'inside' if within else 'outside'}" for axis, within in held.items())
        parts.append(f"{sensor}: {said} our intervals{_share_of_gain(of)}")
    verdict = REPRODUCED if all(inside) else IN_PART if any(inside) else REFUTED
    return Claim(text, "; ".join(parts), verdict)


def _share_of_gain(of):
    held = {name: of["judged"][name]["holdout"] for name in ("grid", "paper")}
    if held["grid"] is None or held["grid"]["gain_over_baseline"] <= 0:
        return ""
    share = held["paper"]["gain_over_baseline"] / held["grid"]["gain_over_baseline"]
    return f", worth {100 * share:.0f} % of our held-out gain"


def _improvement(result):
    text = "Optimising improves every sensor: recall +8 to +25 points (Table III)"
    rows = {sensor: fig9_row(result, sensor, "all", "detectable") for sensor in SENSORS}
    ours = "detectable share, points: " + ", ".join(
        f"{sensor} {with_interval(row['change'], 0, 100.0)}" for sensor, row in rows.items()
    )
    return Claim(text, ours, _by_signs([sign(row["change"]["interval_90"]) for row in rows.values()]))


def _largest(result):
    text = "RS-32 gains most: +25, RS-16 +17, RS-80 +10 points at confidence 0.1 (Table III)"
    change = {sensor: fig9_row(result, sensor, "all", "detectable")["change"] for sensor in SENSORS}
    largest = max(change, key=lambda sensor: change[sensor]["mean"])
    ours = f"the largest change of the detectable share is that of {largest}"
    ends = {sensor: of["interval_90"] for sensor, of in change.items()}
    if None in ends.values():
        return Claim(text, f"{ours}; too few blocks for intervals", UNDECIDED)
    if any(ends[sensor][1] >= ends[largest][0] for sensor in SENSORS if sensor != largest):
        return Claim(text, f"{ours}, but the intervals overlap", UNDECIDED)
    return Claim(text, ours, REPRODUCED if largest == "RS-32" else REFUTED)


def _everywhere(result):
    text = "RS-16 improves at all distances (Fig. 9)"
    rows = [row for row in result["fig9"] if _is_band(row, "RS-16", "detectable")]
    ours = _listed(rows)
    signs = [sign(row["change"]["interval_90"]) for row in rows]
    return Claim(text, ours, _by_signs(signs))


def _distant(result):
    text = "RS-32 and RS-80 improve mainly far away (Fig. 9)"
    parts, holds = [], []
    for sensor in ("RS-32", "RS-80"):
        rows = [row for row in result["fig9"] if _is_band(row, sensor, "detectable")]
        half = len(rows) // 2
        near, far = (_mean_change(some) for some in (rows[:half], rows[half:]))
        parts.append(f"{sensor} nearer half of the bands {100 * near:+.0f} points, farther half {100 * far:+.0f}")
        holds.append(far > near if all(row["change"]["interval_90"] for row in rows) else None)
    if None in holds:
        return Claim(text, "; ".join(parts), UNDECIDED)
    return Claim(text, "; ".join(parts), REPRODUCED if all(holds) else IN_PART if any(holds) else REFUTED)


def _far_band(result):
    text = "RS-80: close to +40 points at 120 to 140 m (Fig. 9)"
    row = fig9_row(result, "RS-80", FAR, "detectable")
    if row is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    interval = row["change"]["interval_90"]
    verdict = UNDECIDED if interval is None else REPRODUCED if interval[0] <= 0.4 <= interval[1] else REFUTED
    return Claim(text, f"{with_interval(row['change'], 0, 100.0)} points detectable", verdict)


def _near_loss(result):
    text = "RS-80: the baseline is better at 0 to 20 m (Fig. 9)"
    rows = [fig9_row(result, "RS-80", NEAR, measure) for measure in ("detectable", "entropy_bits")]
    if rows[0] is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    ours = (
        f"detectable share {with_interval(rows[0]['change'], 0, 100.0)} points, "
        f"entropy {with_interval(rows[1]['change'])} bits, {rows[0]['vehicles']} vehicles"
    )
    signs = [sign(row["change"]["interval_90"]) for row in rows]
    if None in signs:
        return Claim(text, ours, UNDECIDED)
    return Claim(text, ours, REPRODUCED if min(signs) < 0 else REFUTED if max(signs) > 0 else UNDECIDED)


def _spacing(result):
    text = "That loss comes from RS-80's uneven beams (section V.B)"
    row = of_band(result["spacing"], NEAR, "entropy_bits")
    if row is None:
        return Claim(text, "no vehicle there", UNDECIDED)
    ours = (
        f"entropy at 0 to 20 m, bits: change {with_interval(row['change'])} = "
        f"height {with_interval(row['height_evenly_spaced'])} + tilt {with_interval(row['tilt_evenly_spaced'])} "
        f"with evenly spaced beams, + uneven spacing {with_interval(row['spacing'])}"
    )
    signs = {effect: sign(row[effect]["interval_90"]) for effect in ("spacing", "change_evenly_spaced")}
    if None in signs.values() or signs["spacing"] == 0:
        return Claim(text, ours, UNDECIDED)
    if signs["spacing"] > 0:
        return Claim(text, ours, REFUTED)
    lost = sign(row["change"]["interval_90"]) == -1
    return Claim(text, ours, REPRODUCED if lost and signs["change_evenly_spaced"] >= 0 else IN_PART)


def _is_band(row, sensor, measure):
    return row["sensor"] == sensor and row["measure"] == measure and row["band"] != "all"


def _listed(rows):
    return ", ".join(f"{row['band']} {with_interval(row['change'], 0, 100.0)}" for row in rows) + " points detectable"


def _mean_change(rows):
    total = sum(row["vehicles"] for row in rows)
    return sum(row["change"]["mean"] * row["vehicles"] for row in rows) / total if total else 0.0


def _shares(order):
    strict, with_ties = (100.0 * order[key] for key in ("strict", "with_ties"))
    return f"{strict:.0f} % of resamples, {with_ties:.0f} % if ties count"


def _by_probability(strict, with_ties):
    if strict >= LIKELY:
        return REPRODUCED
    if with_ties <= UNLIKELY:
        return REFUTED
    return TIED if with_ties - strict >= LIKELY else UNDECIDED


def _by_signs(signs):
    """All above 0, some, none; undecided where intervals are missing or all hold 0."""
    if None in signs:
        return UNDECIDED
    if min(signs) > 0:
        return REPRODUCED
    if min(signs) == 0:
        return IN_PART if max(signs) > 0 else UNDECIDED
    return REFUTED
