"""Commissioning: clouds name their sensor, their mounting is found, and what cannot be told is refused or said so."""

from __future__ import annotations

import json
import math
import tomllib
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blender_lidar.clouds.files import write_pcd
from blender_lidar.clouds.points import read_grid
from blender_lidar.clouds.scan import PointCloud
from blender_lidar.commands.commission import deployment, unit_table
from blender_lidar.detection.judge import sensor_at
from blender_lidar.errors import InputError
from blender_lidar.scene.mounting import changed_mounting, mounting_from
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.sensors.beams import beam_directions
from blender_lidar.sensors.identify import elevations, identify_sensor, nearest_ring
from blender_lidar.sensors.model import load_model, model_names, unit_of
from blender_lidar.sensors.pose import Pose
from blender_lidar.studies.commission import against_plan, commission, hung_mounting
from blender_lidar.studies.road_fit import Estimate
from blender_lidar.toml_table import read_toml
from tests.forms import USUAL, write_form
from tests.refusals import refused
from tests.small_scene import cli

pytest.importorskip("scipy", reason="SciPy is not installed")
CHENGDU = Path(__file__).parents[2] / "shared" / "data" / "chengdu"
UNIT = CHENGDU / "unit_table.csv"
V2R = "RS-Ruby-Lite-V2R"


def flu(points):
    """From x ahead, y left to x right, y ahead."""
    return np.stack([-points[..., 1], points[..., 0], points[..., 2]], axis=-1)


@cache
def chengdu() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The organised revolution of a roadside LiDAR, and its single frames, in the sensor's frame."""
    if not CHENGDU.is_dir():
        pytest.skip("the roadside clouds of ../shared/data are not here")
    grid = np.load(CHENGDU / "revolution.npz")["xyz_m"].astype(float)
    frames = np.load(CHENGDU / "frames_float16.npz")
    return flu(grid), {name: flu(frames[name].astype(float)) for name in frames.files}


def revolution() -> np.ndarray:
    grid = chengdu()[0]
    return grid[np.isfinite(grid).all(axis=-1)]


@cache
def scene(**settings):
    changes = {("traffic", "frames"): 4, ("traffic", "holdout"): 0.0}
    changes |= {tuple(key.split("__")): value for key, value in settings.items()}
    return prepare(load_scenario("i80", {key: (value, key[1]) for key, value in changes.items()}))


def hung(sensor: str, frame: int = 0, table=None, **settings):
    """A cloud of the shipped motorway in the sensor's frame, and the mounting."""
    site = scene(sensor__name=sensor, **settings)
    table = {"height_m": 4.2, "tilt_x_deg": 12.0, "tilt_y_deg": -1.5, "yaw_deg": 4.0, **(table or {})}
    mounting = mounting_from(table, site.scenario.road_map, site.scenario.baselines[0])
    return mounting.pose.to_sensor(sensor_at(site, mounting).scan(site.search[frame]).xyz), mounting


def fans(model, seed: int) -> np.ndarray:
    """Elevations of a revolution over a level road, with walls that fewer and fewer upper beams meet."""
    seen = np.where(model.elevation_rad < -0.06, 1.0, 0.05 + 0.4 * np.exp(-((model.elevation_rad / 0.15) ** 2)))
    counts = np.random.default_rng(seed).binomial(model.columns(), seen.clip(0.0, 1.0))
    return np.repeat(model.elevation_rad, counts)


# --- Which sensor -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spread", [0.0, 0.015, 0.03])
@pytest.mark.parametrize("name", model_names())
def test_a_cloud_names_its_table_and_all_twins_of_it(name, spread):
    found = identify_sensor(fans(unit_of(load_model(name), spread, 3), 1)).matches
    assert name in [one.model.name for one in found]
    # Even fans of the same angles, and two that differ by less than their units do.
    twins = {"RS-16", "VLP-16", "RS-32", "XT32", *(["RS-Ruby-80V", V2R] if spread else [])}
    if name not in twins:
        assert found[0].model.name == name


