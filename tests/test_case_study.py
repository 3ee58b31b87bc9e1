"""The paper's case study: its statistics are those of slow loops, its verdicts follow the numbers, a small run."""

from __future__ import annotations

import copy
import csv
import itertools
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.research  # noqa: F401
from blender_lidar.optimise.objective import vehicle_score
from blender_lidar.run.verdict import ScoreMap
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.sensors.model import load_model
from blender_lidar.statistics import RESAMPLES, block_sums, interval_90, student_t_95
from case_study import (
    AS_THE_SCENE,
    EVEN,
    PUBLISHED,
    SENSORS,
    Effort,
    evenly_spaced,
    layout_at,
    open_case,
    with_even_beams,
)
from case_study_claims import claims
from case_study_distance import MEASURES, banded, difference_interval_90, effects, halves, measure
from case_study_optima import Landscape, joint_optima, order_shares, orders, with_missed
from case_study_report import report_text
from reproduce_paper import main, opened, reproduce, write_results
from tests.small_scene import MAPPED, write_scene

TINY = Effort(frames=5, grid=(2, 3), wide_grid=(2, 2), iterations=1, sensitivity_frames=1, sensitivity_grid=(2, 2))
HEIGHT, TILT = np.linspace(2.0, 4.5, 4), np.linspace(0.0, 25.0, 5)


# --- statistics, beside slow loops ------------------------------------------------------------------------------------


def landscape(seed, filled) -> Landscape:
    """A random landscape whose blocks of time disagree; blocks that are not filled have no vehicle."""
    rng = np.random.default_rng(seed)
    filled = np.array(filled, dtype=bool)
    vehicles = rng.integers(5, 30, filled.sum()).astype(float)
    objective = rng.normal(0.0, 1.0, (len(HEIGHT), len(TILT), filled.sum())) * vehicles
    values = objective.sum(axis=-1) / vehicles.sum()
    score_map = ScoreMap(HEIGHT, TILT, values, rng.uniform(size=values.shape), objective, vehicles)
    return Landscape(score_map, filled, {"per_vehicle": float(values.min()), "detectable_share": 0.25})


def slow_joint_optima(found, seed):
    """Block by block and point by point, as the joint resampling is meant."""
    blocks = len(found[0].filled)
    best = [[] for _ in found]
    for draw in np.random.default_rng(seed).integers(blocks, size=(RESAMPLES, blocks - 1)).tolist():
        tops = []
        for one in found:
            column = {block: number for number, block in enumerate(np.flatnonzero(one.filled))}
            columns = [column[block] for block in draw if block in column]
            if not columns:
                break
            totals = sum(one.map.block_objective[..., number] for number in columns)
            row, place = max(np.ndindex(totals.shape), key=lambda at: totals[at])
            tops.append((one.map.height_m[row], one.map.tilt_deg[place]))
        else:
            for of_one, top in zip(best, tops, strict=True):
                of_one.append(top)
    return [np.array(of_one).T for of_one in best]


def test_joint_resamples_are_those_of_a_loop_also_where_one_sensor_sees_nothing_in_a_block():
    found = [landscape(1, [1, 1, 1, 1]), landscape(2, [1, 0, 1, 1]), landscape(3, [0, 1, 1, 1])]
    fast, slow = joint_optima(found, 5), slow_joint_optima(found, 5)
    np.testing.assert_array_equal([of[0] for of in fast], [of[0] for of in slow])
    np.testing.assert_array_equal([of[1] for of in fast], [of[1] for of in slow])
    assert 0 < len(fast[0][0]) < RESAMPLES  # those without a vehicle are left out
    assert joint_optima([landscape(1, [1, 1, 1]), landscape(1, [1, 1, 0])], 1) is None  # too few blocks
    ((height, tilt),) = joint_optima([one := landscape(3, [1] * 6)], 1)
    assert one.map.optimum_intervals_90(1) == {"height_m": interval_90(height), "tilt_x_deg": interval_90(tilt)}


