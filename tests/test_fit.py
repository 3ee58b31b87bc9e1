"""Two inputs that do not fit: one change that brings them together is named, and what may be right is never stopped."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.clouds.files import write_cloud
from blender_lidar.clouds.fit import cloud_misfit, detections_misfit, in_frame
from blender_lidar.errors import InputError
from blender_lidar.metrics.assignment import NO_BOX
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.boxes import detected_boxes
from tests.sample_traffic import dense_traffic, scan

KITTI = Path(__file__).parents[2] / "shared" / "data" / "kitti"


def traffic(seed, length_m):
    """Sixteen vehicles, unevenly spaced: mirrored or turned they are in no lane and gap of their own."""
    rng, vehicles = np.random.default_rng(seed), dense_traffic(vehicles=32, length_m=length_m, seed=seed)
    some = vehicles.select(np.sort(rng.permutation(32)[:16]))
    return replace(some, centre_m=some.centre_m + rng.uniform(-1.0, 1.0, (16, 1)) * [1.5, 0.0, 0.0] + [2.0, 1.0, 0.0])


VEHICLES = traffic(1, 80.0)
POSE = Pose(height_m=4.1, tilt_x=0.3)


@pytest.fixture(scope="module")
def cloud():
    """A cloud with ground, of which every vehicle but some has points."""
    return scan(
        VEHICLES, beam_lattice(load_model("RS-80"), stride=4), POSE, caster="exact", min_range_m=0.4, max_range_m=60.0
    )


def owners(cloud, vehicles=VEHICLES):
    at = {number: row for row, number in enumerate(vehicles.vehicle_id.tolist())}
    return np.array([at.get(number, NO_BOX) for number in cloud.vehicle_id.tolist()])


# What has become of the cloud, and what the message says of it. A change is told by what undoes it.
CHANGES = {
    "mirror in x": (lambda p: p * [-1, 1, 1], "a mirror in x (--axes lfu)"),
    "mirror in y": (lambda p: p * [1, -1, 1], "a mirror in y (--axes rbu)"),
    "swapped": (lambda p: p[:, [1, 0, 2]], "swapping x and y (--axes fru)"),
    "turned left": (lambda p: p[:, [1, 0, 2]] * [-1, 1, 1], "a quarter turn to the right (--axes bru)"),
    "turned right": (lambda p: p[:, [1, 0, 2]] * [1, -1, 1], "a quarter turn to the left (--axes flu)"),
    "turned by half": (lambda p: p * [-1, -1, 1], "a half turn (--axes lbu)"),
    "sensor's height": (lambda p: p - [0, 0, 4.1], "adding a height of about 4.1 m"),
    "KITTI's frame": (lambda p: np.column_stack([p[:, 1], -p[:, 0], p[:, 2] - 4.1]), "--axes flu --pose 0 0 4.1 0 0 0"),
    "a camera's frame": (lambda p: np.column_stack([p[:, 0], 4.1 - p[:, 2], p[:, 1]]), "--axes rdf --pose 0 0 4.1"),
    "cm": (lambda p: p * 100, "dividing the coordinates (cm) by 100"),
    "mm": (lambda p: p * 1000, "dividing the coordinates (mm) by 1000"),
    "an origin": (lambda p: p - [553217.25, 5260412.5, 412.0], "an offset of about 553217."),
    "a pole elsewhere": (lambda p: p - [12.3, -4.4, 4.1], "an offset of about 12."),
}


@pytest.mark.parametrize("own", [True, False], ids=["by id", "by box"])
@pytest.mark.parametrize("name", CHANGES)
def test_the_change_that_is_named_is_the_true_one(cloud, name, own):
    change, says = CHANGES[name]
    found = cloud_misfit(change(cloud.xyz), VEHICLES, owners(cloud) if own else None)
    assert found.sure
    assert says in found.text
    assert " or " not in found.text


def test_what_is_named_brings_the_points_into_their_boxes(cloud):
    """The options of the message are all that is needed."""
    for name in ("mirror in y", "KITTI's frame", "a camera's frame"):
        moved, own = CHANGES[name][0](cloud.xyz), owners(cloud)
        words = cloud_misfit(moved, VEHICLES, own).text.partition("(")[2].partition(")")[0].split()
        pose = [float(one) for one in words[3:]] or None
        assert cloud_misfit(in_frame(moved, words[1], pose), VEHICLES, own) is None


@pytest.mark.parametrize("own", [True, False], ids=["by id", "by box"])
def test_boxes_in_cm_are_told(cloud, own):
    boxes = replace(VEHICLES, centre_m=100.0 * VEHICLES.centre_m, size_m=100.0 * VEHICLES.size_m)
    found = cloud_misfit(cloud.xyz, boxes, owners(cloud) if own else None)
    assert found.sure
    assert "dividing the boxes (cm) by 100" in found.text


def test_a_right_pair_is_never_stopped_however_sparse(cloud):
    rng, own = np.random.default_rng(4), owners(cloud)
    for boxes, share in product((1, 2, 3, 6, 16), (1.0, 0.1, 0.02)):
        picked = np.sort(rng.permutation(len(VEHICLES))[:boxes])
        kept, row = rng.random(len(own)) < share, np.full(len(VEHICLES) + 1, NO_BOX)
        row[picked] = np.arange(boxes)
        some = VEHICLES.select(picked)
        for mine in (None, row[own[kept]]):
            found = cloud_misfit(cloud.xyz[kept], some, mine)
            assert found is None or not found.sure


def test_boxes_that_are_out_of_sight_are_noted_and_not_stopped(cloud):
    """Other vehicles, which have no boxes, are in the cloud."""
    rng, own = np.random.default_rng(5), owners(cloud)
    for boxes, side in product((1, 2, 4, 8), (-1.0, 1.0)):
        picked = np.sort(rng.permutation(len(VEHICLES))[:boxes])
        away = VEHICLES.centre_m[picked] + [side * rng.uniform(70.0, 150.0), rng.uniform(-40.0, 40.0), 0.0]
        found = cloud_misfit(cloud.xyz[~np.isin(own, picked)], replace(VEHICLES.select(picked), centre_m=away))
        assert not found.sure
        assert f"no point lies in any of {boxes} box" in found.text
    nothing = cloud_misfit(np.zeros((0, 3)), VEHICLES)
    assert not nothing.sure
    assert cloud_misfit(np.zeros((0, 3)), VEHICLES, np.zeros(0, dtype=int)) is None


def test_one_vehicle_is_stopped_by_its_own_points_and_noted_without_them(cloud):
    own = owners(cloud)
    row = int(np.bincount(own[own >= 0]).argmax())
    one, mine = VEHICLES.select(np.array([row])), np.where(own == row, 0, NO_BOX)
    mirrored = cloud.xyz * [1, -1, 1]
    assert cloud_misfit(mirrored, one, mine).sure
    assert not cloud_misfit(mirrored, one).sure


def test_some_vehicles_whose_points_lie_elsewhere_are_noted(cloud):
    boxes = VEHICLES.centre_m.copy()
    boxes[np.bincount(owners(cloud)[owners(cloud) >= 0]).argmax()] += [0.0, 100.0, 0.0]
    found = cloud_misfit(cloud.xyz, replace(VEHICLES, centre_m=boxes), owners(cloud))
    assert not found.sure
    assert "under a tenth of the points of 1 of" in found.text


def test_real_sweeps_fit_their_boxes_and_mirrored_ones_are_told_or_noted():
    if not KITTI.exists():
        pytest.skip("the KITTI excerpt of ../shared/data is not here")
    with (KITTI / "cars.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    told = 0
    for frame in sorted({row["frame"] for row in rows}):
        of = [row for row in rows if row["frame"] == frame]
        values = np.array([[float(row[key]) for key in ("x_m", "y_m", "z_m")] for row in of])
        sizes = np.array([[float(row[key]) for key in ("length_m", "width_m", "height_m")] for row in of])
        boxes = Boxes(values, sizes, np.array([float(row["yaw_rad"]) for row in of]))
        points = np.fromfile(KITTI / "velodyne" / f"{frame}.bin", "<f4").reshape(-1, 4)[:, :3].astype(float)
        assert cloud_misfit(points, boxes) is None
        mirrored = cloud_misfit(points * [1, -1, 1], boxes)
        assert mirrored is None or not mirrored.sure or "a mirror in y" in mirrored.text
        told += mirrored is not None and mirrored.sure
    assert told > 25  # of 36: others have one car, or cars right ahead


class Boxes(SimpleNamespace):
    """Boxes that are no vehicles of ours."""

    def __init__(self, centre, size, heading):
        super().__init__(centre_m=centre, size_m=size, heading_rad=heading)

    def __len__(self):
        return len(self.centre_m)


# --- Detections -------------------------------------------------------------------------------------------------------

FRAMES = [traffic(seed, 160.0) for seed in range(8)]


def detections(recall=0.7, false_alarms=1, seed=0, centre=lambda c: c, heading=lambda h: h, size=lambda s: s):
    """What a detector finds in `FRAMES`, with its errors, and half of its boxes the wrong way round."""
    rng = np.random.default_rng(seed)

    def of(vehicles):
        seen = vehicles.select(rng.random(len(vehicles)) < recall)
        xyz = np.concatenate(
            [
                seen.centre_m + rng.normal(0.0, 0.25, (len(seen), 3)),
                rng.uniform([-60.0, 0.0, 0.8], [60.0, 40.0, 0.8], (false_alarms, 3)),
            ]
        )
        turn = np.concatenate([seen.heading_rad, rng.uniform(-3.0, 3.0, false_alarms)])
        turn += rng.choice([0.0, np.pi], len(turn)) + rng.normal(0.0, 0.03, len(turn))
        sizes = np.concatenate([seen.size_m, np.full((false_alarms, 3), (4.5, 1.8, 1.5))])
        none = np.zeros(len(turn))
        return detected_boxes(centre(xyz), size(sizes), heading(turn), none.astype(np.int8), none + 0.5)

    return [of(vehicles) for vehicles in FRAMES]


@pytest.mark.parametrize("name", [name for name in CHANGES if name != "sensor's height"])
def test_detections_in_another_frame_are_told_with_the_change(name):
    change, says = CHANGES[name]
    found = detections_misfit(detections(centre=change), FRAMES)
    assert found.sure
    in_words = {"KITTI's frame": "a quarter turn to the left", "a camera's frame": "another sensor, rdf"}
    assert in_words.get(name, says.partition(" (--")[0]) in found.text
    assert "--" not in found.text


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"heading": lambda h: h + 0.5 * np.pi}, "the headings are off by 90 degrees"),
        ({"size": lambda s: s[:, [1, 0, 2]]}, "length and width are swapped"),
    ],
)
def test_detections_that_lie_across_are_told(given, says):
    found = detections_misfit(detections(**given), FRAMES)
    assert found.sure
    assert says in found.text


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"heading": lambda h: h + np.pi},
        {"centre": lambda c: c - [0.0, 0.0, 4.1]},  # nothing that is judged depends on heights
        {"heading": lambda h: h + 0.5 * np.pi, "size": lambda s: s[:, [1, 0, 2]]},  # another way to say the same
        {"recall": 0.1, "false_alarms": 3},
    ],
)
def test_detections_that_fit_however_poor_are_let_through(given):
    assert detections_misfit(detections(**given), FRAMES) is None


def test_false_alarms_alone_are_at_most_noted():
    for seed in range(5):
        found = detections_misfit(detections(recall=0.0, false_alarms=6, seed=seed), FRAMES)
        assert found is None or not found.sure
    assert detections_misfit(detections(recall=0.0, false_alarms=0), FRAMES) is None


# --- As users meet it -------------------------------------------------------------------------------------------------


@pytest.fixture
def pair(tmp_path, cloud):
    """A cloud of `scan` as KITTI's .bin, which is in the sensor's frame, and a table of its boxes in the road's."""
    rows = ["frame,vehicle_id,class,x_m,y_m,z_m,length_m,width_m,height_m,heading_deg"]
    for row in range(len(VEHICLES)):
        numbers = [*VEHICLES.centre_m[row], *VEHICLES.size_m[row], np.degrees(VEHICLES.heading_rad[row])]
        of = f"0,{VEHICLES.vehicle_id[row]},{VEHICLES.class_name[row]}"
        rows.append(",".join([of, *map(repr, map(float, numbers))]))
    (tmp_path / "boxes.csv").write_text("\n".join(rows) + "\n")
    write_cloud(tmp_path / "cloud.bin", cloud, {"pose": POSE.as_table()})
    write_cloud(tmp_path / "cloud.npz", cloud, {"pose": POSE.as_table()})
    return tmp_path


