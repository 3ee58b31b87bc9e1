"""What a benchmark found, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..plots.benchmark import Bar, Line, Panel, plot_benchmark
from .growth import Series
from .plan import Found
from .report import exponent_text
from .rival import GROUP as RIVALS
from .timing import Timing

_AXES = {"frames": "Frames", "vehicles": "Vehicles in a frame", "rings": "Rings", "workers": "Processes"}


def draw(path: str | Path, found: Found, machine: dict[str, object]) -> None:
    """Write the PNG; the optimisations, of other lengths, are in the text alone."""
    about = found.about
    title = "Speed beside others" if found.times else "Growth"
    subtitle = f"{machine['processor']}, Python {machine['python']}"
    if about:
        subtitle = f"{about['sensor']}, {about['beams']:,} beams, {about['vehicles'][1]} vehicles; {subtitle}"
    bars = [_bar(timing) for timing in found.times.values()]
    plot_benchmark(path, bars, _panels(found.growth), title=title, subtitle=subtitle)


def _bar(timing: Timing) -> Bar:
    low, median, high = (1e3 * value for value in timing.quartiles)
    scaled = " (scaled)" if timing.note and timing.group == RIVALS else ""
    return Bar(f"{timing.name}{scaled}", low, median, high, timing.group != RIVALS)


def _panels(series: Sequence[Series]) -> list[Panel]:
    """Of everything that grew the time and, where it could be told, the memory beside it."""
    panels = []
    for over in dict.fromkeys(each.over for each in series):
        ours = [each for each in series if each.over == over]
        panels.append(Panel(_AXES[over], "Seconds", [_line(each, time=True) for each in ours]))
        known = [each for each in ours if each.memory_law is not None]
        if known:
            panels.append(Panel(_AXES[over], "Memory on top [MiB]", [_line(each, time=False) for each in known]))
    return panels


def _line(series: Series, *, time: bool) -> Line:
    if time:
        return Line(series.caster, series.x, [each.median for each in series.seconds], exponent_text(series.time_law))
    return Line(series.caster, series.x, series.above_mib, exponent_text(series.memory_law))
