"""What the times of one RS-80 frame of dense traffic have to come to, each as a ratio to what others take."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from .rival import NAIVE, RAW, RAW_SURVIVORS
from .stages import METRIC_GROUP, casting_of, whole_of
from .timing import Quartiles, Timing


class Target(NamedTuple):
    """One entry's time over another's, and the most that it may be."""

    entry: str
    rival: str
    most: float


class Verdict(NamedTuple):
    """What a ratio came to."""

    target: Target
    ratio: Quartiles

    @property
    def held(self) -> bool:
        """Whether the median is within the limit."""
        return self.ratio.median <= self.target.most


TARGETS = (
    Target(casting_of("embree"), RAW_SURVIVORS, 1.15),
    Target(whole_of("embree"), RAW, 0.73),
    Target(whole_of("raster"), RAW, 0.73),
    Target(whole_of("bvh"), NAIVE, 1.0 / 15.0),
)


def verdicts(times: Mapping[str, Timing]) -> list[Verdict]:
    """Of every target whose two entries were timed."""
    return [
        Verdict(target, times[target.entry].ratio(times[target.rival]))
        for target in TARGETS
        if target.entry in times and target.rival in times
    ]


def beside_raw(times: Mapping[str, Timing], timing: Timing) -> Quartiles | None:
    """A frame's time over raw Embree's; None without that, and for the metric, which is timed in rounds of its own."""
    raw = times.get(RAW)
    return None if raw is None or timing.group == METRIC_GROUP else timing.ratio(raw)
