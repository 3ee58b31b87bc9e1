"""Options: how they are read, what each changes, and that they replace the scene's settings."""

from __future__ import annotations

import argparse
import json
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.commands.options import layout_from, scenario_from
from blender_lidar.commands.parsers import add_verbs, parse_frames
from blender_lidar.commands.verbs import VERBS
from blender_lidar.errors import InputError
from blender_lidar.scene.deployment import MOUNTING
from blender_lidar.scene.mounting import COORDINATES
from tests.refusals import refused
from tests.small_scene import cli, done, without_times, write_scene

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]


def parsed(scene: Path, *words: object, verb: str = "optimise") -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_verbs(parser.add_subparsers(), VERBS)
    return parser.parse_args([verb, str(scene), *map(str, words)])


# --- frame numbers ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("7", [7]),
        ("100,150", [100, 150]),
        ("100:103", [100, 101, 102, 103]),
        ("100:160:20", [100, 120, 140, 160]),
        ("100:159:20", [100, 120, 140]),
        ("3,10:12,7", [3, 10, 11, 12, 7]),
        (" 3 , 4 ", [3, 4]),
        ("-2:0", [-2, -1, 0]),
    ],
)
def test_frames_are_numbers_ranges_with_their_end_or_both_mixed(text, frames):
    assert parse_frames(text, "--frame-ids") == frames


@pytest.mark.parametrize("text", ["", ",", "1,", "a", "1.5", "1:2:3:4", ":", "1:", ":3", "3:1", "1:9:0", "1:9:-1"])
def test_anything_else_is_refused_with_the_forms_that_are_allowed(text):
    with pytest.raises(InputError, match=r"^--frame-ids: '.*'; allowed: "):
        parse_frames(text, "--frame-ids")


def test_a_range_beyond_all_recordings_is_refused_before_it_is_spelt_out():
    with pytest.raises(InputError, match="allowed: a range"):
        parse_frames("0:1000000000000", "--frame-ids")


@given(st.integers(-(10**6), 10**6), st.integers(0, 1000), st.integers(1, 50))
def test_a_range_never_goes_beyond_its_end(first, length, step):
    frames = parse_frames(f"{first}:{first + length}:{step}", "--frame-ids")
    assert frames[0] == first
    assert first + length - step < frames[-1] <= first + length
    assert set(np.diff(frames)) <= {step}


# --- what each option replaces ----------------------------------------------------------------------------------------

REPLACED = [
    ("--sensor", "RS-32", "sensor", "name", "RS-32"),
    ("--range-noise", "0.05", "sensor", "range_noise_m", 0.05),
    ("--range-noise", "datasheet", "sensor", "range_noise_m", 0.02),
    ("--dropout", "0.1", "sensor", "dropout", 0.1),
    ("--glass-dropout", "1", "sensor", "glass_dropout", 1.0),
    ("--range-at-10-percent", "70", "sensor", "range_at_10_percent_m", 70.0),
    ("--range-at-10-percent", "datasheet", "sensor", "range_at_10_percent_m", 56.6),
    ("--unit-spread", "0.03", "sensor", "unit_spread_deg", 0.03),
    ("--period", "2", "traffic", "period", "2"),
    ("--location", "i-80", "traffic", "location", "i-80"),
    ("--vehicle-types", "cars.rou.xml", "traffic", "vehicle_types", ("cars.rou.xml",)),
    ("--frames", "9", "traffic", "frames", 9),
    ("--frame-ids", "3:5", "traffic", "frame_ids", (3, 4, 5)),
    ("--caster", "bvh", "model", "caster", "bvh"),
    ("--workers", "3", "model", "workers", 3),
    ("--cluster", "tcp://host:8786", "model", "cluster", "tcp://host:8786"),
    ("--detail", "box", "world", "detail", "box"),
    ("--metric", "pe-vgop", "objective", "metric", "pe-vgop"),
    ("--reading", "paper", "objective", "reading", "paper"),
    ("--search", "grid", "search", "method", "grid"),
    ("--seed", "7", "search", "seed", 7),
    ("--particles", "11", "search", "particles", 11),
    ("--iterations", "12", "search", "iterations", 12),
]


def tables_of(scenario):
    """The settings of a scene of one recording and one LiDAR, by table."""
    kinds = ("world", "region", "objective", "search", "model", "drawing")
    (traffic,) = scenario.recordings
    return {kind: getattr(scenario, kind) for kind in kinds} | {"traffic": traffic, "sensor": scenario.lidar.sensor}


RIVALS = {("model", "cluster"): {("model", "workers")}}


