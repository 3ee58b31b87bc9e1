"""What is timed beside each other is the same thing, and what is said of the times follows from them."""

from __future__ import annotations

import importlib.util
import json
import os
import runpy
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.benchmark import growth
from blender_lidar.benchmark.case import FrameCase
from blender_lidar.benchmark.dense import RADIUS_M, dense_frame
from blender_lidar.benchmark.document import document
from blender_lidar.benchmark.machine import machine
from blender_lidar.benchmark.memory import resident_mib
from blender_lidar.benchmark.picture import draw
from blender_lidar.benchmark.plan import METRIC, Found, Options, carry_out
from blender_lidar.benchmark.power_law import power_law
from blender_lidar.benchmark.report import report
from blender_lidar.benchmark.rival import SPARSE
from blender_lidar.benchmark.rivals import rivals_missing, rivals_of
from blender_lidar.benchmark.stages import casting_of, stage_entries, whole_of
from blender_lidar.benchmark.targets import TARGETS, verdicts
from blender_lidar.benchmark.timing import Entry, Timing, in_rounds, quartiles
from blender_lidar.benchmark.whole import few_evaluations
from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.errors import InputError
from blender_lidar.plots.benchmark import Bar, Line, Panel, plot_benchmark
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.overlaps import overlapping_pairs
from tests.sample_traffic import dense_traffic
from tests.small_scene import write_scene

SCRIPT = Path(__file__).parents[1] / "scripts" / "benchmark.py"
GATE_M = 60.0
HERE = [name for name in CASTERS if is_available(name)]


@pytest.fixture(scope="module")
def case():
    vehicles = dense_traffic(vehicles=40, length_m=90.0)
    near = np.hypot(*vehicles.centre_m[:, :2].T) < 30.0
    lattice = beam_lattice(load_model("RS-16"), stride=8)
    return FrameCase(vehicles, near, lattice, Pose(0.5, -0.5, 4.2, 0.35), GATE_M, "body", 0.05)


@pytest.fixture(scope="module")
def oracle(case):
    """Distance along every beam, in float64."""
    exact = caster_class("exact")(case.triangles.corners, closed=True)
    return exact.cast(case.pose.position, case.directions, GATE_M).distance


# --- what is timed is right -------------------------------------------------------------------------------------------


def test_every_rival_casts_the_frames_own_beams_and_finds_what_the_oracle_finds(case, oracle):
    rivals = rivals_of(case)
    assert len(rivals) == 2 * bool(importlib.util.find_spec("embreex")) + 6 * bool(
        importlib.util.find_spec("bpy")
    ) + bool(importlib.util.find_spec("open3d"))
    for rival in rivals:
        found, expected = rival.distance(rival.cast()), oracle[rival.beams]
        assert np.isfinite(expected).sum() > 10, rival.name
        same = np.isclose(found, expected, rtol=0.0, atol=2e-3)
        assert (same | (np.isinf(found) & np.isinf(expected))).mean() > 0.995, rival.name  # they leak at edges
        assert rival.scale == pytest.approx(len(oracle) / len(rival.beams)) or rival.scale == 1.0


