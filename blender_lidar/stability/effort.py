"""How much of everything is done."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of everything is done.

    Attributes
    ----------
    frames : int or None
        Frames that searches look at, spread evenly over the searched ones; None takes them all.
    varied_frames : int
        Those on which the best mounting of each variation is looked for, or all where there are fewer.
    heights, tilts : int
        Points of the grid of mountings on which each variation's optimum is looked for.
    fine_tilts : int
        Tilts of the grid for the scene as it is, whose optimum is sampled anew.
    seeds : int
        Seeds of the search.
    budget : float
        Share of the scene's evaluations that each of these searches gets.
    draws : int
        Units of a sensor, seeds of its noise, draws of other traffic.
    quick : bool
        Whether this is the quick study, for what knows only that.
    """

    frames: int | None
    varied_frames: int
    heights: int
    tilts: int
    fine_tilts: int
    seeds: int
    budget: float
    draws: int
    quick: bool


FULL = Effort(None, 15, heights=6, tilts=26, fine_tilts=51, seeds=11, budget=1.0, draws=8, quick=False)
QUICK = Effort(8, 8, heights=4, tilts=26, fine_tilts=51, seeds=3, budget=0.3, draws=2, quick=True)
