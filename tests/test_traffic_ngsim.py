"""NGSIM's dialects all give the same boxes, in metres and in the road frame; real recordings make physical sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from blender_lidar import csv_tables as source
from blender_lidar.errors import InputError
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.traffic import CLASSES, ngsim, plan_frames, read_traffic
from tests import traffic_samples as samples
from tests.traffic_samples import assert_same_boxes

FOOT_M = 0.3048


@pytest.fixture
def columns():
    return samples.columns()


@pytest.fixture
def expected(columns, tmp_path):
    return read_traffic(samples.write(tmp_path, samples.native(columns)))


def _api_with_empty_cells(columns):
    return samples.api(columns).replace("NULL", "")


def _header_tabs(columns):
    return "\t".join(samples.NATIVE_COLUMNS) + "\n" + samples.native(columns, separator="\t", line_end="\n")


def _header_extras(columns):
    body = samples.native(columns, separator=",", line_end=",1\n")
    return ",".join([*samples.NATIVE_COLUMNS, "x_imputed"]) + "\n" + body


DIALECTS = {
    "tabs": lambda c: samples.native(c, separator="\t", line_end="\n"),
    "tabs at the line's end": lambda c: samples.native(c, separator="\t", line_end="\t\r\n"),
    "mixed spaces and tabs": lambda c: samples.native(c, separator=" \t", line_end=" \n"),
    "CRLF": lambda c: samples.native(c, line_end=" \r\n"),
    "commas": lambda c: samples.native(c, separator=",", line_end="\n"),
    "commas at the line's end": lambda c: samples.native(c, separator=",", line_end=",\n"),
    "portal": samples.portal,
    "portal without header": lambda c: samples.portal(c, header=False),
    "API": samples.api,
    "API with empty cells": _api_with_empty_cells,
    "header and tabs": _header_tabs,
    "header and extra columns": _header_extras,
    "comment before the rows": lambda c: "# made up\n\n" + samples.native(c),
    "comment before the header": lambda c: "# made up\n" + samples.api(c),
    "blank lines between": lambda c: samples.native(c).replace("\n", "\n\n"),
    "no line end at the end": lambda c: samples.native(c).rstrip("\n"),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_boxes(dialect, columns, expected, tmp_path):
    assert_same_boxes(read_traffic(samples.write(tmp_path, DIALECTS[dialect](columns))), expected)


def test_front_centre_in_feet_becomes_box_centre_in_the_road_frame(columns, tmp_path):
    road = RoadSettings(station_m=40.0, right_edge_m=25.0, setback_m=3.0)
    recording = read_traffic(samples.write(tmp_path, samples.native(columns)), road=road)
    order = np.lexsort((columns["Vehicle_ID"], columns["Frame_ID"]))
    front_x = columns["Local_Y"][order] * FOOT_M - 40.0
    length = columns["v_Length"][order] * FOOT_M
    np.testing.assert_allclose(recording.size_m[:, 0], length, atol=1e-12)
    np.testing.assert_allclose(recording.centre_m[:, 0], front_x - length / 2, atol=1e-9)
    np.testing.assert_allclose(recording.centre_m[:, 1], 3.0 + 25.0 - columns["Local_X"][order] * FOOT_M, atol=1e-9)
    np.testing.assert_allclose(recording.centre_m[:, 2], recording.size_m[:, 2] / 2)
    np.testing.assert_allclose(recording.heading_rad, 0.0, atol=1e-9)


def test_time_step_and_frame_times_are_inferred(columns, expected, tmp_path):
    assert expected.time_step_s == 0.1
    np.testing.assert_allclose(np.diff(expected.frame_time_s), 0.1)
    columns["Global_Time"] = samples.P1_ORIGIN_MS + 40 * columns["Frame_ID"]
    assert read_traffic(samples.write(tmp_path, samples.native(columns))).time_step_s == 0.04


def test_instants_with_neighbours_keep_frame_numbers_times_and_headings(tmp_path):
    columns = samples.columns(frames=1000)
    columns["Local_X"] = columns["Local_X"] - 0.05 * (columns["Local_Y"] - 100)
    columns = samples.picked(columns, np.isin(columns["Frame_ID"] % 100, (45, 50, 55)))
    recording = read_traffic(samples.write(tmp_path, samples.native(columns)))
    assert recording.frames[:4].tolist() == [145, 150, 155, 245]
    np.testing.assert_allclose(np.diff(recording.frame_time_s)[:3], [0.5, 0.5, 9.0])
    np.testing.assert_allclose(recording.heading_rad, np.arctan(0.05), atol=1e-3)
    assert recording.report.headings_held == 0


def test_classes_and_heights_follow_from_class_and_length(tmp_path):
    columns = samples.columns(vehicles=6, frames=2)
    number = columns["Vehicle_ID"]
    columns["v_Class"] = np.array([0, 2, 2, 3, 3, 1, 2])[number]
    columns["v_Length"] = np.array([0, 14.0, 17.0, 26.0, 50.0, 7.0, 16.0])[number]
    path = samples.write(tmp_path, samples.native(columns))
    vehicles = read_traffic(path).at(100)
    assert vehicles.class_name.tolist() == ["car", "van", "truck", "truck", "motorcycle", "car"]
    assert vehicles.size_m[:, 2].tolist() == [1.5, 1.9, 3.0, 3.8, 1.4, 1.5]
    own = read_traffic(path, height_m={"car": 1.6, "long_truck": 4.0}).at(100)
    assert own.size_m[:, 2].tolist() == [1.6, 1.9, 3.0, 4.0, 1.4, 1.6]
    assert set(vehicles.class_index) <= set(range(len(CLASSES)))


def test_vehicles_of_a_frame_and_selection(expected, columns):
    vehicles = expected.at(150)
    assert vehicles.frame == 150
    assert vehicles.time_s == pytest.approx(15.0)
    assert len(vehicles) == expected.counts[50] == 12
    assert vehicles.vehicle_id.tolist() == list(range(1, 13))
    trucks = vehicles.select(vehicles.class_name == "truck")
    assert trucks.vehicle_id.tolist() == [10]
    assert trucks.centre_m.shape == trucks.size_m.shape == (1, 3)
    with pytest.raises(InputError, match=r"no frame 99; the recording has 120 frames from 100 to 219"):
        expected.at(99)


def test_native_text_of_arterials_has_free_headings(tmp_path):
    columns = samples.columns()
    columns["Local_Y"] = 2000.0 - columns["Local_Y"]  # oncoming
    path = samples.write(tmp_path, samples.native(columns, arterial=True))
    recording = read_traffic(path)
    np.testing.assert_allclose(np.abs(recording.heading_rad), np.pi, atol=1e-9)
    front_x = columns["Local_Y"][columns["Vehicle_ID"] == 1] * FOOT_M - 250.0
    one = recording.vehicle_id == 1
    np.testing.assert_allclose(recording.centre_m[one, 0], front_x + recording.size_m[one, 0] / 2, atol=1e-9)
    path.write_text(samples.portal(columns, "peachtree"), encoding="utf-8")
    np.testing.assert_allclose(np.abs(read_traffic(path).heading_rad), np.pi, atol=1e-9)
    path.write_text(samples.native(columns))
    np.testing.assert_allclose(np.abs(read_traffic(path).heading_rad), np.radians(6.0), atol=1e-9)


def test_the_24_columns_say_the_same_as_the_18(columns, tmp_path):
    """But for headings, which are free where there are intersections."""
    columns["Local_Y"] += 0.5 * np.sin(columns["Frame_ID"])
    paths = tmp_path / "18.txt", tmp_path / "24.txt"
    paths[0].write_text(samples.native(columns))
    paths[1].write_text(samples.native(columns, arterial=True))
    short, long = map(read_traffic, paths)
    for name in ("frame", "vehicle_id", "class_index", "size_m", "lane", "frame_time_s", "centre_m"):
        np.testing.assert_array_equal(getattr(long, name), getattr(short, name), err_msg=name)


DIRTY = ["", "NULL", "nan", "-1", "1,5", '"0,001"', '"a\nb"', '1"5', "+4"]


@pytest.mark.parametrize("dialect", [samples.native, samples.portal, samples.api])
@pytest.mark.parametrize("place", [None, 0, 8, 13, 24])
def test_lines_parsed_by_numpy_and_rows_of_texts_give_the_same(tmp_path, monkeypatch, dialect, place):
    monkeypatch.setattr(source, "_CHUNK_ROWS", 7)
    separator = None if dialect is samples.native else ","
    lines = dialect(samples.columns(vehicles=3, frames=20, first_frame=990)).split("\n")
    parsed, chunks = source._parsed, []

    def rows(path):
        try:
            return ngsim.read_location(path, ngsim.sniff_layout(path), None)
        except InputError as error:
            return str(error)

    for value in DIRTY if place is not None else ["clean"]:
        fields = lines[31].split(separator)
        if place is not None:
            fields[place % len(fields)] = value
        path = samples.write(tmp_path, "\n".join([*lines[:31], (separator or " ").join(fields), *lines[32:]]))
        chunks.clear()
        monkeypatch.setattr(source, "_parsed", lambda *given: chunks.append(parsed(*given)) or chunks[-1])
        fast = rows(path)
        monkeypatch.setattr(source, "_parsed", lambda *given: None)
        np.testing.assert_equal(fast, rows(path))
        assert sum(found is not None for found in chunks) >= 3
        assert place is not None or all(found is not None for found in chunks)


# --- real recordings --------------------------------------------------------------------------------------------------


DATA = Path(__file__).parents[2] / "shared" / "data" / "ngsim"
pytestmark = [
    pytest.mark.skipif(not DATA.is_dir(), reason="the NGSIM excerpts of ../shared/data are not here"),
    pytest.mark.versions,
]

SUMO = "SYNTHETIC_sumo_i80_60s_ngsim18.txt.gz"
LANES_1_TO_3 = "i80_0400-0415_lanes1-3_partial_18col.csv.gz"
VEHICLE_3 = "i80_0515-0530_veh3_raw_99rows.txt"
PEACHTREE = "socrata_export_format_sample_peachtree_200rows.csv"


@pytest.fixture(scope="module")
def recordings():
    read = {}

    def recording(name):
        if name not in read:
            read[name] = read_traffic(DATA / name)
        return read[name]

    return recording


@pytest.mark.parametrize("name", [SUMO, LANES_1_TO_3])
def test_traffic_flows_forward_in_lanes_from_left_to_right_within_the_carriageway(recordings, name):
    recording = recordings(name)
    by_vehicle = np.lexsort((recording.frame, recording.vehicle_id))
    same = np.diff(recording.vehicle_id[by_vehicle]) == 0
    step = np.diff(recording.frame[by_vehicle])
    moved = np.diff(recording.centre_m[by_vehicle], axis=0)[same & (step == 1)] / recording.time_step_s
    # Centres jerk where a held or limited heading jumps; speeds over a tenth of a second are only roughly sane.
    assert 3.0 < np.mean(moved[:, 0]) < 20.0
    assert np.percentile(moved[:, 0], 1) > -0.5
    assert np.percentile(moved[:, 0], 99.9) < 40.0
    assert abs(np.mean(moved[:, 1])) < 0.5
    past_the_ramp = recording.centre_m[:, 0] > 0
    lanes = np.unique(recording.lane[past_the_ramp & (recording.lane <= 6)])
    lateral = [np.median(recording.centre_m[past_the_ramp & (recording.lane == lane), 1]) for lane in lanes]
    assert len(lanes) >= 3
    np.testing.assert_allclose(np.diff(lateral), -3.66, atol=0.7)
    low, high = map_of(RoadSettings()).edges_t
    assert low < min(lateral)
    assert max(lateral) < high


@pytest.mark.parametrize("name", [SUMO, LANES_1_TO_3])
def test_headings_and_sizes_lie_within_their_ranges(recordings, name):
    recording = recordings(name)
    heading = np.degrees(np.abs(recording.heading_rad))
    assert heading.max() <= 15.0 + 1e-9
    assert (heading <= 6.0 + 1e-9).mean() > 0.95
    assert np.median(heading) < 1.5
    length, width, height = recording.size_m.T
    for number, low, high in ((0, 2.5, 4.9), (1, 4.9, 7.0), (2, 5.0, 25.0), (4, 1.6, 2.8)):
        of_class = recording.class_index == number
        assert (length[of_class] >= low).all(), CLASSES[number]
        assert (length[of_class] <= high).all(), CLASSES[number]
    assert width.min() >= 0.5
    assert width.max() <= 2.6
    assert set(np.unique(height)) <= {1.4, 1.5, 1.9, 3.0, 3.8}
    np.testing.assert_allclose(recording.centre_m[:, 2], height / 2)


def test_the_box_ends_at_the_recorded_front(recordings):
    recording = recordings(VEHICLE_3)
    raw = np.loadtxt(DATA / VEHICLE_3)
    assert recording.frame.tolist() == raw[:, 1].astype(int).tolist()
    direction = np.stack([np.cos(recording.heading_rad), np.sin(recording.heading_rad)], axis=1)
    front = recording.centre_m[:, :2] + recording.size_m[:, :1] / 2 * direction
    road = RoadSettings()
    np.testing.assert_allclose(front[:, 0], raw[:, 5] * FOOT_M - road.station_m, atol=1e-9)
    np.testing.assert_allclose(front[:, 1], road.setback_m + road.right_edge_m - raw[:, 4] * FOOT_M, atol=1e-9)
    assert recording.report.period == "0515-0530"


def test_the_dense_scene_has_its_density_and_classes(recordings):
    recording = recordings(SUMO)
    assert 130 < np.median(recording.counts) < 150
    assert {"car", "van", "truck", "motorcycle"} == set(np.array(CLASSES)[np.unique(recording.class_index)])
    assert (recording.time_step_s, len(recording.frames)) == (0.1, 600)


def test_the_sparse_scene_is_whole(recordings):
    recording = recordings(LANES_1_TO_3)
    assert recording.report.rows_read == recording.report.rows_used == 110_905
    assert (len(np.unique(recording.vehicle_id)), recording.report.period) == (222, "0400-0415")


def test_an_export_of_the_portal_is_read_as_it_comes(recordings):
    recording = recordings(PEACHTREE)
    assert recording.report.location == "peachtree"
    assert recording.report.rows_used + recording.report.duplicates + recording.report.repeated == 200
    assert np.isfinite(recording.centre_m).all()


def test_half_of_the_sparse_scene_can_judge_the_other(recordings):
    recording = recordings(LANES_1_TO_3)

    def counted(vehicles):
        return np.hypot(vehicles.centre_m[:, 0], vehicles.centre_m[:, 1]) <= 60.0

    plan = plan_frames(recording, counted, count=40)
    assert len(plan.search) == 40
    assert plan.holdout_block[-1] >= 4
    assert 5.0 <= plan.block_s <= 60.0
    for frame in plan.holdout:
        vehicles = recording.at(frame)
        assert not np.isin(vehicles.vehicle_id[counted(vehicles)], plan.searched_ids).any()
