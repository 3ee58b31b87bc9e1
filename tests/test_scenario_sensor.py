"""The table [sensor] of a scene file: which sensor, how far it is asked to see, and how imperfect it is."""

from __future__ import annotations

import pytest

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import lattice_of
from blender_lidar.sensors.imperfections import Imperfections
from blender_lidar.sensors.model import load_model
from tests.scene_texts import MINIMAL, own_sensor, refusal, scene

GATES = MINIMAL + '[sensor]\nname = "{name}"\nrange_gate_m = 30\n[sensor.RS-16]\nrange_gate_m = 50\n'


def test_a_table_per_sensor_counts_for_that_sensor_alone_and_over_the_general_setting(tmp_path):
    assert load_scenario(scene(tmp_path, GATES.format(name="RS-16"))).lidar.sensor.range_gate_m == 50.0
    assert load_scenario(scene(tmp_path, GATES.format(name="RS-32"))).lidar.sensor.range_gate_m == 30.0


def test_a_sensor_and_its_table_may_go_by_an_alias(tmp_path):
    model = load_model("RS-32")
    alias = model.aliases[0]
    text = MINIMAL + f'[sensor]\nname = "rs_32"\n[sensor."{alias}"]\nrange_gate_m = 80\n'
    sensor = load_scenario(scene(tmp_path, text)).lidar.sensor
    assert (sensor.name, sensor.range_gate_m) == (model.name, 80.0)


def test_a_table_may_be_that_of_a_users_own_sensor(tmp_path):
    own_sensor(tmp_path / "own.toml", 70.0)
    text = MINIMAL + '[sensor]\nname = "own.toml"\n[sensor."own.toml"]\nrange_gate_m = 60\n'
    assert load_scenario(scene(tmp_path, text)).lidar.sensor.range_gate_m == 60.0


def test_an_option_chooses_another_sensor_and_its_table(tmp_path):
    chosen = {("sensor", "name"): ("RS-16", "--sensor")}
    assert load_scenario(scene(tmp_path, GATES.format(name="RS-32")), chosen).lidar.sensor.range_gate_m == 50.0


@pytest.mark.parametrize("gate", [0.1, 1000.0])
def test_a_range_gate_outside_the_sensors_range_is_refused_where_it_stands(tmp_path, gate):
    model = load_model("RS-16")
    allowed = f"allowed for RS-16: more than {model.range_min_m:g}, at most {model.range_max_m:g}"
    text = MINIMAL + f"[sensor]\nrange_gate_m = {gate}\n"
    assert refusal(tmp_path, text) == f"[sensor] range_gate_m: is {gate}; {allowed}"
    text = MINIMAL + f"[sensor.RS-16]\nrange_gate_m = {gate}\n"
    assert refusal(tmp_path, text) == f"[sensor.RS-16] range_gate_m: is {gate}; {allowed}"


def test_a_rotation_rate_that_the_sensor_lacks_is_refused_with_those_it_has(tmp_path):
    text = refusal(tmp_path, MINIMAL + "[sensor]\nrotation_hz = 7\n")
    assert text.startswith("[sensor] rotation_hz: RS-16 does not turn at 7")
    assert "allowed: 5, 10, 20" in text


def test_an_ousters_columns_are_those_of_the_scene_its_table_or_the_option(tmp_path):
    def columns(text, overrides=None):
        sensor = load_scenario(scene(tmp_path, MINIMAL + text), overrides).lidar.sensor
        lattice = lattice_of(sensor)
        assert lattice.columns == sensor.columns
        return lattice.columns

    ouster = '[sensor]\nname = "OS1-128"\n'
    assert columns(ouster) == 1024
    assert columns(ouster + "columns = 512\n") == 512
    assert columns(ouster + "columns = 512\n[sensor.OS1-128]\ncolumns = 2048\n") == 2048
    assert columns(ouster + "columns = 512\n", {("sensor", "columns"): (2048, "--columns")}) == 2048
    assert load_scenario(scene(tmp_path, MINIMAL)).lidar.sensor.columns is None  # an RS-16 has no choice


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            'name = "OS1-64"\ncolumns = 1000\n',
            "columns: OS1-64 cannot be set to 1000 columns a turn; allowed: 512",
        ),
        ("columns = 1024\n", "columns: RS-16 cannot be set to 1024 columns a turn; allowed: what rate and block time"),
        (
            'name = "OS1-64"\ncolumns = 2048\nrotation_hz = 20\n',
            "rotation_hz: OS1-64 does not turn at 20.0 Hz with 2048 columns; allowed: 10",
        ),
    ],
)
def test_columns_that_a_sensor_does_not_have_are_refused_where_they_stand(tmp_path, text, said):
    assert refusal(tmp_path, MINIMAL + "[sensor]\n" + text).startswith(f"[sensor] {said}")


