"""Forms in pairs: small scenes that between them put every two forms of a scene together.

All go through evaluate, scan, dataset, build, Python and the panel, and some through optimise.

`python -m tests.test_forms --write` computes their golden values anew. Do so only where numbers are meant to change.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

import blender_lidar as bl
from blender_lidar.casting import is_available
from blender_lidar.cli import main
from blender_lidar.clouds.files import read_cloud
from blender_lidar.errors import InputError
from blender_lidar.run import what_if
from blender_lidar.run.folder import RunFolder
from blender_lidar.scene.mounting import COORDINATES, Layout
from blender_lidar.scene.scenario import load_scenario, scenario_of
from blender_lidar.scene.site import Site, lidars_of, prepare
from blender_lidar.world.meshes import BUILDING, ROAD
from tests.forms import BOX, FACTORS, NO_ROAD_HAS, REFUSED, USUAL, covering, house_of, write_form
from tests.small_scene import CASTER, cli, without_charts, without_times

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

FORMS = covering(FACTORS, {*REFUSED, *NO_ROAD_HAS})
IDS = ["-".join(form.values()) for form in FORMS]
GOLDEN = Path(__file__).with_name("golden_forms.json")
needs_bpy = pytest.mark.skipif(not is_available("bvh"), reason="needs bpy")


def write_blend(path: Path, house: Mapping) -> None:
    """A house as a file of Blender's."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=house["centre_m"])
    bpy.context.object.scale = house["size_m"]
    bpy.ops.wm.save_as_mainfile(filepath=str(path), copy=True)


class Formed:
    """A scene in some forms, and a mounting of each of its LiDARs within their bounds."""

    def __init__(self, form: Mapping[str, str], folder: Path) -> None:
        self.form, self.folder, self.path = form, folder, write_form(folder, form)
        if form["scenery"] == "blend":
            write_blend(folder / "house.blend", house_of(form))
        self.scenario = load_scenario(self.path)

    @cached_property
    def site(self) -> Site:
        """It made ready."""
        return prepare(self.scenario)

    @property
    def layout(self) -> Layout:
        found = []
        for number, lidar in enumerate(self.scenario.lidars):
            places = lidar.deployment.places
            place = places[number % len(places)]
            found.append(place.mounting([0.4 * low + 0.6 * high for low, high in place.bounds.values()]))
        return tuple(found)

    def coordinates(self, layout: Layout | None = None) -> dict[str, dict[str, float]]:
        """Those of each LiDAR by its name, of which the short form has none."""
        tables = (mounting.as_table() for mounting in layout or self.layout)
        names = (lidar.name for lidar in self.scenario.lidars)
        return {name: {key: table[key] for key in COORDINATES} for name, table in zip(names, tables, strict=True)}

    def words(self, layout: Layout | None = None) -> list[str]:
        """The same as options."""
        given = self.coordinates(layout)
        if "" in given:
            return [f"--{key.rpartition('_')[0].replace('_', '-')}={value!r}" for key, value in given[""].items()]
        pairs = {name: ",".join(f"{key}={value!r}" for key, value in own.items()) for name, own in given.items()}
        return [word for name, own in pairs.items() for word in ("--lidar", f"{name},{own}")]


@pytest.fixture(autouse=True, scope="module")
def one_mix():
    """Look at one mix of other traffic: all of them take longer than the runs, and have tests of their own."""
    mixes = what_if.mixes
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(what_if, "mixes", lambda *given: mixes(*given)[:1])
        yield


@pytest.fixture(scope="module", params=FORMS, ids=IDS)
def formed(request, tmp_path_factory) -> Formed:
    return Formed(request.param, tmp_path_factory.mktemp("form"))


@pytest.fixture(scope="module")
def evaluated(formed) -> RunFolder:
    """What the command line makes of the scene's mountings."""
    out = formed.folder / "run"
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["evaluate", str(formed.path), *formed.words(), "--out", str(out)]) == 0
    return RunFolder(out)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def unlike(one: object, other: object, name: str = "") -> Iterator[tuple[str, object]]:
    """Where two results differ by more than a ray that rounding decides, a thousandth."""
    if isinstance(one, dict):
        for key in one.keys() | other.keys():
            yield from unlike(one.get(key), other.get(key), f"{name}/{key}".lstrip("/"))
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for number, pair in enumerate(zip(one, other, strict=True)):
            yield from unlike(*pair, f"{name}[{number}]")
    elif one != other and not (isinstance(one, float) and one == pytest.approx(other, rel=1e-3, abs=1e-6)):
        yield name, (one, other)