@pytest.mark.parametrize(
    ("unit", "name"), [("ouster_os1_64", "OS1-64"), ("ouster_os0_32", "OS0-32"), ("rs32", "RS-LiDAR-32")]
)
def test_calibrations_of_real_units_are_named_by_their_models(unit, name):
    """They differ from the makers' tables by up to 0.45 degrees."""
    path = CHENGDU.parents[1] / "reference" / "beams" / f"{unit}_unit{'_a' if unit == 'rs32' else ''}.csv"
    if not path.exists():
        pytest.skip("the beam tables of ../shared/reference are not here")
    assert identify_sensor(fans(load_model(path), 1)).matches[0].model.name == name


def test_of_thinned_points_no_table_is_ruled_out_that_may_be_it():
    names = [one.model.name for one in identify_sensor(elevations(revolution()[::48])).matches]
    assert names == [V2R, "RS-Ruby-128"]  # whose lower 80 beams it has


def test_a_real_sensor_is_named_by_every_one_of_its_clouds():
    for points in (revolution(), *chengdu()[1].values()):
        assert identify_sensor(elevations(points)).matches[0].model.name == V2R


def test_rings_are_the_nearest_by_an_independent_search():
    ladder = load_model("RS-80").elevation_rad
    seen = np.random.default_rng(2).uniform(-0.5, 0.4, 500)
    assert nearest_ring(seen, ladder).tolist() == [int(np.argmin(np.abs(ladder - one))) for one in seen]


# --- How it hangs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [{}, {"road__crown_percent": 2.0, "road__cross_fall_percent": 2.0}], ids=str)
@pytest.mark.parametrize("sensor", ["RS-16", "OS1-64", V2R])
def test_height_and_leans_are_found_against_the_road(sensor, settings):
    points, mounting = hung(sensor, **settings)
    fit, pose = commission([points], ["cloud"]).fit, mounting.pose
    for found, true, most in (
        (fit.height_m, pose.height_m, 0.03),
        (fit.tilt_x, pose.tilt_x, math.radians(0.15)),
        (fit.tilt_y, pose.tilt_y, math.radians(0.15)),
        (fit.yaw, pose.yaw, math.radians(1.0)),
    ):
        assert abs(found.value - true) < most
        assert found.interval_90[0] <= true <= found.interval_90[1]
    low, high = fit.carriageways[0].y_m[0], fit.carriageways[-1].y_m[1]
    assert 0.0 < low < 8.0
    assert 14.0 < high < 26.0


def test_leans_do_not_depend_on_how_the_sensor_is_turned():
    points, _ = hung("OS1-64")
    quarter = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    one, other = (commission([turned], ["cloud"]).fit for turned in (points, points @ quarter))
    assert other.height_m.value == pytest.approx(one.height_m.value, abs=0.002)
    up, turned_up = (fit.pose.rotation[:, 2] for fit in (one, other))
    assert np.degrees(np.arccos(min(1.0, turned_up @ (up @ quarter)))) < 0.02
    assert math.degrees(math.remainder(other.yaw.value - one.yaw.value, 0.5 * math.pi)) == pytest.approx(0.0, abs=0.8)


def test_an_error_of_all_ranges_hardly_moves_the_height():
    points, mounting = hung("OS1-64")
    away = np.linalg.norm(points, axis=1, keepdims=True)
    for error in (-0.03, 0.03):
        fit = commission([points * (1.0 + error / away)], ["cloud"]).fit
        assert abs(fit.height_m.value - mounting.pose.height_m) < 0.02
        assert np.sign(fit.range_error_m.value) == np.sign(error)


