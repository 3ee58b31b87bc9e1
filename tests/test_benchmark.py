"""What is timed beside each other is the same thing, and what is said of the times follows from them."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

import tests.research
from benchmark import main
from benchmark_growth import (
    RADIUS_M,
    Measured,
    Series,
    dense_frame,
    grow,
    points_of,
    power_law,
    resident_mib,
    steps,
    with_rings,
)
from benchmark_report import Found, document, draw, machine, report
from benchmark_rivals import SPARSE, rivals_missing, rivals_of
from benchmark_stages import (
    Entry,
    FrameCase,
    NumPyProcess,
    Timing,
    in_rounds,
    optimisations,
    quartiles,
    stage_entries,
    whole_of,
)
from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.vehicles import overlapping_pairs
from tests.sample_traffic import dense_traffic
from tests.small_scene import write_scene

GATE_M = 60.0
HERE = [name for name in CASTERS if is_available(name)]
FAST = [name for name in HERE if name != "exact"] or ["exact"]


@pytest.fixture(scope="module")
def case():
    vehicles = dense_traffic(vehicles=40, length_m=90.0)
    near = np.hypot(*vehicles.centre_m[:, :2].T) < 30.0
    lattice = beam_lattice(load_model("RS-16"), stride=8)
    return FrameCase(vehicles, near, lattice, Pose(0.5, -0.5, 4.2, 0.35), GATE_M, "body", 0.05)


@pytest.fixture(scope="module")
def oracle(case):
    """What every beam meets, in float64."""
    exact = caster_class("exact")(case.triangles.corners, closed=True)
    return exact.cast(case.pose.position, case.directions, GATE_M)


# --- what is timed is right -------------------------------------------------------------------------------------------


def test_every_rival_casts_the_frames_own_beams_and_finds_what_the_oracle_finds(case, oracle):
    rivals = rivals_of(case)
    made = {"embreex": 2, "bpy": 6}
    assert len(rivals) == sum(number for library, number in made.items() if importlib.util.find_spec(library))
    for rival in rivals:
        found, expected = rival.distance(rival.cast()), oracle.distance[rival.beams]
        assert np.isfinite(expected).sum() > 10, rival.name
        same = np.isclose(found, expected, rtol=0.0, atol=2e-3)
        assert (same | (np.isinf(found) & np.isinf(expected))).mean() > 0.995, rival.name  # they leak at edges
        if rival.scale != 1.0:  # a part of the beams stands for all
            assert rival.scale == pytest.approx(len(case.directions) / len(rival.beams))
            assert len(rival.beams) == -(-len(case.directions) // SPARSE)
            assert f"{len(rival.beams):,} beams timed" in rival.entry.note
            assert len(np.unique(rival.beams % case.lattice.columns)) > case.lattice.rings  # many azimuths


def test_every_caster_scores_the_frame_as_exact_does_whole_by_stage_and_without_numba(case):
    entries = {entry.name: entry for entry in stage_entries(case, HERE)}
    expected = entries[whole_of("exact")].act()
    assert (expected > 0.0).any()
    swarm = [entry for entry in entries.values() if "swarm" in entry.name]
    assert all(entry.scale * len(entry.act()) == 1.0 for entry in swarm)  # the time of one mounting is told
    for name in HERE:
        np.testing.assert_allclose(entries[whole_of(name)].act(), expected, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(entries[f"{name}: scoring"].act(), expected[0], rtol=0.0, atol=1e-12)
    slow = NumPyProcess([case], HERE)
    assert len(slow.entries(0)) == 2 * len({"bvh", "embree"} & set(HERE))
    for entry in slow.entries(0):
        same = entries[entry.name.replace(" without Numba", "")]
        np.testing.assert_allclose(entry.act(), same.act(), rtol=0.0, atol=1e-12)
        assert entry.scale == same.scale
    slow.close()


def test_the_survivors_are_all_beams_that_meet_a_counted_vehicle(case, oracle):
    met = oracle.triangle
    of_counted = np.flatnonzero((met >= 0) & case.counted[case.triangles.owner[met]])
    assert len(of_counted)
    assert np.isin(of_counted, case.survivors).all()
    assert len(case.survivors) < len(case.directions)


def test_whole_optimisations_come_to_the_same_mounting_whatever_the_caster(tmp_path):
    scene, sensor = str(write_scene(tmp_path)), {("sensor", "name"): ("RS-16", "--sensor")}
    entries = optimisations(scene, sensor, FAST)
    found = [entry.act() for entry in entries]
    assert [entry.name for entry in entries] == [f"optimisation, RS-16, {name}" for name in FAST]
    for each in found:
        assert each.evaluations == len(each.history) == 100
        np.testing.assert_array_equal(each.history, found[0].history)
    fixed = write_scene(tmp_path, {"deployment": {"height_m": 4.0, "tilt_x_deg": 15.0}})
    with pytest.raises(InputError, match=r"\[deployment\] fixes every coordinate"):
        optimisations(str(fixed), {}, FAST)


# --- timing -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("warm", "rounds", "expected"),
    [(False, 3, ["a0", "b0", "a1", "b1"] * 3), (True, 1, ["a0", "a0", "b0", "b0", "a1", "a1", "b1", "b1"])],
)
def test_in_each_round_everything_is_done_once_after_another_and_warmed_before(warm, rounds, expected):
    done = []
    columns = [[Entry(name, partial(done.append, f"{name}{at}"), "g") for name in "ab"] for at in range(2)]
    in_rounds(columns, rounds, {}, warm=warm)
    assert done == expected


def test_seconds_are_those_of_the_clock_times_the_scale_and_rounds_before_an_interruption_are_kept():
    ticks, kept = iter([0.0, 1.0, 10.0, 13.0, 20.0]), {}

    def clock():
        try:
            return next(ticks)
        except StopIteration:
            raise KeyboardInterrupt from None

    with pytest.raises(KeyboardInterrupt):
        in_rounds([[Entry("a", lambda: None, "g", 2.0, "n")]], 3, kept, clock=clock)
    np.testing.assert_array_equal(kept["a"].seconds, [[2.0], [6.0]])
    assert kept["a"][:3] == ("a", "g", "n")


def timing(name, seconds):
    return Timing(name, "g", "", np.array(seconds, dtype=float))


def test_ratios_are_of_pairs_within_a_round_so_that_a_busy_moment_cancels_and_the_median_frame_counts():
    idle = timing("ours", [[1.0], [1.0], [1.0]]), timing("rival", [[2.0], [2.0], [2.0]])
    busy = timing("ours", [[1.0], [9.0], [1.0]]), timing("rival", [[2.0], [18.0], [2.0]])
    assert idle[0].ratio(idle[1]) == busy[0].ratio(busy[1]) == (0.5, 0.5, 0.5)
    assert timing("ours", [[1.0, 2.0, 90.0], [3.0, 4.0, 90.0]]).quartiles == (2.5, 3.0, 3.5)


# --- growth -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 2.0])
def test_of_a_power_law_the_exponent_is_found_without_error(exponent):
    x = np.array([1.0, 2.0, 4.0, 8.0, 256.0])
    law = power_law(x.tolist(), (3.0 * x**exponent).tolist())
    assert law == pytest.approx((exponent, 0.0, 3.0), abs=1e-12)


def test_the_standard_error_is_that_of_least_squares_and_where_no_law_can_be_fitted_there_is_none():
    rng, x = np.random.default_rng(0), np.geomspace(1.0, 256.0, 9)
    y = x**1.2 * np.exp(rng.normal(0.0, 0.1, len(x)))
    away, rest = np.log(x) - np.log(x).mean(), np.log(y) - np.log(y).mean()
    slope = away @ rest / (away @ away)
    error = np.sqrt(np.sum((rest - slope * away) ** 2) / 7 / (away @ away))  # of nine points with two parameters
    assert power_law(x.tolist(), y.tolist())[:2] == pytest.approx((slope, error))
    assert power_law([1.0, 4.0], [1.0, 2.0])[:2] == (pytest.approx(0.5), None)
    for x, y in (([2.0], [1.0]), ([1.0, 2.0], [0.0, 1.0]), ([1.0, 2.0], [1.0, None])):
        assert power_law(x, y) is None


def test_made_up_vehicles_stand_apart_within_reach_the_first_of_more_being_those_of_fewer():
    for vehicles in (1, 10, 1000):
        frame = dense_frame(vehicles, frame=3)
        assert len(frame.vehicles) == frame.counted.sum() == vehicles
        assert (np.hypot(*frame.vehicles.centre_m[:, :2].T) < RADIUS_M).all()
        assert len(overlapping_pairs(frame.vehicles)) == 0
    few, many = dense_frame(10).vehicles, dense_frame(300).vehicles
    np.testing.assert_array_equal(few.centre_m, many.centre_m[:10])
    assert not np.array_equal(few.centre_m, dense_frame(10, frame=1).vehicles.centre_m)
    with pytest.raises(InputError, match="allowed: 1 to"):
        dense_frame(100_000)


def test_growth_goes_from_one_to_all_and_changes_one_thing_at_a_time():
    every = steps(most_workers=6)
    assert (every["frames"], every["workers"]) == ([1, 2, 4, 8, 16, 32, 64, 128, 256], [1, 2, 4, 6])
    for over, values in every.items():
        points = points_of(over, values, "exact", "box", "RS-16")
        assert [getattr(point, over) for point in points] == values
        others = [name for name in ("caster", "frames", "vehicles", "rings", "workers") if name != over]
        assert len({tuple(getattr(point, name) for name in others) for point in points}) == 1
    model = load_model("RS-80")
    made = with_rings(model, 128)
    assert (made.rings, beam_lattice(made).columns) == (128, beam_lattice(model).columns)
    assert made.elevation_rad[[0, -1]] == pytest.approx(model.elevation_rad[[0, -1]])
    assert np.ptp(np.diff(made.elevation_rad)) == pytest.approx(0.0, abs=1e-12)


def test_peak_memory_holds_what_was_held_for_a_moment():
    """In a process of its own: an allocator that keeps what was freed, as Blender brings one, hands it out again."""
    if resident_mib() is None:
        pytest.skip("this system does not tell")
    program = """
