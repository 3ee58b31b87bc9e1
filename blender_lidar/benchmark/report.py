"""What a benchmark found, as text."""

from __future__ import annotations

from collections.abc import Iterator

from .growth import FRAMES_FOR_WORKERS, VEHICLES, Series
from .plan import Found
from .power_law import PowerLaw
from .rival import RAW
from .stages import SWARM
from .targets import beside_raw
from .timing import Quartiles, Timing

_NAME = 52


def report(found: Found, machine: dict[str, object]) -> str:
    """All of it, a paragraph for each part."""
    parts = [_machine(machine)]
    if found.times:
        parts.append("\n".join(_times(found)))
    if found.verdicts:
        parts.append("\n".join(_verdicts(found)))
    if found.wholes:
        parts.append("\n".join(_wholes(found)))
    if found.growth:
        parts.append("\n".join(_growth(found)))
    if found.left_out:
        parts.append("\n".join(f"left out: {name} ({why})" for name, why in found.left_out.items()))
    return "\n\n".join(parts)


def exponent_text(law: PowerLaw | None) -> str:
    """An exponent with its standard error."""
    if law is None:
        return "no exponent"
    error = "" if law.standard_error is None else f" \N{PLUS-MINUS SIGN} {law.standard_error:.2f}"
    return f"{law.exponent:.2f}{error}"


def _machine(machine) -> str:
    libraries = ", ".join(f"{name} {found}" for name, found in machine["libraries"].items())
    load = "" if machine["load"] is None else f", load {machine['load']:.1f}"
    return f"{machine['processor']}, {machine['processors']} processors, Python {machine['python']}, {libraries}{load}"


def _times(found: Found) -> Iterator[str]:
    if found.about:
        yield _about(found.about)
    beside = f"{'x raw Embree':>14}" if RAW in found.times else ""
    yield _heading("milliseconds, median and quartiles over repeats") + beside
    for timing in found.times.values():
        yield _line(timing, beside_raw(found.times, timing), bool(beside))


def _heading(what: str) -> str:
    return f"{what:<{_NAME}} {'median':>10} {'25 %':>10} {'75 %':>10}"


def _about(about) -> str:
    each = {
        name: f"{middle:,} ({low:,} to {high:,})"
        for name, (low, middle, high) in ((name, about[name]) for name in _COUNTS)
    }
    number = len(about["frames"])
    return (
        f"{about['sensor']}, {about['beams']:,} beams, {number} frame{'s' * (number > 1)}, detail {about['detail']}; "
        f"median (and range) of a frame:\n{each['vehicles']} vehicles, {each['vehicles_counted']} within "
        f"{about['range_gate_m']:g} m, {each['triangles']} triangles, {each['survivors']} beams can reach one of these"
    )


_COUNTS = ("vehicles", "vehicles_counted", "triangles", "survivors")


def _line(timing: Timing, ratio: Quartiles | None, in_column: bool) -> str:
    low, median, high = (1e3 * value for value in timing.quartiles)
    line = f"{timing.name:<{_NAME}} {median:10.2f} {low:10.2f} {high:10.2f}"
    if in_column:
        line += " " * 14 if ratio is None else f"{ratio.median:14.2f}"
    return f"{line}  {timing.note}".rstrip()


def _verdicts(found: Found) -> Iterator[str]:
    yield "ratios, medians of pairs of the same round (quartiles); limits are for RS-80 frames of dense traffic"
    for verdict in found.verdicts:
        entry, rival, most = verdict.target
        held = "held" if verdict.held else "NOT held"
        yield f"{entry} / {rival}: {_ratio(verdict.ratio)}, at most {most:.3g}: {held}"


def _ratio(ratio: Quartiles) -> str:
    return f"{ratio.median:.3g} ({ratio.low:.3g} to {ratio.high:.3g})"


def _wholes(found: Found) -> Iterator[str]:
    yield _heading("seconds of a search, without map and hold-out")
    for timing in found.wholes.values():
        low, median, high = timing.quartiles
        yield f"{timing.name:<{_NAME}} {median:10.2f} {low:10.2f} {high:10.2f}  {timing.note}".rstrip()


def _growth(found: Found) -> Iterator[str]:
    yield (
        f"growth: a swarm of {SWARM} mountings, {VEHICLES} vehicles within 150 m in a frame, one frame "
        f"({FRAMES_FOR_WORKERS} for workers), one process; but for what grows"
    )
    yield "seconds as medians, trees being ready; MiB resident at most, above what libraries take"
    for series in found.growth:
        memory = exponent_text(series.memory_law)
        yield f"over {series.over}, {series.caster}: time ^ {exponent_text(series.time_law)}, memory ^ {memory}"
        yield from _points(series)


def _points(series: Series) -> Iterator[str]:
    rows = zip(series.x, series.seconds, series.ready_s, series.peak_mib, series.above_mib, strict=True)
    for x, seconds, ready, peak, above in rows:
        held = "" if peak is None else f"{peak:9.1f} MiB at most"
        held += "" if above is None else f",{above:9.1f} above"
        yield f"  {x:>6,} {seconds.median:10.4f} s  ready in {ready:8.4f} s {held}".rstrip()
