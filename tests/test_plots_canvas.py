"""The sheet of the charts: written whole or not at all, on settings of its own, and readable in grey."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from blender_lidar.errors import MissingExtraError, OutputError
from blender_lidar.plots import canvas
from blender_lidar.plots.convergence import plot_convergence
from tests.chart_samples import chart_arguments, lightness


def test_without_matplotlib_the_extra_to_install_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r'pip install "blender_lidar\[plots\]"'):
        plot_convergence(tmp_path / "chart.png", [1], [0.5], [0.5])
    assert not list(tmp_path.iterdir())


def test_a_folder_in_the_way_stays_and_no_partial_file_is_left(tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    target = tmp_path / "chart.png"
    (target / "inside").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"chart\.png: the chart cannot be written"):
        plot_convergence(target, [1], [0.5], [0.5])
    assert [path.name for path in tmp_path.iterdir()] == ["chart.png"]
    assert (target / "inside").is_dir()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_refused(tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(OutputError, match="cannot be written"):
            plot_convergence(tmp_path / "chart.png", [1], [0.5], [0.5])
        assert not list(tmp_path.iterdir())
    finally:
        tmp_path.chmod(0o700)


def test_a_failed_drawing_keeps_the_older_chart(tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    target = tmp_path / "chart.png"
    target.write_bytes(b"older")
    with pytest.raises(RuntimeError), canvas.sheet(target, 50.0):
        raise RuntimeError
    assert target.read_bytes() == b"older"
    assert [path.name for path in tmp_path.iterdir()] == ["chart.png"]


def test_drawing_leaves_settings_backend_and_pyplot_alone(tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    script = (
        "import sys, matplotlib\n"
        "matplotlib.rcParams['font.size'] = 31.0\n"
        "before = dict(matplotlib.rcParams.items())\n"
        "from blender_lidar.plots.convergence import plot_convergence\n"
        f"plot_convergence({str(tmp_path / 'chart.png')!r}, [1, 2], [0.4, 0.5], [0.4, 0.5])\n"
        "assert dict(matplotlib.rcParams.items()) == before\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    environment = {**os.environ, "MPLBACKEND": "svg"}
    subprocess.run([sys.executable, "-c", script], check=True, env=environment)


def test_the_users_own_settings_do_not_change_a_chart(tmp_path):
    matplotlib = pytest.importorskip("matplotlib", reason="charts need matplotlib")
    plot_convergence(tmp_path / "plain.png", [1, 2], [0.4, 0.5], [0.4, 0.5])
    with matplotlib.rc_context({"axes.facecolor": "black", "font.size": 20.0}):
        plot_convergence(tmp_path / "own.png", [1, 2], [0.4, 0.5], [0.4, 0.5])
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "own.png").read_bytes()


def test_importing_the_charts_does_not_import_matplotlib():
    modules = ", ".join(sorted({plot.__module__ for plot, _ in chart_arguments().values()}))
    script = f"import sys, {modules}; sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_an_axes_is_placed_in_millimetres(tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    with canvas.sheet(tmp_path / "chart.png", 80.0, to_scale=True) as figure:
        axes = canvas.place(figure, 10.0, 20.0, 100.0, 40.0)
    x0, y0, x1, y1 = axes.get_window_extent().extents / canvas.DPI * canvas.MM_PER_INCH
    np.testing.assert_allclose((x0, y0, x1, y1), (10.0, 20.0, 110.0, 60.0), atol=1e-6)


@pytest.mark.parametrize("part", [canvas.SCORE_COLOURS, canvas.BLIND_COLOURS, canvas.HEIGHT_COLOURS])
def test_the_colour_maps_keep_their_order_in_grey(part):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    steps = np.diff(lightness(canvas.colours(part)(np.linspace(0.0, 1.0, 64))))
    assert (steps > 0.0).all() or (steps < 0.0).all()
    assert abs(steps.sum()) > 0.4


def test_baseline_and_optimised_differ_in_grey_and_in_shape():
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    before, after = canvas.BASELINE, canvas.OPTIMISED
    assert abs(lightness(before["color"]) - lightness(after["color"])) > 0.25
    assert lightness(before["color"]) < 0.65  # still dark enough on white paper
    assert before["linestyle"] != after["linestyle"]
    assert before["marker"] != after["marker"]
