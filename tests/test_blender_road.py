"""Mapped roads in Blender: asphalt, footways and paint lie where the map says it, within reach and no farther."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.road.road_map import Junction, Lane, RoadMap
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.objects import frame_of
from blender_lidar.world.blender.road import build_road
from blender_lidar.world.blender.scene import build_scene, empty_scene, render_picture
from tests.blender_session import moment
from tests.test_road_map import arc

pytestmark = pytest.mark.versions

FLAT = map_of(RoadSettings()).surface
HALF_M, WIDTH_M, CYCLE_M, WALK_M, ARM_M = 12.0, 3.25, 1.8, 2.5, 150.0
SIDE = {"vehicles": (0.5 * WIDTH_M, 1.5 * WIDTH_M), "bicycles": (7.4,), "pedestrians": (9.55,)}  # from the middle line
LANE_M = {"vehicles": WIDTH_M, "bicycles": CYCLE_M, "pedestrians": WALK_M}


def crossing(surface=FLAT, arms=4, far_m=ARM_M):
    """Four arms with two lanes, a cycle track and a footway each way, and a junction with its lanes and crossings."""
    lines, lanes, widths = [], [], []

    def add(points, turn, width, *said):
        cos, sin = math.cos(turn), math.sin(turn)
        lines.append(np.array(points, dtype=float) @ [[cos, sin], [-sin, cos]])
        lanes.append(Lane(*said))
        widths.append(width)

    for arm in range(arms):
        turn, ends = 0.5 * math.pi * arm, np.array([[HALF_M, 0.0], [far_m, 0.0]])
        for name, sign in (("out", -1.0), ("in", 1.0)):
            for use, offsets in SIDE.items():
                for t in offsets:
                    line = (ends + np.array([0.0, sign * t]))[:: -1 if name == "in" else 1]
                    leads = (2 * 4 * arms,) if name == "in" else ()  # the first lane of the junction
                    add(line, turn, LANE_M[use], f"{name}{arm}{use}{t}", f"{name}{arm}", "", leads, use)
    add([[-HALF_M, -1.6], [HALF_M, -1.6]], 0.0, WIDTH_M, "across", "across", "J")
    add([[9.0, -8.3], [9.0, 8.3]], 0.0, 3.0, "walk", "walk", "J", (), "pedestrians")
    corners = HALF_M * np.array([(1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)])  # clockwise
    none = np.zeros(len(lines))
    return RoadMap(
        tuple(lines),
        none,
        none,
        np.array(widths),
        none.astype(bool),
        surface,
        lanes=tuple(lanes),
        junctions=(Junction("J", corners, True),),
    )


@pytest.fixture
def scene():
    yield empty_scene()
    empty_scene()


def drawn(scene, road, xy=(0.0, 0.0), reach_m=100.0):
    build_road(scene, road, xy, reach_m)
    scene.view_layers[0].update()
    frame = frame_of(scene)
    assert all(item.parent == frame for item in scene.objects if item != frame)
    return {item.name: item.data for item in scene.objects if item != frame}


def seen_at(scene, xy):
    """Material that one meets first from above."""
    depsgraph = scene.view_layers[0].depsgraph
    found = []
    for x, y in xy:
        hit, _, normal, face, item, _ = scene.ray_cast(depsgraph, (x, y, 50.0), (0.0, 0.0, -1.0))
        assert not hit or normal.z > 0.0
        found.append(item.data.materials[item.data.polygons[face].material_index].name if hit else None)
    return np.array(found)


def along(start, end, step_m=0.25):
    start, end = np.array(start), np.array(end)
    return start + np.arange(0.0, 1.0, step_m / np.hypot(*(end - start)))[:, None] * (end - start)


def test_what_a_map_calls_lane_or_junction_is_drawn_as_what_travels_there(scene):
    road = crossing()
    drawn(scene, road)
    scene.objects["Lane lines"].hide_viewport = True
    scene.view_layers[0].update()
    xy = np.random.default_rng(1).uniform(-65.0, 65.0, (3000, 2))
    at = road.locate(xy)
    edge = np.abs(np.abs(at.t_m) - 0.5 * road.width_m[at.lane]) < 0.05
    in_junction = (np.abs(xy) < HALF_M).all(axis=1)
    walk = in_junction & (np.abs(xy[:, 0] - 9.0) < 1.5) & (np.abs(xy[:, 1]) < 8.3)
    names = {"vehicles": "Asphalt", "bicycles": "Cycle track", "pedestrians": "Footway"}
    expected = np.array([names[road.lanes[lane].use] if lane >= 0 else "Verge" for lane in at.lane], dtype=object)
    expected[in_junction], expected[walk] = "Asphalt", "Footway"
    clear = ~edge & (np.abs(np.abs(xy) - HALF_M).min(axis=1) > 0.05)
    np.testing.assert_array_equal(seen_at(scene, xy[clear]), expected[clear])
    assert set(expected) == {"Asphalt", "Cycle track", "Footway", "Verge"}


def test_sides_are_solid_or_broken_and_stop_lines_lie_where_lanes_enter_the_junction(scene):
    drawn(scene, crossing())

    def painted(start, end):
        return (seen_at(scene, along(start, end)) == "Lane line").mean()

    for sign in (1.0, -1.0):
        assert painted((20.0, sign * WIDTH_M), (92.0, sign * WIDTH_M)) == pytest.approx(0.25, abs=0.03)
        assert painted((20.0, sign * 2.0 * WIDTH_M), (92.0, sign * 2.0 * WIDTH_M)) == 1.0
    assert painted((20.0, 0.0), (92.0, 0.0)) == 1.0
    assert painted((20.0, 9.5), (92.0, 9.5)) == 0.0  # on the footway
    for x in np.arange(-11.5, 12.0, 0.37):
        assert painted((x, -11.9), (x, 11.9)) == 0.0  # within the junction
    assert painted((HALF_M + 0.2, 0.1), (HALF_M + 0.2, 6.4)) == 1.0  # in: traffic keeps to the right
    assert painted((HALF_M + 0.2, -0.1), (HALF_M + 0.2, -6.4)) < 0.1
    assert painted((HALF_M + 0.5, 0.1), (HALF_M + 0.5, 6.4)) < 0.1


def test_where_one_road_goes_on_as_another_there_is_no_stop_line(scene):
    def stops(road):
        return len(drawn(scene, road)["Lane lines"].polygons)

    for arms, signals, lines in ((4, False, 8), (3, False, 6), (2, True, 4), (2, False, 0)):
        road = crossing(arms=arms)
        here = replace(road, junctions=(road.junctions[0]._replace(signalised=signals),))
        nowhere = replace(road, lanes=tuple(lane._replace(leads_to=()) for lane in road.lanes))
        assert stops(here) - stops(nowhere) == lines


def test_a_large_map_is_drawn_within_reach_alone(scene):
    whole = {name: len(mesh.polygons) for name, mesh in drawn(scene, crossing()).items()}
    assert sum(whole.values()) < 300
    endless = drawn(scene, crossing(far_m=50_000.0))
    assert {name: len(mesh.polygons) for name, mesh in endless.items()} == whole
    for name in ("Surface", "Lane lines"):
        places = np.array([vertex.co for vertex in endless[name].vertices])
        assert np.hypot(*places[:, :2].T).max() < 100.0 + 11.0
    assert set(drawn(scene, crossing(), (0.0, 4000.0))) == {"Verge"}


def test_a_bend_is_drawn_along_its_lanes_with_one_broken_line_between(scene):
    road, middle = arc(lanes=2), np.array([0.0, 60.0])
    drawn(scene, road)
    angle = np.linspace(0.02, 1.18, 400)

    def at(radius):
        return seen_at(scene, middle + radius * np.stack([np.sin(angle), -np.cos(angle)], axis=1))

    for radius in (55.0, 56.2, 58.6, 61.5):
        assert set(at(radius)) == {"Asphalt"}
    for radius in (54.6, 61.9):
        assert set(at(radius)) == {"Verge"}
    for radius in (54.77, 61.74):
        assert (at(radius) == "Lane line").all()
    assert (at(58.25) == "Lane line").mean() == pytest.approx(0.25, abs=0.06)


def test_meshes_lie_on_the_surface_of_the_road(scene):
    @dataclass(frozen=True)
    class Hill:
        is_flat: bool = False

        def height(self, xy):
            return 0.04 * xy[..., 0]

    meshes = drawn(scene, replace(crossing(), surface=Hill()))
    for name, most in (("Surface", 0.02), ("Junctions", 0.006), ("Lane lines", 0.021)):
        x, _, z = np.array([vertex.co for vertex in meshes[name].vertices]).T
        assert ((z - 0.04 * x > -1e-4) & (z - 0.04 * x < most)).all()
    lowest = min(vertex.co.z for vertex in meshes["Surface"].vertices)
    assert all(lowest - 0.03 < vertex.co.z < lowest for vertex in meshes["Verge"].vertices)


@dataclass(frozen=True, slots=True, eq=False)
class Driven(RoadMap):
    """A road without lanes: rectangles."""

    def area(self, lanes=None, s_m=None):
        shape = np.array([(0.0, 0.0), (30.0, 0.0), (30.0, 4.0), (0.0, 4.0)])
        return [shape + np.array(move) for move in ((0.0, 0.0), (0.0, 4.0), (900.0, 0.0))]

    def nearest(self, xy):
        return np.array([[5.0, 2.0]])


def test_a_driven_area_without_lanes_is_asphalt(scene):
    none = np.zeros(0)
    road = Driven((), none, none, none, none.astype(bool), FLAT)
    meshes = drawn(scene, road)
    assert set(meshes) == {"Verge", "Surface"}
    assert len(meshes["Surface"].polygons) == 2
    assert seen_at(scene, [(5.0, 2.0), (29.0, 7.0), (5.0, -1.0)]).tolist() == ["Asphalt", "Asphalt", "Verge"]
    build_scene(scene, replace(moment(cloud=False), road=road, pose=Pose(5.0, -6.0, 4.0)))
    looks = np.array(scene.objects["From the pole"].matrix_world)[:3, 2]
    np.testing.assert_allclose(looks[:2] / np.hypot(*looks[:2]), [0.0, -1.0], atol=1e-5)


def test_cameras_look_at_the_junction_and_a_picture_shows_the_roads(scene, tmp_path):
    pose = Pose(-17.0, -17.0, 6.0)
    build_scene(scene, replace(moment(cloud=False, scenery=None), road=crossing(), pose=pose))
    for name in ("From above", "From the pole"):
        camera = np.array(scene.objects[name].matrix_world)
        away = np.array([0.0, 0.0]) - camera[:2, 3]
        assert -camera[:2, 2] @ away > 0.7 * np.hypot(*away)
    pictures = []
    for row, road in enumerate((crossing(), map_of(RoadSettings()))):
        build_scene(scene, replace(moment(cloud=False, scenery=None), road=road, pose=pose))
        render_picture(tmp_path / f"{row}.png", scene, "From above", size=(96, 54), samples=2)
        image = bpy.data.images.load(str(tmp_path / f"{row}.png"))
        pictures.append(np.array(image.pixels[:]))
    assert pictures[0].std() > 0.05
    assert np.abs(pictures[0] - pictures[1]).max() > 0.2
