"""The LiDAR models that come with the package, and sensor files of a user's own."""

from __future__ import annotations

import csv
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import DATA_FOLDER, load_model, model_names, with_columns
from tests.waiting import WAIT_S

pytestmark = pytest.mark.versions

BEAM_TABLES = Path(__file__).parents[2] / "shared" / "reference" / "beams"
VELODYNE_TURNS_THE_OTHER_WAY = -1.0
# Model: table of beams, whether its firing times are known (None: not from there), sign of its azimuth offsets.
TABLE_OF = {
    "RS-16": ("rs16", True, 1.0),
    "RS-32": ("rs_helios_1615", True, 1.0),
    "RS-LiDAR-32": ("rs32", True, 1.0),
    "RS-80": ("rs_ruby_lite80", True, 1.0),
    "RS-Ruby-80V": ("rs_ruby80v", True, 1.0),
    "RS-Ruby-Lite-V2R": ("rs_ruby_lite80_v2r", True, 1.0),
    "RS-Ruby-128": ("rs_ruby128", True, 1.0),
    "RS-Helios-5515": ("rs_helios_5515", True, 1.0),
    "RS-BPearl": ("rs_bpearl", True, 1.0),
    "VLP-16": ("velodyne_vlp16", True, VELODYNE_TURNS_THE_OTHER_WAY),
    "HDL-64E-S2": ("velodyne_hdl64e_s2", False, VELODYNE_TURNS_THE_OTHER_WAY),
    "HDL-64E-S3": ("velodyne_hdl64e_s3", False, VELODYNE_TURNS_THE_OTHER_WAY),
    "HDL-32E": ("velodyne_hdl32e", None, VELODYNE_TURNS_THE_OTHER_WAY),
    "VLP-32C": ("velodyne_vlp32c", None, VELODYNE_TURNS_THE_OTHER_WAY),
    "VLS-128": ("velodyne_vls128", None, VELODYNE_TURNS_THE_OTHER_WAY),
    "QT64": ("hesai_qt64", None, 1.0),
    "OS0-128": ("ouster_os0_128_unit", None, 1.0),
    "OS1-128": ("ouster_os1_128_unit", None, 1.0),
    "OS1-32": ("ouster_os1_32_unit", None, 1.0),
}
# Nominal model: one of its calibrated units, and how far that lies from it in elevation and azimuth offset [degrees].
UNIT_OF = {
    "XT32": ("hesai_xt32", 0.09, 0.13),
    "Pandar40P": ("hesai_pandar40p", 0.21, 0.0),
    "Pandar64": ("hesai_pandar64", 0.02, 0.0),
    "Pandar128": ("hesai_pandar128e4x", 0.17, 0.22),
    "OS0-32": ("ouster_os0_32_unit", 0.45, 0.0),
    "OS1-64": ("ouster_os1_64_unit", 0.16, 0.0),
    "OS2-128": ("ouster_os2_128_unit", 0.06, 0.0),
    "OS2-32": ("ouster_os2_32_unit", 0.1, 0.0),
}
OUSTERS = [name for name in (*TABLE_OF, *UNIT_OF) if name.startswith("OS")]
THREE_BEAMS = "beams = [[0, -2.0, 1.5, 0.0], [1, -1.0, 0.0, 2.5], [2, 0.0, -1.5, nan]]\n"


def written(folder: Path, text: str | bytes, name: str = "own.toml") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def elevation_deg(name: str) -> np.ndarray:
    return np.degrees(load_model(name).elevation_rad)


def test_the_models_of_the_paper_and_the_reference_sensors_are_there():
    assert sorted(model_names()) == sorted((*TABLE_OF, *UNIT_OF))


@pytest.mark.parametrize("name", model_names())
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
    assert not np.any(model.fire_time_s > model.block_time_us * 1e-6)
    assert 0.0 < model.range_min_m < model.range_max_m
    assert 0.0 < model.range_noise_m < 0.05
    assert model.range_at_10_percent_m is None or 20.0 < model.range_at_10_percent_m <= model.range_max_m


