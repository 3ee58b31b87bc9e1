"""Clouds beside their simulation: those that our shapes made are recognised, and what hides a vehicle is set aside."""

from __future__ import annotations

import csv
import json
import math
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.cli import main
from blender_lidar.clouds.rings import table_rings
from blender_lidar.errors import InputError
from blender_lidar.files import write_columns
from blender_lidar.metrics.vgop import occupancy, pe_vgop
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import Imperfections
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.statistics import RESAMPLES, resampled_weights
from blender_lidar.studies.compare import Setup, compare_frames, median_interval, resampled_medians
from blender_lidar.studies.recorded import (
    NO_POINT,
    Firings,
    LabelledBoxes,
    Rays,
    RecordedFrame,
    crossing,
    labelled_frames,
)
from blender_lidar.world.triangles import shape_names
from tests.recorded_samples import CASTER, HEIGHT_M, SENSOR, scanned, street
from tests.refusals import refused
from tests.sample_traffic import joined

LEVELS = ("box", "body", "detailed")
PLAIN = Setup(details=("body",), caster=CASTER, pose=Pose(height_m=HEIGHT_M))


def frame_of(vehicles, cloud, which=None, label=None) -> RecordedFrame:
    """A cloud and the labels of its vehicles, or of some of them."""
    boxes = LabelledBoxes(
        **vehicles.columns() | {"frame": vehicles.frame, "time_s": vehicles.time_s},
        label=vehicles.class_name if label is None else np.array(label),
        shape=shape_names(vehicles),
    )
    return RecordedFrame(str(vehicles.frame), "here", cloud.xyz, boxes if which is None else boxes.select(which))


def compared(frames, setup=PLAIN):
    return compare_frames(frames, beam_lattice(load_model(SENSOR)), setup).table


@pytest.fixture(scope="module")
def bodies():
    """Three frames of streets whose cars are bodies."""
    return [frame_of(vehicles, scanned(vehicles)) for vehicles in map(street, (1, 2, 3))]


@pytest.fixture(scope="module")
def paired(bodies):
    """By level of detail the columns of every car."""
    table = compared(bodies, replace(PLAIN, details=LEVELS))
    return {detail: {key: of[table["detail"] == detail] for key, of in table.items()} for detail in LEVELS}


def test_the_level_that_the_cloud_was_made_of_has_no_error_and_the_others_have(paired):
    error = {detail: np.abs(of["error_bits"]) for detail, of in paired.items()}
    assert len(error["body"]) > 15
    assert error["body"].max() < 0.03
    assert np.median(error["body"]) < 0.002
    assert np.median(error["box"]) > 0.05
    assert np.median(error["detailed"]) > 0.01


def test_with_the_true_shapes_every_ray_gives_the_same_point(paired):
    real, simulated, both = (paired["body"][f"{of}_points"].sum() for of in ("real", "simulated", "both"))
    assert real > 3000
    assert both > 0.995 * max(real, simulated)
    assert np.nanmax(paired["body"]["range_error_m"]) < 1e-4


def test_the_columns_are_those_of_the_metric(bodies, paired):
    """One car by hand: the points in its box, as `metrics` scores them."""
    frame, of = bodies[0], paired["body"]
    boxes = frame.boxes
    row = int(np.argmin(np.hypot(*boxes.centre_m[:, :2].T)))
    cos, sin = np.cos(boxes.heading_rad[row]), np.sin(boxes.heading_rad[row])
    away = frame.points - boxes.centre_m[row]
    local = np.column_stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]])
    half = 0.5 * boxes.size_m[row]
    mine = (np.abs(local) <= half + 0.05).all(axis=1) & (local[:, 2] >= 0.15 - half[2])
    at = np.flatnonzero((of["frame"] == frame.name) & (of["vehicle_id"] == boxes.vehicle_id[row]))[0]
    size, first = boxes.size_m[row : row + 1], np.zeros(int(mine.sum()), dtype=int)
    assert of["real_points"][at] == mine.sum() > 100
    assert of["real_entropy_bits"][at] == pytest.approx(pe_vgop(local[mine], first, size)[0])
    shares = [of[f"real_p_{view}"][at] for view in ("top", "side", "front")]
    np.testing.assert_allclose(shares, occupancy(local[mine], first, size)[0])
    assert of["distance_m"][at] == pytest.approx(np.hypot(*boxes.centre_m[row, :2]))
    assert of["hidden_share"][at] == 0.0


