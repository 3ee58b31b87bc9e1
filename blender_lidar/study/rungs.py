"""The rungs of a search from cheap to dear: which frames, beams and shapes each scores mountings with.

A rung's frames are the first so many of one fixed order, so that each rung has all frames of the one below and two
mountings are always compared on the same ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..world.shapes import DETAILS
from .fidelity import Fidelity
from .frame_scorer import Observation

FIRST_FRAMES = 8
_CANDIDATES = (16, 8)  # of the second rung and the third
_FINALISTS = 4
_SCREEN_CLIMB, _COARSE_CLIMB, _LAST_CLIMB = 24, 15, 14  # samples for each variable, of two at least
_COARSE_BEAMS = 4000  # in a turn of the first rung: an eighth of an RS-16's, a thirty-second of an RS-80's
_MOST_STRIDE = 32
_FEWEST_COLUMNS = 40  # of a turn, whatever the stride
_LARGEST_CELL_M = 0.4  # to which strides let cells grow


@dataclass(frozen=True, slots=True)
class Rung:
    """What mountings are scored with on one rung.

    Attributes
    ----------
    fidelity : Fidelity
        Shapes and share of the beams.
    frames : tuple of int
        Places among the searched frames, in the order in which rungs take them.
    candidates : int
        How many mountings come here from the rung below, at most; the first rung has a search in their place.
    climb : int
        Samples of the climbs from the best of them in all; at the reference, of each.
    """

    fidelity: Fidelity
    frames: tuple[int, ...]
    candidates: int = 0
    climb: int = 0


def coarse_observation(observation: Observation, fidelity: Fidelity) -> Observation:
    """The same sensor through a fidelity, with cells that grow as returns thin out; the reference stays as it is.

    With one column in k, returns are a k-th, and vehicles fall below the threshold that all beams see; on cells of k
    times the area their share of occupied cells stays about the same. `scripts/coarse_beams.py` (RS-16, 60 frames of
    scenes/i80.toml) ranks 150 mountings by a quarter of the beams on 30 frames, beside all beams on 54, with a weighted
    tau of 0.85 on cells as they are and of 0.94 on larger ones; on 8 frames of 0.82 and 0.88, and so by an eighth of
    the beams. Where all are good, 150 mountings within 0.15 m and 5 degrees about the best, shapes count: a quarter of
    the beams on all frames correlates by 0.93 with all beams on the vehicles' own bodies, with boxes by 0.86, and all
    beams with boxes by 0.91, so boxes are not used.
    """
    seen = fidelity.observed(observation)
    if fidelity.stride == 1:
        return seen
    grown = observation.cell_m * math.sqrt(fidelity.stride)
    return replace(seen, cell_m=max(observation.cell_m, min(grown, _LARGEST_CELL_M)))


def coarsest_stride(observation: Observation) -> int:
    """Every so many-th column leaves about `_COARSE_BEAMS` beams in a turn: a power of two."""
    lattice = observation.lattice
    thinning = min(lattice.columns * lattice.rings / _COARSE_BEAMS, lattice.columns / _FEWEST_COLUMNS, _MOST_STRIDE)
    return 2 ** round(math.log2(max(thinning, 1.0)))


def make_rungs(
    observation: Observation, block: Sequence[int], vehicles: Sequence[int], variables: int
) -> tuple[Rung, ...]:
    """The rungs from the cheapest to the reference, which is the last: the scene's own detail, beams and frames.

    Frames double and beams come back from rung to rung, while half as many candidates go on.

    Parameters
    ----------
    observation : Observation
        The scene's.
    block : sequence of int, (f,)
        Block of time of each searched frame.
    vehicles : sequence of int, (f,)
        Vehicles that count in each.
    variables : int
        Searched coordinates.
    """
    order, stride = spread_order(block, vehicles), coarsest_stride(observation)
    cheap, reference = min(observation.detail, "body", key=DETAILS.index), Fidelity(observation.detail)
    coarse, finer = Fidelity(cheap, stride), Fidelity(cheap, max(1, stride // 2))
    across = max(variables, 2)  # with one too a climb takes some generations
    climb = 0 if finer == reference else _COARSE_CLIMB * across
    return (
        Rung(coarse, order[:FIRST_FRAMES], climb=_SCREEN_CLIMB * across),
        Rung(coarse, order[: 2 * FIRST_FRAMES], candidates=_CANDIDATES[0]),
        Rung(finer, order[: 4 * FIRST_FRAMES], candidates=_CANDIDATES[1], climb=climb),
        Rung(reference, order, candidates=_FINALISTS, climb=_LAST_CLIMB * across),
    )


def spread_order(block: Sequence[int], vehicles: Sequence[int]) -> tuple[int, ...]:
    """Places of frames in an order of which every beginning is spread evenly over the blocks of time.

    Blocks take turns, a frame each, and come in an order in which neighbours in time come far apart; so do the frames
    within a block. Frames in which no vehicle counts come last.
    """
    block, filled = np.asarray(block), np.asarray(vehicles) > 0
    order = []
    for some in (filled, ~filled):
        places = np.flatnonzero(some)
        queues = [
            [members[turn] for turn in far_apart(len(members))]
            for members in (places[block[places] == label] for label in np.unique(block[places]))
        ]
        turns = far_apart(len(queues))
        for step in range(max(map(len, queues), default=0)):
            order += [int(queues[turn][step]) for turn in turns if step < len(queues[turn])]
    return tuple(order)


def far_apart(count: int) -> list[int]:
    """0 to `count` - 1 in an order of which every beginning is spread out: by van der Corput's sequence."""
    bits = max(count - 1, 1).bit_length()
    reverse = (int(f"{number:0{bits}b}"[::-1], 2) for number in range(2**bits))
    return [number for number in reverse if number < count]
