"""What a benchmark found, as the JSON file holds it."""

from __future__ import annotations

from .growth import Series
from .plan import Found
from .power_law import PowerLaw
from .targets import Verdict, beside_raw
from .timing import Quartiles, Timing

SCHEMA = 1


def document(found: Found, machine: dict[str, object]) -> dict[str, object]:
    """The whole content; what was not asked for, or not come to, is an empty list."""
    return {
        "schema": SCHEMA,
        "machine": machine,
        "frame": found.about,
        "times": [_timing(each, beside_raw(found.times, each)) for each in found.times.values()],
        "targets": [_verdict(each) for each in found.verdicts],
        "optimisations": [_timing(each, None) for each in found.wholes.values()],
        "growth": [_series(each) for each in found.growth],
        "left_out": found.left_out,
        "stopped": found.stopped,
    }


def _timing(timing: Timing, beside: Quartiles | None) -> dict[str, object]:
    row: dict[str, object] = {
        "name": timing.name,
        "group": timing.group,
        "note": timing.note,
        "seconds": _quartiles(timing.quartiles),
        "rounds": timing.seconds.tolist(),
    }
    if beside is not None:
        row["times_raw_embree"] = _quartiles(beside)
    return row


def _verdict(verdict: Verdict) -> dict[str, object]:
    return {**verdict.target._asdict(), "ratio": _quartiles(verdict.ratio), "held": verdict.held}


def _series(series: Series) -> dict[str, object]:
    return {
        "over": series.over,
        "caster": series.caster,
        "x": series.x,
        "seconds": [_quartiles(each) for each in series.seconds],
        "ready_s": series.ready_s,
        "peak_mib": series.peak_mib,
        "above_mib": series.above_mib,
        "time_law": _law(series.time_law),
        "memory_law": _law(series.memory_law),
    }


def _law(law: PowerLaw | None) -> dict[str, object] | None:
    return None if law is None else law._asdict()


def _quartiles(found: Quartiles) -> dict[str, float]:
    return found._asdict()