@settings(max_examples=30)
@given(st.lists(st.tuples(*[st.integers(0, 3)] * 3), min_size=1, max_size=30))
def test_shares_of_an_order_equal_a_loop(rows):
    found = order_shares(dict(zip("abc", np.array(rows, dtype=float).T, strict=True)))
    assert found["strict"] == pytest.approx(np.mean([a > b > c for a, b, c in rows]))
    assert found["with_ties"] == pytest.approx(np.mean([a >= b >= c for a, b, c in rows]))
    for pair, (first, second) in zip(found["pairs"], itertools.combinations(range(3), 2), strict=True):
        assert pair["above"] == pytest.approx(np.mean([row[first] > row[second] for row in rows]))
        assert pair["equal"] == pytest.approx(np.mean([row[first] == row[second] for row in rows]))


@pytest.mark.parametrize("missed", [0.0, -0.5, -4.0, 1.0])
def test_another_loss_is_worked_out_as_if_every_vehicle_were_scored_again(missed):
    rng = np.random.default_rng(3)
    entropy, noticed = rng.uniform(0, 1.5, (4, 5, 40)), rng.uniform(size=(4, 5, 40)) < 0.6
    base_entropy, base_noticed = rng.uniform(0, 1.5, 40), rng.uniform(size=40) < 0.4

    def scored(value):
        """The landscape when a missed vehicle adds `value`, by Eq. 10 itself."""
        values = vehicle_score(entropy, noticed, -value, "paper").mean(axis=-1)
        return values, vehicle_score(base_entropy, base_noticed, -value, "paper").mean()

    values, baseline = scored(-1.0)
    score_map = ScoreMap(HEIGHT, TILT, values, noticed.mean(axis=-1), values[..., None] * 40, np.array([40.0]))
    before = {"per_vehicle": baseline, "detectable_share": base_noticed.mean()}
    found = with_missed(Landscape(score_map, np.ones(1, dtype=bool), before), missed - -1.0)
    again, again_baseline = scored(missed)
    np.testing.assert_allclose(found.map.per_vehicle, again, atol=1e-12)
    assert found.gain == pytest.approx(again.max() - again_baseline)


@given(seed=st.integers(0, 1000))
def test_the_effects_add_up_to_the_change_and_tell_what_does_nothing(seed):
    rng = np.random.default_rng(seed)
    real, even = ({corner: rng.normal(size=6) for corner in ("00", "10", "01", "11")} for _ in range(2))
    found = effects(real, even)
    np.testing.assert_allclose(found["change"], real["11"] - real["00"])
    np.testing.assert_allclose(found["change_evenly_spaced"] + found["spacing"], found["change"])
    np.testing.assert_allclose(
        found["height_evenly_spaced"] + found["tilt_evenly_spaced"], found["change_evenly_spaced"]
    )
    np.testing.assert_allclose(found["spacing_at_optimum"], real["11"] - even["11"])
    np.testing.assert_allclose(found["spacing_at_baseline"] + found["spacing"], found["spacing_at_optimum"])
    flat = effects(*[{"00": real["00"], "10": real["00"], "01": real["01"], "11": real["01"]}] * 2)
    for effect in ("spacing", "spacing_at_baseline", "height_evenly_spaced"):
        np.testing.assert_array_equal(flat[effect], 0.0)
    np.testing.assert_allclose(flat["tilt_evenly_spaced"], real["01"] - real["00"])


def test_the_interval_of_a_band_is_that_of_a_loop_over_resampled_blocks():
    rng = np.random.default_rng(2)
    values, block = rng.normal(1.0, 1.0, 60), rng.integers(0, 5, 60)
    found = banded(values, block, 11)
    means = [
        np.concatenate([values[block == label] for label in draw]).mean()
        for draw in np.random.default_rng(11).integers(5, size=(RESAMPLES, 4)).tolist()
    ]
    reach = student_t_95(4) * np.std(means)
    assert found["mean"] == pytest.approx(values.mean())
    np.testing.assert_allclose(found["interval_90"], [values.mean() - reach, values.mean() + reach])
    assert banded(np.ones(4), np.array([0, 0, 1, 1]), 1) == {"mean": 1.0, "interval_90": None}  # too few blocks


