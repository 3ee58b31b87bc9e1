"""A site of the user's own, from a file that Blender reads to scores, clouds and pictures."""

from __future__ import annotations

import gzip
import json
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.errors import InputError
from blender_lidar.world.blender import site
from blender_lidar.world.blender.objects import new_mesh
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.blender.site import read_site
from blender_lidar.world.scenery import box
from tests.refusals import refused
from tests.small_scene import cli, done, without_charts, write_scene

pytestmark = pytest.mark.versions

WALL = box("wall", (0.0, 1.0, 2.5), (60.0, 0.2, 5.0))
TURNED = box("wall", (50_000.0 - 1.0, 70.0, 2.5), (0.2, 60.0, 5.0))  # the wall, in a map's frame: x to the north

FOREST = [(float(x), float(y)) for x in range(-60, 61, 5) for y in (-8.0, 1.0, 11.0, 40.0)]  # beside the carriageway


def blend(path, *parts):
    """A .blend with an object for each scenery, and nothing else."""
    scene = empty_scene()
    for part in parts:
        corners = part.corners.reshape(-1, 3)
        middle = corners.mean(axis=0)
        made = bpy.data.objects.new("wall", new_mesh("wall", corners - middle, np.arange(len(corners)).reshape(-1, 3)))
        made.location = middle
        scene.collection.objects.link(made)
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)
    empty_scene()
    return path


def evaluated(capsys, folder, world, *options):
    scene = write_scene(folder, {"world": world})
    done(capsys, "evaluate", scene, "--height", 3, "--out", folder / "run", *options)
    return json.loads((folder / "run" / "result.json").read_text())


