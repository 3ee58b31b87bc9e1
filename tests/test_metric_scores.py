"""`score` with other metrics than PE-VGOP: what is asked for is made, what a cloud cannot give is said."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest

from blender_lidar.metrics.catalogue import METRICS
from tests.small_scene import cli, done


@pytest.fixture
def cloud(tmp_path):
    """Words for `score`: a car 5 m from the origin with four returns, a van with none."""
    rows = ["frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg"]
    rows += ["0,7,car,3.0,4.0,4.0,2.0,1.5,0.0", "0,9,van,30.0,40.0,5.0,2.0,2.0,0.0"]
    (tmp_path / "boxes.csv").write_text("\n".join(rows) + "\n")
    points = np.array([[3.05, 3.05, 0.75], [3.06, 3.05, 0.75], [4.05, 3.05, 0.75], [4.55, 3.05, 0.75]])
    np.savez(tmp_path / "cloud.npz", xyz=points)
    return ["score", "--points", tmp_path / "cloud.npz", "--boxes", tmp_path / "boxes.csv", "--assign", "box"]


def test_score_adds_the_metrics_that_are_asked_for(cloud, capsys, tmp_path):
    asked = ["--metric", "log-points", "--metric", "voxel-entropy-0.1", "--metric", "distance", "--metric", "pe-vgop"]
    code, out, err = cli(capsys, *cloud, *asked, "--lidar", 0, 0, "--json", "--out", tmp_path / "scores.csv")
    assert (code, err) == (0, "")
    scores = json.loads(out)
    car, van = scores["vehicles"]
    assert car["log_points"] == pytest.approx(math.log(5.0))
    assert car["voxel_entropy_0.1"] == pytest.approx(1.5)  # two of four returns share a voxel
    assert (car["distance"], van["distance"]) == pytest.approx((5.0, 50.0))
    assert van["log_points"] == 0.0
    assert list(scores["metrics"]) == ["log-points", "voxel-entropy-0.1", "distance", "pe-vgop"]
    assert scores["metrics"]["distance"] == {"column": "distance", "unit": "m", "per_vehicle": pytest.approx(27.5)}
    assert scores["metrics"]["pe-vgop"]["per_vehicle"] == scores["entropy_bits_per_vehicle"]
    with (tmp_path / "scores.csv").open(newline="") as stream:
        assert float(next(csv.DictReader(stream))["voxel_entropy_0.1"]) == car["voxel_entropy_0.1"]
    _, text, _ = cli(capsys, *cloud, *asked, "--lidar", 0, 0)
    lines = text.splitlines()
    assert lines[0].split()[-3:] == ["log-points", "voxel-entropy-0.1", "distance"]
    assert lines[1].split()[-3:] == ["1.6094", "1.5000", "5.000"]
    assert "distance: 27.500 m per vehicle" in lines


def test_score_tells_the_detectable_share_in_per_cent(cloud, capsys):
    out, _ = done(capsys, *cloud, "--metric", "detectable", "--json")
    scores = json.loads(out)
    assert scores["metrics"] == {
        "detectable": {"column": "detectable", "unit": "", "per_vehicle": scores["detectable_share"]}
    }
    out, _ = done(capsys, *cloud, "--metric", "detectable")
    assert f"detectable: {100.0 * scores['detectable_share']:.2f} %\n" in out


def test_score_offers_the_metrics_that_it_can_make_and_no_others(capsys):
    out, _ = done(capsys, "score", "--help")
    offered = "".join(out.split()).split("FILE.py:NAME,")[1].split("output:")[0]
    assert offered.split(",") == list(METRICS)


def test_score_says_no_more_than_before_unless_asked(cloud, capsys):
    _, out, _ = cli(capsys, *cloud, "--json")
    scores = json.loads(out)
    assert set(scores) == {"points", "entropy_bits_per_vehicle", "detectable_share", "vehicles"}
    columns = ["frame", "vehicle_id", "class", "points", "p_top", "p_side", "p_front", "entropy_bits", "detectable"]
    assert list(scores["vehicles"][0]) == columns
    _, text, _ = cli(capsys, *cloud)
    assert text.splitlines()[0] == "vehicle  class       points   p_top  p_side p_front  entropy  detectable"


def test_score_with_all_metrics_leaves_out_what_the_cloud_cannot_give_and_says_so(cloud, capsys):
    out, err = done(capsys, *cloud, "--metric", "all", "--json")
    assert set(json.loads(out)["metrics"]) == {*METRICS} - {"distance"}
    assert err.startswith("blender-lidar: note: left out: ")
    assert "distance" in err
    out, _ = done(capsys, *cloud, "--metric", "all", "--lidar", 1.0, 2.0, "--json")
    assert set(json.loads(out)["metrics"]) == {*METRICS}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--metric", "log-point"], "--metric: unknown metric 'log-point'; did you mean 'log-points'?"),
        (["--metric", "distance"], "--metric: distance needs to know where the LiDAR is; give --lidar X Y"),
        (["--metric", "distance", "--lidar", "nan", "0"], "--lidar: is nan; allowed: a number"),
    ],
)
def test_metrics_that_score_cannot_make_are_refused(cloud, capsys, words, expected):
    code, out, err = cli(capsys, *cloud, *words)
    assert (code, out) == (2, "")
    assert expected in err
