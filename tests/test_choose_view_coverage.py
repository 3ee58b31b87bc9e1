"""The choice of view coverage can be made again, from the training split alone."""

from __future__ import annotations

import csv
import runpy
import sys
from pathlib import Path

import pytest

from blender_lidar.metrics.view_coverage import CELL_M, HALF_SHARE

ROOT = Path(__file__).parents[1]
KITTI = ROOT.parent / "shared" / "data" / "kitti"
needs_kitti = pytest.mark.skipif(not KITTI.is_dir(), reason=f"no KITTI excerpt at {KITTI}")


def chosen(capsys, monkeypatch, detections):
    """What the script prints."""
    script = ROOT / "scripts" / "choose_view_coverage.py"
    monkeypatch.setattr(sys, "argv", [str(script), "--kitti", str(KITTI), "--detections", str(detections)])
    with pytest.raises(SystemExit) as stop:
        runpy.run_path(str(script), run_name="__main__")
    return stop.value.code, capsys.readouterr()


@needs_kitti
def test_cell_and_constant_are_the_best_of_their_form_and_no_car_of_the_other_split_has_a_say(
    tmp_path, capsys, monkeypatch
):
    code, told = chosen(capsys, monkeypatch, KITTI / "cars.csv")
    assert code == 0
    assert f"root of squares  cell {CELL_M:g} m, h {HALF_SHARE:g}: +0.0000" in told.out
    with (KITTI / "cars.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        if row["split"] != "train":
            row["second_confidence"] = row["pointpillars_iou3d"] = "0.5"
    with (tmp_path / "cars.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    assert chosen(capsys, monkeypatch, tmp_path / "cars.csv")[1].out == told.out


@needs_kitti
def test_a_table_without_a_training_split_is_refused_in_one_line(tmp_path, capsys, monkeypatch):
    table = tmp_path / "cars.csv"
    table.write_text("frame,label_line,a_confidence,a_iou3d\n000001,0,0.5,0.5\n", encoding="utf-8")
    code, told = chosen(capsys, monkeypatch, table)
    assert code == 2
    assert told.err.count("\n") == 1
    assert "no frame of split 'train'" in told.err
