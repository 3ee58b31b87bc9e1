"""What a benchmark found: as text, as JSON, and as a picture of rows of times."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from benchmark_rivals import RAW, RIVALS
from benchmark_stages import METRIC, SWARM, Quartiles, Timing
from blender_lidar.report.figure import BASELINE_LOOK, INK, OPTIMISED_LOOK, SMALL_PT, sheet


@dataclass(slots=True)
class Found:
    """What came of it; what was not asked for, or not come to before it was stopped, is empty."""

    about: dict[str, object] = field(default_factory=dict)
    times: dict[str, Timing] = field(default_factory=dict)
    wholes: dict[str, Timing] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)
    stopped: bool = False

    def beside_raw(self, timing: Timing) -> Quartiles | None:
        """A frame's time over raw Embree's; None without that, and for the metric, which has rounds of its own."""
        raw = self.times.get(RAW)
        return None if raw is None or timing.group == METRIC else timing.ratio(raw)


def machine() -> dict[str, object]:
    """On what it was measured; `load` is the mean number of processes that wanted to run in the last minute."""
    libraries = {}
    for name in ("numpy", "numba", "embreex", "bpy"):
        try:
            libraries[name] = version(name)
        except PackageNotFoundError:
            continue
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8").splitlines() if cpu.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return {
        "processor": names[0] if names else platform.processor() or platform.machine(),
        "processors": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "libraries": libraries,
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
    }


# --- JSON -------------------------------------------------------------------------------------------------------------


def document(found: Found, here: Mapping[str, object]) -> dict[str, object]:
    """The whole content; what was not asked for, or not come to, is an empty list."""
    return {
        "machine": here,
        "frame": found.about,
        "times": [_timing(each, found.beside_raw(each)) for each in found.times.values()],
        "optimisations": [_timing(each, None) for each in found.wholes.values()],
        "left_out": found.left_out,
        "stopped": found.stopped,
    }


def _timing(timing: Timing, beside: Quartiles | None) -> dict[str, object]:
    row = {**timing._asdict(), "seconds": timing.quartiles._asdict(), "rounds": timing.seconds.tolist()}
    return row if beside is None else {**row, "times_raw_embree": beside._asdict()}


# --- text -------------------------------------------------------------------------------------------------------------

_NAME = 60


def report(found: Found, here: Mapping[str, object]) -> str:
    """All of it, a paragraph for each part."""
    libraries = ", ".join(f"{name} {of}" for name, of in here["libraries"].items())
    load = "" if here["load"] is None else f", load {here['load']:.1f}"
    head = f"{here['processor']}, {here['processors']} processors, Python {here['python']}, {libraries}{load}"
    parts = [_times(found), _wholes(found)]
    parts.append(f"left out: {name} ({why})" for name, why in found.left_out.items())
    return "\n\n".join(text for text in (head, *map("\n".join, parts)) if text)


def _times(found: Found) -> Iterator[str]:
    if about := found.about:
        ranges = (about[name] for name in ("vehicles", "vehicles_counted", "triangles", "survivors"))
        each = [f"{middle:,} ({low:,} to {high:,})" for low, middle, high in ranges]
        number = len(about["frames"])
        yield (
            f"{about['sensor']}, {about['beams']:,} beams, {number} frame{'s' * (number > 1)}, detail "
            f"{about['detail']}; median (and range) of a frame:\n{each[0]} vehicles, {each[1]} within "
            f"{about['range_gate_m']:g} m, {each[2]} triangles, {each[3]} beams can reach one of these"
        )
    beside = f"{'x raw Embree':>14} {'of the least':>13}" if RAW in found.times else ""
    if found.times:
        yield _heading("milliseconds, least, median and quartiles over repeats") + beside
    for timing in found.times.values():
        ratio, column = found.beside_raw(timing), " " * len(beside)
        if ratio is not None:
            of_least = timing.quartiles.least / found.times[RAW].quartiles.least
            column = f"{ratio.median:14.3f} {of_least:13.3f}"
        first, _, kind = timing.name.partition(f"{SWARM}, ")
        if kind:  # beside the same swarm of one perfect LiDAR
            swarm = found.times[f"{first}{SWARM}"]
            of_least = timing.quartiles.least / swarm.quartiles.least
            column += f"  {timing.ratio(swarm).median:.2f} x the swarm, {of_least:.2f} of the least"
        yield _line(timing, 1e3, column)


def _heading(what: str) -> str:
    return f"{what:<{_NAME}} {'least':>10} {'median':>10} {'25 %':>10} {'75 %':>10}"


def _line(timing: Timing, scale: float, column: str = "") -> str:
    least, low, median, high = (scale * value for value in timing.quartiles)
    return (
        f"{timing.name:<{_NAME}} {least:10.2f} {median:10.2f} {low:10.2f} {high:10.2f}{column}  {timing.note}".rstrip()
    )


def _wholes(found: Found) -> Iterator[str]:
    if found.wholes:
        yield _heading("seconds of a search, without map and hold-out")
    for timing in found.wholes.values():
        yield _line(timing, 1.0)


# --- picture ----------------------------------------------------------------------------------------------------------

_ROW_MM, _HEAD_MM = 5.2, 30.0


def draw(path: str | Path, found: Found, here: Mapping[str, object]) -> None:
    """Write a PNG of the frames' times; optimisations are in the text alone."""
    about, times = found.about, list(found.times.values())
    subtitle = f"{here['processor']}, Python {here['python']}"
    if about:
        subtitle = f"{about['sensor']}, {about['beams']:,} beams, {about['vehicles'][1]} vehicles; {subtitle}"
    with sheet(path, _HEAD_MM + _ROW_MM * len(times), "Speed beside others", subtitle) as figure:
        _draw_times(figure.subplots(), times)


def _draw_times(axes, times: Sequence[Timing]) -> None:
    """A dot at each median, a line between the quartiles, the number beside it; the first row on top."""
    for row, timing in enumerate(times):
        _, low, median, high = (1e3 * value for value in timing.quartiles)
        look = BASELINE_LOOK if timing.group == RIVALS else OPTIMISED_LOOK
        axes.plot([low, high], [row, row], color=look["color"], linewidth=2.4, solid_capstyle="butt")
        face = "white" if timing.group == RIVALS else look["color"]
        axes.plot(median, row, look["marker"], color=look["color"], markersize=4.5, markerfacecolor=face)
        text = f"{median:,.3g}" if median < 1000.0 else f"{median:,.0f}"
        place = {"xytext": (6.0, 0.0), "textcoords": "offset points", "va": "center"}
        axes.annotate(text, (high, row), fontsize=SMALL_PT, color=INK, **place)
    ends = [timing.quartiles for timing in times]
    axes.set_xscale("log")
    axes.set_xlim(600.0 * min(end.low for end in ends), 4000.0 * max(end.high for end in ends))
    axes.set_yticks(range(len(times)), [timing.name for timing in times])
    axes.set_ylim(len(times) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0.0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("Milliseconds, median and quartiles (filled: ours)")
    axes.grid(visible=True, axis="x")
