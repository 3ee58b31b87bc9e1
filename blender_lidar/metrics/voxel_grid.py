"""A region cut into cubic voxels, and which of them vehicles' boxes fill."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError

MOST_VOXELS = 1 << 27
_WHOLE_VOXEL_TOLERANCE = 1e-9  # a region of 4.4 m is 11 voxels of 0.4 m, whatever the rounding of 4.4 / 0.4


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
        When a number is not finite, a side or count is not positive, or there are more than `MOST_VOXELS`.
    """

    low_m: tuple[float, float, float]
    counts: tuple[int, int, int]
    voxel_m: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.voxel_m) and self.voxel_m > 0.0):
            raise InputError(f"voxel_m is {self.voxel_m}; allowed: a positive number of metres")
        if len(self.low_m) != 3 or not np.isfinite(self.low_m).all():
            raise InputError(f"low_m is {self.low_m}; allowed: three finite numbers of metres")
        if len(self.counts) != 3 or any(count < 1 or count != int(count) for count in self.counts):
            raise InputError(f"counts is {self.counts}; allowed: three whole numbers, 1 or more")
        if float(np.prod(self.counts, dtype=float)) > MOST_VOXELS:
            raise InputError(f"a grid of {self.counts} voxels of {self.voxel_m:g} m; allowed: {MOST_VOXELS:,} at most")

    @classmethod
    def covering(cls, low_m: np.ndarray, high_m: np.ndarray, voxel_m: float) -> VoxelGrid:
        """The fewest whole voxels from `low_m` (3,) on that reach `high_m` (3,) [m]."""
        low, high = np.asarray(low_m, dtype=float), np.asarray(high_m, dtype=float)
        if low.shape != (3,) or high.shape != (3,) or not np.isfinite(high - low).all() or not (high > low).all():
            raise InputError(f"a region from {low.tolist()} to {high.tolist()}; allowed: finite, each side above 0")
        if not (np.isfinite(voxel_m) and voxel_m > 0.0):
            raise InputError(f"voxel_m is {voxel_m}; allowed: a positive number of metres")
        counts = np.maximum(np.ceil((high - low) / voxel_m - _WHOLE_VOXEL_TOLERANCE), 1.0)
        return cls(tuple(low.tolist()), tuple(int(count) for count in counts), float(voxel_m))

    def __len__(self) -> int:
        return self.counts[0] * self.counts[1] * self.counts[2]

    @property
    def high_m(self) -> np.ndarray:
        """Corner of the region with the greatest x, y and z, (3,) [m]."""
        return np.add(self.low_m, np.multiply(self.counts, self.voxel_m))

    def centres(self, voxel: np.ndarray) -> np.ndarray:
        """Centres of voxels (k,) by number, (k, 3) [m]."""
        return self.low_m + (np.stack(np.unravel_index(voxel, self.counts), axis=-1) + 0.5) * self.voxel_m

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

        Raises
        ------
        InputError
            When shapes disagree, a number is not finite or a side is not positive.
        """
        centre, size, heading = check_boxes(centre_m, size_m, heading_rad)
        inside = [self._in_box(*box) for box in zip(centre, size, heading, strict=True)]
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
            low + (index + 0.5) * self.voxel_m - middle
            for low, index, middle in zip(self.low_m, (i, j, k), centre, strict=True)
        )
        x, y = x[:, None], y[None, :]
        in_plan = (np.abs(cos * x + sin * y) <= half[0]) & (np.abs(cos * y - sin * x) <= half[1])
        column = (i[:, None] * self.counts[1] + j)[in_plan]
        return (column[:, None] * self.counts[2] + k[np.abs(z) <= half[2]]).ravel()


def check_boxes(
    centre_m: np.ndarray, size_m: np.ndarray, heading_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes as float arrays, or `InputError` when shapes disagree, a number is not finite or a side is not positive."""
    centre, size, heading = (np.asarray(values, dtype=float) for values in (centre_m, size_m, heading_rad))
    if centre.ndim != 2 or centre.shape[1] != 3 or size.shape != centre.shape or heading.shape != centre.shape[:1]:
        raise InputError(
            f"boxes: centres, sizes and headings have shapes {centre.shape}, {size.shape} and {heading.shape}; "
            "allowed: (n, 3), (n, 3) and (n,)"
        )
    if not (all(np.isfinite(values).all() for values in (centre, size, heading)) and (size > 0.0).all()):
        raise InputError("boxes: a number is not finite or a side not positive; allowed: finite, with positive sides")
    return centre, size, heading
