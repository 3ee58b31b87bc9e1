"""The Python interface: it comes to what the command line comes to, and refuses what that refuses."""

from __future__ import annotations

import builtins
import gc
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import blender_lidar as bl
import tests.research  # noqa: F401
from blender_lidar.document import ANSWER, DOUBT
from blender_lidar.errors import InputError
from blender_lidar.run.folder import RunFolder
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.scene.scenario import load_scenario
from rival_metrics import OPTIONS
from tests.small_scene import CASTER, done, write_scene

pytestmark = pytest.mark.versions

ROOT = Path(__file__).parents[1]
MAPPED = {"deployment": {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}}


@pytest.fixture
def site(tmp_path):
    return bl.load_scene(write_scene(tmp_path, MAPPED), particles=4, iterations=3, workers=1)


def boxes_table(rows=1, **changed):
    """A table of cars, in the columns that are needed."""
    table = {"frame": 1, "vehicle_id": 1, "class": "car", "x_m": 9.0, "y_m": 4.0, "heading_deg": 0.0}
    table |= {"length_m": 4.4, "width_m": 1.8, "height_m": 1.5}
    return {name: [value] * rows for name, value in table.items()} | changed


def rows_of(table):
    return {name: np.asarray(table[name]) for name in table}


def test_importing_costs_nothing_until_something_is_asked_for():
    program = "import sys, blender_lidar as bl; print('numpy' in sys.modules, 'load_scene' in dir(bl))"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "False True\n"
    with pytest.raises(AttributeError, match="nonsense"):
        _ = bl.nonsense


def test_a_search_comes_to_what_the_command_line_comes_to(tmp_path, site, capsys):
    words = ("--particles", 4, "--iterations", 3, "--workers", 1, "--out", tmp_path / "run")
    done(capsys, "optimise", tmp_path / "scene.toml", *words)
    message = RunFolder(tmp_path / "run")
    run = bl.best_mounting(site)
    assert run.complete
    assert run.mounting == {key: message.result["deployment"][key] for key in COORDINATES}
    assert {key: value for key, value in run.result.items() if key not in ("seconds", "notes")} == {
        key: value for key, value in message.result.items() if key not in ("seconds", "notes")
    }
    for name, column in rows_of(run.vehicles).items():
        np.testing.assert_array_equal(column, message.optimised[name])
    told = message.document.of(DOUBT, ANSWER, first=True)
    assert all(one.text.rstrip(".") in str(run) for one in told)
    assert len(run.history["objective"]) == message.result["evaluations"]
    assert np.max(run.history["objective"]) == pytest.approx(message.result["objective"])


def test_scores_of_one_of_many_and_of_a_judged_mounting_agree(site):
    many = rows_of(bl.score_mountings(site, [{"height_m": 3.0, "tilt_x_deg": 10}, {"height_m": np.float64(4.0)}]))
    one = bl.score_mounting(site, height_m=3.0, tilt_x_deg=10.0)
    assert many["objective"][0] == one.objective
    assert many["detectable_share"][0] == one.detectable_share
    judged = bl.judge_mounting(site, height_m=3.0, tilt_x_deg=10.0)
    assert judged.result["objective"] == one.objective
    columns = {"height_m": [3.0, 4.0], "tilt_x_deg": [10.0, site.scenario.lidar.baseline.as_table()["tilt_x_deg"]]}
    np.testing.assert_array_equal(rows_of(bl.score_mountings(site, columns))["objective"], many["objective"])
    assert bl.score_mounting(site, height_m=3.0, tilt_x_deg=10.0, held_out=True).objective != one.objective


def test_a_mounting_beyond_the_searched_places_meets_all_vehicles_that_matter_to_it(tmp_path, site):
    far = {"x_m": 60.0, "height_m": 4.0, "tilt_x_deg": 15.0}
    assert bl.score_mounting(site, **far).objective == bl.judge_mounting(site, **far).result["objective"]


