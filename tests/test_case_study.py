"""The whole case study on a handful of vehicles: what it leaves, how it goes on, and what it refuses."""

from __future__ import annotations

import csv
import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.case_study.clouds import busiest_frame, write_clouds
from blender_lidar.case_study.distance import MEASURES, by_distance, decomposition, measure
from blender_lidar.case_study.identity import study_identity
from blender_lidar.case_study.mountings import baseline_coordinates, coordinates
from blender_lidar.case_study.optima import judged, landscape
from blender_lidar.case_study.output import FILES
from blender_lidar.case_study.published import EVEN, SENSORS
from blender_lidar.case_study.report import report_text
from blender_lidar.case_study.reproduce import reproduce
from blender_lidar.case_study.sites import open_case
from blender_lidar.case_study.variants import AS_THE_SCENE, variants, with_even_beams
from blender_lidar.errors import InputError
from blender_lidar.formats.clouds import read_points
from blender_lidar.moments import mounted_sensor
from blender_lidar.study.evaluation import Evaluator
from blender_lidar.study.stages import StudyFolder
from tests.case_study_run import TINY, Counter, study
from tests.small_scene import MAPPED, without_charts, write_scene

SCRIPT = Path(__file__).parents[1] / "scripts" / "reproduce_paper.py"
WHOLE = {("sensor", "dropout"): (0.0, "test")}
TABLES = ("table2.csv", "fig9.csv", "spacing.csv", "sensitivity.csv", "report.md", "case_study.json")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"), MAPPED)


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory):
    """A study that nothing stopped: its folder and its result, without pictures."""
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        out = tmp_path_factory.mktemp("study") / "run"
        result, written = study(scene, out)
    return out, result, written


def table(path):
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def test_it_leaves_what_it_names(finished):
    out, result, written = finished
    assert {name for name in written if not name.startswith("no pictures")} == {
        path.relative_to(out).as_posix()
        for path in out.rglob("*")
        if path.is_file() and path.parent.name != "stages" and path.name != "study.json"
    }
    assert written[-1].startswith("no pictures: charts need matplotlib")
    assert json.loads((out / "case_study.json").read_text()) == json.loads(json.dumps(result))


def test_table_2_holds_each_sensor_beside_the_paper(finished):
    out, result, _ = finished
    rows = table(out / "table2.csv")
    assert [row["sensor"] for row in rows] == list(SENSORS)
    assert [float(row["paper_tilt_deg"]) for row in rows] == [19.0, 13.0, 9.0]
    for row in rows:
        of = result["sensors"][row["sensor"]]
        values = np.array(of["map"]["per_vehicle"])
        at = np.unravel_index(values.argmax(), values.shape)
        assert float(row["height_m"]) == of["map"]["height_m"][at[0]]
        assert float(row["tilt_deg"]) == of["map"]["tilt_deg"][at[1]]
        assert float(row["searched_optimised_bits"]) == values.max()
        assert float(row["tilt_low_deg"]) <= float(row["tilt_deg"]) <= float(row["tilt_high_deg"])
        gain = float(row["heldout_optimised_bits"]) - float(row["heldout_baseline_bits"])
        assert gain == pytest.approx(float(row["heldout_optimised_gain_bits"]))
        assert of["de_pso"]["evaluations"] == 4  # one iteration of the scene's four particles


def test_fig_9_adds_up_to_what_the_verdict_says_of_all_vehicles(finished):
    _, result, _ = finished
    for sensor in SENSORS:
        of = [row for row in result["fig9"] if row["sensor"] == sensor]
        held = result["sensors"][sensor]["judged"]["grid"]["holdout"]
        for name, key in (("objective_bits", "objective_per_vehicle"), ("detectable", "detectable_share")):
            bands = [row for row in of if row["measure"] == name]
            whole = bands.pop()
            assert whole["band"] == "all"
            assert whole["optimised"] == pytest.approx(held[key])
            assert whole["vehicles"] == sum(row["vehicles"] for row in bands) == held["vehicles"]
            mean = sum(row["vehicles"] * row["change"]["mean"] for row in bands) / whole["vehicles"]
            assert mean == pytest.approx(whole["change"]["mean"])


