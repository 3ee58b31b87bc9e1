"""Runs with every metric: what is maximised, stored and shown."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.cli import main
from blender_lidar.errors import InputError
from blender_lidar.metrics.catalogue import METRICS, metric_named
from blender_lidar.metrics.metric import vehicle_returns
from blender_lidar.metrics.vehicle_metrics import TIE_BREAKER
from blender_lidar.plugins import short_name
from blender_lidar.report.html import escaped
from blender_lidar.report.page import minus
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.quantities import amount, quantities
from blender_lidar.run.vehicle_table import METRIC_VALUE, vehicle_table
from blender_lidar.run.words import objective_text
from blender_lidar.scene.mounting import Mast, Mounting
from blender_lidar.scene.observation import Observation, Scoring
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from rival_metrics import OPTIONS as RIVALS
from tests.report_samples import page_of
from tests.sample_traffic import counted_frames
from tests.small_scene import cli, done, without_charts, write_scene

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

SEEN = Observation((Lidar(beam_lattice(load_model("RS-16"), stride=20), 40.0, 0.4),), "exact", "body", 0.05)
MOUNTINGS = [
    Mounting(height_m=2.0),
    Mounting(Mast((1.0, -0.5, 0.0)), 4.1, 0.33),
    Mounting(height_m=3.0, tilt_x=0.1, tilt_y=0.1, yaw=0.4),
]
LAYOUTS, POSES = [(one,) for one in MOUNTINGS], [one.pose for one in MOUNTINGS]
OPTIONS = {"detectable": "detectable", "view-coverage": "view-coverage", **RIVALS}
OTHERS = ("detectable", "number_of_returns", "distance", "ap_entropy")


FRAMES = counted_frames(2)


# --- sums -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*METRICS, *RIVALS.values()])
@pytest.mark.parametrize("loss", [None, -0.25])
def test_the_objective_sums_the_metric_of_each_vehicle_as_it_is_seen_from_each_mounting_alone(name, loss):
    metric, scoring = metric_named(name), Scoring(0.005, "mean", loss, "corrected", name)
    with Evaluator(FRAMES, SEEN, scoring) as evaluator:
        totals = evaluator.totals(LAYOUTS)
    sign = 1.0 if metric.higher_is_better else -1.0
    for column, frame in enumerate(FRAMES):
        scorer, counted = FrameScorer(frame, SEEN), frame.select(frame.counted)
        for row, pose in enumerate(POSES):
            points, vehicle = scorer.vehicle_points(pose)
            distance = np.array([math.dist((x, y), (pose.x_m, pose.y_m)) for x, y, _ in counted.centre_m.tolist()])
            returns = vehicle_returns(points, vehicle, counted.size_m, distance)
            returns = replace(returns, detectable=np.array([sum(p) / 3.0 >= 0.005 for p in returns.occupancy.tolist()]))
            expected = 0.0
            for value, shares in zip(metric.values(returns).tolist(), returns.occupancy.tolist(), strict=True):
                missed = loss is not None and sum(shares) / 3.0 < 0.005
                expected += -0.25 if missed else sign * value
            assert totals.objective[row, column] == pytest.approx(expected, rel=1e-9), (frame, pose)


def test_returns_are_kept_by_mounting_and_vehicle_only_where_they_are_asked_for():
    scorer = FrameScorer(FRAMES[0], SEEN)
    assert scorer.see(singles(POSES)).returns is None
    seen = scorer.see(singles(POSES), keep_returns=True)
    points, row = seen.returns
    np.testing.assert_array_equal(np.bincount(row, minlength=seen.points.size).reshape(seen.points.shape), seen.points)
    for number, pose in enumerate(POSES):
        alone, vehicle = scorer.vehicle_points(pose)
        mine = row // len(scorer) == number
        np.testing.assert_allclose(points[mine], alone, atol=1e-12)
        np.testing.assert_array_equal(row[mine] % len(scorer), vehicle)


def test_the_vehicle_table_has_a_column_for_another_metric_and_none_for_pe_vgop():
    plain, other = (
        vehicle_table(LAYOUTS[1], search=Evaluator(FRAMES, SEEN, Scoring(0.005, "mean", None, "corrected", name)))
        for name in ("pe-vgop", OPTIONS["distance"])
    )
    assert METRIC_VALUE not in plain
    assert set(other) == {*plain, METRIC_VALUE}
    np.testing.assert_allclose(other[METRIC_VALUE], other["distance_m"], rtol=1e-12)
    np.testing.assert_array_equal(other["entropy_bits"], plain["entropy_bits"])


# --- the detectable share ---------------------------------------------------------------------------------------------

GRID = [
    (Mounting(height_m=height, tilt_x=tilt),)
    for height in (2.0, 2.5, 3.0, 3.5, 4.0)
    for tilt in np.linspace(0.0, 0.4, 12)
]


@pytest.mark.parametrize(("threshold", "view"), [(0.005, "mean"), (0.02, "max"), (0.002, "min"), (0.0, "mean")])
def test_the_most_detectable_vehicles_are_the_best_and_bits_break_ties(threshold, view):
    found = {}
    for name in ("detectable", "pe-vgop"):
        with Evaluator(FRAMES, SEEN, Scoring(threshold, view, None, "corrected", name)) as evaluator:
            found[name] = evaluator.totals(GRID)
    vehicles, bits = (found[name].objective.sum(axis=1).tolist() for name in ("detectable", "pe-vgop"))
    share = found["detectable"].detectable.sum(axis=1).tolist()
    ranked = sorted(range(len(GRID)), key=lambda row: (share[row], bits[row]))
    assert sorted(range(len(GRID)), key=lambda row: vehicles[row]) == ranked
    assert len(set(share)) < len(GRID), "no tie was there to break"
    assert found["detectable"].per_vehicle() == pytest.approx(found["detectable"].detectable_share(), abs=2e-8)


def test_all_bits_of_a_run_are_worth_less_than_a_vehicle():
    most = 3.0 * math.log2(math.e) / math.e  # each view's -P log2 P peaks at P = 1/e
    assert 60e6 * most * TIE_BREAKER < 1.0
    vehicles = 100_000
    assert vehicles + 2e-3 * TIE_BREAKER > vehicles


def test_a_share_is_told_in_per_cent_its_differences_in_points_its_sum_in_vehicles():
    share = METRICS["detectable"]
    assert (share.amount(0.6325), share.in_unit("score"), share.unit) == ("63.2 %", "score [%]", "")
    assert share.difference(-0.0625, sign="+") == "-6.2 percentage points"
    assert share.total(117.0000012) == "117 vehicles"
    assert share.shown(np.array([0.5])).tolist() == [50.0]


# --- whole runs -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Searches of three mountings of a small scene with metrics of each kind."""
    folder = tmp_path_factory.mktemp("metrics")
    scene = write_scene(folder, {"traffic": {"frames": 3}, "search": {"method": "random", "iterations": 1}})
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        for name in OTHERS:
            assert main(["optimise", str(scene), "--metric", OPTIONS[name], "--out", str(folder / name)]) == 0
    return folder


