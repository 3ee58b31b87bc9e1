"""One thing changed about a scene, and perhaps about how its mountings are scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from ..sensors.pose import Pose
from ..traffic.vehicles import Vehicles
from .frame_scorer import FrameScorer, Seen
from .scoring import CountedFrame
from .site import Site


class Scorer(Protocol):
    """What sees one frame from mountings: `FrameScorer`, or what an experiment puts in its place."""

    vehicles: Vehicles

    def __len__(self) -> int:
        """Vehicles that count."""

    def see(self, poses: Sequence[Pose], *, keep_returns: bool = False) -> Seen:
        """As `FrameScorer.see`."""


def frame_scorer(site: Site, frame: CountedFrame) -> Scorer:
    """The product's own way to see a frame."""
    return FrameScorer(frame.vehicles, frame.counted, site.observation)


@dataclass(frozen=True, slots=True)
class Variation:
    """One thing changed about a site.

    Attributes
    ----------
    section : str
        What sort of thing it is.
    what, value : str
        What is changed, and to what.
    changed : callable
        Makes the changed site of a site; it can be pickled, and the number of frames stays.
    draw : int
        Which of several random draws of the same change it is, from 1; 0 where nothing is drawn.
    scorer : callable
        What sees a frame of the changed site; it can be pickled.
    """

    section: str
    what: str
    value: str
    changed: Callable[[Site], Site]
    draw: int = 0
    scorer: Callable[[Site, CountedFrame], Scorer] = frame_scorer

    @property
    def stage(self) -> str:
        """A name for a file."""
        words = f"{self.section} {self.what} {self.value} {self.draw or ''}".lower()
        return "_".join("".join(sign if sign.isalnum() or sign in "-." else " " for sign in words).split())


def unchanged(site: Site) -> Site:
    """The site as it is."""
    return site


AS_IT_IS = Variation("", "as the scene has it", "", unchanged)
