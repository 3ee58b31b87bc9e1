"""Beams through a grid of voxels, all of them a voxel further at a time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..errors import InputError
from .voxel_grid import VoxelGrid

_LEVEL = 1e-12  # of a unit vector; a smaller component moves a beam by less than a nanometre in a kilometre


class VoxelWalk:
    """The voxels that beams from one place cross, in the order in which they cross them.

    Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987: a beam goes on through
    the nearest of the next planes across x, y and z. Exact but for rounding: a voxel that a beam merely touches, on a
    face, an edge or a corner, may count as crossed or not. Beams go through everything: what a vehicle hides is not
    known here.

    Parameters
    ----------
    grid : VoxelGrid
        Where they are followed.
    origin_m : ndarray, (3,)
        Where they start [m].
    directions : ndarray, (n, 3)
        Unit vectors.
    max_range_m : float
        How far they are followed [m].
    min_range_m : float
        From where on [m].

    Attributes
    ----------
    beam : ndarray of int64, (m,)
        Rows of `directions` that cross the region at all, those with the most voxels first.

    Raises
    ------
    InputError
        When shapes disagree, a number is not finite or a range is negative.

    A walk is used up by going through its `steps` once.
    """

    def __init__(
        self,
        grid: VoxelGrid,
        origin_m: np.ndarray,
        directions: np.ndarray,
        max_range_m: float,
        min_range_m: float = 0.0,
    ) -> None:
        origin, directions = _checked(origin_m, directions, max_range_m, min_range_m)
        counts = np.array(grid.counts)[:, None]
        start = ((origin - grid.low_m) / grid.voxel_m)[:, None]  # all in voxels from here on
        ahead = np.where(np.abs(directions.T) < _LEVEL, 0.0, directions.T)
        enter, leave = _within(start, ahead, counts, min_range_m / grid.voxel_m, max_range_m / grid.voxel_m)
        beam = np.flatnonzero(enter < leave)
        ahead, enter, leave = ahead[:, beam], enter[beam], leave[beam]
        first = np.clip(np.floor(start + ahead * enter), 0, counts - 1)
        last = np.clip(np.floor(start + ahead * leave), 0, counts - 1)
        voxels = np.abs(last - first).sum(axis=0).astype(np.int64) + 1  # a plane crossed for each but the first
        order = np.argsort(-voxels, kind="stable")
        self.beam = beam[order]
        self._counts = grid.counts
        self._walking = _still_walking(voxels)
        ahead, first = ahead[:, order], first[:, order]
        stands = ahead == 0.0
        self._apart = 1.0 / np.abs(np.where(stands, 1.0, ahead))  # between planes, along the beam
        self._next = np.where(stands, np.inf, (first + (ahead > 0.0) - start) / np.where(stands, 1.0, ahead))
        # A rim of voxels about the grid takes up a beam that rounding lets cross its last plane too early.
        stride = np.array([(grid.counts[1] + 2) * (grid.counts[2] + 2), grid.counts[2] + 2, 1])[:, None]
        self._voxel = ((first.astype(np.int64) + 1) * stride).sum(axis=0)
        self._stride = np.where(ahead > 0.0, stride, -stride)

    def steps(self) -> Iterator[np.ndarray]:
        """The voxel that each beam is in, step after step; for numbers within the rim that `empty` makes.

        Yields
        ------
        ndarray of int64, (k,)
            Numbers for the first k of `beam`: those that have not left the region yet. Overwritten by the next step.
        """
        for walking in self._walking:
            voxel = self._voxel[:walking]
            yield voxel
            x, y, z = (along[:walking] for along in self._next)
            by_x = (x <= y) & (x <= z)
            by_y = (y <= z) & ~by_x
            by_z = ~(by_x | by_y)
            for along, apart, crossed in zip((x, y, z), self._apart, (by_x, by_y, by_z), strict=True):
                np.add(along, apart[:walking], out=along, where=crossed)
            across_x, across_y, across_z = (stride[:walking] for stride in self._stride)
            voxel += np.where(by_x, across_x, np.where(by_y, across_y, across_z))

    def empty(self, dtype: type) -> np.ndarray:
        """Zeros for every voxel and for a rim about the grid, to be indexed by `steps`."""
        return np.zeros(np.prod(np.add(self._counts, 2)), dtype=dtype)

    def with_rim(self, value: np.ndarray) -> np.ndarray:
        """A value of each voxel (voxels,) as `steps` index it."""
        return np.pad(value.reshape(self._counts), 1).ravel()

    def without_rim(self, value: np.ndarray) -> np.ndarray:
        """What was found by `steps` for each voxel of the grid, (voxels,)."""
        return value.reshape(np.add(self._counts, 2))[1:-1, 1:-1, 1:-1].ravel()


def covered_voxels(
    grid: VoxelGrid, origin_m: np.ndarray, directions: np.ndarray, max_range_m: float, min_range_m: float = 0.0
) -> np.ndarray:
    """Which voxels any beam crosses, (voxels,) bool; parameters and errors as for `VoxelWalk`."""
    walk = VoxelWalk(grid, origin_m, directions, max_range_m, min_range_m)
    covered = walk.empty(bool)
    for voxel in walk.steps():
        covered[voxel] = True
    return walk.without_rim(covered)


def _checked(origin, directions, max_range, min_range):
    origin, directions = np.asarray(origin, dtype=float), np.asarray(directions, dtype=float)
    if origin.shape != (3,) or directions.ndim != 2 or directions.shape[1] != 3:
        raise InputError(f"origin and directions: shapes {origin.shape} and {directions.shape}; allowed: (3,), (n, 3)")
    if not (np.isfinite(origin).all() and np.isfinite(directions).all()):
        raise InputError("origin or directions: a number is not finite; allowed: finite numbers")
    if not 0.0 <= min_range <= max_range < np.inf:
        raise InputError(f"beams from {min_range} m to {max_range} m; allowed: 0 <= from <= to, finite")
    return origin, directions


def _within(start, ahead, counts, nearest, farthest):
    """Where beams enter and leave the region (the slabs between its faces), both in voxels along the beam."""
    stands = ahead == 0.0
    slope = np.where(stands, 1.0, ahead)
    one, other = -start / slope, (counts - start) / slope
    between = (start >= 0.0) & (start < counts)  # a beam along a slab is in it always or never
    enter = np.where(stands, np.where(between, -np.inf, np.inf), np.minimum(one, other))
    leave = np.where(stands, np.inf, np.maximum(one, other))
    return np.maximum(enter.max(axis=0), nearest), np.minimum(leave.min(axis=0), farthest)


def _still_walking(voxels):
    """How many beams are still in the region in each step; the counts of their voxels descend."""
    ended = np.bincount(voxels, minlength=1)
    return (len(voxels) - np.cumsum(ended))[:-1].tolist()
