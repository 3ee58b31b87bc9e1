"""How often a voxel of the road is inside a vehicle, learned from frames, and what one frame tells beyond that."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ..errors import InputError


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
        Without a frame that counts, with a voxel that the grid does not have or that a frame names twice.
    """

    def __init__(self, occupied: Sequence[np.ndarray], voxels: int, weights: np.ndarray | None = None) -> None:
        weights = np.ones(len(occupied)) if weights is None else np.asarray(weights, dtype=float)
        if weights.shape != (len(occupied),) or not (weights >= 0.0).all() or not 0.0 < weights.sum() < np.inf:
            raise InputError(
                f"{len(occupied)} frames with weights of shape {weights.shape}; "
                "allowed: one finite weight for each, 0 or more, not all of them 0"
            )
        self._frame = np.repeat(np.arange(len(occupied)), [len(one) for one in occupied])
        self._voxel = np.concatenate([np.asarray(one, dtype=np.int64) for one in occupied])
        if len(self._voxel) and (self._voxel.min() < 0 or self._voxel.max() >= voxels):
            raise InputError(
                f"voxels {self._voxel.min()} to {self._voxel.max()} are occupied; allowed: 0 to {voxels - 1}"
            )
        if len(np.unique(self._frame * voxels + self._voxel)) < len(self._voxel):
            raise InputError("a frame names a voxel twice; allowed: each once")
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
        frames with the weights that the prior was learned with is `occupancy_entropy.covered_entropy`, but for
        rounding: entropy is expected surprisal.

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
