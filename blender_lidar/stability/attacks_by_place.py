"""Attacks by where rays start and where scenes lie: within vehicles, on lines and surfaces, and far from anything."""

from __future__ import annotations

import numpy as np

from ..casting.exact import ExactCaster
from ..sensors.beams import beam_lattice
from ..sensors.model import load_model
from ..sensors.pose import Pose
from ..world.shapes import DETAILS
from .attack_scenes import (
    MOUNTS_M,
    Attack,
    aimed,
    cuboid,
    floor,
    points_inside,
    points_on_edges,
    some,
    street,
    streets,
    unit,
    vehicle,
    vertices_of,
)


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
        targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
        yield from aimed(rng, triangles, targets, quick)


def inside_a_vehicle(rng, quick):
    """From within a vehicle, at its corners and edges and into every direction."""
    for detail in DETAILS:
        triangles = street(detail, 0.13)
        targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
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
        targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
        for target in some(rng, targets, 3 if quick else 20):
            origin = np.array([*target[:2], 6.0])
            near = targets[np.hypot(*(targets[:, :2] - origin[:2]).T) < 8.0]
            rays = np.concatenate([[[0.0, 0.0, -1.0]], unit(some(rng, near, 150) - origin)])
            for closed in (True, False):
                yield Attack(triangles, closed, origin, rays)
        origins = some(rng, targets, 200) * [1.0, 1.0, 0.0] + [0.0, 0.0, 6.0]
        yield Attack(triangles, True, origins, np.tile([[0.0, 0.0, -1.0]], (len(origins), 1)))


def along_the_axes(rng, quick):
    """Rays along an axis, and square to one, at the sides and corners of boxes that stand along the axes."""
    triangles = street("box", 0.0)
    targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles), points_inside(rng, triangles)])
    for _ in range(1 if quick else 5):
        for axis in range(3):
            away = np.zeros(3)
            away[axis] = 40.0
            for way in (away, -away):
                yield Attack(triangles, True, targets + way, np.tile(-way / 40.0, (len(targets), 1)))
            across = rng.normal(size=(len(targets), 3))
            across[:, axis] = 0.0
            across = unit(across)
            yield Attack(triangles, False, targets - 30.0 * across, across)


def shifted_scenes(rng, quick):
    """Streets from one to ten thousand kilometres from the origin, as state plane and UTM coordinates are."""
    for shift in (1e3, 1e4, 1e5, 1e6, 1e7):
        away = np.array([shift, -0.7 * shift, 0.0])
        triangles = street("body", 0.13) + away
        targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
        yield from aimed(rng, triangles, targets, quick, mounts=MOUNTS_M[:2] + away)


def outliers(rng, quick):
    """One vehicle so far from all others that its place can only be an error."""
    for away in (1e4, 1e6, 1e9, 1e12, 1e14):
        near = street("body", 0.13)
        triangles = np.concatenate([near, vehicle("car", "body", (away, 6.0))])
        targets = np.concatenate([vertices_of(near), points_on_edges(rng, near)])
        yield from aimed(rng, triangles, targets, quick, mounts=MOUNTS_M[:2])


def large_triangles(rng, quick):
    """Vehicles on a ground of two triangles that are two thousand kilometres wide."""
    vehicles = street("body", 0.13) + np.array([0.0, 0.0, 0.1])
    triangles = np.concatenate([vehicles, floor(np.array([-1e6, 1e6]), np.array([-1e6, 1e6]))])
    targets = np.concatenate([vertices_of(vehicles), points_on_edges(rng, vehicles)])
    yield from aimed(rng, triangles, targets, quick, (False,), MOUNTS_M[:2])
    diagonal = np.repeat(10.0 ** rng.uniform(0.0, 5.0, (200, 1)), 3, axis=1) * [1.0, 1.0, 0.0]
    yield from aimed(rng, triangles, diagonal, quick, (False,), MOUNTS_M[:2])


def origins_far_apart(rng, quick):
    """Many mountings in one cast, metres to a hundred kilometres from each other."""
    triangles = street("body", 0.13)
    targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
    for spread in (20.0, 1e3, 1e5, 1e7):
        origins = np.column_stack(
            [
                rng.uniform(-spread, spread, len(targets)),
                rng.uniform(-8.0, 0.0, len(targets)),
                np.full(len(targets), 4.0),
            ]
        )
        origins[::2, 0] = rng.uniform(-20.0, 20.0, len(origins[::2]))
        picked = some(rng, np.arange(len(targets)), 800 if quick else 4000)
        for closed in (True, False):
            yield Attack(triangles, closed, origins[picked], unit(targets[picked] - origins[picked]))


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


BY_PLACE = (
    overlapping_vehicles,
    inside_a_vehicle,
    on_the_road_surface,
    on_a_mesh_line,
    exactly_above,
    along_the_axes,
    shifted_scenes,
    outliers,
    large_triangles,
    origins_far_apart,
    touching_a_surface,
    ranges_at_the_gate,
)