def test_the_halves_of_the_bands_are_those_of_a_loop_over_vehicles():
    rng = np.random.default_rng(6)
    change, distance = rng.normal(0.0, 1.0, 90), rng.choice([5.0, 25.0, 70.0, 150.0, 155.0], 90)
    block, far = rng.integers(0, 6, 90), distance > 40.0  # bands 60-80 m and 140-160 m
    found = halves(change, {"distance_m": distance, "block": block}, 3)
    means = [change[~far].mean(), change[far].mean()]
    assert [found["near"], found["far"], found["far_less_near"]["mean"]] == pytest.approx([*means, means[1] - means[0]])
    sums = [
        tuple(np.array([of[rows & (block == b)].sum() for b in range(6)]) for of in (change, np.ones(90)))
        for rows in (far, ~far)
    ]
    assert found["far_less_near"]["interval_90"] == pytest.approx(difference_interval_90(*sums, 3))
    three = {"distance_m": np.array([5.0, 25.0, 45.0]), "block": np.zeros(3)}  # the middle one is far
    message = {"near": 1.0, "far": 3.0, "far_less_near": {"mean": 2.0, "interval_90": None}}
    assert halves(np.array([1.0, 2.0, 4.0]), three, 1) == message
    assert halves(np.ones(3), three | {"distance_m": np.full(3, 5.0)}, 1)["near"] is None


def test_the_interval_of_a_difference_is_that_of_a_loop_also_where_a_block_lacks_one_of_the_two():
    rng = np.random.default_rng(4)
    values, block, far = rng.normal(1.0, 1.0, 80), rng.integers(0, 5, 80), rng.uniform(size=80) < 0.5
    far[block == 0] = False
    sums = [tuple(block_sums(of, block) for of in (np.where(rows, values, 0.0), rows)) for rows in (far, ~far)]
    differences = []
    for draw in np.random.default_rng(11).integers(5, size=(RESAMPLES, 4)).tolist():
        picked = [np.concatenate([values[rows & (block == label)] for label in draw]) for rows in (far, ~far)]
        if len(picked[0]) and len(picked[1]):
            differences.append(picked[0].mean() - picked[1].mean())
    middle, reach = values[far].mean() - values[~far].mean(), student_t_95(4) * np.std(differences)
    np.testing.assert_allclose(difference_interval_90(*sums, 11), [middle - reach, middle + reach])
    assert len(differences) < RESAMPLES
    assert difference_interval_90(sums[0], (np.zeros(5), np.array([1, 1, 0, 0, 0])), 11) is None


def test_the_order_of_tilts_is_told_for_settings_that_all_sensors_have():
    def row(sensor, tilt, what="setback", value="5 m", note=""):
        return {"sensor": sensor, "what": what, "value": value, "tilt_deg": tilt, "height_m": 4.5, "note": note}

    rows = [row("RS-16", 20.0), row("RS-32", 20.0), row("RS-80", 9.0), row("RS-80", 1.0, "beam table", "other")]
    rows += [row(sensor, tilt, value="10 m") for sensor, tilt in zip(SENSORS, (19.0, 13.0, 9.0), strict=True)]
    rows += [row(sensor, None, "range gate", "50 m", "impossible") for sensor in SENSORS]
    rows += [row(sensor, tilt, "region", f"within {tilt} m") for sensor, tilt in zip(SENSORS, (3, 2, 1), strict=True)]
    assert [(of["what"], of["value"], of["tilts_fall"]) for of in orders(rows)] == [
        ("setback", "5 m", False),
        ("setback", "10 m", True),
        ("region", "0.5 of the gate", True),
    ]


def test_what_the_paper_reports_is_carried_over():
    assert [(of.height_m, of.tilt_deg) for of in PUBLISHED.values()] == [(4.1, 19.0), (4.2, 13.0), (4.4, 9.0)]
    for name, printed in (("recall_01", [17, 25, 10]), ("recall_03", [10, 15, 8])):  # Table III's differences
        recalls = [getattr(of, name) for of in PUBLISHED.values()]
        assert [round(100 * (after - before)) for before, after in recalls] == printed