def scored(pair, capsys, *words, points="cloud.bin"):
    code = main(["score", "--points", str(pair / points), "--boxes", str(pair / "boxes.csv"), *words])
    out, err = capsys.readouterr()
    return code, out, err


def test_score_stops_names_the_options_that_mend_it_and_gives_the_same_with_them(pair, capsys):
    right = json.loads(scored(pair, capsys, "--json", points="cloud.npz")[1])
    code, out, err = scored(pair, capsys)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert "--axes flu --pose 0 0 4.1 0 0 0" in err
    assert err.endswith("go on with --accept frames\n")
    placed = json.loads(scored(pair, capsys, "--json", "--axes", "flu", "--pose", "0", "0", "4.1", "0", "0", "0")[1])
    assert "warnings" not in placed
    assert "warnings" not in right
    assert placed["entropy_bits_per_vehicle"] == pytest.approx(right["entropy_bits_per_vehicle"], abs=2e-3)


def test_score_goes_on_where_frames_are_accepted_and_says_so(pair, capsys):
    code, out, _ = scored(pair, capsys, "--accept", "frames")
    assert code == 0
    assert out.startswith("Warning, accepted (frames): ")
    assert out.rstrip().endswith("mean PE-VGOP 0.0000 bits")
    (warning,) = json.loads(scored(pair, capsys, "--accept", "frames", "--json")[1])["warnings"]
    assert warning["name"] == "frames"
    assert "a quarter turn to the left" in warning["text"]