@pytest.mark.parametrize("name", TABLE_OF)
def test_every_beam_equals_the_reference_table(name):
    if not BEAM_TABLES.is_dir():
        pytest.skip(f"no reference beam tables at {BEAM_TABLES}")
    table, timed, sign = TABLE_OF[name]
    beams = reference(table)
    model = load_model(name)
    assert sorted(beams) == list(range(model.rings))
    for ring, row in beams.items():
        assert math.degrees(model.elevation_rad[ring]) == pytest.approx(float(row["elevation_deg"]), abs=1e-9)
        expected = sign * float(row["azimuth_offset_deg"])
        assert math.degrees(model.azimuth_offset_rad[ring]) == pytest.approx(expected, abs=1e-9)
    if timed is None:
        return
    if not timed:
        assert np.all(np.isnan(model.fire_time_s))
        return
    with (BEAM_TABLES / f"{table}_timing.csv").open() as file:
        times = {int(row["ring"]): float(row["fire_offset_us"]) for row in csv.DictReader(file)}
    assert sorted(times) == list(range(model.rings))
    for ring, time_us in times.items():
        assert model.fire_time_s[ring] * 1e6 == pytest.approx(time_us, abs=1e-9)


def reference(table: str) -> dict[int, dict[str, str]]:
    with (BEAM_TABLES / f"{table}.csv").open() as file:
        return {int(row["ring"]): row for row in csv.DictReader(file)}


@pytest.mark.parametrize("name", UNIT_OF)
def test_a_nominal_ladder_lies_as_near_its_calibrated_unit_as_its_source_says(name):
    if not BEAM_TABLES.is_dir():
        pytest.skip(f"no reference beam tables at {BEAM_TABLES}")
    table, *most = UNIT_OF[name]
    beams, model = reference(table), load_model(name)
    assert sorted(beams) == list(range(model.rings))
    unit = [[float(beams[ring][key]) for ring in sorted(beams)] for key in ("elevation_deg", "azimuth_offset_deg")]
    away = np.abs(np.degrees([model.elevation_rad, model.azimuth_offset_rad]) - unit).max(axis=1)
    assert (away <= np.add(most, 1e-9)).all()
    assert (away >= np.array(most) - 0.011).all()  # the bound is no wider than it needs to be


@pytest.mark.parametrize(
    ("name", "rings", "lowest", "highest"),
    [
        ("XT32", 32, -16.0, 15.0),
        ("Pandar40P", 40, -25.0, 15.0),
        ("Pandar64", 64, -25.0, 15.0),
        ("Pandar128", 128, -25.0, 15.0),
        ("QT64", 64, -52.1, 52.1),
        ("OS0-32", 32, -45.4, 43.9),
        ("OS0-128", 128, -46.3, 45.8),
        ("OS1-32", 32, -15.3, 12.75),
        ("OS1-64", 64, -16.7, 16.5),
        ("OS1-128", 128, -21.8, 21.0),
        ("OS2-32", 32, -10.5, 10.9),
        ("OS2-128", 128, -11.1, 10.8),
        ("HDL-32E", 32, -30.67, 10.67),
        ("VLP-32C", 32, -25.0, 15.0),
        ("VLS-128", 128, -25.0, 15.0),
    ],
)
def test_field_of_view_and_rings_are_those_of_the_datasheet(name, rings, lowest, highest):
    elevation = elevation_deg(name)
    assert (np.diff(elevation) > 0.0).all()
    assert len(elevation) == rings
    np.testing.assert_allclose(elevation[[0, -1]], [lowest, highest], atol=0.25)


@pytest.mark.parametrize(
    ("name", "step_deg"),
    [("XT32", 1.0), ("HDL-32E", 4 / 3), ("OS0-32", 2.88), ("OS1-64", 0.527), ("OS2-128", 0.172), ("OS2-32", 0.689)],
)
def test_even_ladders_are_even(name, step_deg):
    np.testing.assert_allclose(np.diff(elevation_deg(name)), step_deg, atol=0.011)