# --- What no scene is -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pair", REFUSED, ids="-".join)
def test_forms_that_do_not_go_together_are_refused_in_one_line(pair, tmp_path):
    form = {name: next((one for one in pair if one in values), USUAL[name]) for name, values in FACTORS.items()}
    with pytest.raises(InputError, match=REFUSED[pair]) as caught:
        load_scenario(write_form(tmp_path, form))
    assert "\n" not in str(caught.value)


# --- What every scene is ----------------------------------------------------------------------------------------------


def test_a_scene_written_out_is_the_scene(formed):
    again = scenario_of(formed.scenario.with_whole_paths())
    assert again.as_tables() == formed.scenario.as_tables() | {"traffic": again.as_tables()["traffic"]}
    assert again.lidars == formed.scenario.lidars
    keys = [[(one.key, one.max_range_m) for one in lidars_of(of)] for of in (again, formed.scenario)]
    assert keys[0] == keys[1]  # of all draws


def told_of(run: RunFolder) -> dict[str, object]:
    """Golden values of a run: returns and occupancy of each vehicle, and which are detectable."""
    rows = rows_of(run.file("vehicles.csv"))
    shares = [round(sum(float(row[f"p_{side}"]) for side in ("top", "side", "front")), 6) for row in rows]
    detectable = "".join(row["detectable"] for row in rows)
    return {"points": [int(row["points"]) for row in rows], "occupancy": shares, "detectable": detectable}


def test_every_vehicle_is_seen_as_it_was(formed, evaluated):
    golden, found = json.loads(GOLDEN.read_text(encoding="utf-8"))["-".join(formed.form.values())], told_of(evaluated)
    assert found["points"] == golden["points"]
    assert found["detectable"] == golden["detectable"]
    assert found["occupancy"] == pytest.approx(golden["occupancy"], abs=2e-6)


def test_python_judges_as_the_command_line_does(formed, evaluated):
    site, given = bl.load_scene(formed.path), formed.coordinates()
    run = bl.judge_mounting(site, **given[""]) if "" in given else bl.judge_layout(site, **given)
    assert without_times(json.loads(json.dumps(run.result))) == without_times(evaluated.result)


def test_clouds_have_the_points_that_the_run_counted_and_say_what_the_others_lie_on(formed, evaluated, capsys):
    rows = rows_of(evaluated.file("vehicles.csv"))
    frame = rows[0]["frame"]
    words = ("--frame", frame, *formed.words(), "--out", formed.folder / "cloud.npz")
    code, _, err = cli(capsys, "scan", formed.path, *words)
    assert code == 0, err
    cloud, _ = read_cloud(formed.folder / "cloud.npz")
    for row in (row for row in rows if row["frame"] == frame):
        assert (cloud.vehicle_id == int(row["vehicle_id"])).sum() == int(row["points"])
    standing = cloud.xyz[(cloud.vehicle_id < 0) & (cloud.surface != ROAD)]
    assert len(standing) == 0 or formed.form["scenery"] != "none"
    if formed.form["scenery"] == "box":
        assert set(cloud.surface[cloud.vehicle_id < 0]) <= {ROAD, BUILDING}
    if formed.form["scenery"] in ("box", "mesh", "blend"):  # the same house
        off = np.abs(standing[:, :2] - BOX["centre_m"][:2]) - 0.5 * np.array(BOX["size_m"][:2])
        assert off.max(initial=0.0) < 0.3


def test_the_page_and_the_sheet_tell_the_numbers_of_the_result(formed, evaluated):
    page = " ".join(evaluated.file("report.html").read_text(encoding="utf-8").split())
    result, names = evaluated.result, [lidar.name for lidar in formed.scenario.lidars]
    assert f"{100 * result['holdout']['as_hung']['detectable_share']:.0f}\u00a0%" in page.replace(" %", "\u00a0%")
    for name, one in zip(names, result["lidars"], strict=True):
        sheet = evaluated.file(f"installation_{name}.txt" if len(names) > 1 else "installation.txt").read_text()
        mount, at = one["deployment"], one["pointing"]
        assert f"Height       {mount['height_m']:.2f} m" in sheet
        assert f"On the map   x {at['x_m']:.2f} m, y {at['y_m']:.2f} m" in sheet
        assert f"bearing {at['facing_bearing_deg']:.0f} deg" in sheet
        assert f"{mount['height_m']:.2f}" in page


def test_a_data_set_has_the_boxes_of_its_scene(formed, capsys):
    folder = formed.folder / "set"
    code, _, err = cli(capsys, "dataset", formed.path, "--mountings", 1, "--out", folder, "--json")
    assert code == 0, err
    boxes = [row for path in folder.rglob("boxes/*.csv") for row in rows_of(path)]
    assert any(row["counted"] == "1" and int(row["points"]) > 0 for row in boxes)


