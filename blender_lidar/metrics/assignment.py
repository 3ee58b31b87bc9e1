"""Point-in-box assignment: which box each point of a cloud belongs to, where the cloud does not say."""

from __future__ import annotations

import numpy as np

from .vgop import to_vehicle_frame

NO_BOX = -1
SLACK_M = 0.002
"""Clouds of boxes lie on their very faces, where rounding decides; and boxes are given to the millimetre."""


def points_in_boxes(
    points: np.ndarray,
    centre: np.ndarray,
    size: np.ndarray,
    heading: np.ndarray,
    ground_clearance_m: float = 0.0,
    slack_m: float = SLACK_M,
) -> np.ndarray:
    """Row of the box that each point lies in, or `NO_BOX`.

    Parameters
    ----------
    points : ndarray, (k, 3)
        Points in the frame of the boxes [m].
    centre, size : ndarray, (n, 3)
        Box centres; length, width and height [m].
    heading : ndarray, (n,)
        Counter-clockwise from +x [rad].
    ground_clearance_m : float
        Points less than this above a box's floor are left out: they are returns from the ground [m]. 0 leaves none out.
    slack_m : float
        Points up to this far outside a face belong to the box as well [m].

    Returns
    -------
    ndarray of int64, (k,)
        Where boxes overlap, the one whose centre is nearest.
    """
    row = np.full(len(points), NO_BOX, dtype=np.int64)
    nearest = np.full(len(points), np.inf)
    half = 0.5 * size + slack_m
    reach = np.linalg.norm(half[:, :2], axis=1)
    along = np.ascontiguousarray(points[:, 0])
    for box in range(len(centre)):
        near = np.flatnonzero(np.abs(along - centre[box, 0]) <= reach[box])
        local = to_vehicle_frame(points[near], centre[box], float(heading[box]))
        inside = (np.abs(local) <= half[box]).all(axis=1)
        if ground_clearance_m > 0.0:
            inside &= local[:, 2] >= ground_clearance_m - 0.5 * size[box, 2]
        distance = np.einsum("ij,ij->i", local, local)
        taken = inside & (distance < nearest[near])
        row[near[taken]], nearest[near[taken]] = box, distance[taken]
    return row
