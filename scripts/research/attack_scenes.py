"""Rays and triangles that make ray casters leak: 17 attacks by name, on vehicles, floors, needles and more.

`ATTACKS` has them by name and `attacks` makes those of a name; `caster_attacks.py` counts what casters get wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from blender_lidar.casting.exact import ExactCaster
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose, rotation_matrix
from blender_lidar.world.shapes import DETAILS, SHAPES, shape
from blender_lidar.world.triangles import place

# --- shapes, and targets on them --------------------------------------------------------------------------------------

SIZES_M = {
    "car": (4.5, 1.8, 1.5),
    "van": (5.2, 2.0, 1.9),
    "truck": (7.5, 2.5, 3.0),
    "long_truck": (12.7, 2.5, 3.8),
    "bus": (12.0, 2.5, 3.2),
    "motorcycle": (2.1, 0.8, 1.4),
    "bicycle": (1.8, 0.6, 1.7),
    "pedestrian": (0.8, 0.6, 1.7),
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
        What the caster knows of them: see `casting.protocol.Caster`.
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
    """Triangles (m, 3, 3) of a vehicle of each shape, on two lanes [m]: 61 m long, at y = 6 and 10 m."""
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


def corners_and_edges(rng: np.random.Generator, triangles: np.ndarray) -> np.ndarray:
    """`vertices_of` and `points_on_edges`, one after the other."""
    return np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])


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
    """Rays from each mount at some of the targets (k, 3) [m], once for each thing that casters know."""
    for origin in mounts:
        rays = unit(some(rng, targets, 250 if quick else 2500) - origin)
        for bounds_solids in closed:
            yield Attack(triangles, bounds_solids, origin, rays)


# --- attacks where triangles meet, end, or are hardly there ----------------------------------------


def vertices(rng, quick):
    """At the corners of vehicles."""
    for triangles in streets(quick):
        yield from aimed(rng, triangles, vertices_of(triangles), quick)


def edges(rng, quick):
    """At the sides of vehicles' triangles."""
    for triangles in streets(quick):
        yield from aimed(rng, triangles, points_on_edges(rng, triangles), quick)


def grazing(rng, quick):
    """Almost along flat sides, at their inner edges and elsewhere: down to a hundred-millionth of a radian."""
    for detail in DETAILS:
        triangles = vehicle("bus", detail, (0.0, 8.0), 0.13)
        face = ExactCaster(triangles)
        for angle in 10.0 ** -np.arange(1, 7 if quick else 9):
            rows = rng.integers(0, len(triangles), 2)
            for row in rows:
                points = np.concatenate([points_inside(rng, triangles), points_on_edges(rng, triangles)])
                normal = face.normals(np.array([row]))[0]
                flat = np.abs((points - triangles[row, 0]) @ normal) < 1e-9  # the points on that face's plane
                along = unit(np.cross(normal, rng.normal(size=3))[None])[0]
                origin = triangles[row].mean(axis=0) + 25.0 * (angle * normal - along)
                for closed in (True, False):
                    yield Attack(triangles, closed, origin, unit(points[flat] - origin))


def grazing_a_floor(rng, quick):
    """Almost along a floor of many triangles, which hides nothing behind it that would tell of a leak."""
    lines = np.arange(-40.0, 41.0, 2.5)
    triangles = floor(lines, lines)
    for height in 10.0 ** -np.arange(0, 5):
        origin = np.array([*rng.uniform(-1.0, 1.0, 2), height])
        targets = corners_and_edges(rng, triangles)
        yield from aimed(rng, triangles, targets, quick, (False,), [origin])


def grazing_a_box_around_another(rng, quick):
    """Almost along the flat sides of a box: what slips in meets the front of the box within."""
    low, high = np.array([-8.0, 6.0, 0.0]), np.array([8.0, 9.0, 3.0])
    outer = cuboid(low, high)
    for shrunk in (0.02, 0.3):
        triangles = np.concatenate([cuboid(low + shrunk, high - shrunk), outer]) @ rotation_matrix(0.0, 0.0, 0.21)
        outside, face = triangles[12:], ExactCaster(triangles)
        for angle in 10.0 ** -np.arange(1, 7 if quick else 9):
            for row in rng.permutation(12)[: 3 if quick else 12]:
                normal = face.normals(np.array([12 + row]))[0]
                targets = np.concatenate([points_on_edges(rng, outside[[row]]) for _ in range(30)])
                along = unit(np.cross(normal, rng.normal(size=3))[None])[0]
                origin = outside[row].mean(axis=0) + 60.0 * (angle * normal - along)
                for closed in (True, False):
                    yield Attack(triangles, closed, origin, unit(targets - origin))