def test_losses_are_those_that_scans_know():
    """A cloud that lost its weak returns is matched by a simulation that loses them, and not by another."""
    weak, vehicles = Imperfections(range_at_10_percent_m=20.0), street(1)
    perfect, lossy = scanned(vehicles), scanned(vehicles, imperfections=weak)
    parts = perfect.xyz[perfect.vehicle_id < 0], lossy.xyz[lossy.vehicle_id >= 0]  # of the far road nothing is left
    frames = [frame_of(vehicles, SimpleNamespace(xyz=np.concatenate(parts)))]
    error = {
        name: np.abs(compared(frames, replace(PLAIN, losses={"": losses}))["error_bits"])
        for name, losses in {"weak": weak, "none": Imperfections(), "any": Imperfections(dropout=0.3)}.items()
    }
    assert np.median(error["weak"]) < 0.005
    assert min(np.median(error["none"]), np.median(error["any"])) > 0.03


def test_shares_that_are_lost_by_chance_are_lost():
    frames = [frame_of(street(4), scanned(street(4)))]
    counts = {
        losses: compared(frames, replace(PLAIN, losses={"": losses}))["simulated_points"].sum()
        for losses in (Imperfections(), Imperfections(dropout=0.3), Imperfections(glass_dropout=1.0))
    }
    whole, thinned, without_glass = counts.values()
    assert thinned == pytest.approx(0.7 * whole, rel=0.05)
    assert 0.5 * whole < without_glass < 0.95 * whole


def test_what_an_unlabelled_thing_hid_counts_on_neither_side():
    """A second car stands before half of the first, and is labelled in one of two otherwise equal frames."""
    vehicles = street(5, cars=1)
    target = replace(vehicles, centre_m=np.array([[0.0, 25.0, 0.75]]), heading_rad=np.array([0.0]))
    before = replace(target, centre_m=np.array([[1.3, 15.0, 0.75]]), heading_rad=np.array([1.2]))
    both = replace(joined(target, before), vehicle_id=np.arange(2))
    cloud = scanned(both)
    labelled, unlabelled = (compared([frame_of(both, cloud, np.arange(count))]) for count in (2, 1))
    assert 0.1 < unlabelled["hidden_share"][0] < 0.9
    assert abs(unlabelled["error_bits"][0]) < 0.02  # the hidden rays are set aside
    assert abs(labelled["error_bits"][0]) < 0.05  # what is labelled hides in the simulation too
    assert labelled["real_points"][0] == unlabelled["real_points"][0]


def test_intervals_cover_the_median_of_frames_that_differ():
    """Of 200 sets of 20 frames of 8 cars, whose frames differ as much as their cars, nine in ten hold the truth."""
    rng = np.random.default_rng(6)
    frame = np.repeat(np.arange(20), 8)
    held = 0
    for _ in range(200):
        values = rng.normal(size=20)[frame] + rng.normal(size=160)
        low, high = median_interval(values, frame)["interval_90"]
        held += low <= 0.0 <= high
    assert 165 <= held <= 195


# --- A known sensor, in any mounting and any order of the points ------------------------------------------------------

TILTED = Pose(x_m=3.0, y_m=-2.0, height_m=4.1, tilt_x=math.radians(9.0), tilt_y=math.radians(-2.0), yaw=0.4)


def in_table(clouds, boxes, sensor):
    """The comparison of clouds beside a table, from a tilted sensor."""
    return compare_frames(
        labelled_frames(clouds, boxes, None), beam_lattice(load_model(sensor)), replace(PLAIN, pose=TILTED)
    )


def only(cloud, which):
    """The points of a cloud that a mask picks."""
    return SimpleNamespace(xyz=cloud.xyz[which])


def recorded(cloud, vehicles, tmp_path, frame=5):
    """A cloud in any order, as NPZ, beside a table of boxes; the paths of both."""
    shuffled = np.random.default_rng(1).permutation(len(cloud.xyz))
    np.savez(tmp_path / f"cloud{frame}.npz", xyz=cloud.xyz[shuffled])
    columns = dict(zip(("x_m", "y_m", "z_m"), vehicles.centre_m.T, strict=True))
    columns |= dict(zip(("length_m", "width_m", "height_m"), vehicles.size_m.T, strict=True))
    named = {"frame": np.full(len(vehicles), frame), "vehicle_id": vehicles.vehicle_id, "class": vehicles.class_name}
    write_columns(tmp_path / "boxes.csv", {**named, **columns, "heading_deg": np.degrees(vehicles.heading_rad)})
    return str(tmp_path / f"cloud{frame}.npz"), str(tmp_path / "boxes.csv")


