"""The detector without training, and the verb that judges detectors."""

from __future__ import annotations

import importlib.util
import json
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.clouds.files import read_cloud
from blender_lidar.detection.classical import ClassicalDetector
from blender_lidar.detection.l_shape import LShape, l_shape_heading
from blender_lidar.detection.scores import MEASURES
from blender_lidar.detection.stored import StoredClouds
from blender_lidar.errors import InputError
from blender_lidar.report import cloud_figures
from blender_lidar.scoring.workers import Workers
from tests.refusals import refused
from tests.report_samples import Page
from tests.small_scene import HEADER, REGION, cli, done, traffic_rows, without_charts, write_scene, write_table

pytestmark = pytest.mark.versions

MOUNT = ("--height", 4.5, "--tilt-x", 15)
CLASSICAL = ("--detector", "classical")


def needs_scikit_learn():
    pytest.importorskip("sklearn", reason="scikit-learn, of the extra detect, is not installed")


@pytest.fixture
def scene(tmp_path):
    needs_scikit_learn()
    return write_scene(tmp_path, REGION)


@pytest.fixture
def all_start(monkeypatch):
    """Pools wait until all their processes have started, so that each has a part in the work; their sizes."""
    counts, start = [], Workers.__init__

    def ready(self, function, processes=1):
        start(self, function, processes)
        self.await_ready()
        counts.append(self.count)

    monkeypatch.setattr(Workers, "__init__", ready)
    monkeypatch.setattr("blender_lidar.detection.judge.CLOUDS_A_PROCESS", 1)
    without_charts(monkeypatch)
    return counts


