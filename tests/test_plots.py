"""The charts of a run: printed size, units, nothing covered, and what each of them shows."""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from blender_lidar.errors import InputError, OutputError
from blender_lidar.metrics.catalogue import METRICS
from blender_lidar.plots import canvas
from blender_lidar.plots.agreement import plot_against, plot_declines
from blender_lidar.plots.blind_zones import plot_blind_zones
from blender_lidar.plots.by_distance import FEWEST_VEHICLES, plot_by_distance
from blender_lidar.plots.changes import Mean, plot_before_after, plot_effects, plot_settings
from blender_lidar.plots.clouds import plot_clouds
from blender_lidar.plots.convergence import plot_convergence
from blender_lidar.plots.near_best import plot_gain_maps
from blender_lidar.plots.occupancy import OccupancyViews, plot_occupancy
from blender_lidar.plots.score_map import plot_score_map
from tests.chart_samples import (
    CAR,
    CHARTS,
    ROAD,
    chart_arguments,
    cloud,
    gain_map,
    grey_pixels,
    lightness,
    score_map_arguments,
    vehicles,
    views,
    words,
)

pytest.importorskip("matplotlib", reason="charts need matplotlib")


@contextmanager
def figures_kept():
    """The figures that are saved meanwhile, in order; they are written all the same."""
    saved, save = [], canvas.save

    def keep(figure, path):
        save(figure, path)
        saved.append(figure)

    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(canvas, "save", keep)
        yield saved


@pytest.fixture
def figures():
    with figures_kept() as saved:
        yield saved


class Drawn(NamedTuple):
    """A chart under headings: its file, its figure, and what it was drawn from."""

    path: Path
    figure: object
    arguments: dict


