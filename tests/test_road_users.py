"""Pedestrians and cyclists: left out, hiding or scored as [objective] classes says, through every verb."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.errors import InputError
from blender_lidar.road.driven import driven_area
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.words import definitions
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recordings
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.studies.variations import ablations, traffic_variations
from blender_lidar.traffic import read_table, read_traffic
from blender_lidar.traffic.fleet import queued
from blender_lidar.traffic.movements import ways_by_track
from blender_lidar.traffic.vehicles import CLASSES, PEDESTRIAN
from tests.sample_traffic import joined, one_vehicle
from tests.small_scene import cli, done, traffic_rows, write_scene, write_table

EVERY = list(CLASSES)
ROAD = map_of(RoadSettings(lanes=2, lane_width_m=3.5, setback_m=2.0))
SIZES = {"bicycle": (1.76, 0.6, 1.73), "pedestrian": (0.6, 0.6, 1.73)}


def slow_rows(frames=60):
    """Pedestrians who cross the road and cyclists along its right edge, a new one of each every 20 s."""
    rows = []
    for frame in range(frames):
        for number in range(12):
            walked, cycled = (2.0 * frame - 10.0 * number, 2.0 * frame - 10.0 * number)
            if 0.0 <= walked < 9.0:
                y = round(1.0 + 1.0 * walked, 3)
                rows.append([frame, 1000 + number, "pedestrian", 6.0, y, *SIZES["pedestrian"], 90.0, 2.0 * frame])
            if 0.0 <= cycled < 9.0:
                x = round(-15.0 + 4.0 * cycled, 3)
                rows.append([frame, 2000 + number, "bicycle", x, 2.4, *SIZES["bicycle"], 0.0, 2.0 * frame])
    return rows


def scene(folder, users=True, **changes):
    """A scene with them, or without pedestrians alone."""
    rows = [row for row in slow_rows() if users or row[2] != "pedestrian"]
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "traffic.csv", [*traffic_rows(), *rows])
    return write_scene(folder, {"traffic": {"accept": ["overlaps"]}, **changes})


def totals(site, mount=None):
    """Objective of two mountings, frame by frame."""
    mount = mount or [(replace(site.scenario.lidar.baseline, height_m=height),) for height in (2.0, 4.0)]
    with site_evaluator(site, site.search) as evaluator:
        return evaluator.totals(mount)


def counted(site):
    """Classes of all that count in the searched frames."""
    return set(np.concatenate([frame.class_name[frame.counted] for frame in site.search]).tolist())


def test_pedestrians_are_left_out_unless_they_are_named_and_nothing_else_changes(tmp_path):
    site = prepare(load_scenario(scene(tmp_path / "with")))
    without = prepare(load_scenario(scene(tmp_path / "without", users=False)))
    assert counted(site) == counted(without) == {"car", "van", "truck", "bicycle"}
    assert totals(site).objective.tobytes() == totals(without).objective.tobytes()
    (assumed,) = [text for text in site.recording.report.assumed if "edestrian" in text]
    assert assumed == "Pedestrians: 12 left out; [objective] classes that name pedestrian score them"
    assert site.recording.report.left_out == sum(row[2] == "pedestrian" for row in slow_rows())


@pytest.mark.parametrize("classes", [["pedestrian"], ["bicycle", "pedestrian"], ["car", "pedestrian"], EVERY])
def test_the_classes_that_are_named_are_scored_and_the_others_hide_them(tmp_path, classes):
    frames = {"traffic": {"accept": ["overlaps"], "frame_ids": [10, 15, 20, 25, 30], "frames": None, "holdout": 0.0}}
    every, some = (
        prepare(load_scenario(scene(tmp_path, objective={"classes": asked}, **frames))) for asked in (EVERY, classes)
    )
    assert counted(some) == set(classes) & counted(every)
    mount = (replace(every.scenario.lidar.baseline, height_m=3.0),)
    with site_evaluator(every, every.search) as evaluator:
        scored = evaluator.by_vehicle([mount])
    asked = [np.isin(frame.class_name[frame.counted], classes) for frame in every.search]
    expected = [one.objective[0][which].sum() for one, which in zip(scored, asked, strict=True)]
    assert np.any(expected)
    np.testing.assert_allclose(totals(some, [mount]).objective[0], expected, atol=1e-12)


def test_pedestrians_may_only_hide_and_chart_and_stability_then_have_a_row(tmp_path):
    hiding = prepare(load_scenario(scene(tmp_path / "hiding", world={"pedestrians": True})))
    assert counted(hiding) == {"car", "van", "truck", "bicycle"}
    assert any((frame.class_index == PEDESTRIAN).any() for frame in hiding.search)
    without = prepare(load_scenario(scene(tmp_path / "without", objective={}, users=False)))
    (row,) = [one for one in ablations(hiding, 1) if one.what == "pedestrians"]
    ((left_out, own),) = row.pairs
    bare = left_out.changed(hiding)
    assert not any((frame.class_index == PEDESTRIAN).any() for frame in (*bare.search, *bare.holdout))
    assert own.changed(hiding).search == hiding.search
    assert [one.what for one in traffic_variations(hiding, 1)].count("pedestrians") == 1
    assert not any(one.what == "pedestrians" for one in (*ablations(without, 1), *traffic_variations(without, 1)))
    scored = prepare(load_scenario(scene(tmp_path / "scored", objective={"classes": EVERY})))
    assert not any(one.what == "pedestrians" for one in (*ablations(scored, 1), *traffic_variations(scored, 1)))


@pytest.mark.parametrize("caster", ["raster", "embree", "bvh"])
@pytest.mark.parametrize("detail", ["box", "body", "detailed"])
def test_casters_agree_on_them_to_the_last_digit(tmp_path, caster, detail):
    if not is_available(caster):
        pytest.skip(f"caster {caster} is not installed")
    found = []
    for name in ("exact", caster):
        changes = {"objective": {"classes": ["bicycle", "pedestrian"]}, "world": {"detail": detail}}
        path = scene(tmp_path / name, **changes, model={"caster": name}, traffic={"accept": ["overlaps"], "frames": 3})
        found.append(totals(prepare(load_scenario(path))).objective)
    assert (found[0] != 0.0).any()
    np.testing.assert_array_equal(found[0], found[1])


def test_classes_of_which_there_are_none_are_refused_in_one_line(tmp_path, capsys):
    path = scene(tmp_path, objective={"classes": ["bus", "motorcycle"]})
    code, _, err = cli(capsys, "evaluate", path, "--height", 3, "--out", tmp_path / "run")
    assert code == 2
    assert err.count("\n") == 1
    assert "[objective] classes: bus, motorcycle: " in err
    assert "has none; its classes are car, van, truck, bicycle" in err
    code, _, err = cli(capsys, "evaluate", scene(tmp_path, objective={"classes": ["cyclist"]}), "--height", 3)
    assert (code, err.count("\n")) == (2, 1)
    assert "unknown classes 'cyclist'; did you mean 'bicycle'? allowed: car, van, truck, bus, motorcycle" in err


def test_a_pedestrian_gives_way_to_a_mast_where_a_vehicle_is_refused(tmp_path):
    def standing(kind):
        folder = tmp_path / kind
        folder.mkdir()
        rows = [[frame, 77, kind, 0.0, 0.0, 0.8, 0.6, 1.7, 0.0, 2.0 * frame] for frame in range(60)]
        write_table(folder / "traffic.csv", [*traffic_rows(), *rows])
        accept = {"traffic": {"accept": ["overlaps", "carriageway", "sizes", "tracks"]}}
        return load_scenario(write_scene(folder, {**accept, "objective": {"classes": EVERY}}))

    assert counted(prepare(standing("pedestrian"))) > {"pedestrian"}
    with pytest.raises(InputError, match="vehicle 77"):
        prepare(standing("bicycle"))


def test_a_run_says_who_is_scored_and_its_tables_have_their_classes(tmp_path, capsys, quick):
    path = scene(tmp_path, objective={"classes": EVERY, "class_weights": {"pedestrian": 2.0}})
    done(capsys, "evaluate", path, "--height", 3, "--out", tmp_path / "run")
    run = RunFolder(tmp_path / "run")
    assert {"pedestrian", "bicycle"} < set(run.optimised["class"].tolist())
    said = definitions(run.result)["Objective"]
    assert "those of car, van, truck, bus, motorcycle, bicycle, pedestrian" in said
    assert "pedestrian 2" in said
    again = read_table(str(tmp_path / "run" / "vehicles.csv"))
    assert {"pedestrian", "bicycle"} < {CLASSES[index] for index in again.class_index}


def test_a_detector_is_not_asked_for_pedestrians_and_a_data_set_labels_them(tmp_path, capsys):
    path = scene(tmp_path, objective={"classes": EVERY})
    code, _, err = cli(capsys, "detect", path, "--height", 3, "--out", tmp_path / "found")
    assert (code, err.count("\n")) == (2, 1)
    assert "pedestrian: the detectors find vehicles alone; allowed with a detector: car, van" in err
    layouts = ("--layout", "npz", "--layout", "kitti", "--layout", "nuscenes")
    words = ("--mountings", 2, "--scans", 6, *layouts, "--out", tmp_path / "set")
    done(capsys, "dataset", path, *words)
    labels = "".join(one.read_text() for one in (tmp_path / "set/kitti/training/label_2").glob("*.txt"))
    assert {"Pedestrian", "Cyclist", "Car"} <= {line.split()[0] for line in labels.splitlines()}
    (categories,) = (tmp_path / "set/nuscenes").rglob("category.json")
    assert "human.pedestrian.adult" in {one["name"] for one in json.loads(categories.read_text())}
    for file in sorted((tmp_path / "set/npz").glob("*.npz")):
        boxes = np.load(file)
        walking = boxes["box_class"] == "pedestrian"
        assert not boxes["box_counted"][walking].any()


def test_who_walks_has_no_movement_and_makes_no_driven_area(tmp_path):
    (recording,) = read_recordings(load_scenario(scene(tmp_path, objective={"classes": EVERY})))
    ways = ways_by_track(recording, (0.0, 0.0))
    walking = set(recording.vehicle_id[recording.class_index == PEDESTRIAN].tolist())
    assert walking
    assert not walking & set(ways)
    assert {movement for _, _, movement in ways.values()} > {"straight"}
    path = tmp_path / "driven.toml"
    path.write_text(
        '[traffic]\npath = "traffic.csv"\n[road]\ndriven = true\n[region]\ncentre_m = [0.0, 0.0]\nradius_m = 20.0\n'
        "[deployment]\nx_m = 0.0\ny_m = -1.0\nheight_m = 3.0\n"
    )
    assert not load_scenario(path).road_map.on(np.array([[6.0, 1.4]])).any()
    area = driven_area(recording.centre_m, recording.size_m, recording.heading_rad)
    assert area.on(np.array([[6.0, 1.4]])).all()


def test_a_weight_of_a_class_that_is_not_scored_is_refused(tmp_path):
    for objective in ({"class_weights": {"pedestrian": 3.0}}, {"classes": ["car"], "class_weights": {"truck": 5.0}}):
        name = next(iter(objective["class_weights"]))
        with pytest.raises(InputError, match=rf"\[objective\] class_weights: {name} is not scored; allowed: those of"):
            load_scenario(scene(tmp_path, objective=objective))


def test_every_verb_takes_a_mast_where_people_walk(tmp_path, capsys):
    path = scene(tmp_path, objective={"classes": EVERY})
    rows = [[frame, 77, "pedestrian", 0.0, 0.0, 0.8, 0.6, 1.7, 0.0, 2.0 * frame] for frame in range(60)]
    write_table(tmp_path / "traffic.csv", [*traffic_rows(), *slow_rows(), *rows])
    done(capsys, "scan", path, "--frame", 10, "--height", 3, "--out", tmp_path / "cloud.npz")
    with np.load(tmp_path / "cloud.npz") as cloud:
        assert "pedestrian" in cloud["class"].tolist()


def test_queues_leave_who_walks_where_they_are():
    walking = joined(*(one_vehicle("pedestrian", centre=(x, 6.0)) for x in (0.0, 0.4, 30.0)))
    found = queued(walking, walking.size_m[:, 0], lambda gaps: np.clip(gaps, 1.5, 3.0), anchor_m=0.0, road=ROAD)
    np.testing.assert_array_equal(found.centre_m, walking.centre_m)
    driving = joined(*(one_vehicle("car", centre=(x, 6.0)) for x in (0.0, 8.0, 30.0)))
    moved = queued(driving, driving.size_m[:, 0], lambda gaps: np.clip(gaps, 1.5, 3.0), anchor_m=0.0, road=ROAD)
    assert (moved.centre_m != driving.centre_m).any()


def test_a_table_of_people_without_any_size_is_read_and_a_car_without_one_is_refused():
    def table(kind, **sizes):
        cells = {"length_m": [4.5, 0.0], "width_m": [1.8, np.nan], "height_m": [1.5, np.nan]} | sizes
        base = {"frame": [0, 0], "vehicle_id": [1, 2], "class": ["car", kind], "x_m": [0.0, 5.0], "y_m": [0.0, 5.0]}
        return {key: np.array(values) for key, values in (base | cells | {"heading_deg": [0.0, 0.0]}).items()}

    found = read_table(table("pedestrian"))
    assert found.size_m.tolist() == [[4.5, 1.8, 1.5], [0.5, 0.6, 1.73]]
    assert (found.report.sizes_repaired, found.centre_m[1, 2]) == (0, 0.865)
    for sizes, said in (({}, "length_m is 0"), ({"length_m": [4.5, 4.5]}, "width_m is nothing")):
        with pytest.raises(InputError, match=f"{said}; allowed: more than 0, 0.001 to 1000"):
            read_table(table("car", **sizes))
    with pytest.raises(InputError, match=r"length_m is 0\.0005; allowed"):
        read_table(table("pedestrian", length_m=[4.5, 0.0005]))


def test_a_vehicle_that_sumo_writes_without_its_lane_is_no_pedestrian(tmp_path):
    path = tmp_path / "run.csv"
    rows = [f"{time};{name};{x};5;90;{kind};{lane}" for time in (0, 1) for name, x, kind, lane in FCD]
    path.write_text(
        "\n".join(["timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_type;vehicle_lane", *rows])
    )
    found = read_traffic(path)
    assert sorted({CLASSES[index] for index in found.class_index}) == ["car", "pedestrian"]
    assert found.report.left_out == 2
    assert "rows of vehicles on no road: 2 of passenger" in found.report.notes


FCD = (("a", 0, "passenger", "e_0"), ("b", 10, "passenger", ""), ("p", 20, "DEFAULT_PEDTYPE", ""))


def test_score_leaves_pedestrians_out(tmp_path, capsys):
    columns = ("frame", "vehicle_id", "class", "x_m", "y_m", "length_m", "width_m", "height_m", "heading_deg")
    rows = [[0, 1, "car", 10.0, 5.0, 4.5, 1.8, 1.5, 0.0], [0, 2, "pedestrian", 20.0, 5.0, 0.5, 0.6, 1.7, 0.0]]
    boxes = write_table(tmp_path / "boxes.csv", rows, columns)
    np.savez(tmp_path / "cloud.npz", xyz=np.array([[20.0, 5.0, 1.0], [10.0, 4.1, 1.0]]), vehicle_id=np.array([2, 1]))
    out, _ = done(capsys, "score", "--points", tmp_path / "cloud.npz", "--boxes", boxes, "--assign", "id", "--json")
    assert [one["class"] for one in json.loads(out)["vehicles"]] == ["car"]
