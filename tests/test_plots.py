"""The charts: what they count, how they look in grey, and that a PNG is written whole or not at all."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError, MissingExtraError, OutputError
from blender_lidar.plots import binning, canvas
from blender_lidar.plots.blind_zones import plot_blind_zones
from blender_lidar.plots.by_distance import FEWEST_VEHICLES, plot_by_distance
from blender_lidar.plots.clouds import plot_clouds
from blender_lidar.plots.convergence import plot_convergence
from blender_lidar.plots.occupancy import OccupancyViews, plot_occupancy
from blender_lidar.plots.score_map import plot_score_map

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
CAR = (4.5, 1.8, 1.5)
ROAD = (2.0, 20.3)


def vehicles(seed: int, number: int = 200) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-50.0, 50.0, number), rng.uniform(*ROAD, number)
    return {
        "x_m": x,
        "y_m": y,
        "length_m": rng.uniform(4.0, 12.0, number),
        "width_m": rng.uniform(1.6, 2.5, number),
        "heading_deg": rng.normal(0.0, 2.0, number),
        "distance_m": np.hypot(x, y),
        "detectable": rng.random(number) < 0.6,
        "entropy_bits": rng.uniform(0.0, 1.2, number),
    }


def cloud(seed: int, number: int = 500) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {"xyz": rng.uniform((-50, 2, 0), (50, 20, 3), (number, 3)), "vehicle_id": rng.integers(-1, 5, number)}


def views(share: float, size: tuple[float, float, float] = CAR) -> OccupancyViews:
    rng = np.random.default_rng(3)
    length, width, height = (math.ceil(side / 0.05) for side in size)
    shapes = {"top": (length, width), "side": (length, height), "front": (width, height)}
    return OccupancyViews({view: rng.random(shape) < share for view, shape in shapes.items()}, size)


def score_map_arguments() -> dict[str, object]:
    height, tilt = np.linspace(2.0, 4.5, 6), np.linspace(0.0, 25.0, 6)
    value = 0.8 - 0.05 * (height[:, None] - 4.0) ** 2 - 0.0005 * (tilt - 18.0) ** 2
    return {
        "height_m": height,
        "tilt_deg": tilt,
        "value": value,
        "optimum": (4.0, 18.0),
        "baseline": (2.0, 0.0),
        "baseline_value": float(value[0, 0]),
    }


def chart_arguments() -> dict[str, tuple[object, dict[str, object]]]:
    """Every chart with small arguments of its own."""
    table, other = vehicles(1), vehicles(2)
    both = {"baseline_table": table, "optimised_table": other}
    boxes = vehicles(4, 12)
    seen = np.arange(12) % 3 > 0
    best = np.maximum.accumulate(np.random.default_rng(5).random(50))
    return {
        "convergence": (
            plot_convergence,
            {"evaluation": np.arange(1, 51), "value": best - 0.1, "best": best, "baseline": 0.2},
        ),
        "score_map": (plot_score_map, score_map_arguments()),
        "by_distance": (plot_by_distance, both),
        "blind_zones": (plot_blind_zones, {**both, "sensor_xy": (0.0, 0.0), "carriageway": ROAD}),
        "clouds": (
            plot_clouds,
            {
                "clouds": (cloud(6), cloud(7)),
                "boxes": boxes,
                "detectable": (seen, ~seen),
                "sensor_xy": (0.0, 0.0),
            },
        ),
        "occupancy": (plot_occupancy, {"before": views(0.02), "after": views(0.1)}),
    }


CHARTS = sorted(chart_arguments())


@pytest.fixture
def pixels():
    """A function that decodes a PNG as (rows, columns) of lightness, 0 to 1, having checked its signature."""
    image = pytest.importorskip("matplotlib.image", reason="charts need matplotlib")

    def read(path: Path) -> np.ndarray:
        assert path.read_bytes().startswith(PNG_SIGNATURE)
        return image.imread(path)[..., :3] @ (0.299, 0.587, 0.114)

    return read


@pytest.fixture
def figures(monkeypatch):
    """The figures saved during a test, in order; they are written all the same."""
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    saved, save = [], canvas.save

    def keep(figure, path):
        save(figure, path)
        saved.append(figure)

    monkeypatch.setattr(canvas, "save", keep)
    return saved


def words(figure) -> str:
    """Everything that is written on a figure."""
    from matplotlib.text import Text

    return "\n".join(text.get_text() for text in figure.findobj(Text))


# --- what the charts count ---------------------------------------------------------------------------------------

table_rows = st.lists(
    st.tuples(
        st.floats(0.0, 200.0),
        st.booleans(),
        st.one_of(st.just(math.nan), st.floats(0.0, 1.6)),
    ),
    max_size=60,
)


@settings(deadline=None)
@given(rows=table_rows, band_m=st.sampled_from([1.7, 5.0, 10.0, 33.3]))
def test_distance_bands_equal_a_loop_over_the_vehicles(rows, band_m):
    distance, detectable, entropy = (
        (np.array(column, dtype=float) for column in zip(*rows, strict=True)) if rows else (np.empty((3, 0)))
    )
    number = binning.band_count(distance, band_m)
    bands = binning.distance_bands(distance, detectable, entropy, band_m, number)
    members: list[list[tuple[float, bool, float]]] = [[] for _ in range(number)]
    for row in rows:
        members[math.floor(row[0] / band_m)].append(row)
    for band, inside in enumerate(members):
        known = [entropy for _, _, entropy in inside if not math.isnan(entropy)]
        assert bands.count[band] == len(inside)
        share = sum(seen for _, seen, _ in inside) / len(inside) if inside else math.nan
        np.testing.assert_array_equal(bands.detectable_share[band], share)
        np.testing.assert_array_equal(bands.entropy_bits[band], sum(known) / len(known) if known else math.nan)
        assert bands.centre_m[band] == (band + 0.5) * band_m


def test_a_distance_on_the_border_belongs_to_the_farther_band():
    bands = binning.distance_bands(np.array([0.0, 10.0, 19.9]), np.ones(3), np.ones(3), 10.0, 2)
    np.testing.assert_array_equal(bands.count, [1, 2])


@settings(deadline=None)
@given(
    low=st.floats(-1e3, 1e3),
    length=st.floats(0.0, 300.0),
    step=st.floats(0.1, 20.0),
    anchor=st.floats(-30.0, 30.0),
)
def test_covering_edges_hold_the_range_and_no_whole_cell_more(low, length, step, anchor):
    high = low + length
    edges = binning.covering_edges(low, high, step, anchor)
    assert edges[0] <= low
    assert high <= edges[-1]
    tolerance = 1e-9 * (abs(low) + length + abs(anchor) + step)
    assert low - edges[0] <= step + tolerance
    assert edges[-1] - high <= step + tolerance
    np.testing.assert_allclose(np.diff(edges), step, rtol=1e-9, atol=1e-9)


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), number=st.integers(0, 80))
def test_cell_shares_equal_a_loop_over_the_cells(seed, number):
    rng = np.random.default_rng(seed)
    x, y, counted = rng.uniform(-12.0, 12.0, number), rng.uniform(-2.0, 12.0, number), rng.random(number) < 0.5
    x_edges, y_edges = np.arange(-10.0, 11.0, 5.0), np.arange(0.0, 10.1, 3.0)
    share = binning.cell_shares(x, y, counted, x_edges, y_edges)
    assert share.shape == (len(y_edges) - 1, len(x_edges) - 1)
    for row in range(share.shape[0]):
        for column in range(share.shape[1]):
            inside = [
                bool(counted[i])
                for i in range(number)
                if x_edges[column] <= x[i] < x_edges[column + 1] and y_edges[row] <= y[i] < y_edges[row + 1]
            ]
            np.testing.assert_array_equal(share[row, column], np.mean(inside) if inside else math.nan)


def test_footprints_equal_corners_turned_one_by_one():
    table = vehicles(11, 20)
    names = ("x_m", "y_m", "length_m", "width_m", "heading_deg")
    corners = binning.footprints(*(table[name] for name in names))
    for index in range(20):
        x, y, length, width, heading = (float(table[name][index]) for name in names)
        turn = complex(math.cos(math.radians(heading)), math.sin(math.radians(heading)))
        for corner, (along, left) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            point = complex(x, y) + turn * complex(along * length / 2, left * width / 2)
            np.testing.assert_allclose(corners[index, corner], (point.real, point.imag), atol=1e-12)


@settings(deadline=None)
@given(best=st.floats(-1, 2), baseline=st.floats(-1, 2), share=st.floats(0, 1))
def test_the_near_best_threshold_gives_up_that_share_of_the_gain_and_never_more(best, baseline, share):
    threshold = binning.near_best_threshold(best, baseline, share)
    assert threshold <= best
    if baseline >= best:
        assert threshold == best
    else:
        assert best - threshold == pytest.approx(share * (best - baseline), abs=1e-12)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"a": [1.0]}, "no column 'b'; needed: a, b"),
        ({"a": [1.0], "b": [1.0, 2.0]}, "column 'b' has shape"),
        ({"a": [1.0], "b": ["car"]}, "not numeric"),
        ({"a": [1.0], "b": [math.nan]}, "column 'b' holds a value that is not a finite number"),
        ({"a": 1.0, "b": 2.0}, "column 'a' has shape"),
    ],
)
def test_a_table_that_cannot_be_counted_is_refused_by_column(table, message):
    with pytest.raises(InputError, match=message) as caught:
        binning.columns(table, ("a", "b"), "vehicles")
    assert str(caught.value).startswith("vehicles: ")
    assert "\n" not in str(caught.value)


def test_nan_passes_only_in_the_columns_that_may_hold_it():
    table = {"a": [1.0, 2.0], "b": [math.nan, 1.0]}
    assert math.isnan(binning.columns(table, ("a", "b"), "vehicles", may_be_nan=("b",))["b"][0])


# --- every chart -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_is_a_png_of_the_printed_size_with_something_on_it(name, tmp_path, pixels):
    plot, arguments = chart_arguments()[name]
    plot(tmp_path / "chart.png", **arguments, title="Title", subtitle="Subtitle")
    grey = pixels(tmp_path / "chart.png")
    assert grey.shape[1] == pytest.approx(canvas.WIDTH_MM / canvas.MM_PER_INCH * canvas.DPI, abs=1)
    assert 0.01 < np.mean(grey < 0.9) < 0.9
    assert [path.name for path in tmp_path.iterdir()] == ["chart.png"]


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_leaves_its_inputs_alone_and_repeats_byte_for_byte(name, tmp_path, pixels):
    plot, arguments = chart_arguments()[name]
    plot(tmp_path / "first.png", **arguments)
    untouched = chart_arguments()[name][1]
    assert repr(arguments) == repr(untouched)
    np.testing.assert_equal(
        {key: value for key, value in arguments.items() if not isinstance(value, OccupancyViews)},
        {key: value for key, value in untouched.items() if not isinstance(value, OccupancyViews)},
    )
    plot(tmp_path / "second.png", **untouched)
    assert (tmp_path / "first.png").read_bytes() == (tmp_path / "second.png").read_bytes()


@pytest.mark.parametrize("name", CHARTS)
def test_every_axis_says_what_it_measures_and_in_which_unit(name, tmp_path, figures):
    plot, arguments = chart_arguments()[name]
    plot(tmp_path / "chart.png", **arguments)
    labels = [label for axes in figures[0].axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert all("[" in label or label.startswith("Evaluations") for label in labels)
    assert labels or "1 m; a cell is 0.05 m by 0.05 m" in words(figures[0])


@pytest.mark.parametrize("name", CHARTS)
def test_headings_legend_and_panels_do_not_cover_each_other(name, tmp_path, figures):
    plot, arguments = chart_arguments()[name]
    plot(tmp_path / "chart.png", **arguments, title="A title", subtitle="And a subtitle")
    figure = figures[0]
    panels = [axes.get_tightbbox() for axes in figure.axes]
    around = [legend.get_window_extent() for legend in figure.legends] + [figure._suptitle.get_window_extent()]
    for index, box in enumerate(panels):
        assert not any(box.overlaps(other) for other in panels[index + 1 :] + around)
        assert box.x0 >= 0.0
        assert box.y0 >= 0.0
        assert box.x1 <= figure.bbox.x1
        assert box.y1 <= figure.bbox.y1


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_that_cannot_be_written_says_where_and_leaves_nothing(name, tmp_path):
    pytest.importorskip("matplotlib", reason="charts need matplotlib")
    plot, arguments = chart_arguments()[name]
    with pytest.raises(OutputError, match="cannot be written") as caught:
        plot(tmp_path / "no such folder" / "chart.png", **arguments)
    assert "no such folder" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


# --- the sheet ---------------------------------------------------------------------------------------------------


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


def test_the_users_own_settings_do_not_change_a_chart(tmp_path, pixels):
    import matplotlib

    plot_convergence(tmp_path / "plain.png", [1, 2], [0.4, 0.5], [0.4, 0.5])
    with matplotlib.rc_context({"axes.facecolor": "black", "font.size": 20.0}):
        plot_convergence(tmp_path / "own.png", [1, 2], [0.4, 0.5], [0.4, 0.5])
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "own.png").read_bytes()


def test_importing_the_charts_does_not_import_matplotlib():
    modules = ", ".join(f"blender_lidar.plots.{name}" for name in CHARTS)
    script = f"import sys, {modules}; sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", script], check=True)


def test_an_axes_is_placed_in_millimetres(tmp_path, figures):
    with canvas.sheet(tmp_path / "chart.png", 80.0, to_scale=True) as figure:
        axes = canvas.place(figure, 10.0, 20.0, 100.0, 40.0)
    x0, y0, x1, y1 = axes.get_window_extent().extents / canvas.DPI * canvas.MM_PER_INCH
    np.testing.assert_allclose((x0, y0, x1, y1), (10.0, 20.0, 110.0, 60.0), atol=1e-6)


# --- in grey -----------------------------------------------------------------------------------------------------


def lightness(colour) -> np.ndarray:
    from matplotlib.colors import to_rgba_array

    return to_rgba_array(colour)[:, :3] @ (0.299, 0.587, 0.114)


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


# --- one by one --------------------------------------------------------------------------------------------------


def test_convergence_leaves_out_candidates_without_a_value(tmp_path, figures):
    plot_convergence(tmp_path / "c.png", [1, 2, 3], [np.nan, -np.inf, 0.3], [np.nan, np.nan, 0.3], 0.1)
    dots = next(line for line in figures[0].axes[0].lines if line.get_label() == "one candidate")
    np.testing.assert_array_equal(dots.get_xdata(), [3.0])
    assert "at the end 0.300 bits" in words(figures[0])
    assert "baseline mounting (0.100 bits)" in words(figures[0])


@pytest.mark.parametrize("lengths", [(0, 0, 0), (2, 2, 1)])
def test_convergence_refuses_histories_without_rows_or_of_unequal_length(lengths, tmp_path):
    with pytest.raises(InputError, match="one length of at least 1"):
        plot_convergence(tmp_path / "c.png", *(np.zeros(length) for length in lengths))
    assert not list(tmp_path.iterdir())


def test_the_score_map_outlines_the_mountings_near_the_best(tmp_path, figures, monkeypatch):
    from matplotlib.axes import Axes

    levels, contour = [], Axes.contour

    def note(*args, **keywords):
        levels.append(keywords["levels"])
        return contour(*args, **keywords)

    monkeypatch.setattr(Axes, "contour", note)
    arguments = score_map_arguments()
    plot_score_map(tmp_path / "m.png", **arguments, region_share=0.2)
    best, base = arguments["value"].max(), arguments["baseline_value"]
    assert levels[-1] == [pytest.approx(best - 0.2 * (best - base))]
    assert "within 20 % of the gain" in words(figures[0])


def test_the_score_map_marks_a_mounting_off_the_map_at_its_edge(tmp_path, figures):
    plot_score_map(tmp_path / "m.png", **{**score_map_arguments(), "baseline": (1.5, -5.0)})
    marker = next(line for line in figures[0].axes[0].lines if "baseline" in line.get_label())
    assert (marker.get_xdata()[0], marker.get_ydata()[0]) == (0.0, 2.0)
    assert "baseline: 1.50 m, -5.0°, off the map" in words(figures[0])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"value": np.full((6, 6), 0.5), "baseline_value": 0.5}, "the whole map"),
        ({"optimum": (4.5, 25.0), "optimum_value": 2.0}, "smaller than a cell"),
        ({"value": np.where(np.arange(6) < 3, np.nan, score_map_arguments()["value"])}, "within 1 %"),
    ],
)
def test_the_score_map_copes_with_flat_steep_and_unfinished_maps(changes, text, tmp_path, figures):
    plot_score_map(tmp_path / "m.png", **{**score_map_arguments(), **changes})
    assert text in words(figures[0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"height_m": [2.0]}, "height_m must hold at least two rising values"),
        ({"tilt_deg": [0, 5, 5, 10, 15, 20]}, "tilt_deg must hold at least two rising values"),
        ({"value": np.zeros((6, 5))}, r"value has shape \(6, 5\)"),
        ({"value": np.full((6, 6), np.nan)}, "no value is finite"),
    ],
)
def test_the_score_map_refuses_a_grid_that_is_none(changes, message, tmp_path):
    with pytest.raises(InputError, match=message):
        plot_score_map(tmp_path / "m.png", **{**score_map_arguments(), **changes})
    assert not list(tmp_path.iterdir())


def test_bands_with_few_vehicles_are_hollow_and_not_averaged(tmp_path, figures):
    distance = np.repeat([5.0, 15.0, 25.0], [FEWEST_VEHICLES, FEWEST_VEHICLES - 1, 30])
    table = {"distance_m": distance, "detectable": np.ones(39), "entropy_bits": np.full(39, 0.5)}
    plot_by_distance(tmp_path / "d.png", table, table)
    share, entropy, count = figures[0].axes
    for axes in (share, entropy):
        for line in axes.lines:
            np.testing.assert_array_equal(np.isnan(line.get_ydata()), [False, True, False])
    filled = {round(bar.get_x() + bar.get_width() / 2): bar.get_facecolor()[3] > 0 for bar in count.patches}
    assert filled == {5: True, 15: False, 25: True}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["by_distance", "blind_zones"])
def test_a_run_without_vehicles_says_so(name, tmp_path, figures):
    plot, arguments = chart_arguments()[name]
    none = {column: [] for column in vehicles(0)}
    plot(tmp_path / "chart.png", **{**arguments, "baseline_table": none, "optimised_table": none})
    assert "no vehicles" in words(figures[0])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [1, FEWEST_VEHICLES, 40])
def test_one_band_and_unknown_entropies_are_drawn(number, tmp_path, figures):
    table = {
        "distance_m": np.full(number, 3.0),
        "detectable": np.ones(number, dtype=bool),
        "entropy_bits": np.full(number, np.nan),
    }
    plot_by_distance(tmp_path / "d.png", table, table)
    assert figures[0].axes[-1].get_xlim() == (0.0, 10.0)


def test_blind_zones_darken_where_vehicles_are_missed(tmp_path, pixels):
    table = vehicles(1, 400)
    seen, missed = ({**table, "detectable": np.full(400, value)} for value in (True, False))
    plot_blind_zones(tmp_path / "seen.png", seen, seen, (0.0, 0.0), ROAD)
    plot_blind_zones(tmp_path / "missed.png", missed, missed, (0.0, 0.0), ROAD)
    assert pixels(tmp_path / "seen.png").mean() > pixels(tmp_path / "missed.png").mean() + 0.2


def test_blind_zones_use_whole_lanes_and_one_scale_and_hold_every_vehicle(tmp_path, figures):
    from matplotlib.collections import QuadMesh

    table = vehicles(1)
    beside = {**table, "y_m": np.append(table["y_m"][:-1], -4.0)}
    plot_blind_zones(tmp_path / "b.png", beside, beside, [(0.0, 0.0), (3.0, 1.0)], ROAD, (5.0, 3.66))
    meshes = [mesh for axes in figures[0].axes[:2] for mesh in axes.findobj(QuadMesh)]
    lane = (ROAD[1] - ROAD[0]) / 5
    for mesh in meshes:
        assert mesh.get_clim() == (0.0, 100.0)
        edges = mesh.get_coordinates()[:, 0, 1]
        np.testing.assert_allclose(np.diff(edges), lane)
        assert edges[0] <= -4.0
        assert np.isclose(edges, ROAD[0]).any()
        assert np.isclose(edges, ROAD[1]).any()
    assert len(meshes) == 2


def test_blind_zones_refuse_a_carriageway_without_width(tmp_path):
    with pytest.raises(InputError, match=r"from a lower to a higher y, got 5\.0 to 5\.0 m"):
        plot_blind_zones(tmp_path / "b.png", vehicles(1), vehicles(1), (0.0, 0.0), (5.0, 5.0))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("spread", "panels"), [(1.0, 2), (3.0, 4)])
def test_clouds_are_drawn_to_scale_and_a_long_road_in_stretches(spread, panels, tmp_path, figures):
    plot, arguments = chart_arguments()["clouds"]
    boxes = {**arguments["boxes"], "x_m": spread * np.linspace(-45.0, 45.0, 12)}
    plot(tmp_path / "c.png", **{**arguments, "boxes": boxes})
    drawings = figures[0].axes[:-1]
    assert len(drawings) == panels
    scales = []
    for axes in drawings:
        box = axes.get_window_extent()
        scales += [box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())]
    np.testing.assert_allclose(scales, scales[0], rtol=1e-9)


def test_clouds_count_what_they_show(tmp_path, figures):
    plot, arguments = chart_arguments()["clouds"]
    plot(tmp_path / "c.png", **arguments, mountings=("height 2.0 m", "height 4.1 m"))
    for cloud_, seen, title in zip(
        arguments["clouds"], arguments["detectable"], ("Baseline: height 2.0 m", "Optimised: height 4.1 m"), strict=True
    ):
        points = np.count_nonzero(cloud_["vehicle_id"] >= 0)
        text = f"{title}\n{seen.sum()} of 12 vehicles detectable, {points} points on vehicles"
        assert text in words(figures[0])


@pytest.mark.filterwarnings("error")
def test_clouds_without_points_or_vehicles_are_drawn(tmp_path, figures):
    empty = {"xyz": np.zeros((0, 3)), "vehicle_id": np.zeros(0, dtype=int)}
    none = {name: [] for name in ("x_m", "y_m", "length_m", "width_m", "heading_deg")}
    plot_clouds(tmp_path / "c.png", (empty, empty), none, ([], []), (0.0, 0.0))
    assert "0 of 0 vehicles detectable, 0 points on vehicles" in words(figures[0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"clouds": ({"xyz": np.zeros((1, 3))}, cloud(1))}, "Baseline cloud: no array 'vehicle_id'"),
        ({"clouds": (cloud(1), {"xyz": np.zeros((2, 2)), "vehicle_id": [0, 1]})}, "Optimised cloud: xyz has shape"),
        ({"detectable": (np.ones(12, dtype=bool), np.ones(3, dtype=bool))}, "there are 12 boxes"),
    ],
)
def test_clouds_refuse_arrays_that_do_not_fit(changes, message, tmp_path):
    plot, arguments = chart_arguments()["clouds"]
    with pytest.raises(InputError, match=message):
        plot(tmp_path / "c.png", **{**arguments, **changes})
    assert not list(tmp_path.iterdir())


def test_occupancy_states_p_and_entropy_of_each_view(tmp_path, figures):
    before, after = views(0.02), views(0.1)
    plot_occupancy(tmp_path / "o.png", before, after)
    text = words(figures[0])
    for vehicle in (before, after):
        total = 0.0
        for view, grid in vehicle.grids.items():
            p = np.count_nonzero(grid) / grid.size
            total -= p * math.log2(p)
            assert f"P = {p:.4f}, adds {-p * math.log2(p):.3f} bits" in text, view
        assert f"PE-VGOP {total:.3f} bits" in text


def test_occupied_cells_darken_their_area_on_paper(tmp_path, pixels):
    truck = (16.0, 2.5, 3.8)  # its cells are too small on paper for outlines
    plot_occupancy(tmp_path / "empty.png", views(0.0, truck), views(0.0, truck))
    plot_occupancy(tmp_path / "half.png", views(0.5, truck), views(0.5, truck))
    darkening = (pixels(tmp_path / "empty.png") - pixels(tmp_path / "half.png")).sum()
    darkening /= (1.0 - lightness(canvas.OPTIMISED["color"])[0]) * (canvas.DPI / canvas.MM_PER_INCH) ** 2
    length, width, height = truck
    views_mm2 = 2.0 * (length * width + length * height + width * height) * (79.0 / length) ** 2
    assert darkening == pytest.approx(0.5 * views_mm2, rel=0.05)


def test_an_unseen_vehicle_adds_zero_bits_and_not_minus_zero(tmp_path, figures):
    plot_occupancy(tmp_path / "o.png", views(0.0), views(0.0))
    assert "adds 0.000 bits" in words(figures[0])
    assert "-0.000" not in words(figures[0])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("size", [(16.2, 2.5, 3.8), (2.1, 0.8, 1.4)])
def test_occupancy_fits_a_truck_and_a_motorcycle_on_the_sheet(size, tmp_path, figures):
    plot_occupancy(tmp_path / "o.png", views(0.1, size), views(0.2, size), title="T", subtitle="S")
    figure = figures[0]
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert box.x0 >= 0.0
        assert box.x1 <= figure.bbox.x1
        assert box.y0 >= 0.0


@pytest.mark.parametrize(
    ("grids", "size", "message"),
    [
        ({"top": np.ones((2, 2))}, CAR, "no view 'side'; needed: top, side, front"),
        ({"top": np.ones((0, 2)), "side": [[1]], "front": [[1]]}, CAR, r"view 'top' has shape \(0, 2\)"),
        ({"top": [[1]], "side": [[1]], "front": [[1]]}, (4.5, 0.0, 1.5), "three positive lengths"),
    ],
)
def test_occupancy_refuses_grids_that_are_none(grids, size, message):
    with pytest.raises(InputError, match=message):
        OccupancyViews(grids, size)