def test_the_decomposition_adds_up_and_agrees_with_fig_9(finished):
    _, result, _ = finished
    for row in result["spacing"]:
        mean = {name: of["mean"] for name, of in row.items() if isinstance(of, dict)}
        assert mean["change"] == pytest.approx(mean["change_evenly_spaced"] + mean["spacing"])
        assert mean["change_evenly_spaced"] == pytest.approx(mean["height_evenly_spaced"] + mean["tilt_evenly_spaced"])
        assert mean["place_evenly_spaced"] == 0.0
        assert mean["spacing"] == pytest.approx(mean["spacing_at_optimum"] - mean["spacing_at_baseline"])
        key = (row["band"], row["measure"])
        changes = {of["sensor"]: of["change"]["mean"] for of in result["fig9"] if (of["band"], of["measure"]) == key}
        assert mean["change"] == pytest.approx(changes["RS-80"])
        assert mean["change_evenly_spaced"] == pytest.approx(changes[EVEN])


def test_every_setting_is_varied_for_every_sensor_and_what_the_traffic_does_not_allow_says_why(finished):
    out, result, _ = finished
    rows = result["sensitivity"]
    common = {"setback", "place along the road", "region", "range gate", "azimuth step", "azimuth phase", "abs(C)"}
    common |= {AS_THE_SCENE, "C as printed:", "view of Eq. 11", "vehicle shapes", "reading of Eqs. 8 and 10"}
    for sensor in SENSORS:
        assert {row["what"] for row in rows if row["sensor"] == sensor} - {"beam table"} == common
    for row in rows:
        assert (row["height_m"] is None) == bool(row["note"])
    away = [row for row in rows if row["what"] == "place along the road"]
    assert all("no vehicle" in row["note"] for row in away)  # the vehicles are seen over 80 m alone
    assert len(table(out / "sensitivity.csv")) == len(rows)


def test_a_higher_loss_makes_the_same_vehicles_count_more(finished):
    _, result, _ = finished
    for sensor in SENSORS:
        of = {row["value"]: row for row in result["sensitivity"] if row["sensor"] == sensor and row["what"] == "abs(C)"}
        baselines = [of[loss]["baseline_bits"] for loss in ("0", "0.5", "2", "4")]
        missed = 1.0 - of["0"]["detectable_baseline"]
        np.testing.assert_allclose(np.diff(baselines), -missed * np.array([0.5, 1.5, 2.0]), atol=1e-12)


def test_clouds_are_those_of_the_busiest_judging_frame(finished, scene):
    out, _, _ = finished
    site = open_case(str(scene), {}, TINY).site("RS-16")
    assert busiest_frame(site).counted.sum() == max(frame.counted.sum() for frame in site.holdout)
    for sensor in SENSORS:
        for name in ("baseline", "optimised"):
            points, vehicle_id = read_points(out / "clouds" / f"{sensor.lower()}_{name}.pcd")
            assert len(points) > 1000
            assert (vehicle_id >= 0).any()


def test_clouds_are_those_that_the_scene_s_own_sensor_scans_with_what_makes_it_imperfect(tmp_path):
    changes = {
        "sensor": {"name": "RS-16", "rotation_hz": 20.0, "range_gate_m": 20.0, "dropout": 0.3, "range_noise_m": 0.02},
        "world": {"ground": False, "boxes": [{"name": "sign", "centre_m": [5, 1, 2], "size_m": [0.5, 0.5, 4]}]},
        "baseline": {"y_m": -1.0},
    }
    case = open_case(str(write_scene(tmp_path, MAPPED | changes)), {}, TINY)
    site = case.site("RS-16")
    mounts = {"baseline": baseline_coordinates(site), "optimised": coordinates(site, (4.0, 20.0))}
    assert [mounts[name]["y_m"] for name in mounts] == [-1.0, 0.0]
    names = write_clouds(site, tmp_path / "clouds", mounts)
    vehicles = site.recording.vehicles(busiest_frame(site).vehicles.frame)
    for name, mount in zip(names, mounts.values(), strict=True):
        sensor = mounted_sensor(site.scenario, mount)
        cloud = sensor.scan(vehicles)
        whole = replace(sensor, scenario=case.site("RS-16", WHOLE).scenario).scan(vehicles)
        assert 0.6 < len(cloud) / len(whole) < 0.8
        assert (cloud.vehicle_id == -1).any()  # the sign, as there is no ground
        points, vehicle_id = read_points(tmp_path / name)
        np.testing.assert_array_equal(points, cloud.xyz.astype(np.float32))
        np.testing.assert_array_equal(vehicle_id, cloud.vehicle_id)
        head = (tmp_path / name).read_bytes()[:4000]
        assert b'"dropout": 0.3' in head
        assert json.dumps(mount).encode() in head