@pytest.mark.parametrize("sensor", ["RS-16", "RS-80"])
def test_a_tilted_sensor_is_simulated_as_its_cloud_was(tmp_path, sensor):
    vehicles = street(2, cars=5)
    cloud, boxes = recorded(scanned(vehicles, TILTED, sensor), vehicles, tmp_path)
    found = in_table([cloud], boxes, sensor)
    table = found.table
    assert (found.sensor["share_on_rings"], len(table["frame"])) == (1.0, 5)
    assert table["real_points"].min() > 10
    np.testing.assert_allclose(table["simulated_points"], table["real_points"], rtol=0.03, atol=3)
    assert np.abs(table["error_bits"]).max() < 0.02
    away = np.hypot(vehicles.centre_m[:, 0] - 3.0, vehicles.centre_m[:, 1] + 2.0)
    np.testing.assert_allclose(table["distance_m"], away, atol=1e-6)


def test_rings_on_which_nothing_returned_are_simulated_too(tmp_path):
    """Of vehicles that gave no point, what the sensor should have seen of them is there."""
    vehicles = street(2, cars=5)
    cloud = scanned(vehicles, TILTED, "RS-16")
    path, boxes = recorded(cloud, vehicles, tmp_path)
    seen = in_table([path], boxes, "RS-16").table["real_points"]
    path, boxes = recorded(only(cloud, (cloud.vehicle_id < 0) & (cloud.ring < 8)), vehicles, tmp_path)
    table = in_table([path], boxes, "RS-16").table
    assert table["real_points"].sum() == 0
    np.testing.assert_allclose(table["simulated_points"], seen, rtol=0.05, atol=3)


@pytest.mark.parametrize(
    ("sensor", "pose"),
    [("RS-32", TILTED), ("RS-80", replace(TILTED, tilt_x=math.radians(7.5))), ("RS-80", replace(TILTED, height_m=3.0))],
    ids=["another sensor", "another tilt", "another height"],
)
def test_a_beam_table_that_is_not_the_clouds_is_refused(tmp_path, capsys, sensor, pose):
    vehicles = street(2, cars=5)
    cloud, boxes = recorded(scanned(vehicles, TILTED, "RS-80"), vehicles, tmp_path)
    tilts = ("--tilt-x", math.degrees(pose.tilt_x), "--tilt-y", math.degrees(pose.tilt_y), "--yaw", math.degrees(0.4))
    words = ("--sensor", sensor, "--x", 3, "--y", -2, "--height", pose.height_m, *tilts, "--caster", CASTER)
    message = refused(capsys, tmp_path, "compare", "--points", cloud, "--boxes", boxes, *words)
    assert f"% of its {len(np.load(cloud)['xyz'])} points are near the rings of {sensor}, where chance gives" in message


def test_a_cloud_in_another_frame_than_its_boxes_is_told(tmp_path, capsys):
    vehicles = street(2, cars=9)
    cloud, boxes = recorded(scanned(vehicles), vehicles, tmp_path)
    np.savez(tmp_path / "mm.npz", xyz=1000.0 * np.load(cloud)["xyz"])
    words = ("--boxes", boxes, "--sensor", SENSOR, "--height", HEIGHT_M, "--caster", CASTER)
    message = refused(capsys, tmp_path, "compare", "--points", tmp_path / "mm.npz", *words)
    assert "would after dividing the coordinates (mm) by 1000; if it is right" in message
    np.savez(tmp_path / "f4.npz", xyz=(np.load(cloud)["xyz"] + np.array([5e5, 5e6, 0.0])).astype("f4"))
    assert "in float32" in refused(capsys, tmp_path, "compare", "--points", tmp_path / "f4.npz", *words)


# --- The command ------------------------------------------------------------------------------------------------------


def run(*words):
    return main(["compare", *map(str, words)])


@pytest.fixture(scope="module")
def clouds(tmp_path_factory):
    """Options that name three clouds, their boxes and their sensor."""
    folder, words, rows = tmp_path_factory.mktemp("clouds"), [], {}
    for vehicles in map(street, (1, 2, 3)):
        path, boxes = recorded(scanned(vehicles), vehicles, folder, vehicles.frame)
        words += ["--points", path, "--frame", vehicles.frame]
        rows[vehicles.frame] = Path(boxes).read_text(encoding="utf-8").splitlines()
    (folder / "all.csv").write_text("\n".join([rows[1][0], *(line for of in rows.values() for line in of[1:])]) + "\n")
    return [*words, "--boxes", folder / "all.csv", "--sensor", SENSOR, "--height", HEIGHT_M, "--caster", CASTER]


