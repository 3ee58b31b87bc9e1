"""S-MIG and M-SOG of single vehicles: where in its box a vehicle usually returns, and how much that tells.

Both are published for a region, not for a vehicle. Here the region is the vehicle's box, and the prior of a voxel the
share of training vehicles with a return in it; only what a return lies in counts as covered. The form is ours. Density
and NUC of the ground (`ground_returns`) have no form for a vehicle and get none.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .metric import VehicleReturns
from .occupancy_entropy import bernoulli_entropy
from .view_grids import cell_counts
from .voxel_grid import MOST_VOXELS

VOXEL_M = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class VehiclePrior:
    """How often vehicles return from each voxel of their box, voxels being counted from the box's centre.

    So counted, a voxel lies as far ahead, to the left and above the middle in a small vehicle as in a large one. A box
    has the voxels that lie in it at least in part. Returns up to a voxel beyond a face fall into the face's voxel,
    further ones are dropped.

    Attributes
    ----------
    voxel_m : float
        Side of a voxel [m].
    p : ndarray, (2 a, 2 b, 2 c)
        Share of the training vehicles whose box has the voxel that return from it; 0 where no box has it. The centre is
        the corner that the voxels ``[a - 1 : a + 1, b - 1 : b + 1, c - 1 : c + 1]`` share.
    vehicles : ndarray of int64, (2 a, 2 b, 2 c)
        Training vehicles whose box has the voxel: how far to trust p.
    """

    voxel_m: float
    p: np.ndarray
    vehicles: np.ndarray

    @classmethod
    def learn(cls, returns: VehicleReturns, voxel_m: float = VOXEL_M) -> VehiclePrior:
        """The prior of some vehicles; to be fair learned from other vehicles than those that it scores.

        Raises
        ------
        InputError
            Without vehicles, without their points, for boxes of more than `MOST_VOXELS` or a voxel that is no
            positive number of metres.
        """
        if not len(returns):
            raise InputError("no vehicle to learn from; allowed: 1 or more")
        half = _half_counts(returns.size_m, voxel_m)
        a, b, c = most = half.max(axis=0)
        if 8.0 * float(np.prod(most, dtype=float)) > MOST_VOXELS:
            raise InputError(
                f"a box of {2 * a} x {2 * b} x {2 * c} voxels of {voxel_m:g} m; allowed: {MOST_VOXELS:,} at most"
            )
        index, _ = _filled(returns, voxel_m)
        filled = np.bincount(np.ravel_multi_index((index + most[:, None]).tolist(), 2 * most), minlength=8 * a * b * c)
        # A box has the i-th voxel from the middle if it has more than i on that side: summed from the far end.
        boxes = np.zeros(most, dtype=np.int64)
        np.add.at(boxes, tuple((half - 1).T), 1)
        for axis in range(3):
            boxes = np.flip(np.cumsum(np.flip(boxes, axis), axis=axis), axis)
            boxes = np.concatenate([np.flip(boxes, axis), boxes], axis=axis)
        return cls(float(voxel_m), filled.reshape(boxes.shape) / np.maximum(boxes, 1), boxes)

    def covered_entropy(self, returns: VehicleReturns) -> np.ndarray:
        """Sum of H(p) over the voxels that a vehicle returns from [nats], (n,); higher is better.

        0 for a voxel from which all training vehicles return or none does, and for one that none of them has: a vehicle
        larger than all of them has no prior at its ends.
        """
        return self._sums(returns)[0]

    def s_mig(self, returns: VehicleReturns) -> np.ndarray:
        """Minus `covered_entropy`, S-MIG's published sign [nats], (n,).

        Higher claimed better, and highest, 0, for a vehicle without returns: see `occupancy_entropy.s_mig`. On real
        cars it is lowest where a detector does best (Spearman -0.85 with confidence times IoU, and so 0.85 for
        `covered_entropy`; 203 cars of KITTI, SECOND detector, prior from the other half of the frames).
        """
        return 0.0 - self._sums(returns)[0]

    def m_sog(self, returns: VehicleReturns) -> np.ndarray:
        """Minus the mean of H(p) over the voxels that a vehicle returns from [nats], (n,); 0 without returns.

        Higher claimed better, and highest for a vehicle without returns: see `occupancy_entropy.m_sog`. On the same
        cars it tells next to nothing (Spearman -0.11).
        """
        entropy, voxels = self._sums(returns)
        return 0.0 - entropy / np.maximum(voxels, 1)

    def _sums(self, returns):
        """Sum of H(p) over the voxels that each vehicle returns from, (n,), and the number of those voxels, (n,)."""
        index, vehicle = _filled(returns, self.voxel_m)
        shape = np.array(self.p.shape)[:, None]
        index = index + shape // 2
        known = ((index >= 0) & (index < shape)).all(axis=0)
        entropy = np.zeros(len(vehicle))
        entropy[known] = bernoulli_entropy(self.p[tuple(index[:, known])])
        total = np.bincount(vehicle, weights=entropy, minlength=len(returns))
        return total, np.bincount(vehicle, minlength=len(returns))


def _filled(returns, voxel_m):
    """Voxels that hold a return, each once: index from the centre, (3, u), and vehicle, (u,)."""
    if returns.points is None:
        raise InputError("a prior of a vehicle's voxels needs the points themselves, not their number alone")
    half_m, half = 0.5 * returns.size_m, _half_counts(returns.size_m, voxel_m)
    row = returns.vehicle
    kept = (np.abs(returns.points) <= half_m[row] + voxel_m).all(axis=1)
    row = row[kept]
    index = np.floor(returns.points[kept] / voxel_m).astype(np.int64)
    index = np.clip(index, -half[row], half[row] - 1)
    found = np.unique(np.column_stack([row, index]), axis=0)
    return found[:, 1:].T, found[:, 0]


def _half_counts(size_m, voxel_m):
    """Whole voxels from each box's centre to its faces, (n, 3): the last of them may reach beyond."""
    return cell_counts(0.5 * np.asarray(size_m, dtype=float), voxel_m)
