"""Attacks where triangles meet, end, lie in each other, or are hardly there."""

from __future__ import annotations

import numpy as np

from ..casting.exact import ExactCaster
from ..sensors.pose import rotation_matrix
from ..world.shapes import DETAILS
from .attack_scenes import (
    MOUNTS_M,
    Attack,
    aimed,
    cuboid,
    floor,
    lens,
    points_inside,
    points_on_edges,
    soup,
    street,
    streets,
    unit,
    vehicle,
    vertices_of,
)


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
        targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
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


def coplanar_faces(rng, quick):
    """Boxes that touch, that overlap with sides in one plane, and that stand within each other side by side."""
    first = cuboid([-4.0, 6.0, 0.0], [1.0, 8.0, 2.0])
    others = (
        ([1.0, 6.0, 0.0], [5.0, 8.0, 2.0]),
        ([-1.0, 6.0, 0.0], [3.0, 8.0, 2.0]),
        ([-2.0, 6.0, 0.5], [0.0, 7.0, 2.0]),
    )
    for low, high in others:
        triangles = np.concatenate([first, cuboid(low, high)])
        targets = np.concatenate([vertices_of(triangles), *(points_on_edges(rng, triangles) for _ in range(5))])
        yield from aimed(rng, triangles, np.concatenate([targets, points_inside(rng, triangles)]), quick)


def duplicate_faces(rng, quick):
    """Every triangle twice, and once more inside out."""
    for detail in DETAILS[:2]:
        once = street(detail, 0.13)
        targets = np.concatenate([vertices_of(once), points_on_edges(rng, once)])
        yield from aimed(rng, np.concatenate([once, once]), targets, quick, mounts=MOUNTS_M[:2])
        yield from aimed(rng, np.concatenate([once, once[:, ::-1]]), targets, quick, (False,), MOUNTS_M[:2])


def degenerate_triangles(rng, quick):
    """A street with points, lines and folded triangles strewn among its own."""
    whole = street("body", 0.13)
    collapsed = whole.copy()
    collapsed[::3, 1:] = collapsed[::3, :1]
    collapsed[1::3, 2] = collapsed[1::3, 1]
    collapsed[2::3, 2] = 0.3 * collapsed[2::3, 0] + 0.7 * collapsed[2::3, 1]
    triangles = np.stack([collapsed, whole], axis=1).reshape(-1, 3, 3)
    yield from aimed(rng, triangles, np.concatenate([vertices_of(whole), points_on_edges(rng, whole)]), quick)


def needles(rng, quick):
    """Along the long side that two needles share, and at their tips."""
    for tip_rad in (2e-2, 1e-3, 1e-5, 1e-7):
        for _ in range(2 if quick else 8):
            triangles = lens(tip_rad) @ rotation_matrix(*rng.uniform(-1.2, 1.2, 3)) + [0.0, 60.0, 0.0]
            along = rng.uniform(0.0, 1.0, (200, 1))
            targets = np.concatenate([triangles[0, 0] + along * (triangles[0, 1] - triangles[0, 0]), triangles[0]])
            yield Attack(triangles, False, np.zeros(3), unit(targets))


def fans_of_needles(rng, quick):
    """Cones whose hundreds of needles meet in one tip, closed and seen from outside."""
    for sides, height in ((12, 2.0), (200, 2.0), (800, 0.01)):
        turn = 2.0 * np.pi * np.arange(sides) / sides
        rim = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides)])
        after, tip, foot = np.roll(rim, -1, axis=0), np.zeros((sides, 3)), np.zeros((sides, 3))
        tip[:, 2] = height
        cone = np.concatenate([np.stack([rim, after, tip], axis=1), np.stack([after, rim, foot], axis=1)])
        cone = cone @ rotation_matrix(*rng.uniform(-0.4, 0.4, 3)) + [3.0, 12.0, 0.5]
        targets = np.concatenate([points_on_edges(rng, cone), points_inside(rng, cone), np.repeat(cone[:1, 2], 20, 0)])
        yield from aimed(rng, cone, targets, quick)


def small_triangles(rng, quick):
    """Triangles of a millimetre to a decimetre, ten metres to a kilometre away."""
    for away in (10.0, 100.0, 1000.0):
        for side in (1e-3, 1e-2, 1e-1):
            triangles = unit(rng.normal(size=(60 if quick else 300, 3)))[:, None] * away
            triangles = triangles + rng.normal(scale=side, size=(len(triangles), 3, 3))
            targets = np.concatenate([triangles.mean(axis=1), points_on_edges(rng, triangles), vertices_of(triangles)])
            yield Attack(triangles, False, np.zeros(3), unit(targets))


def parallel_sheets(rng, quick):
    """Walls one behind the other, from a decimetre to ten micrometres apart: the first of them counts."""
    wall, behind = cuboid([-20.0, 30.0, 0.0], [20.0, 30.1, 4.0]), np.array([0.0, 1.0, 0.0])
    front = wall[np.abs(wall[:, :, 1] - 30.0).max(axis=1) < 1e-9]
    for gap in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5):
        triangles = np.concatenate([front + 2 * gap * behind, front + gap * behind, front])
        targets = np.concatenate([points_on_edges(rng, front) for _ in range(30)])
        targets = np.concatenate([targets, *(points_inside(rng, front) for _ in range(60))])
        for origin in MOUNTS_M[:2]:
            yield Attack(triangles, False, origin, unit(targets - origin))


def triangle_soup(rng, quick):
    """Triangles anyhow, at their edges and corners."""
    for side in (0.1, 1.0, 5.0):
        triangles = soup(rng, 120, side, 15.0)
        targets = np.concatenate([vertices_of(triangles), points_on_edges(rng, triangles)])
        yield from aimed(rng, triangles, targets, quick, (False,), np.array([[0.0, 0.0, 40.0], [0.0, 0.0, 0.0]]))


ON_TRIANGLES = (
    vertices,
    edges,
    grazing,
    grazing_a_floor,
    grazing_a_box_around_another,
    coplanar_faces,
    duplicate_faces,
    degenerate_triangles,
    needles,
    fans_of_needles,
    small_triangles,
    parallel_sheets,
    triangle_soup,
)
