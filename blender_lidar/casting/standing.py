"""Scenery that hides vehicles: one tree for all frames, made once in each process that casts against it."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..errors import InputError
from ..world.scenery import Scenery
from . import caster_class
from .protocol import Caster


class StandingScenery:
    """What stands still, made ready to be cast against; its tree is made at the first cast and not pickled.

    Parameters
    ----------
    scenery : Scenery
        Its triangles.
    caster : str
        A name of `casting.CASTERS`.
    """

    def __init__(self, scenery: Scenery, caster: str) -> None:
        self.scenery, self._caster = scenery, caster

    def __getstate__(self) -> dict:
        return {"scenery": self.scenery, "_caster": self._caster}

    @cached_property
    def tree(self) -> Caster:
        """A caster of the triangles; meshes of others may be open."""
        return caster_class(self._caster)(self.scenery.corners, closed=False)

    def hides(self, origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Whether something stands nearer than a distance along rays, (n,) bool.

        Parameters
        ----------
        origins : ndarray, (3,) or (n, 3)
            Start of all rays, or of each [m].
        directions : ndarray, (n, 3)
            Unit directions.
        distance : ndarray, (n,)
            How far along each [m].

        Raises
        ------
        InputError
            For a distance that is not a number.
        """
        hidden = np.zeros(len(distance), dtype=bool)
        if len(distance):
            reach = float(distance.max())  # NaN if any is
            if not reach >= 0.0:
                raise InputError(f"rays are followed for {reach} m; allowed: a distance of 0 m or more")
            found = self.tree.meet(origins, directions, reach)
            hidden[found.ray] = found.distance < distance[found.ray]
        return hidden