@pytest.mark.parametrize("heading_deg", [-40.0, -7.0, 0.0, 13.0, 44.0])
def test_an_l_shape_has_the_heading_of_its_sides(heading_deg):
    rng = np.random.default_rng(2)
    along, across = rng.uniform(0, 4.5, 60), rng.uniform(0, 1.8, 25)
    corner = np.concatenate([np.column_stack([along, 0 * along]), np.column_stack([0 * across, across])])
    angle = np.radians(heading_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    noisy = corner @ turn + rng.normal(0, 0.01, corner.shape)
    assert np.degrees(l_shape_heading(noisy)) == pytest.approx(heading_deg, abs=0.5)


def test_a_box_lies_away_from_the_lidars_that_see_it():
    """Of a car at (20, 5) its rear and its right side are seen, a metre of the one and two of the other."""
    xy = np.array([[20.0, 5.0], [22.0, 5.0], [20.0, 6.0]])
    shape, size = LShape.about(xy, 0.0), (4.5, 1.8)
    near, abreast, beyond = (np.array([place]) for place in ((0.0, 0.0), (21.0, 0.0), (40.0, 30.0)))
    np.testing.assert_allclose(shape.seen, [2.0, 1.0])
    np.testing.assert_allclose(shape.centre(size, near), [22.25, 5.9])
    np.testing.assert_allclose(shape.centre(size, abreast), [21.0, 5.9])
    np.testing.assert_allclose(shape.centre(size, beyond), [19.75, 5.1])
    np.testing.assert_allclose(shape.centre(size, np.concatenate([near, beyond])), [21.0, 5.5])
    angle = np.radians(30.0)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    turned = LShape.about(xy @ turn, angle)
    np.testing.assert_allclose(turned.centre(size, near), np.array([22.25, 5.9]) @ turn)


def test_what_it_finds_is_there_and_most_is_found(scene, tmp_path, capsys):
    out, _ = done(capsys, "detect", scene, *MOUNT, *CLASSICAL, "--out", tmp_path / "found")
    result = json.loads((tmp_path / "found" / "detection.json").read_text())
    given = result["mountings"]["given"]
    assert result["held_out"]
    assert given["recall_0.1"] > 0.9
    assert given["precision_0.3"] > 0.7
    assert given["ap_centre_2m"] > 0.85
    assert given["recall_0.1"] <= given["with_return"]
    assert set(given["over_baseline"]) == set(MEASURES)
    text = " ".join(out.split())
    assert " of the vehicles instead of " in text
    over = given["over_baseline"]["recall_0.3"]
    assert ("; not shown" in text) == (over["interval_90"][0] <= 0.0 <= over["interval_90"][1])
    for one in result["mountings"].values():
        low, high = one["interval_90"]["recall_0.3"]
        assert 0.0 <= low <= one["recall_0.3"] <= high <= 1.0
    assert (tmp_path / "found" / "detections.png").exists() == (find_spec("matplotlib") is not None)
    again, _ = done(capsys, "detect", scene, *MOUNT, *CLASSICAL, "--out", tmp_path / "again", "--json")
    assert json.loads(again) == result


@pytest.mark.parametrize(("of", "detector"), [("scene", "pillars"), ("clouds", "classical"), ("set", "pillars")])
def test_workers_change_nothing(of, detector, scene, tmp_path, capsys, all_start):
    if of == "clouds":
        done(capsys, "scan", scene, "--frame-ids", "5:40:5", *MOUNT, "--out", tmp_path / of)
    if of == "set":
        done(capsys, "dataset", scene, "--mountings", 2, "--scans", 20, "--out", tmp_path / of)
    files = []
    for workers in (1, 2):
        out, asked = tmp_path / f"found_{workers}", scene if of == "scene" else tmp_path / of
        done(capsys, "detect", asked, "--detector", detector, "--workers", workers, "--out", out)
        files.append({path.name: path.read_bytes() for path in out.rglob("*.*")})
    assert files[0]["detections.csv"].count(b"\n") > 9
    assert all_start[-1] == 2
    if detector == "classical":
        assert files[0] == files[1]
        return
    # A product of float32 matrices has other last bits with another number of the BLAS's threads.
    rows = [np.genfromtxt(found["detections.csv"].splitlines(), delimiter=",", skip_header=1) for found in files]
    np.testing.assert_allclose(rows[0], rows[1], atol=2e-3)
    assert files[0].keys() == files[1].keys()


@pytest.mark.usefixtures("quick")
def test_what_is_accepted_of_the_traffic_is_told_first(scene, tmp_path, capsys):
    rows = traffic_rows()
    for row in rows:
        row[HEADER.index("heading_deg")] = 180.0
    write_table(tmp_path / "traffic.csv", rows)
    refused(capsys, tmp_path, "detect", scene, "--out", tmp_path / "found")
    out, _ = done(capsys, "detect", scene, "--accept", "headings", "--out", tmp_path / "found")
    assert out.startswith("Warning, accepted (headings): ")
    assert "Few different vehicles: " in out
    assert json.loads((tmp_path / "found" / "detection.json").read_text())["warnings"][0]["name"] == "headings"


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("name", ["detections.csv", "label_2"])
def test_detections_of_ones_own_are_judged_as_the_same_boxes_are(name, scene, tmp_path, capsys):
    done(capsys, "detect", scene, *MOUNT, *CLASSICAL, "--out", tmp_path / "found")
    words = "--detector", tmp_path / "found" / name, "--out", tmp_path / "own", "--json"
    own = json.loads(done(capsys, "detect", scene, *MOUNT, *words)[0])["mountings"]
    given = json.loads((tmp_path / "found" / "detection.json").read_text())["mountings"]["given"]
    assert set(own) == {"given"}
    assert own["given"]["with_return"] is None
    for measure in MEASURES:
        assert own["given"][measure] == pytest.approx(given[measure], abs=0.02)


@pytest.mark.usefixtures("quick")
def test_detections_in_another_frame_stop_unless_that_is_accepted(scene, tmp_path, capsys):
    done(capsys, "detect", scene, *MOUNT, *CLASSICAL, "--out", tmp_path / "found")
    header, *rows = (tmp_path / "found" / "detections.csv").read_text().splitlines()
    mirrored = [[*row[:3], f"-{row[3]}", *row[4:]] for row in (line.split(",") for line in rows)]
    (tmp_path / "own.csv").write_text("\n".join([header, *map(",".join, mirrored)]) + "\n")
    words = "--detector", tmp_path / "own.csv", "--out", tmp_path / "own"
    line = refused(capsys, tmp_path, "detect", scene, *MOUNT, *words)
    assert "would after a mirror in y; if it is right as it is, go on with --accept frames" in line
    out, _ = done(capsys, "detect", scene, *MOUNT, *words, "--accept", "frames")
    assert out.startswith("Warning, accepted (frames): ")
    (warning,) = json.loads((tmp_path / "own" / "detection.json").read_text())["warnings"]
    assert warning["name"] == "frames"


def test_clouds_of_a_recording_give_the_boxes_that_those_of_a_scan_do(tmp_path, capsys):
    """KITTI's .bin has neither header nor pose, and is in the sensor's frame."""
    scene, frames = write_scene(tmp_path, REGION), ("--frame-ids", "10:20:10", *MOUNT)
    for name in ("npz", "bin"):
        done(capsys, "scan", scene, *frames, "--format", name, "--out", tmp_path / name)
    done(capsys, "detect", tmp_path / "npz", "--out", tmp_path / "of_npz")
    placed = "--axes", "flu", "--pose", 0, 0, 4.5, 0, 0, 0
    out, _ = done(capsys, "detect", tmp_path / "bin", *placed, "--out", tmp_path / "of_bin")
    assert "not on a sensor without a name" in out
    given, found = (
        np.genfromtxt(tmp_path / name / "detections.csv", delimiter=",", skip_header=1, usecols=(0, 2, 3, 9))
        for name in ("of_npz", "of_bin")
    )
    sure = [one[one[:, 3] > 0.3] for one in (given, found)]
    assert len(sure[0]) == len(sure[1]) > 1
    np.testing.assert_allclose(sure[0], sure[1], atol=0.3)
    empty = tmp_path / "bin"
    assert "a recording needs --pose" in refused(capsys, tmp_path, "detect", empty, "--out", tmp_path / "x")
    assert "--axes: is given without --pose" in refused(capsys, tmp_path, "detect", empty, "--axes", "flu")
    assert "folders of recorded clouds" in refused(capsys, tmp_path, "detect", scene, *placed)
    if importlib.util.find_spec("sklearn"):
        assert "classical needs rings" in refused(capsys, tmp_path, "detect", empty, *placed, *CLASSICAL)
    (tmp_path / "named").mkdir()
    (tmp_path / "named" / "cloud.csv").write_text("1,2,3\n")
    assert "does not end with the number" in refused(capsys, tmp_path, "detect", tmp_path / "named", *placed)


@pytest.mark.usefixtures("quick")
def test_a_lidar_that_hangs_off_its_plan_costs_overlap(scene, tmp_path, capsys):
    """The classical detector looks at ranges, so that it finds as much, but at places that are off."""
    scores = []
    for number, words in enumerate(((), ("--pose-error", "tilt_deg=5,yaw_deg=5,height_m=0.3"))):
        words = *words, "--out", tmp_path / str(number), "--json"
        result = json.loads(done(capsys, "detect", scene, *MOUNT, *CLASSICAL, *words)[0])
        scores.append(result["mountings"]["given"])
        assert (result["hangs"] == result["deployment"]) == (number == 0)
    assert scores[1]["with_return"] > 0.9
    assert scores[1]["ap_iou_0.7"] < scores[0]["ap_iou_0.7"] - 0.05


def test_the_baseline_alone_is_judged_alone_and_without_matplotlib_there_is_no_picture(
    scene, tmp_path, capsys, monkeypatch
):
    without_charts(monkeypatch)
    out, err = done(capsys, "detect", scene, "--tilt-x", 0, "--out", tmp_path / "found")
    assert "under the baseline" not in out
    assert "note: no picture: charts need matplotlib" in err
    assert sorted(path.name for path in (tmp_path / "found").iterdir()) == [
        "detection.json",
        "detections.csv",
        "label_2",
    ]


def test_clouds_of_a_scan_give_boxes(scene, tmp_path, capsys):
    done(capsys, "scan", scene, "--frame-ids", "5:40:5", *MOUNT, "--out", tmp_path / "clouds")
    out, _ = done(capsys, "detect", tmp_path / "clouds", *CLASSICAL, "--out", tmp_path / "found")
    rows = (tmp_path / "found" / "detections.csv").read_text().splitlines()
    assert f"{len(rows) - 1} boxes in 8 clouds" in out
    assert len(rows) > 9


@pytest.mark.parametrize(
    "sensor",
    [
        {"name": "OS1-32", "columns": 2048, "rotation_hz": 10.0},
        {"name": "OS1-32", "columns": 512, "rotation_hz": 20.0},
        {"rotation_hz": 5.0},
        {"unit_spread_deg": 0.2, "unit": 3, "range_noise_m": 0.02},
    ],
    ids=["more columns", "fewer columns", "another rate", "another unit"],
)
def test_each_point_of_a_stored_cloud_is_on_its_own_beam(sensor, tmp_path, capsys):
    needs_scikit_learn()
    scene = write_scene(tmp_path, REGION | {"sensor": sensor})
    done(capsys, "scan", scene, "--frame", 5, *MOUNT, "--out", tmp_path / "cloud.npz")
    clouds = StoredClouds.of(tmp_path / "cloud.npz")
    cloud = clouds(tmp_path / "cloud.npz")
    beam = ClassicalDetector(clouds.lattice, (0.0, 0.0)).beam(cloud)
    assert len(np.unique(beam)) == len(cloud) > 2000
    ring, slot = np.divmod(beam, clouds.lattice.columns)
    np.testing.assert_array_equal(ring, cloud.ring)
    np.testing.assert_allclose(clouds.lattice.azimuth_rad(ring, slot), cloud.azimuth_rad, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda header: header.pop("range_m"), "cloud.npz: its header range_m: is missing"),
        (lambda header: header.update(sensor="mine"), "its sensor 'mine' is of a table of its own"),
    ],
)
def test_a_header_that_lacks_something_is_refused_in_a_line(change, message, tmp_path, capsys):
    scene = write_scene(tmp_path, REGION)
    path = tmp_path / "clouds" / "cloud.npz"
    path.parent.mkdir()
    done(capsys, "scan", scene, "--frame", 5, *MOUNT, "--out", path)
    with np.load(path) as stored:
        content = {name: stored[name] for name in stored.files}
    header = json.loads(str(content["header"]))
    change(header)
    np.savez(path, **content | {"header": json.dumps(header)})
    assert message in refused(capsys, tmp_path, "detect", path.parent, "--out", tmp_path / "found")