@needs_bpy
def test_the_blend_file_has_the_cloud_of_the_scene(formed, capsys):
    import bpy

    from blender_lidar.world.blender.objects import CLOUD, role

    frame = str(formed.site.search[0].frame)
    for verb, name in (("scan", "scanned.npz"), ("build", "scene.blend")):
        words = ("--frame", frame, *formed.words(), "--out", formed.folder / name)
        code, _, err = cli(capsys, verb, formed.path, *words)
        assert code == 0, err
    bpy.ops.wm.open_mainfile(filepath=str(formed.folder / "scene.blend"))
    shown = sum(len(item.data.vertices) for item in bpy.data.objects if role(item) == CLOUD)
    assert shown == len(read_cloud(formed.folder / "scanned.npz")[0])


@needs_bpy
def test_the_panel_judges_as_the_command_line_does(formed, registered_addon):
    import bpy

    from blender_lidar.addon import properties, scenarios

    scene = bpy.context.scene
    scene.blender_lidar.traffic.path = str(formed.path)
    if formed.form["road"] == "driven":
        with pytest.raises(RuntimeError, match="driven: a driven area is made from the traffic; allowed in the panel"):
            bpy.ops.blender_lidar.load()
        return
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    hung = scenarios.layout_of(scene, scenarios.active_lidar(scene))
    words = formed.words(tuple(map(properties.mounting_of, hung)))
    assert bpy.ops.blender_lidar.export_run(directory=str(formed.folder / "panel")) == {"FINISHED"}
    assert main(["evaluate", str(formed.path), *words, "--out", str(formed.folder / "line")]) == 0
    panel, line = (without_times(RunFolder(formed.folder / name).result) for name in ("panel", "line"))
    assert dict(unlike(panel, line)).keys() <= {"scene", "site"}  # what an open file is called
    left = [{path.name for path in (formed.folder / name).iterdir()} for name in ("panel", "line")]
    assert left[0] == left[1] >= {"report.html", "result.json"}


@needs_bpy
def test_in_a_run_of_the_panel_an_object_of_the_open_file_hides_what_a_box_of_a_scene_file_does(
    tmp_path, registered_addon
):
    import bpy

    from blender_lidar.addon import properties, scenarios

    bare, boxed = (Formed(USUAL | {"scenery": name}, tmp_path / name) for name in ("none", "box"))
    scene = bpy.context.scene
    scene.blender_lidar.traffic.path = str(bare.path)
    assert bpy.ops.blender_lidar.load() == {"FINISHED"}
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=BOX["centre_m"])
    bpy.context.object.scale = BOX["size_m"]
    assert bpy.ops.blender_lidar.export_run(directory=str(tmp_path / "panel")) == {"FINISHED"}
    words = bare.words((properties.mounting_of(scenarios.active_lidar(scene)),))
    for formed in (bare, boxed):
        assert main(["evaluate", str(formed.path), *words, "--out", str(formed.folder / "line")]) == 0
    folders = tmp_path / "panel", boxed.folder / "line", bare.folder / "line"
    panel, line, without = ([int(row["points"]) for row in rows_of(folder / "vehicles.csv")] for folder in folders)
    assert panel == line != without


@pytest.mark.skipif(CASTER == "exact", reason="searches by the exact caster take minutes")
@pytest.mark.parametrize("formed", FORMS[::4], ids=IDS[::4], indirect=True)
def test_evaluate_scores_what_optimise_answers(formed, capsys):
    if all(lidar.is_held for lidar in formed.scenario.lidars):
        code, _, err = cli(capsys, "optimise", formed.path, "--out", formed.folder / "searched")
        assert (code, err.count("\n")) == (2, 1)
        return
    assert main(["optimise", str(formed.path), "--out", str(formed.folder / "searched")]) == 0
    code, out, err = cli(
        capsys, "evaluate", formed.path, "--run", formed.folder / "searched", "--out", formed.folder / "again", "--json"
    )
    assert code == 0, err
    found, again = RunFolder(formed.folder / "searched").result, json.loads(out)
    for key in ("objective", "objective_as_hung", "detectable_share", "vehicles"):
        assert found[key] == pytest.approx(again[key], rel=1e-12), key
    assert found["holdout"] == again["holdout"]
    rows = [(formed.folder / name / "vehicles.csv").read_bytes() for name in ("searched", "again")]
    assert rows[0] == rows[1]


def write() -> None:
    """Write the golden values of all forms."""
    found = {}
    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        for name, form in zip(IDS, FORMS, strict=True):
            formed = Formed(form, Path(folder) / name)
            assert main(["evaluate", str(formed.path), *formed.words(), "--out", str(formed.folder / "run")]) == 0
            found[name] = told_of(RunFolder(formed.folder / "run"))
    lines = (f"{json.dumps(name)}: {json.dumps(one, separators=(',', ':'))}" for name, one in found.items())
    GOLDEN.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", required=True)
    parser.parse_args()
    write()
