"""The LiDAR models that come with the package, and sensor files of a user's own."""

from __future__ import annotations

import csv
import math
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError
from blender_lidar.sensors.files import MAX_RINGS
from blender_lidar.sensors.model import DATA_FOLDER, load_model, model_names
from tests.waiting import WAIT_S

BEAM_TABLES = Path(__file__).parents[2] / "shared" / "reference" / "beams"
VELODYNE_TURNS_THE_OTHER_WAY = -1.0
# Model: table of beams, whether its firing times are known, sign of its azimuth offsets.
TABLE_OF = {
    "RS-16": ("rs16", True, 1.0),
    "RS-32": ("rs_helios_1615", True, 1.0),
    "RS-LiDAR-32": ("rs32", True, 1.0),
    "RS-80": ("rs_ruby_lite80", True, 1.0),
    "RS-Ruby-80V": ("rs_ruby80v", True, 1.0),
    "RS-Ruby-128": ("rs_ruby128", True, 1.0),
    "RS-Helios-5515": ("rs_helios_5515", True, 1.0),
    "RS-BPearl": ("rs_bpearl", True, 1.0),
    "VLP-16": ("velodyne_vlp16", True, VELODYNE_TURNS_THE_OTHER_WAY),
    "HDL-64E-S2": ("velodyne_hdl64e_s2", False, VELODYNE_TURNS_THE_OTHER_WAY),
    "HDL-64E-S3": ("velodyne_hdl64e_s3", False, VELODYNE_TURNS_THE_OTHER_WAY),
}
THREE_BEAMS = "beams = [[0, -2.0, 1.5, 0.0], [1, -1.0, 0.0, 2.5], [2, 0.0, -1.5, nan]]\n"