@pytest.mark.parametrize("axes", ["", "fl", "flx", "ffu", "fbu", "fluu", "FLU"])
def test_axes_that_are_none_are_refused(axes):
    with pytest.raises(InputError, match=r"--axes: is .*allowed: three letters"):
        in_frame(np.zeros((1, 3)), axes, None)


def test_a_cloud_in_the_frame_of_a_tilted_sensor_is_placed_by_its_pose(cloud):
    placed = in_frame(POSE.to_sensor(cloud.xyz), "rfu", (0.0, 0.0, 4.1, np.degrees(0.3), 0.0, 0.0))
    np.testing.assert_allclose(placed, cloud.xyz, atol=1e-9)


@pytest.mark.parametrize("kind", ["<f4", "<f8"])
def test_coordinates_that_float32_has_rounded_are_refused_even_as_float64(pair, cloud, capsys, kind):
    far = (cloud.xyz + np.array([553217.25, 5260412.5, 0.0])).astype("<f4").astype(kind)
    np.savez(pair / "far.npz", xyz=far, vehicle_id=cloud.vehicle_id)
    code, _, err = scored(pair, capsys, points="far.npz")
    assert code == 2
    assert "in float32, whose steps there are 0.0625" in err
    assert "subtract an origin" in err
    assert scored(pair, capsys, "--cell", "4", "--accept", "frames", points="far.npz")[0] == 0


def test_coordinates_of_utm_in_float64_score_as_those_near_the_origin(pair, cloud, capsys):
    shift = np.array([553217.25, 5260412.5, 0.0])
    rows = [line.split(",") for line in (pair / "boxes.csv").read_text().splitlines()]
    for row in rows[1:]:
        row[3:5] = (repr(float(row[at]) + float(shift[at - 3])) for at in (3, 4))
    near = json.loads(scored(pair, capsys, "--json", points="cloud.npz")[1])
    (pair / "boxes.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    np.savez(pair / "far.npz", xyz=cloud.xyz + shift, vehicle_id=cloud.vehicle_id)
    far = json.loads(scored(pair, capsys, "--json", points="far.npz")[1])
    assert far["entropy_bits_per_vehicle"] == pytest.approx(near["entropy_bits_per_vehicle"], abs=2e-3)