def test_an_unknown_sensor_is_refused_with_the_nearest_wherever_it_is_named(tmp_path):
    assert refusal(tmp_path, MINIMAL + '[sensor]\nname = "RS-61"\n').startswith(
        "[sensor] name: unknown sensor 'RS-61'; did you mean "
    )
    assert refusal(tmp_path, MINIMAL + "[sensor.RS-61]\nrange_gate_m = 3\n").startswith(
        "[sensor] RS-61: unknown sensor 'RS-61'; did you mean "
    )
    chosen = {("sensor", "name"): ("RS-61", "--sensor")}
    path = scene(tmp_path, MINIMAL)
    with pytest.raises(InputError, match=r"^--sensor: unknown sensor 'RS-61'"):
        load_scenario(path, chosen)


def test_a_beam_table_that_is_not_there_is_refused_by_name_and_key(tmp_path):
    text = refusal(tmp_path, MINIMAL + '[sensor]\nname = "own.csv"\n', error=MissingFileError)
    assert text == f"[sensor] name: {tmp_path / 'own.csv'}: there is no such file"


IMPERFECT = """[sensor]
name = "{name}"
range_noise_m = 0.05
unit = 4
noise_seed = 9
[sensor.RS-16]
range_noise_m = "datasheet"
dropout = 0.1
glass_dropout = 1
range_at_10_percent_m = "datasheet"
unit_spread_deg = 0.03
"""


def test_imperfections_may_be_those_of_one_model(tmp_path):
    general = load_scenario(scene(tmp_path, MINIMAL + IMPERFECT.format(name="RS-32"))).lidar.sensor
    assert general.imperfections == Imperfections(0.05, 0.0, seed=9)
    assert (general.unit_spread_deg, general.unit) == (0.0, 4)
    own = load_scenario(scene(tmp_path, MINIMAL + IMPERFECT.format(name="RS-16"))).lidar.sensor
    sheet = load_model("RS-16")
    assert own.imperfections == Imperfections(
        sheet.range_noise_m, 0.1, glass_dropout=1.0, range_at_10_percent_m=sheet.range_at_10_percent_m, seed=9
    )
    assert (own.unit_spread_deg, own.unit) == (0.03, 4)


def test_an_option_replaces_the_imperfections_of_a_models_table_too(tmp_path):
    path = scene(tmp_path, MINIMAL + IMPERFECT.format(name="RS-16"))
    changed = load_scenario(path, {("sensor", "range_noise_m"): (0.5, "--range-noise")}).lidar.sensor
    assert (changed.range_noise_m, changed.dropout) == (0.5, 0.1)


def test_seeds_of_the_imperfections_hold_for_every_model(tmp_path):
    text = refusal(tmp_path, MINIMAL + "[sensor.RS-16]\nunit = 2\n")
    assert text.startswith("[sensor.RS-16]: unknown key 'unit'; ")


def test_a_data_sheet_with_more_noise_than_is_allowed_is_refused_where_it_is_asked_for(tmp_path):
    (tmp_path / "own.toml").write_text("range_noise_m = 20.0\nbeams = [[0, -10.0], [1, 0.0]]\n")
    text = refusal(tmp_path, MINIMAL + '[sensor]\nname = "own.toml"\nrange_noise_m = "datasheet"\n')
    assert text == "[sensor] range_noise_m: own: is 20.0; allowed: 0 to 10"


@pytest.mark.parametrize(("name", "found"), [("RS-32", 90.0), ("RS-LiDAR-32", None)])
def test_a_data_sheet_says_how_far_a_dark_target_is_seen_or_that_no_source_does(tmp_path, name, found):
    text = MINIMAL + f'[sensor]\nname = "{name}"\nrange_at_10_percent_m = "datasheet"\n'
    if found:
        assert load_scenario(scene(tmp_path, text)).lidar.sensor.range_at_10_percent_m == found
    else:
        message = f"[sensor] range_at_10_percent_m: no source gives that of {name}; allowed: a number"
        assert refusal(tmp_path, text) == message


def test_a_unit_with_a_beam_beyond_the_zenith_is_refused_when_the_scene_is_read(tmp_path):
    text = refusal(
        tmp_path, MINIMAL + '[sensor]\nname = "RS-BPearl"\nunit = 4\n[sensor.RS-BPearl]\nunit_spread_deg = 4\n'
    )
    assert text.startswith("[sensor.RS-BPearl] unit_spread_deg: unit 4 of RS-BPearl has ring 31 at 9")
    assert text.endswith("with a spread of 4; allowed: a spread that leaves every beam between -90 and 90")