def test_the_verb_leaves_a_table_aggregates_and_a_picture_that_agree(clouds, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    out = tmp_path / "out"
    words = (*clouds, "--details", "detailed,body")
    assert run(*words, "--out", out, "--json") == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert result == json.loads((out / "compare.json").read_text())
    assert "HDL-64E-S3: 100 % of the points are on its rings" in printed.err
    assert "Intervals resample the 3 clouds" in printed.err
    assert (out / "compare.png").read_bytes().startswith(b"\x89PNG")
    with (out / "compare.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [one["detail"] for one in result["variants"]] == ["body", "detailed"]
    assert len(rows) == 2 * result["vehicles"]
    for one in result["variants"]:
        mine = [row for row in rows if row["detail"] == one["detail"]]
        error = np.abs([float(row["error_bits"]) for row in mine])
        assert np.median(error) == pytest.approx(one["absolute_error_bits"]["median"], abs=1e-5)
        assert sum(int(row["both_points"]) for row in mine) == one["points"]["both"]
        assert sum(band["vehicles"] for band in one["by_distance"]) == result["vehicles"]
    assert run(*words, "--out", out) == 2
    assert run(*words, "--out", tmp_path / "again") == 0
    assert (tmp_path / "again" / "compare.csv").read_bytes() == (out / "compare.csv").read_bytes()


def test_what_is_compared_may_be_named_by_class_and_distance(bodies):
    vehicles = street(1)
    frame = frame_of(vehicles, scanned(vehicles), label=["van" if row % 2 else "Car" for row in range(len(vehicles))])
    ways = ({"classes": ("car",)}, {"classes": ("VAN",)}, {}, {"between_m": (0.0, 25.0)})
    counts = [len(compared([frame], replace(PLAIN, **way))["frame"]) for way in ways]
    assert counts == [4, 3, 7, (np.hypot(*vehicles.centre_m[:, :2].T) < 25.0).sum()]


def test_a_single_cloud_has_intervals_over_its_vehicles(tmp_path, capsys):
    vehicles = street(2, cars=5)
    cloud, boxes = recorded(scanned(vehicles), vehicles, tmp_path)
    words = ("--points", cloud, "--boxes", boxes, "--sensor", SENSOR, "--height", HEIGHT_M, "--caster", CASTER)
    assert run(*words, "--out", tmp_path / "out") == 0
    assert "Intervals resample single vehicles" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--details", "body,fine"), "--details: "),
        (("--losses", "glass_dropout=2"), "--losses: glass_dropout is 2.0; allowed: 0 to 1"),
        (("--losses", "glass=0.5"), "--losses: "),
        (("--losses", "dropout=much"), "--losses: 'dropout=much'; allowed: NAME=VALUE"),
        (("--label-margin", "0", "0", "2"), "--label-margin: is 2.0; allowed: 0 to 1"),
        (("--distance", "50", "10"), "--distance: 50 10; allowed: the nearer one first"),
    ],
)
def test_wrong_options_end_in_one_line(clouds, tmp_path, capsys, words, message):
    assert message in refused(capsys, tmp_path, "compare", *clouds, "--out", tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_where_nothing_is_left_to_compare_it_says_why(bodies):
    for way, message in (
        ({"between_m": (100.0, 200.0)}, r"no labelled vehicle to compare at 100 to 200 m \(21 nearer\)"),
        ({"classes": ("Lorry",)}, "no Lorry to compare; the labels are car"),
    ):
        with pytest.raises(InputError, match=message):
            compared(bodies, replace(PLAIN, **way))


# --- recorded clouds beside a table of boxes, and the rays of their sensor --------------------------------------------


LATTICE, POSE = beam_lattice(load_model(SENSOR)), Pose(height_m=HEIGHT_M)


@cache
def swept():
    """A turn over a street."""
    return scanned(street())


def firings(xyz):
    return Firings(xyz, table_rings(POSE.to_sensor(xyz), LATTICE)[0], POSE)


def test_rays_run_through_the_points_that_they_returned_as():
    cloud = swept()
    rays, _ = firings(cloud.xyz).towards(np.array([5.0, 20.0, 1.0]), np.array([8.0, 4.0, 3.0]), 0.4)
    returned = rays.point != NO_POINT
    assert 0 < returned.sum() < len(returned)
    at = rays.origin[returned] + rays.range_m[returned, None] * rays.direction[returned]
    np.testing.assert_allclose(at, cloud.xyz[rays.point[returned]], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rays.direction, axis=1), 1.0, atol=1e-12)
    assert np.isinf(rays.range_m[~returned]).all()