def test_the_ouster_os1_32_is_the_gradient_model_and_no_ladder():
    elevation = elevation_deg("OS1-32")
    assert np.abs(elevation - np.linspace(elevation[0], elevation[-1], 32)).max() > 5.0


@pytest.mark.parametrize(
    ("name", "together", "first"),
    [("HDL-32E", 1, -30.67), ("VLP-32C", 2, -25.0), ("VLS-128", 8, -11.742), ("XT32", 1, 15.0), ("QT64", 1, -52.121)],
)
def test_as_many_lasers_fire_together_as_the_maker_says_and_the_first_is_his(name, together, first):
    model = load_model(name)
    times, counts = np.unique(model.fire_time_s, return_counts=True)
    assert times[0] == 0.0
    assert (counts == together).all()
    assert np.degrees(model.elevation_rad[model.fire_time_s == 0.0]).round(3).min() == pytest.approx(first)


@pytest.mark.parametrize("name", OUSTERS)
def test_all_beams_of_an_ousters_column_fire_together(name):
    np.testing.assert_array_equal(load_model(name).fire_time_s, 0.0)


@pytest.mark.parametrize("name", OUSTERS)
def test_an_ouster_has_1024_columns_or_as_many_as_it_is_set_to(name):
    model = load_model(name)
    assert [model.columns(rate) for rate in (10, 20)] == [1024, 1024]
    for columns, rates in {512: (10, 20), 1024: (10, 20), 2048: (10,)}.items():
        chosen = with_columns(model, columns)
        assert (chosen.columns(), chosen.rotation_hz) == (columns, rates)
        lattice = beam_lattice(chosen)
        assert (lattice.columns, lattice.step_rad) == (columns, pytest.approx(math.tau / columns))
    assert with_columns(model, None) is model


def test_a_rate_at_which_so_many_columns_do_not_fit_is_refused():
    with pytest.raises(InputError, match="OS1-128 does not turn at 20 Hz with 2048 columns; allowed: 10"):
        with_columns(load_model("OS1-128"), 2048).columns(20)


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


def test_every_beam_of_the_ruby_lites_is_one_of_the_ruby_128_and_the_v2r_has_its_lowest():
    of_128 = [(round(e, 4), round(a, 4)) for e, a in _angles("RS-Ruby-128")]
    assert {(round(e, 4), round(a, 4)) for e, a in _angles("RS-80")} <= {*of_128}
    assert [(round(e, 4), round(a, 4)) for e, a in _angles("RS-Ruby-Lite-V2R")] == of_128[:80]


def _angles(name: str) -> np.ndarray:
    model = load_model(name)
    return np.degrees(np.stack([model.elevation_rad, model.azimuth_offset_rad], axis=1))


def test_velodyne_offsets_are_turned_into_clockwise_ones():
    # rot_correction of the S2's lowest laser is -2.053 degrees; its clockwise azimuth is encoder - rot_correction.
    assert math.degrees(load_model("HDL-64E-S2").azimuth_offset_rad[0]) == pytest.approx(+2.053)
    # The VLP-32C's manual gives its laser 0, at -25 degrees, an azimuth offset of +1.4, clockwise.
    assert math.degrees(load_model("VLP-32C").azimuth_offset_rad[0]) == pytest.approx(+1.4)
    assert math.degrees(load_model("VLS-128").azimuth_offset_rad[0]) == pytest.approx(-0.911)


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        *[("RS-16", 1802), ("RS-32", 1800), ("RS-80", 1800), ("RS-LiDAR-32", 1801), ("VLP-16", 1808)],
        *[("HDL-64E-S2", 2083), ("HDL-32E", 2170), ("VLP-32C", 1808), ("VLS-128", 1876), ("XT32", 2000)],
        *[("Pandar40P", 1800), ("Pandar64", 1800), ("Pandar128", 1800), ("QT64", 600)],
    ],
)
def test_columns_per_turn_are_the_turn_over_the_block_time(name, columns):
    assert load_model(name).columns() == columns