def result_of(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", OTHERS)
def test_a_run_says_what_it_maximised(runs, name):
    metric, result = metric_named(OPTIONS[name]), result_of(runs / name)
    assert (result["metric"], result["metric_unit"]) == (OPTIONS[name], metric.unit)
    assert result["metric_higher_is_better"] == metric.higher_is_better
    assert result["identity"]["[objective] metric"].split(",")[0] == short_name(OPTIONS[name])
    sign = 1.0 if metric.higher_is_better else -1.0
    for file, scores in (("vehicles.csv", result), ("vehicles_baseline.csv", result["baseline"])):
        with (runs / name / file).open(newline="") as stream:
            rows = [row for row in csv.DictReader(stream) if row["split"] == "search"]
        values = [sign * float(row["metric_value"]) for row in rows]
        assert scores["objective"] == pytest.approx(sum(values), rel=1e-9)
        assert scores["objective_per_vehicle"] == pytest.approx(sum(values) / len(values), rel=1e-9)
    with (runs / name / "history.csv").open(newline="") as stream:
        history = [float(row["objective"]) for row in csv.DictReader(stream)]
    assert max(history) == pytest.approx(result["objective"], rel=1e-9)


@pytest.mark.parametrize("name", OTHERS)
def test_what_is_told_of_a_run_has_the_metrics_unit_and_no_other(runs, name):
    metric, folder = metric_named(OPTIONS[name]), runs / name
    page, sheet = (folder.joinpath(file).read_text(encoding="utf-8") for file in ("report.html", "installation.txt"))
    assert page_of(RunFolder(folder)) == page
    assert f"objective{metric.per_vehicle or ', mean'}" in page
    assert metric.tells in page
    told, held = quantities(result_of(folder)), result_of(folder)["holdout"]
    gain = amount(metric, "", "", held["gain_over_baseline"], held["interval_90"], signed=True)
    assert gain.unit == ("points" if metric.of_share else metric.unit)
    assert str(told["after"]) in " ".join(sheet.split())
    assert minus(str(told["points" if metric.of_share else "objective"])) in page
    assert escaped(objective_text(result_of(folder))) in page
    if metric.unit != "bits":
        assert "bits" not in page
        assert "bits" not in sheet


def test_a_run_goes_on_with_its_metric_alone(runs, capsys):
    words = ["optimise", runs / "scene.toml", "--out", runs / "number_of_returns", "--resume"]
    code, _, err = cli(capsys, *words, "--metric", "view-coverage")
    assert code == 2
    assert "the run there had [objective] metric = 'rival_metrics.py:number_of_returns, file with" in err
    out, _ = done(capsys, *words, "--metric", OPTIONS["number_of_returns"])
    assert code == 2
    out, _ = done(capsys, "report", runs / "number_of_returns", "--all")
    assert "Objective: the number of returns of every vehicle, detectable or not," in out


def test_the_scene_that_a_run_leaves_has_its_metric(runs):
    again = load_scenario(runs / "ap_entropy" / "scene.toml").objective
    assert (again.metric, again.loss) == (OPTIONS["ap_entropy"], None)


def test_groups_of_vehicles_are_scored_by_the_metric(runs):
    with (runs / "distance" / "vehicles.csv").open(newline="") as stream:
        near = [row for row in csv.DictReader(stream) if row["split"] == "holdout" and float(row["distance_m"]) < 10.0]
    mean = -sum(float(row["distance_m"]) for row in near) / len(near)
    groups = RunFolder(runs / "distance").result["groups"]
    group = next(one for one in groups if (one["by"], one["name"]) == ("distance", "0-10 m"))
    assert group["objective_after"] == pytest.approx(mean, abs=0.001)


def test_a_run_with_another_metric_has_its_charts(tmp_path, capsys, monkeypatch):
    monkeypatch.undo()
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    scene = write_scene(tmp_path, {"traffic": {"frames": 2}})
    code, _, err = cli(
        capsys, "evaluate", scene, "--metric", OPTIONS["ap_entropy"], "--height", 4, "--out", tmp_path / "run"
    )
    assert (code, err) == (0, "")
    assert len(list((tmp_path / "run").glob("*.png"))) == 4
    assert (tmp_path / "run" / "by_distance.png").exists()


def test_a_table_without_the_metric_is_damaged(runs, tmp_path):
    folder = RunFolder(tmp_path)
    for file in (runs / "number_of_returns").iterdir():
        if file.is_file():
            folder.file(file.name).write_bytes(file.read_bytes())
    with folder.file("vehicles.csv").open(newline="") as stream:
        rows = list(csv.reader(stream))
    folder.file("vehicles.csv").write_text("".join(",".join(row[:-1]) + "\n" for row in rows))
    with pytest.raises(InputError, match=r"vehicles.csv: is damaged, or not of this version: has no 'metric_value'"):
        _ = folder.optimised


def test_the_loss_is_minus_one_bit_for_pe_vgop_and_none_for_others_unless_the_scene_sets_it(tmp_path):
    def loss(**objective):
        return load_scenario(write_scene(tmp_path, {"objective": objective})).objective.loss

    assert (loss(), loss(metric="pe-vgop")) == (-1.0, -1.0)
    assert loss(metric="view-coverage") is None
    assert loss(metric="view-coverage", loss=-2.5) == -2.5


@pytest.mark.parametrize(
    ("metric", "loss", "reading", "text"),
    [
        ("pe-vgop", -1.0, "corrected", "the PE-VGOP of every detectable vehicle, minus 1 bit for every other vehicle"),
        (
            "pe-vgop",
            0.5,
            "corrected",
            "the PE-VGOP of every detectable vehicle, minus 0.5 bits for every other vehicle",
        ),
        ("pe-vgop", -1.0, "paper", "Eq. 10 of the paper as printed"),
        ("number_of_returns", None, "paper", "the number of returns of every vehicle, detectable or not"),
        ("distance", None, "corrected", "minus the distance of every vehicle, detectable or not"),
        ("detectable", None, "corrected", "1 for every detectable vehicle, 0 for every other vehicle"),
        ("detectable", -0.5, "corrected", "1 for every detectable vehicle, minus 0.5 for every other vehicle"),
        (
            "number_of_returns",
            -1.0,
            "corrected",
            "the number of returns of every detectable vehicle, minus 1 point for every other vehicle",
        ),
        (
            "sum_of_views",
            1.0,
            "corrected",
            "the sum of the views' occupancies of every detectable vehicle, minus 1 for every other vehicle",
        ),
        (
            "ap_entropy",
            -2.0,
            "paper",
            "Eq. 10 of the paper as printed, with minus the entropy of the position in place of the entropy",
        ),
    ],
)
def test_the_objective_in_words(metric, loss, reading, text):
    result = {"metric": OPTIONS.get(metric, metric), "reading": reading, "identity": {"[objective] loss": loss}}
    assert objective_text(result) == text