def test_a_scan_that_is_scored_has_the_occupancies_of_the_scorer(site):
    at = {"height_m": 4.0, "tilt_x_deg": 15.0}
    frame = site.search[0].frame
    scan = bl.scan_frame(site, frame, **at)
    scored = rows_of(bl.score_cloud(scan.cloud.xyz, scan.vehicles, scan.cloud.vehicle_id))
    seen = rows_of(bl.score_mounting(site, **at).vehicles)
    of_frame = seen["frame"] == frame
    row = [scored["vehicle_id"].tolist().index(number) for number in seen["vehicle_id"][of_frame]]
    np.testing.assert_array_equal(scored["points"][row], seen["points"][of_frame])
    np.testing.assert_allclose(scored["entropy_bits"][row], seen["entropy_bits"][of_frame], rtol=1e-12)


def test_a_cloud_is_scored_from_its_file_too(tmp_path, site):
    scan = bl.scan_frame(site, site.search[0].frame, height_m=4.0)
    scan.write(tmp_path / "cloud.npz")
    of_file = rows_of(bl.score_cloud(tmp_path / "cloud.npz", scan.vehicles, metrics=[OPTIONS["log_returns"]]))
    of_arrays = rows_of(bl.score_cloud(scan.cloud.xyz, scan.vehicles, scan.cloud.vehicle_id))
    np.testing.assert_array_equal(of_file["entropy_bits"], of_arrays["entropy_bits"])
    np.testing.assert_allclose(of_file["log_returns"], np.log1p(of_file["points"]))
    assert len(scan.points["x_m"]) == len(scan.cloud)


def test_a_search_that_is_stopped_gives_its_best_so_far_and_can_be_gone_on_with(tmp_path, site):
    calls = []

    def stop(done, total, best):
        calls.append((done, total))
        if done >= 4:
            raise KeyboardInterrupt

    stopped = bl.best_mounting(site, tmp_path / "run", progress=stop)
    assert not stopped.complete
    assert stopped.result["search"] is None
    assert "was stopped" in stopped._repr_html_()
    assert calls[0] == (0, 12)
    again = bl.best_mounting(site, tmp_path / "run", resume=True)
    assert again.complete
    assert again.mounting == bl.best_mounting(site).mounting


def test_a_search_that_is_stopped_before_its_first_batch_is_stopped(site):
    def stop(done, total, best):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bl.best_mounting(site, progress=stop)


def test_the_best_so_far_is_kept_until_its_polish_has_found_any(tmp_path):
    scene = write_scene(tmp_path)
    site = bl.load_scene(scene, particles=4, iterations=2, workers=1, installer="tilt_deg=1")
    message, known = [], []

    def stop(done, total, best):
        message.append(done)
        if len(message) > 2 and done == 0:  # the judging under more errors begins, and has found nothing yet
            raise KeyboardInterrupt
        known.append(best)

    stopped = bl.best_mounting(site, progress=stop)
    whole = bl.best_mounting(site, tmp_path / "whole")
    candidates = np.loadtxt(tmp_path / "whole" / "history_candidates.csv", delimiter=",", skiprows=1)
    assert stopped.mounting["height_m"] == candidates[np.argmax(candidates[:, -2]), 3]
    assert whole.complete
    assert not stopped.complete


def test_a_search_over_fidelities_that_is_stopped_while_it_screens_gives_the_best_that_it_screened(tmp_path):
    site = bl.load_scene(write_scene(tmp_path, MAPPED), fidelity="auto", workers=1)

    def stop(done, total, best):
        if done:
            assert best == ""
            raise KeyboardInterrupt

    stopped = bl.best_mounting(site, progress=stop)
    assert not stopped.complete
    assert stopped.result["objective"] >= 0


def test_a_run_that_is_kept_has_the_files_of_the_command_line_and_a_judged_one_is_no_search(tmp_path, site):
    run = bl.judge_mounting(site, out=tmp_path / "kept", height_m=3.0)
    assert {"report.html", "result.json", "installation.txt"} <= {path.name for path in (tmp_path / "kept").iterdir()}
    assert repr(run) == f"<Run: {run}>"
    with pytest.raises(InputError, match="holds one mounting's evaluation, not a search"):
        bl.best_mounting(site, tmp_path / "kept", resume=True)
    with pytest.warns(UserWarning, match="nothing is stored there to go on with"):
        bl.best_mounting(site, tmp_path / "new", resume=True)


