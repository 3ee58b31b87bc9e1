"""What a run comes to, in one sentence."""

from __future__ import annotations

import re
from collections.abc import Mapping

from .elements import minus
from .summary import better_than_baseline, was_searched

_LEVEL_DEG = 0.05  # a smaller angle cannot be set on site
_NO_BREAK = "\N{NO-BREAK SPACE}"
_SPACE_BEFORE_UNIT = re.compile(r"(?<=\d) (?=%|(?:m|bits)\b)")


def answer(result: Mapping) -> str:
    """The mounting and what it is worth against the baseline, with the interval where there is one."""
    return _SPACE_BEFORE_UNIT.sub(_NO_BREAK, f"{_what_to_do(result)}: {_worth(result)}.")


def key_figures(result: Mapping) -> list[tuple[str, str]]:
    """The few figures that matter, each with what it is."""
    mount, (found, base, on) = result["deployment"], _judges(result)
    figures = [
        ("height above the road", f"{mount['height_m']:.2f} m"),
        ("tilt across the road", minus(f"{mount['tilt_x_deg']:.1f}°")),
        (f"detectable on {on}", f"{100 * base['detectable_share']:.1f} \N{RIGHTWARDS ARROW} {_percent(found)}"),
    ]
    gain = "gain per vehicle"
    if found.get("interval_90"):
        low, high = found["interval_90"]
        gain += f" (90 %: {minus(f'{low:.3f} to {high:.3f}')})"
    figures.append((gain, minus(f"{_gain(found, base):+.3f} bits")))
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
    gain = _gain(found, base)
    return (
        f"on {on} {_percent(found)} of the vehicles are detectable instead of {_percent(base)} under the baseline, and "
        f"a vehicle {'gains' if gain >= 0.0 else 'loses'} {abs(gain):.3f} bits{_interval(result, gain)}"
    )


def _interval(result, gain):
    if result["holdout"] is None:
        return "; nothing was held out, so that there is no interval"
    if result["holdout"]["interval_90"] is None:
        return "; there are too few blocks of time for an interval"
    low, high = result["holdout"]["interval_90"]
    doubt = "" if low > 0.0 or high < 0.0 else f", so that there may be no {'gain' if gain >= 0.0 else 'loss'} at all"
    return f" (90 % interval of the gain {minus(f'{low:.3f} to {high:.3f}')}{doubt})"


def _judges(result):
    """Scores of the mounting and of the baseline where they are judged, and what traffic that is."""
    if result["holdout"] is not None:
        return result["holdout"], result["baseline"]["holdout"], "held-out traffic"
    return result, result["baseline"], "the traffic that chose it" if was_searched(result) else "the scored traffic"


def _gain(found, base):
    return found["objective_per_vehicle"] - base["objective_per_vehicle"]


def _percent(scores):
    return f"{100 * scores['detectable_share']:.1f} %"
