"""The plain CSV of boxes: where they are placed, what may be left out, what is refused."""

from __future__ import annotations

import gzip
import sys

import numpy as np
import pytest

from blender_lidar import csv_tables as csv_rows
from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.traffic import format_of, read_table, read_traffic, write_table
from blender_lidar.traffic.presets import PRESETS, meta_files
from blender_lidar.traffic.table import BOX_NEEDED
from blender_lidar.traffic.vehicles import CLASSES, RepairReport
from tests.traffic_samples import refused

pytestmark = pytest.mark.versions

HEADER = "frame,vehicle_id,class,x_m,y_m,z_m,length_m,width_m,height_m,heading_deg"
ROWS = [
    "10,1,car,5.0,6.0,0.75,4.5,1.9,1.5,2.0",
    "10,2,truck,-20.0,10.0,1.9,12.0,2.5,3.8,-1.0",
    "20,1,car,15.0,6.5,0.75,4.5,1.9,1.5,1.0",
]


def write(tmp_path, header=HEADER, rows=ROWS, name="boxes.csv"):
    path = tmp_path / name
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_boxes_are_read_as_they_are_written(tmp_path):
    recording = read_table(write(tmp_path))
    assert (recording.frames.tolist(), recording.counts.tolist()) == ([10, 20], [2, 1])
    vehicles = recording.at(10)
    assert vehicles.class_name.tolist() == ["car", "truck"]
    np.testing.assert_array_equal(vehicles.centre_m, [[5.0, 6.0, 0.75], [-20.0, 10.0, 1.9]])
    np.testing.assert_array_equal(vehicles.size_m, [[4.5, 1.9, 1.5], [12.0, 2.5, 3.8]])
    np.testing.assert_allclose(np.degrees(vehicles.heading_rad), [2.0, -1.0])
    assert vehicles.lane.tolist() == [0, 0]
    assert recording.report.rows_read == recording.report.rows_used == 3


def test_the_format_is_told_by_the_header(tmp_path):
    assert len(read_traffic(write(tmp_path))) == 3
    path = tmp_path / "boxes.dat"
    path.write_bytes(b"\xef\xbb\xbf# made up\n" + write(tmp_path).read_bytes())
    assert len(read_traffic(path)) == 3
    with pytest.raises(InputError, match="period = 2 does not apply to traffic of format 'table'"):
        read_traffic(path, period=2)


def test_origin_and_heading_place_the_tables_own_frame_in_the_road_frame(tmp_path):
    """A road that runs due north through (100, 50): what lies east of it is to its right."""
    rows = ["1,7,car,103.0,70.0,0.75,4.5,1.9,1.5,92.0"]
    vehicles = read_table(write(tmp_path, rows=rows), origin_m=(100.0, 50.0), heading_deg=90.0).at(1)
    np.testing.assert_allclose(vehicles.centre_m, [[20.0, -3.0, 0.75]], atol=1e-12)
    np.testing.assert_allclose(np.degrees(vehicles.heading_rad), [2.0])


def driven(left_out=(), rename=None, **changes):
    """A whole table of two cars and a lorry on a bend, some columns left out, renamed or changed."""
    rows = []
    for frame in range(40):
        for number, kind, size in (
            (1, "car", (4.5, 1.8, 1.5)),
            (2, "truck", (12.7, 2.6, 3.8)),
            (3, "car", (4.5, 1.8, 1.5)),
        ):
            turn = 0.001 * frame + 0.3 * number
            place = (800.0 * np.sin(turn), 800.0 * (1.0 - np.cos(turn)))
            values = (frame, number, kind, *place, *size, np.degrees(turn), 0.1 * frame)
            rows.append(dict(zip((*BOX_NEEDED, "time_s"), values, strict=True)) | changes)
    names = [name for name in rows[0] if name not in left_out]
    return {(rename or {}).get(name, name): np.array([row[name] for row in rows]) for name in names}


