"""Detailed vehicle shapes: what a LiDAR can tell from a plain body, at the size of a real vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.casting import caster_class
from blender_lidar.world.detailed_shapes import detailed_parts
from blender_lidar.world.meshes import GLASS, PAINT, joined
from blender_lidar.world.shapes import SHAPES, shape

pytestmark = pytest.mark.versions

TYPICAL_SIZE = {
    "car": (4.5, 1.8, 1.5),
    "van": (5.0, 1.9, 1.9),
    "truck": (8.0, 2.5, 3.0),
    "long_truck": (16.0, 2.6, 3.8),
    "bus": (12.0, 2.55, 3.2),
    "motorcycle": (2.2, 0.9, 1.4),
    "bicycle": (1.75, 0.6, 1.73),
    "pedestrian": (0.32, 0.6, 1.75),
}
FAR = 50.0
WITH_CABIN = [name for name in SHAPES if name not in ("motorcycle", "bicycle", "pedestrian")]


def across(name, x, z):
    """Rays from the left at places along the vehicle and heights [m]: distance from the middle, inf past all; surface.

    `x` counts from the tail and `z` from the ground; both are laid out as a grid, flattened.
    """
    x, z = map(np.ravel, np.meshgrid(x, z, indexing="ij"))
    mesh = joined(detailed_parts(name))
    hits = caster_class("exact")(mesh.vertices[mesh.faces]).cast(
        np.column_stack([x, np.full_like(x, FAR), z]), np.tile([0.0, -1.0, 0.0], (len(x), 1))
    )
    return np.where(np.isfinite(hits.distance), FAR - hits.distance, -np.inf), mesh.surface[hits.triangle]


def silhouette(name, heights):
    """Whether rays from the side meet the vehicle: places along it from the tail [m], and a column for each height."""
    x = np.arange(0.01, TYPICAL_SIZE[name][0], 0.04)
    return x, np.isfinite(across(name, x, heights)[0]).reshape(len(x), -1)


@pytest.mark.parametrize("name", SHAPES)
def test_the_tables_are_metres_of_a_vehicle_of_typical_size(name):
    mesh = joined(detailed_parts(name))
    np.testing.assert_allclose(mesh.vertices.max(axis=0), np.array(TYPICAL_SIZE[name]) * [1, 0.5, 1], atol=1e-9)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), np.array(TYPICAL_SIZE[name]) * [0, -0.5, 0], atol=1e-9)
    unit = shape(name, "detailed")
    scaled = (unit.vertices + np.array([0.5, 0.0, 0.5])) * TYPICAL_SIZE[name]
    np.testing.assert_allclose(scaled, mesh.vertices, atol=1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_no_triangle_is_a_needle(name):
    mesh = joined(detailed_parts(name))
    corners = mesh.vertices[mesh.faces]
    double_area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    assert (double_area / longest).min() > 0.005  # [m], its least height


@pytest.mark.parametrize("name", SHAPES)
def test_no_part_but_the_wheels_of_trucks_hangs_in_the_air(name):
    """Boxes about the parts, overlapped one to the next, reach from the first part to every other."""
    low, high = (
        np.array([getattr(part.vertices, end)(axis=0) for part in detailed_parts(name)]) for end in ("min", "max")
    )
    if "truck" in name:
        low, high = low[low[:, 2] > 0.01], high[low[:, 2] > 0.01]
    touches = ((low[:, None] < high) & (high[:, None] > low)).all(axis=2)
    reached = np.arange(len(low)) == 0
    for _ in low:
        reached = touches[reached].any(axis=0)
    assert len(low) > 5
    assert reached.all()


@pytest.mark.parametrize("name", SHAPES)
def test_no_two_parts_lie_back_to_back(name):
    """Of two such faces a ray may meet either, and one of them is an inside."""
    parts = detailed_parts(name)
    mesh = joined(parts)
    corners, part = mesh.vertices[mesh.faces], np.repeat(np.arange(len(parts)), [len(each.faces) for each in parts])
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    offset = np.einsum("ti,ti->t", normal, corners[:, 0])
    opposite = (normal @ normal.T < -0.9999) & (np.abs(offset[:, None] + offset) < 0.002) & (part[:, None] != part)
    a, b = np.nonzero(opposite)
    low, high = corners.min(axis=1) - 1e-9, corners.max(axis=1) + 1e-9
    assert not ((low[a] < high[b]) & (low[b] < high[a])).all(axis=1).any()


@pytest.mark.parametrize(
    ("name", "clearance"), [("car", 0.15), ("van", 0.18), ("truck", 0.36), ("long_truck", 0.31), ("bus", 0.30)]
)
def test_a_ray_passes_under_the_body_between_the_axles_and_meets_the_body_above(name, clearance):
    length = TYPICAL_SIZE[name][0]
    y, _ = across(name, np.linspace(0.36, 0.6, 9) * length, [0.02, 0.5 * clearance, clearance])
    assert np.isneginf(y).all()
    y, _ = across(name, np.linspace(0.36, 0.6, 9) * length, [0.25 if length < 6 else 1.14])
    assert (y > 0.8).all()


@pytest.mark.parametrize(
    ("name", "radius"),
    [
        ("car", 0.32),
        ("van", 0.34),
        ("truck", 0.45),
        ("long_truck", 0.5),
        ("bus", 0.48),
        ("motorcycle", 0.31),
        ("bicycle", 0.34),
    ],
)
def test_nothing_but_round_wheels_reaches_the_ground(name, radius):
    heights = np.array([0.05, 0.10, 0.14])
    x, met = silhouette(name, heights)
    wheels = (np.diff(met[:, 0].astype(int)) == 1).sum()
    assert wheels == (5 if name == "long_truck" else 2)
    chord = 2.0 * np.sqrt(radius**2 - (radius - heights) ** 2)
    np.testing.assert_allclose(met.mean(axis=0) * np.ptp(x) / wheels, chord, atol=0.09)  # of flat sides and 4 cm steps


@pytest.mark.parametrize("name", ["car", "van", "bus"])
def test_above_each_wheel_a_slit_separates_it_from_its_arch(name):
    radius = {"car": 0.32, "van": 0.34, "bus": 0.48}[name]
    axles = {"car": (0.9, 3.6), "van": (1.0, 4.05), "bus": (3.3, 9.25)}[name]
    y, _ = across(name, axles, [radius, 2.0 * radius + 0.015, 2.0 * radius + 0.08])
    wheel, slit, body = y.reshape(2, 3).T
    assert (wheel > 0.5 * TYPICAL_SIZE[name][1] - 0.04).all()
    assert (slit < wheel - 0.005).all()
    assert (body > wheel - 0.01).all()


@pytest.mark.parametrize(("name", "gap"), [("truck", (5.4, 5.58)), ("long_truck", (13.2, 13.7))])
def test_between_cargo_box_and_cab_one_looks_through(name, gap):
    y, _ = across(name, np.linspace(*gap, 5), np.linspace(1.3, TYPICAL_SIZE[name][2], 10))
    assert np.isneginf(y).all()
    y, _ = across(name, np.linspace(*gap, 5), [0.8])
    assert (y > 0.3).all()  # the frame joins them


@pytest.mark.parametrize("name", WITH_CABIN)
def test_seen_from_ahead_a_windscreen_lies_between_painted_pillars(name):
    length, width, _ = TYPICAL_SIZE[name]
    mesh = joined(detailed_parts(name))
    caster = caster_class("exact")(mesh.vertices[mesh.faces])
    y, z = map(np.ravel, np.meshgrid(np.linspace(-0.5, 0.5, 101) * width, np.linspace(0.9, 2.6, 35)))
    hits = caster.cast(np.column_stack([np.full_like(y, FAR), y, z]), np.tile([-1.0, 0.0, 0.0], (len(y), 1)))
    surface = np.where(hits.distance < FAR - 0.4 * length, mesh.surface[hits.triangle].astype(int), -1).reshape(35, 101)
    wide = 0
    for row in surface[surface[:, 50] == GLASS]:
        right, left = 50 - np.argmax(row[50::-1] != GLASS), 50 + np.argmax(row[50:] != GLASS)
        assert (row[[right, left]] == PAINT).all()
        assert left - 50 == 50 - right
        wide += left - right > 50
    assert wide >= 5


def test_the_cars_proportions_are_those_of_a_car():
    z = np.arange(0.5, 1.5, 0.02)
    x, met = silhouette("car", z)
    top = np.where(met, z, 0.0).max(axis=1)
    hood = (x > 3.5) & (x < 4.3)
    assert 0.7 < top[hood].min() < top[hood].max() < 1.0
    assert (np.diff(top[hood]) <= 1e-9).all()
    roof = x[top > 1.40]
    assert 1.5 < np.ptp(roof) < 2.2
    screen = (x > 2.75) & (x < 3.25)
    rake = np.degrees(np.arctan(-np.polyfit(x[screen], top[screen], 1)[0]))
    assert 25.0 < rake < 38.0
    y, surface = across("car", [2.3, 1.6], [0.85, 1.0, 1.2])
    assert surface.reshape(2, 3).tolist() == [[PAINT, GLASS, GLASS]] * 2
    assert (np.diff(y.reshape(2, 3)) < 0.0).all()  # the sides lean in towards the roof


def test_roofs_are_cambered_along_and_across():
    for name in ("car", "van", "bus"):
        length, width, height = TYPICAL_SIZE[name]
        mesh = joined(detailed_parts(name))
        caster = caster_class("exact")(mesh.vertices[mesh.faces])
        places = np.array([[0.45, 0.0], [0.3, 0.0], [0.55, 0.0], [0.45, 0.25]]) * [length, width]
        down = np.tile([0.0, 0.0, -1.0], (4, 1))
        z = FAR - caster.cast(np.column_stack([places, np.full(4, FAR)]), down).distance
        assert z[0] > height - 0.01
        assert (z[1:] < z[0] + 1e-9).all()
        assert z[1] < z[0] or z[2] < z[0]
        assert z[3] < z[0] - 0.005


def test_on_the_motorcycle_sits_a_rider():
    x, met = silhouette("motorcycle", [1.395])
    assert abs(x[met[:, 0]].mean() - 1.06) < 0.1  # the helmet, above the seat's front
    y, _ = across("motorcycle", [0.9], [1.1])
    assert 0.1 < y[0] < 0.3  # an arm, or the back
