"""The metrics against slow loops, the properties that their docstrings claim, and what `score` makes of them."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.research  # noqa: F401
from blender_lidar.errors import InputError
from blender_lidar.metrics.catalogue import METRICS, metric_named
from blender_lidar.metrics.metric import NEEDS_POINTS, vehicle_returns
from blender_lidar.metrics.vgop import pe_vgop, to_vehicle_frame
from rival_metrics import OPTIONS, spread
from tests.small_scene import cli, done

pytestmark = pytest.mark.versions

EVERY = METRICS | {name: metric_named(option) for name, option in OPTIONS.items()}
"""Those of the catalogue, and their rivals from the plug-in."""
OF_RETURNS = [name for name in EVERY if EVERY[name].needs <= {NEEDS_POINTS}]
"""Metrics of a vehicle's returns alone."""
GROW_WITH_POINTS = (
    *("view-coverage", "sum_of_views", "number_of_returns", "log_returns"),
    *("areal_density", "volumetric_density", "voxel_occupancy"),
)


def cloud(seed, vehicles=6, points=400, spread=1.05):
    """Returns within and about boxes, the last of which gets none."""
    rng = np.random.default_rng(seed)
    size = rng.uniform([1.5, 0.5, 1.0], [12.0, 2.6, 4.0], (vehicles, 3))
    vehicle = rng.integers(0, vehicles - 1, points)
    local = rng.uniform(-0.5, 0.5, (points, 3)) * size[vehicle] * spread
    return local, vehicle, size, rng.uniform(3.0, 90.0, vehicles)


# --- oracles: one vehicle at a time, in plain Python ------------------------------------------------------------------


def slow_cells(points, size, cell):
    """Cells of the returns that are not dropped, and how many there are along each side."""
    n = [max(1, math.ceil(side / cell - 1e-9)) for side in size]
    kept = []
    for point in points:
        index = [math.floor((x + side / 2) / cell) for x, side in zip(point, size, strict=True)]
        if all(-1 <= i <= count for i, count in zip(index, n, strict=True)):
            kept.append(tuple(min(max(i, 0), count - 1) for i, count in zip(index, n, strict=True)))
    return kept, n


def slow_views(points, size, cell=0.05):
    cells, n = slow_cells(points, size, cell)
    return [len({(c[a], c[b]) for c in cells}) / (n[a] * n[b]) for a, b in ((0, 1), (0, 2), (1, 2))]


def slow_bits(shares):
    return -sum(p * math.log2(p) for p in shares if p > 0)


def slow_coverage(points, size):
    top, side, front = (1.5 * share / (share + 0.5) for share in slow_views(points, size, 0.2))
    return (top + math.sqrt(side**2 + front**2)) / (1.0 + math.sqrt(2.0))


def slow_voxel_entropy(points, size, voxel):
    cells, _ = slow_cells(points, size, voxel)
    return slow_bits([count / len(cells) for count in Counter(cells).values()])


def slow_voxel_share(points, size):
    cells, n = slow_cells(points, size, 0.1)
    return len(set(cells)) / math.prod(n)


def slow_ap_entropy(points):
    precision = 0.001
    if len(points):
        precision = min(max(0.152 * math.log(len(points)) + 0.659, 0.001), 0.999)
    sigma = (1.0 - precision) / precision
    return math.log(2.0 * math.pi * math.e * sigma**2)  # of a normal distribution in the plane


SLOW = {
    "pe-vgop": lambda points, size, distance: slow_bits(slow_views(points, size)),
    "view-coverage": lambda points, size, distance: slow_coverage(points, size),
    "sum_of_views": lambda points, size, distance: sum(slow_views(points, size)),
    "number_of_returns": lambda points, size, distance: len(points),
    "log_returns": lambda points, size, distance: math.log(1 + len(points)),
    "areal_density": lambda points, size, distance: len(points) / size[0] / size[1],
    "volumetric_density": lambda points, size, distance: len(points) / size[0] / size[1] / size[2],
    "voxel_entropy_10_cm": lambda points, size, distance: slow_voxel_entropy(points, size, 0.1),
    "voxel_entropy_20_cm": lambda points, size, distance: slow_voxel_entropy(points, size, 0.2),
    "voxel_occupancy": lambda points, size, distance: slow_voxel_share(points, size),
    "voxel_occupancy_entropy": lambda points, size, distance: slow_bits([slow_voxel_share(points, size)]),
    "ap_entropy": lambda points, size, distance: slow_ap_entropy(points),
    "distance": lambda points, size, distance: distance,
}