def test_what_can_be_inferred_may_be_left_out():
    whole, less = read_table(driven()), read_table(driven(("frame", "height_m", "heading_deg", "class")))
    np.testing.assert_array_equal(less.frames, whole.frames)
    np.testing.assert_array_equal(less.class_index, whole.class_index)
    np.testing.assert_allclose(less.size_m, whole.size_m)
    np.testing.assert_allclose(less.heading_rad, whole.heading_rad, atol=0.03)
    assert less.report.assumed == (
        "Class: truck from 7 m of length on, else car, as the table has none",
        "Heights: by class, as the table has none",
        "Headings: those of motion, as the table has none",
    )
    sizes = read_table(driven(("length_m", "width_m", "height_m")), height_m={"car": 1.6})
    assert sizes.size_m[sizes.class_index == 0][0].tolist() == [4.5, 1.8, 1.6]
    some = driven()
    some["heading_deg"] = np.where(np.arange(120) % 7 == 0, np.nan, some["heading_deg"])
    np.testing.assert_allclose(read_table(some).heading_rad, whole.heading_rad, atol=0.03)


def test_one_frame_shows_no_motion_to_take_headings_from():
    one = {name: column[:3] for name, column in driven(("heading_deg",)).items()}
    with pytest.raises(InputError, match="has no heading_deg, and one frame shows no motion"):
        read_table(one)


@pytest.mark.parametrize(
    ("left_out", "rename", "message"),
    [
        (("frame", "time_s"), {}, "no column frame; needed: frame, vehicle_id, x_m, y_m"),
        (("class", "length_m"), {}, "no column class; needed"),
        ((), {"heading_deg": "psi_rad"}, "no column heading_deg; .*nearest: psi_rad to heading_deg"),
        ((), {"length_m": "lenght_m"}, "no column length_m; .*nearest: lenght_m to length_m"),
        ((), {"class": "agent_type"}, "no column class; .*nearest: agent_type to class"),
    ],
)
def test_what_cannot_be_inferred_or_has_nearly_the_right_name_is_asked_for(left_out, rename, message):
    with pytest.raises(InputError, match=message):
        read_table(driven(left_out, rename))


