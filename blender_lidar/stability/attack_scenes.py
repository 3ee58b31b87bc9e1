"""What rays are aimed at, and from where, when casters are attacked: streets, floors, needles, and targets on them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..world.shapes import DETAILS, SHAPES, shape
from ..world.triangles import place

SIZES_M = {
    "car": (4.5, 1.8, 1.5),
    "van": (5.2, 2.0, 1.9),
    "truck": (7.5, 2.5, 3.0),
    "long_truck": (12.7, 2.5, 3.8),
    "bus": (12.0, 2.5, 3.2),
    "motorcycle": (2.1, 0.8, 1.4),
}
MOUNTS_M = np.array([[0.0, 0.0, 4.1], [-40.0, -1.0, 4.5], [7.0, 0.0, 0.8], [0.0, 9.0, 9.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Attack:
    """Rays on triangles that a caster may get wrong.

    Attributes
    ----------
    triangles : ndarray, (m, 3, 3)
        Their corners [m].
    closed : bool
        What the caster is told of them: see `casting.protocol.Caster`.
    origins : ndarray, (3,) or (n, 3)
        Where the rays start [m].
    directions : ndarray, (n, 3)
        Where they go: of unit length.
    max_range_m : float
        How far they are cast [m].
    """

    triangles: np.ndarray
    closed: bool
    origins: np.ndarray
    directions: np.ndarray
    max_range_m: float = np.inf


def unit(vectors: np.ndarray) -> np.ndarray:
    """Rows (n, 3) made unit length; those without length are left out."""
    length = np.linalg.norm(vectors, axis=1)
    return vectors[length > 0.0] / length[length > 0.0, None]


def vehicle(name: str, detail: str, centre_xy: tuple[float, float], heading_rad: float = 0.0) -> np.ndarray:
    """Triangles (m, 3, 3) of a vehicle that stands on the plane z = 0 [m]."""
    size, made = np.array([SIZES_M[name]]), shape(name, detail)
    middle = np.array([[*centre_xy, 0.5 * size[0, 2]]])
    return place(made.vertices, middle, size, np.array([heading_rad]))[0][made.faces]


def street(detail: str, heading_rad: float = 0.0) -> np.ndarray:
    """Triangles (m, 3, 3) of a vehicle of each shape, on two lanes [m]: 46 m long, at y = 6 and 10 m."""
    return np.concatenate(
        [
            vehicle(name, detail, (15.0 * (number // 2) - 15.0, 6.0 + 4.0 * (number % 2)), heading_rad)
            for number, name in enumerate(SHAPES)
        ]
    )


def cuboid(low, high) -> np.ndarray:
    """Twelve triangles (12, 3, 3) of the box between two corners."""
    low, high, made = np.array(low, dtype=float), np.array(high, dtype=float), shape("car", "box")
    return (0.5 * (low + high) + made.vertices * (high - low))[made.faces]


def floor(lines_x: np.ndarray, lines_y: np.ndarray) -> np.ndarray:
    """A flat grid of triangles at z = 0 between lines [m]: two in each cell, facing up."""
    x, y = np.meshgrid(lines_x, lines_y, indexing="ij")
    grid = np.stack([x, y, np.zeros_like(x)], axis=-1)
    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    halves = [np.stack(corners, axis=2).reshape(-1, 3, 3) for corners in ((a, b, c), (a, c, d))]
    return np.concatenate(halves)


def lens(tip_rad: float, half_length_m: float = 10.0) -> np.ndarray:
    """Two needles (2, 3, 3) in the plane z = 0 that share their long side, which lies along x [m]."""
    end, width = half_length_m, half_length_m * np.tan(tip_rad)
    return np.array([[[-end, 0, 0], [end, 0, 0], [0, width, 0]], [[end, 0, 0], [-end, 0, 0], [0, -width, 0]]])


def soup(rng: np.random.Generator, triangles: int, side_m: float, spread_m: float) -> np.ndarray:
    """Triangles (m, 3, 3) of about a size, anywhere and turned anyhow [m]."""
    return rng.uniform(-spread_m, spread_m, (triangles, 1, 3)) + rng.normal(scale=side_m, size=(triangles, 3, 3))


def vertices_of(triangles: np.ndarray) -> np.ndarray:
    """Distinct corners (k, 3)."""
    return np.unique(triangles.reshape(-1, 3), axis=0)


def points_on_edges(rng: np.random.Generator, triangles: np.ndarray) -> np.ndarray:
    """A point (3 m, 3) on each side of each triangle: its middle, or anywhere."""
    ends = np.roll(triangles, -1, axis=1)
    weight = np.where(rng.random((len(triangles), 3, 1)) < 0.5, 0.5, rng.random((len(triangles), 3, 1)))
    return (triangles + weight * (ends - triangles)).reshape(-1, 3)


def points_inside(rng: np.random.Generator, triangles: np.ndarray) -> np.ndarray:
    """A point (m, 3) somewhere within each triangle."""
    return np.einsum("tc,tci->ti", rng.dirichlet([1.0, 1.0, 1.0], len(triangles)), triangles)


def some(rng: np.random.Generator, rows: np.ndarray, most: int) -> np.ndarray:
    """At most so many of the rows, drawn without replacement."""
    return rows if len(rows) <= most else rows[rng.choice(len(rows), most, replace=False)]


def streets(quick: bool) -> Iterator[np.ndarray]:
    """Triangles of streets at every level of detail, along the axes and off them."""
    for detail in DETAILS:
        for heading in (0.0, 0.13):
            if not quick or (detail, heading) != ("box", 0.13):
                yield street(detail, heading)


def aimed(
    rng: np.random.Generator,
    triangles: np.ndarray,
    targets: np.ndarray,
    quick: bool,
    closed: tuple[bool, ...] = (True, False),
    mounts: Iterable[np.ndarray] = MOUNTS_M,
) -> Iterator[Attack]:
    """Rays from each mount at some of the targets (k, 3) [m], once for each thing that casters are told."""
    for origin in mounts:
        rays = unit(some(rng, targets, 250 if quick else 2500) - origin)
        for bounds_solids in closed:
            yield Attack(triangles, bounds_solids, origin, rays)
