"""What a run comes to, in one sentence."""

from __future__ import annotations

import re
from collections.abc import Mapping

from ..metrics.catalogue import METRICS, metric_named
from ..study.tolerance_text import kept_text
from .elements import minus
from .summary import better_than_baseline, was_searched

_LEVEL_DEG = 0.05  # a smaller angle cannot be set on site
_NO_BREAK = "\N{NO-BREAK SPACE}"
_UNITS = "|".join(sorted({re.escape(metric.unit) for metric in METRICS.values() if metric.unit}, reverse=True))
_SPACE_BEFORE_UNIT = re.compile(rf"(?<=\d) (?=%|(?:m|{_UNITS})(?!\w))")


def answer(result: Mapping) -> str:
    """The mounting and what it is worth against the baseline, with the interval where there is one."""
    forgives = "" if result.get("tolerance") is None else kept_text(result)
    told = f"{_what_to_do(result)}: {_worth(result)}." + (f" {forgives[0].upper()}{forgives[1:]}." if forgives else "")
    return _SPACE_BEFORE_UNIT.sub(_NO_BREAK, told)


def key_figures(result: Mapping) -> list[tuple[str, str]]:
    """The few figures that matter, each with what it is."""
    mount, (found, base, on), metric = result["deployment"], _judges(result), metric_named(result["metric"])
    figures = [
        ("height above the road", f"{mount['height_m']:.2f} m"),
        ("tilt across the road", minus(f"{mount['tilt_x_deg']:.1f}°")),
        (f"detectable on {on}", f"{100 * base['detectable_share']:.1f} \N{RIGHTWARDS ARROW} {_percent(found)}"),
    ]
    gain = "gain per vehicle"
    if found.get("interval_90"):
        low, high = found["interval_90"]
        gain += f" (90 %: {minus(f'{metric.number(low)} to {metric.number(high)}')})"
    figures.append((gain, minus(metric.amount(_gain(found, base), sign="+"))))
    return [(_SPACE_BEFORE_UNIT.sub(_NO_BREAK, what), figure) for what, figure in figures]


def _what_to_do(result):
    sensor, place = result["sensor"], _place(result["deployment"])
    if not was_searched(result):
        return f"The {sensor} {place}"
    if not better_than_baseline(result):
        return f"No mounting that was tried is better than the baseline; the best of them has the {sensor} {place}"
    return f"Hang the {sensor} {place}"


def _place(mount):
    tilts = {"tilt_x_deg": "across it", "tilt_y_deg": "along it"}
    leaning = [f"{mount[key]:.1f}° {way}" for key, way in tilts.items() if abs(mount[key]) >= _LEVEL_DEG]
    parts = [f"{mount['height_m']:.2f} m above the road", f"tilted {' and '.join(leaning)}" if leaning else "level"]
    if abs(mount["yaw_deg"]) >= _LEVEL_DEG:
        parts.append(f"turned {mount['yaw_deg']:.1f}°")
    if mount["x_m"] or mount["y_m"]:
        parts.append(f"at x {mount['x_m']:.2f} m and y {mount['y_m']:.2f} m")
    return minus(", ".join(parts))


def _worth(result):
    found, base, on = _judges(result)
    gain, metric = _gain(found, base), metric_named(result["metric"])
    return (
        f"on {on} {_percent(found)} of the vehicles are detectable instead of {_percent(base)} under the baseline, and "
        f"{_gained(metric, gain)}{_interval(result, metric, gain)}"
    )


def _gained(metric, gain):
    """What the mounting is worth to a vehicle."""
    amount = f"{'gains' if gain >= 0.0 else 'loses'} {metric.amount(abs(gain))}"
    # A vehicle that gains metres or nats would sound like the reverse of what is meant where lower is better, and what
    # a scene gains is not a vehicle's.
    of_vehicles = metric.higher_is_better and not metric.of_scene
    return f"a vehicle {amount}" if of_vehicles else f"the objective {amount} per vehicle"


def _interval(result, metric, gain):
    if result["holdout"] is None:
        return "; nothing was held out, so that there is no interval"
    if result["holdout"]["interval_90"] is None:
        return "; there are too few blocks of time for an interval"
    low, high = result["holdout"]["interval_90"]
    doubt = "" if low > 0.0 or high < 0.0 else f", so that there may be no {'gain' if gain >= 0.0 else 'loss'} at all"
    return f" (90 % interval of the gain {minus(f'{metric.number(low)} to {metric.number(high)}')}{doubt})"


def _judges(result):
    """Scores of the mounting and of the baseline where they are judged, and what traffic that is."""
    if result["holdout"] is not None:
        return result["holdout"], result["baseline"]["holdout"], "held-out traffic"
    return result, result["baseline"], "the traffic that chose it" if was_searched(result) else "the scored traffic"


def _gain(found, base):
    return found["objective_per_vehicle"] - base["objective_per_vehicle"]


def _percent(scores):
    return f"{100 * scores['detectable_share']:.1f} %"