def written(folder: Path, text: str | bytes, name: str = "own.toml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def elevation_deg(name: str) -> np.ndarray:
    return np.degrees(load_model(name).elevation_rad)


def test_the_models_of_the_paper_and_the_reference_sensors_are_there():
    assert sorted(model_names()) == sorted(TABLE_OF)


@pytest.mark.parametrize("name", TABLE_OF)
def test_every_model_says_where_its_numbers_come_from_and_is_complete(name):
    model = load_model(name)
    assert model.name == name
    assert model.description
    assert len(model.source) > 50
    assert model.confidence.partition(":")[0] in ("high", "medium-high", "medium")
    assert model.default_rotation_hz == 10.0
    assert model.default_rotation_hz in model.rotation_hz
    assert model.rings == len(model.azimuth_offset_rad) == len(model.fire_time_s)
    assert np.all(np.diff(model.elevation_rad) >= 0.0)
    assert np.all(np.isfinite(model.azimuth_offset_rad))
    assert not np.any(model.fire_time_s > model.block_time_s)
    assert 0.0 < model.range_min_m < model.range_max_m
    assert 0.0 < model.range_noise_m < 0.05
    assert model.range_at_10_percent_m is None or 20.0 < model.range_at_10_percent_m <= model.range_max_m


@pytest.mark.parametrize("name", TABLE_OF)
def test_every_beam_equals_the_reference_table(name):
    if not BEAM_TABLES.is_dir():
        pytest.skip(f"no reference beam tables at {BEAM_TABLES}")
    table, timed, sign = TABLE_OF[name]
    with (BEAM_TABLES / f"{table}.csv").open() as file:
        beams = {int(row["ring"]): row for row in csv.DictReader(file)}
    model = load_model(name)
    assert sorted(beams) == list(range(model.rings))
    for ring, row in beams.items():
        assert math.degrees(model.elevation_rad[ring]) == pytest.approx(float(row["elevation_deg"]), abs=1e-9)
        expected = sign * float(row["azimuth_offset_deg"])
        assert math.degrees(model.azimuth_offset_rad[ring]) == pytest.approx(expected, abs=1e-9)
    if not timed:
        assert np.all(np.isnan(model.fire_time_s))
        return
    with (BEAM_TABLES / f"{table}_timing.csv").open() as file:
        times = {int(row["ring"]): float(row["fire_offset_us"]) for row in csv.DictReader(file)}
    assert sorted(times) == list(range(model.rings))
    for ring, time_us in times.items():
        assert model.fire_time_s[ring] * 1e6 == pytest.approx(time_us, abs=1e-9)


def test_rs_16_steps_evenly_by_two_degrees():
    np.testing.assert_allclose(elevation_deg("RS-16"), np.arange(-15.0, 16.0, 2.0))


def test_the_papers_rs_32_is_the_even_helios_and_the_uneven_one_has_its_own_name():
    np.testing.assert_allclose(elevation_deg("RS-32"), np.arange(-16.0, 16.0))
    uneven = elevation_deg("RS-LiDAR-32")
    np.testing.assert_allclose(uneven[[0, -1]], [-25.0, 15.0])
    assert np.ptp(np.diff(uneven)) > 5.0


def test_rs_80_is_the_ruby_lite_and_the_80v_looks_almost_only_down():
    lite, roadside = elevation_deg("RS-80"), elevation_deg("RS-Ruby-80V")
    assert np.sum(lite <= -0.09 + 1e-9) == 58
    assert np.sum(roadside <= -0.09 + 1e-9) == 77
    dense = lite[(lite >= -2.99 - 1e-9) & (lite <= 1.01 + 1e-9)]
    np.testing.assert_allclose(np.diff(dense), 0.1, atol=1e-9)
    assert dense.size == 41


def test_every_beam_of_the_ruby_lite_is_one_of_the_ruby_128():
    of_128 = {(round(e, 4), round(a, 4)) for e, a in _angles("RS-Ruby-128")}
    assert {(round(e, 4), round(a, 4)) for e, a in _angles("RS-80")} <= of_128


def _angles(name: str) -> np.ndarray:
    model = load_model(name)
    return np.degrees(np.stack([model.elevation_rad, model.azimuth_offset_rad], axis=1))


def test_velodyne_offsets_are_turned_into_clockwise_ones():
    # rot_correction of the S2's lowest laser is -2.053 degrees; its clockwise azimuth is encoder - rot_correction.
    assert math.degrees(load_model("HDL-64E-S2").azimuth_offset_rad[0]) == pytest.approx(+2.053)


@pytest.mark.parametrize(
    ("name", "columns"),
    [("RS-16", 1802), ("RS-32", 1800), ("RS-80", 1800), ("RS-LiDAR-32", 1801), ("VLP-16", 1808), ("HDL-64E-S2", 2083)],
)
def test_columns_per_turn_are_the_turn_over_the_block_time(name, columns):
    assert load_model(name).columns() == columns


def test_a_slower_turn_has_more_columns():
    model = load_model("RS-16")
    assert [model.columns(rate) for rate in (5, 10, 20)] == [3604, 1802, 901]


@pytest.mark.parametrize("rate", [0.0, -10.0, 7.0, math.nan, math.inf])
def test_a_rate_the_sensor_does_not_have_is_refused(rate):
    with pytest.raises(InputError, match=r"RS-80 does not turn at .* Hz; allowed: 5, 10, 20"):
        load_model("RS-80").columns(rate)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("rs-80", "RS-80"),
        ("RS80", "RS-80"),
        ("rs_ruby_lite", "RS-80"),
        ("RS-Helios-1615", "RS-32"),
        ("rs-lidar-16", "RS-16"),
        ("RS-Bpearl", "RS-BPearl"),
        ("hdl 64e s3", "HDL-64E-S3"),
    ],
)
def test_names_and_aliases_are_found_however_they_are_spelt(given, name):
    assert load_model(given).name == name


def test_no_two_models_share_a_name_or_alias():
    models = [load_model(name) for name in model_names()]
    names = [spelt.lower().replace("-", "") for model in models for spelt in (model.name, *model.aliases)]
    assert len(names) == len(set(names))


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(InputError, match=r"unknown sensor 'RS-Ruby-8OV'; did you mean 'RS-Ruby-80V'\?"):
        load_model("RS-Ruby-8OV")


@pytest.mark.parametrize("given", ["", " ", "no such sensor", "\0", "x" * 5000])
def test_what_is_neither_a_name_nor_a_path_is_refused(given):
    with pytest.raises(InputError, match="unknown sensor"):
        load_model(given)


def test_a_model_cannot_be_changed():
    model = load_model("RS-16")
    with pytest.raises(ValueError, match="read-only"):
        model.elevation_rad[0] = 0.0
    with pytest.raises(AttributeError):
        model.name = "other"