def test_the_optimum_is_judged_where_it_was_searched_also_if_the_baseline_hangs_elsewhere(tmp_path):
    elsewhere = {"baseline": {"y_m": -1.5, "x_m": 3.0, "yaw_deg": 20.0}, "traffic": {"frames": 5, "holdout": 0.0}}
    scene = write_scene(
        tmp_path,
        MAPPED | {"traffic": {"path": "traffic.csv"} | elsewhere["traffic"]} | {"baseline": elsewhere["baseline"]},
    )
    case = open_case(str(scene), {}, TINY)
    site = case.site("RS-80")
    found = landscape(site, (2, 2))
    height, tilt, best = found.map.best
    of = {row["measure"]: row for row in by_distance(site, "RS-80", (height, tilt), 1)["bands"] if row["band"] == "all"}
    assert of["objective_bits"]["optimised"] == pytest.approx(best)  # judged on the frames that were searched
    assert of["objective_bits"]["baseline"] == pytest.approx(found.baseline["per_vehicle"])
    scores = judged(site, {"grid": (height, tilt)}, 1)
    assert scores["grid"]["objective_per_vehicle"] == pytest.approx(best)
    assert scores["baseline"]["objective_per_vehicle"] == pytest.approx(found.baseline["per_vehicle"])
    for row in decomposition(site, with_even_beams(site), (height, tilt), 1):
        mean = {name: one["mean"] for name, one in row.items() if isinstance(one, dict)}
        parts = [mean[f"{part}_evenly_spaced"] for part in ("place", "height", "tilt")]
        assert sum(parts) + mean["spacing"] == pytest.approx(mean["change"])
        if (row["band"], row["measure"]) == ("all", "objective_bits"):
            assert mean["change"] == pytest.approx(best - found.baseline["per_vehicle"])
            assert mean["place_evenly_spaced"] != 0.0


def test_settings_are_varied_on_no_more_frames_than_are_searched(scene):
    many = replace(TINY, frames=None, sensitivity_frames=15)
    assert open_case(str(scene), {}, many).effort.sensitivity_frames == 6  # all that the scene searches
    few = {("traffic", "frames"): (4, "--frames")}
    assert open_case(str(scene), few, many).effort.sensitivity_frames == 4
    assert open_case(str(scene), few, replace(many, sensitivity_frames=3)).effort.sensitivity_frames == 3


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        ("identity", "SCHEMA", 0),
        ("identity", "WIDE", {"height_m": (2.0, 9.0)}),
        ("identity", "NEAR_BEST", (0.02,)),
        ("variants", "SETBACKS_M", (0.5, 5.0)),
        ("variants", "REGION_SHARE", 0.6),
        ("identity", "LOSSES", (0.0,)),
    ],
)
def test_a_study_that_was_asked_something_else_is_not_gone_on_with(scene, tmp_path, monkeypatch, module, name, value):
    case = open_case(str(scene), {}, TINY)
    with StudyFolder(tmp_path / "run", study_identity(case)).locked():
        pass
    StudyFolder(tmp_path / "run", study_identity(case)).check(resume=True)
    monkeypatch.setattr(f"blender_lidar.case_study.{module}.{name}", value)
    with pytest.raises(InputError, match="the study there had study"):
        StudyFolder(tmp_path / "run", study_identity(case)).check(resume=True)


def test_a_study_that_was_stopped_comes_to_the_same_files(finished, scene, tmp_path, monkeypatch):
    without_charts(monkeypatch)
    out = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        study(scene, out, Counter("RS-32, de-pso"))
    assert not (out / "case_study.json").exists()
    kept = {path.name: path.stat().st_mtime_ns for path in (out / "stages").iterdir()}
    assert kept
    study(scene, out, resume=True)
    assert all((out / "stages" / name).stat().st_mtime_ns == changed for name, changed in kept.items())
    for name in TABLES:
        assert (out / name).read_bytes() == (finished[0] / name).read_bytes()


