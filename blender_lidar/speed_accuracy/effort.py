"""How much of everything is done."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of everything is done.

    Attributes
    ----------
    frames : int or None
        Searched frames that the reference looks at, spread evenly; None takes them all.
    mountings : int
        Of Sobol's sequence, an even number: each half is judged by a calibration fitted on the other.
    few_mountings : int
        Of these, those on which it is checked that casters, culling and the ground change nothing.
    varied_mountings : int
        Those on which the ablations are scored: so many of the best by the reference.
    draws : int
        How many units, or draws of noise, stand for a sensor that is imperfect at random.
    other_mountings : int
        Those on which another sensor is scored.
    phases : int
        How many phases of a stride are averaged at most.
    rounds : int
        How often each evaluation is timed.
    hit_frames, hit_mountings : int
        On how many the casters' hits are compared with the float64 oracle's.
    quick : bool
        Whether this is the quick chart, for what knows only that.
    """

    frames: int | None
    mountings: int
    few_mountings: int
    varied_mountings: int
    draws: int
    other_mountings: int
    phases: int
    rounds: int
    hit_frames: int
    hit_mountings: int
    quick: bool


FULL = Effort(None, 128, 8, 64, 6, 64, phases=2, rounds=5, hit_frames=3, hit_mountings=3, quick=False)
QUICK = Effort(10, 64, 4, 64, 2, 64, phases=2, rounds=5, hit_frames=1, hit_mountings=2, quick=True)