def test_words_for_classes_are_known_and_who_has_no_size_has_the_class_s():
    table = driven()
    words = {"car": ["Car", "small-vehicle", "PKW"], "truck": ["truck_bus", "Large-Vehicle", "Lorry"]}
    kinds = [words[kind][row // 3 % 3] for row, kind in enumerate(table["class"].tolist())]
    table["class"] = np.array([*kinds[:-3], "pedestrian/bicycle", "Person", "cyclist"])
    table["length_m"][-3:] = [0.0, np.nan, 0.0]  # as points have
    recording = read_table(table)
    walking, cycling = (recording.class_index == CLASSES.index(name) for name in ("pedestrian", "bicycle"))
    assert (walking.sum(), cycling.sum(), recording.report.left_out) == (2, 1, 0)
    assert recording.size_m[walking, :2].tolist() == [[0.5, 0.6]] * 2
    assert recording.size_m[cycling, :2].tolist() == [[1.76, 0.6]]
    assert "Sizes: by class, where the table has none" in recording.report.assumed
    motor = ~(walking | cycling)
    np.testing.assert_array_equal(recording.class_index[motor] == 2, recording.vehicle_id[motor] == 2)


def as_preset(preset, folder):
    """The same drive as a data set has it, and the boxes that are meant."""
    table = driven()
    x, y, length, width = (table[name] for name in ("x_m", "y_m", "length_m", "width_m"))
    ids, frame, time_s = table["vehicle_id"], table["frame"], table["frame"] / 25.0
    columns = {
        "highd": {
            "frame": frame,
            "id": ids,
            "x": x - length / 2,
            "y": -y - width / 2,
            "width": length,
            "height": width,
        },
        "ind": {"trackId": ids, "frame": frame, "xCenter": x, "yCenter": y, "heading": table["heading_deg"] % 360.0},
        "k733": {"track_id": ids, "frame_id": frame, "timestamp_ms": 1000 * time_s, "agent_type": table["class"]},
        "tgsim": {"id": ids, "time": time_s, "xloc-kf": x, "yloc-kf": -y, "lane-kf": 0 * ids, "run-index": 0 * ids + 1},
    }[preset]
    columns |= {
        "highd": {"laneId": 0 * ids},
        "ind": {"length": length, "width": width},
        "k733": {"x": x, "y": y, "vx": 0 * x, "vy": 0 * y, "psi_rad": 0 * x, "length": length, "width": width},
        "tgsim": {"length-smoothed": length, "width-smoothed": width, "type-most-common": table["class"]},
    }[preset]
    path = folder / "07_tracks.csv"
    rows = [",".join(map(str, row)) for row in zip(*(column.tolist() for column in columns.values()), strict=True)]
    path.write_text("\n".join([",".join(columns), *rows]), encoding="utf-8")
    key = "id" if preset == "highd" else "trackId"
    way = [",drivingDirection", ",2"] if preset == "highd" else ["", ""]
    meta = [f"{key},class{way[0]}", f"1,Car{way[1]}", f"2,truck_bus{way[1]}", f"3,car{way[1]}"]
    (folder / "07_tracksMeta.csv").write_text("\n".join(meta), encoding="utf-8")
    (folder / "07_recordingMeta.csv").write_text("frameRate\n25.0\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("preset", PRESETS)
def test_a_data_set_is_the_table_that_is_meant(tmp_path, preset):
    path, whole = as_preset(preset, tmp_path), read_table(driven())
    assert format_of(path) == preset
    recording = read_traffic(path, format=preset)
    np.testing.assert_array_equal(recording.vehicle_id, whole.vehicle_id)
    np.testing.assert_array_equal(recording.class_index, whole.class_index)
    np.testing.assert_allclose(recording.centre_m[:, :2], whole.centre_m[:, :2], atol=1e-9)
    np.testing.assert_allclose(recording.size_m, whole.size_m)
    assert recording.time_step_s == pytest.approx(0.04)
    if preset != "highd":  # which has the direction of travel alone
        np.testing.assert_allclose(recording.heading_rad, whole.heading_rad, atol=0.03)
    assert [one.name for one in meta_files(path, preset)] == (
        ["07_tracksMeta.csv", "07_recordingMeta.csv"] if PRESETS[preset].has_meta else []
    )


def test_a_data_set_without_its_meta_file_is_refused_and_named_where_it_is_not_said(tmp_path):
    path = as_preset("highd", tmp_path)
    with pytest.raises(InputError, match=r'has the columns of highd; say so: \[traffic\] format = "highd"'):
        read_traffic(path)
    (tmp_path / "07_tracksMeta.csv").unlink()
    with pytest.raises(MissingFileError, match=r"its tracksMeta\.csv, which has the classes, is not beside it"):
        read_traffic(path, format="highd")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"_id": 1, "timestamp": [1.0]}', "is JSON; write a CSV"),
        ("[\n {", "is JSON; write a CSV"),
        (
            "track_id; type; traveled_d; avg_speed; lat; lon; speed; time\n1; Car; 0; 1; 37.9; 23.7; 1; 0",
            "longitude and",
        ),
    ],
)
def test_what_is_no_table_of_metres_is_told_as_what_it_is(tmp_path, text, message):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_traffic(tmp_path / "x.csv")


