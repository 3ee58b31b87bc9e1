"""What the paper claims of its case study, and what our numbers say to it."""

from __future__ import annotations

from collections.abc import Mapping

from .distance_claims import distance_claims, fig9_row
from .published import PUBLISHED, SENSORS
from .verdicts import (
    IN_PART,
    LIKELY,
    REFUTED,
    REPRODUCED,
    UNDECIDED,
    Claim,
    by_probability,
    by_signs,
    sign,
    with_interval,
)


def claims(result: Mapping) -> list[Claim]:
    """The paper's claims in its own order, each with our finding and a verdict."""
    return [
        _heights(result),
        _tilts(result),
        _values(result),
        _improvement(result),
        _largest(result),
        *distance_claims(result),
    ]


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
    return Claim(text, ours, by_probability(order["strict"], order["with_ties"]))


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
    return Claim(text, ours, by_signs([sign(row["change"]["interval_90"]) for row in rows.values()]))


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


def _shares(order):
    strict, with_ties = (100.0 * order[key] for key in ("strict", "with_ties"))
    return f"{strict:.0f} % of resamples, {with_ties:.0f} % if ties count"
