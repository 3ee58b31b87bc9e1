"""What is timed beside each other is the same thing, and what is said of the times follows from them."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import tests.research  # noqa: F401
from benchmark import main
from benchmark_rivals import rivals_missing, rivals_of
from benchmark_stages import (
    Entry,
    FrameCase,
    NumPyProcess,
    Timing,
    in_rounds,
    optimisations,
    stage_entries,
    whole_of,
)
from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.errors import InputError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
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
    return FrameCase(replace(vehicles, counted=near), lattice, Pose(0.5, -0.5, 4.2, 0.35), GATE_M, "body", 0.05)


@pytest.fixture(scope="module")
def oracle(case):
    """What every beam meets, in float64."""
    exact = caster_class("exact")(case.triangles.corners, closed=True)
    return exact.cast(case.pose.position, case.directions, GATE_M)


# --- what is timed is right -------------------------------------------------------------------------------------------


def test_every_rival_casts_the_frames_own_beams_and_finds_what_the_oracle_finds(case, oracle):
    rivals = rivals_of(case)
    made = {"embreex": 2, "bpy": 4}
    assert len(rivals) == sum(number for library, number in made.items() if importlib.util.find_spec(library))
    for rival in rivals:
        found, expected = rival.distance(rival.cast()), oracle.distance[rival.beams]
        assert np.isfinite(expected).sum() > 10, rival.name
        same = np.isclose(found, expected, rtol=0.0, atol=2e-3)
        assert (same | (np.isinf(found) & np.isinf(expected))).mean() > 0.995, rival.name  # they leak at edges


def test_every_caster_scores_the_frame_as_exact_does_whole_by_stage_and_without_numba(case):
    entries = {entry.name: entry for entry in stage_entries(case, HERE)}
    expected = entries[whole_of("exact")].act()
    assert (expected > 0.0).any()
    swarm = [entry for entry in entries.values() if entry.name.endswith(("swarm of 20", "drop-out 0.1", "barrier"))]
    assert len(swarm) == len(HERE) + 2
    assert all(entry.scale * len(entry.act()) == 1.0 for entry in swarm)  # the time of one mounting is reported
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
    of_counted = np.flatnonzero((met >= 0) & case.vehicles.counted[case.triangles.owner[met]])
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
    assert idle[0].ratio(idle[1]) == busy[0].ratio(busy[1]) == (0.5, 0.5, 0.5, 0.5)
    assert timing("ours", [[1.0, 2.0, 90.0], [3.0, 4.0, 90.0]]).quartiles == (2.0, 2.5, 3.0, 3.5)


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


@pytest.mark.parametrize("words", [["no/such/scene.toml"], ["--json", "no/such/folder/b.json"]])
def test_what_cannot_be_used_is_said_in_one_line(words, capsys):
    assert main([*words, "--only", "ours"]) == 2
    error = capsys.readouterr().err
    assert (error.startswith("benchmark: "), error.count("\n"), "no/such" in error) == (True, 1, True)