def test_a_slower_turn_has_more_columns():
    model = load_model("RS-16")
    assert [model.columns(rate) for rate in (5, 10, 20)] == [3604, 1802, 901]


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
        ("Ouster OS1-128", "OS1-128"),
        ("Velodyne Ultra Puck", "VLP-32C"),
        ("OT128", "Pandar128"),
        ("Hesai PandarXT-32", "XT32"),
    ],
)
def test_names_and_aliases_are_found_however_they_are_spelt(given, name):
    assert load_model(given).name == name


@pytest.mark.parametrize(
    ("given", "near"),
    [
        ("OS1-16", ["OS1-32", "OS1-64", "OS1-128"]),
        ("OS3-128", ["OS0-128", "OS1-128", "OS2-128"]),
        ("Pandar90", ["Pandar40P", "Pandar64", "Pandar128"]),
        ("RS-17", ["RS-16"]),
        ("VLP-32", ["VLP-32C"]),
        ("HDL-32", ["HDL-32E"]),
    ],
)
def test_an_unknown_name_is_answered_with_the_nearest_of_its_own_family(given, near):
    with pytest.raises(InputError, match=r"unknown sensor .*; did you mean '(.*)'\? allowed: ") as refused:
        load_model(given)
    assert str(refused.value).split("did you mean '")[1].partition("'")[0] in near


@pytest.mark.parametrize("given", ["Livox", "Livox Mid-360", "Blickfeld-128", "M1-128", "AT128", "Velodyne", "16"])
def test_a_name_of_no_known_family_is_answered_with_the_list_alone(given):
    with pytest.raises(InputError, match="unknown sensor") as refused:
        load_model(given)
    assert "did you mean" not in str(refused.value)
    assert all(name in str(refused.value) for name in model_names())


def test_a_model_cannot_be_changed():
    model = load_model("RS-16")
    with pytest.raises(ValueError, match="read-only"):
        model.elevation_rad[0] = 0.0
    with pytest.raises(AttributeError):
        model.name = "other"


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
    assert model.block_time_us == 55.55
    assert (model.range_min_m, model.range_max_m, model.range_noise_m) == (0.4, 200.0, 0.02)
    assert model.range_at_10_percent_m is None
    assert (model.description, model.source, model.aliases) == ("", "", ())
    empty = 'name = ""\naliases = []\nrotation_hz = []\nsource = ""\n'  # counts as left out
    assert load_model(written(tmp_path, empty + THREE_BEAMS)).rotation_hz == (10.0,)
    np.testing.assert_allclose(np.degrees(model.elevation_rad), [-2.0, -1.0, 0.0])
    np.testing.assert_allclose(np.degrees(model.azimuth_offset_rad), [1.5, 0.0, -1.5])
    np.testing.assert_allclose(model.fire_time_s, [0.0, 2.5e-6, np.nan])


def test_every_assumption_that_is_made_for_a_file_is_known(tmp_path):
    csv_file = load_model(written(tmp_path, "ring,elevation_deg\n0,-2\n1,1\n", "own.csv"))
    assert csv_file.assumptions == {
        "rotation_hz": "10 turns a second",
        "block_time_us": "a column every 55.55 us, 1800 a turn at 10 Hz",
        "range_min_m": "it sees from 0.4 m",
        "range_max_m": "it sees to 200 m",
        "range_noise_m": "range noise 0.02 m where asked for",
        "azimuth_offset_deg": "every beam looks along its column",
        "fire_offset_us": "all beams of a column fire at once",
    }
    some = load_model(written(tmp_path, "range_max_m = 90\nrange_noise_m = 0.01\nrotation_hz = [10]\n" + THREE_BEAMS))
    assert list(some.assumptions) == ["block_time_us", "range_min_m"]
    assert all(not load_model(name).assumptions for name in model_names())