import numpy as np
from benchmark_growth import peak_mib, resident_mib
before = resident_mib()
np.ones(64 << 17)  # 64 MiB, gone at once
print(peak_mib() - before)
"""
    where = {"cwd": tests.research.RESEARCH, "capture_output": True, "text": True, "check": True}
    assert 32.0 < float(subprocess.run([sys.executable, "-c", program], **where).stdout) < 128.0


def test_growth_is_measured_in_processes_of_their_own_and_what_was_measured_before_an_interruption_is_kept(monkeypatch):
    kept = []
    series = grow("vehicles", [2, 4], 1, (HERE[0], "box", "RS-16"), kept.append)
    assert [each.x for each in kept] == [[2], [2, 4]]
    assert all(each.median > 0.0 for each in series.seconds)
    for peak, above in zip(series.peak_mib, series.above_mib, strict=True):
        assert (peak is None and above is None) or peak > above >= 0.0

    def measured(point):
        if point.vehicles == 8:
            raise KeyboardInterrupt
        return Measured(0.1 * point.vehicles, 0.1, 100.0 + point.vehicles, float(point.vehicles))

    monkeypatch.setattr("benchmark_growth.in_fresh_process", measured)
    with pytest.raises(KeyboardInterrupt):
        grow("vehicles", [2, 4, 8], 3, ("raster", "box", "RS-16"), kept.append)
    assert kept[-1].x == [2, 4]
    assert kept[-1].time_law.exponent == pytest.approx(1.0)


# --- end to end -------------------------------------------------------------------------------------------------------


def test_a_whole_benchmark_of_a_small_scene_says_and_stores_what_it_found(tmp_path, capsys):
    scene, stored, picture = write_scene(tmp_path), tmp_path / "b.json", tmp_path / "b.png"
    words = ["--sensor", "RS-16", "--frames", 1, "--repeats", 1, "--detail", "box", "--json", stored]
    for name in FAST:
        words += ["--caster", name]
    if importlib.util.find_spec("matplotlib"):
        words += ["--picture", picture]
    assert main([str(word) for word in (scene, *words)]) == 0
    found, out = json.loads(stored.read_text(encoding="utf-8")), capsys.readouterr().out
    names = [row["name"] for row in found["times"]]
    assert {whole_of(name) for name in FAST} <= set(names)
    assert any("the metric alone" in name for name in names)
    assert len(found["optimisations"]) == len(FAST)
    assert found["frame"]["beams"] == 16 * load_model("RS-16").columns(20.0)
    assert found["growth"] == []
    assert found["left_out"].keys() >= rivals_missing().keys()
    for row in found["times"] + found["optimisations"]:
        assert 0.0 < row["seconds"]["low"] <= row["seconds"]["median"] <= row["seconds"]["high"]
        assert row["name"] in out
    beside = {row["name"] for row in found["times"] if "times_raw_embree" in row}
    assert beside == ({name for name in names if "the metric" not in name} if is_available("embree") else set())
    assert all(f"left out: {name}" in out for name in found["left_out"])
    assert picture.exists() == bool(importlib.util.find_spec("matplotlib"))


def test_ctrl_c_leaves_what_was_measured_in_a_whole_file(tmp_path, capsys, monkeypatch):
    stored, rounds = tmp_path / "b.json", iter([None, None])

    def advance(progress, steps, note=""):
        if next(rounds, "over"):
            raise KeyboardInterrupt

    monkeypatch.setattr("arguments.Progress.advance", advance)
    assert main(["--only", "metric", "--repeats", "10", "--json", str(stored)]) == 1
    out, err = capsys.readouterr()
    assert err.splitlines()[-1] == "benchmark: stopped"
    (row,) = (found := json.loads(stored.read_text(encoding="utf-8")))["times"]
    assert found["stopped"]
    assert len(row["rounds"]) == 3
    assert row["name"] in out


def test_growth_is_told_by_its_exponents_in_text_json_and_picture(tmp_path):
    seconds = [quartiles(np.array([x, x, x])) for x in (0.1, 0.2, 0.4)]
    grown = Series("frames", "raster", [1, 2, 4], seconds, [0.1, 0.2, 0.4], [110.0, 120.0, 140.0], [10.0, 20.0, 40.0])
    found = Found(growth=[grown])
    (stored,) = json.loads(json.dumps(document(found, machine())))["growth"]
    assert (stored["over"], stored["x"]) == ("frames", [1, 2, 4])
    assert [stored[law]["exponent"] for law in ("time_law", "memory_law")] == pytest.approx([1.0, 1.0])
    assert "over frames, raster: time ^ 1.00 \N{PLUS-MINUS SIGN} 0.00, memory ^ 1.00" in report(found, machine())
    unknown = grown._replace(peak_mib=[None] * 3, above_mib=[None] * 3)  # where memory cannot be told
    assert "memory ^ no exponent" in report(Found(growth=[unknown]), machine())
    pytest.importorskip("matplotlib")
    draw(tmp_path / "times.png", Found(times={"ours": timing("ours", [[0.1], [0.2]])}), machine())
    assert (tmp_path / "times.png").stat().st_size > 10_000


@pytest.mark.parametrize("words", [["no/such/scene.toml"], ["--json", "no/such/folder/b.json"]])
def test_what_cannot_be_used_is_said_in_one_line(words, capsys):
    assert main([*words, "--only", "ours"]) == 2
    error = capsys.readouterr().err
    assert (error.startswith("benchmark: "), error.count("\n"), "no/such" in error) == (True, 1, True)
