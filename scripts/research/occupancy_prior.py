"""Occupancy priors: how often voxels hold a vehicle or a return, their entropy, and what beams reach through them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from blender_lidar.errors import InputError
from blender_lidar.metrics.metric import VehicleReturns
from blender_lidar.metrics.view_grids import cell_counts
from voxel_grid import MOST_VOXELS, VoxelGrid, traverse

# --- How uncertain the voxels are that beams cross: S-MIG and M-SOG, which learn from traffic where vehicles drive -
# Both ask no more of a beam than that it crosses a voxel: it goes on through what stands there. Neither sees
# occlusion, nor how densely a voxel is sampled, and both end with the region and the range that they are given.


def bernoulli_entropy(p: np.ndarray) -> np.ndarray:
    """H(p) = -p ln p - (1 - p) ln(1 - p) of probabilities, elementwise [nats]; 0 where p is 0 or 1."""
    certain = (p == 0.0) | (p == 1.0)
    inner = np.where(certain, 0.5, p)
    return np.where(certain, 0.0, -inner * np.log(inner) - (1.0 - inner) * np.log1p(-inner))


# --- How often a voxel of the road is inside a vehicle, learned from frames, and what one frame tells beyond that -


class OccupiedFrames:
    """Which voxels vehicles fill in each of some frames, and the share of frames in which each is filled.

    Parameters
    ----------
    occupied : sequence of ndarray of int, (f,)
        For each frame the numbers of the voxels inside a box, each once: see `VoxelGrid.in_boxes`.
    voxels : int
        Voxels of the grid.
    weights : ndarray, (f,), optional
        How much each frame counts, 0 or more; all the same unless given.

    Raises
    ------
    InputError
        Without a frame that counts.
    """

    def __init__(self, occupied: Sequence[np.ndarray], voxels: int, weights: np.ndarray | None = None) -> None:
        weights = np.ones(len(occupied)) if weights is None else np.asarray(weights, dtype=float)
        if not weights.sum() > 0.0:
            raise InputError(f"of {len(occupied)} frames none counts; allowed: 1 or more with a weight above 0")
        self._frame = np.repeat(np.arange(len(occupied)), [len(one) for one in occupied])
        self._voxel = np.concatenate([np.asarray(one, dtype=np.int64) for one in occupied])
        self.weights = weights
        filled = np.bincount(self._voxel, weights=weights[self._frame], minlength=voxels)
        self.prior = np.minimum(filled / weights.sum(), 1.0)
        """Probability p that a voxel is occupied: the (weighted) share of frames in which it is, (voxels,)."""

    def __len__(self) -> int:
        return len(self.weights)

    def sums(self, value: np.ndarray) -> np.ndarray:
        """Sum over the voxels that are occupied in each frame of a value of each voxel (voxels,), (f,)."""
        return np.bincount(self._frame, weights=value[self._voxel], minlength=len(self))

    def surprisal(self, chosen: np.ndarray) -> np.ndarray:
        """Sum over chosen voxels of -ln of the probability of their state in each frame [nats], (f,).

        -ln p of a voxel that the frame occupies and -ln(1 - p) of another; 0 where p is 0 or 1. The mean over the
        frames with the weights that the prior was learned with is the sum of H(p) over them, except for rounding:
        entropy is expected surprisal.

        Parameters
        ----------
        chosen : ndarray of bool, (voxels,)
            Which voxels are summed over.
        """
        free, change = self._surprisals
        return free[chosen].sum() + self.sums(np.where(chosen, change, 0.0))

    @cached_property
    def _surprisals(self):
        """Surprisal of each voxel when it is free, (voxels,), and what is added to that when it is occupied."""
        certain = (self.prior <= 0.0) | (self.prior >= 1.0)
        p = np.where(certain, 0.5, self.prior)
        return np.where(certain, 0.0, -np.log1p(-p)), np.where(certain, 0.0, np.log1p(-p) - np.log(p))


# --- S-MIG and M-SOG of single vehicles: where in its box a vehicle usually returns, and how much that tells -
# Both are published for a region, not for a vehicle. Here the region is the vehicle's box, and the prior of a voxel
# the share of training vehicles with a return in it; only what a return lies in counts as covered. The form is ours.
# Density and NUC of the ground (`scene_metrics`) have no form for a vehicle and get none.

VEHICLE_VOXEL_M = 0.2


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
    def learn(cls, returns: VehicleReturns, voxel_m: float = VEHICLE_VOXEL_M) -> VehiclePrior:
        """The prior of some vehicles; to be fair learned from other vehicles than those that it scores.

        Raises
        ------
        InputError
            Without vehicles, or for boxes of more than `MOST_VOXELS`.
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

        Higher claimed better, and highest, 0, for a vehicle without returns: see `scene_metrics.s_mig`. On real
        cars it is lowest where a detector does best (Spearman -0.85 with confidence times IoU, and so 0.85 for
        `covered_entropy`; 203 cars of KITTI, SECOND detector, prior from the other half of the frames).
        """
        return 0.0 - self._sums(returns)[0]

    def m_sog(self, returns: VehicleReturns) -> np.ndarray:
        """Minus the mean of H(p) over the voxels that a vehicle returns from [nats], (n,); 0 without returns.

        Higher claimed better, and highest for a vehicle without returns: see `scene_metrics.m_sog`. On the same
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