def test_the_folder_of_a_run_that_nobody_keeps_goes_with_it(site):
    run = bl.judge_mounting(site)
    folder = run.path
    assert folder.is_dir()
    del run
    gc.collect()
    assert not folder.exists()


def test_settings_may_be_tables_of_the_scene_file_and_values_of_numpy(tmp_path):
    scene = write_scene(tmp_path, MAPPED)
    tables = {"deployment": {"height_m": np.array([2.0, 3.0])}, "traffic": {"holdout": 0.0}}
    site = bl.load_scene(scene, frame_ids=range(10, 31, 10), seed=np.int64(7), pose_error=None, **tables)
    assert site.scenario.lidar.deployment.places[0].bounds["height_m"] == (2.0, 3.0)
    assert not site.holdout
    assert site.scenario.search.seed == 7
    assert [frame.frame for frame in site.search] == [10, 20, 30]


def test_a_scene_may_be_given_as_its_tables(tmp_path):
    scene = write_scene(tmp_path, MAPPED)
    tables = load_scenario(scene).as_tables()
    tables["lidar"][0]["height_m"] = np.array([2.0, 3.0])
    site = bl.load_scene(tables, workers=1)
    assert site.identity == bl.load_scene(scene, deployment={"height_m": [2.0, 3.0]}, workers=1).identity
    with pytest.raises(InputError, match=r"^load_scene: deployment: height_m: is \[3, 2\]; allowed: the lower"):
        bl.load_scene({"traffic": tables["traffic"], "deployment": {"height_m": (3, 2)}})
    with pytest.raises(InputError, match=r"^load_scene: traffic: path: is missing"):
        bl.load_scene({})


def test_what_is_read_again_is_found_from_another_folder_and_refused_where_it_has_changed(tmp_path, monkeypatch):
    write_scene(tmp_path, MAPPED)
    monkeypatch.chdir(tmp_path)
    site = bl.load_scene("scene.toml", workers=1)
    far = {"x_m": 60.0, "height_m": 4.0}
    here = bl.score_mounting(site, **far).objective
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert bl.score_mounting(site, **far).objective == here
    traffic = tmp_path / "traffic.csv"
    traffic.write_text("\n".join(traffic.read_text().splitlines()[:-1]) + "\n")
    with pytest.raises(InputError, match="is not as it was when the run read it"):
        bl.score_mounting(site, **far)


def test_tables_of_any_kind_are_scored_and_a_scored_one_again(site):
    pandas = pytest.importorskip("pandas")
    rows = [{"height_m": 3.0, "tilt_x_deg": 10.0}, {"height_m": 4.0, "tilt_x_deg": 12.0}]
    scored = bl.score_mountings(site, pandas.DataFrame(rows))
    for table in (iter(rows), [pandas.Series(row) for row in rows], scored):
        np.testing.assert_array_equal(bl.score_mountings(site, table)["objective"], scored["objective"])


def test_a_scan_brings_its_labels_and_boxes_and_a_table_of_boxes_does_as_well(tmp_path, site):
    frame = site.search[0].frame
    scan = bl.scan_frame(site, np.int64(frame), height_m=4.0)
    whole = rows_of(bl.score_cloud(scan))
    vehicles = rows_of(bl.score_mounting(site, height_m=4.0).vehicles)
    boxes = {name: column[vehicles["frame"] == frame] for name, column in vehicles.items()}
    by_table = rows_of(bl.score_cloud(scan, boxes))
    row = [whole["vehicle_id"].tolist().index(number) for number in by_table["vehicle_id"]]
    np.testing.assert_array_equal(by_table["points"], whole["points"][row])
    assert "distance" in rows_of(bl.score_cloud(scan, metrics=[OPTIONS["distance"]], lidar_xy=np.array([0.0, 0.0])))