def test_a_wall_from_a_blend_hides_what_a_wall_of_the_scene_hides(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    blend(tmp_path / "wall.blend", box("low", (0.0, 1.0, 1.0), (60.0, 0.2, 2.0)))
    boxes = [{"centre_m": [0.0, 1.0, 1.0], "size_m": [60.0, 0.2, 2.0]}]
    written = evaluated(capsys, tmp_path / "written", {"boxes": boxes})
    for name, options in (("read", ()), ("read by two", ("--workers", 2)), ("read for bvh", ("--caster", "bvh"))):
        read = evaluated(capsys, tmp_path / name, {"blend": str(tmp_path / "wall.blend")}, *options)
        assert read["objective_per_vehicle"] == pytest.approx(written["objective_per_vehicle"], abs=1e-6)
        assert read["versions"]["bpy"]
    free = evaluated(capsys, tmp_path / "free", {})
    assert written["objective_per_vehicle"] < free["objective_per_vehicle"]


def test_a_site_is_moved_and_turned_into_the_road_frame(tmp_path, capsys):
    blend(tmp_path / "map.blend", TURNED)
    world = {"blend": str(tmp_path / "map.blend"), "origin_m": [50_000.0, 70.0, 0.0], "heading_deg": 90.0}
    scene = write_scene(tmp_path, {"world": {**world, "ground": False}})
    assert cli(capsys, "scan", scene, "--frame", 20, "--height", 3, "--out", tmp_path / "c.npz")[0] == 0
    with np.load(tmp_path / "c.npz") as cloud:
        wall = cloud["xyz"][cloud["vehicle_id"] < 0]
        assert len(wall) > 100
        np.testing.assert_allclose(wall[:, 1], 0.9, atol=0.005)  # float32 in the file: 50 km


def test_a_site_that_lies_elsewhere_is_refused_with_where_it_lies(tmp_path, capsys):
    blend(tmp_path / "map.blend", TURNED)
    scene = write_scene(tmp_path, {"world": {"blend": str(tmp_path / "map.blend")}})
    line = refused(capsys, tmp_path, "evaluate", scene, "--out", tmp_path / "run")
    assert "nothing of it lies within 20 m of the mount at x 0, y 0 m" in line
    assert "spans x 49998.9 to 49999.1" in line
    assert not (tmp_path / "run").exists()


def write_obj(path, corners, axes=(0, 1, 2), signs=(1.0, 1.0, 1.0), by=1.0):
    """Triangles (n, 3, 3) as an .obj whose axes are these of ours."""
    points = by * (corners.reshape(-1, 3)[:, axes] * signs)
    rows = [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in points.tolist()]
    rows += [f"f {3 * row + 1} {3 * row + 2} {3 * row + 3}" for row in range(len(points) // 3)]
    path.write_text("\n".join(rows) + "\n")
    return str(path)


def test_an_obj_with_y_up_is_read_and_one_with_z_up_where_the_scene_says_so(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    wall = box("wall", (0.0, 1.2, 1.3), (60.0, 0.4, 2.6))
    boxes = [{"centre_m": [0.0, 1.2, 1.3], "size_m": [60.0, 0.4, 2.6]}]
    written = evaluated(capsys, tmp_path / "written", {"boxes": boxes})
    y_up = write_obj(tmp_path / "y_up.obj", wall.corners, (0, 2, 1), (1.0, 1.0, -1.0))
    z_up = write_obj(tmp_path / "z_up.obj", wall.corners)
    for name, world in (("y", {"mesh": y_up}), ("said", {"mesh": y_up, "up": "y"}), ("z", {"mesh": z_up, "up": "z"})):
        read = evaluated(capsys, tmp_path / name, world)
        assert read["objective_per_vehicle"] == pytest.approx(written["objective_per_vehicle"], abs=1e-6)
        assert read["scenery"]["z_m"] == pytest.approx([0.0, 2.6], abs=1e-6)
    scene = write_scene(tmp_path, {"world": {"mesh": z_up}})
    line = refused(capsys, tmp_path, "evaluate", scene, "--out", tmp_path / "run")
    assert 'z_up.obj: does not say which axis is up; with [world] up = "y" it has z 1.0 to 1.4 m' in line
    assert 'with "z" z 0.0 to 2.6 m' in line


def test_scenery_in_large_coordinates_under_the_road_or_in_millimetres_is_refused(tmp_path, capsys):
    wall = box("wall", (0.0, 1.2, 1.3), (60.0, 0.4, 2.6)).corners
    deep = box("wall", (0.0, 1.2, -3.0), (60.0, 0.4, 2.6)).corners
    for name, corners, by, origin, said in (
        (
            "map",
            wall + np.array([553_000.0, 5_260_000.0, 0.0]),
            1.0,
            [553_000.0, 5_260_000.0, 0.0],
            "have steps of 0.5 m",
        ),
        ("deep", deep, 1.0, [0.0, 0.0, 0.0], "most of it lies under the road, z -4.3 to -1.7 m"),
        ("mm", wall, 1000.0, [0.0, 0.0, 0.0], "perhaps in millimetres: metres are needed"),
    ):
        mesh = write_obj(tmp_path / f"{name}.obj", corners, by=by)
        scene = write_scene(tmp_path / name, {"world": {"mesh": mesh, "up": "z", "origin_m": origin}})
        assert said in refused(capsys, tmp_path, "evaluate", scene, "--out", tmp_path / "run")


def test_of_a_forest_only_the_trees_within_reach_are_made_real(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    path = blend(tmp_path / "forest.blend", *(box("tree", (x, y, 2.0), (0.4, 0.4, 4.0)) for x, y in FOREST))
    made = []
    original = site.visible_triangles
    monkeypatch.setattr(site, "visible_triangles", lambda *words: made.append(original(*words)) or made[-1])
    read = evaluated(capsys, tmp_path / "read", {"blend": str(path)})
    near = [(x, y) for x, y in FOREST if np.hypot(*(np.clip(0.0, c - 0.2, c + 0.2) for c in (x, y))) <= 20.0]
    assert 10 < len(near) < len(FOREST) / 3
    assert len(made[0].names) == len(near)
    boxes = [{"centre_m": [x, y, 2.0], "size_m": [0.4, 0.4, 4.0]} for x, y in FOREST]
    written = evaluated(capsys, tmp_path / "written", {"boxes": boxes})
    assert read["objective_per_vehicle"] == pytest.approx(written["objective_per_vehicle"], abs=1e-3)
    assert read["scenery"] == written["scenery"]


def test_a_library_that_is_not_there_is_refused_by_name(tmp_path):
    blend(tmp_path / "lib.blend", WALL)
    empty_scene()
    with bpy.data.libraries.load(str(tmp_path / "lib.blend"), link=True) as (there, here):
        here.objects = there.objects
    bpy.context.scene.collection.objects.link(here.objects[0])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "site.blend"), copy=True)
    empty_scene()
    assert len(read_site(tmp_path / "site.blend")) == 12
    (tmp_path / "lib.blend").unlink()
    with pytest.raises(InputError, match=r"takes objects from .*lib\.blend, which is not there"):
        read_site(tmp_path / "site.blend")


@pytest.mark.parametrize("header", [b"BLENDER-v999rest", b"BLENDER17-01v9901rest"])
@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "gzip"])
def test_a_file_of_a_newer_blender_is_refused_with_both_versions(tmp_path, header, pack):
    (tmp_path / "new.blend").write_bytes(pack(header))
    with pytest.raises(InputError, match=r"written by Blender 9\d?\.\d+, and this is \d\.\d+"):
        read_site(tmp_path / "new.blend")


def test_without_blender_the_extra_that_brings_it_is_named(tmp_path, capsys, monkeypatch):
    blend(tmp_path / "wall.blend", WALL)
    scene = write_scene(tmp_path, {"world": {"blend": str(tmp_path / "wall.blend")}, "model": {"caster": "exact"}})
    for name in [name for name in sys.modules if "world.blender" in name]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(sys.modules["blender_lidar.world"], "blender", None, raising=False)
    monkeypatch.setitem(sys.modules, "bpy", None)
    for words in (("evaluate", scene, "--out", tmp_path / "run"), ("build", scene, "--frame", 1, "--out", "a.blend")):
        assert 'pip install "blender_lidar[blender]"' in refused(capsys, tmp_path, *words)


def test_a_run_is_rendered_and_its_page_shows_the_pictures(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    monkeypatch.setattr("blender_lidar.world.blender.scene.SIZE", (64, 36))
    folder = tmp_path / "run{x}#1"
    scene = write_scene(tmp_path, {"world": {"boxes": [{"centre_m": [5.0, 1.0, 1.0], "size_m": [1.0, 0.5, 2.0]}]}})
    assert cli(capsys, "evaluate", scene, "--height", 3, "--out", folder)[0] == 0
    out, _ = done(capsys, "render", folder, "--samples", 1)
    pictures = sorted(path.name for path in folder.glob("render_*.png"))
    views = ("above", "points", "pole")
    named = [f"render_{name}_{view}.png" for name in ("baseline", "optimised") for view in views]
    assert pictures == sorted([*named, "render_comparison.png"])
    assert all(name in out for name in pictures)
    assert (folder / "report.html").read_text().count("data:image/png") == 6
    shown = {name: _pixels(folder / name) for name in pictures}
    assert shown["render_comparison.png"].shape == (72, 128, 3)
    above = np.concatenate([shown[f"render_{name}_above.png"] for name in ("baseline", "optimised")], axis=1)
    np.testing.assert_allclose(shown["render_comparison.png"][36:], above, atol=1.5 / 255.0)
    assert shown["render_baseline_points.png"].mean() < 0.5 * shown["render_baseline_above.png"].mean()
    done(capsys, "render", folder, "--samples", 1, "--style", "points")
    assert _pixels(folder / "render_comparison.png").shape == (36, 128, 3)


def _pixels(path):
    """Of a picture, (height, width, 3), from the bottom."""
    image = bpy.data.images.load(str(path))
    width, height = image.size
    pixels = np.empty((height, width, 4), np.float32)
    image.pixels.foreach_get(pixels.ravel())
    bpy.data.images.remove(image)
    return pixels[..., :3]


def test_detections_are_built_and_rendered_with_the_mounting_that_they_are_of(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    monkeypatch.setattr("blender_lidar.world.blender.scene.SIZE", (64, 36))
    row = "{},car,{},5,0.7,4,2,1,0,0.5\n"
    header = "frame,class,x_m,y_m,z_m,length_m,width_m,height_m,heading_deg,confidence\n"
    (tmp_path / "own.csv").write_text(header + row.format(20, 3) + row.format(20, 9) + row.format(21, 3))
    (tmp_path / "own_baseline.csv").write_text(header + row.format(20, 3))
    (tmp_path / "far.csv").write_text(header + row.format(10**6, 3))
    words = write_scene(tmp_path), "--height", 3, "--out"
    detections = "--detections", tmp_path / "own.csv"
    for frames, message in ((("--frame", 20), 2), (("--frame", 22), 0), (("--frame-ids", "20:22"), 3)):
        out, _ = done(capsys, "build", *words, tmp_path / "a.blend", *frames, "--no-cloud", *detections)
        assert f", {message} detections" in out
    assert cli(capsys, "evaluate", *words, tmp_path / "run", "--frame-ids", "18:24")[0] == 0
    boxes = []
    monkeypatch.setattr(
        "blender_lidar.world.blender.scene.show_detections", lambda scene, found: boxes.append(found and len(found))
    )
    out, _ = done(capsys, "render", tmp_path / "run", "--samples", 1, *detections)
    assert out.startswith("frame 21: ")
    assert boxes == [None, 1]
    done(capsys, "render", tmp_path / "run", "--samples", 1, "--frame", 20, *detections)
    assert boxes[2:] == [1, 2]
    line = refused(capsys, tmp_path, "render", tmp_path / "run", "--detections", tmp_path / "far.csv")
    assert "far.csv: has no frame of the run" in line
    assert "none.csv: there is no such file" in refused(
        capsys, tmp_path, "build", *words, tmp_path / "a.blend", "--frame", 20, "--detections", tmp_path / "none.csv"
    )


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("render", "none"), "result.json"),
        (("render", "run", "--samples", 0), "--samples: is 0; allowed: 1 to 4096"),
        (("render", "run", "--frame", 10**6), "no frame 1000000"),
        (("build", "scene.toml", "--frame", 1, "--out", "scene.obj"), "allowed: a file name that ends in .blend"),
        (("build", "scene.toml", "--frame", 1, "--out", "no/folder/scene.blend"), "cannot be written"),
        (("build", "scene.toml", "--frame", 9999, "--out", "a.blend"), "--frame"),
    ],
)
def test_what_cannot_be_built_or_rendered_is_refused_in_one_line(tmp_path, capsys, monkeypatch, words, problem):
    without_charts(monkeypatch)
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path)
    if "run" in words:
        assert cli(capsys, "evaluate", "scene.toml", "--out", "run")[0] == 0
    assert problem in refused(capsys, tmp_path, *words)