def test_errors_of_rings_that_a_driver_does_not_know_are_learnt_and_hold_on_the_other_half_of_the_road():
    """Drivers write points by their table, whatever the unit's beams are."""
    model, unit = load_model("RS-32"), unit_of(load_model("RS-32"), 0.03, 5)
    points, mounting = hung("RS-32", sensor__unit_spread_deg=0.03, sensor__unit=5, table={"tilt_x_deg": 5.0})
    away, azimuth = np.linalg.norm(points, axis=1), np.arctan2(points[:, 0], points[:, 1])
    told = model.elevation_rad[nearest_ring(elevations(points), unit.elevation_rad)]
    found = commission([away[:, None] * beam_directions(azimuth, told)], ["cloud"])
    true = np.degrees(unit.elevation_rad - model.elevation_rad)
    known = found.fit.ring_sd_rad < math.radians(0.015)
    learnt = np.degrees(found.unit_rad - model.elevation_rad)
    assert known.sum() >= 8
    assert np.corrcoef(learnt[known], true[known])[0, 1] > 0.8
    assert found.fit.ring_check.after_rad < 0.7 * found.fit.ring_check.before_rad
    assert abs(found.fit.height_m.value - mounting.pose.height_m) < 0.03


def test_real_frames_agree_on_height_and_leans_and_with_an_independent_fit():
    fits = [commission([points], [name]).fit for name, points in chengdu()[1].items()]
    height, tilt_x, tilt_y = (
        np.array([getattr(fit, key).value for fit in fits]) for key in ("height_m", "tilt_x", "tilt_y")
    )
    assert np.std(height, ddof=1) < 0.004
    assert np.degrees([np.std(tilt_x, ddof=1), np.std(tilt_y, ddof=1)]).max() < 0.015
    assert np.mean(height) == pytest.approx(3.49, abs=0.02)
    assert math.degrees(np.mean(tilt_y)) == pytest.approx(0.40, abs=0.05)


def test_errors_of_rings_do_not_make_ground_beside_the_road_a_part_of_it():
    name = "s348565000"
    points, model = chengdu()[1][name], load_model(V2R)
    seen = elevations(points, 0.036)
    ring = nearest_ring(seen, model.elevation_rad)
    for seed in (1, 2):
        off = np.random.default_rng(seed).normal(0.0, math.radians(0.02), model.rings)
        azimuth, away = np.arctan2(points[:, 0], points[:, 1]), np.linalg.norm(points, axis=1)
        fit = commission([away[:, None] * beam_directions(azimuth, seen + off[ring])], [name]).fit
        assert math.degrees(fit.tilt_y.value) == pytest.approx(0.40, abs=0.1)


def test_a_real_background_shows_lens_blind_sector_and_corrections_like_an_independent_ones():
    frames = chengdu()[1]
    found = commission([*frames.values()], [*frames])
    assert found.lens_m == pytest.approx(0.036, abs=0.004)
    ((first, last),) = found.blind_deg
    assert first == pytest.approx(149.0, abs=3.0)
    assert last == pytest.approx(209.0, abs=5.0)
    assert found.dead_rings == ()
    assert found.fit.ring_check.after_rad < 0.67 * found.fit.ring_check.before_rad
    assert [100.0 * abs(one.slope) for one in found.fit.carriageways] == pytest.approx([2.15, 2.15], abs=0.2)
    table = np.genfromtxt(UNIT, delimiter=",", names=True)
    known = np.isfinite(found.fit.ring_sd_rad) & np.isfinite(table["road_elevation_correction_deg"])
    learnt = np.degrees(found.unit_rad - found.model.elevation_rad)[known]
    assert np.corrcoef(learnt, table["road_elevation_correction_deg"][known])[0, 1] > 0.6


def test_a_dead_ring_and_a_blind_sector_are_seen():
    points, _ = hung("OS1-64", table={"tilt_x_deg": 2.0, "tilt_y_deg": 0.0})
    model = load_model("OS1-64")
    ring = nearest_ring(elevations(points), model.elevation_rad)
    azimuth = np.degrees(np.arctan2(points[:, 0], points[:, 1])) % 360.0
    assert commission([points], ["cloud"]).blind_deg == ()
    found = commission([points[(ring != 20) & ~((azimuth > 100.0) & (azimuth < 130.0))]], ["cloud"])
    assert found.dead_rings == (20,)
    assert found.blind_deg == ((100.0, 130.0),)


