"""How uncertain the voxels are that beams cross: S-MIG and M-SOG, which learn from traffic where vehicles drive.

Both ask no more of a beam than that it crosses a voxel: it goes on through whatever stands there. Neither sees
occlusion, nor how densely a voxel is sampled, and both end with the region and the range that they are given.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError


def bernoulli_entropy(p: np.ndarray) -> np.ndarray:
    """H(p) = -p ln p - (1 - p) ln(1 - p) of probabilities, elementwise [nats]; 0 where p is 0 or 1.

    Raises
    ------
    InputError
        When a probability is not in [0, 1].
    """
    p = np.asarray(p, dtype=float)
    if not ((p >= 0.0) & (p <= 1.0)).all():
        raise InputError("a probability is outside 0 to 1 or not a number; allowed: 0 to 1")
    certain = (p == 0.0) | (p == 1.0)
    inner = np.where(certain, 0.5, p)
    return np.where(certain, 0.0, -inner * np.log(inner) - (1.0 - inner) * np.log1p(-inner))


def covered_entropy(prior: np.ndarray, covered: np.ndarray) -> float:
    """Sum of H(p) over the voxels that a sensor's beams cross [nats]; higher is better.

    The entropy H(POG | L) of Hu, Liu, Chitlangia, Agnihotri and Zhao (CVPR 2022, arXiv:2105.00373), whose S-MIG is
    minus it, with the sign that rewards a sensor for covering what is uncertain: where vehicles are sometimes but not
    always. No published metric has this sign with this formula; see `s_mig` for why it is needed.

    Parameters
    ----------
    prior : ndarray, (voxels,)
        Probability that a voxel is occupied: `occupancy_prior.OccupiedFrames.prior`.
    covered : ndarray of bool, (voxels,)
        Whether a beam crosses it: `voxel_walk.covered_voxels`.

    Raises
    ------
    InputError
        When shapes disagree or a probability is not in [0, 1].
    """
    return float(bernoulli_entropy(_chosen(prior, covered)).sum())


def s_mig(prior: np.ndarray, covered: np.ndarray) -> float:
    """S-MIG as published: minus the sum of H(p) over covered voxels [nats], higher claimed better.

    Hu, Liu, Chitlangia, Agnihotri and Zhao, "Investigating the Impact of Multi-LiDAR Placement on Object Detection for
    Autonomous Driving", CVPR 2022, arXiv:2105.00373. Their information gain IG = H(POG) - H(POG | L) differs from it by
    a constant. Written from the definition: their released code counts a voxel once for every beam.

    The sign makes it degenerate: a sensor whose beams miss the road altogether gets 0, the greatest value there is, and
    every voxel that a beam adds lowers it. It was meant for set-ups with as many beams in the same region, and is of
    use between such alone; a search that may turn beams away from the road will do so. `covered_entropy` has the other
    sign.

    Parameters and errors as for `covered_entropy`.
    """
    return -covered_entropy(prior, covered) + 0.0  # no minus zero


def m_sog(prior: np.ndarray, covered: np.ndarray) -> float:
    """M-SOG: minus the mean of H(p) over covered voxels [nats], higher claimed better; 0 where none is covered.

    Li, Kong, Hu, Xu and Huang, "Is Your LiDAR Placement Optimized for 3D Scene Understanding?" (Place3D), NeurIPS 2024,
    arXiv:2403.17009, section 3, as for car detection: two classes, vehicle and anything else. Theirs learns classes
    from dense merged clouds and follows beams as `voxel_walk` does; code for the metric was not released.

    As a mean of -H it rises with every *certain* voxel that is covered, such as the air above the roofs, and is
    greatest for a sensor that covers nothing uncertain, or nothing at all: degenerate as `s_mig` is. Between set-ups
    with as many covered voxels both say the same.

    Parameters and errors as for `covered_entropy`.
    """
    chosen = _chosen(prior, covered)
    return -float(bernoulli_entropy(chosen).mean()) + 0.0 if len(chosen) else 0.0


def _chosen(prior, covered):
    prior, covered = np.asarray(prior, dtype=float), np.asarray(covered)
    if prior.ndim != 1 or covered.shape != prior.shape or covered.dtype != bool:
        raise InputError(
            f"prior and covered have shapes {prior.shape} and {covered.shape}, covered holds {covered.dtype}; "
            "allowed: one probability and one bool for each voxel"
        )
    return prior[covered]