def test_a_rival_that_casts_a_part_of_the_beams_says_so_and_stands_for_all(case):
    sparse = [rival for rival in rivals_of(case) if rival.scale != 1.0]
    assert bool(sparse) == bool(importlib.util.find_spec("bpy"))
    for rival in sparse:
        assert len(rival.beams) == -(-len(case.directions) // SPARSE)
        assert f"{len(rival.beams):,} beams timed" in rival.entry.note
        assert len(np.unique(rival.beams % case.lattice.columns)) > case.lattice.rings  # many azimuths


def test_every_caster_scores_the_frame_as_exact_does_whole_and_by_stage(case):
    entries = {entry.name: entry for entry in stage_entries(case, HERE)}
    expected = entries[whole_of("exact")].act()
    assert (expected > 0.0).any()
    for name in HERE:
        np.testing.assert_allclose(entries[whole_of(name)].act(), expected, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(entries[f"{name}: scoring"].act(), expected[0], rtol=0.0, atol=1e-12)


def test_of_a_swarm_the_time_of_one_mounting_is_told(case):
    entry = next(entry for entry in stage_entries(case, HERE[-1:]) if "swarm" in entry.name)
    assert entry.scale * len(entry.act()) == 1.0


def test_the_survivors_are_all_beams_that_meet_a_counted_vehicle(case, oracle):
    exact = caster_class("exact")(case.triangles.corners, closed=True)
    met = exact.cast(case.pose.position, case.directions, GATE_M).triangle
    of_counted = np.flatnonzero((met >= 0) & case.counted[case.triangles.owner[met]])
    assert len(of_counted)
    assert np.isin(of_counted, case.survivors).all()
    assert len(case.survivors) < len(oracle)


def test_whole_optimisations_come_to_the_same_mounting_whatever_the_caster(tmp_path):
    scene = write_scene(tmp_path)
    casters = [name for name in HERE if name != "exact"] or ["exact"]
    entries = few_evaluations(str(scene), {("sensor", "name"): ("RS-16", "--sensor")}, casters)
    found = [entry.act() for entry in entries]
    assert [entry.name for entry in entries] == [f"optimisation, RS-16, {name}" for name in casters]
    for each in found:
        assert each.evaluations == len(each.history) == 100
        np.testing.assert_array_equal(each.history, found[0].history)


def test_a_scene_that_searches_nothing_is_refused(tmp_path):
    scene = write_scene(tmp_path, {"deployment": {"height_m": 4.0, "tilt_x_deg": 15.0}})
    with pytest.raises(InputError, match=r"\[deployment\] fixes every coordinate"):
        few_evaluations(str(scene), {}, [HERE[0]])


# --- timing -----------------------------------------------------------------------------------------------------------


def test_in_each_round_everything_is_done_once_after_another_and_warmed_before():
    done = []
    columns = [[Entry(name, partial(done.append, f"{name}{at}"), "g") for name in "ab"] for at in range(2)]
    in_rounds(columns, 3, warm=False)
    assert done == ["a0", "b0", "a1", "b1"] * 3
    done.clear()
    in_rounds(columns, 1)
    assert done == ["a0", "a0", "b0", "b0", "a1", "a1", "b1", "b1"]


def test_seconds_are_those_of_the_clock_times_the_scale():
    ticks = iter([0.0, 1.0, 10.0, 13.0])
    times = in_rounds([[Entry("a", lambda: None, "g", 2.0, "n")]], 2, clock=lambda: next(ticks))
    np.testing.assert_array_equal(times["a"].seconds, [[2.0], [6.0]])
    assert (times["a"].group, times["a"].note) == ("g", "n")


def test_who_is_interrupted_keeps_the_rounds_before():
    done, kept = [], {}

    def act():
        done.append(1)
        if len(done) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        in_rounds([[Entry("a", act, "g")]], 5, warm=False, into=kept)
    assert kept["a"].seconds.shape == (2, 1)
    assert (kept["a"].seconds > 0.0).all()


def test_columns_of_other_entries_are_refused():
    one, other = (Entry(name, lambda: None, "g") for name in "ab")
    with pytest.raises(InputError, match="the same ones in each column"):
        in_rounds([[one], [other]], 1)
    with pytest.raises(InputError, match="different names"):
        in_rounds([[one, one]], 1)


def test_quartiles_are_numpys():
    assert quartiles(np.array([5.0, 1.0, 3.0, 2.0, 4.0])) == (2.0, 3.0, 4.0)
    assert quartiles(np.array([1.0, 2.0])) == (1.25, 1.5, 1.75)


def timing(name, seconds):
    return Timing(name, "g", "", np.array(seconds, dtype=float))


def test_ratios_are_of_pairs_within_a_round_so_that_a_busy_moment_cancels():
    idle = timing("ours", [[1.0], [1.0], [1.0]]), timing("rival", [[2.0], [2.0], [2.0]])
    busy = timing("ours", [[1.0], [9.0], [1.0]]), timing("rival", [[2.0], [18.0], [2.0]])
    assert idle[0].ratio(idle[1]) == busy[0].ratio(busy[1]) == (0.5, 0.5, 0.5)
    with pytest.raises(InputError, match="as many rounds"):
        idle[0].ratio(timing("rival", [[1.0]]))


def test_of_several_frames_the_median_one_counts():
    assert timing("ours", [[1.0, 2.0, 90.0], [3.0, 4.0, 90.0]]).quartiles == (2.5, 3.0, 3.5)


def test_a_target_is_held_up_to_its_limit_and_not_beyond():
    target = TARGETS[0]
    times = {target.rival: timing(target.rival, [[1.0]])}
    for seconds, held in ((target.most, True), (1.01 * target.most, False)):
        (verdict,) = verdicts({**times, target.entry: timing(target.entry, [[seconds]])})
        assert (verdict.target, verdict.held) == (target, held)
    assert verdicts(times) == []


def test_targets_name_entries_that_there_are(case):
    ours = {entry.name for entry in stage_entries(case, HERE)}
    for target in TARGETS:
        caster = target.entry.partition(":")[0]
        assert target.entry in {whole_of(caster), casting_of(caster)}
        assert caster not in HERE or target.entry in ours


# --- growth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 1.0, 2.0])
def test_of_a_power_law_the_exponent_is_found_without_error(exponent):
    x = np.array([1.0, 2.0, 4.0, 8.0, 256.0])
    law = power_law(x, 3.0 * x**exponent)
    assert law.exponent == pytest.approx(exponent, abs=1e-12)
    assert law.factor == pytest.approx(3.0)
    assert law.standard_error == pytest.approx(0.0, abs=1e-12)


def test_the_standard_error_is_that_of_least_squares_and_covers_the_truth():
    rng, x = np.random.default_rng(0), np.geomspace(1.0, 256.0, 9)
    within = []
    for _ in range(400):
        y = x**1.2 * np.exp(rng.normal(0.0, 0.1, len(x)))
        law = power_law(x, y)
        (slope, _), covariance = np.polyfit(np.log(x), np.log(y), 1, cov=True)
        assert (law.exponent, law.standard_error) == pytest.approx((slope, np.sqrt(covariance[0, 0])))
        within.append(abs(law.exponent - 1.2) < 1.895 * law.standard_error)  # Student's t, 7 degrees, 90 %
    assert 0.85 < np.mean(within) < 0.95


def test_two_points_have_an_exponent_without_error_and_one_has_none():
    assert power_law([1.0, 4.0], [1.0, 2.0])[:2] == (pytest.approx(0.5), None)
    assert power_law([2.0], [1.0]) is None
    assert power_law([1.0, 2.0], [0.0, 1.0]) is None
    with pytest.raises(InputError, match="x above 0"):
        power_law([0.0, 1.0], [1.0, 1.0])


@pytest.mark.parametrize("vehicles", [1, 10, 1000])
def test_made_up_vehicles_stand_apart_within_reach_as_many_as_asked_for(vehicles):
    frame = dense_frame(vehicles, frame=3)
    assert len(frame.vehicles) == frame.counted.sum() == vehicles
    assert (np.hypot(*frame.vehicles.centre_m[:, :2].T) < RADIUS_M).all()
    assert len(overlapping_pairs(frame.vehicles)) == 0


def test_of_more_made_up_vehicles_the_first_are_those_of_fewer_and_too_many_are_refused():
    few, many = dense_frame(10).vehicles, dense_frame(300).vehicles
    np.testing.assert_array_equal(few.centre_m, many.centre_m[:10])
    assert not np.array_equal(few.centre_m, dense_frame(10, frame=1).vehicles.centre_m)
    with pytest.raises(InputError, match="allowed: 1 to"):
        dense_frame(100_000)


@pytest.mark.parametrize("rings", [16, 128])
def test_a_sensor_with_other_rings_spreads_them_evenly_over_the_same_field(rings):
    model = load_model("RS-80")
    made = growth.with_rings(model, rings)
    assert made.rings == rings
    assert made.elevation_rad[[0, -1]] == pytest.approx(model.elevation_rad[[0, -1]])
    assert np.ptp(np.diff(made.elevation_rad)) == pytest.approx(0.0, abs=1e-12)
    assert beam_lattice(made).columns == beam_lattice(model).columns
    assert growth.with_rings(model, None) is model


def test_growth_goes_from_one_to_all_and_changes_one_thing_at_a_time():
    steps = growth.steps(most_workers=6)
    assert steps["frames"] == [1, 2, 4, 8, 16, 32, 64, 128, 256]
    assert (steps["vehicles"][0], steps["vehicles"][-1]) == (10, 1000)
    assert (steps["rings"][0], steps["rings"][-1]) == (16, 128)
    assert steps["workers"] == [1, 2, 4, 6]
    for over, values in steps.items():
        points = growth.points_of(over, values, "exact", "box", "RS-16")
        assert [getattr(point, over) for point in points] == values
        others = [name for name in ("caster", "frames", "vehicles", "rings", "workers") if name != over]
        assert len({tuple(getattr(point, name) for name in others) for point in points}) == 1


def test_peak_memory_holds_what_was_held_for_a_moment():
    """In a process of its own: an allocator that keeps what was freed, as Blender brings one, hands it out again."""
    if resident_mib() is None:
        pytest.skip("this system does not tell")
    program = """
import numpy as np
from blender_lidar.benchmark.memory import peak_mib, resident_mib
before = resident_mib()
np.ones(64 << 17)  # 64 MiB, gone at once
print(peak_mib() - before)
"""
    found = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert 32.0 < float(found.stdout) < 128.0


# --- end to end -------------------------------------------------------------------------------------------------------


def main(*words):
    return runpy.run_path(str(SCRIPT))["main"]([str(word) for word in words])


def test_a_whole_benchmark_of_a_small_scene_says_and_stores_what_it_found(tmp_path, capsys):
    scene, stored, picture = write_scene(tmp_path), tmp_path / "b.json", tmp_path / "b.png"
    words = ["--sensor", "RS-16", "--frames", 1, "--repeats", 1, "--detail", "box", "--json", stored]
    casters = [name for name in HERE if name != "exact"] or ["exact"]
    for name in casters:
        words += ["--caster", name]
    if importlib.util.find_spec("matplotlib"):
        words += ["--picture", picture]
    assert main(scene, *words) == 0
    found, out = json.loads(stored.read_text(encoding="utf-8")), capsys.readouterr().out
    names = [row["name"] for row in found["times"]]
    assert {whole_of(name) for name in casters} <= set(names)
    assert any("the metric alone" in name for name in names)
    assert len(found["optimisations"]) == len(casters)
    assert found["frame"]["beams"] == 16 * load_model("RS-16").columns(20.0)
    assert found["growth"] == []
    assert found["left_out"].keys() >= rivals_missing().keys()
    for row in found["times"] + found["optimisations"]:
        assert 0.0 < row["seconds"]["low"] <= row["seconds"]["median"] <= row["seconds"]["high"]
        assert row["name"] in out
    beside = {row["name"] for row in found["times"] if "times_raw_embree" in row}
    assert beside == ({name for name in names if "the metric" not in name} if is_available("embree") else set())
    for name in found["left_out"]:
        assert f"left out: {name}" in out
    assert picture.exists() == bool(importlib.util.find_spec("matplotlib"))
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith(".")) == []


def test_growth_is_measured_in_processes_of_their_own_one_for_each_point():
    told = []
    series = growth.grow(
        "vehicles", [2, 4], 1, caster=HERE[0], detail="box", sensor="RS-16", told=partial(told.append, 1)
    )
    assert (series.x, len(told)) == ([2, 4], 2)
    assert all(each.median > 0.0 for each in series.seconds)
    assert min(series.ready_s) > 0.0
    assert series.time_law is not None
    for peak, above in zip(series.peak_mib, series.above_mib, strict=True):
        assert (peak is None and above is None) or peak > above >= 0.0


def test_growth_that_is_interrupted_is_that_of_the_points_before(monkeypatch):
    told = []

    def measured(point):
        if point.vehicles == 8:
            raise KeyboardInterrupt
        return growth.Measured(0.1 * point.vehicles, 0.1, 100.0 + point.vehicles, float(point.vehicles))

    monkeypatch.setattr(growth, "in_fresh_process", measured)
    with pytest.raises(KeyboardInterrupt):
        growth.grow("vehicles", [2, 4, 8], 3, caster="raster", detail="box", sensor="RS-16", kept=told.append)
    assert told[-1].x == [2, 4]
    assert told[-1].time_law.exponent == pytest.approx(1.0)


@pytest.mark.skipif(os.name == "nt", reason="there is no such signal")
def test_ctrl_c_leaves_what_was_measured_in_a_whole_file(tmp_path):
    stored, errors = tmp_path / "b.json", tmp_path / "errors"
    words = [str(SCRIPT), "--only", "metric", "--repeats", "10", "--json", str(stored)]
    with errors.open("w") as stream:
        running = subprocess.Popen(
            [sys.executable, *words],
            env={**os.environ, "PYTHONPATH": str(SCRIPT.parents[1])},
            stdout=subprocess.PIPE,
            stderr=stream,
            text=True,
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # a job in the background ignores it
        )
        while " 1 of 10" not in errors.read_text() and running.poll() is None:
            time.sleep(0.1)
        running.send_signal(signal.SIGINT)
        out, _ = running.communicate(timeout=120)
    assert running.returncode == 1, errors.read_text()
    assert "stopped" in errors.read_text().splitlines()[-1]
    found = json.loads(stored.read_text(encoding="utf-8"))
    (row,) = found["times"]
    assert found["stopped"]
    assert 1 <= len(row["rounds"]) < 10
    assert row["name"] in out


GROWN = growth.Series(
    "frames",
    "raster",
    [1, 2, 4],
    [quartiles(np.array([x, x, x])) for x in (0.1, 0.2, 0.4)],
    [0.1, 0.2, 0.4],
    [110.0, 120.0, 140.0],
    [10.0, 20.0, 40.0],
)


def test_growth_is_told_by_its_exponents_in_text_and_json():
    found = Found(growth=[GROWN])
    (stored,) = json.loads(json.dumps(document(found, machine())))["growth"]
    assert (stored["over"], stored["x"]) == ("frames", [1, 2, 4])
    for law in ("time_law", "memory_law"):
        assert stored[law]["exponent"] == pytest.approx(1.0)
    assert "over frames, raster: time ^ 1.00 \N{PLUS-MINUS SIGN} 0.00, memory ^ 1.00" in report(found, machine())


def test_where_memory_cannot_be_told_growth_is_that_of_time_alone():
    unknown = replace(GROWN, peak_mib=[None] * 3, above_mib=[None] * 3)
    assert unknown.memory_law is None
    assert "memory ^ no exponent" in report(Found(growth=[unknown]), machine())


def test_the_picture_of_growth_alone_and_of_times_alone_is_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    times = {"ours": timing("ours", [[0.1], [0.2]])}
    for name, found in (("growth", Found(growth=[GROWN])), ("times", Found(times=times))):
        draw(tmp_path / f"{name}.png", found, machine())
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("bars", "panels", "said"),
    [
        ([], [], "at least one is needed"),
        ([Bar("a", 0.0, 1.0, 2.0, True)], [], "times above 0"),
        ([], [Panel("x", "y", [Line("a", [1.0], [1.0], "1")] * 5)], "more than 4 lines"),
    ],
)
def test_a_picture_that_cannot_be_read_is_refused(tmp_path, bars, panels, said):
    with pytest.raises(InputError, match=said):
        plot_benchmark(tmp_path / "b.png", bars, panels)
    assert not (tmp_path / "b.png").exists()


def test_the_metric_alone_needs_no_scene(tmp_path):
    found = carry_out(Options(str(tmp_path / "none.toml"), repeats=1, parts=(METRIC,)))
    assert list(found.times) == ["the metric alone: 14,357 vehicles x 400 points"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--only", "everything"], "invalid choice: 'everything'"),
        (["--repeats", "0"], "allowed: a whole number from 1"),
        (["--sensor", "RS-7"], "invalid choice: 'RS-7'"),
        (["--caster", "magic"], "invalid choice: 'magic'"),
        (["--quick"], "unrecognized arguments: --quick"),
        (["--rep", "3"], "unrecognized arguments"),
    ],
)
def test_unknown_options_are_refused(words, said, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(*words)
    assert stopped.value.code == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("words", [["no/such/scene.toml"], ["--json", "no/such/folder/b.json"]])
def test_what_cannot_be_used_is_said_in_one_line(words, capsys):
    assert main(*words, "--only", "stages") == 2
    error = capsys.readouterr().err
    assert error.startswith("benchmark: ")
    assert error.count("\n") == 1
    assert words[-1] in error or "no/such" in error
