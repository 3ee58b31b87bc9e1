"""Voxel grid, and voxel traversal of beams through it (Amanatides and Woo)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from blender_lidar.errors import InputError

# --- A region cut into cubic voxels, and which of them vehicles' boxes fill -------------------------------

MOST_VOXELS = 1 << 27
_WHOLE_VOXEL_TOLERANCE = 1e-9  # a region of 4.4 m is 11 voxels of 0.4 m, though 4.4 / 0.4 is rounded


@dataclass(frozen=True, slots=True)
class VoxelGrid:
    """Cubic voxels that fill an upright region, numbered with x slowest and z fastest.

    Attributes
    ----------
    low_m : tuple of float
        Corner of the region with the least x, y and z [m].
    counts : tuple of int
        Voxels along x, y and z.
    voxel_m : float
        Side of a voxel [m].

    Raises
    ------
    InputError
        When there are more than `MOST_VOXELS`.
    """

    low_m: tuple[float, float, float]
    counts: tuple[int, int, int]
    voxel_m: float

    def __post_init__(self) -> None:
        if float(np.prod(self.counts, dtype=float)) > MOST_VOXELS:
            raise InputError(f"a grid of {self.counts} voxels of {self.voxel_m:g} m; allowed: {MOST_VOXELS:,} at most")

    @classmethod
    def covering(cls, low_m: np.ndarray, high_m: np.ndarray, voxel_m: float) -> VoxelGrid:
        """The fewest whole voxels from `low_m` (3,) on that reach `high_m` (3,) [m].

        Raises
        ------
        InputError
            When the region has no volume, or too many voxels.
        """
        low, high = np.asarray(low_m, dtype=float), np.asarray(high_m, dtype=float)
        if not (np.isfinite(high - low) & (high > low)).all():
            raise InputError(f"a region from {low.tolist()} to {high.tolist()}; allowed: finite, each side above 0")
        counts = np.maximum(np.ceil((high - low) / voxel_m - _WHOLE_VOXEL_TOLERANCE), 1.0)
        return cls(tuple(low.tolist()), tuple(int(count) for count in counts), float(voxel_m))

    def __len__(self) -> int:
        return self.counts[0] * self.counts[1] * self.counts[2]

    def centres(self, voxel: np.ndarray) -> np.ndarray:
        """Centres of voxels (k,) by number, (k, 3) [m]."""
        return self.low_m + (np.stack(np.unravel_index(voxel, self.counts), axis=-1) + 0.5) * self.voxel_m

    def with_rim(self, value: np.ndarray) -> np.ndarray:
        """A value of each voxel (voxels,) as `traverse` numbers them: with a rim of voxels about the grid, all 0."""
        return np.pad(value.reshape(self.counts), 1).ravel()

    def without_rim(self, value: np.ndarray) -> np.ndarray:
        """A value of each voxel of the grid, (voxels,), from what `with_rim` made."""
        return value.reshape(np.add(self.counts, 2))[1:-1, 1:-1, 1:-1].ravel()

    def in_boxes(self, centre_m: np.ndarray, size_m: np.ndarray, heading_rad: np.ndarray) -> np.ndarray:
        """Voxels whose centre lies in one of n boxes, each once.

        Parameters
        ----------
        centre_m, size_m : ndarray, (n, 3)
            Box centres; length, width and height [m]. Boxes stand upright; faces belong to them.
        heading_rad : ndarray, (n,)
            Counter-clockwise from +x [rad].

        Returns
        -------
        ndarray of int64, (k,)
            Their numbers, ascending.
        """
        inside = [self._in_box(*box) for box in zip(centre_m, size_m, heading_rad, strict=True)]
        return np.unique(np.concatenate(inside)) if inside else np.zeros(0, dtype=np.int64)

    def _in_box(self, centre, size, heading):
        """Numbers of the voxels whose centre lies in a box, from the block of voxels about it alone."""
        cos, sin = np.cos(heading), np.sin(heading)
        half = 0.5 * size
        reach = np.array([abs(cos) * half[0] + abs(sin) * half[1], abs(sin) * half[0] + abs(cos) * half[1], half[2]])
        first, last = ((centre + side * reach - self.low_m) / self.voxel_m - 0.5 for side in (-1.0, 1.0))
        # One voxel more on either side than the bounds say: whether it is in the box is decided below.
        first = np.clip(np.floor(first), 0, self.counts).astype(np.int64)
        last = np.clip(np.ceil(last) + 1.0, 0, self.counts).astype(np.int64)
        i, j, k = (np.arange(start, stop) for start, stop in zip(first, last, strict=True))
        x, y, z = (
            self.low_m[axis] + (index + 0.5) * self.voxel_m - centre[axis] for axis, index in enumerate((i, j, k))
        )
        x, y = x[:, None], y[None, :]
        in_plan = (np.abs(cos * x + sin * y) <= half[0]) & (np.abs(cos * y - sin * x) <= half[1])
        column = (i[:, None] * self.counts[1] + j)[in_plan]
        return (column[:, None] * self.counts[2] + k[np.abs(z) <= half[2]]).ravel()


# --- Beams through a grid of voxels, all of them a voxel further at a time --------------------------------

_LEVEL = 1e-12  # of a unit vector; a smaller component moves a beam by less than a nanometre in a kilometre


def traverse(
    grid: VoxelGrid, origin_m: np.ndarray, directions: np.ndarray, max_range_m: float, min_range_m: float = 0.0
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Voxel traversal: the voxels that beams from one place cross, step after step, in the order they cross them.

    Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987: a beam goes on through
    the nearest of the next planes across x, y and z. Exact except for rounding: a voxel that a beam merely touches,
    on a face, an edge or a corner, may count as crossed or not. Beams go through everything: what a vehicle hides is
    not known here.

    Parameters
    ----------
    grid : VoxelGrid
        Where they are followed.
    origin_m : ndarray, (3,)
        Where they start [m].
    directions : ndarray, (n, 3)
        Unit vectors.
    max_range_m, min_range_m : float
        How far they are followed, and from where on [m].

    Yields
    ------
    beam, voxel : ndarray of int64, (k,)
        Rows of the beams that have not left the region yet, those with the most voxels first, so that each step has the
        first k of the one before; and the number of the voxel that each is in, within the rim of
        `VoxelGrid.with_rim`, overwritten by the next step.
    """
    counts = np.array(grid.counts)[:, None]
    start = ((origin_m - grid.low_m) / grid.voxel_m)[:, None]  # all in voxels from here on
    ahead = np.where(np.abs(directions.T) < _LEVEL, 0.0, directions.T)
    enter, leave = _within(start, ahead, counts, min_range_m / grid.voxel_m, max_range_m / grid.voxel_m)
    beam = np.flatnonzero(enter < leave)
    ahead, enter, leave = ahead[:, beam], enter[beam], leave[beam]
    first = np.clip(np.floor(start + ahead * enter), 0, counts - 1)
    last = np.clip(np.floor(start + ahead * leave), 0, counts - 1)
    voxels = np.abs(last - first).sum(axis=0).astype(np.int64) + 1  # a plane crossed for each but the first
    order = np.argsort(-voxels, kind="stable")
    beam, ahead, first = beam[order], ahead[:, order], first[:, order]
    stands = ahead == 0.0
    slope = np.where(stands, 1.0, ahead)
    apart = 1.0 / np.abs(slope)  # between planes, along the beam
    planes = np.where(stands, np.inf, (first + (ahead > 0.0) - start) / slope)  # the next ones
    # A rim of voxels about the grid takes up a beam that rounding lets cross its last plane too early.
    stride = np.array([(grid.counts[1] + 2) * (grid.counts[2] + 2), grid.counts[2] + 2, 1])[:, None]
    place = ((first.astype(np.int64) + 1) * stride).sum(axis=0)
    stride = np.where(ahead > 0.0, stride, -stride)
    going = len(voxels) - np.cumsum(np.bincount(voxels, minlength=1))  # beams, after so many steps
    for walking in going[:-1].tolist():
        voxel = place[:walking]
        yield beam[:walking], voxel
        x, y, z = (along[:walking] for along in planes)
        by_x = (x <= y) & (x <= z)
        by_y = (y <= z) & ~by_x
        by_z = ~(by_x | by_y)
        for along, gap, crossed in zip((x, y, z), apart, (by_x, by_y, by_z), strict=True):
            np.add(along, gap[:walking], out=along, where=crossed)
        across_x, across_y, across_z = (step[:walking] for step in stride)
        voxel += np.where(by_x, across_x, np.where(by_y, across_y, across_z))


def covered_voxels(
    grid: VoxelGrid, origin_m: np.ndarray, directions: np.ndarray, max_range_m: float, min_range_m: float = 0.0
) -> np.ndarray:
    """Which voxels any beam crosses, (voxels,) bool; parameters as for `traverse`."""
    covered = grid.with_rim(np.zeros(len(grid), dtype=bool))
    for _, voxel in traverse(grid, origin_m, directions, max_range_m, min_range_m):
        covered[voxel] = True
    return grid.without_rim(covered)


def _within(start, ahead, counts, nearest, farthest):
    """Where beams enter and leave the region (the slabs between its faces), both in voxels along the beam."""
    stands = ahead == 0.0
    slope = np.where(stands, 1.0, ahead)
    one, other = -start / slope, (counts - start) / slope
    between = (start >= 0.0) & (start < counts)  # a beam along a slab is in it always or never
    enter = np.where(stands, np.where(between, -np.inf, np.inf), np.minimum(one, other))
    leave = np.where(stands, np.inf, np.maximum(one, other))
    return np.maximum(enter.max(axis=0), nearest), np.minimum(leave.min(axis=0), farthest)
