"""What is changed about a scene, one thing at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..study.site import Site

TRAFFIC, MOUNTING, METRIC, SENSOR, SEARCH, CASTERS = "traffic", "mounting", "metric", "sensor", "search", "casters"
SECTIONS = (TRAFFIC, MOUNTING, METRIC, SENSOR, SEARCH, CASTERS)


@dataclass(frozen=True, slots=True)
class Variation:
    """One thing changed about a site.

    Attributes
    ----------
    section : str
        One of `SECTIONS`.
    what, value : str
        What is changed, and to what.
    changed : callable
        Makes the changed site of a site; it can be pickled, and the number of frames stays.
    draw : int
        Which of several random draws of the same change it is, from 1; 0 where nothing is drawn.
    """

    section: str
    what: str
    value: str
    changed: Callable[[Site], Site]
    draw: int = 0

    @property
    def stage(self) -> str:
        """A name for a file."""
        words = f"{self.section} {self.what} {self.value} {self.draw or ''}".lower()
        return "_".join("".join(sign if sign.isalnum() or sign in "-." else " " for sign in words).split())


def unchanged(site: Site) -> Site:
    """The site as it is."""
    return site


AS_IT_IS = Variation("", "as the scene has it", "", unchanged)
