"""Vehicle shapes: closed triangle meshes that fill their length x width x height box exactly and never leave it.

A shape lives in the unit box, x forward, y left, z up, each from -0.5 to 0.5, and is scaled to a vehicle's own box.
`box` is that box; `body` is lofted: a few cross-sections along the length, each a hexagon (sill, belt line and roof
edge on both sides), joined by quads and closed by two caps; `detailed` is in `detailed_shapes`. All are tubes
(`meshes.tube`), and so closed, and their faces point outwards. The bodies of `traffic.fleet` differ at `body` alone.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from ..errors import unknown_name
from ..names import DETAILS
from ..traffic.fleet import KIND_OF_BODY
from .detailed_shapes import detailed_shape
from .meshes import Shape, block, both_sides, drum, joined, tube

SHAPES = ("car", "van", "truck", "long_truck", "bus", "motorcycle", "bicycle", "pedestrian")


@cache
def shape(name: str, detail: str = "body") -> Shape:
    """The shape `name` of `SHAPES`, or of a body of `traffic.fleet`, at a level of detail of `DETAILS`.

    Returns
    -------
    Shape
        Shared and read-only: scale it, do not change it.
    """
    if detail not in DETAILS:
        raise unknown_name(detail, DETAILS, "level of detail")
    if name not in KIND_OF_BODY:
        raise unknown_name(name, KIND_OF_BODY, "vehicle shape")
    if detail == "box":
        made = block((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))
    elif detail == "body":
        made = _loft(_BODIES[name])
    else:
        made = detailed_shape(KIND_OF_BODY[name])
    for array in (made.vertices, made.faces, made.surface):
        array.setflags(write=False)
    return made


# Cross-sections from tail to nose. Each: position along the length (0 tail, 1 nose), half-width at the sill, at the
# belt line and at the roof edge (0.5 = half the box), height of the belt line and of the top (0 ground, 1 roof), and
# whether the upper band that leads to the next cross-section is glass on its sides and on its top. Proportions by eye
# from common vehicles, those of the car fitted to ranges that a real LiDAR measured (docs/evidence/reality.md); sills
# reach the ground, so that the box is filled to its floor.
_BODIES = {
    "car": (
        (0.00, 0.40, 0.42, 0.38, 0.43, 0.60, False, False),
        (0.07, 0.46, 0.50, 0.40, 0.56, 0.72, True, True),
        (0.19, 0.46, 0.50, 0.33, 0.61, 0.97, False, False),
        (0.23, 0.47, 0.50, 0.33, 0.61, 1.00, True, False),
        (0.47, 0.49, 0.50, 0.34, 0.61, 1.00, True, True),
        (0.73, 0.49, 0.50, 0.42, 0.58, 0.68, False, False),
        (1.00, 0.41, 0.43, 0.33, 0.34, 0.48, False, False),
    ),
    "van": (
        (0.00, 0.45, 0.48, 0.40, 0.48, 0.90, True, True),
        (0.06, 0.48, 0.50, 0.41, 0.52, 0.99, True, False),
        (0.58, 0.48, 0.50, 0.41, 0.52, 1.00, True, True),
        (0.76, 0.48, 0.50, 0.44, 0.48, 0.60, False, False),
        (1.00, 0.44, 0.47, 0.42, 0.38, 0.50, False, False),
    ),
    "truck": (
        (0.00, 0.48, 0.50, 0.50, 0.50, 1.00, False, False),
        (0.70, 0.48, 0.50, 0.50, 0.50, 1.00, False, False),
        (0.71, 0.42, 0.45, 0.40, 0.42, 0.74, True, False),
        (0.84, 0.44, 0.46, 0.40, 0.46, 0.74, True, True),
        (0.91, 0.45, 0.46, 0.42, 0.42, 0.50, False, False),
        (1.00, 0.44, 0.46, 0.40, 0.30, 0.42, False, False),
    ),
    "long_truck": (
        (0.00, 0.48, 0.50, 0.50, 0.50, 1.00, False, False),
        (0.80, 0.48, 0.50, 0.50, 0.50, 1.00, False, False),
        (0.81, 0.40, 0.40, 0.30, 0.22, 0.28, False, False),
        (0.86, 0.40, 0.40, 0.30, 0.22, 0.28, False, False),
        (0.87, 0.46, 0.48, 0.45, 0.45, 0.94, True, False),
        (0.96, 0.46, 0.48, 0.45, 0.45, 0.90, True, True),
        (1.00, 0.45, 0.47, 0.45, 0.40, 0.55, False, False),
    ),
    "bus": (
        (0.00, 0.48, 0.49, 0.46, 0.40, 0.97, True, False),
        (0.03, 0.49, 0.50, 0.48, 0.40, 1.00, True, False),
        (0.94, 0.49, 0.50, 0.48, 0.40, 1.00, True, True),
        (1.00, 0.47, 0.49, 0.45, 0.36, 0.88, False, False),
    ),
    "motorcycle": (
        (0.00, 0.08, 0.12, 0.08, 0.25, 0.40, False, False),
        (0.25, 0.15, 0.30, 0.20, 0.40, 0.62, False, False),
        (0.38, 0.20, 0.38, 0.22, 0.62, 1.00, False, False),
        (0.55, 0.18, 0.50, 0.20, 0.60, 0.98, False, False),
        (0.70, 0.14, 0.45, 0.16, 0.58, 0.68, False, False),
        (1.00, 0.06, 0.10, 0.06, 0.22, 0.40, False, False),
    ),
    "bicycle": (
        (0.00, 0.04, 0.08, 0.04, 0.20, 0.40, False, False),
        (0.30, 0.10, 0.22, 0.14, 0.42, 0.60, False, False),
        (0.40, 0.18, 0.38, 0.20, 0.60, 0.84, False, False),
        (0.54, 0.18, 0.42, 0.16, 0.72, 1.00, False, False),
        (0.62, 0.16, 0.42, 0.16, 0.70, 0.96, False, False),
        (0.70, 0.08, 0.50, 0.20, 0.58, 0.64, False, False),
        (0.78, 0.05, 0.12, 0.06, 0.36, 0.54, False, False),
        (1.00, 0.04, 0.08, 0.04, 0.20, 0.40, False, False),
    ),
    "pedestrian": (
        (0.00, 0.18, 0.28, 0.16, 0.34, 0.60, False, False),
        (0.30, 0.26, 0.46, 0.20, 0.70, 0.88, False, False),
        (0.42, 0.28, 0.50, 0.16, 0.78, 1.00, False, False),
        (0.60, 0.28, 0.50, 0.16, 0.78, 1.00, False, False),
        (0.70, 0.26, 0.46, 0.20, 0.70, 0.88, False, False),
        (1.00, 0.18, 0.28, 0.16, 0.34, 0.60, False, False),
    ),
    "hatchback": (
        (0.00, 0.42, 0.46, 0.40, 0.45, 0.62, False, False),
        (0.05, 0.46, 0.50, 0.40, 0.58, 0.76, True, True),
        (0.16, 0.47, 0.50, 0.35, 0.60, 0.97, True, False),
        (0.45, 0.49, 0.50, 0.36, 0.60, 1.00, True, True),
        (0.74, 0.49, 0.50, 0.42, 0.58, 0.68, False, False),
        (1.00, 0.42, 0.44, 0.34, 0.36, 0.50, False, False),
    ),
    "suv": (
        (0.00, 0.45, 0.48, 0.40, 0.48, 0.70, False, False),
        (0.05, 0.47, 0.50, 0.41, 0.58, 0.84, True, True),
        (0.12, 0.47, 0.50, 0.37, 0.58, 0.97, True, False),
        (0.55, 0.48, 0.50, 0.38, 0.58, 1.00, True, True),
        (0.72, 0.48, 0.50, 0.44, 0.56, 0.64, False, False),
        (1.00, 0.44, 0.47, 0.40, 0.44, 0.54, False, False),
    ),
    "large_suv": (
        (0.00, 0.46, 0.49, 0.42, 0.50, 0.80, False, False),
        (0.04, 0.48, 0.50, 0.42, 0.56, 0.97, True, False),
        (0.55, 0.48, 0.50, 0.42, 0.56, 1.00, True, True),
        (0.69, 0.48, 0.50, 0.45, 0.56, 0.64, False, False),
        (1.00, 0.45, 0.48, 0.42, 0.46, 0.56, False, False),
    ),
    "pickup": (
        (0.00, 0.47, 0.49, 0.47, 0.45, 0.56, False, False),
        (0.38, 0.48, 0.50, 0.47, 0.50, 0.58, False, False),
        (0.40, 0.48, 0.50, 0.41, 0.56, 0.96, True, False),
        (0.60, 0.48, 0.50, 0.41, 0.56, 1.00, True, True),
        (0.72, 0.48, 0.50, 0.44, 0.56, 0.64, False, False),
        (1.00, 0.45, 0.48, 0.42, 0.44, 0.55, False, False),
    ),
    "panel_van": (
        (0.00, 0.47, 0.50, 0.46, 0.48, 0.97, False, False),
        (0.70, 0.48, 0.50, 0.46, 0.48, 1.00, True, False),
        (0.80, 0.48, 0.50, 0.42, 0.46, 0.94, True, True),
        (0.91, 0.47, 0.49, 0.42, 0.44, 0.50, False, False),
        (1.00, 0.44, 0.47, 0.42, 0.32, 0.42, False, False),
    ),
    "large_saloon": (
        (0.00, 0.42, 0.45, 0.40, 0.46, 0.62, False, False),
        (0.05, 0.46, 0.50, 0.41, 0.56, 0.72, False, False),
        (0.15, 0.46, 0.50, 0.41, 0.60, 0.74, True, True),
        (0.27, 0.46, 0.50, 0.34, 0.61, 0.97, True, False),
        (0.48, 0.49, 0.50, 0.34, 0.61, 1.00, True, True),
        (0.68, 0.49, 0.50, 0.42, 0.58, 0.68, False, False),
        (1.00, 0.41, 0.43, 0.33, 0.36, 0.48, False, False),
    ),
    "flatbed": (
        (0.00, 0.48, 0.50, 0.49, 0.30, 0.40, False, False),
        (0.70, 0.48, 0.50, 0.49, 0.30, 0.40, False, False),
        (0.71, 0.46, 0.48, 0.44, 0.50, 0.96, True, False),
        (0.90, 0.46, 0.48, 0.44, 0.48, 1.00, True, True),
        (0.97, 0.46, 0.48, 0.44, 0.44, 0.52, False, False),
        (1.00, 0.45, 0.46, 0.42, 0.36, 0.46, False, False),
    ),
    "tank_truck": (
        (0.00, 0.30, 0.46, 0.18, 0.62, 0.92, False, False),
        (0.03, 0.32, 0.50, 0.20, 0.62, 0.98, False, False),
        (0.72, 0.32, 0.50, 0.20, 0.62, 0.98, False, False),
        (0.74, 0.40, 0.46, 0.36, 0.42, 0.90, False, False),
        (0.76, 0.44, 0.48, 0.42, 0.50, 1.00, True, False),
        (0.90, 0.46, 0.48, 0.44, 0.48, 0.94, True, True),
        (1.00, 0.45, 0.47, 0.42, 0.36, 0.48, False, False),
    ),
    "flatbed_trailer": (
        (0.00, 0.48, 0.50, 0.48, 0.30, 0.36, False, False),
        (0.12, 0.48, 0.50, 0.48, 0.30, 0.36, False, False),
        (0.13, 0.48, 0.50, 0.46, 0.34, 0.62, False, False),
        (0.60, 0.48, 0.50, 0.46, 0.34, 0.62, False, False),
        (0.61, 0.48, 0.50, 0.48, 0.30, 0.36, False, False),
        (0.84, 0.48, 0.50, 0.48, 0.30, 0.36, False, False),
        (0.85, 0.46, 0.48, 0.45, 0.45, 0.97, True, False),
        (0.96, 0.46, 0.48, 0.45, 0.45, 1.00, True, True),
        (1.00, 0.45, 0.47, 0.45, 0.40, 0.55, False, False),
    ),
    "tanker_trailer": (
        (0.00, 0.28, 0.46, 0.16, 0.60, 0.90, False, False),
        (0.02, 0.30, 0.50, 0.20, 0.60, 0.97, False, False),
        (0.79, 0.30, 0.50, 0.20, 0.60, 0.97, False, False),
        (0.81, 0.40, 0.40, 0.30, 0.22, 0.28, False, False),
        (0.86, 0.40, 0.40, 0.30, 0.22, 0.28, False, False),
        (0.87, 0.46, 0.48, 0.45, 0.45, 0.96, True, False),
        (0.95, 0.46, 0.48, 0.45, 0.45, 1.00, True, True),
        (1.00, 0.45, 0.47, 0.45, 0.40, 0.55, False, False),
    ),
    "coach": (
        (0.00, 0.47, 0.49, 0.46, 0.46, 0.96, True, False),
        (0.02, 0.49, 0.50, 0.47, 0.46, 1.00, True, False),
        (0.95, 0.49, 0.50, 0.47, 0.46, 0.98, True, True),
        (1.00, 0.46, 0.49, 0.44, 0.40, 0.72, False, False),
    ),
}


# Of each kind of lofted vehicle its usual size, and of its wheels radius and places along it, 0 tail and 1 nose [m].
_WHEELS = {
    "car": ((4.5, 1.8, 1.5), 0.32, (0.2, 0.8)),
    "van": ((5.1, 2.0, 1.9), 0.34, (0.2, 0.8)),
    "truck": ((8.0, 2.5, 3.0), 0.45, (0.22, 0.87)),
    "long_truck": ((16.0, 2.6, 3.8), 0.5, (0.11, 0.19, 0.27, 0.76, 0.92)),
    "bus": ((12.0, 2.5, 3.2), 0.48, (0.28, 0.77)),
}
_PROUD_M, _HUB, _DEEP_M = 0.005, 0.55, 0.3


def wheels(name: str) -> tuple[Shape, ...]:
    """Tires and hubs of a body, for the eye alone: some millimetres proud of its flanks, in the unit box; or none."""
    if KIND_OF_BODY[name] not in _WHEELS:
        return ()
    size, radius, places = _WHEELS[KIND_OF_BODY[name]]
    along, sill, belt, _, belt_height, *_ = np.array(_BODIES[name], dtype=float).T
    found = []
    for out, share in ((_PROUD_M, 1.0), (2.0 * _PROUD_M, _HUB)):
        parts = []
        for place in places:
            x = place + np.linspace(-1.0, 1.0, 9) * radius / size[0]
            low, high, top = (np.interp(x, along, column) for column in (sill, belt, belt_height))
            flank = (low + (high - low) * np.minimum(2.0 * radius / size[2] / top, 1.0)).max()
            middle = (size[0] * (place - 0.5), size[1] * flank + out - 0.5 * _DEEP_M, radius - 0.5 * size[2])
            parts += both_sides(drum(middle, share * radius, _DEEP_M, 24))
        made = joined(parts)
        found.append(Shape(made.vertices / size, made.faces, made.surface))
    return tuple(found)


def _loft(stations) -> Shape:
    """Join hexagonal cross-sections into a closed mesh."""
    along, sill, belt, roof, belt_height, top_height, glass_sides, glass_top = np.array(stations, dtype=float).T
    y = np.stack([sill, belt, roof, -roof, -belt, -sill], axis=1)
    ground = np.zeros_like(along)
    z = np.stack([ground, belt_height, top_height, top_height, belt_height, ground], axis=1) - 0.5
    x = np.broadcast_to(along[:, None] - 0.5, y.shape)
    # Sides of the hexagon: left lower, left upper, top, right upper, right lower, floor.
    glass = np.stack([ground, glass_sides, glass_top, glass_sides, ground, ground], axis=1)[:-1] > 0.0
    return tube(np.stack([x, y, z], axis=-1), glass, shorter=False)
