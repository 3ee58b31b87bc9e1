"""Range noise, drop-out and units on the command line: named in every result, and refused where they cannot be."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.refusals import refused
from tests.report_samples import Page
from tests.small_scene import done, write_scene

pytestmark = pytest.mark.usefixtures("quick")
NOISE, LOST, UNIT = ("--range-noise", "datasheet"), ("--dropout", 0.25), ("--unit-spread", 0.03)
GLASS, WEAK = ("--glass-dropout", 0.6), ("--range-at-10-percent", "datasheet")
WORDS = (*NOISE, *LOST, *GLASS, *WEAK, *UNIT)
PERFECT = {
    "range_noise_m": 0.0,
    "dropout": 0.0,
    "glass_dropout": 0.0,
    "range_at_10_percent_m": None,
    "unit_spread_deg": 0.0,
    "unit": 1,
    "noise_seed": 1,
}
TOLD = PERFECT | {
    "range_noise_m": 0.02,
    "dropout": 0.25,
    "glass_dropout": 0.6,
    "range_at_10_percent_m": 56.6,
    "unit_spread_deg": 0.03,
}


def test_a_cloud_tells_its_imperfections_and_the_elevations_of_its_unit(tmp_path, capsys):
    scene = write_scene(tmp_path)
    for name, words in (("plain", ()), ("rough", WORDS)):
        done(capsys, "scan", scene, "--frame", 30, "--out", f"{name}.npz", *words)
    plain, rough = (np.load(f"{name}.npz") for name in ("plain", "rough"))
    message = [json.loads(str(cloud["header"])) for cloud in (plain, rough)]
    assert message[0]["imperfections"] == PERFECT
    assert message[1]["imperfections"] == TOLD
    off = np.subtract(*(each["ring_elevation_deg"] for each in message))
    assert 0.005 < abs(off).max() < 0.15
    assert 0.6 * len(plain["range_m"]) < len(rough["range_m"]) < 0.9 * len(plain["range_m"])


def test_a_run_says_what_is_assumed_of_a_beam_table_that_leaves_it_open(tmp_path, capsys):
    (tmp_path / "own.csv").write_text("ring,elevation_deg\n0,-15\n1,-5\n")
    scene = write_scene(tmp_path, {"sensor": {"name": "own.csv", "rotation_hz": None}})
    done(capsys, "evaluate", scene, "--height", 3, "--out", "own")
    message, _ = done(capsys, "report", "own", "--all")
    assert (
        "Assumed: The sensor's file leaves open, and is taken to mean: 10 turns a second; a column every 55.55 us, "
        "1800 a turn at 10 Hz; it sees from 0.4 m; it sees to 200 m; range noise 0.02 m where asked for; every beam "
        "looks along its column; all beams of a column fire at once."
    ) in " ".join(message.split())
    message, _ = done(capsys, "evaluate", write_scene(tmp_path), "--height", 3, "--out", "shipped")
    assert "Assumed" not in message


def test_a_result_tells_its_imperfections_and_the_run_says_so(tmp_path, capsys):
    scene, results = write_scene(tmp_path), []
    for name, words in (("plain", ()), ("rough", WORDS), ("again", WORDS)):
        out, _ = done(capsys, "evaluate", scene, "--height", 3, "--out", name, *words)
        results.append(json.loads((tmp_path / name / "result.json").read_text()))
        line = (
            "range noise 0.02 m, drop-out 25 %, drop-out on glass 60 %, noise seed 1, a 10 % target seen to 56.6 m, "
            "unit 1 of units that differ by 0.03 deg"
        )
        page = Page((tmp_path / name / "report.html").read_text(encoding="utf-8"))
        notes = page.text(page.find("ul")[0])
        for message in (out, notes):
            assert (line in message) == bool(words)
        assert ("imperfect" in notes) == bool(words)
    assert results[1]["imperfections"] == TOLD
    assert results[1]["objective"] == results[2]["objective"] != results[0]["objective"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--dropout", 1), "--dropout: is 1.0; allowed: at least 0 and less than 1"),
        (("--dropout", "nan"), "--dropout: is nan; allowed: a number"),
        (("--glass-dropout", 1.1), "--glass-dropout: is 1.1; allowed: 0 to 1"),
        (("--range-at-10-percent", 0), "--range-at-10-percent: is 0.0; allowed: 0.01"),
        (("--range-at-10-percent", "far"), "--range-at-10-percent: is 'far'; allowed: a number, or \"datasheet\""),
        (
            ("--sensor", "RS-LiDAR-32", "--range-at-10-percent", "datasheet"),
            "--range-at-10-percent: no source gives that of RS-LiDAR-32; allowed: a number",
        ),
        (("--range-noise", "much"), "--range-noise: is 'much'; allowed: a number, or \"datasheet\""),
        (("--unit-spread", 50), "--unit-spread: is 50.0; allowed: 0 to 5"),
        (("--sensor", "RS-BPearl", "--unit-spread", 5), "--unit-spread: unit 4 of RS-BPearl has ring 31 at 9"),
    ],
)
def test_the_command_line_refuses_what_cannot_be_in_one_line_and_leaves_nothing(tmp_path, capsys, words, named):
    scene = write_scene(tmp_path, {"sensor": {"unit": 4, "rotation_hz": None, "range_gate_m": 20.0}})
    before = set(tmp_path.iterdir())
    assert named in refused(capsys, tmp_path, "scan", scene, "--frame", 30, "--out", "cloud.npz", *words)
    assert set(tmp_path.iterdir()) == before