@pytest.mark.parametrize("name", SLOW)
@pytest.mark.parametrize("spread", [0.9, 1.4])
def test_a_metric_equals_its_slow_loop(name, spread):
    points, vehicle, size, distance = cloud(3, spread=spread)
    values = EVERY[name].values(vehicle_returns(points, vehicle, size, distance))
    slow = [SLOW[name](points[vehicle == row].tolist(), size[row].tolist(), distance[row]) for row in range(len(size))]
    np.testing.assert_allclose(values, slow, rtol=1e-9, atol=1e-12)


def test_every_metric_of_returns_has_an_oracle():
    assert {*OF_RETURNS, "distance"} <= set(SLOW)


# --- properties -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*OF_RETURNS, "distance"])
def test_a_vehicle_is_scored_the_same_alone_and_among_others(name):
    points, vehicle, size, distance = cloud(4)
    together = EVERY[name].values(vehicle_returns(points, vehicle, size, distance))
    for row in range(len(size)):
        mine = points[vehicle == row]
        alone = vehicle_returns(mine, np.zeros(len(mine), dtype=int), size[row : row + 1], distance[row : row + 1])
        np.testing.assert_allclose(EVERY[name].values(alone), together[row : row + 1], rtol=1e-12)


@settings(max_examples=15)
@given(st.floats(-7, 7), st.floats(-500, 500), st.floats(-500, 500), st.integers(0, 2**32 - 1))
def test_moving_vehicle_and_points_together_changes_no_metric(heading, x, y, seed):
    rng = np.random.default_rng(seed)
    size = np.array([[4.4, 1.8, 1.4]])
    # Middles of cells of 0.05 m, which lie on no border of a voxel either: rounding cannot move them across.
    local = (rng.integers(0, np.array([88, 36, 28]), (200, 3)) + 0.5) * 0.05 - size / 2
    centre = np.array([x, y, 0.7])
    cos, sin = math.cos(heading), math.sin(heading)
    world = local @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + centre
    rows = np.zeros(len(local), dtype=int)
    before = vehicle_returns(local, rows, size)
    after = vehicle_returns(to_vehicle_frame(world, centre, heading), rows, size)
    for name in OF_RETURNS:
        np.testing.assert_array_equal(EVERY[name].values(after), EVERY[name].values(before), err_msg=name)


