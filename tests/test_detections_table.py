"""Tables of detections are read strictly, and what is wrong is told in one line."""

from __future__ import annotations

import re

import pytest

from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError
from blender_lidar.reality.detections import read_detections

HEADER = "frame,label_line,a_confidence,a_iou3d,b_confidence,b_iou3d,b_iou_bev,b_in_range,size_m"
ROWS = ["1,0,0.5,0.8,0.9,0.7,0.75,1,4.2", "1,2,0,0,0,0,0,0,4.2", "2,0,1,1,0.3,0.2,0.3,1,4.2"]


def written(folder, *lines, name="cars.csv"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_every_detector_that_has_a_confidence_is_read(tmp_path):
    found = read_detections(written(tmp_path, HEADER, *ROWS))
    assert found.frame.tolist() == ["1", "1", "2"]
    assert found.label_line.tolist() == [0, 2, 0]
    first, second = found.detectors
    assert (first.name, second.name) == ("a", "b")
    assert first.performance.tolist() == pytest.approx([0.4, 0.0, 1.0])
    assert first.in_range.tolist() == [True, True, True]  # not told: all are
    assert second.in_range.tolist() == [True, False, True]
    assert found.about == {}


def test_what_is_told_of_frames_comes_from_beside_or_from_where_it_is_named(tmp_path):
    cars = written(tmp_path, "frame,label_line,split,a_confidence,a_iou3d", "1,0,val,1,1", "2,0,val,1,1")
    assert read_detections(cars).about["split"].tolist() == ["val", "val"]
    written(tmp_path, "frame,split,drive", "2,train,x", "1,val,y", "3,val,y", name="frames.csv")
    about = read_detections(cars).about
    assert about["split"].tolist() == ["val", "train"]
    assert about["drive"].tolist() == ["y", "x"]
    other = written(tmp_path, "frame,label_kind", "1,object", "2,tracking", name="other.csv")
    about = read_detections(cars, other).about
    assert about["label_kind"].tolist() == ["object", "tracking"]
    assert "drive" not in about


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        ([HEADER, *ROWS, ROWS[1]], "cars.csv:5: frame 1, label_line 2 is in line 3 already"),
        ([HEADER.replace("label_line", "label_lin"), *ROWS], "no column 'label_line'; did you mean 'label_lin'?"),
        ([HEADER.replace("a_iou3d", "a_iou_3d"), *ROWS], "no column 'a_iou3d'; did you mean 'a_iou_3d'?"),
        ([HEADER.replace("_confidence", "_score"), *ROWS], "no column NAME_confidence; it has frame, label_line"),
        ([HEADER.replace("a_iou3d", "a_confidence"), *ROWS], "has two columns 'a_confidence'"),
        ([HEADER, ROWS[0].replace("0.5", "1.5")], "cars.csv:2: a_confidence is '1.5'; allowed: 0 to 1"),
        ([HEADER, ROWS[0].replace("0.8", "nan")], "cars.csv:2: a_iou3d is 'nan'; allowed: 0 to 1"),
        ([HEADER, ROWS[0].replace("0.75", "-1")], "cars.csv:2: b_iou_bev is '-1'; allowed: 0 to 1"),
        ([HEADER, ROWS[0].replace(",1,4.2", ",0.5,4.2")], "cars.csv:2: b_in_range is 0.5; allowed: 0 or 1"),
        ([HEADER, ROWS[0].replace("1,0,", "1,1.0,", 1)], "cars.csv:2: label_line is '1.0'; allowed: a whole number"),
        ([HEADER, ROWS[0].replace("1,0,", "1,-1,", 1)], "cars.csv:2: label_line is '-1'; allowed: a whole number"),
        ([HEADER, ROWS[0].replace("1,0,", " ,0,", 1)], "cars.csv:2: frame is empty"),
        ([HEADER, "", ROWS[0] + ",7"], "cars.csv:3: 10 fields; the header has 9"),
        ([HEADER], "has no row below its header"),
        ([""], "has no row below its header"),
    ],
)
def test_a_row_or_column_that_cannot_be_used_is_named_in_one_line(tmp_path, lines, told):
    with pytest.raises(InputError, match=re.escape(told)) as caught:
        read_detections(written(tmp_path, *lines))
    assert "\n" not in str(caught.value)
    assert "cars.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (["frame,split", "1,val", "1,val"], "frames.csv:3: frame 1 is in line 2 already"),
        (["frame,split", "1,val"], "cars.csv:4: frame 2 has no row in"),
        (["split", "val"], "frames.csv: has no column 'frame'; it has split"),
        (["frame,split", "1,", "2,val"], "frames.csv:2: split is empty"),
    ],
)
def test_a_table_of_frames_that_cannot_be_used_is_named_too(tmp_path, lines, told):
    written(tmp_path, *lines, name="frames.csv")
    with pytest.raises(InputError, match=re.escape(told)):
        read_detections(written(tmp_path, HEADER, *ROWS))


def test_files_that_are_not_there_or_no_tables_are_refused(tmp_path):
    with pytest.raises(MissingFileError, match="there is no such file"):
        read_detections(tmp_path / "none.csv")
    with pytest.raises(InputError, match="cannot be read"):
        read_detections(tmp_path)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(bytes(range(256)) * 4)
    with pytest.raises(BlenderLidarError) as caught:
        read_detections(binary)
    assert "\n" not in str(caught.value)
    cars = written(tmp_path, HEADER, *ROWS)
    with pytest.raises(MissingFileError, match=r"nowhere.csv: there is no such file"):
        read_detections(cars, tmp_path / "nowhere.csv")


def test_long_names_of_frames_and_detectors_stay_whole(tmp_path):
    frame, detector = "sweep_" * 12, "a_detector_of_three_ensembles_and_more"
    cars = written(tmp_path, f"frame,label_line,{detector}_confidence,{detector}_iou3d", f"{frame},0,1,1")
    found = read_detections(cars)
    assert found.frame.tolist() == [frame]
    assert [one.name for one in found.detectors] == [detector]