def degenerate_triangles(rng, quick):
    """A street with points, lines and folded triangles strewn among its own."""
    whole = street("body", 0.13)
    collapsed = whole.copy()
    collapsed[::3, 1:] = collapsed[::3, :1]
    collapsed[1::3, 2] = collapsed[1::3, 1]
    collapsed[2::3, 2] = 0.3 * collapsed[2::3, 0] + 0.7 * collapsed[2::3, 1]
    triangles = np.stack([collapsed, whole], axis=1).reshape(-1, 3, 3)
    yield from aimed(rng, triangles, corners_and_edges(rng, whole), quick)


def needles(rng, quick):
    """Along the long side that two needles share, and at their tips."""
    for tip_rad in (2e-2, 1e-3, 1e-5, 1e-7):
        for _ in range(2 if quick else 8):
            triangles = lens(tip_rad) @ rotation_matrix(*rng.uniform(-1.2, 1.2, 3)) + [0.0, 60.0, 0.0]
            along = rng.uniform(0.0, 1.0, (200, 1))
            targets = np.concatenate([triangles[0, 0] + along * (triangles[0, 1] - triangles[0, 0]), triangles[0]])
            yield Attack(triangles, False, np.zeros(3), unit(targets))


# --- attacks by where rays start and where scenes lie: within vehicles, on lines and surfaces, far from anything ------


def overlapping_vehicles(rng, quick):
    """Vehicles that stand in each other, as tracked boxes do: no front face may show from within another vehicle."""
    for detail in DETAILS:
        parts = [
            vehicle(name, detail, (x, y), heading)
            for name, x, y, heading in (
                ("car", 0.0, 6.0, 0.0),
                ("van", 2.6, 6.7, 0.21),
                ("bus", -3.0, 8.0, -0.04),
                ("truck", 3.0, 8.9, 0.0),
                ("car", 1.0, 6.0, 0.0),
            )
        ]
        triangles = np.concatenate(parts)
        targets = corners_and_edges(rng, triangles)
        yield from aimed(rng, triangles, targets, quick)


def inside_a_vehicle(rng, quick):
    """From within a vehicle, at its corners and edges and into every direction."""
    for detail in DETAILS:
        triangles = street(detail, 0.13)
        targets = corners_and_edges(rng, triangles)
        inside = np.array([-15.0, 6.0, 0.7]) + rng.uniform(-0.2, 0.2, (1 if quick else 4, 3))
        yield from aimed(rng, triangles, targets, quick, mounts=inside)
        yield from aimed(rng, triangles, rng.normal(size=(400, 3)) + inside[0], quick, mounts=inside[:1])


def on_the_road_surface(rng, quick):
    """From z = 0, in the plane of the vehicles' floors: along it, upwards and downwards."""
    level = rng.uniform(-np.pi, np.pi, 400)
    rays = np.column_stack([np.cos(level), np.sin(level), np.zeros(400)])
    up = unit(np.column_stack([rays[:, :2], rng.choice([1e-9, 1e-6, 1e-3, 0.1, -1e-9, -1e-6, -1e-3, -0.1], 400)]))
    for triangles in streets(quick):
        for closed in (True, False):
            yield Attack(triangles, closed, np.zeros(3), np.concatenate([rays, up]))


def on_a_mesh_line(rng, quick):
    """A LiDAR over a line or a corner of a floor: whole columns of its beams run along lines."""
    lattice = beam_lattice(load_model("RS-16"), stride=10 if quick else 2)
    for step_x, step_y in ((2.5, 2.5), (10.0, 3.75)):
        triangles = floor(step_x * np.arange(-8, 9), step_y * np.arange(-8, 9))
        for x, y in ((step_x, 0.3), (0.3, step_y), (step_x, step_y), (0.0, 0.0)):
            for tilt_x in (0.0, 0.3):
                pose = Pose(x, y, 4.0, tilt_x)
                rays = pose.to_world(lattice.directions.reshape(-1, 3))
                yield Attack(triangles, False, pose.position, rays[rays[:, 2] < -0.05], 60.0)


