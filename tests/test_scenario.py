"""Scene files: what they mean, what options change, and that every refusal names the file, the table and the key."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest

from blender_lidar.errors import InputError
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scene.scenario import load_scenario, scenario_of
from blender_lidar.scene.settings import DECLARED
from blender_lidar.sensors.model import load_model
from blender_lidar.toml_table import to_toml
from tests.scene_texts import MINIMAL, own_sensor, refusal, scene
from tests.small_scene import write_scene

pytestmark = pytest.mark.versions

# --- what a scene means -----------------------------------------------------------------------------------------------


def test_a_scene_needs_no_more_than_its_traffic(tmp_path):
    scenario = load_scenario(scene(tmp_path, MINIMAL))
    assert scenario.recordings[0].path == str(tmp_path / "traffic.csv")
    assert scenario.lidar.sensor.name == "RS-16"
    assert scenario.lidar.sensor.range_gate_m == load_model("RS-16").range_max_m
    assert scenario.lidar.sensor.rotation_hz == load_model("RS-16").default_rotation_hz
    assert scenario.lidar.deployment.places[0].bounds == {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}
    assert scenario.lidar.baseline == Mounting(height_m=2.0)
    assert (scenario.search.particles, scenario.search.iterations, scenario.search.method) == (20, 100, "hardened")
    assert scenario.search.inertia is None
    assert (scenario.objective.metric, scenario.objective.reading) == ("pe-vgop", "corrected")
    assert scenario.recordings[0].frames >= 30


CIRCLE = "[region]\ncentre_m = [3.0, 4.0]\nradius_m = 40.0\n"


def test_a_number_fixes_a_coordinate_and_a_pair_has_it_searched(tmp_path):
    text = MINIMAL + "[deployment]\nx_m = [-4.0, 6.0]\ny_m = -1.5\nheight_m = 3\nyaw_deg = [-10, 10]\n" + CIRCLE
    deployment = load_scenario(scene(tmp_path, text)).lidar.deployment
    (place,), (space,) = deployment.places, deployment.spaces
    assert space.variables == ("x_m", "tilt_x_deg", "yaw_deg")
    assert space.lower == (-4.0, 0.0, -10.0)
    assert space.upper == (6.0, 25.0, 10.0)
    assert place.fixed == {"y_m": -1.5, "height_m": 3.0, "tilt_y_deg": 0.0}
    assert place.facing.at((9.0, -1.5), place.road) == 90.0
    assert deployment.nominal_xy == (1.0, -1.5)
    pose = space.layout([2.0, 18.0, 5.0])[0].pose
    assert (pose.x_m, pose.y_m, pose.height_m, pose.tilt_y) == (2.0, -1.5, 3.0, 0.0)
    assert pose.tilt_x == pytest.approx(math.radians(18.0))
    assert pose.yaw == pytest.approx(math.radians(5.0))


def test_the_baseline_stands_at_the_mounts_place_or_the_regions_middle_unless_said(tmp_path):
    deployment = "[deployment]\nx_m = 7.0\ny_m = -2.0\n"
    assert load_scenario(scene(tmp_path, MINIMAL + deployment)).lidar.baseline.xy[0] == 7.0
    deployment = CIRCLE + "[deployment]\nx_m = [10.0, 20.0]\ny_m = -2.0\n"
    assert load_scenario(scene(tmp_path, MINIMAL + deployment)).lidar.baseline.xy[0] == 3.0
    said = load_scenario(scene(tmp_path, MINIMAL + deployment + "[baseline]\nx_m = 0.0\nheight_m = 5\n")).lidar.baseline
    assert (*said.xy, said.height_m) == (0.0, -2.0, 5.0)


# --- paths ------------------------------------------------------------------------------------------------------------


def test_paths_in_the_file_start_from_its_folder_and_those_of_options_from_the_working_folder(tmp_path, monkeypatch):
    folder = tmp_path / "scenes"
    folder.mkdir()
    path = scene(folder, MINIMAL)
    monkeypatch.chdir(tmp_path)
    assert load_scenario("scenes/site.toml").recordings[0].path == str(Path("scenes/traffic.csv"))
    other = load_scenario(path, {("traffic", "path"): ("other.csv", "--traffic")})
    assert other.recordings[0].path == "other.csv"


def test_a_beam_table_is_looked_for_beside_the_scene_and_an_optional_one_in_the_working_folder(tmp_path, monkeypatch):
    own_sensor(tmp_path / "scenes" / "own.toml", 50.0)
    own_sensor(tmp_path / "own.toml", 70.0)
    path = scene(tmp_path / "scenes", MINIMAL + '[sensor]\nname = "own.toml"\n')
    monkeypatch.chdir(tmp_path)
    assert load_scenario(path).lidar.sensor.range_gate_m == 50.0
    assert load_scenario(path, {("sensor", "name"): ("own.toml", "--sensor")}).lidar.sensor.range_gate_m == 70.0
    assert load_scenario(path).lidar.sensor.is_file


# --- frames -----------------------------------------------------------------------------------------------------------


def test_frames_are_spread_evenly_or_listed(tmp_path):
    listed = load_scenario(scene(tmp_path, MINIMAL + "frame_ids = [3, 5]\n")).recordings[0]
    assert (listed.frames, listed.frame_ids) == (None, (3, 5))
    spread = load_scenario(scene(tmp_path, MINIMAL + "frames = 7\nspacing_s = 2.0\n")).recordings[0]
    assert (spread.frames, spread.frame_ids, spread.spacing_s) == (7, None, 2.0)


@pytest.mark.parametrize("key", ["frames", "spacing_s"])
def test_frames_both_listed_and_spread_evenly_are_refused(tmp_path, key):
    text = refusal(tmp_path, MINIMAL + f"frame_ids = [3]\n{key} = 2\n")
    assert text.startswith("[traffic] frame_ids: lists the frames that ")
    assert f"[traffic] {key}" in text


def test_an_option_puts_the_files_choice_of_frames_out_of_force(tmp_path):
    path = scene(tmp_path, MINIMAL + "frames = 7\nspacing_s = 2.0\n")
    listed = load_scenario(path, {("traffic", "frame_ids"): ([4], "--frame-ids")}).recordings[0]
    assert (listed.frames, listed.frame_ids, listed.spacing_s) == (None, (4,), None)
    path = scene(tmp_path, MINIMAL + "frame_ids = [3, 5]\n")
    spread = load_scenario(path, {("traffic", "frames"): (9, "--frames")}).recordings[0]
    assert (spread.frames, spread.frame_ids) == (9, None)


# --- refusals ---------------------------------------------------------------------------------------------------------

LIMITS = [  # a table, a key, and a value just beyond what its meaning allows
    ("traffic", "weight", "0"),
    ("traffic", "format", '"xml"'),
    ("traffic", "heading_deg", "361"),
    ("traffic", "accept", '["none"]'),
    ("traffic", "frame_ids", f"[{10**20}]"),
    ("traffic", "holdout", "0.95"),
    ("traffic.height_m", "car", "0"),
    ("road", "drives_on", '"up"'),
    ("road", "carriageways", "3"),
    ("road", "lanes", "0"),
    ("road", "crown_percent", "6.5"),
    ("world", "blend", '"site.obj"'),
    ("world", "mesh", '"site.blend"'),
    ("sensor", "range_noise_m", "11"),
    ("sensor", "dropout", "1"),
    ("sensor", "range_at_10_percent_m", "0"),
    ("deployment", "height_m", "0"),
    ("deployment", "tilt_x_deg", "[0, 91]"),
    ("deployment", "side", '"kerb"'),
    ("deployment", "lean_deg", "[-5, 10]"),
    ("baseline", "x_m", "[1, 2]"),
    ("region", "polygon_m", "[[0, 0], [1, 0], [1, 1e9]]"),
    ("objective", "threshold", "1.5"),
    ("objective", "view", '"top"'),
    ("deployment.installer", "tilt_deg", "11"),
    ("objective.class_weights", "car", "-1"),
    ("search", "particles", "2"),
    ("search", "social", "11"),
    ("model", "cluster", '"host:8786"'),
    ("model", "cluster", '"tcp://host:65536"'),
    ("model", "cluster", '"tcp://host:8786/"'),
]
EVERY_KEY = [(table, key, "2020-01-01") for table, settings in DECLARED.items() for key in settings]  # never a date


@pytest.mark.parametrize(("table", "key", "value"), [*LIMITS, *EVERY_KEY])
def test_a_wrong_value_is_refused_with_the_file_the_table_and_the_key(tmp_path, table, key, value):
    tables = {"traffic": 'path = "traffic.csv"\n'}
    tables["search"] = 'method = "de-pso"\n' if key != "method" else ""  # which alone has all of [search]'s keys
    tables["lidar"] = 'name = "north"\n' if table == "lidar" and key != "name" else ""
    tables[table] = f"{key} = {value}\n" if key == "path" else tables.get(table, "") + f"{key} = {value}\n"
    called = {name: f"[{name}]" for name in tables} | {"lidar": "[[lidar]]"}
    text = "".join(f"{called[name]}\n{content}" for name, content in tables.items() if content)
    named = "[[lidar]] 1" if table == "lidar" else f"[{table}]"
    message = refusal(tmp_path, text)
    assert message.startswith((f"{named} {key}: is ", f"{named} {key}: unknown ", f"[{table}.{key}]: is "))


UNREADABLE = {
    MINIMAL
    + "[deployment]\nhight_m = 3\n": "[deployment]: unknown key 'hight_m'; did you mean 'height_m'? allowed: x_m, ",
    MINIMAL + "[sensors]\n": "unknown table 'sensors'; did you mean 'sensor'? allowed: traffic, road, ",
    MINIMAL + "[plan]\n": "unknown table 'plan'; allowed: traffic, road, world, sensor, deployment, drawing, ",
    "seed = 1\n" + MINIMAL: "unknown table 'seed'; ",
    "road = 3\n" + MINIMAL: "[road]: is 3; allowed: a table",
    "[road]\nlanes = 3\n": "[traffic] path: is missing",
    MINIMAL + "[deployment]\nheight_m = [4.5, 2.0]\n": (
        "[deployment] height_m: is [4.5, 2.0]; allowed: the lower bound first, below the upper"
    ),
    MINIMAL + '[search]\nmethod = "grid"\nparticles = 3\niterations = 1\n': (
        "[search] particles: 3 x 1 iterations are too few evaluations for a grid over 2 coordinates; allowed: 4 or more"
    ),
    MINIMAL + "[model]\npose_error = 1\n": "[model.pose_error]: is 1; allowed: a table",
    MINIMAL + "[deployment]\ninstaller = {tilt_x_deg = 1}\n": (
        "[deployment.installer]: unknown key 'tilt_x_deg'; did you mean 'tilt_deg'? allowed: "
    ),
}


@pytest.mark.parametrize(("text", "message"), UNREADABLE.items(), ids=list(UNREADABLE.values()))
def test_what_no_scene_says_is_refused_with_its_place_and_the_nearest(tmp_path, text, message):
    assert refusal(tmp_path, text).startswith(message)


def test_an_option_is_named_in_place_of_the_file(tmp_path):
    overrides = {("search", "particles"): (1, "--particles")}
    assert refusal(tmp_path, MINIMAL, overrides) == "--particles: is 1; allowed: 3 to 10000"


DE_PSO_ALONE = ("inertia", "differential_weight", "cognitive", "social", "differential_threshold")


@pytest.mark.parametrize("key", DE_PSO_ALONE)
@pytest.mark.parametrize("method", ["", 'method = "hardened"\n', 'method = "random"\n', 'method = "grid"\n'])
def test_a_setting_of_de_pso_is_refused_with_another_search_instead_of_being_ignored(tmp_path, key, method):
    name = method.split('"')[1] if method else "hardened"
    assert refusal(tmp_path, MINIMAL + f"[search]\n{method}{key} = 0.5\n") == (
        f"[search] {key}: a setting of de-pso alone, but the method is {name}; "
        'allowed: method = "de-pso", or leave it out'
    )


def test_an_option_that_names_another_search_puts_de_pso_s_settings_in_the_file_out_of_force(tmp_path):
    path = scene(tmp_path, MINIMAL + '[search]\nmethod = "de-pso"\ninertia = 0.5\n')
    assert load_scenario(path, {("search", "method"): ("hardened", "--search")}).search.inertia is None
    assert load_scenario(path, {("search", "method"): ("de-pso", "--search")}).search.inertia == 0.5


def test_with_de_pso_what_is_left_out_is_the_papers(tmp_path):
    path = scene(tmp_path, MINIMAL + '[search]\nmethod = "de-pso"\nsocial = 0.5\n')
    search = load_scenario(path).search
    assert [getattr(search, key) for key in DE_PSO_ALONE] == [0.7, 0.5, 0.3, 0.5, 0.1]


# --- round trip -------------------------------------------------------------------------------------------------------

FULL = {
    "traffic": {
        "format": "table",
        "origin_m": [1.5, -2.0],
        "heading_deg": 30.0,
        "lanes": [1, 2],
        "frames": None,
        "frame_ids": [3, 9],
        "block_s": 7.0,
        "height_m": {"car": 1.4, "bus": 3.1},
    },
    "region": {"centre_m": [1.0, 2.0], "radius_m": 30.0, "keep_out": [[[0.0, 0.0], [4.0, 0.0], [0.0, 5.0]]]},
    "deployment": {"x_m": [-5.0, 5.0], "y_m": -0.5, "yaw_deg": [-1.0, 1.0]},
    "baseline": {"height_m": 3.0, "tilt_x_deg": 5.0},
    "sensor": {
        "range_noise_m": 0.03,
        "dropout": 0.25,
        "glass_dropout": 0.9,
        "range_at_10_percent_m": 80.0,
        "unit_spread_deg": 0.03,
        "unit": 0,
        "noise_seed": 2**53,
    },
    "objective": {"reading": "paper", "cell_m": 0.1, "view": "max", "loss": -2.0, "threshold": 0.01},
    "search": {"method": "de-pso", "inertia": 0.9, "seed": 2**53 - 1},
    "world": {"detail": "box"},
}


ROUND_TRIPS = {
    "small": {},
    "every kind of value": FULL,
    "an installer": {"deployment": {"installer": {"yaw_deg": 2.5, "aim": "low"}}},
    "a LiDAR and a baseline that hang": {"deployment": {"installer": False}, "baseline": {"installer": False}},
    "a pose error": {"model": {"pose_error": {"yaw_deg": 2.5}}},
    "weights": {
        "objective": {
            "class_weights": {"truck": 3.0},
            "zones": [{"name": "merge", "polygon_m": [[0.0, 2.0], [9.0, 2.0], [9.0, 6.0]], "weight": 0.0}],
        }
    },
    "a cluster": {"model": {"workers": None, "cluster": "tcp://host:8786"}},
    **{method: {"search": {"method": method, "particles": 7}} for method in ("hardened", "random", "de-pso")},
}


@pytest.mark.parametrize("changes", ROUND_TRIPS.values(), ids=ROUND_TRIPS)
def test_a_scenario_written_as_a_scene_file_is_read_as_the_same_scenario(tmp_path, changes):
    first = load_scenario(write_scene(tmp_path, changes))
    written = to_toml(first.as_tables())
    again = load_scenario(scene(tmp_path, written))
    assert again == dataclasses.replace(first, source=again.source)
    assert to_toml(again.as_tables()) == written
    assert ("inertia" in written) == (first.search.method == "de-pso")


@pytest.mark.parametrize("changes", ROUND_TRIPS.values(), ids=ROUND_TRIPS)
def test_settings_given_as_values_are_those_of_the_file(tmp_path, changes):
    of_file = load_scenario(write_scene(tmp_path, changes))
    assert scenario_of(of_file.as_tables(), source=of_file.source) == of_file


def field(table, key):
    """What a panel calls its fields."""
    return f"panel: {key or 'part'} of {table}"


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"sensor": {"rotation_hz": 7}}, "panel: rotation_hz of sensor: RS-16 does not turn at 7"),
        ({"sensor": {"range_gate_m": -1.0}}, "panel: range_gate_m of sensor: is -1.0; allowed: more than 0"),
        ({"sensor": {"RS-16": {"dropout": 2}}}, "panel: RS-16 of sensor dropout: is 2; allowed: "),
        ({"deployment": {"height_m": [3, 2]}}, "panel: height_m of deployment: is .3, 2.; allowed: the lower bound"),
        ({"deployment": {"installer": {"yaw_deg": 90}}}, "panel: installer of deployment yaw_deg: is 90; allowed: "),
        ({"objective": {"metric": "speed"}}, "panel: metric of objective: unknown objective .speed.; allowed: pe-vgop"),
        ({"search": {"particle": 3}}, "panel: part of search: unknown key 'particle'; did you mean 'particles'"),
        ({"traffic": {"path": None}}, "panel: path of traffic: is missing"),
        ({"traffics": {}}, "window: unknown table 'traffics'; did you mean 'traffic'"),
        ({"sensor": 3}, "panel: part of sensor: is 3; allowed: a table"),
    ],
)
def test_what_is_wrong_with_a_value_names_the_panels_field(given, message):
    given = {"traffic": {"path": "traffic.csv"}, **given}
    with pytest.raises(InputError, match=message):
        scenario_of(given, where=field, source="window")


def test_values_may_be_left_out_as_none(tmp_path):
    path = {"path": str(tmp_path / "traffic.csv")}
    some = {
        "deployment": {"height_m": None, "yaw_deg": None},
        "baseline": {"height_m": None},
        "search": {"seeds": None},
    }
    assert scenario_of({"traffic": path, **some}) == scenario_of({"traffic": {"spacing_s": None, **path}})


# --- a cluster --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("address", ["tcp://host:8786", "tls://10.0.0.1:1", "tcp://[fe80::1]:65535", "tcp://a-b.c:80"])
def test_the_address_of_a_scheduler_is_a_cluster(tmp_path, address):
    model = load_scenario(scene(tmp_path, MINIMAL + to_toml({"model": {"cluster": address}}))).model
    assert (model.cluster, model.workers) == (address, 0)


def test_a_cluster_and_processes_here_are_refused_together_and_an_option_puts_the_other_out_of_force(tmp_path):
    cluster, two = ("tcp://host:8786", "--cluster"), (2, "--workers")
    for workers in (two, (0, "--workers")):
        text = refusal(tmp_path, MINIMAL, {("model", "cluster"): cluster, ("model", "workers"): workers})
        assert text.startswith("--cluster: has its own workers, and --workers asks for ")
    text = refusal(tmp_path, MINIMAL + '[model]\nworkers = 2\ncluster = "tcp://host:8786"\n')
    assert text.startswith("[model] cluster: has its own workers, and ")
    path = scene(tmp_path, MINIMAL + "[model]\nworkers = 2\n")
    model = load_scenario(path, {("model", "cluster"): cluster}).model
    assert (model.workers, model.cluster) == (0, "tcp://host:8786")
    path = scene(tmp_path, MINIMAL + '[model]\ncluster = "tcp://host:8786"\n')
    model = load_scenario(path, {("model", "workers"): two}).model
    assert (model.workers, model.cluster) == (2, None)
