"""``blender-lidar sensors``: the list, one model in full, JSON, and the chart of the beam fan."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.commands import sensors
from blender_lidar.commands.parsers import add_verbs
from blender_lidar.commands.verbs import VERBS
from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError
from blender_lidar.report.beam_fan import ground_distance_m
from blender_lidar.sensors.model import load_model, model_names

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def run(*words: str) -> int:
    parser = argparse.ArgumentParser()
    add_verbs(parser.add_subparsers(required=True), VERBS)
    return sensors.run(parser.parse_args(["sensors", *map(str, words)]))


def own_sensor(folder: Path, rows: str) -> str:
    path = folder / "own.csv"
    path.write_text("ring,elevation_deg\n" + rows)
    return str(path)


def test_the_list_has_one_line_per_model_with_its_facts(capsys):
    assert run() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1 : 1 + len(model_names())]] == model_names()
    line = next(line for line in lines if line.startswith("RS-32 "))
    for fact in ("32", "-16 to +15", "1800", "576,000", "0.2-150", "medium", "RS-Helios-1615"):
        assert fact in line


@pytest.mark.parametrize("name", model_names())
def test_every_page_fits_100_columns_and_shows_every_ring(name, capsys):
    assert run(name) == 0
    out, err = capsys.readouterr()
    assert max(map(len, out.splitlines())) <= 100
    assert err == ""
    model = load_model(name)
    rings = [f"{e:.3f}" for e in np.degrees(model.elevation_rad)]
    table = out[out.index("ring elevation") :]
    assert all(ring in table for ring in rings)
    assert " ".join(model.source.split())[:40] in " ".join(out.split())


def test_a_page_tells_the_columns_that_an_ouster_may_be_set_to(capsys):
    run("OS1-128")
    expected = " ".join(capsys.readouterr().out.split())
    assert "512 at 10 or 20 Hz, 1024 at 10 or 20 Hz, 2048 at 10 Hz (1024 at 10 Hz is the default)" in expected
    run("OS1-128", "--json")
    facts = json.loads(capsys.readouterr().out)
    assert (facts["columns"], facts["columns_a_turn"]) == (1024, [512, 1024, 2048])


def test_every_assumption_made_for_a_users_own_table_is_told(tmp_path, capsys):
    path = own_sensor(tmp_path, "0,-10\n1,-5\n")
    run(path)
    expected = " ".join(capsys.readouterr().out.split())
    run(path, "--json")
    assumed = json.loads(capsys.readouterr().out)["assumed"]
    keys = ["rotation_hz", "block_time_us", "range_min_m", "range_max_m", "range_noise_m"]
    assert list(assumed) == [*keys, "azimuth_offset_deg", "fire_offset_us"]
    assert all(f"{text} ({key})" in expected for key, text in assumed.items())
    run("RS-16")
    assert "assumed" not in capsys.readouterr().out


@pytest.mark.parametrize(("name", "expected"), [("RS-80", "seen to 160 m"), ("VLP-16", None)])
def test_how_far_a_dark_target_is_seen_is_told_where_a_source_gives_it(capsys, name, expected):
    run(name)
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("10 % target")]
    assert [line.removeprefix("10 % target").strip() for line in lines] == ([expected] if expected else [])


def test_json_of_the_list_is_json_alone(capsys):
    assert run("--json") == 0
    listed = json.loads(capsys.readouterr().out)
    assert [model["name"] for model in listed] == model_names()
    assert next(model for model in listed if model["name"] == "RS-16")["points_per_second"] == 288_320


def test_json_of_one_model_holds_every_beam_as_its_file_gives_it(capsys):
    assert run("rs-ruby-lite", "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["name"] == "RS-80"
    assert facts["columns_by_rotation_hz"] == {"5": 3600, "10": 1800, "20": 900}
    assert (facts["block_time_us"], facts["range_at_10_percent_m"]) == (55.552, 160.0)
    assert facts["beams"][1] == {
        "ring": 1,
        "elevation_deg": -19.582,
        "azimuth_offset_deg": 2.55,
        "fire_offset_us": 12.944,
    }
    assert len(facts["beams"]) == facts["rings"] == 80


def test_json_says_null_where_a_firing_time_is_unknown(capsys):
    run("HDL-64E-S3", "--json")
    assert {beam["fire_offset_us"] for beam in json.loads(capsys.readouterr().out)["beams"]} == {None}


@pytest.mark.parametrize("rows", ["0,-90\n1,90\n", "0,0\n", "0,-1e-9\n", "0,90\n", "0,-89.999\n1,-0.0001\n2,0.0001\n"])
def test_a_users_own_table_is_shown_however_its_beams_point(rows, tmp_path, capsys):
    assert run(own_sensor(tmp_path, rows)) == 0
    out = capsys.readouterr().out
    assert out.startswith("own\n")
    assert max(len(line) for line in out.splitlines()) <= 100


def test_rings_meet_the_road_where_trigonometry_says():
    distance = ground_distance_m(load_model("RS-16"))
    np.testing.assert_allclose(distance[:7], [4.0 / math.tan(math.radians(a)) for a in (15, 13, 11, 9, 7, 5, 3)])
    assert np.all(np.isinf(distance[7:]))  # the last one downwards lands at 229 m, the sensor sees 150 m far


def test_the_chart_is_a_png_and_json_stays_alone_on_stdout(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    chart = tmp_path / "fan.png"
    assert run("RS-LiDAR-32", "--json", "--out", chart) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["name"] == "RS-LiDAR-32"
    assert str(chart) in err
    assert chart.read_bytes().startswith(PNG_SIGNATURE)
    assert [path.name for path in tmp_path.iterdir()] == ["fan.png"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rows", ["0,-90\n1,90\n", "0,0\n", "0,5\n1,5\n"])
def test_the_chart_draws_whatever_beams_a_sensor_has(rows, tmp_path):
    pytest.importorskip("matplotlib")
    assert run(own_sensor(tmp_path, rows), "--out", tmp_path / "fan.png") == 0


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (["RS-17"], InputError, "did you mean 'RS-16'"),
        (["none.toml"], MissingFileError, "there is no such file"),
        (["--out", "fan.png"], InputError, "--out fan.png: draws one sensor, so it needs a NAME"),
        (["RS-16", "--out", "fan.jpg"], InputError, r"--out fan\.jpg: the fan is drawn as a \.png"),
    ],
)
def test_wrong_input_is_one_line_and_prints_nothing(words, error, message, capsys):
    with pytest.raises(error, match=message) as caught:
        run(*words)
    assert isinstance(caught.value, BlenderLidarError)
    assert "\n" not in str(caught.value)
    assert capsys.readouterr().out == ""
