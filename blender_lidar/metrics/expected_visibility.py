"""Which occupied voxels beams can be expected to reach, with traffic in the way only as a probability."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .voxel_grid import VoxelGrid, check_boxes
from .voxel_walk import VoxelWalk


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
    take them for independent would make any voxel certain that enough beams cross, whatever stands before it.

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

    Raises
    ------
    InputError
        When shapes disagree or a number is out of its bounds.
    """
    prior = np.asarray(prior, dtype=float)
    if prior.shape != (len(grid),):
        raise InputError(f"prior has shape {prior.shape}; allowed: ({len(grid)},), one number for each voxel")
    if not ((prior >= 0.0) & (prior <= 1.0)).all():
        raise InputError("prior holds a number outside 0 to 1; allowed: probabilities")
    walk = VoxelWalk(grid, origin_m, directions, max_range_m, min_range_m)
    free = 1.0 - walk.with_rim(prior)
    best = walk.empty(float)
    strength = np.ones(len(walk.beam))  # of each beam: the product so far
    for voxel in walk.steps():
        still = strength[: len(voxel)]
        _raise_to(best, voxel, still)
        still *= free[voxel]
    return walk.without_rim(best)


def expected_visibility(prior: np.ndarray, reached: np.ndarray) -> float:
    """Number of occupied voxels that a beam can be expected to meet: sum of p_k prod_{j<k} (1 - p_j); higher is better.

    What the group of Ma, Zheng and Easa places roadside LiDARs by, as read in their code (github.com/yangma93/
    Roadside-LiDAR-placement-), for one sensor: its cap at p_k holds because the best beam counts. They go on to compare
    histograms of the true and the seen grid, which is left out. Occlusion by traffic enters as an expectation, from one
    prior and without casting a beam at a vehicle. How densely beams sample a voxel does not enter.

    Parameters
    ----------
    prior : ndarray, (voxels,)
        Probability that a voxel is occupied.
    reached : ndarray, (voxels,)
        `reach_probability` under the same prior.
    """
    return float(np.dot(prior, reached))


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

    Raises
    ------
    InputError
        When shapes disagree, a number is not finite or a side is not positive.
    """
    centre, size, heading = check_boxes(centre_m, size_m, heading_rad)
    reached = np.asarray(reached, dtype=float)
    if reached.shape != (len(grid),):
        raise InputError(f"reached has shape {reached.shape}; allowed: ({len(grid)},), one number for each voxel")
    voxels = [grid.in_boxes(*(part[None] for part in box)) for box in zip(centre, size, heading, strict=True)]
    return np.array([reached[inside].mean() if len(inside) else 0.0 for inside in voxels])


def _raise_to(best: np.ndarray, place: np.ndarray, value: np.ndarray) -> None:
    """The greatest value for each place into `best`: `numpy.maximum.at`, which was slow before NumPy 1.25."""
    greater = value > best[place]
    while greater.any():
        place, value = place[greater], value[greater]
        best[place] = value  # of several for one place the last stays; the others are looked at again
        greater = value > best[place]