def test_a_table_of_boxes_is_read_from_parquet_by_its_columns(tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    parquet.write_table(pyarrow.table(driven()), tmp_path / "boxes.parquet")
    recording, whole = read_traffic(tmp_path / "boxes.parquet"), read_table(driven())
    np.testing.assert_array_equal(recording.centre_m, whole.centre_m)
    np.testing.assert_array_equal(recording.vehicle_id, whole.vehicle_id)


@pytest.mark.parametrize("turn_deg", [-170.0, -30.0, 0.0, 45.0, 400.0])
def test_moving_the_table_and_its_placing_together_changes_nothing(tmp_path, turn_deg):
    expected = read_table(write(tmp_path))
    turn, origin = np.radians(turn_deg), np.array([321.0, -54.0])
    rows = []
    for row in ROWS:
        fields = row.split(",")
        x, y = float(fields[3]), float(fields[4])
        fields[3] = repr(float(x * np.cos(turn) - y * np.sin(turn) + origin[0]))
        fields[4] = repr(float(x * np.sin(turn) + y * np.cos(turn) + origin[1]))
        fields[9] = repr(float(fields[9]) + turn_deg)
        rows.append(",".join(fields))
    moved = read_table(write(tmp_path, rows=rows, name="moved.csv"), origin_m=tuple(origin), heading_deg=turn_deg)
    np.testing.assert_allclose(moved.centre_m, expected.centre_m, atol=1e-9)
    np.testing.assert_allclose(moved.heading_rad, expected.heading_rad, atol=1e-12)


def test_times_come_from_the_column_or_the_step_or_are_assumed_aloud(tmp_path):
    timed = write(tmp_path, HEADER + ",time_s", [f"{row},{3.0 if row[0] == '1' else 5.0}" for row in ROWS], "timed.csv")
    recording = read_table(timed)
    assert recording.frame_time_s.tolist() == [3.0, 5.0]
    assert recording.time_step_s == pytest.approx(0.2)
    assert not recording.report.notes
    plain = write(tmp_path)
    np.testing.assert_allclose(read_table(plain, time_step_s=0.04).frame_time_s, [0.4, 0.8])
    assumed = read_table(plain)
    np.testing.assert_allclose(assumed.frame_time_s, [1.0, 2.0])
    assert assumed.report.assumed == ("Time: 0.1 s from frame to frame, as there is neither time_s nor time_step_s",)


def test_repeated_rows_are_dropped_and_counted(tmp_path):
    path = write(tmp_path, rows=[*ROWS, ROWS[0], ROWS[1].replace("-20.0", "-21.0")])
    recording = read_table(path)
    assert len(recording) == 3
    assert (recording.report.duplicates, recording.report.repeated) == (1, 1)


@pytest.mark.parametrize(
    ("column", "value", "text"),
    [
        ("frame", "1.5", "frame is 1.5; allowed: a whole number"),
        ("vehicle_id", "", "vehicle_id is missing"),
        ("class", "ufo", "unknown class 'ufo'; allowed: car, van, truck, bus, motorcycle, bicycle, pedestrian"),
        ("x_m", "abc", "x_m is 'abc'; allowed: a number, -1e9 to 1e9"),
        ("z_m", "inf", "z_m is 'inf'; allowed: a number, -1e9 to 1e9"),
        ("length_m", "-4.5", "length_m is -4.5; allowed: more than 0, 0.001 to 1000"),
        ("width_m", "0", "width_m is 0; allowed: more than 0, 0.001 to 1000"),
    ],
)
def test_a_bad_value(tmp_path, column, value, text):
    fields = ROWS[1].split(",")
    fields[HEADER.split(",").index(column)] = value
    path = write(tmp_path, rows=[ROWS[0], "", ",".join(fields), ROWS[2]])
    assert refused(path) == f"FILE:4: {text}"


def test_other_files_and_settings_that_cannot_be_used(tmp_path):
    assert refused(tmp_path).startswith("FILE: is a folder")
    path = write(tmp_path)
    assert refused(write(tmp_path, HEADER + ",x_m", name="twice.csv")) == "FILE:1: column x_m is there twice"
    assert "time_step_s is 0" in refused(path, time_step_s=0.0)
    packed = gzip.compress(path.read_bytes())
    cut = tmp_path / "cut.csv.gz"
    cut.write_bytes(packed[:-10])
    assert "truncated or damaged gzip" in refused(cut)


def test_times_that_contradict_one_another(tmp_path):
    header = HEADER + ",time_s"
    two = write(tmp_path, header, [f"{row},{time}" for row, time in zip(ROWS, (1, 2, 3), strict=True)])
    assert refused(two) == "FILE: frame 10 has more than one time_s"
    back = write(tmp_path, header, [f"{row},{time}" for row, time in zip(ROWS, (5, 5, 3), strict=True)])
    assert refused(back) == "FILE: time_s of frame 20 is not later than that of the frame before"


def test_too_many_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(csv_rows, "MAX_ROWS", 2)
    assert refused(write(tmp_path)) == "FILE: more than 2 rows; split the file"


def test_what_was_read_is_told_in_singular_and_plural():
    one = RepairReport(rows_read=1, rows_used=1, duplicates=1, headings_held=1, overlaps=1, overlap_frames=1)
    assert one.lines() == [
        "1 of 1 row used",
        "1 duplicate row dropped",
        "1 heading held (slower than 2 m/s, or no neighbour in time)",
        "1 pair of overlapping boxes in 1 frame looked at",
    ]
    assert one.lines(losses=True) == ["1 of 1 row used", "1 duplicate row dropped"]
    assert RepairReport(rows_read=1, rows_used=1, headings_held=1).lines(losses=True) == []
    many = RepairReport(rows_read=1200, rows_used=1, duplicates=2, overlaps=1000, overlap_frames=2)
    assert many.lines() == [
        "1 of 1,200 rows used",
        "2 duplicate rows dropped",
        "1,000 pairs of overlapping boxes in 2 frames looked at",
    ]


# --- as spreadsheets and people write them ----------------------------------------------------------------------------

TEN = [
    f"{10 + 2 * row // 3},{row % 3},car,{1234.5 * row - 7:g},{0.125 * row + 6:g},0.75,4.5,1.9,1.5,{row:g}"
    for row in range(9)
]
COLUMNS = ("frame", "vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "frame_time_s", "lane")


def same(recording, expected):
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(recording, name), getattr(expected, name), err_msg=name)


def sheet(tmp_path, *, mark=",", comma=False, encoding="utf-8", end="\n", head="", header=HEADER, rows=TEN, tail=""):
    """The rows as a program would write them, with `mark` between columns and perhaps decimal commas."""
    lines = [header.replace(",", mark)]
    for row in rows:
        fields = [field.replace(".", ",") if comma else field for field in row.split(",")]
        lines.append(mark.join(f'"{field}"' if mark in field else field for field in fields))
    path = tmp_path / "sheet.csv"
    path.write_bytes((head + end.join(lines) + end + tail).encode(encoding))
    return path


SHEETS = {
    "German Excel": {"mark": ";", "comma": True, "encoding": "cp1252", "end": "\r\n"},
    "German Excel, UTF-8": {"mark": ";", "comma": True, "encoding": "utf-8-sig", "end": "\r\n"},
    "French Excel, Unicode text": {"mark": "\t", "comma": True, "encoding": "utf-16", "end": "\r\n"},
    "Excel for Mac": {"mark": ";", "comma": True, "end": "\r"},
    "English Excel, Unicode text": {"mark": "\t", "encoding": "utf-16", "end": "\r\n"},
    "UTF-16 without its mark": {"encoding": "utf-16-le"},
    "UTF-16, big end first": {"encoding": "utf-16-be", "mark": ";"},
    "sep": {"mark": ";", "comma": True, "head": "sep=;\r\n", "end": "\r\n"},
    "sep after a mark": {"mark": "\t", "encoding": "utf-8-sig", "head": "SEP=\t\r\n", "end": "\r\n"},
    "a comment saved again": {"mark": ";", "comma": True, "head": '"# made up; by hand";;\n# more\n;;;\n'},
    "bars": {"mark": "|"},
    "blanks": {"mark": " "},
    "blanks and decimal commas": {"mark": "  ", "comma": True},
    "quoted header": {"header": ",".join(f'"{name}"' for name in HEADER.split(",")), "mark": ";"},
    "header of capitals and blanks": {"header": HEADER.upper().replace("_", " "), "mark": ";"},
    "header with units": {
        "header": "Frame,Vehicle ID,Class,x [m],y [m],z (m),Length (m),Width (m),Height (m),Heading [°]",
        "encoding": "cp1252",
    },
    "camels": {"header": "Frame,VehicleId,Class,X_m,Y_m,Z_m,LengthM,WidthM,HeightM,HeadingDeg"},
    "empty columns and rows behind": {
        "header": HEADER + ",,", "rows": [row + ",," for row in TEN], "tail": ",,,,,,,,,,,\n,,,,,,,,,,,\n\n",
    },
    "empty columns in rows alone": {"rows": [row + ",," for row in TEN], "mark": ";"},
    "empty columns in the header alone": {"header": HEADER + ",,"},
    "a city in Windows-1252": {
        "header": HEADER + ",Straße", "rows": [row + ",Königsallee" for row in TEN], "encoding": "cp1252", "mark": ";",
        "comma": True,
    },
}  # fmt: skip


@pytest.mark.parametrize("chunk", [2, 5000])
@pytest.mark.parametrize("case", SHEETS)
def test_a_table_is_read_as_spreadsheets_write_it(tmp_path, monkeypatch, case, chunk):
    expected = read_table(write(tmp_path, rows=TEN))
    monkeypatch.setattr(csv_rows, "_CHUNK_ROWS", chunk)
    path = sheet(tmp_path, **SHEETS[case])
    recording = read_traffic(path)
    same(recording, expected)
    assert recording.report.rows_read == len(TEN)


def small(value="12,345", frame="1", mark=";", more="4,5"):
    fields = (frame, "7", "car", value, "6", "0", more, "2", "2", "0")
    return [mark.join(f'"{field}"' if mark in field else field for field in fields)]


def plain(tmp_path, rows, mark):
    return write(tmp_path, HEADER.replace(",", mark), rows)


def test_a_decimal_comma_is_told_from_thousands_or_refused(tmp_path):
    """Each reading is right, or there is none: semicolons come with decimal commas, other separators with either."""
    for mark, more in ((";", "4"), (";", "4,5"), ("\t", "4,5"), ("|", "0,500"), (" ", "4,5000")):
        assert read_table(plain(tmp_path, small(mark=mark, more=more), mark)).centre_m[0, 0] == 12.345
    either = "'12,345' and its like may have a decimal comma or divide thousands; write decimal points"
    for mark in ("\t", "|", " ", ","):
        assert refused(plain(tmp_path, small(mark=mark, more="4"), mark)) == f"FILE: {either}"
    assert read_table(plain(tmp_path, small(mark=",", more="4.5"), ",")).centre_m[0, 0] == 12345.0
    assert read_table(plain(tmp_path, small("1,234,567", mark=",", more="4"), ",")).centre_m[0, 0] == 1234567.0
    assert refused(plain(tmp_path, small("1,5", mark=",", more="4.5"), ",")).startswith("FILE:2: x_m is '1,5'; allowed")
    for value in ("1,5", "1,234", "1,234.5", "1.234,5"):
        for mark in (";", "\t"):
            message = refused(plain(tmp_path, small(value, mark=mark, more="4.5"), mark))
            assert message.startswith(f"FILE:2: x_m is '{value}'; allowed")
    assert "x_m is '1.234.567'" in refused(plain(tmp_path, small("1.234.567"), ";"))


@pytest.mark.parametrize("first", ["4,5", "4.5"])
def test_commas_and_points_in_one_file_are_refused_however_far_apart(tmp_path, monkeypatch, first):
    monkeypatch.setattr(csv_rows, "_CHUNK_ROWS", 1)
    other = first.translate({ord(","): ".", ord("."): ","})
    rows = [*small("1", more=first), *small("2", "2", more="4"), *small("3", "3", more=other)]
    message = refused(plain(tmp_path, rows, ";"))
    assert message == f"FILE:{2 if first == '4,5' else 4}: length_m is '4,5'; allowed: more than 0, 0.001 to 1000"


# --- columns that are nearly right ------------------------------------------------------------------------------------


@pytest.mark.parametrize("mark", [",", ";", "\t", "|", " "])
@pytest.mark.parametrize(
    ("header", "message"),
    [
        (
            "frame,id,type,x,y,length,width,height,heading",
            "no column vehicle_id, class, x_m, y_m, length_m, width_m, height_m, heading_deg; needed: frame, "
            "vehicle_id, class, x_m, y_m, length_m, width_m, height_m, heading_deg; it has frame, id, type, x, y, "
            "length, width, height, heading; nearest: id to vehicle_id, type to class, x to x_m, y to y_m, "
            "length to length_m, "
            "width to width_m, height to height_m, heading to heading_deg",
        ),
        ("frame,vehicle_id,class,x_m,y_m,lenght_m,width_m,height_m,yaw", "nearest: lenght_m to length_m, yaw to"),
        (
            "frame_id,track_id,category,pos_x,pos_y,l,w,h,angle",
            "frame_id to frame, track_id to vehicle_id, category to",
        ),
        ("id,type,x,y,length,width", "no column frame, vehicle_id"),
        ("time,id,class,x,y,length,width,height,heading", "no column frame, vehicle_id"),
        ("frame,vehicle_id,class,x_ft,y_ft,length_ft,width_ft,height_ft,heading_rad", "x_ft to x_m, y_ft to y_m"),
    ],
)
def test_a_table_whose_columns_are_nearly_right_is_known_and_the_missing_ones_are_named(
    tmp_path, header, message, mark
):
    path = write(tmp_path, header.replace(",", mark), ["1,2,car,3,4,4.5,2,1.5,0".replace(",", mark)])
    line = refused(path)
    assert line.startswith("FILE:1: no column ")
    assert message in line


# --- ids that are texts -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("chunk", [1, 2, 5000])
@pytest.mark.parametrize(("mark", "comma"), [(",", False), (";", True), ("\t", True)])
@pytest.mark.parametrize("ids", [["veh_12", "flow.3", "12"], ["12", "bus,7", "Käfer"], ["7", "07", "a" * 40]])
def test_ids_that_are_texts_are_numbered_as_they_appear(tmp_path, monkeypatch, ids, mark, comma, chunk):
    if mark in "".join(ids):
        ids = [name.replace(mark, "-") for name in ids]
    expected = read_table(write(tmp_path, rows=TEN))
    monkeypatch.setattr(csv_rows, "_CHUNK_ROWS", chunk)
    path = sheet(tmp_path, mark=mark, comma=comma)
    lines = path.read_text(encoding="utf-8").splitlines()
    for place, line in enumerate(lines[1:], start=1):
        fields = line.split(mark)
        fields[1] = ids[int(fields[1])]
        lines[place] = mark.join(fields)
    path.write_text("\n".join(lines), encoding="utf-8")
    recording = read_traffic(path)
    same(recording, expected)  # as each appears in the order of its number
    assert f"vehicles are numbered from 0 by first appearance: {', '.join(ids[:2])}" in recording.report.notes[-1]


@pytest.mark.parametrize("bad", ["", "nan", "-1", "1.5", "inf", "NULL"])
def test_what_is_no_id_is_refused_beside_texts_too(tmp_path, bad):
    rows = [ROWS[0].replace("10,1", "10,veh_1"), ROWS[1].replace("10,2", f"10,{bad}")]
    message = refused(write(tmp_path, rows=rows))
    is_number = f"FILE: vehicle_id is {bad!r}; allowed: a whole number of at least 0, or a text"
    assert message == (is_number if bad in ("-1", "1.5", "inf") else "FILE:3: vehicle_id is missing")


def test_numbers_that_a_spreadsheet_writes_with_a_point_stay_whole(tmp_path):
    rows = [row.replace("10,1,", "10,1.0,").replace("10,2,", "10,2.0,").replace("20,1,", "20,1.0,") for row in ROWS]
    same(read_table(write(tmp_path, rows=rows)), read_table(write(tmp_path, name="whole.csv")))


def test_ids_that_the_encoding_garbles_are_not_taken_for_one_another(tmp_path):
    rows = [ROWS[0]] * 4000 + [ROWS[1].replace("10,2", "10,Käfer")]
    path = write(tmp_path, HEADER, rows)
    path.write_bytes(path.read_text(encoding="utf-8").encode("cp1252"))
    assert "in another encoding than the file's beginning; save it as UTF-8" in refused(path)


def test_runs_of_a_tgsim_file_that_are_left_out_are_named(tmp_path):
    header = "id,time,xloc-kf,yloc-kf,lane-kf,length-smoothed,width-smoothed,type-most-common,run-index"
    rows = [
        f"{number + 10 * run},{0.1 * k + 100 * run},{10 * k + 30 * number},3.5,1,4.5,1.8,small-vehicle,{run}"
        for run in (1, 2)
        for number in range(5)
        for k in range(20)
    ]
    (tmp_path / "tg.csv").write_text("\n".join([header, *rows]))
    found = read_traffic(tmp_path / "tg.csv", format="tgsim")
    assert len(found) == 100
    assert found.report.rows_read == 200
    assert any("2 runs found (run-index 1, 2); the first is used" in note for note in found.report.notes)


def test_what_a_table_is_written_as_gives_the_same_boxes_and_says_the_same(tmp_path):
    path = sheet(tmp_path, **SHEETS["French Excel, Unicode text"])
    recording = read_traffic(path)
    write_table(tmp_path / "traffic.csv", recording)
    again = read_traffic(tmp_path / "traffic.csv")
    for name in COLUMNS:
        tolerance = 1e-15 if name == "heading_rad" else 0.0  # in degrees on its way
        np.testing.assert_allclose(getattr(again, name), getattr(recording, name), rtol=tolerance, err_msg=name)
    assert again.report == recording.report
    write_table(tmp_path / "again.csv", again)
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "traffic.csv").read_bytes()


ENCODINGS = ("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "cp1252")


@pytest.mark.parametrize("case", SHEETS)
def test_no_table_of_text_needs_more_than_numpy(tmp_path, monkeypatch, case):
    for library in ("pandas", "pyarrow"):
        monkeypatch.setitem(sys.modules, library, None)
    same(read_traffic(sheet(tmp_path, **SHEETS[case])), read_table(write(tmp_path, rows=TEN)))


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_in_every_encoding_quoted_thousands_are_read_and_a_short_row_is_refused_by_its_line(tmp_path, encoding):
    path = write(tmp_path, rows=[row.replace(",1227.5,", ',"1,227.5",') for row in TEN])
    text = path.read_text(encoding="utf-8")
    assert '"1,227.5"' in text
    path.write_bytes(text.encode(encoding))
    same(read_traffic(path), read_table(write(tmp_path, name="plain.csv", rows=TEN)))
    short = write(tmp_path, rows=[*TEN[:-1], TEN[-1].rpartition(",")[0]])
    short.write_bytes(short.read_text(encoding="utf-8").encode(encoding))
    columns = HEADER.count(",") + 1
    assert refused(short) == f"FILE:{len(TEN) + 1}: {columns - 1} fields; the first line has {columns}"