# --- Which occupied voxels beams can be expected to reach, with traffic in the way only as a probability --


def reach_probability(
    grid: VoxelGrid,
    prior: np.ndarray,
    origin_m: np.ndarray,
    directions: np.ndarray,
    max_range_m: float,
    min_range_m: float = 0.0,
) -> np.ndarray:
    """Probability that a beam gets to each voxel, (voxels,); 0 where none crosses it.

    Along a beam through voxels with the probabilities p_1, p_2, ... of being occupied, independent of each other, it
    gets to the k-th with the probability prod_{j<k} (1 - p_j). Of several beams that cross a voxel **the best counts**:
    beams of one sensor to one voxel pass through much the same voxels before it, and so are free or hidden together. To
    take them for independent would make any voxel certain that enough beams cross, even behind other things.

    Neighbouring voxels are occupied together, by one vehicle. That they count as independent makes a beam lose its
    strength within the first vehicle's depth as it would over several: the far side of dense traffic comes out darker
    than it is.

    Parameters
    ----------
    grid : VoxelGrid
        The region; nothing outside it is in the way.
    prior : ndarray, (voxels,)
        Probability that a voxel is occupied.
    origin_m : ndarray, (3,)
        Where the beams start [m].
    directions : ndarray, (n, 3)
        Unit vectors.
    max_range_m, min_range_m : float
        How far they are followed, and from where on [m].
    """
    free = 1.0 - grid.with_rim(prior)
    best = np.zeros(len(free))
    strength = np.ones(len(directions))  # of each beam: the product so far
    for _, voxel in traverse(grid, origin_m, directions, max_range_m, min_range_m):
        still = strength[: len(voxel)]
        np.maximum.at(best, voxel, still)
        still *= free[voxel]
    return grid.without_rim(best)


def box_visibility(
    grid: VoxelGrid, reached: np.ndarray, centre_m: np.ndarray, size_m: np.ndarray, heading_rad: np.ndarray
) -> np.ndarray:
    """Mean probability that a beam gets to a voxel of a box, (n,); 0 for a box with no voxel in the grid.

    The form of expected visibility for a single vehicle, ours: what stands before it is traffic as the prior knows it,
    not the vehicles of the moment, and its own voxels weaken the beams to those behind them. It depends on where a box
    is, not on its returns.

    Parameters
    ----------
    grid : VoxelGrid
        A region about the LiDAR, in a frame that moves with it where it is driven about.
    reached : ndarray, (voxels,)
        `reach_probability`, under a prior that other frames taught.
    centre_m, size_m, heading_rad : ndarray, (n, 3), (n, 3), (n,)
        The boxes, in the grid's frame: see `VoxelGrid.in_boxes`.
    """
    boxes = zip(centre_m, size_m, heading_rad, strict=True)
    voxels = [grid.in_boxes(*(part[None] for part in box)) for box in boxes]
    return np.array([reached[inside].mean() if len(inside) else 0.0 for inside in voxels])