# --- a small study ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return str(write_scene(tmp_path_factory.mktemp("scene"), {**MAPPED, "region": {"radius_m": "gate"}}))


def study(scene, out, resume=False):
    case = open_case(scene, {}, TINY)
    with opened(case, out, resume) as folder:
        result = reproduce(case, folder)
        return result, write_results(folder, result)


@pytest.fixture(scope="module")
def finished(scene, tmp_path_factory):
    """The folder of a study that nothing stopped, its result, and what it says it wrote."""
    out = tmp_path_factory.mktemp("study") / "run"
    return out, *study(scene, out)


def test_it_leaves_what_it_names_and_tables_hold_the_result(finished):
    out, result, written = finished
    left = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    assert set(written) == {name for name in left if not name.startswith("stages/") and name != "study.json"}
    assert json.loads((out / "case_study.json").read_text()) == json.loads(json.dumps(result))
    with (out / "table2.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["published_tilt_deg"]) for row in rows] == [19.0, 13.0, 9.0]
    for row in rows:
        of = result["sensors"][row["sensor"]]
        values = np.array(of["map"]["per_vehicle"])
        at = np.unravel_index(values.argmax(), values.shape)
        assert [float(row["height_m"]), float(row["tilt_deg"])] == [of["map"]["height_m"][at[0]], TILTS[at[1]]]
        assert float(row["objective_per_vehicle"]) == values.max()
        assert float(row["tilt_interval_90_low"]) <= float(row["tilt_deg"]) <= float(row["tilt_interval_90_high"])
        held = {name: float(row[f"judged_{name}_holdout_objective_per_vehicle"]) for name in ("grid", "baseline")}
        assert held["grid"] - held["baseline"] == pytest.approx(float(row["judged_grid_holdout_gain_over_baseline"]))
        assert of["de_pso"]["evaluations"] == 4  # one iteration of the scene's four particles


TILTS = np.linspace(0.0, 25.0, TINY.grid[1])


def test_fig_9_and_the_decomposition_add_up_to_what_the_verdict_says_of_all_vehicles(finished):
    _, result, _ = finished
    for sensor in SENSORS:
        of = [row for row in result["fig9"] if row["sensor"] == sensor]
        held = result["sensors"][sensor]["judged"]["grid"]["holdout"]
        for name, key in (("objective_bits", "objective_per_vehicle"), ("detectable", "detectable_share")):
            *bands, whole = [row for row in of if row["measure"] == name]
            assert whole["optimised"] == pytest.approx(held[key])
            assert whole["vehicles"] == sum(row["vehicles"] for row in bands) == held["vehicles"]
            mean = sum(row["vehicles"] * row["change"]["mean"] for row in bands) / whole["vehicles"]
            assert mean == pytest.approx(whole["change"]["mean"])
    for row in result["spacing"]:
        key = (row["band"], row["measure"])
        changes = {of["sensor"]: of["change"]["mean"] for of in result["fig9"] if (of["band"], of["measure"]) == key}
        assert row["change"]["mean"] == pytest.approx(changes["RS-80"])
        assert row["change_evenly_spaced"]["mean"] == pytest.approx(changes[EVEN])


def test_every_setting_is_varied_for_every_sensor_and_what_the_traffic_does_not_allow_says_why(finished):
    rows = finished[1]["sensitivity"]
    common = {"setback", "place along the road", "region", "range gate", "azimuth step", "azimuth phase", "abs(C)"}
    common |= {AS_THE_SCENE, "C as printed:", "view of Eq. 11", "vehicle shapes", "reading of Eqs. 8 and 10"}
    for sensor in SENSORS:
        own = [row for row in rows if row["sensor"] == sensor]
        assert {row["what"] for row in own} - {"beam table"} == common
        losses = {row["value"]: row for row in own if row["what"] == "abs(C)"}
        missed = 1.0 - losses["0"]["detectable_baseline"]
        steps = np.diff([losses[value]["baseline_bits"] for value in ("0", "0.5", "2", "4")])
        np.testing.assert_allclose(steps, -missed * np.array([0.5, 1.5, 2.0]), atol=1e-12)
    assert all((row["height_m"] is None) == bool(row["note"]) for row in rows)
    away = [row for row in rows if row["what"] == "place along the road"]
    assert all("no vehicle" in row["note"] for row in away)  # the vehicles are seen over 80 m alone


def test_what_is_measured_vehicle_by_vehicle_is_what_an_evaluator_sums(scene):
    site = with_even_beams(open_case(scene, {}, TINY).site("RS-80"))
    layout = layout_at(site, (3.5, 10.0))
    seen = measure(site, layout)
    with Evaluator(site.holdout, site.observation, site.scoring) as evaluator:
        totals = evaluator.totals([layout])
    assert seen["objective_bits"].sum() == pytest.approx(totals.objective.sum())
    assert seen["detectable"].sum() == totals.detectable.sum()
    assert {len(seen[name]) for name in (*MEASURES, "distance_m", "block")} == {totals.vehicles.sum()}


def test_sensors_share_frames_and_blocks_as_long_as_the_widest_region_needs(scene):
    case = open_case(scene, {}, TINY)
    assert case.block_s < open_case(scene, {("sensor", "range_gate_m"): (40.0, "test")}, TINY).block_s
    assert open_case(scene, {}, TINY._replace(frames=None, sensitivity_frames=15)).effort.sensitivity_frames == 6
    plans = [case.site(sensor).plan for sensor in SENSORS]
    for plan in plans[1:]:
        np.testing.assert_array_equal(plan.search, plans[0].search)
        np.testing.assert_array_equal(plan.search_block, plans[0].search_block)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, "must be pairs, and they alone"),  # its tilt is fixed
        (MAPPED | {"baseline": {"x_m": 3.0}}, "allowed: another height and tilt alone"),
        (MAPPED | {"objective": {"metric": "detectable"}}, "metric is 'detectable'"),
    ],
)
def test_a_scene_that_asks_something_else_is_refused(tmp_path, capsys, changes, said):
    assert main([str(write_scene(tmp_path, changes)), "--out", str(tmp_path / "run")]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("reproduce_paper: ")
    assert said in err
    assert not (tmp_path / "run").exists()


# --- claims -----------------------------------------------------------------------------------------------------------

LOST, LEVEL, WON = (-0.2, -0.1), (-0.1, 0.1), (0.1, 0.2)


def message(ends):
    """A mean with its interval; None for no interval."""
    return {"mean": -0.1 if ends is None else np.mean(ends), "interval_90": None if ends is None else list(ends)}


@pytest.fixture
def result(finished):
    return copy.deepcopy(json.loads(json.dumps(finished[1])))


def verdict(result, number):
    return claims(result)[number].verdict


def test_every_claim_has_a_verdict_and_stands_in_the_report(result):
    text, found = report_text(result), claims(result)
    assert len(found) == 10
    for claim in found:
        assert f"| {claim.text} | {claim.ours} | **{claim.verdict}** |" in text
    for table in text.split("\n\n"):  # a cell with a bar in it would break its row
        if table.startswith("| "):
            assert len({line.count("|") for line in table.splitlines()}) == 1


def test_verdicts_on_the_optima_follow_the_numbers(result):
    def order(axis, strict, with_ties):
        result["order"][axis] |= {"strict": strict, "with_ties": with_ties}
        for pair in result["order"][axis]["pairs"]:
            pair["above"] = 0.5

    order("height", 0.95, 0.95)
    order("tilt", 0.05, 0.08)
    assert [verdict(result, number) for number in (0, 1)] == ["reproduced", "not reproduced"]
    order("height", 0.0, 0.99)
    order("tilt", 0.5, 0.6)
    assert [verdict(result, number) for number in (0, 1)] == ["not shown: ties", "undecided"]
    result["order"]["tilt"]["pairs"][1]["above"] = 1.0
    assert verdict(result, 1) == "reproduced in part"
    for of in result["sensors"].values():
        of["height_interval_90"] = [of["published"]["height_m"], 4.5]
        of["tilt_interval_90"] = [0.0, of["published"]["tilt_deg"]]
    assert verdict(result, 2) == "reproduced"
    result["sensors"]["RS-32"]["tilt_interval_90"] = [20.0, 25.0]
    assert verdict(result, 2) == "reproduced in part"


@pytest.mark.parametrize(
    ("means", "expected"),
    [
        ((0.1, 0.3, 0.2), ["reproduced", "reproduced"]),
        ((0.3, 0.1, -0.2), ["not reproduced", "not reproduced"]),
        ((0.1, 0.105, 0.0), ["reproduced in part", "undecided"]),
    ],
)
def test_verdicts_on_the_gain_follow_the_intervals(result, means, expected):
    rows = [row for row in result["fig9"] if row["band"] == "all" and row["measure"] == "detectable"]
    for row, mean in zip(rows, means, strict=False):
        row["change"] = {"mean": mean, "interval_90": [mean - 0.01, mean + 0.01]}
    assert [verdict(result, number) for number in (3, 4)] == expected


@pytest.mark.parametrize(
    ("rs32", "rs80", "expected"),
    [
        (WON, WON, "reproduced"),
        (WON, LEVEL, "reproduced in part"),
        (LEVEL, LEVEL, "undecided"),
        (WON, LOST, "not reproduced"),
    ],
)
def test_more_is_gained_far_away_only_if_the_interval_of_the_difference_says_so(result, rs32, rs80, expected):
    for row in result["fig9_halves"]:
        ends = {"RS-32": rs32, "RS-80": rs80}.get(row["sensor"]) if row["measure"] == "detectable" else WON
        row.update({"near": 0.0, "far": 0.1, "far_less_near": message(ends)})
    assert verdict(result, 6) == expected


@pytest.mark.parametrize(
    ("share", "bits", "expected"),
    [
        (LOST, WON, "reproduced"),
        (LEVEL, LOST, "undecided"),  # the entropy is no second chance
        (WON, LOST, "not reproduced"),
        (None, LOST, "undecided"),
    ],
)
def test_the_detectable_share_alone_decides_on_the_loss_near_by(result, share, bits, expected):
    for row in result["fig9"]:
        if (row["sensor"], row["band"]) == ("RS-80", "0-20 m"):
            row["change"] = message({"detectable": share, "entropy_bits": bits}.get(row["measure"]))
    assert verdict(result, 8) == expected


@pytest.mark.parametrize(
    ("change", "at_optimum", "spacing", "even", "expected"),
    [
        (LOST, LOST, LOST, WON, "reproduced"),
        (LOST, LOST, LOST, LOST, "reproduced in part"),  # even beams lose too
        (LOST, LOST, LEVEL, LEVEL, "reproduced in part"),  # they were as much worse before
        (LOST, LEVEL, LOST, WON, "undecided"),  # a lead that is lost, and no more
        (LOST, WON, LOST, LOST, "not reproduced"),
        (WON, LOST, LOST, WON, "no loss here"),
    ],
)
def test_uneven_beams_cause_a_loss_only_if_there_is_one_and_they_are_worse_at_the_optimum(
    result, change, at_optimum, spacing, even, expected
):
    near = next(row for row in result["spacing"] if row["band"] == "0-20 m" and row["measure"] == "detectable")
    near |= {"change": message(change), "spacing_at_optimum": message(at_optimum), "spacing": message(spacing)}
    near["change_evenly_spaced"] = message(even)
    assert verdict(result, 9) == expected


@pytest.mark.parametrize("name", ["RS-16", "RS-80"])
def test_even_beams_have_the_same_number_and_the_same_ends_and_one_step(name):
    model, even = load_model(name), evenly_spaced(load_model(name))
    assert even.elevation_rad[[0, -1]].tolist() == model.elevation_rad[[0, -1]].tolist()
    np.testing.assert_allclose(np.diff(even.elevation_rad), np.ptp(model.elevation_rad) / (model.rings - 1), rtol=1e-9)
    assert even.azimuth_offset_rad is model.azimuth_offset_rad
    for key in ("rings", "rotation_hz", "block_time_us", "range_min_m", "range_max_m"):
        assert getattr(even, key) == getattr(model, key)
    assert (even.name, even.aliases) == (f"{name} evenly spaced", ())
    assert "no such sensor" in even.confidence