def test_a_cloud_is_read_as_it_was_written(scene, tmp_path, capsys):
    done(capsys, "scan", scene, "--frame", 5, *MOUNT, "--out", tmp_path / "cloud.npz")
    cloud, header = read_cloud(tmp_path / "cloud.npz")
    with np.load(tmp_path / "cloud.npz") as stored:
        np.testing.assert_array_equal(cloud.xyz, stored["xyz"])
        np.testing.assert_allclose(np.degrees(cloud.azimuth_rad), stored["azimuth_deg"])
    assert header["frame"] == 5


DAMAGE = {
    "cut off": lambda content: None,
    "shorter ranges": lambda content: content | {"range_m": content["range_m"][1:]},
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_cloud_that_is_none_is_refused_in_a_line(damage, scene, tmp_path, capsys):
    path = tmp_path / "cloud.npz"
    done(capsys, "scan", scene, "--frame", 5, *MOUNT, "--out", path)
    with np.load(path) as stored:
        content = DAMAGE[damage]({name: stored[name] for name in stored.files})
    if content is None:
        path.write_bytes(path.read_bytes()[:500])
    else:
        np.savez(path, **content)
    with pytest.raises(InputError, match=r"cloud.npz: is not an NPZ cloud of scan: .+"):
        read_cloud(path)


def test_lost_returns_and_noise_leave_the_background_where_it_is(scene, tmp_path, capsys):
    """One lost return in any frame made the road a vehicle."""
    settings = {"range_noise_m": 0.05, "dropout": 0.05}
    scene = write_scene(tmp_path, REGION | {"sensor": settings})
    result = json.loads(done(capsys, "detect", scene, *MOUNT, *CLASSICAL, "--out", tmp_path / "found", "--json")[0])
    given = result["mountings"]["given"]
    assert given["precision_0.3"] > 0.7
    assert given["recall_0.3"] > 0.85


@pytest.mark.usefixtures("quick")
def test_results_take_the_place_of_earlier_ones(scene, tmp_path, capsys):
    done(capsys, "detect", scene, *MOUNT, *CLASSICAL, "--out", tmp_path / "found")
    (tmp_path / "found" / "label_2" / "999999.txt").touch()
    done(capsys, "detect", scene, "--tilt-x", 0, *CLASSICAL, "--out", tmp_path / "found")
    assert not (tmp_path / "found" / "detections_baseline.csv").exists()
    assert not (tmp_path / "found" / "label_2" / "999999.txt").exists()
    assert not list((tmp_path / "found" / "label_2_baseline").iterdir())


def test_wrong_words_are_refused(scene, tmp_path, capsys):
    out = "--out", tmp_path / "found"
    (tmp_path / "empty").mkdir()
    assert "has 0 .npz clouds" in refused(capsys, tmp_path, "detect", tmp_path / "empty", *out)
    (tmp_path / "own.csv").write_text(
        "frame,class,x_m,y_m,z_m,length_m,width_m,height_m,heading_deg,confidence\n999,car,0,5,0.7,4,2,1,0,0.5\n"
    )
    line = refused(capsys, tmp_path, "detect", scene, "--detector", tmp_path / "own.csv", *out)
    assert "lacks 8 of the 8 judging frames" in line
    (tmp_path / "label_2").mkdir()
    (tmp_path / "label_2" / "000999.txt").touch()
    line = refused(capsys, tmp_path, "detect", scene, "--detector", tmp_path / "label_2", *out)
    assert "lacks 8 of the 8 judging frames" in line
    words = "--height", 9, *out
    assert "--height: is an option for scenes" in refused(capsys, tmp_path, "detect", tmp_path / "empty", *words)
    (tmp_path / "file").touch()
    line = refused(capsys, tmp_path, "detect", scene, "--out", tmp_path / "file")
    assert "file" in line
    assert "no such file" in refused(capsys, tmp_path, "detect", scene, "--detector", "pillar", *out)


def test_the_picture_shows_what_was_matched_in_the_median_frame_and_is_on_the_page(
    scene, tmp_path, capsys, monkeypatch
):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    monkeypatch.setattr("blender_lidar.report.run_figures.draw_charts", lambda site, run: [])
    shown, plot = [], cloud_figures.plot_detections
    monkeypatch.setattr(
        cloud_figures,
        "plot_detections",
        lambda path, *given, **leaning: (shown.extend(given), plot(path, *given, **leaning)),
    )
    out, _ = done(capsys, "evaluate", scene, *MOUNT, "--detector", "classical", "--out", tmp_path / "run")
    result = json.loads((tmp_path / "run" / "detection.json").read_text())
    share = f"finds {100 * result['mountings']['given']['recall_0.3']:.0f}"
    assert share in " ".join(out.split())
    frame, (baseline, given), title, subtitle = shown
    assert title == f"RS-16: what the detector classical finds in frame {frame.frame}"
    assert subtitle.endswith("held-out frames; confidence 0.3 or more, hits within 2 m")
    assert (baseline.name, given.name, given.layout[0].height_m) == ("Baseline", "Given", 4.5)
    rows = np.genfromtxt(tmp_path / "run" / "vehicles.csv", delimiter=",", names=True, dtype=None, encoding=None)
    counts = np.sort(np.unique(rows["frame"][rows["split"] == "holdout"], return_counts=True)[1])
    assert frame.counted.sum() == counts[len(counts) // 2]
    of_frame = frame.centre_m[given.vehicle[given.vehicle >= 0], :2]
    away = np.linalg.norm(given.boxes.centre_m[given.vehicle >= 0, :2] - of_frame, axis=1)
    assert len(away) > 0
    assert (away <= 2.0).all()
    text = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert share in text
    page = Page(text)
    assert [image["alt"].split(": ")[1] for tag, image in page.elements if tag == "img"] == [
        "Detections in one frame from above, over vehicles and points"
    ]


@pytest.mark.parametrize("verb", ["detect", "evaluate", "optimise"])
def test_without_scikit_learn_the_extra_is_named(verb, scene, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.cluster", None)
    code, _, err = cli(capsys, verb, scene, "--detector", "classical", "--out", tmp_path / "found")
    assert code == 2
    assert 'pip install "blender_lidar[detect]"' in err
    assert not Path(tmp_path / "found").exists()
