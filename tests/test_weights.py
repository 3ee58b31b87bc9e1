"""Weights by class and zone: a whole weight is the vehicle counted that often, wherever vehicles are counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.errors import InputError
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.searches import fresh_auto_search
from blender_lidar.run.verdict import map_scores
from blender_lidar.run.words import definitions
from blender_lidar.scene.deployment import SearchSpace
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scene.observation import Observation, Scoring, check_weights, vehicle_weights
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.settings import ObjectiveSettings, ZoneSettings
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator, site_evaluator
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from blender_lidar.statistics import ratio_interval_90
from blender_lidar.studies.driver import AS_IT_IS, Job, landscapes
from tests.sample_traffic import counted_frames, joined, one_vehicle
from tests.small_scene import place_of, without_charts, write_scene

pytestmark = pytest.mark.versions

SEEN = Observation((Lidar(beam_lattice(load_model("RS-16"), stride=20), 40.0, 0.4),), "exact", "body", 0.05)
SCORING = Scoring(0.005, "mean", -1.0, "corrected")
LAYOUTS = [(Mounting(height_m=2.0),), (Mounting(height_m=4.1, tilt_x=0.33),)]
FRAMES = counted_frames(3)
CLASSES = {"car": 1.0, "van": 2.0, "truck": 3.0}
ZONES = [{"name": "left lane", "polygon_m": [[-20.0, 5.5], [20.0, 5.5], [20.0, 9.0], [-20.0, 9.0]], "weight": 2.0}]


def weighed(frame):
    """The frame with weights from 0 to 3."""
    return replace(frame, weight=np.arange(len(frame)) % 4.0)


def test_a_whole_weight_is_the_vehicle_counted_that_often():
    with Evaluator(FRAMES, SEEN, SCORING) as evaluator:
        single = evaluator.by_vehicle(LAYOUTS)
    with Evaluator([weighed(frame) for frame in FRAMES], SEEN, SCORING) as evaluator:
        found = evaluator.totals(LAYOUTS)
    assert found.weight.sum() != found.vehicles.sum()
    for row in range(len(LAYOUTS)):
        rows, detected, vehicles = [], 0, 0
        for frame, scored in zip(FRAMES, single, strict=True):
            times = weighed(frame).weight[frame.counted].astype(int).tolist()
            for value, often, noticed in zip(scored.objective[row], times, scored.detectable[row], strict=True):
                rows += [float(value)] * often
                detected, vehicles = detected + bool(noticed), vehicles + 1
        assert found.objective[row].sum() == pytest.approx(sum(rows), rel=1e-12)
        assert found.per_vehicle()[row] == pytest.approx(sum(rows) / len(rows), rel=1e-12)
        assert found.detectable_share()[row] == detected / vehicles  # whatever they weigh


def test_weights_that_are_all_one_change_no_digit():
    ones = [replace(frame, weight=np.ones(len(frame))) for frame in FRAMES]
    found = []
    for frames in (FRAMES, ones):
        with Evaluator(frames, SEEN, SCORING) as evaluator:
            totals = evaluator.totals(LAYOUTS)
        found.append([totals.objective.tobytes(), totals.per_vehicle().tobytes(), totals.detectable_share().tobytes()])
    assert found[0] == found[1]


def test_a_vehicle_weighs_its_class_times_the_first_zone_that_holds_its_centre():
    square = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
    larger = tuple((3.0 * x, 3.0 * y) for x, y in square)
    zones = tuple(
        ZoneSettings(name=str(weight), polygon_m=polygon, weight=weight)
        for polygon, weight in ((square, 5.0), (larger, 0.5))
    )
    places = {(0.0, 0.0): 5.0, (1.0, 0.3): 5.0, (1.1, 0.3): 0.5, (3.0, 3.0): 0.5, (3.1, 0.0): 1.0}
    for name, of_class in {"car": 1.0, "truck": 4.0, "bus": 0.0}.items():
        vehicles = joined(*(one_vehicle(name, centre=place) for place in places))
        found = vehicle_weights(vehicles, ObjectiveSettings(class_weights={"truck": 4.0, "bus": 0.0}, zones=zones))
        assert found.tolist() == [of_class * of_zone for of_zone in places.values()]
    assert vehicle_weights(vehicles, ObjectiveSettings(class_weights={})) is None


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with weights, and its site."""
    folder = tmp_path_factory.mktemp("weights")
    objective = {"class_weights": CLASSES, "zones": ZONES}
    scene = write_scene(folder, {"objective": objective, "traffic": {"holdout": 0.5, "block_s": 8.0}})
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["optimise", str(scene), "--out", str(folder / "run")]) == 0
    return RunFolder(folder / "run"), prepare(load_scenario(scene))


def scores(table, chosen):
    """Each chosen vehicle's score as often as it weighs, from its row alone."""
    rows = []
    for row in np.flatnonzero(chosen):
        on_left = -20.0 <= table["x_m"][row] <= 20.0 and 5.5 <= table["y_m"][row] <= 9.0
        often = int(CLASSES[table["class"][row]] * (2 if on_left else 1))
        assert often == table["weight"][row]
        rows += [table["entropy_bits"][row] if table["detectable"][row] else -1.0] * often
    return rows