def test_without_pandas_tables_are_dictionaries_of_arrays(site, monkeypatch):
    found = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "pandas":
            raise ImportError(name)
        return found(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    vehicles = bl.score_mounting(site).vehicles
    assert isinstance(vehicles, dict)
    assert all(isinstance(column, np.ndarray) for column in vehicles.values())


def test_pictures_are_png_and_a_given_mounting_has_no_map(site):
    pytest.importorskip("matplotlib")
    judged = bl.judge_mounting(site, height_m=3.0)
    assert judged.plot.by_distance().startswith(b"\x89PNG")
    assert judged.plot.blind_zones().startswith(b"\x89PNG")
    assert judged.history is None
    assert judged.score_map is None
    with pytest.raises(InputError, match="score_map: the run has none"):
        judged.plot.score_map()
    with pytest.raises(InputError, match="search: the run has no history"):
        judged.plot.search()


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (lambda site: bl.load_scene("i80", colour=1), "load_scene: unknown setting 'colour'"),
        (lambda site: bl.load_scene("i80", frames=-1), "load_scene: frames: is -1; allowed: "),
        (lambda site: bl.load_scene("nowhere"), "nowhere: there is no such file; .*: crossing, .*i80, paper"),
        (
            lambda site: bl.score_mounting(site, height=3),
            "mounting: unknown coordinate 'height'; did you mean 'height_m'",
        ),
        (lambda site: bl.score_mounting(site, height_m=300), "height_m: is 300; allowed: 0.1 to 100"),
        (lambda site: bl.score_mountings(site, []), "score_mountings: the table is empty"),
        (lambda site: bl.score_mountings(site, {"height_m": [2, 3], "tilt_x_deg": [1]}), "allowed: .s,., all of one"),
        (
            lambda site: bl.score_cloud(np.zeros((2, 2)), site.search[0]),
            r"points: shape \(2, 2\); allowed: \(n, 3\)",
        ),
        (lambda site: bl.score_cloud(np.zeros((2, 3)), site.search[0], [1]), r"of shape \(1,\)"),
        (lambda site: bl.score_cloud(np.zeros((1, 3)), boxes_table(x_m=[1, 2]), [1]), r"x_m \(2,\), .*one length"),
        (lambda site: bl.score_cloud(np.zeros((1, 3)), {"frame": [1]}, [1]), "^boxes: .*vehicle_id"),
        (lambda site: bl.score_cloud("a.npz", "b.csv", colour=1), "score_cloud: unknown setting 'colour'"),
        (lambda site: bl.best_mounting(site, resume=True), "resume needs out"),
        (lambda site: bl.best_mounting(site, progress="yes"), "progress: is 'yes'; allowed: True, False or a function"),
        (lambda site: bl.load_scene("i80", frame_ids="a"), "load_scene: frame_ids: 'a'; allowed: frame numbers"),
        (lambda site: bl.score_mountings(site, [{"height_m": 3}, 4]), "row 2: is 4; allowed: a mapping"),
        (lambda site: bl.score_mountings(site, {"height_m": [3, np.nan]}), "row 2: height_m: is nan; allowed"),
        (lambda site: bl.scan_frame(site, "1400"), "frame: is '1400'; allowed: a whole number"),
        (lambda site: bl.score_cloud("a.npz", site.search[0], [1]), "is given beside a file"),
        (
            lambda site: bl.score_cloud(np.zeros((1, 3)), site.search[0], [1], frame=-5),
            "boxes: hold frame .*; allowed: one vehicle or more, of the frame",
        ),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(site, asked, message):
    with pytest.raises((InputError, FileNotFoundError), match=message) as caught:
        asked(site)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(CASTER == "exact", reason="no fast caster is installed")
def test_the_examples_of_the_page_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "reference" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    program = "\n".join(blocks).replace("frames=6", "frames=2, particles=3, iterations=2, workers=1")
    ran = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "Hang it: " in ran.stdout
