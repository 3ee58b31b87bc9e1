"""The same as `culling.reachable_beams`, compiled: piece by piece, without arrays in between."""

from __future__ import annotations

import math

import numpy as np

from ..compiled import compiled, inlined

_TURN = 2.0 * math.pi


@compiled
def beams_within(
    corners, middle, radius, origin, rotation, max_range, sine, azimuth0, step, columns, margin, least_cosine
):
    """Flat indices of the beams that may meet a piece, rising; a row of the mask for each ring.

    `corners` (3, 8, p), `middle` (3, p) and `radius` (p,) are those of `Pieces`, `sine` (rings,) is the elevations'.
    """
    mask = np.zeros((len(sine), columns), dtype=np.bool_)
    first_azimuth, last_azimuth = azimuth0.min(), azimuth0.max()
    for piece in range(len(radius)):
        x, y, z = middle[0, piece] - origin[0], middle[1, piece] - origin[1], middle[2, piece] - origin[2]
        if not math.sqrt(x * x + y * y + z * z) - radius[piece] <= max_range:
            continue
        low, high, first, last = _bounds(corners, piece, origin, rotation, least_cosine)
        ring_from, ring_to = np.searchsorted(sine, low - margin), np.searchsorted(sine, high + margin, side="right")
        slot_from = math.ceil((first - margin - last_azimuth) / step)
        slot_to = math.floor((last + margin - first_azimuth) / step) + 1
        if slot_to - slot_from >= columns:
            slot_from, slot_to = 0, columns
        turns = slot_from // columns * columns
        slot_from, slot_to = slot_from - turns, slot_to - turns
        for ring in range(ring_from, ring_to):
            mask[ring, slot_from : min(slot_to, columns)] = True
            if slot_to > columns:  # across azimuth zero
                mask[ring, : slot_to - columns] = True
    return np.flatnonzero(mask)


@inlined
def _bounds(corners, piece, origin, rotation, least_cosine):
    """As `culling._angular_bounds`, for one piece."""
    place = np.empty((8, 3))
    across = ahead = above = 0.0
    for k in range(8):
        x, y, z = corners[0, k, piece] - origin[0], corners[1, k, piece] - origin[1], corners[2, k, piece] - origin[2]
        for axis in range(3):
            place[k, axis] = rotation[axis, 0] * x + rotation[axis, 1] * y + rotation[axis, 2] * z
        across, ahead, above = across + place[k, 0], ahead + place[k, 1], above + place[k, 2]
    length = math.sqrt(across * across + ahead * ahead + above * above)
    low, high, cosine, first, last = np.inf, -np.inf, np.inf, np.inf, -np.inf
    for k in range(8):
        x, y, z = place[k, 0], place[k, 1], place[k, 2]
        distance = math.sqrt(x * x + y * y + z * z)
        if distance == 0.0 or length == 0.0:  # at a corner, or in the very middle
            return -1.0, 1.0, 0.0, _TURN
        low, high = min(low, z / distance), max(high, z / distance)
        cosine = min(cosine, (x * across + y * ahead + z * above) / distance / length)
        off_centre = math.atan2(x * ahead - y * across, x * across + y * ahead)
        first, last = min(first, off_centre), max(last, off_centre)
    if not cosine > least_cosine:  # about the sensor
        return -1.0, 1.0, 0.0, _TURN
    low, high = low / cosine if low < 0.0 else low, high / cosine if high > 0.0 else high
    if not last - first < math.pi or (across == 0.0 and ahead == 0.0):  # about its axis
        return low, high, 0.0, _TURN
    centre = math.atan2(across, ahead)
    return low, high, first + centre, last + centre


@compiled
def directions_of(components, beams, rotation):
    """Directions (3, k) of beams in the road frame, added up as `Pose.to_world` does."""
    found = np.empty((3, len(beams)))
    for k in range(len(beams)):
        x, y, z = components[0, beams[k]], components[1, beams[k]], components[2, beams[k]]
        for axis in range(3):
            found[axis, k] = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
    return found


@compiled
def single_directions_of(components, beams, rotation):
    """The same, (k, 3), rounded to float32."""
    found = np.empty((len(beams), 3), dtype=np.float32)
    for k in range(len(beams)):
        x, y, z = components[0, beams[k]], components[1, beams[k]], components[2, beams[k]]
        for axis in range(3):
            found[k, axis] = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * z
    return found