def test_a_run_judges_as_if_heavy_vehicles_were_there_several_times(run):
    outcome, site = run
    result, plan = outcome.result, site.plan
    for table, message in ((outcome.baseline, result["baseline"]), (outcome.optimised, result)):
        for split, found in (("search", message), ("holdout", message["holdout"])):
            slow = scores(table, table["split"] == split)
            assert found["objective_per_vehicle"] == pytest.approx(np.mean(slow), abs=1e-5)  # as the table is rounded
            assert found["detectable_share"] == table["detectable"][table["split"] == split].mean()
        assert message["objective"] == pytest.approx(sum(scores(table, table["split"] == "search")), abs=1e-2)
    gained, weight = [], []
    for block in np.unique(plan.holdout_block):
        of = np.isin(outcome.baseline["frame"], plan.holdout[plan.holdout_block == block])
        of &= outcome.baseline["split"] == "holdout"
        before, after = scores(outcome.baseline, of), scores(outcome.optimised, of)
        gained.append(sum(after) - sum(before))
        weight.append(len(after))
    interval = ratio_interval_90(np.array(gained), np.array(weight), result["seed"])
    assert result["holdout"]["interval_90"] == pytest.approx(interval, abs=1e-4)
    assert result["holdout"]["vehicles"] == (outcome.baseline["split"] == "holdout").sum()


def test_the_score_map_and_the_tables_by_group_weigh_too(run):
    outcome, site = run
    fixed = dict.fromkeys(("x_m", "y_m", "tilt_y_deg", "yaw_deg"), 0.0)
    space = SearchSpace((place_of(fixed, {"height_m": (2.0, 4.0), "tilt_x_deg": (0.0, 20.0)}),))
    with site_evaluator(site, site.search) as evaluator:
        score_map = map_scores(evaluator, space, space.lower, site.plan.search_block, grid=(2, 2))
    assert score_map.block_vehicles.sum() == len(scores(outcome.baseline, outcome.baseline["split"] == "search"))
    whole = score_map.block_objective.sum(axis=-1) / score_map.block_vehicles.sum()
    np.testing.assert_allclose(score_map.per_vehicle, whole, rtol=1e-9)
    group = next(one for one in outcome.result["groups"] if one["by"] == "distance")
    near = (outcome.baseline["distance_m"] < float(group["name"].split("-")[1].split()[0])) & (
        outcome.baseline["split"] == "holdout"
    )
    assert group["objective_before"] == pytest.approx(np.mean(scores(outcome.baseline, near)), abs=0.0051)


def test_studies_and_rungs_of_a_search_see_the_same_weights(run):
    _, site = run
    with site_evaluator(site, site.search) as evaluator:
        totals = evaluator.totals(LAYOUTS)
    (found,) = landscapes(site, [Job(AS_IT_IS, tuple(LAYOUTS))])
    assert found.per_vehicle() == pytest.approx(totals.per_vehicle(), rel=1e-12)
    assert found.blocks(site.plan.search_block)[1].sum() == totals.weight.sum() != found.vehicles.sum()
    only_last = [replace(frame, weight=np.zeros(len(frame))) for frame in site.search[:-1]]
    alone = replace(site, search=(*only_last, site.search[-1]))
    frames = fresh_auto_search(alone, site.scenario.lidar.deployment.spaces[0]).frames
    assert frames[0] == len(site.search) - 1  # frames without a weight are looked at last


def test_a_result_tells_its_weights(run):
    outcome, _ = run
    assert outcome.result["identity"]["[objective] class_weights"] == CLASSES
    assert "van 2, truck 3, in left lane x 2" in definitions(outcome.result)["Objective"]
    plain = outcome.result["identity"] | {"[objective] class_weights": {}, "[objective] zones": []}
    assert "weight" not in definitions(outcome.result | {"identity": plain})["Objective"]


@pytest.mark.parametrize(
    ("objective", "message"),
    [
        (
            {"zones": [{"name": "far", "polygon_m": [[900.0, 0.0], [990.0, 0.0], [990.0, 9.0]], "weight": 2.0}]},
            ("zones 1", "'far'", "those that count are at x"),
        ),
        ({"zones": [*ZONES, {**ZONES[0], "name": "again"}]}, ("zones 2", "'again'", "put the smaller zone first")),
        ({"class_weights": dict.fromkeys(("car", "van", "truck"), 0.0)}, ("above 0", "car, truck, van")),
        ({"class_weights": {"lorry": 2.0}}, ("lorry", "truck")),
        ({"class_weights": {"car": -1.0}}, ("class_weights] car", "0 to 1e+06")),
        ({"zones": [{**ZONES[0], "polygon_m": [[0.0, 0.0], [1.0, 1.0]]}]}, ("zones 1 polygon_m", "3 or more")),
        ({"zones": [{"name": "no weight", "polygon_m": ZONES[0]["polygon_m"]}]}, ("zones 1 weight", "missing")),
    ],
)
def test_weights_that_cannot_be_are_refused_in_one_line(tmp_path, objective, message):
    scene = write_scene(tmp_path, {"objective": objective})
    with pytest.raises(InputError) as error:
        prepare(load_scenario(scene))
    assert all(text in str(error.value) for text in message), error.value
    assert "\n" not in str(error.value)


def test_weights_that_leave_nothing_held_out_are_refused():
    plain = load_scenario("i80").objective
    weightless = [replace(frame, weight=np.zeros(len(frame))) for frame in FRAMES[1:]]
    check_weights(plain, FRAMES[:1], FRAMES[1:], "[objective]")
    check_weights(plain, FRAMES[:1], [], "[objective]")
    with pytest.raises(InputError, match=r"held-out frames a weight above 0, so that there is no check of the answer"):
        check_weights(plain, FRAMES[:1], weightless, "[objective]")