@pytest.mark.parametrize("centre", [(4.0, 25.0, 0.8), (0.0, 14.0, 0.8), (-18.0, 0.0, 0.8), (0.3, -30.0, 0.8)])
def test_firings_that_did_not_return_are_put_back_where_they_were(centre):
    """A third of the returns are taken away; the rays towards a box are the sensor's own all the same."""
    cloud = swept()
    kept = np.random.default_rng(4).random(len(cloud.xyz)) > 0.3
    size, heading, centre = np.array([4.5, 1.8, 1.6]), 0.7, np.array(centre)
    rays, _ = firings(cloud.xyz[kept]).towards(centre, size, heading)
    beams = LATTICE.directions.reshape(-1, 3)
    count = len(beams)
    every = Rays(np.tile(POSE.position, (count, 1)), beams, np.full(count, NO_POINT), np.full(count, np.inf))
    entry, leave = crossing(every, centre, size, heading)
    true = beams[(leave >= entry) & (leave > 0.0)]
    assert abs(len(rays.point) - len(true)) <= 0.02 * len(true) + 1
    nearest = np.max(true @ rays.direction.T, axis=1)
    assert np.degrees(np.arccos(np.clip(nearest, -1.0, 1.0))).max() < 0.1  # steps are 0.17


# --- Clouds beside a table --------------------------------------------------------------------------------------------


@pytest.fixture
def table(tmp_path):
    """Two frames of one vehicle each, and clouds of one point for both."""
    for name in "ab":
        np.savez(tmp_path / f"{name}.npz", xyz=np.array([[10.0, 2.0, 1.0]]))
    path = tmp_path / "boxes.csv"
    header = "frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg"
    path.write_text(f"{header}\n1,7,car,10,2,4,2,1.5,90\n2,7,truck,11,2,10,2.5,4,90\n", encoding="utf-8")
    return path


def test_each_cloud_has_the_boxes_of_its_frame(table):
    clouds = [str(table.with_name(f"{name}.npz")) for name in "ab"]
    first, second = labelled_frames(clouds, str(table), (2, 1))
    assert (first.name, first.boxes.shape.tolist(), second.boxes.shape.tolist()) == ("2", ["long_truck"], ["car"])
    assert second.boxes.centre_m.tolist() == [[10.0, 2.0, 0.75]]
    assert second.points.tolist() == [[10.0, 2.0, 1.0]]
    np.testing.assert_allclose(second.boxes.heading_rad, [0.5 * math.pi])


@pytest.mark.parametrize(
    ("clouds", "frames", "message"),
    [
        (
            "a",
            None,
            "holds 2 frames, 1 to 2, for 1 clouds, whose names end with others or none; give --frame",
        ),
        ("ab", (1,), "--frame: 1 numbers; allowed: one for each of the 2 clouds"),
        ("a", (3,), "no frame 3; the recording has 2 frames from 1 to 2"),
    ],
)
def test_clouds_that_have_no_frame_are_refused(table, clouds, frames, message):
    paths = [str(table.with_name(f"{name}.npz")) for name in clouds]
    with pytest.raises(InputError, match=re.escape(message)):
        list(labelled_frames(paths, str(table), frames))


def test_rays_of_a_blind_sector_count_on_neither_side():
    """Half of a car lies where the sensor is switched off."""
    vehicles = street()
    cloud = scanned(vehicles)
    azimuth = np.degrees(np.arctan2(*cloud.xyz[:, :2].T)) % 360.0
    middle = np.degrees(np.arctan2(*vehicles.centre_m[3, :2])) % 360.0
    cut = replace(cloud, xyz=cloud.xyz[(azimuth - middle) % 360.0 > 40.0])
    lost, aside = (
        compared([frame_of(vehicles, cut, which=[3])], replace(PLAIN, blind_deg=sectors))
        for sectors in ((), [(middle, middle + 40.0)])
    )
    assert lost["real_points"] == aside["real_points"]
    assert lost["simulated_points"] > 1.3 * lost["real_points"]
    assert aside["simulated_points"] == pytest.approx(aside["real_points"], rel=0.05)
    assert aside["hidden_share"] > 0.3


@given(seed=st.integers(0, 2**32 - 1))
def test_resampled_medians_are_medians_of_the_values_that_were_drawn(seed):
    rng = np.random.default_rng(seed)
    values, cluster = rng.integers(0, 9, 8).astype(float), np.repeat(np.arange(4), 2)
    weights = resampled_weights(4, np.random.default_rng(1), RESAMPLES)[:, cluster]
    found = resampled_medians(values[None], cluster)[0]
    for row in range(0, RESAMPLES, RESAMPLES // 40):
        assert found[row] == np.median(np.repeat(values, weights[row].astype(int)))