def test_a_file_may_offer_a_choice_of_columns(tmp_path):
    text = "rotation_hz = [5, 10]\nblock_time_us = 100\ncolumns_a_turn = [2000, 900]\n" + THREE_BEAMS
    model = load_model(written(tmp_path, text))
    assert (model.columns(), model.rotation_hz) == (2000, (5.0,))  # 2000 columns of 100 us take a fifth of a second
    model = load_model(written(tmp_path, "default_columns = 900\n" + text))
    assert (model.columns(), model.rotation_hz, model.default_rotation_hz) == (900, (5.0, 10.0), 10.0)
    assert with_columns(model, 2000).default_rotation_hz == 5.0


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


def fan(factor, middle=0.0):
    """A table of 16 rings from -15 to 15 degrees, in another unit or from another zero."""
    rows = (f"{ring},{round(middle + factor * (2.0 * ring - 15.0), 6)}" for ring in range(16))
    return "\n".join(["ring,elevation_deg", *rows])


LAYOUTS = {  # of one fan, whose azimuth offsets are 0.5 and -0.5 degrees in turn
    "a header of its own": ("Laser id,Elevation,Azimuth", "{number},{elevation},{offset}"),
    "semicolons and decimal commas": ("ring;elevation_deg;azimuth_offset_deg", "{ring};{elevation};{offset}"),
    "tabs": ("channel\tvertical [deg]\thorizontal [deg]", "{number}\t{elevation}\t{offset}"),
    "no header": ("", "{elevation},{offset}"),
    "no header, with rings": ("", "{ring},{elevation},{offset}"),
    "blanks": ("", "{elevation} {offset}"),
    "a comment and an index": ("# mine\n,ring,elevation_deg,azimuth_offset_deg", "{ring},{ring},{elevation},{offset}"),
    "EEFF": ("EEFF,1,1\nLaser id,Elevation,Azimuth", "{number},{elevation},{offset}"),
    "radians said": ("ring,elevation_rad,azimuth_offset_deg", "{ring},{radians},{offset}"),
    "zenith angles said": ("ring,zenith_deg,azimuth_offset_deg", "{ring},{zenith},{offset}"),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize("downwards", [False, True])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_fan_is_read_in_whatever_layout_and_order(tmp_path, layout, downwards, encoding):
    header, row = LAYOUTS[layout]
    rows, count = [], 16
    for ring in range(count):
        elevation = 2.0 * (count - 1 - ring if downwards else ring) - 15.0
        words = {
            "ring": ring,
            "number": ring + 1,
            "elevation": elevation,
            "offset": 0.5 if elevation % 4.0 == 1.0 else -0.5,
        }
        text = row.format(**words, radians=math.radians(elevation), zenith=90.0 - elevation)
        rows.append(text.replace(".", ",") if ";" in row else text)
    path = tmp_path / "own.csv"
    path.write_bytes("\n".join([*([header] if header else []), *rows]).encode(encoding))
    model = load_model(path)
    np.testing.assert_allclose(np.degrees(model.elevation_rad), np.arange(-15.0, 16.0, 2.0), atol=1e-9)
    np.testing.assert_allclose(np.degrees(model.azimuth_offset_rad), [0.5, -0.5] * 8)
    renumbered = ("{ring}" in row and downwards) or "{number}" in row
    assert ("rings are numbered again, from the lowest beam up" in model.notes) == renumbered


def test_an_ousters_metadata_is_read_in_both_layouts(tmp_path):
    angles = {"beam_altitude_angles": [10.0, 5.0, 0.0, -5.0], "beam_azimuth_angles": [3.1, 1.0, -1.1, -3.2]}
    old = {**angles, "lidar_mode": "512x20", "prod_line": "OS-1-4"}
    new = {"beam_intrinsics": angles, "config_params": {"lidar_mode": "512x20"}, "sensor_info": {"prod_line": "OS-1-4"}}
    for number, table in enumerate((old, new)):
        model = load_model(written(tmp_path, json.dumps(table), f"{number}.json"))
        assert (model.name, model.columns(), model.rotation_hz) == ("OS-1-4", 512, (20.0,))
        np.testing.assert_allclose(np.degrees(model.elevation_rad), [-5.0, 0.0, 5.0, 10.0])
        np.testing.assert_allclose(np.degrees(model.azimuth_offset_rad), [-3.2, -1.1, 1.0, 3.1])
    for text in ("[]", "{}", '{"beam_altitude_angles": [1], "beam_azimuth_angles": []}', "x"):
        with pytest.raises(InputError, match="is no metadata of an Ouster"):
            load_model(written(tmp_path, text, "bad.json"))


def test_a_velodynes_calibration_is_in_radians_and_its_azimuths_are_turned(tmp_path):
    pytest.importorskip("yaml")
    lasers = [(-0.2617993877991494, 0.0349), (0.2617993877991494, -0.0349), (0.0, 0.0)]
    rows = (
        f"- {{laser_id: {at}, vert_correction: {up}, rot_correction: {turn}}}" for at, (up, turn) in enumerate(lasers)
    )
    model = load_model(written(tmp_path, "\n".join(["lasers:", *rows, "num_lasers: 3"]), "mine.yaml"))
    np.testing.assert_allclose(np.degrees(model.elevation_rad), [-15.0, 0.0, 15.0])
    np.testing.assert_allclose(model.azimuth_offset_rad, [-0.0349, 0.0, 0.0349])
    with pytest.raises(InputError, match="is no calibration of a Velodyne"):
        load_model(written(tmp_path, "lasers: [{a: 1}]", "bad.yaml"))


def test_what_may_be_meant_otherwise_is_noted(tmp_path):
    up = "\n".join(["elevation_deg", *(str(one) for one in range(-4, 12))])
    assert load_model(written(tmp_path, up, "own.csv")).notes == ("11 of 16 beams look up: are the signs turned?",)
    rows = (f"{ring},{ring - 3},{0.0244 * (-1) ** ring}" for ring in range(8))
    text = "\n".join(["ring,elevation_deg,azimuth_offset_deg", *rows])
    (note,) = load_model(written(tmp_path, text, "own.csv")).notes
    assert note == "azimuth offsets of at most 0.0244 degrees: in radians they would be 1.4"


# What is wrong, the file, and the beginning of the line that says so; OWN is the file.
BAD_CSV = {
    "no elevation": ("ring\n0\n", "OWN:2: has no elevations"),
    "fire times alone": ("Laser id,fire time(us)\n1,0\n2,1.5\n", "OWN:2: has no elevations"),
    "wide without a header": ("1.5,2,3\n1,0,0\n", "OWN:1: 3 columns without a header"),
    "misspelt column": (
        "ring,elevatoin_deg\n0,1\n",
        "OWN:1: unknown column 'elevatoin_deg'; did you mean 'elevation_deg'",
    ),
    "a scan pattern": ("Time/s,Azimuth/deg,Zenith/deg\n0,1,90\n", "OWN:1: is a scan pattern over time"),
    "radians": (
        fan(math.radians(1.0)),
        "OWN: elevations from -0.261799 to 0.261799 are no degrees of a sensor; in radians",
    ),
    "milliradians": (
        fan(math.radians(1000.0)),
        "OWN: elevations from -261.799 to 261.799 are no degrees of a sensor; in m",
    ),
    "millidegrees": (
        fan(1000.0),
        "OWN: elevations from -15000 to 15000 are no degrees of a sensor; in millidegrees they ",
    ),
    "hundredths": (
        fan(100.0),
        "OWN: elevations from -1500 to 1500 are no degrees of a sensor; in hundredths of a degree",
    ),
    "zenith angles": (fan(1.0, 90.0), "OWN: elevations from 75 to 105 degrees are counted from the zenith"),
    "column twice": ("ring,elevation_deg,ring\n0,1,0\n", "OWN:1: column 'ring' is given twice"),
    "text in a number": ("ring,elevation_deg\n0,-1\n1,low\n", "OWN:3 elevation_deg: is 'low'; allowed: a number"),
    "empty cell": ("ring,elevation_deg\n0,\n", "OWN:2 elevation_deg: is ''; allowed: a number"),
    "no rows": ("ring,elevation_deg\n", "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "NaN elevation": ("ring,elevation_deg\n0,nan\n", "OWN:2 elevation_deg: is 'nan'; allowed: a number"),
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
        "OWN:3: ring is 0; 2 rings are numbered 0 to 1, each once",
    ),
    "ring missing": ("ring,elevation_deg\n0,1\n2,2\n", "OWN:3: ring is 2; 2 rings are numbered 0 to 1"),
    "empty": ("", "OWN: no rows; a table is needed"),
}
BAD_TOML = {
    "no beams": ('name = "x"', "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "unknown key": ("beam" + THREE_BEAMS[5:], "OWN:beam: unknown key 'beam'; did you mean 'beams'"),
    "beams no list": ("beams = 3", "OWN:beams: is 3; allowed: a list"),
    "a beam no list": ("beams = [1, 2]", "OWN:beams: 1, where [ring"),
    "a beam too short": ("beams = [[0]]", "OWN:beams[0] elevation_deg: is missing"),
    "a field of view turned round": (
        "azimuth_deg = [60, -60]\n" + THREE_BEAMS,
        "OWN:azimuth_deg: is [60.0, -60.0]; allowed: [from, to] clockwise",
    ),
    "standing still": ("rotation_hz = [0]\n" + THREE_BEAMS, "OWN:rotation_hz: is 0; allowed: 0.01 to "),
    "no block time": ("block_time_us = 0\n" + THREE_BEAMS, "OWN:block_time_us: is 0; allowed: 0.01 to "),
    "block longer than the turn": ("block_time_us = 1e6\n" + THREE_BEAMS, "OWN:block_time_us: 1e+06 us at 10 Hz"),
    "far too many beams": ("block_time_us = 0.01\n" + THREE_BEAMS, "OWN:block_time_us: 0.01 us at 10 Hz make"),
    "columns that do not fit": (
        "columns_a_turn = [1000, 1801]\n" + THREE_BEAMS,
        "OWN:columns_a_turn: 1801 columns a turn need less than block_time_us, 55.55, between two at any rate; allowed",
    ),
    "no such columns": (
        "columns_a_turn = [100, 200]\ndefault_columns = 300\n" + THREE_BEAMS,
        "OWN:default_columns: is 300; allowed: 100, 200",
    ),
    "columns without a choice": (
        "default_columns = 300\n" + THREE_BEAMS,
        "OWN:default_columns: is 300; allowed: none without columns_a_turn",
    ),
    "negative range": ("range_min_m = -1\n" + THREE_BEAMS, "OWN:range_min_m: is -1; allowed: 0 to 1"),
    "ranges upside down": (
        "range_min_m = 9\nrange_max_m = 8\n" + THREE_BEAMS,
        "OWN:range_max_m: is 8; allowed: more than range_min_m, 9",
    ),
    "NaN range": ("range_max_m = nan\n" + THREE_BEAMS, "OWN:range_max_m: is nan; allowed: a number"),
    "number for a name": ("name = 3\n" + THREE_BEAMS, "OWN:name: is 3; allowed: a text"),
    "no TOML": ("x = 1\nbeams = [[0 1]]\n", "OWN: is not TOML: Unclosed array (at line 2"),
    "empty": ("", "OWN:beams: 0 rings; allowed: 1 to 4096"),
    "not UTF-8": (b'name = "\xff"', "OWN: is text in another encoding; allowed: UTF-8"),
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
    with pytest.raises(InputError, match=r"sensor\.xml: a sensor file ends in \.toml, \.csv"):
        load_model(written(tmp_path, "x", "sensor.xml"))