HEADINGS = {"title": "A title", "subtitle": "And a subtitle"}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Each chart, drawn once for all that look at it."""

    @cache
    def draw(name: str) -> Drawn:
        path = tmp_path_factory.mktemp(name) / "chart.png"
        plot, arguments = chart_arguments()[name]
        with figures_kept() as saved:
            plot(path, **arguments, **HEADINGS)
        return Drawn(path, saved[0], arguments)

    return draw


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_is_a_png_of_the_printed_size_with_something_on_it(name, drawn):
    path = drawn(name).path
    grey = grey_pixels(path)
    assert grey.shape[1] == pytest.approx(canvas.WIDTH_MM / canvas.MM_PER_INCH * canvas.DPI, abs=1)
    assert 0.01 < np.mean(grey < 0.9) < 0.9
    assert [found.name for found in path.parent.iterdir()] == ["chart.png"]


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_leaves_its_inputs_alone_and_repeats_byte_for_byte(name, drawn, tmp_path):
    plot, untouched = chart_arguments()[name]
    arguments = drawn(name).arguments
    assert repr(arguments) == repr(untouched)
    np.testing.assert_equal(
        {key: value for key, value in arguments.items() if not isinstance(value, OccupancyViews)},
        {key: value for key, value in untouched.items() if not isinstance(value, OccupancyViews)},
    )
    plot(tmp_path / "second.png", **untouched, **HEADINGS)
    assert drawn(name).path.read_bytes() == (tmp_path / "second.png").read_bytes()


@pytest.mark.parametrize("name", CHARTS)
def test_every_axis_says_what_it_measures_and_in_which_unit(name, drawn):
    figure = drawn(name).figure
    labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert all("[" in label or label.startswith("Evaluations") for label in labels)
    assert labels or "1 m; a cell is 0.05 m by 0.05 m" in words(figure)


@pytest.mark.parametrize("name", CHARTS)
def test_headings_legend_and_panels_do_not_cover_each_other(name, drawn):
    figure = drawn(name).figure
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
    plot, arguments = chart_arguments()[name]
    with pytest.raises(OutputError, match="cannot be written") as caught:
        plot(tmp_path / "no such folder" / "chart.png", **arguments)
    assert "no such folder" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())


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


@pytest.mark.parametrize("name", ["sum-of-views", "ap-entropy"])
def test_charts_of_scores_say_the_metric_and_its_unit_and_have_room_for_it(name, tmp_path, figures):
    metric = METRICS[name]
    table = {**vehicles(1, 200), "metric_value": metric.merit(np.full(200, 2.0))}
    plot_by_distance(tmp_path / "d.png", table, table, metric=metric, column="metric_value")
    plot_convergence(tmp_path / "c.png", [1, 2], [0.25, 0.5], [0.25, 0.5], 0.125, metric=metric)
    plot_score_map(tmp_path / "m.png", **{**score_map_arguments(), "metric": metric})
    by_distance, convergence, score_map = figures
    score = by_distance.axes[1]
    assert metric.label in score.get_ylabel()
    assert metric.unit in score.get_ylabel()
    assert ("lower is better" in score.get_ylabel()) != metric.higher_is_better
    low, high = score.get_ylim()
    assert (low == 0.0) == metric.higher_is_better  # values below 0 are not cut off
    assert low <= metric.merit(2.0) <= high
    boxes = [axes.yaxis.label.get_window_extent() for axes in by_distance.axes]
    assert not any(box.overlaps(other) for number, box in enumerate(boxes) for other in boxes[number + 1 :])
    assert max(box.y1 for box in boxes) <= by_distance.bbox.y1
    assert f"at the end {metric.amount(0.5)})" in words(convergence)
    assert convergence.axes[0].get_ylabel() == metric.in_unit("Objective per vehicle")
    assert metric.in_unit("Objective per vehicle") in {axes.get_ylabel() for axes in score_map.axes}


def test_blind_zones_darken_where_vehicles_are_missed(tmp_path):
    table = vehicles(1, 400)
    seen, missed = ({**table, "detectable": np.full(400, value)} for value in (True, False))
    plot_blind_zones(tmp_path / "seen.png", seen, seen, (0.0, 0.0), ROAD)
    plot_blind_zones(tmp_path / "missed.png", missed, missed, (0.0, 0.0), ROAD)
    assert grey_pixels(tmp_path / "seen.png").mean() > grey_pixels(tmp_path / "missed.png").mean() + 0.2


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


def test_occupied_cells_darken_their_area_on_paper(tmp_path):
    truck = (16.0, 2.5, 3.8)  # its cells are too small on paper for outlines
    plot_occupancy(tmp_path / "empty.png", views(0.0, truck), views(0.0, truck))
    plot_occupancy(tmp_path / "half.png", views(0.5, truck), views(0.5, truck))
    darkening = (grey_pixels(tmp_path / "empty.png") - grey_pixels(tmp_path / "half.png")).sum()
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


def test_gain_maps_outline_what_is_near_best_and_name_the_rivals(tmp_path, figures):
    plot_gain_maps(tmp_path / "c.png", [gain_map("RS-16"), gain_map("RS-80", interval=False)])
    text = words(figures[0])
    for part in ("RS-16", "RS-80", "the paper's Table II", "DE-PSO", "within 1 % of the gain", "90 % of resampled"):
        assert part in text
    stars = [line for axes in figures[0].axes for line in axes.lines if line.get_marker() == "*"]
    assert [tuple(*star.get_xydata()) for star in stars] == [(20.0, 4.0)] * 2
    with pytest.raises(InputError, match="share has shape"):
        plot_gain_maps(tmp_path / "d.png", [replace(gain_map("RS-16"), share=np.ones((2, 2)))])
    assert not (tmp_path / "d.png").exists()


@pytest.mark.parametrize(
    "draw",
    [
        lambda path: plot_gain_maps(path, []),
        lambda path: plot_before_after(path, [], share_label="", change_label=""),
        lambda path: plot_settings(path, {}, {}, label=""),
        lambda path: plot_declines(path, [], []),
        lambda path: plot_against(path, [], label=""),
    ],
)
def test_charts_of_studies_refuse_to_show_nothing(tmp_path, draw):
    with pytest.raises(InputError, match="at least one is needed"):
        draw(tmp_path / "c.png")
    assert not list(tmp_path.iterdir())


def test_a_change_without_an_interval_is_drawn_without_bars(tmp_path, figures):
    means = [Mean(0.1, -0.1, 0.3), Mean(0.2, math.nan, math.nan)]
    plot_effects(tmp_path / "c.png", ["near", "far"], {"height": means}, ("all", means), label="Change [bits]")
    axes = figures[0].axes[0]
    assert [bar.get_height() for bar in axes.patches] == [0.1, 0.2]
    (segments, *_) = [of.get_segments() for of in axes.collections]
    lengths = [np.ptp(segment[:, 1]) for segment in segments]
    np.testing.assert_allclose(lengths, [0.4, 0.0], atol=1e-12)
