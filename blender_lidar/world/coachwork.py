"""Parts that road vehicles are made of: a lower body with wheel arches, a glazed upper body, wheels.

All in metres: x from the tail, y to the left of the middle, z from the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .meshes import Shape, both_sides, drum, loft

_ARCH = np.array([-1.0, -0.72, 0.0, 0.72, 1.0])  # of its radius: where cross-sections are laid through a wheel arch
_SILL_M = 0.02  # the outer edge of the floor lies so much above the floor
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


def lower_body(sections, axles=(), well: float = 0.6) -> Shape:
    """The body up to its belt line, with hood and boot, its floor clear of the ground and cut by wheel arches.

    Parameters
    ----------
    sections : sequence of (x, bow, floor_z, sill_y, side_y, side_z, belt_y, belt_z, ridge_z)
        Cross-sections from tail to nose [m]: `bow` is how far a side at the body's greatest width lies behind the
        section's middle (below 0: ahead of it); then height of the floor, half-width at its edge, half-width and height
        where the section is widest, half-width and height of the belt line or hood's edge, and height in the middle.
    axles : sequence of Axle
        Whose arches are cut into the sides; they end below where the section is widest.
    well : float
        From the middle of the vehicle to the inner end of the wheel wells [m].
    """
    table = np.array(sections, dtype=float)
    x = np.unique(np.concatenate([table[:, 0], *(axle.x + axle.arch * _ARCH for axle in axles)]))
    bow, floor, sill_y, side_y, side_z, belt_y, belt_z, ridge = (
        np.interp(x, table[:, 0], column) for column in table.T[1:]
    )
    edge = floor + _SILL_M
    for axle in axles:
        away = np.abs(x - axle.x)
        within = away < 0.99 * axle.arch
        edge[within] = axle.radius + np.sqrt(axle.arch**2 - away[within] ** 2)
    edge_y = sill_y + (side_y - sill_y) * (edge - floor - _SILL_M) / (side_z - floor - _SILL_M)
    y = np.stack([np.minimum(well, 0.9 * sill_y), edge_y, side_y, belt_y, np.zeros_like(x)], axis=1)
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
