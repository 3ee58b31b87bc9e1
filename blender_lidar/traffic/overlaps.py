"""Vehicles that stand in one another: a defect of recordings that is reported, not repaired."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..errors import InputError
from .vehicles import Recording, Vehicles

_FRAMES_LOOKED_AT = 60
_MOST_NEAR_PAIRS = 5_000_000  # in one frame; ten thousand vehicles spread over a city have a tenth of that
_AT_ONCE = 200_000


def overlapping_pairs(vehicles: Vehicles) -> np.ndarray:
    """Pairs of vehicles whose oriented boxes overlap, seen from above.

    Parameters
    ----------
    vehicles : Vehicles
        One frame.

    Returns
    -------
    ndarray, (p, 2) int64
        Rows of `vehicles`, the smaller first.

    Raises
    ------
    InputError
        If millions of pairs are close enough to overlap.
    """
    centre = vehicles.centre_m[:, :2]
    half = vehicles.size_m[:, :2] / 2
    reach = np.hypot(half[:, 0], half[:, 1])
    heading = vehicles.heading_rad
    found = [np.zeros((0, 2), dtype=np.int64)]
    for first, second in _near_pairs(centre, reach, vehicles.frame):
        near = np.abs(centre[second] - centre[first]).max(axis=1) < reach[first] + reach[second]
        first, second = first[near], second[near]
        together = rectangles_overlap(
            centre[first], half[first], heading[first], centre[second], half[second], heading[second]
        )
        found.append(np.sort(np.stack([first[together], second[together]], axis=1), axis=1))
    pairs = np.concatenate(found)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _near_pairs(centre: np.ndarray, reach: np.ndarray, frame: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Pairs of circles, (n, 2) and (n,), that overlap along the axis on which the fewest do; a part of them at a time.

    Swept along that axis, each is paired with those that begin before it ends.
    """
    order, following = min((_swept(along, reach) for along in centre.T), key=lambda sweep: int(sweep[1].sum()))
    total = int(following.sum())
    if total > _MOST_NEAR_PAIRS:
        raise InputError(f"frame {frame}: {len(order):,} vehicles so close to one another are no traffic")
    ends = np.cumsum(following)
    for start in range(0, total, _AT_ONCE):
        number = np.arange(start, min(start + _AT_ONCE, total))
        row = np.searchsorted(ends, number, side="right")
        yield order[row], order[row + 1 + number - (ends[row] - following[row])]


def _swept(along: np.ndarray, reach: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Order by where circles begin along an axis, and how many begin within each after it."""
    order = np.argsort(along - reach, kind="stable")
    begin = (along - reach)[order]
    within = np.searchsorted(begin, (along + reach)[order], side="left") - np.arange(1, len(order) + 1)
    return order, np.maximum(within, 0)


def rectangles_overlap(
    centre: np.ndarray,
    half: np.ndarray,
    heading: np.ndarray,
    other_centre: np.ndarray,
    other_half: np.ndarray,
    other_heading: np.ndarray | float,
) -> np.ndarray:
    """Which rectangles overlap another each, row by row, (n,) bool; those that only touch do not.

    By the separating-axis theorem: two rectangles are apart if and only if they are apart along one of their sides.

    Parameters
    ----------
    centre, half : ndarray, (n, 2)
        Centres, and half the length and width [m].
    heading : ndarray, (n,)
        Direction of the length, counter-clockwise from +x [rad].
    other_centre, other_half, other_heading
        The same of the others; also those of one rectangle for all, (2,), (2,) and a number.
    """
    forward, other_forward = _directions(heading), _directions(other_heading)
    left, other_left = (np.stack([-side[..., 1], side[..., 0]], axis=-1) for side in (forward, other_forward))
    offset = other_centre - centre
    together = np.ones(len(centre), dtype=bool)
    for axis in (forward, left, other_forward, other_left):
        extent = half[:, 0] * _along(forward, axis) + half[:, 1] * _along(left, axis)
        extent += other_half[..., 0] * _along(other_forward, axis) + other_half[..., 1] * _along(other_left, axis)
        together &= _along(offset, axis) < extent
    return together


def _directions(heading):
    return np.stack([np.cos(heading), np.sin(heading)], axis=-1)


def _along(vectors, axis):
    return np.abs((vectors * axis).sum(axis=-1))


def with_overlaps_reported(recording: Recording) -> Recording:
    """The same recording, its report telling the overlaps of up to 60 frames spread evenly over it."""
    total = len(recording.frames)
    looked_at = recording.frames[np.unique(np.linspace(0, total - 1, min(total, _FRAMES_LOOKED_AT)).astype(int))]
    try:
        pairs = sum(len(overlapping_pairs(recording.vehicles(frame))) for frame in looked_at)
    except InputError as error:
        raise InputError(f"{recording.source}: {error}") from error
    return replace(recording, report=replace(recording.report, overlaps=pairs, overlap_frames=len(looked_at)))
