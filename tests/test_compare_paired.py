"""Sweeps cast against our shapes: those that a sweep was made of are recognised, what hides a car is set aside."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.cli import main
from blender_lidar.metrics.vgop import occupancy, pe_vgop
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.studies.compare.labelled import open_labelled
from blender_lidar.studies.compare.paired import MEASURED, pair_cars, shapes_of_labels, variants
from blender_lidar.studies.compare.paired_findings import aggregate, cheapest_within_noise, median_interval
from tests.labelled_samples import KITTI, needs_kitti
from tests.real_sweeps import cloud_of, in_kitti_frame, street, write_kitti
from tests.refusals import refused
from tests.sample_traffic import joined

CASTER = "embree" if is_available("embree") else "exact"
NO_MARGIN = (0.0, 0.0, 0.0)
LEVELS = ("box", "body", "detailed")
PLAIN = tuple(way for way in variants(LEVELS) if way.losses == "none")


@pytest.fixture(scope="module")
def true_bodies(tmp_path_factory):
    """Three sweeps over streets whose cars are bodies."""
    folder = tmp_path_factory.mktemp("bodies")
    for seed in (1, 2, 3):
        vehicles = street(seed)
        write_kitti(folder, f"00000{seed}", cloud_of(vehicles)[1], vehicles)
    return folder


@pytest.fixture(scope="module")
def paired(true_bodies):
    return pair_cars(open_labelled(true_bodies), PLAIN, CASTER, NO_MARGIN)


def test_the_level_that_the_sweep_was_made_of_has_no_error_and_the_others_have(paired):
    error = {way.detail: np.abs(one) for way, one in zip(paired.variants, paired["error_bits"], strict=True)}
    assert len(paired) > 15
    assert error["body"].max() < 0.03
    assert np.median(error["body"]) < 0.002
    assert np.median(error["box"]) > 0.05
    assert np.median(error["detailed"]) > 0.01
    found = cheapest_within_noise(aggregate(paired, {})["all"], LEVELS)
    assert found["best"] == found["cheapest"] == {"detail": "body", "losses": "none"}


def test_with_the_true_shapes_every_ray_gives_the_same_point(paired):
    body = [way.detail for way in paired.variants].index("body")
    real, simulated, both = (paired[f"{of}_points"][body].sum() for of in ("real", "simulated", "both"))
    assert real > 3000
    assert both > 0.995 * max(real, simulated)
    assert np.nanmax(paired["residual_abs_median_m"][body]) < 1e-4


def test_the_columns_are_those_of_the_metric(true_bodies, paired):
    """One car by hand: the points in its box, as `metrics` scores them."""
    sweep = open_labelled(true_bodies).read("000001")
    boxes = sweep.boxes
    row = int(np.argmin(boxes.distance_m))
    cos, sin = np.cos(boxes.heading_rad[row]), np.sin(boxes.heading_rad[row])
    away = sweep.points - boxes.centre_m[row]
    local = np.column_stack([cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0], away[:, 2]])
    half = 0.5 * boxes.size_m[row]
    mine = (np.abs(local) <= half + 0.05).all(axis=1) & (local[:, 2] >= 0.15 - half[2])
    at = np.flatnonzero((paired.table["frame"] == "000001") & (paired.table["label_line"] == boxes.label_line[row]))[0]
    size, first = boxes.size_m[row : row + 1], np.zeros(int(mine.sum()), dtype=int)
    assert paired.table["real_points"][at] == mine.sum() > 100
    assert paired.table["real_entropy_bits"][at] == pytest.approx(pe_vgop(local[mine], first, size)[0])
    shares = [paired.table[f"real_p_{view}"][at] for view in ("top", "side", "front")]
    np.testing.assert_allclose(shares, occupancy(local[mine], first, size)[0])
    assert paired.table["hidden_share"][at] == 0.0


def test_losses_are_those_that_scans_know(tmp_path):
    """A sweep that lost its weak returns is matched by the variant that loses them, and by it alone."""
    weak = Imperfections(range_at_10_percent_m=20.0)
    for seed in (1, 2, 3):
        vehicles = street(seed)
        perfect, lossy = cloud_of(vehicles)[0], cloud_of(vehicles, imperfections=weak)[0]
        road, cars = perfect.vehicle_id < 0, lossy.vehicle_id >= 0  # of the far road nothing would be left
        parts = [(cloud.ring[kept], cloud.azimuth_rad[kept]) for cloud, kept in ((perfect, road), (lossy, cars))]
        order = np.lexsort(tuple(np.concatenate(column) for column in zip(*parts, strict=True))[::-1])
        points = in_kitti_frame(np.concatenate([perfect.xyz[road], lossy.xyz[cars]])[order])
        write_kitti(tmp_path, f"00000{seed}", points, vehicles)
    ways = variants(("body",), replace(MEASURED, range_at_10_percent_m=20.0))
    paired = pair_cars(open_labelled(tmp_path), ways, CASTER, NO_MARGIN)
    error = {way.losses: np.abs(one) for way, one in zip(ways, paired["error_bits"], strict=True)}
    assert np.median(error["weak"]) < 0.005
    assert all(np.median(error[losses]) > 0.03 for losses in ("none", "glass", "any", "both"))


def one_sweep(folder, vehicles, labels=None):
    """A folder of one sweep over vehicles."""
    folder.mkdir(exist_ok=True)
    write_kitti(folder, "1", cloud_of(vehicles)[1], vehicles, labels)
    return open_labelled(folder)


def test_shares_that_are_lost_by_chance_are_lost(tmp_path):
    ways = variants(("body",), Imperfections(0.02, 0.3, glass_dropout=1.0, range_at_10_percent_m=1e3))
    paired = pair_cars(one_sweep(tmp_path, street(4)), ways, CASTER, NO_MARGIN)
    counts = {way.losses: points.sum() for way, points in zip(ways, paired["simulated_points"], strict=True)}
    assert counts["any"] == pytest.approx(0.7 * counts["none"], rel=0.05)
    assert counts["both"] == pytest.approx(0.7 * counts["glass"], rel=0.05)
    assert counts["glass"] < 0.95 * counts["none"] == 0.95 * counts["weak"]


def test_what_an_unlabelled_thing_hid_counts_on_neither_side(tmp_path):
    """A second car stands before half of the first, and is labelled in one of two otherwise equal folders."""
    vehicles = street(5, cars=1)
    target = replace(vehicles, centre_m=np.array([[0.0, 25.0, 0.75]]), heading_rad=np.array([0.0]))
    before = replace(target, centre_m=np.array([[1.3, 15.0, 0.75]]), heading_rad=np.array([1.2]))
    both = replace(joined(target, before), vehicle_id=np.arange(2))
    results = {}
    for name, labels in {"told": ["Car", "Car"], "untold": ["Car", "DontCare"]}.items():
        results[name] = pair_cars(one_sweep(tmp_path / name, both, labels), PLAIN[1:2], CASTER, NO_MARGIN)
        assert results[name].table["label_line"][0] == 0
    told, untold = results["told"], results["untold"]
    kept = [of.table["simulated_entropy_hidden_kept_bits"] - of.table["real_entropy_bits"] for of in (untold, told)]
    assert 0.1 < untold.table["hidden_share"][0] < 0.9
    assert abs(untold.table["error_bits"][0]) < 0.02  # the hidden rays are set aside
    assert kept[0][0] > 0.1  # and would otherwise be the car's
    assert abs(kept[1][0]) < 0.05  # what is labelled hides in the simulation too


def test_labels_become_the_shapes_that_traffic_has(tmp_path):
    labels = ["Car", "Pedestrian", "Car", "Van", "Truck", "Cyclist", "Truck", "Tram"]
    boxes = one_sweep(tmp_path, street(1, cars=8), labels).read("1").boxes
    size = np.repeat([[4.0, 1.8, 1.5], [5.0, 1.9, 1.8], [8.0, 2.5, 3.0], [12.0, 2.5, 3.5]], 2, axis=0)
    expected = ["car", None, "van", "van", "truck", "motorcycle", "long_truck", "bus"]
    assert shapes_of_labels(replace(boxes, size_m=size)) == expected


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


def test_a_drive_that_is_told_is_resampled_as_one(true_bodies, tmp_path, capsys):
    frames = open_labelled(true_bodies).frames
    folder = tmp_path / "drives"
    shutil.copytree(true_bodies, folder)
    words = ("--kitti", folder, "--label-margin", 0, 0, 0, "--caster", CASTER, "--details", "box,body", "--json")

    def told(*columns):
        rows = [",".join([frame, *(str(column(number)) for column in columns)]) for number, frame in enumerate(frames)]
        return "\n".join(rows) + "\n"

    assert len(frames) >= 3
    (folder / "frames.csv").write_text("frame,label_kind\n" + told(lambda n: "tracking"), encoding="utf-8")
    assert run(*words, "--out", tmp_path / "a") == 0
    first = capsys.readouterr()
    drawn = json.loads(first.out)["sets"]["all"]["resampled"]
    assert drawn == {"unit": "frame", "number": len(frames), "too_narrow": True}
    assert "They are too narrow" in first.err
    (folder / "frames.csv").write_text("frame,drive\n" + told(lambda n: n % 3), encoding="utf-8")
    assert run(*words, "--out", tmp_path / "b") == 0
    second = capsys.readouterr()
    assert json.loads(second.out)["sets"]["all"]["resampled"] == {"unit": "drive", "number": 3, "too_narrow": False}
    assert "too narrow" not in second.err


def run(*words):
    return main(["compare", "--paired", *map(str, words)])


def test_the_verb_leaves_a_table_and_aggregates_that_agree(true_bodies, tmp_path, capsys):
    out = tmp_path / "out"
    words = ("--kitti", true_bodies, "--label-margin", 0, 0, 0, "--caster", CASTER, "--details", "detailed,body")
    assert run(*words, "--out", out, "--json") == 0
    printed = capsys.readouterr()
    result = json.loads(printed.out)
    assert result == json.loads((out / "paired.json").read_text())
    assert "body, no loss" in printed.err
    with (out / "paired.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    of = result["sets"]["all"]
    assert len(rows) == of["cars"] * len(of["variants"]) == of["cars"] * 12
    for one in of["variants"]:
        mine = [row for row in rows if (row["detail"], row["losses"]) == (one["detail"], one["losses"])]
        error = np.abs([float(row["error_bits"]) for row in mine])
        assert np.median(error) == pytest.approx(one["absolute_error_bits"]["median"], abs=1e-5)
        assert sum(int(row["both_points"]) for row in mine) == one["hits"]["both"]
        assert sum(group["cars"] for group in one["by_distance"]) == of["cars"]
        assert sum(group["cars"] for group in one["by_bearing"]) == of["cars"]
    assert run(*words, "--out", tmp_path / "again") == 0
    assert (tmp_path / "again" / "paired.csv").read_bytes() == (out / "paired.csv").read_bytes()


@pytest.mark.parametrize(
    ("split", "told"),
    [("train", "the frames that shapes and losses were fitted to"), ("test", "that nothing was fitted to")],
)
def test_a_folder_of_fitted_or_of_other_frames_alone_says_so(tmp_path, capsys, split, told):
    one_sweep(tmp_path, street(1))
    (tmp_path / "frames.csv").write_text(f"frame,split,label_kind\n1,{split},tracking\n", encoding="utf-8")
    words = ("--kitti", tmp_path, "--details", "box", "--caster", CASTER, "--out", tmp_path / "out")
    assert run(*words) == 0
    printed = capsys.readouterr().out
    assert told in printed
    assert "on the frames of the fit and" not in printed


def test_what_counts_as_a_car_may_be_named(tmp_path, capsys):
    vehicles = street(1)
    one_sweep(tmp_path, vehicles, ["Van" if row % 2 else "Car" for row in range(len(vehicles))])
    words = ("--kitti", tmp_path, "--details", "box", "--caster", CASTER, "--json")
    counts = []
    for number, classes in enumerate((("car",), ("VAN",), ("Car", "Van"))):
        named = [word for name in classes for word in ("--class", name)]
        assert run(*words, *named, "--out", tmp_path / f"out{number}") == 0
        counts.append(json.loads(capsys.readouterr().out)["sets"]["all"]["cars"])
    assert counts[0] > 0
    assert counts[1] > 0
    assert counts[2] == counts[0] + counts[1]


def test_a_single_sweep_is_compared_without_intervals(tmp_path, capsys):
    one_sweep(tmp_path / "one", street(1))
    words = ("--kitti", tmp_path / "one", "--label-margin", 0, 0, 0, "--caster", CASTER, "--out", tmp_path / "out")
    assert run(*words) == 0
    printed = capsys.readouterr().out
    assert "Smallest error: body" in printed
    assert "with fewer than 3 frames there are no intervals" in printed
    of = json.loads((tmp_path / "out" / "paired.json").read_text())["sets"]["all"]
    assert all(one["within_noise"] is None and one["interval_90"] is None for one in of["differences"])


def test_without_a_kind_of_comparison_the_verb_asks_for_one(true_bodies, tmp_path, capsys):
    assert "--paired" in refused(capsys, tmp_path, "compare", "--kitti", true_bodies)


def test_the_verb_draws_its_pictures(true_bodies, tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    assert run("--kitti", true_bodies, "--caster", CASTER, "--out", tmp_path / "out") == 0
    for name in ("error.png", "scores.png", "cars.png", "residuals.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--details", "body,fine"), "--details: "),
        (("--class", " "), "--class: is empty"),
        (("--losses", "glass_dropout=2"), "--losses: glass_dropout is 2.0; allowed: 0 to 1"),
        (("--losses", "glass=0.5"), "--losses: "),
        (("--losses", "dropout=much"), "--losses: 'dropout=much'; allowed: NAME=VALUE"),
        (("--label-margin", "0", "0", "2"), "--label-margin: is 2.0; allowed: 0 to 1"),
        (("--label-margin", "0", "nan", "0"), "--label-margin: is nan"),
    ],
)
def test_wrong_options_end_in_one_line(true_bodies, tmp_path, capsys, words, told):
    given = ("compare", "--paired", "--kitti", true_bodies, "--out", tmp_path / "out", *words)
    assert told in refused(capsys, tmp_path, *given)


def test_wrong_folders_end_in_one_line_and_leave_nothing(true_bodies, tmp_path, capsys):
    full = tmp_path / "full"
    full.mkdir()
    (full / "paired.csv").write_text("mine", encoding="utf-8")
    assert run("--kitti", true_bodies, "--caster", CASTER, "--out", full) == 2
    assert "holds paired.csv already; give another folder" in capsys.readouterr().err
    assert [path.name for path in full.iterdir()] == ["paired.csv"]
    shuffled = tmp_path / "shuffled"
    shuffled.mkdir()
    vehicles = street(1)
    points = cloud_of(vehicles)[1]
    write_kitti(shuffled, "1", points[np.random.default_rng(1).permutation(len(points))], vehicles)
    assert run("--kitti", shuffled, "--caster", CASTER, "--out", tmp_path / "out") == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert f"{shuffled}: 1: its {len(points)} points are not in ring order" in message
    far = replace(vehicles, centre_m=vehicles.centre_m * [3.0, 3.0, 1.0])
    write_kitti(shuffled, "1", points, far)
    assert run("--kitti", shuffled, "--caster", CASTER, "--out", tmp_path / "out") == 2
    assert "none of its 1 sweeps has a whole Car at 10 to 50 m" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@needs_kitti
def test_real_sweeps_give_an_hdl_64e_and_the_shapes_beat_the_box():
    clouds = open_labelled(KITTI)
    few = replace(clouds, frames=clouds.frames[::6])
    ways = tuple(way for way in variants(LEVELS, MEASURED) if way.losses in ("none", "weak"))
    paired = pair_cars(few, ways, CASTER)
    assert paired.sensor["rings"] == [64]
    np.testing.assert_allclose(paired.sensor["height_m"][-32:], 0.204, atol=0.007)
    np.testing.assert_allclose(paired.sensor["height_m"][:32], 0.12, atol=0.015)
    assert paired.sensor["off_cone_median_m"] < 0.001
    assert paired.sensor["elevation_spread_deg"] < 0.003
    errors = zip(ways, paired["error_bits"], strict=True)
    error = {(way.detail, way.losses): np.median(np.abs(one)) for way, one in errors}
    assert error["detailed", "weak"] < 0.08 < error["box", "none"]
    assert error["detailed", "weak"] < error["detailed", "none"]
    assert ways[0].imperfections == PERFECT