def test_a_crown_that_traffic_on_one_side_hides_widens_the_interval():
    """What is driven on is one plane, and the other side of the crown may be anywhere."""
    site = scene(sensor__name=V2R, road__crown_percent=2.0)
    table = {"height_m": 4.2, "tilt_x_deg": 12.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0}
    mounting = mounting_from(table, site.scenario.road_map, site.scenario.baselines[0])
    for count in (0, 6):
        vehicles = site.search[0]
        near = np.argsort(vehicles.centre_m[:, 1])[:count]
        points = mounting.pose.to_sensor(sensor_at(site, mounting).scan(vehicles.select(near)).xyz)
        fit = commission([points], ["cloud"]).fit
        low, high = fit.tilt_x.interval_90
        assert low <= mounting.pose.tilt_x <= high


def test_a_cloud_thrice_gives_what_it_gives_once():
    points, _ = hung("RS-32", sensor__unit_spread_deg=0.03, sensor__unit=5)
    once, thrice = commission([points], ["a"]), commission([points] * 3, list("abc"))
    assert thrice.fit.height_m.value == pytest.approx(once.fit.height_m.value, abs=0.004)
    assert thrice.fit.yaw.error >= 0.9 * once.fit.yaw.error
    unit = unit_of(load_model("RS-32"), 0.03, 5)
    seen = np.isin(np.arange(32), once.ring)
    for found in (once, thrice):
        assert np.degrees(np.abs(found.unit_rad - unit.elevation_rad))[seen].max() < 0.01
        assert found.fit.ring_check.before_rad < math.radians(0.003)


def test_points_at_the_origin_are_no_returns():
    points, _ = hung("OS1-64")
    found = commission([np.concatenate([points, np.zeros((len(points), 3)), [[np.nan] * 3]])], ["cloud"])
    assert found.left_out == len(points) + 1
    assert found.fit.height_m == commission([points], ["cloud"]).fit.height_m


def test_columns_of_a_full_cloud_hide_no_rings():
    model = load_model("Pandar64")
    assert identify_sensor(np.tile(model.elevation_rad, 1800)).matches[0].model.name == "Pandar64"


# --- What is refused --------------------------------------------------------------------------------------------------


def level(sensor="Pandar64", height_m=6.0):
    points, mounting = hung(sensor, table={"height_m": height_m, "tilt_x_deg": 0.0, "tilt_y_deg": 0.0, "yaw_deg": 0.0})
    return mounting.pose.to_world(points) + mounting.pose.position


