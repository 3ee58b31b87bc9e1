"""Vehicles that stand in one another: a defect of recordings that is reported, not repaired."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .vehicles import Recording, Vehicles

_FRAMES_LOOKED_AT = 60


def overlapping_pairs(vehicles: Vehicles) -> np.ndarray:
    """Pairs of vehicles whose oriented boxes overlap, seen from above.

    Parameters
    ----------
    vehicles : Vehicles
        One frame.

    Returns
    -------
    ndarray, (p, 2) int64
        Rows of `vehicles`, the smaller first. By the separating-axis theorem: two rectangles are apart if and only if
        they are apart along one of their four sides.
    """
    centre = vehicles.centre_m[:, :2]
    half = vehicles.size_m[:, :2] / 2
    reach = np.hypot(half[:, 0], half[:, 1])
    first, second = np.triu_indices(len(vehicles), k=1)
    near = np.abs(centre[second] - centre[first]).max(axis=1) < reach[first] + reach[second]
    first, second = first[near], second[near]
    offset = centre[second] - centre[first]
    forward = np.stack([np.cos(vehicles.heading_rad), np.sin(vehicles.heading_rad)], axis=1)
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=1)
    together = np.ones(len(first), dtype=bool)
    for axis in (forward[first], left[first], forward[second], left[second]):
        extent = np.zeros(len(first))
        for box in (first, second):
            extent += half[box, 0] * np.abs((forward[box] * axis).sum(axis=1))
            extent += half[box, 1] * np.abs((left[box] * axis).sum(axis=1))
        together &= np.abs((offset * axis).sum(axis=1)) < extent
    return np.stack([first[together], second[together]], axis=1)


def with_overlaps_reported(recording: Recording) -> Recording:
    """The same recording, its report telling the overlaps of up to 60 frames spread evenly over it."""
    total = len(recording.frames)
    looked_at = recording.frames[np.unique(np.linspace(0, total - 1, min(total, _FRAMES_LOOKED_AT)).astype(int))]
    pairs = sum(len(overlapping_pairs(recording.vehicles(frame))) for frame in looked_at)
    return replace(recording, report=replace(recording.report, overlaps=pairs, overlap_frames=len(looked_at)))
