"""The pictures of the study of stability."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from ..plots.stability import VERDICT_LOOKS, Change, plot_changes, plot_profiles, plot_sample_size
from .findings import MOST_FRAGILE_LOSS, MOST_STABLE_LOSS
from .sample_size import ASKED_DEG

CHANGES, OFF_PLAN, SAMPLE_SIZE = "changes.png", "off_plan.png", "sample_size.png"
PICTURES = (CHANGES, OFF_PLAN, SAMPLE_SIZE)
_OFF_PLAN = {  # of a coordinate: its name on an axis, and which tolerance is its own
    "height_m": ("Height [m]", "height_m"),
    "tilt_x_deg": ("Tilt across [deg]", "tilt_deg"),
    "tilt_y_deg": ("Tilt along [deg]", "tilt_deg"),
    "yaw_deg": ("Yaw [deg]", "yaw_deg"),
}


def draw_charts(result: Mapping, path: Callable[[str], Path]) -> list[str]:
    """Draw what there is to draw, each into the file that `path` gives for its name; returns the names."""
    drawn = []
    for name, draw in ((CHANGES, _draw_changes), (OFF_PLAN, _draw_profiles), (SAMPLE_SIZE, _draw_sample_size)):
        if draw(result, path(name)):
            drawn.append(name)
    return drawn


def _draw_changes(result: Mapping, path: Path) -> bool:
    changes = [
        Change(
            one["section"],
            _name(one),
            one["verdict"],
            numbers["loss"],
            numbers["interval_90"],
            numbers["best_tilt_deg"],
        )
        for one, numbers in ((one, one["numbers"]) for one in result["findings"])
        if one["verdict"] in VERDICT_LOOKS and "best_tilt_deg" in numbers
    ]
    if not changes:
        return False
    plot_changes(
        path,
        changes,
        limits=(MOST_STABLE_LOSS, MOST_FRAGILE_LOSS),
        reference=result["mounting"]["tilt_x_deg"],
        interval=_numbers_with(result, "tilt_interval_90_deg").get("tilt_interval_90_deg"),
        label="Best tilt under the change [deg]",
        title="What the mounting loses when one thing changes",
        subtitle=_about(result),
    )
    return True


def _draw_profiles(result: Mapping, path: Path) -> bool:
    kept = {_OFF_PLAN[key][0]: (of["offset"], of["kept"]) for key, of in result["profiles"].items()}
    if not kept:
        return False
    tolerances = {name: result["tolerance"][width] for name, width in _OFF_PLAN.values()}
    plot_profiles(path, kept, tolerances, title="The mounting off its plan", subtitle=_about(result))
    return True


def _draw_sample_size(result: Mapping, path: Path) -> bool:
    found = _numbers_with(result, "reach_deg")
    if not found:
        return False
    plot_sample_size(
        path,
        found["vehicles"],
        found["reach_deg"],
        power=found["power"],
        needed=found["needed"],
        asked=ASKED_DEG,
        title="How many vehicles make the best tilt certain",
        subtitle=_about(result),
    )
    return True


def _numbers_with(result: Mapping, key: str) -> Mapping:
    """The numbers of the only finding that has this one; none without it."""
    return next((one["numbers"] for one in result["findings"] if key in one["numbers"]), {})


def _name(finding: Mapping) -> str:
    return f"{finding['what']}: {finding['value']}" if finding["value"] else finding["what"]


def _about(result: Mapping) -> str:
    mount = result["mounting"]
    return f"{result['sensor']} at {mount['height_m']:.2f} m, {mount['tilt_x_deg']:.1f} deg; {result['scene']}"