def exactly_above(rng, quick):
    """Straight down on vehicles from above their corners, edges and middle."""
    for triangles in streets(quick):
        targets = corners_and_edges(rng, triangles)
        for target in some(rng, targets, 3 if quick else 20):
            origin = np.array([*target[:2], 6.0])
            near = targets[np.hypot(*(targets[:, :2] - origin[:2]).T) < 8.0]
            rays = np.concatenate([[[0.0, 0.0, -1.0]], unit(some(rng, near, 150) - origin)])
            for closed in (True, False):
                yield Attack(triangles, closed, origin, rays)
        origins = some(rng, targets, 200) * [1.0, 1.0, 0.0] + [0.0, 0.0, 6.0]
        yield Attack(triangles, True, origins, np.tile([[0.0, 0.0, -1.0]], (len(origins), 1)))


def shifted_scenes(rng, quick):
    """Streets from one to ten thousand kilometres from the origin, as state plane and UTM coordinates are."""
    for shift in (1e3, 1e4, 1e5, 1e6, 1e7):
        away = np.array([shift, -0.7 * shift, 0.0])
        triangles = street("body", 0.13) + away
        targets = corners_and_edges(rng, triangles)
        yield from aimed(rng, triangles, targets, quick, mounts=MOUNTS_M[:2] + away)


def outliers(rng, quick):
    """One vehicle so far from all others that its place can only be an error."""
    for away in (1e4, 1e6, 1e9, 1e12, 1e14):
        near = street("body", 0.13)
        triangles = np.concatenate([near, vehicle("car", "body", (away, 6.0))])
        targets = corners_and_edges(rng, near)
        yield from aimed(rng, triangles, targets, quick, mounts=MOUNTS_M[:2])


def large_triangles(rng, quick):
    """Vehicles on a ground of two triangles that are two thousand kilometres wide."""
    vehicles = street("body", 0.13) + np.array([0.0, 0.0, 0.1])
    triangles = np.concatenate([vehicles, floor(np.array([-1e6, 1e6]), np.array([-1e6, 1e6]))])
    targets = corners_and_edges(rng, vehicles)
    yield from aimed(rng, triangles, targets, quick, (False,), MOUNTS_M[:2])
    diagonal = np.repeat(10.0 ** rng.uniform(0.0, 5.0, (200, 1)), 3, axis=1) * [1.0, 1.0, 0.0]
    yield from aimed(rng, triangles, diagonal, quick, (False,), MOUNTS_M[:2])


def touching_a_surface(rng, quick):
    """From on a floor or a roof, and from nanometres to a millimetre off it, into every direction."""
    lines = np.arange(-20.0, 21.0, 2.5)
    for triangles, level in ((floor(lines, lines), 0.0), (street("box"), 1.5), (cuboid([-3, -3, 0], [3, 3, 2]), 2.0)):
        for gap in (0.0, 1e-9, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3):
            for way in (1.0, -1.0):
                origin = np.array([*rng.uniform(-1.0, 1.0, 2), level + way * gap])
                if level == 1.5:
                    origin[:2] += [-15.0, 6.0]  # of the car
                rays = unit(rng.normal(size=(60 if quick else 400, 3)))
                for closed in (True, False) if level else (False,):
                    yield Attack(triangles, closed, origin, rays, 50.0)


def ranges_at_the_gate(rng, quick):
    """Rays cast exactly as far as they meet something, a hair less, and a hair more."""
    triangles, origin = street("body", 0.13), MOUNTS_M[0]
    rays = unit(some(rng, points_inside(rng, triangles), 12 if quick else 60) - origin)
    for ray, distance in zip(rays, ExactCaster(triangles).cast(origin, rays).distance.tolist(), strict=True):
        if np.isfinite(distance):
            for gate in (distance, distance * (1.0 - 1e-7), distance * (1.0 + 1e-7), 0.0):
                yield Attack(triangles, True, origin, ray[None], gate)


# --- by name ----------------------------------------------------------------------------------------------------------

ATTACKS: dict[str, Callable[[np.random.Generator, bool], Iterator[Attack]]] = {
    attack.__name__.replace("_", " "): attack
    for attack in (
        *(vertices, edges, grazing, grazing_a_floor, grazing_a_box_around_another, degenerate_triangles, needles),
        *(overlapping_vehicles, inside_a_vehicle, on_the_road_surface, on_a_mesh_line, exactly_above),
        *(shifted_scenes, outliers, large_triangles, touching_a_surface, ranges_at_the_gate),
    )
}


def attacks(name: str, *, quick: bool = True, seed: int = 1) -> Iterator[Attack]:
    """The attacks of a name of `ATTACKS`; the same ones for the same seed. Quick ones are smaller, not other ones."""
    yield from ATTACKS[name](np.random.default_rng([seed, list(ATTACKS).index(name)]), quick)