@settings(max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_metrics_that_claim_it_never_fall_when_returns_are_added(seed):
    points, vehicle, size, _ = cloud(seed)
    some, more = vehicle_returns(points[:150], vehicle[:150], size), vehicle_returns(points, vehicle, size)
    for name in (*GROW_WITH_POINTS, "ap_entropy"):
        metric = EVERY[name]
        assert (metric.merit(metric.values(more)) >= metric.merit(metric.values(some))).all(), name


def test_voxel_entropy_falls_when_returns_crowd_into_one_voxel_and_pe_vgop_when_a_view_fills():
    size = np.array([[4.0, 2.0, 1.6]])
    spread = np.array([[x, 0.05, 0.05] for x in np.arange(-1.95, 2.0, 0.1)])
    crowded = np.concatenate([spread, np.repeat(spread[:1], 500, axis=0)])
    grid = np.stack(np.meshgrid(*(np.arange(-s / 2 + 0.025, s / 2, 0.05) for s in size[0]), indexing="ij"), axis=-1)
    full = grid.reshape(-1, 3)
    third = full[np.isclose(full[:, 0] * 20 % 3, 0.5)]
    for name, fewer, more in (("voxel_entropy_10_cm", spread, crowded), ("pe-vgop", third, full)):
        less, value = (
            EVERY[name].values(vehicle_returns(points, np.zeros(len(points), dtype=int), size))[0]
            for points in (more, fewer)
        )
        assert less < value, name


@pytest.mark.parametrize("name", OF_RETURNS)
def test_no_vehicle_has_a_worse_value_than_one_without_returns(name):
    metric = EVERY[name]
    nothing = vehicle_returns(np.empty((0, 3)), np.empty(0, dtype=int), np.array([[4.5, 1.8, 1.5]]))
    value = metric.values(nothing)
    assert value.shape == (1,)
    assert np.isfinite(value).all()
    points, vehicle, size, _ = cloud(6)
    merits = metric.merit(metric.values(vehicle_returns(points, vehicle, size)))
    assert (merits >= metric.merit(value)).all()
    if name != "ap_entropy":
        assert value[0] == 0.0


@pytest.mark.parametrize("name", [*OF_RETURNS, "distance"])
def test_a_frame_without_vehicles_has_no_scores(name):
    nothing = vehicle_returns(np.empty((0, 3)), np.empty(0, dtype=int), np.empty((0, 3)), np.empty(0))
    assert EVERY[name].values(nothing).shape == (0,)


def test_boxes_with_more_voxels_along_a_side_than_memory_bears_are_refused():
    returns = vehicle_returns(np.zeros((1, 3)), np.zeros(1, dtype=int), np.full((1, 3), 1e3), cell_m=10.0)
    with pytest.raises(InputError, match=r"cell_m is 0\.0001; allowed: at least"):
        spread(returns, 1e-4)


def test_pe_vgop_in_the_catalogue_is_that_of_the_paper_to_the_last_bit():
    points, vehicle, size, _ = cloud(8)
    for reading in ("corrected", "paper"):
        of_catalogue = METRICS["pe-vgop"].values(vehicle_returns(points, vehicle, size, None, 0.07, reading))
        assert of_catalogue.tobytes() == pe_vgop(points, vehicle, size, 0.07, reading).tobytes()


def test_merit_turns_the_sign_of_metrics_in_which_lower_is_better():
    values = np.array([1.0, 2.0])
    for name, metric in EVERY.items():
        better_first = metric.merit(values)[0] > metric.merit(values)[1]
        assert better_first == (name in ("distance", "ap_entropy")), name


# --- what is refused --------------------------------------------------------------------------------------------------


def test_names_are_the_catalogues_and_an_unknown_one_is_refused_with_the_nearest():
    assert list(METRICS) == [metric.name for metric in METRICS.values()]
    assert metric_named("view-coverage") is METRICS["view-coverage"]
    with pytest.raises(InputError, match=r"--metric: unknown metric 'view-cover'; did you mean 'view-coverage'"):
        metric_named("view-cover", "--metric")


def test_a_metric_names_what_it_lacks():
    with pytest.raises(InputError, match="metric 'distance' needs the place of the LiDAR"):
        EVERY["distance"].values(vehicle_returns(np.zeros((1, 3)), np.zeros(1, dtype=int), np.array([[4.0, 2.0, 1.5]])))


# --- what score makes of them -----------------------------------------------------------------------------------------


@pytest.fixture
def scoring(tmp_path):
    """Words for `score`: a car 5 m from the origin with four returns, a van with none."""
    rows = ["frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg"]
    rows += ["0,7,car,3.0,4.0,4.0,2.0,1.5,0.0", "0,9,van,30.0,40.0,5.0,2.0,2.0,0.0"]
    (tmp_path / "boxes.csv").write_text("\n".join(rows) + "\n")
    points = np.array([[3.05, 3.05, 0.75], [3.06, 3.05, 0.75], [4.05, 3.05, 0.75], [4.55, 3.05, 0.75]])
    np.savez(tmp_path / "cloud.npz", xyz=points)
    return ["score", "--points", tmp_path / "cloud.npz", "--boxes", tmp_path / "boxes.csv", "--assign", "box"]


def test_score_adds_the_metrics_that_are_asked_for(scoring, capsys, tmp_path):
    asked = [OPTIONS["log_returns"], OPTIONS["voxel_entropy_10_cm"], OPTIONS["distance"], "pe-vgop"]
    asked = [word for name in asked for word in ("--metric", name)]
    code, out, err = cli(capsys, *scoring, *asked, "--lidar", 0, 0, "--json", "--out", tmp_path / "scores.csv")
    assert (code, err) == (0, "")
    scores = json.loads(out)
    car, van = scores["vehicles"]
    assert car["log_returns"] == pytest.approx(math.log(5.0))
    assert car["voxel_entropy_10_cm"] == pytest.approx(1.5)  # two of four returns share a voxel
    assert (car["distance"], van["distance"]) == pytest.approx((5.0, 50.0))
    assert van["log_returns"] == 0.0
    assert list(scores["metrics"]) == ["log_returns", "voxel_entropy_10_cm", "distance", "pe-vgop"]
    assert scores["metrics"]["distance"] == {"column": "distance", "unit": "m", "per_vehicle": pytest.approx(27.5)}
    assert scores["metrics"]["pe-vgop"]["per_vehicle"] == scores["entropy_bits_per_vehicle"]
    with (tmp_path / "scores.csv").open(newline="") as stream:
        assert float(next(csv.DictReader(stream))["voxel_entropy_10_cm"]) == car["voxel_entropy_10_cm"]
    _, text, _ = cli(capsys, *scoring, *asked, "--lidar", 0, 0)
    lines = text.splitlines()
    assert lines[0].split()[-3:] == ["log_returns", "voxel_entropy_10_cm", "distance"]
    assert lines[1].split()[-3:] == ["1.6094", "1.5000", "5.000"]
    assert "distance: 27.500 m per vehicle" in lines


def test_score_tells_the_detectable_share_in_per_cent(scoring, capsys):
    out, _ = done(capsys, *scoring, "--metric", "detectable", "--json")
    scores = json.loads(out)
    assert scores["metrics"] == {
        "detectable": {"column": "detectable", "unit": "", "per_vehicle": scores["detectable_share"]}
    }
    out, _ = done(capsys, *scoring, "--metric", "detectable")
    assert f"detectable: {100.0 * scores['detectable_share']:.2f} %\n" in out


def test_score_offers_the_metrics_that_it_can_make_and_no_others(capsys):
    out, _ = done(capsys, "score", "--help")
    offered = "".join(out.split()).split("FILE.py:NAME,")[1].split("output:")[0]
    assert offered.split(",") == list(METRICS)


def test_score_says_no_more_than_before_unless_asked(scoring, capsys):
    _, out, _ = cli(capsys, *scoring, "--json")
    scores = json.loads(out)
    assert set(scores) == {"points", "entropy_bits_per_vehicle", "detectable_share", "vehicles"}
    columns = ["frame", "vehicle_id", "class", "points", "p_top", "p_side", "p_front", "entropy_bits", "detectable"]
    assert list(scores["vehicles"][0]) == columns
    _, text, _ = cli(capsys, *scoring)
    assert text.splitlines()[0] == "vehicle  class       points   p_top  p_side p_front  entropy  detectable"


def test_score_with_all_metrics_has_those_of_the_catalogue_and_one_that_is_asked_for_besides(scoring, capsys):
    out, _ = done(capsys, *scoring, "--metric", "all", "--json")
    assert set(json.loads(out)["metrics"]) == {*METRICS}
    out, _ = done(capsys, *scoring, "--metric", "all", "--metric", OPTIONS["areal_density"], "--json")
    assert set(json.loads(out)["metrics"]) == {*METRICS, "areal_density"}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--metric", "pe-vgob"], "--metric: unknown metric 'pe-vgob'; did you mean 'pe-vgop'?"),
        (["--metric", OPTIONS["distance"]], "py:distance needs to know where the LiDAR is; give --lidar X Y"),
        (["--metric", OPTIONS["distance"], "--lidar", "nan", "0"], "--lidar: is nan; allowed: a number"),
    ],
)
def test_metrics_that_score_cannot_make_are_refused(scoring, capsys, words, expected):
    code, out, err = cli(capsys, *scoring, *words)
    assert (code, out) == (2, "")
    assert expected in err
