"""Vehicle shapes at the level `detailed`: wheels and arches, cambered bodies, glass and pillars, mirrors, clearance.

Tables are in metres for a vehicle of the class's typical size, x from the tail, y from the middle, z from the ground,
and scaled to the unit box at the end; in a box of other proportions wheels become a little elliptic. Proportions by eye
from common vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .meshes import Shape, block, both_sides, drum, fitted, joined, limb, loft

# --- Parts that road vehicles are made of: a lower body with wheel arches, a glazed upper body, wheels ----
# All in metres: x from the tail, y to the left of the middle, z from the ground.

_ARCH = np.array([-1.0, -0.72, 0.0, 0.72, 1.0])  # of its radius: where cross-sections are laid through a wheel arch
_SILL_M = 0.02  # the outer edge of the floor lies so much above the floor
_WELL_M = 0.6  # from the middle of the vehicle to the inner end of the wheel wells
_FOOT_M = 0.10  # the upper body reaches so far down into the lower one


@dataclass(frozen=True, slots=True)
class Axle:
    """A pair of wheels (of dual wheels as well), and the arches above them.

    Attributes
    ----------
    x : float
        Where it is [m].
    radius : float
        Of the wheels [m].
    outer, width : float
        From the middle of the vehicle to the outer side of a wheel, and how wide a wheel is [m].
    gap : float
        Between wheel and arch [m].
    sides : int
        How many flat sides a wheel has.
    """

    x: float
    radius: float
    outer: float
    width: float
    gap: float = 0.05
    sides: int = 10

    def wheels(self) -> tuple[Shape, ...]:
        """Both wheels; dual ones as one."""
        middle = (self.x, self.outer - self.width / 2, self.radius)
        return both_sides(drum(middle, self.radius, self.width, self.sides))

    @property
    def arch(self) -> float:
        """Radius of the arches [m]."""
        return self.radius + self.gap


def lower_body(sections, axles=()) -> Shape:
    """The body up to its belt line, with hood and boot, its floor clear of the ground and cut by wheel arches.

    Parameters
    ----------
    sections : sequence of (x, bow, floor_z, sill_y, side_y, side_z, belt_y, belt_z, ridge_z)
        Cross-sections from tail to nose [m]: `bow` is how far a side at the body's greatest width lies behind the
        section's middle (below 0: ahead of it); then height of the floor, half-width at its edge, half-width and height
        where the section is widest, half-width and height of the belt line or hood's edge, and height in the middle.
    axles : sequence of Axle
        Whose arches are cut into the sides; they end below where the section is widest.
    """
    table = np.array(sections, dtype=float)
    x = np.unique(np.concatenate([table[:, 0], *(axle.x + axle.arch * _ARCH for axle in axles)]))
    columns = (np.interp(x, table[:, 0], column) for column in table.T[1:])
    bow, floor, sill_y, side_y, side_z, belt_y, belt_z, ridge = columns
    edge = floor + _SILL_M
    for axle in axles:
        away = np.abs(x - axle.x)
        within = away < 0.99 * axle.arch
        edge[within] = axle.radius + np.sqrt(axle.arch**2 - away[within] ** 2)
    edge_y = sill_y + (side_y - sill_y) * (edge - floor - _SILL_M) / (side_z - floor - _SILL_M)
    y = np.stack([np.minimum(_WELL_M, 0.9 * sill_y), edge_y, side_y, belt_y, np.zeros_like(x)], axis=1)
    z = np.stack([floor, edge, side_z, belt_z, ridge], axis=1)
    return loft(_bent(x, bow, y, z))


def upper_body(sections, shoulder=(0.85, 0.6)) -> Shape:
    """The body above its belt line: windows, pillars and a roof cambered along and across.

    Parameters
    ----------
    sections : sequence of (x, bow, belt_y, belt_z, rail_y, rail_z, ridge_z, side_glass, top_glass)
        Cross-sections from tail to nose [m]: half-width and height of the belt line and of the windows' upper edge, and
        height in the middle; whether the sides and the top from here to the next section are glass. `bow` as above.
    shoulder : (float, float)
        A point of the roof between the windows' upper edge and the middle: its half-width as a share of the edge's, and
        how far it lies below the middle as a share of what the edge does. From the edge to here all is painted, and so
        leaves the windscreen a pillar at either side.
    """
    table = np.array(sections, dtype=float)
    x, bow, belt_y, belt_z, rail_y, rail_z, ridge = table.T[:7]
    share, drop = shoulder
    y = np.stack([belt_y, belt_y, rail_y, share * rail_y, np.zeros_like(x)], axis=1)
    z = np.stack([belt_z - _FOOT_M, belt_z, rail_z, ridge - drop * (ridge - rail_z), ridge], axis=1)
    side, top = table.T[7:, :-1].astype(bool)
    none = np.zeros_like(side)
    return loft(_bent(x, bow, y, z), np.stack([none, side, none, top], axis=1))


def _bent(x, bow, y, z) -> np.ndarray:
    """Points (s, p, 3) of cross-sections that lie the farther back the farther out they are."""
    return np.stack([x[:, None] - bow[:, None] * np.square(y / y.max()), y, z], axis=-1)


# --- A motorcycle and its rider, 2.2 x 0.9 x 1.4 m up to the helmet ---------------------------------------------------


def _motorcycle():
    yield drum((0.31, 0.0, 0.31), 0.31, 0.16, 12)
    yield drum((1.89, 0.0, 0.31), 0.31, 0.13, 12)
    tail, seat = (0.12, 0, 0.80, 0.07, 0.05), (0.62, 0, 0.72, 0.14, 0.09)
    tank, head = (1.16, 0, 0.80, 0.17, 0.15), (1.50, 0, 0.88, 0.08, 0.08)
    yield limb([tail, seat, tank, head])
    yield limb([(0.66, 0, 0.46, 0.15, 0.24), (1.40, 0, 0.48, 0.17, 0.26)])  # engine
    yield limb([(1.42, 0, 0.90, 0.10, 0.10), (1.70, 0, 0.92, 0.12, 0.12)])  # headlight
    yield block((1.36, -0.42, 1.00), (1.42, 0.42, 1.05))  # handlebar
    yield from both_sides(
        limb([(1.50, 0.09, 0.96, 0.04, 0.03), (1.89, 0.09, 0.31, 0.04, 0.03)], 4),  # fork
        limb([(0.31, 0.10, 0.31, 0.04, 0.04), (0.80, 0.10, 0.42, 0.04, 0.05)], 4),  # swing arm
        block((1.38, 0.33, 1.03), (1.44, 0.45, 1.16)),  # mirror
    )
    # The rider.
    yield limb([(0.70, 0, 0.80, 0.17, 0.12), (0.84, 0, 1.00, 0.18, 0.12), (0.98, 0, 1.18, 0.21, 0.10)])  # torso
    neck, jaw = (1.06, 0, 1.10, 0.08, 0.08), (1.07, 0, 1.19, 0.12, 0.14)
    brow, crown = (1.07, 0, 1.30, 0.12, 0.14), (1.06, 0, 1.40, 0.06, 0.08)
    yield limb([neck, jaw, brow, crown], 8)  # helmet
    yield from both_sides(
        limb([(0.96, 0.20, 1.16, 0.06, 0.06), (1.12, 0.33, 0.98, 0.05, 0.05), (1.40, 0.34, 1.03, 0.04, 0.04)]),  # arm
        limb([(0.72, 0.11, 0.78, 0.08, 0.09), (1.14, 0.21, 0.74, 0.06, 0.07)]),  # thigh
        limb([(1.12, 0.21, 0.76, 0.06, 0.07), (0.88, 0.21, 0.30, 0.05, 0.06)]),  # shank
    )


# --- A bicycle and its rider, 1.75 x 0.6 x 1.73 m, and a pedestrian, 0.32 x 0.6 x 1.75 m -----------------------------


def _bicycle():
    yield drum((0.34, 0.0, 0.34), 0.34, 0.05, 12)
    yield drum((1.41, 0.0, 0.34), 0.34, 0.05, 12)
    yield limb([(0.34, 0, 0.34, 0.03, 0.03), (0.80, 0, 0.30, 0.04, 0.05)], 4)  # chain stays
    yield limb([(0.60, 0, 0.86, 0.06, 0.05), (0.78, 0, 0.32, 0.03, 0.03)], 4)  # saddle and seat tube
    yield limb([(0.80, 0, 0.30, 0.03, 0.03), (1.22, 0, 0.84, 0.03, 0.03)], 4)  # down tube
    yield limb([(1.20, 0, 0.98, 0.03, 0.03), (1.41, 0, 0.34, 0.04, 0.03)], 4)  # fork
    yield block((1.18, -0.30, 0.97), (1.22, 0.30, 1.01))  # handlebar
    yield from _person(hip=(0.62, 0.92), shoulder=(0.88, 1.36), head=(0.95, 1.46))
    yield from both_sides(
        limb([(0.87, 0.19, 1.33, 0.05, 0.05), (1.03, 0.25, 1.13, 0.04, 0.04), (1.19, 0.26, 1.01, 0.04, 0.04)]),  # arm
        limb([(0.64, 0.10, 0.90, 0.08, 0.08), (0.96, 0.12, 0.72, 0.06, 0.06)]),  # thigh
        limb([(0.95, 0.12, 0.74, 0.06, 0.06), (0.82, 0.12, 0.24, 0.05, 0.05)]),  # shank
    )


def _pedestrian():
    yield from _person(hip=(0.16, 0.92), shoulder=(0.17, 1.42), head=(0.19, 1.48))
    yield from both_sides(
        limb([(0.16, 0.10, 0.94, 0.09, 0.10), (0.18, 0.10, 0.50, 0.06, 0.07), (0.12, 0.10, 0.06, 0.05, 0.06)]),  # leg
        block((0.0, 0.05, 0.0), (0.28, 0.16, 0.08)),  # foot
        limb([(0.17, 0.22, 1.40, 0.06, 0.06), (0.12, 0.24, 1.12, 0.05, 0.05), (0.28, 0.25, 0.98, 0.04, 0.04)]),  # arm
        block((0.24, 0.22, 0.92), (0.32, 0.30, 1.00)),  # hand
    )


def _person(hip, shoulder, head):
    """Trunk and head, by places x, z of hip, shoulder and chin [m]."""
    (x, z), (over_x, over_z), (head_x, chin) = hip, shoulder, head
    middle = (0.5 * (x + over_x), 0, 0.5 * (z + over_z))
    yield limb([(x, 0, z - 0.06, 0.15, 0.11), (*middle, 0.17, 0.12), (over_x, 0, over_z, 0.22, 0.11)], 8)
    yield limb([(over_x, 0, over_z - 0.02, 0.07, 0.07), (head_x, 0, chin, 0.07, 0.08)], 8)  # neck
    rings = ((0.0, 0.06, 0.08), (0.07, 0.08, 0.10), (0.18, 0.08, 0.10), (0.27, 0.04, 0.05))
    yield limb([(head_x, 0, chin + up, half_width, half_depth) for up, half_width, half_depth in rings], 8)


# --- Road users of every class, from these parts ----------------------------------------------------------------------


def detailed_shape(name: str) -> Shape:
    """The shape `name` of `shapes.SHAPES` in the unit box."""
    return fitted(joined(detailed_parts(name)))


def detailed_parts(name: str) -> tuple[Shape, ...]:
    """Its parts in metres, each closed by itself, for a vehicle of typical size."""
    return tuple(_MAKERS[name]())


def _car():
    """A car between hatchback and saloon, 4.5 x 1.8 x 1.5 m."""
    axles = (Axle(0.90, 0.32, 0.885, 0.21), Axle(3.60, 0.32, 0.885, 0.21))
    lower = (
        (0.00, 0.00, 0.32, 0.62, 0.68, 0.52, 0.66, 0.62, 0.64),
        (0.10, -0.12, 0.26, 0.76, 0.80, 0.66, 0.74, 0.92, 0.97),
        (0.45, 0.00, 0.19, 0.84, 0.88, 0.72, 0.81, 0.95, 1.00),
        (2.30, 0.00, 0.17, 0.86, 0.90, 0.72, 0.845, 0.93, 0.95),
        (3.20, 0.00, 0.17, 0.86, 0.90, 0.73, 0.83, 0.91, 0.98),
        (3.98, 0.00, 0.18, 0.84, 0.89, 0.72, 0.78, 0.84, 0.90),
        (4.30, 0.14, 0.20, 0.80, 0.83, 0.66, 0.72, 0.74, 0.80),
        (4.50, 0.00, 0.22, 0.56, 0.58, 0.48, 0.54, 0.60, 0.62),
    )
    upper = (
        (0.22, -0.06, 0.77, 0.90, 0.73, 0.94, 0.97, False, True),
        (0.80, -0.06, 0.82, 0.92, 0.62, 1.36, 1.42, True, False),
        (2.02, 0.00, 0.82, 0.92, 0.635, 1.44, 1.50, False, False),
        (2.12, 0.00, 0.82, 0.92, 0.635, 1.44, 1.50, True, False),
        (2.62, 0.04, 0.82, 0.915, 0.625, 1.38, 1.435, True, True),
        (3.38, 0.10, 0.77, 0.89, 0.70, 0.92, 0.97, False, False),
    )
    mirror = block((2.98, 0.74, 0.92), (3.10, 0.90, 1.04))
    return _road_vehicle(lower, upper, axles, mirror)


def _van():
    """A minivan, with the stance of an SUV, 5.0 x 1.9 x 1.9 m."""
    axles = (Axle(1.00, 0.34, 0.935, 0.22, 0.06), Axle(4.05, 0.34, 0.935, 0.22, 0.06))
    lower = (
        (0.00, 0.00, 0.36, 0.76, 0.80, 0.55, 0.78, 0.62, 0.64),
        (0.08, -0.06, 0.30, 0.84, 0.90, 0.76, 0.87, 1.05, 1.10),
        (0.50, 0.00, 0.22, 0.88, 0.94, 0.77, 0.91, 1.08, 1.12),
        (3.60, 0.00, 0.20, 0.90, 0.95, 0.78, 0.91, 1.06, 1.14),
        (4.48, 0.03, 0.22, 0.87, 0.93, 0.77, 0.84, 0.93, 1.01),
        (4.82, 0.14, 0.24, 0.80, 0.84, 0.66, 0.78, 0.80, 0.86),
        (5.00, 0.00, 0.26, 0.60, 0.62, 0.50, 0.58, 0.62, 0.64),
    )
    upper = (
        (0.10, -0.05, 0.86, 1.06, 0.84, 1.09, 1.12, False, True),
        (0.32, -0.05, 0.88, 1.07, 0.74, 1.78, 1.85, False, False),
        (0.60, 0.00, 0.895, 1.07, 0.745, 1.80, 1.88, True, False),
        (2.10, 0.00, 0.90, 1.07, 0.75, 1.83, 1.90, False, False),
        (2.22, 0.00, 0.90, 1.07, 0.75, 1.83, 1.90, True, False),
        (3.20, 0.06, 0.90, 1.06, 0.73, 1.75, 1.82, True, True),
        (4.20, 0.14, 0.84, 1.01, 0.77, 1.04, 1.09, False, False),
    )
    mirror = block((3.62, 0.80, 1.06), (3.76, 0.95, 1.26))
    return _road_vehicle(lower, upper, axles, mirror)


def _truck():
    """A box truck with two axles and a short hood, 8.0 x 2.5 x 3.0 m."""
    axles = (Axle(1.75, 0.45, 1.18, 0.52), Axle(6.95, 0.45, 1.09, 0.26, 0.06))
    lower = (
        (5.60, 0.00, 0.50, 1.02, 1.08, 1.02, 1.08, 1.40, 1.45),
        (6.30, 0.00, 0.45, 1.04, 1.10, 1.02, 1.09, 1.40, 1.48),
        (7.50, 0.00, 0.38, 1.03, 1.09, 1.02, 0.98, 1.30, 1.42),
        (7.85, 0.12, 0.36, 0.98, 1.04, 0.85, 0.94, 1.12, 1.22),
        (8.00, 0.00, 0.38, 0.82, 0.86, 0.68, 0.82, 0.85, 0.90),
    )
    upper = (
        (5.63, 0.00, 1.06, 1.38, 0.98, 2.18, 2.28, False, False),
        (6.00, 0.00, 1.07, 1.38, 0.99, 2.20, 2.33, True, False),
        (6.60, 0.05, 1.07, 1.38, 0.97, 2.16, 2.30, True, True),
        (7.35, 0.12, 0.98, 1.30, 0.90, 1.36, 1.43, False, False),
    )
    mirror = block((6.95, 0.88, 1.50), (7.05, 1.25, 1.90))
    parts = (
        block((0.0, -1.25, 0.95), (5.35, 1.25, 3.0)),  # cargo box
        block((0.1, -0.43, 0.60), (7.3, 0.43, 1.00)),  # frame
        block((0.05, -1.1, 0.42), (0.15, 1.1, 0.62)),  # underrun bar
        *both_sides(block((3.2, 0.4, 0.45), (4.4, 1.1, 0.85))),  # tanks
    )
    return (*parts, *_road_vehicle(lower, upper, axles, mirror, shoulder=(0.9, 0.3)))


def _long_truck():
    """A cab-over tractor with a trailer on three axles, 16.0 x 2.6 x 3.8 m."""
    trailer = tuple(Axle(x, 0.5, 1.27, 0.4, sides=8) for x in (2.3, 3.6, 4.9))
    axles = (*trailer, Axle(11.0, 0.5, 1.24, 0.6, sides=8), Axle(14.65, 0.5, 1.24, 0.32, 0.07, sides=8))
    lower = (
        (13.80, 0.00, 0.75, 1.16, 1.24, 1.15, 1.24, 1.66, 1.70),
        (15.30, 0.00, 0.38, 1.18, 1.25, 1.15, 1.25, 1.66, 1.70),
        (15.85, 0.10, 0.32, 1.15, 1.24, 1.12, 1.24, 1.66, 1.70),
        (16.00, 0.00, 0.34, 1.04, 1.10, 0.92, 1.12, 1.55, 1.60),
    )
    upper = (
        (13.83, 0.00, 1.22, 1.64, 1.19, 2.60, 3.45, False, False),
        (14.60, 0.00, 1.23, 1.64, 1.20, 2.60, 3.50, True, False),
        (15.35, 0.02, 1.23, 1.64, 1.20, 2.60, 3.20, True, False),
        (15.78, 0.10, 1.22, 1.64, 1.18, 2.52, 2.80, False, True),
        (15.96, 0.12, 1.20, 1.64, 1.17, 1.72, 1.80, False, False),
    )
    mirror = block((15.45, 1.15, 1.85), (15.57, 1.30, 2.55))
    parts = (
        block((0.0, -1.3, 1.12), (13.1, 1.3, 3.8)),  # trailer
        block((0.15, -0.5, 0.90), (12.6, 0.5, 1.20)),  # its frame
        block((0.1, -1.2, 0.45), (0.2, 1.2, 0.95)),  # underrun bar
        block((10.1, -0.43, 0.60), (15.4, 0.43, 1.00)),  # the tractor's frame
    )
    return (*parts, *_road_vehicle(lower, upper, axles, mirror, shoulder=(0.92, 0.15)))


def _bus():
    """A city bus, 12.0 x 2.55 x 3.2 m."""
    axles = (Axle(3.3, 0.48, 1.25, 0.56, 0.07), Axle(9.25, 0.48, 1.25, 0.3, 0.07))
    lower = (
        (0.00, 0.00, 0.45, 1.12, 1.18, 1.06, 1.18, 1.25, 1.30),
        (0.20, 0.00, 0.36, 1.20, 1.26, 1.10, 1.26, 1.28, 1.32),
        (5.00, 0.00, 0.32, 1.24, 1.275, 1.10, 1.27, 1.28, 1.32),
        (11.5, 0.00, 0.32, 1.23, 1.27, 1.10, 1.265, 1.28, 1.32),
        (11.9, 0.14, 0.32, 1.18, 1.24, 1.00, 1.24, 1.26, 1.31),
        (12.0, 0.00, 0.34, 1.02, 1.08, 0.90, 1.08, 1.22, 1.27),
    )
    upper = (
        (0.04, -0.08, 1.20, 1.24, 1.18, 2.70, 3.10, False, False),
        (0.35, 0.00, 1.255, 1.26, 1.235, 2.72, 3.17, True, False),
        (4.00, 0.00, 1.26, 1.26, 1.24, 2.72, 3.20, False, False),
        (4.12, 0.00, 1.26, 1.26, 1.24, 2.72, 3.20, True, False),
        (7.80, 0.00, 1.26, 1.26, 1.24, 2.72, 3.20, False, False),
        (7.92, 0.00, 1.26, 1.26, 1.24, 2.72, 3.20, True, False),
        (11.55, 0.12, 1.255, 1.24, 1.225, 2.70, 3.12, True, True),
        (11.94, 0.20, 1.22, 1.20, 1.18, 1.30, 1.36, False, False),
    )
    mirror = block((11.47, 1.15, 2.10), (11.60, 1.275, 2.55))
    return _road_vehicle(lower, upper, axles, mirror, shoulder=(0.93, 0.12))


def _road_vehicle(lower, upper, axles, mirror, shoulder=(0.85, 0.6)):
    """Its parts: lower and upper body, wheels, arches where axles lie under the body, and mirrors."""
    under = [axle for axle in axles if lower[0][0] < axle.x < lower[-1][0]]
    wheels = (wheel for axle in axles for wheel in axle.wheels())
    return (lower_body(lower, under), upper_body(upper, shoulder), *wheels, *both_sides(mirror))


_MAKERS = {
    "car": _car,
    "van": _van,
    "truck": _truck,
    "long_truck": _long_truck,
    "bus": _bus,
    "motorcycle": _motorcycle,
    "bicycle": _bicycle,
    "pedestrian": _pedestrian,
}
