"""The sheet of the charts: written whole or not at all, readable in grey; and what charts count, against loops."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import MissingExtraError, OutputError
from blender_lidar.report import figure as canvas
from blender_lidar.report.run_figures import cell_means, plot_convergence
from blender_lidar.traffic.boxes import corners_of
from tests.chart_samples import history, lightness, run_of, vehicles


def test_without_matplotlib_the_extra_to_install_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r'pip install "blender_lidar\[plots\]"'):
        plot_convergence(tmp_path / "chart.png", run_of(), history())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["chart.png", "no such folder/chart.png"])
def test_what_stands_in_the_way_stays_and_no_partial_file_is_left(name, tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    (tmp_path / "chart.png" / "inside").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"chart\.png: cannot be written") as caught:
        plot_convergence(tmp_path / name, run_of(), history())
    assert "\n" not in str(caught.value)
    assert [path.name for path in tmp_path.rglob("*")] == ["chart.png", "inside"]


def test_drawing_leaves_settings_backend_and_pyplot_alone(tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    script = (
        "import sys, matplotlib\n"
        "matplotlib.rcParams['font.size'] = 31.0\n"
        "before = dict(matplotlib.rcParams.items())\n"
        "from blender_lidar.report.run_figures import plot_convergence\n"
        "from tests.chart_samples import history, run_of\n"
        f"plot_convergence({str(tmp_path / 'chart.png')!r}, run_of(), history())\n"
        "assert dict(matplotlib.rcParams.items()) == before\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    environment = {**os.environ, "MPLBACKEND": "svg"}
    subprocess.run([sys.executable, "-c", script], check=True, env=environment)


def test_the_users_own_settings_do_not_change_a_chart(tmp_path):
    matplotlib = pytest.importorskip("matplotlib", reason="charts need matplotlib")
    plot_convergence(tmp_path / "plain.png", run_of(), history())
    with matplotlib.rc_context({"axes.facecolor": "black", "font.size": 20.0}):
        plot_convergence(tmp_path / "own.png", run_of(), history())
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "own.png").read_bytes()


@pytest.mark.parametrize("part", [canvas.SCORE_COLOURS, canvas.BLIND_COLOURS, canvas.HEIGHT_COLOURS])
def test_the_colour_maps_keep_their_order_in_grey(part):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    steps = np.diff(lightness(canvas.colours(part)(np.linspace(0.0, 1.0, 64))))
    assert (steps > 0.0).all() or (steps < 0.0).all()
    assert abs(steps.sum()) > 0.4


def test_baseline_and_optimised_differ_in_grey_and_in_shape():
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    before, after = canvas.BASELINE_LOOK, canvas.OPTIMISED_LOOK
    assert abs(lightness(before["color"]) - lightness(after["color"])) > 0.25
    assert lightness(before["color"]) < 0.65  # still dark enough on white paper
    assert before["linestyle"] != after["linestyle"]
    assert before["marker"] != after["marker"]


@given(seed=st.integers(0, 2**32 - 1), number=st.integers(0, 80))
def test_means_of_cells_equal_a_loop_over_the_cells_without_what_is_unknown(seed, number):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-12.0, 12.0, number), rng.uniform(-2.0, 12.0, number)
    values = np.where(rng.random(number) < 0.2, np.nan, rng.random(number))
    x_edges, y_edges = np.arange(-10.0, 11.0, 5.0), np.arange(0.0, 10.1, 3.0)
    share = cell_means(values, (y, x), (y_edges, x_edges))
    assert share.shape == (len(y_edges) - 1, len(x_edges) - 1)
    for row in range(share.shape[0]):
        for column in range(share.shape[1]):
            inside = [
                values[i]
                for i in range(number)
                if x_edges[column] <= x[i] < x_edges[column + 1]
                and y_edges[row] <= y[i] < y_edges[row + 1]
                and not math.isnan(values[i])
            ]
            np.testing.assert_allclose(share[row, column], np.mean(inside) if inside else math.nan, rtol=1e-13)


def test_footprints_equal_corners_turned_one_by_one():
    boxes = vehicles(11, 20)
    corners = corners_of(boxes)
    for index in range(20):
        x, y, _ = boxes.centre_m[index]
        length, width, _ = boxes.size_m[index]
        turn = complex(math.cos(boxes.heading_rad[index]), math.sin(boxes.heading_rad[index]))
        for corner, (along, left) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            point = complex(x, y) + turn * complex(along * length / 2, left * width / 2)
            np.testing.assert_allclose(corners[index, corner], (point.real, point.imag), atol=1e-12)


def test_a_matplotlib_that_is_too_old_is_told_in_one_line(tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib", reason="charts need matplotlib")
    monkeypatch.setattr(matplotlib, "__version_info__", (3, 6, 3, "final", 0))
    message = "^charts need matplotlib 3.7 or later, and .* is installed$"
    with pytest.raises(MissingExtraError, match=message), canvas.sheet(tmp_path / "a.png", 80.0, "title", ""):
        pass
