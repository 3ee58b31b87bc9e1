"""Barriers along the road, extruded along x from a cross-section that is the same to the left and to the right."""

from __future__ import annotations

import numpy as np

from ..errors import unknown_name
from .scenery import Scenery, box, structure

# Cross-sections from the ground up: height and half-width [m].
# Concrete: the New Jersey profile of FHWA's Roadside Design Guide, 32 in high, 24 in wide at its foot, 6 in at its top.
# Guard rail: the W-beam of the Midwest Guardrail System, 12.25 in high and 3.25 in deep with its top at 31 in.
_CONCRETE = ((0.0, 0.305), (0.075, 0.305), (0.330, 0.127), (0.813, 0.076))
_RAIL = ((0.476, 0.0415), (0.787, 0.0415))
_POST_SPACING_M = 1.905  # 6 ft 3 in
_POST_SIZE_M = (0.10, 0.15, 0.70)  # W6 x 9

BARRIERS = ("concrete", "guard_rail")


HALF_WIDTH_M, HEIGHT_M = 0.305, 0.813  # of the widest and the highest


def barrier(kind: str, y_m: float, x_m: tuple[float, float]) -> Scenery:
    """A barrier that stands along the line y = `y_m` from one x to another [m, road frame].

    Parameters
    ----------
    kind : {"concrete", "guard_rail"}
        A median barrier of New Jersey's profile, or a W-beam on posts.
    y_m : float
        Its middle line.
    x_m : (float, float)
        Where it begins and ends, the lower first.
    """
    if kind not in BARRIERS:
        raise unknown_name(kind, BARRIERS, "barrier")
    name = f"{kind} at y {y_m:g} m"
    if kind == "concrete":
        return structure(name, _extruded(_CONCRETE, y_m, x_m))
    first, last = x_m
    posts = np.arange(first, last, _POST_SPACING_M)
    standing = [box("post", (x, y_m, _POST_SIZE_M[2] / 2), _POST_SIZE_M).corners for x in posts + 0.5 * _POST_SIZE_M[0]]
    return structure(name, np.concatenate([_extruded(_RAIL, y_m, x_m), *standing]))


def _extruded(section, y_m, x_m) -> np.ndarray:
    """A closed mesh, (m, 3, 3): the cross-section's outline joined from one end to the other, and both ends closed."""
    height, half = np.array(section).T
    outline = np.concatenate([np.stack([half, height], 1), np.stack([-half, height], 1)[::-1]])  # up on the left
    points = np.array([[(x, y_m + across, z) for across, z in outline] for x in x_m])
    count, levels = len(outline), len(section)
    faces = []
    for here in range(count):
        there = (here + 1) % count
        faces += [(here, there, count + there), (here, count + there, count + here)]
    for low in range(levels - 1):  # strips between one level and the next
        left, right = (low, low + 1), (count - 1 - low, count - 2 - low)
        strip = [(left[0], right[0], right[1]), (left[0], right[1], left[1])]
        faces += strip + [tuple(count + corner for corner in face[::-1]) for face in strip]
    return points.reshape(-1, 3)[np.array(faces)]