REFUSED = {
    "ten points": (lambda: revolution()[:10], "10 points; allowed: 500 or more"),
    "millimetres": (lambda: 1000.0 * hung("RS-32")[0], r"metres \(are these millimetres\?\)"),
    "the road's frame": (
        level,
        r"road's frame: .* 6\.0 m up its points are on the rings of Pandar64 .--origin 0 0 6\.0",
    ),
    "upside down": (lambda: hung("RS-80")[0] * [1.0, 1.0, -1.0], "upside down: with z turned .* RS-80"),
    "voxels": (lambda: np.unique(np.floor(hung("RS-32")[0] / 0.2), axis=0) * 0.2 + 0.1, "on no rings"),
    "two sensors": (
        lambda: np.concatenate([hung("RS-80")[0], hung("RS-80", table={"height_m": 4.9})[0] + [6.0, 3.0, 0.4]]),
        "second sensor|on no rings",
    ),
    "no ground": (lambda: (lambda p: p[p[:, 2] > -1.5])(hung("OS1-64", table={"tilt_x_deg": 0.0})[0]), "road|plane"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_cloud_of_a_sensor_over_a_road_is_refused_by_what_it_is(what):
    make, text = REFUSED[what]
    with pytest.raises(InputError, match=f"^here: .*({text})"):
        commission([make()], ["here"])


@pytest.mark.parametrize(
    "other", [("RS-80", {}), ("RS-32", {"height_m": 4.7}), ("RS-32", {"tilt_x_deg": 9.0})], ids=str
)
def test_clouds_of_other_sensors_or_mountings_are_refused_together(other):
    sensor, table = other
    clouds = [hung("RS-32")[0], hung(sensor, 1, table=table)[0], hung("RS-32", 2)[0]]
    with pytest.raises(InputError, match=r"b: its points are not on the rings of RS-32|a to c: hang 4\."):
        commission(clouds, list("abc"))


def test_a_mirrored_axis_is_seen_in_organised_clouds():
    grid = chengdu()[0] * [-1.0, 1.0, 1.0]
    with pytest.raises(InputError, match="right-handed frame"):
        commission([grid[np.isfinite(grid).all(axis=-1)]], ["here"], grid=grid)
    commission([revolution()], ["here"], grid=chengdu()[0])


def test_clouds_of_a_moving_lidar_are_refused():
    """A wall of trees that passes by."""
    points, _ = hung("OS1-64", table={"tilt_x_deg": 0.0, "tilt_y_deg": 0.0})
    rng = np.random.default_rng(4)
    model, clouds = load_model("OS1-64"), []
    for _ in range(4):
        ring, column = rng.integers(40, 64, 6000), rng.integers(0, model.columns(), 6000)
        azimuth = (column + 0.5) * 2.0 * math.pi / model.columns()
        way = beam_directions(azimuth, model.elevation_rad[ring])
        clouds.append(np.concatenate([points, rng.uniform(8.0, 40.0, (6000, 1)) * way]))
    with pytest.raises(InputError, match="stands still from cloud to cloud"):
        commission(clouds, list("abcd"))


def test_on_a_road_that_lies_higher_a_lidar_hangs_as_high_above_it(tmp_path):
    site = prepare(load_scenario(write_form(tmp_path, USUAL | {"road": "heights"})))
    planned = site.scenario.lidar.mounting({"height_m": 4.0})
    points, mounting = hung("OS1-64")
    hangs = hung_mounting(site, planned, commission([points], ["cloud"]).fit)
    assert planned.pose.height_m > 5.5  # the road lies some 2 m above z = 0 here
    assert hangs.height_m == pytest.approx(mounting.height_m, abs=0.03)


# --- The verb ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def run_of_two(tmp_path_factory):
    """A run, and clouds of its LiDAR hung 12 cm lower and 3 degrees less tilted."""
    folder = tmp_path_factory.mktemp("commission")
    from blender_lidar.cli import main

    few = ["--frames", "6", "--particles", "6", "--iterations", "4", "--search", "de-pso"]
    assert main(["optimise", "i80", "--sensor", "RS-32", *few, "--out", str(folder / "run")]) == 0
    scenario = load_scenario(folder / "run" / "scene.toml")
    planned = scenario.lidar.mounting(json.loads((folder / "run" / "result.json").read_text())["deployment"])
    site = prepare(scenario, (planned,))
    hangs = changed_mounting(
        planned,
        scenario.road_map,
        height_m=planned.height_m - 0.12,
        tilt_x_deg=math.degrees(planned.tilt_x) - 3.0,
    )
    for number, frame in enumerate(site.search[:3]):
        points = hangs.pose.to_sensor(sensor_at(site, hangs).scan(frame).xyz)
        np.savez(folder / f"cloud_{number}.npz", xyz=points)
    return folder


def test_the_verb_tells_how_a_lidar_hangs_beside_its_plan_and_what_to_do(run_of_two, tmp_path, capsys):
    clouds = sorted(run_of_two.glob("cloud_*.npz"))
    out = tmp_path / "out"
    code, text, errors = cli(capsys, "commission", *clouds, "--run", run_of_two / "run", "--out", out)
    assert code == 0, errors
    result = json.loads((out / "commission.json").read_text())
    off = result["plan"]["differences"]
    assert off["height_m"]["value"] == pytest.approx(-0.12, abs=0.03)
    assert off["tilt_x_deg"]["value"] == pytest.approx(-3.0, abs=0.2)
    assert off["tilt_y_deg"]["interval_90"][0] < 0.0 < off["tilt_y_deg"]["interval_90"][1]
    sheet = (out / "correction.txt").read_text()
    for words in ("Raise the sensor by 1", "Lower the side of zero azimuth by 3.", "Inclinometer"):
        assert words in sheet
    share = result["plan"]["detectable_share"]
    assert share["gain"] == pytest.approx(share["measured"] - share["planned"])
    assert share["interval_90"][0] <= share["gain"] <= share["interval_90"][1]
    assert "Against the plan" in text
    assert result["as_possible"] == ["XT32"]
    assert cli(capsys, "commission", clouds[0], "--out", out)[0] == 0  # in the place of its own results
    assert not (out / "correction.txt").exists()


def test_forgotten_axes_are_asked_for_and_not_corrected(run_of_two, tmp_path, capsys):
    points = np.load(run_of_two / "cloud_0.npz")["xyz"]
    np.savez(tmp_path / "flu.npz", xyz=np.stack([points[:, 1], -points[:, 0], points[:, 2]], axis=1))
    words = "commission", tmp_path / "flu.npz", "--run", run_of_two / "run", "--out"
    assert cli(capsys, *words, tmp_path / "one")[0] == 0
    assert "is --axes right?" in (tmp_path / "one" / "correction.txt").read_text()
    assert cli(capsys, *words, tmp_path / "other", "--axes", "flu")[0] == 0
    assert "Raise the sensor by" in (tmp_path / "other" / "correction.txt").read_text()


@pytest.mark.parametrize("name", [name for name in model_names() if load_model(name).rings > 1])
def test_the_beam_table_of_a_unit_keeps_all_else_of_its_model(name, tmp_path):
    model = load_model(name)
    found = SimpleNamespace(model=model, unit_rad=model.elevation_rad)
    (tmp_path / "beams.toml").write_text(unit_table(found))
    read = load_model(tmp_path / "beams.toml")
    for key in ("rotation_hz", "default_rotation_hz", "block_time_us", "columns_a_turn", "range_min_m", "range_max_m"):
        assert getattr(read, key) == getattr(model, key)
    assert read.columns() == model.columns()
    np.testing.assert_allclose(read.elevation_rad, model.elevation_rad, atol=1e-5)
    np.testing.assert_allclose(read.azimuth_offset_rad, model.azimuth_offset_rad, atol=1e-5)


def test_what_it_writes_is_read_again(run_of_two, tmp_path, capsys):
    out = tmp_path / "out"
    assert cli(capsys, "commission", run_of_two / "cloud_0.npz", "--sensor", "RS-32", "--out", out)[0] == 0
    assert read_toml(out / "deployment.toml")["deployment"]["installer"] is False
    unit = load_model(out / "beams.toml")
    np.testing.assert_allclose(unit.elevation_rad, load_model("RS-32").elevation_rad, atol=math.radians(0.05))
    pose = json.loads((out / "commission.json").read_text())["pose"]
    scene_of = {
        (table, key): (value, key)
        for table, keys in _toml(out / "deployment.toml").items()
        for key, value in keys.items()
    }
    scenario = load_scenario("i80", scene_of)
    assert scenario.lidar.sensor.name == "RS-32"
    found = scenario.lidar.deployment.spaces[0].layout([])[0].as_table()
    for key in ("height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg"):
        assert found[key] == pytest.approx(pose[key], abs=1e-3)


def _toml(path):
    import tomllib

    return tomllib.loads(path.read_text())


def test_the_options_are_refused_by_name(run_of_two, tmp_path, capsys):
    cloud = run_of_two / "cloud_0.npz"
    for words, text in {
        ("--lidar", "north"): "--lidar: is given without --run",
        ("--run", run_of_two / "run", "--lidar", "north"): "--lidar: is 'north'; allowed: LiDAR",
        ("--axes", "xyz"): "--axes: is 'xyz'",
        ("--sensor", "RS-16"): "on the rings of RS-32, not on those of RS-16",
        ("--origin", "0", "0", "nan"): "--origin",
        ("--run", tmp_path): "there is no such file",
    }.items():
        assert text in refused(capsys, tmp_path, "commission", cloud, *words, "--out", tmp_path / "out", begun=True)


def test_organised_clouds_keep_their_columns(tmp_path):
    grid = np.random.default_rng(1).normal(size=(12, 5, 3))
    grid[3, 2] = np.nan
    np.savez(tmp_path / "grid.npz", xyz=grid)
    np.testing.assert_array_equal(read_grid(tmp_path / "grid.npz"), grid)
    np.savez(tmp_path / "turned.npz", xyz=np.swapaxes(grid, 0, 1))
    np.testing.assert_array_equal(read_grid(tmp_path / "turned.npz"), grid)
    np.savez(tmp_path / "list.npz", xyz=grid.reshape(-1, 3))
    assert read_grid(tmp_path / "list.npz") is None
    rows = "\n".join(" ".join(map(repr, row)) for row in grid.reshape(-1, 3).tolist())
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 5\nHEIGHT 12\nPOINTS 60\nDATA ascii\n"
    (tmp_path / "grid.pcd").write_text(head + rows)
    np.testing.assert_allclose(read_grid(tmp_path / "grid.pcd"), grid)
    write_pcd(tmp_path / "plain.pcd", PointCloud(np.zeros((4, 3)), *np.zeros((9, 4))), {})
    assert read_grid(tmp_path / "plain.pcd") is None


def test_beside_a_plan_detectable_shares_count_boxes_whatever_these_weigh():
    """With cars of a fifth of the weight the planned share was 190 %."""
    site = prepare(
        load_scenario(
            "i80",
            {
                ("traffic", "frames"): (4, "here"),
                ("model", "workers"): (1, "here"),
                ("objective", "class_weights"): ({"car": 0.2}, "here"),
            },
        )
    )
    planned = site.scenario.lidar.mounting({"height_m": 4.5, "tilt_x_deg": 23.0})
    known = {"height_m": 4.5, "tilt_x": math.radians(23.0), "tilt_y": 0.0}
    fit = SimpleNamespace(
        pose=Pose(0.0, 0.0, 4.5, math.radians(23.0), 0.0, 0.0),
        yaw=None,
        **{key: Estimate(value, 0.001, 0.001) for key, value in known.items()},
    )
    found = against_plan(site, (planned,), 0, fit)["detectable_share"]
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        totals = evaluator.held_out.totals([(planned,)])
    assert found["planned"] == found["measured"] == pytest.approx(totals.detectable.sum() / totals.vehicles.sum())
    assert found["planned"] < 1.0


def test_a_sensor_file_of_ones_own_is_found_again_and_keeps_its_sector(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    beams = "beams=[[0,-10.0,0.0,0.0],[1,-5.0,0.0,0.0],[2,0.0,0.0,0.0]]\n"
    (tmp_path / "mine.toml").write_text(f"rotation_hz=[10.0]\nazimuth_deg=[-60.0, 60.0]\n{beams}")
    model = load_model(tmp_path / "mine.toml")
    pose = Pose(0.0, 0.0, 4.0, 0.0, 0.0, 0.0)
    found = SimpleNamespace(model=model, unit_rad=model.elevation_rad, fit=SimpleNamespace(pose=pose, yaw=None))
    (tmp_path / "beams.toml").write_text(unit_table(found))
    named = load_model(tomllib.loads(deployment(found))["sensor"]["name"])
    assert named.azimuth_deg == model.azimuth_deg == (-60.0, 60.0)
    np.testing.assert_allclose(named.elevation_rad, model.elevation_rad)