def test_a_model_survives_pickling():
    model = load_model("RS-80")
    copy = pickle.loads(pickle.dumps(model))
    assert copy.name == model.name
    np.testing.assert_array_equal(copy.fire_time_s, model.fire_time_s)


def test_the_sensors_room_imports_with_numpy_alone():
    blocked = "import sys; sys.modules.update(dict.fromkeys(('bpy', 'mathutils', 'pandas', 'matplotlib', 'embreex')))"
    use = "from blender_lidar.sensors import beams, model, pose; beams.beam_lattice(model.load_model('RS-16'))"
    subprocess.run([sys.executable, "-c", f"{blocked}; {use}"], check=True, timeout=WAIT_S)


# A user's own file


@pytest.mark.parametrize("path", sorted(DATA_FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_a_shipped_file_loads_by_its_path_too(path):
    model = load_model(path)
    np.testing.assert_array_equal(model.elevation_rad, load_model(model.name).elevation_rad)


def test_a_toml_of_beams_alone_takes_the_documented_defaults(tmp_path):
    model = load_model(written(tmp_path, THREE_BEAMS))
    assert model.name == "own"
    assert (model.rotation_hz, model.default_rotation_hz) == ((10.0,), 10.0)
    assert model.block_time_s == pytest.approx(55.55e-6)
    assert (model.range_min_m, model.range_max_m, model.range_noise_m) == (0.4, 200.0, 0.02)
    assert model.range_at_10_percent_m is None
    assert (model.description, model.source, model.aliases) == ("", "", ())
    empty = 'name = ""\naliases = []\nrotation_hz = []\nsource = ""\n'  # counts as left out
    assert load_model(written(tmp_path, empty + THREE_BEAMS)).rotation_hz == (10.0,)
    np.testing.assert_allclose(np.degrees(model.elevation_rad), [-2.0, -1.0, 0.0])
    np.testing.assert_allclose(np.degrees(model.azimuth_offset_rad), [1.5, 0.0, -1.5])
    np.testing.assert_allclose(model.fire_time_s, [0.0, 2.5e-6, np.nan])


def test_a_toml_keeps_every_setting(tmp_path):
    settings = (
        'name = "Mine"\naliases = ["M"]\ndescription = "d"\nsource = """a\nb"""\nconfidence = "low"\n'
        "rotation_hz = [12.5, 25]\nblock_time_us = 40\nrange_min_m = 1\nrange_max_m = 90\nrange_noise_m = 0\n"
        "range_at_10_percent_m = 45\n"
    )
    model = load_model(str(written(tmp_path, settings + THREE_BEAMS)))
    assert (model.name, model.aliases, model.description, model.source) == ("Mine", ("M",), "d", "a b")
    assert (model.rotation_hz, model.default_rotation_hz) == ((12.5, 25.0), 12.5)
    assert model.columns() == 2000
    assert (model.range_min_m, model.range_max_m, model.range_noise_m) == (1.0, 90.0, 0.0)
    assert model.range_at_10_percent_m == 45.0


@pytest.mark.parametrize("header", ["ring,elevation_deg", " ring , elevation_deg ", "\ufeffring,elevation_deg"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_csv_needs_only_rings_and_elevations_in_any_order(tmp_path, header, newline):
    model = load_model(written(tmp_path, newline.join([header, "2,0", "", "0,-2", "1,-1", ""]), "own.csv"))
    np.testing.assert_allclose(np.degrees(model.elevation_rad), [-2.0, -1.0, 0.0])
    np.testing.assert_array_equal(model.azimuth_offset_rad, 0.0)
    assert np.all(np.isnan(model.fire_time_s))
    assert model.columns() == 1800


def test_a_csv_may_give_its_columns_in_any_order(tmp_path):
    text = "fire_offset_us,ring,azimuth_offset_deg,elevation_deg\nnan,0,1.5,-1\n3,1,-2,4\n"
    model = load_model(written(tmp_path, text, "OWN.CSV"))
    np.testing.assert_allclose(np.degrees(model.azimuth_offset_rad), [1.5, -2.0])
    np.testing.assert_allclose(model.fire_time_s, [np.nan, 3e-6])


# What is wrong, the file, and the beginning of the line that says so; OWN is the file.
BAD_CSV = {
    "no elevation": ("ring\n0\n", "OWN:2 elevation_deg: is missing"),
    "no header": ("0,-1\n1,0\n", "OWN:1: unknown column '0'"),
    "misspelt column": ("ring,elevation\n0,1\n", "OWN:1: unknown column 'elevation'; did you mean 'elevation_deg'"),
    "column twice": ("ring,elevation_deg,ring\n0,1,0\n", "OWN:1: column 'ring' is given twice"),
    "text in a number": ("ring,elevation_deg\n0,-1\n1,low\n", "OWN:3 elevation_deg: is 'low'; allowed: a number"),
    "underscore": ("ring,elevation_deg\n0,-1_0\n", "OWN:2 elevation_deg: is '-1_0'; allowed: a number"),
    "other digits": ("ring,elevation_deg\n0,\u0663\n", "OWN:2 elevation_deg: is '\u0663'; allowed: a number"),
    "empty cell": ("ring,elevation_deg\n0,\n", "OWN:2 elevation_deg: is ''; allowed: a number"),
    "short row": ("ring,elevation_deg\n0,-1\n1\n", "OWN:3: 1 values, where the header has 2"),
    "no rows": ("ring,elevation_deg\n", "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "NaN elevation": ("ring,elevation_deg\n0,nan\n", "OWN:2 elevation_deg: is 'nan'; allowed: a number"),
    "infinite azimuth": ("ring,elevation_deg,azimuth_offset_deg\n0,1,inf\n", "OWN:2 azimuth_offset_deg: is inf"),
    "past the zenith": (
        "ring,elevation_deg\n0,90.1\n",
        "OWN:2 elevation_deg: is 90.1; allowed: -90 to 90",
    ),
    "negative time": (
        "ring,elevation_deg,fire_offset_us\n0,1,-1\n",
        "OWN:2 fire_offset_us: is -1.0; allowed: 0 to",
    ),
    "ring twice": (
        "ring,elevation_deg\n0,1\n0,2\n",
        "OWN:3: ring is 0; 2 rings are numbered 0 (lowest) to 1, each once",
    ),
    "ring missing": ("ring,elevation_deg\n0,1\n2,2\n", "OWN:3: ring is 2; 2 rings are numbered 0 (lowest) to 1"),
    "half a ring": ("ring,elevation_deg\n0,1\n0.5,2\n", "OWN:3: ring is 0.5"),
    "NaN ring": ("ring,elevation_deg\nnan,1\n", "OWN:2 ring: is 'nan'"),
    "from the top": ("ring,elevation_deg\n0,1\n1,-1\n", "OWN:3: ring 1 at -1 degrees lies below ring 0 at 1"),
    "semicolons": ("ring;elevation_deg\n0;1\n", "OWN:1: unknown column 'ring;elevation_deg'"),
    "empty": ("", "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "blank": (" \n\n", "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "binary": (b"ring,elevation_deg\n\0\0\n", "OWN:2: 1 values"),
    "not UTF-8": (
        b"ring,elevation_deg\n\xff\xfe\n",
        "OWN: is not CSV: 'utf-8' codec can't decode byte 0xff",
    ),
    "far too many rings": ("ring,elevation_deg\n" + "0,1\n" * (MAX_RINGS + 1), "OWN:beams: 4097 rings; allowed: 1"),
    "far too large": (b"x" * 1_100_000, "OWN: is not CSV: field larger"),
    "endless cell": ("ring,elevation_deg\n0," + "1" * 200_000, "OWN: is not CSV: field larger"),
}
BAD_TOML = {
    "no beams": ('name = "x"', "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "unknown key": ("beam" + THREE_BEAMS[5:], "OWN:beam: unknown key 'beam'; did you mean 'beams'"),
    "beams no list": ("beams = 3", "OWN:beams: is 3; allowed: a list"),
    "a beam no list": ("beams = [1, 2]", "OWN:beams: 1, where [ring"),
    "a beam too short": ("beams = [[0]]", "OWN:beams[0] elevation_deg: is missing"),
    "a beam too long": ("beams = [[0, 1, 2, 3, 4]]", "OWN:beams: [0, 1, 2, 3, 4], where"),
    "text in a beam": ('beams = [[0, 1], [1, "2"]]', "OWN:beams[1] elevation_deg: is '2'; allowed: a number"),
    "truth in a beam": ("beams = [[0, true]]", "OWN:beams[0] elevation_deg: is True; allowed: a number"),
    "rate no list": ("rotation_hz = 10\n" + THREE_BEAMS, "OWN:rotation_hz: is 10; allowed: a list, each a number"),
    "standing still": ("rotation_hz = [0]\n" + THREE_BEAMS, "OWN:rotation_hz: is 0; allowed: 0.01 to "),
    "no such rate": ("default_rotation_hz = 5\n" + THREE_BEAMS, "OWN:default_rotation_hz: is 5; allowed: one of"),
    "no block time": ("block_time_us = 0\n" + THREE_BEAMS, "OWN:block_time_us: is 0; allowed: 0.01 to "),
    "block longer than the turn": ("block_time_us = 1e6\n" + THREE_BEAMS, "OWN:block_time_us: 1e+06 us at 10 Hz"),
    "far too many beams": ("block_time_us = 0.01\n" + THREE_BEAMS, "OWN:block_time_us: 0.01 us at 10 Hz make"),
    "negative range": ("range_min_m = -1\n" + THREE_BEAMS, "OWN:range_min_m: is -1; allowed: 0 to 1"),
    "ranges upside down": (
        "range_min_m = 9\nrange_max_m = 8\n" + THREE_BEAMS,
        "OWN:range_max_m: is 8; allowed: more than range_min_m, 9",
    ),
    "NaN range": ("range_max_m = nan\n" + THREE_BEAMS, "OWN:range_max_m: is nan; allowed: a number"),
    "negative noise": ("range_noise_m = -0.1\n" + THREE_BEAMS, "OWN:range_noise_m: is -0.1"),
    "blind": ("range_at_10_percent_m = 0\n" + THREE_BEAMS, "OWN:range_at_10_percent_m: is 0; allowed: 0.01 to "),
    "number for a name": ("name = 3\n" + THREE_BEAMS, "OWN:name: is 3; allowed: a text"),
    "number for an alias": ("aliases = [3]\n" + THREE_BEAMS, "OWN:aliases: is 3; allowed: a text"),
    "a table for a number": ("block_time_us = {}\n" + THREE_BEAMS, "OWN:block_time_us: is {}; allowed: a number"),
    "no TOML": ("x = 1\nbeams = [[0 1]]\n", "OWN: is not TOML: Unclosed array (at line 2"),
    "endless number": (f"block_time_us = {'9' * 5000}\n{THREE_BEAMS}", "OWN: is not TOML"),
    "huge number": (f"block_time_us = {'9' * 400}\n{THREE_BEAMS}", "OWN:block_time_us: is 9"),
    "endless nesting": ("beams = " + "[" * 50_000, "OWN: is not TOML"),
    "empty": ("", "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "not UTF-8": (b'name = "\xff"', "OWN: is not TOML: 'utf-8' codec can't decode"),
}


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [("own.csv", *case) for case in BAD_CSV.values()] + [("own.toml", *case) for case in BAD_TOML.values()],
    ids=[f"csv {case}" for case in BAD_CSV] + [f"toml {case}" for case in BAD_TOML],
)
def test_a_bad_file_is_refused_in_one_line_that_names_the_place(tmp_path, name, content, message):
    path = written(tmp_path, content, name)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert str(caught.value).replace(str(path), "OWN").startswith(message)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400 + 2 * len(str(tmp_path))


def test_a_missing_file_is_reported_as_missing(tmp_path):
    with pytest.raises(MissingFileError, match=r"none\.toml: there is no such file"):
        load_model(tmp_path / "none.toml")


def test_a_folder_is_no_sensor_file(tmp_path):
    folder = tmp_path / "sensor.toml"
    folder.mkdir()
    with pytest.raises(InputError, match="is a folder; allowed: a TOML file"):
        load_model(folder)


def test_another_kind_of_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"sensor\.yaml: a sensor file ends in \.toml or \.csv"):
        load_model(written(tmp_path, "x", "sensor.yaml"))


def test_an_impossible_path_is_refused():
    with pytest.raises(BlenderLidarError):
        load_model("x" * 5000 + ".toml")
