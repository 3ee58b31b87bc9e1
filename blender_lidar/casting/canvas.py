"""What a turn is drawn with and on: the lattice's sines and cosines, and room for what its beams meet."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..sensors.beams import BeamLattice


class Table(NamedTuple):
    """What `draw` needs of a `BeamLattice`: by ring, and by slot the sine and cosine of its azimuth from slot 0."""

    elevation_sine: np.ndarray
    elevation_cosine: np.ndarray
    azimuth0: np.ndarray
    azimuth0_sine: np.ndarray
    azimuth0_cosine: np.ndarray
    slot_sine: np.ndarray
    slot_cosine: np.ndarray
    step: float


class Canvas(NamedTuple):
    """Room for one turn; between turns `nearest` and `doubted` are inf for every beam.

    Attributes
    ----------
    nearest : ndarray, (b,)
        Distance to the nearest triangle drawn so far [m].
    triangle : ndarray of int32, (b,)
        Its row.
    doubted : ndarray, (b,)
        The least distance of what a beam may or may not meet [m].
    touched, doubtful : ndarray of int32, (b,)
        Beams that met something, and beams of which rounding decides, in the order in which that was found.
    number : ndarray of int64, (3,)
        How many these are, and how many turns have been drawn.
    seen : ndarray, (v, 6)
        Of each vertex in this turn: x, y and z in the sensor frame [m], azimuth [rad], sine of the elevation and one
        over the distance.
    made : ndarray of int64, (v,)
        The turn that a row of `seen` was made in.
    """

    nearest: np.ndarray
    triangle: np.ndarray
    doubted: np.ndarray
    touched: np.ndarray
    doubtful: np.ndarray
    number: np.ndarray
    seen: np.ndarray
    made: np.ndarray


@lru_cache(maxsize=8)
def table_of(lattice: BeamLattice) -> Table:
    """What `draw` needs of a lattice."""
    azimuth0, slots = np.ascontiguousarray(lattice.slot_azimuth0_rad), lattice.step_rad * np.arange(lattice.columns)
    return Table(
        np.sin(lattice.elevation_rad),
        np.cos(lattice.elevation_rad),
        azimuth0,
        np.sin(azimuth0),
        np.cos(azimuth0),
        np.sin(slots),
        np.cos(slots),
        float(lattice.step_rad),
    )


def canvas(beams: int, vertices: int) -> Canvas:
    """An empty one."""
    return Canvas(
        np.full(beams, np.inf),
        np.zeros(beams, dtype=np.int32),
        np.full(beams, np.inf),
        np.zeros(beams, dtype=np.int32),
        np.zeros(beams, dtype=np.int32),
        np.zeros(3, dtype=np.int64),
        np.empty((vertices, 6)),
        np.full(vertices, -1, dtype=np.int64),
    )