@pytest.mark.parametrize(
    ("option", "value", "table", "key", "expected"), REPLACED, ids=["".join(row[:2]) for row in REPLACED]
)
def test_an_option_replaces_its_setting_and_no_other(tmp_path, option, value, table, key, expected):
    scene = write_scene(tmp_path)
    plain, changed = (scenario_from(parsed(scene, *words)) for words in ([], [option, value]))
    before, after = (tables_of(scenario) for scenario in (plain, changed))
    assert getattr(after[table], key) == expected
    different = {
        (name, field.name)
        for name, content in before.items()
        for field in fields(content)
        if getattr(content, field.name) != getattr(after[name], field.name)
    }
    # The level of detail stands in [world]; a list of frames takes the place of their number, a cluster of processes.
    assert different <= {(table, key), ("world", key), ("traffic", "frames"), *RIVALS.get((table, key), ())}


@pytest.mark.parametrize("value", ["nan", "-1", "inf", "much"])
def test_a_range_noise_that_cannot_be_is_refused_by_the_option(tmp_path, value):
    with pytest.raises(InputError, match=r"^--range-noise: is .*; allowed: "):
        scenario_from(parsed(write_scene(tmp_path), f"--range-noise={value}"))


def test_the_traffic_option_starts_from_the_working_folder(tmp_path):
    scene = write_scene(tmp_path / "scenes")
    assert scenario_from(parsed(scene, "--traffic", "other.csv")).recordings[0].path == "other.csv"


def test_a_mounting_is_the_baseline_but_for_what_is_given(tmp_path):
    args = parsed(write_scene(tmp_path), "--height", 4.1, "--tilt-x", -3, "--yaw", "-1.5", verb="evaluate")
    expected = {"x_m": 0.0, "y_m": 0.0, "height_m": 4.1, "tilt_x_deg": -3.0, "tilt_y_deg": 0.0, "yaw_deg": -1.5}
    (mounting,) = layout_from(args, scenario_from(args))
    found = mounting.as_table()
    assert {key: found[key] for key in expected} == pytest.approx(expected)


def test_every_coordinate_has_its_option():
    names = ["--x", "--y", "--height", "--tilt-x", "--tilt-y", "--yaw"]
    assert [MOUNTING[key].option for key in COORDINATES] == names


# --- what each option does to a run -----------------------------------------------------------------------------------


def run(capsys, scene: Path, out: str, *words: object, verb: str = "optimise") -> dict:
    done(capsys, verb, scene, "--out", out, *words)
    return json.loads((Path(out) / "result.json").read_text())


def test_frames_may_be_listed_in_any_form_and_order(tmp_path, capsys):
    scene = write_scene(tmp_path)
    one, other, third = (
        run(capsys, scene, f"run{number}", "--frame-ids", text)
        for number, text in enumerate(("9,15,21,27", "9:27:6", "27,9:21:6,9"))
    )
    assert one["frame_ids"] == [9, 15, 21, 27]
    assert without_times(one)["objective"] == other["objective"] == third["objective"]
    assert one["holdout"] is not None


def test_the_number_of_frames_is_as_asked_for(tmp_path, capsys):
    scene = write_scene(tmp_path)
    assert run(capsys, scene, "three", "--frames", 3)["frames"] == 3
    many = run(capsys, scene, "many", "--frames", 999)
    assert many["frames"] < 999
    assert any("instead of 999" in note for note in many["notes"])


@pytest.mark.parametrize("method", ["grid", "random", "de-pso", "hardened"])
def test_every_search_stays_within_its_budget_and_its_bounds(tmp_path, capsys, method):
    result = run(capsys, write_scene(tmp_path), "run", "--search", method, "--particles", 5, "--iterations", 3)
    assert result["search"] == method
    assert result["evaluations"] == 15
    assert 2.0 <= result["deployment"]["height_m"] <= 4.5
    assert result["deployment"]["tilt_x_deg"] == 15.0


def test_auto_names_the_caster_that_it_took(tmp_path, capsys, monkeypatch):
    from blender_lidar import casting

    scene = write_scene(tmp_path)
    monkeypatch.setattr(casting, "is_available", lambda name: name == "exact")
    code, _, err = cli(capsys, "evaluate", scene, "--caster", "auto")
    assert (code, err.count("\n")) == (2, 1)
    assert all(f'"blender_lidar[{extra}]"' in err for extra in ("fast", "blender"))


@pytest.mark.parametrize("words", [("--traffic", "a.csv", "--traffic", "b.csv"), ("--seed", "1", "--seed", "2")])
def test_an_option_that_is_given_twice_is_refused(tmp_path, capsys, words):
    line = refused(capsys, tmp_path, "optimise", write_scene(tmp_path), *words, "--out", "run")
    assert f"argument {words[0]}: is given twice; allowed: once" in line
