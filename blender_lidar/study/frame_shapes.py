"""The vehicles of a frame as shapes, ready to be cast against: made once for any sensor and mounting."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..casting import caster_class
from ..casting.culling import Pieces, cut_vehicles
from ..traffic.vehicles import Vehicles
from ..world.triangles import vehicle_triangles


class FrameShapes:
    """A frame at one level of detail, behind one caster.

    Parameters
    ----------
    vehicles : Vehicles
        All vehicles of the frame; each can hide another.
    counted : ndarray of bool, (n,)
        Those that are scored.
    detail : str
        Level of detail, of `world.shapes.DETAILS`.
    caster : str
        A name of `casting.CASTERS`.

    Attributes
    ----------
    counted : Vehicles
        The vehicles that are scored.
    tree : Caster
        Of all triangles.
    counted_row : ndarray of int64, (m,)
        Row of each triangle's vehicle among the counted; -1 where it does not count.
    surface : ndarray of uint8, (m,)
        What each triangle is made of, an index into `world.meshes.SURFACES`.
    """

    def __init__(self, vehicles: Vehicles, counted: np.ndarray, detail: str, caster: str) -> None:
        self.frame, self.detail, self.caster = vehicles.frame, detail, caster
        self.counted = vehicles.select(counted)
        triangles = vehicle_triangles(vehicles, detail)
        self.tree = caster_class(caster)(triangles.corners, closed=True)
        self.counted_row = np.where(counted, np.cumsum(counted) - 1, -1)[triangles.owner]
        self.surface = triangles.surface

    @cached_property
    def pieces(self) -> Pieces:
        """The counted vehicles cut for culling: beams that can reach only others hide nothing from them."""
        return cut_vehicles(self.counted, self.detail)
