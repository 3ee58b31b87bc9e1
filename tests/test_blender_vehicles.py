"""[world.vehicles]: an object or a collection of a .blend file in place of our bodies of a class."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.api import load_scene
from blender_lidar.errors import InputError
from blender_lidar.scene.scenario import load_scenario, scenario_of
from blender_lidar.scene.site import prepare
from blender_lidar.toml_table import to_toml
from blender_lidar.world.blender.bodies import body_of, fit_of, read_body
from blender_lidar.world.blender.objects import new_mesh
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.meshes import GLASS, PAINT, Shape
from blender_lidar.world.shapes import shape
from tests.refusals import refused
from tests.small_scene import cli, done, without_charts, write_scene

pytestmark = pytest.mark.versions


def item(name, made: Shape, scale=(1.0, 1.0, 1.0), at=(0.0, 0.0, 0.0), into=None):
    found = bpy.data.objects.new(name, new_mesh(name, made.vertices, made.faces))
    found.scale, found.location = scale, at
    (into or bpy.context.scene.collection).objects.link(found)
    return found


def collection(name):
    made = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(made)
    return made


@pytest.fixture(scope="module")
def cars(tmp_path_factory):
    """A .blend with a car that faces +x, the same in two parts that faces -y, one as parent and child, and nothing."""
    path = tmp_path_factory.mktemp("cars") / "cars.blend"
    empty_scene()
    car, half = shape("car", "detailed"), len(shape("car", "detailed").faces) // 2
    item("Along x", car, (4.4, 1.8, 1.5), (3.0, 1.0, 7.0))
    turned = Shape(car.vertices[:, [1, 0, 2]] * [1.0, -1.0, 1.0], car.faces, car.surface)  # +x becomes -y
    into = collection("Along y")
    for number, faces in enumerate((turned.faces[:half], turned.faces[half:])):
        item(f"part {number}", Shape(turned.vertices, faces, turned.surface), (1.8, 4.4, 1.5), into=into)
    parent = item("Parent", Shape(car.vertices, car.faces[:half], car.surface), (4.4, 1.8, 1.5))
    item("Child", Shape(car.vertices, car.faces[half:], car.surface)).parent = parent
    collection("Nothing")
    item("Flat", Shape(car.vertices * [1.0, 1.0, 0.0], car.faces, car.surface))
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    empty_scene()
    return path


@pytest.mark.parametrize("size", [(4.0, 2.0, 1.5), (1.0, 4.0, 7.0)])
def test_a_body_fills_the_unit_box_and_faces_ahead(size):
    low = np.array([3.0, -2.0, 10.0])
    high = low + size
    fit = fit_of(low, high)
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * size + low
    placed = corners @ fit[:3, :3].T + fit[:3, 3]
    ends = placed.min(axis=0), placed.max(axis=0)
    np.testing.assert_allclose(ends, (np.full(3, -0.5), np.full(3, 0.5)), atol=1e-12)
    ahead = np.array([1.0, 0.0, 0.0]) if size[0] > size[1] else np.array([0.0, -1.0, 0.0])
    front = (low + high) / 2 + 0.5 * ahead * size
    np.testing.assert_allclose(front @ fit[:3, :3].T + fit[:3, 3], [0.5, 0.0, 0.0], atol=1e-12)
    assert np.linalg.det(fit[:3, :3]) > 0.0  # not mirrored
    bottom = np.array([low[0], low[1], low[2]])
    assert (bottom @ fit[:3, :3].T + fit[:3, 3])[2] == pytest.approx(-0.5)


def test_objects_and_collections_are_read_as_they_are_fitted_and_nothing_stays(cars):
    before = len(bpy.data.objects), len(bpy.data.collections), len(bpy.data.scenes), len(bpy.data.libraries)
    ours = shape("car", "detailed")
    expected = ours.vertices[ours.faces]
    for name in ("Along x", "Along y", "Parent"):
        found = read_body(str(cars), name, "here")
        corners = found.vertices[found.faces]
        assert np.abs(corners).max() == 0.5
        np.testing.assert_allclose(corners, expected, atol=1e-6)
        assert (found.surface == PAINT).all()
    assert (len(bpy.data.objects), len(bpy.data.collections), len(bpy.data.scenes), len(bpy.data.libraries)) == before


def test_glass_of_our_own_materials_stays_glass():
    from blender_lidar.world.blender.objects import glass, plain

    empty_scene()
    into, car = collection("car"), shape("car", "body")
    materials = [plain("any", (0.5, 0.5, 0.5), PAINT), glass()]
    mesh = new_mesh("car", car.vertices, car.faces, materials, car.surface == GLASS)
    into.objects.link(bpy.data.objects.new("car", mesh))
    found = body_of(into, "here").shape
    np.testing.assert_array_equal(found.surface, car.surface)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("cars.blend/Along z", "cars.blend: unknown object or collection 'Along z'; did you mean 'Along "),
        ("cars.blend/Nothing", "Nothing: nothing with faces is visible in it"),
        ("cars.blend/Flat", "Flat: its size is 1, 1, 0; allowed: finite, and none of them 0"),
        ("no.blend/Car", "no.blend: there is no such file"),
        ("cars.blend", "is 'cars.blend'; allowed: such as \"cars.blend/Sedan\""),
        (3, "is 3; allowed: a text in quotes"),
    ],
)
def test_what_is_no_body_is_refused_in_a_line(cars, tmp_path, capsys, value, words):
    (tmp_path / "cars.blend").write_bytes(cars.read_bytes())
    scene = write_scene(tmp_path, {"world": {"vehicles": {"car": value}}})
    line = refused(capsys, tmp_path, "evaluate", scene, "--height", 3, "--out", tmp_path / "run")
    assert words in line
    assert "[world.vehicles] car" in line or "[world] vehicles car" in line


def test_an_unknown_class_is_refused_with_the_nearest(tmp_path):
    with pytest.raises(InputError, match=r"\[world.vehicles\]: unknown key 'cars'; did you mean 'car'\?"):
        load_scenario(write_scene(tmp_path, {"world": {"vehicles": {"cars": "cars.blend/Along x"}}}))


def test_without_blender_a_line_says_what_needs_it(cars, tmp_path, capsys, monkeypatch):
    scene = write_scene(tmp_path, {"world": {"vehicles": {"car": f"{cars}/Along x"}}})
    monkeypatch.setitem(sys.modules, "bpy", None)
    monkeypatch.delitem(sys.modules, "blender_lidar.world.blender.bodies")
    line = refused(capsys, tmp_path, "scan", scene, "--frame", 20, "--height", 3, "--out", tmp_path / "c.npz")
    assert "[world] vehicles car: needs Blender: pip install" in line


def test_settings_come_back_with_whole_paths_and_the_mesh_is_part_of_a_runs_identity(cars, tmp_path, monkeypatch):
    (tmp_path / "cars.blend").write_bytes(cars.read_bytes())
    scene = write_scene(tmp_path, {"world": {"vehicles": {"car": "cars.blend/Along x", "bus": "cars.blend/Parent"}}})
    read = load_scenario(scene)
    assert read.world.bodies["car"] == (str(tmp_path / "cars.blend"), "Along x")
    monkeypatch.chdir("/")
    (tmp_path / "again.toml").write_text(to_toml(read.with_whole_paths()))
    assert load_scenario(tmp_path / "again.toml").world == read.world
    assert scenario_of(read.with_whole_paths()).world == read.world
    one, other = prepare(read).identity, prepare(load_scenario(scene)).identity
    assert one == other
    assert "triangles with SHA-256" in one["[world] vehicles"]["car"]
    assert one["[world] vehicles"]["car"] != one["[world] vehicles"]["bus"]  # which faces lie in which order


def test_a_scene_with_a_car_of_ours_as_own_mesh_is_scored_and_scanned_as_with_ours(cars, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    own = {"vehicles": dict.fromkeys(("car", "van"), f"{cars}/Along y")}
    found = {}
    for name, world, options in (
        ("ours", {"detail": "detailed"}, ()),
        ("own", own | {"detail": "detailed"}, ()),
        ("own by two", own | {"detail": "detailed"}, ("--workers", 2)),
    ):
        scene = write_scene(tmp_path / name, {"world": world})
        done(capsys, "evaluate", scene, "--height", 3, "--out", tmp_path / name / "run", *options)
        found[name] = json.loads((tmp_path / name / "run" / "result.json").read_text())["objective_per_vehicle"]
    assert found["own"] == found["own by two"]
    assert found["own"] == pytest.approx(found["ours"], abs=0.02)  # a van is our car there
    assert load_scene(tmp_path / "own" / "scene.toml").observation.bodies.shapes.keys() == {"car", "van"}
    assert cli(capsys, "scan", scene, "--frame", 20, "--height", 3, "--out", tmp_path / "c.npz")[0] == 0