def test_what_is_measured_vehicle_by_vehicle_is_what_an_evaluator_sums(scene):
    site = with_even_beams(open_case(str(scene), {}, TINY).site("RS-80"))
    seen = measure(site, coordinates(site, (3.5, 10.0)))
    with Evaluator(site.holdout, site.observation, site.scoring) as evaluator:
        totals = evaluator.totals([site.scenario.deployment.pose((3.5, 10.0))])
    assert seen["objective_bits"].sum() == pytest.approx(totals.objective.sum())
    assert seen["detectable"].sum() == totals.detectable.sum()
    assert {len(seen[name]) for name in (*MEASURES, "distance_m", "block")} == {totals.vehicles.sum()}


def test_a_changed_region_counts_fewer_vehicles_and_a_turned_sensor_sees_along_other_azimuths(scene):
    case = open_case(str(scene), {}, TINY)
    site = case.site("RS-16")
    changed = {(of.what, of.value): of.change(site) for of in variants(site.scenario) if not of.overrides}
    within = next(of for (what, _), of in changed.items() if what == "region")
    for frame, old in zip(within.search, site.search, strict=True):
        assert frame.vehicles is old.vehicles
        distance = np.hypot(*frame.vehicles.centre_m[:, :2].T)
        np.testing.assert_array_equal(frame.counted, old.counted & (distance <= 10.0))
    lattice = site.observation.lattice
    turned = changed["azimuth phase", "0.33 of a step"].observation.lattice
    moved = (turned.slot_azimuth0_rad - lattice.slot_azimuth0_rad) % lattice.step_rad
    np.testing.assert_allclose(moved, lattice.step_rad / 3.0)


def test_blocks_are_as_long_as_the_widest_region_needs(scene):
    gates = {("sensor", "range_gate_m"): (40.0, "test")}
    near, far = (open_case(str(scene), overrides, TINY).block_s for overrides in ({}, gates))
    assert near < far
    case = open_case(str(scene), {}, TINY)
    plans = [case.site(sensor).plan for sensor in SENSORS]
    for plan in plans[1:]:
        np.testing.assert_array_equal(plan.search, plans[0].search)
        np.testing.assert_array_equal(plan.search_block, plans[0].search_block)


def test_without_held_out_frames_the_searched_ones_judge_and_the_report_says_so(scene, tmp_path, monkeypatch):
    without_charts(monkeypatch)
    case = open_case(str(scene), {("traffic", "holdout"): (0.0, "test")}, TINY)
    monkeypatch.setattr("blender_lidar.case_study.reproduce.sensitivity_variants", lambda case: [])
    with StudyFolder(tmp_path / "run", study_identity(case), FILES).locked() as folder:
        result = reproduce(case, folder, Counter())
    text = report_text(result)
    assert f"{len(case.site('RS-16').search)} searched frames in {result['judged_blocks']} blocks of time judge" in text
    assert "(searched frames)" in text
    assert result["sensors"]["RS-16"]["judged"]["grid"]["holdout"] is None


def test_a_scene_that_searches_something_else_is_refused(tmp_path):
    scene = write_scene(tmp_path)  # its tilt is fixed
    with pytest.raises(InputError, match="must be pairs, and they alone"):
        open_case(str(scene), {}, TINY)


@pytest.mark.parametrize("method", [None, "hardened", "grid"])
def test_the_search_is_the_papers_whichever_the_scene_names(tmp_path, method):
    scene = write_scene(tmp_path, MAPPED | {"search": {"method": method}})
    settings = open_case(str(scene), {}, TINY).site("RS-16").scenario.search
    assert (settings.method, settings.inertia) == ("de-pso", 0.7)


def script():
    spec = importlib.util.spec_from_file_location("reproduce_paper", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--traffic", "missing.csv"], "missing.csv"),
        (["--reading", "paper", "--seed", "-1"], "--seed"),
        (["--frames", "0"], "--frames"),
        (["--out", __file__], "is a file"),
    ],
)
def test_wrong_input_is_one_line_and_leaves_nothing(scene, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    assert script().main([str(scene), *words]) == 2
    out, err = capsys.readouterr()
    assert (out, len(err.splitlines())) == ("", 1)
    assert err.startswith("reproduce_paper: ")
    assert said in err
    assert list(tmp_path.iterdir()) == []


def test_a_scene_that_is_not_there_is_one_line(capsys):
    assert script().main(["missing.toml"]) == 2
    assert capsys.readouterr().err == "reproduce_paper: missing.toml: there is no such file\n"
