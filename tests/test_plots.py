"""The charts of a run: printed size, units, nothing covered, and what each of them shows."""

from __future__ import annotations

import pickle
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.metrics.catalogue import metric_named
from blender_lidar.report import figure as canvas
from blender_lidar.report.cloud_figures import plot_clouds, plot_detections
from blender_lidar.report.coverage_figures import plot_blind_zones
from blender_lidar.report.run_figures import (
    FEWEST_VEHICLES,
    plot_by_distance,
    plot_convergence,
    plot_score_map,
)
from blender_lidar.scene.settings import ZoneSettings
from rival_metrics import OPTIONS
from tests.chart_samples import (
    CHARTS,
    ROAD,
    chart_arguments,
    detections,
    grey_pixels,
    history,
    run_of,
    score_map,
    scores,
    sights,
    table,
    vehicles,
    words,
)
from tests.small_scene import done, write_scene

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
    """A chart: its file and its figure."""

    path: Path
    figure: object


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Each chart, drawn once for all that look at it."""

    @cache
    def draw(name: str) -> Drawn:
        path = tmp_path_factory.mktemp(name) / "chart.png"
        plot, arguments = chart_arguments()[name]
        before = pickle.dumps(arguments)
        with figures_kept() as saved:
            plot(path, **arguments)
        assert pickle.dumps(arguments) == before, "a chart has changed what it shows"
        return Drawn(path, saved[0])

    return draw


@pytest.mark.parametrize("name", CHARTS)
def test_a_chart_is_a_png_of_the_printed_size_with_something_on_it_and_repeats_byte_for_byte(name, drawn, tmp_path):
    path = drawn(name).path
    grey = grey_pixels(path)
    assert grey.shape[1] == pytest.approx(canvas.WIDTH_MM / canvas.MM_PER_INCH * canvas.DPI, abs=1)
    assert 0.01 < np.mean(grey < 0.9) < 0.9
    assert [found.name for found in path.parent.iterdir()] == ["chart.png"]
    plot, arguments = chart_arguments()[name]
    plot(tmp_path / "second.png", **arguments)
    assert path.read_bytes() == (tmp_path / "second.png").read_bytes()


@pytest.mark.parametrize("name", CHARTS)
def test_every_axis_says_what_it_measures_and_in_which_unit(name, drawn):
    figure = drawn(name).figure
    labels = [label for axes in figure.axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert all("[" in label or label.startswith("Evaluations") for label in labels)
    assert labels


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


def test_convergence_leaves_out_candidates_without_a_value(tmp_path, figures):
    tried = {"evaluation": np.array([1.0, 2.0, 3.0]), "best": np.array([np.nan, np.nan, 0.6])}
    tried["objective"] = np.array([np.nan, -np.inf, 0.6])
    plot_convergence(tmp_path / "c.png", run_of(vehicles=2, baseline=scores(0.1, 2, 0)), tried)
    dots = next(line for line in figures[0].axes[0].lines if line.get_label() == "one candidate")
    np.testing.assert_array_equal(dots.get_xdata(), [3.0])
    np.testing.assert_array_equal(dots.get_ydata(), [0.3])
    assert "at the end 0.300 bits" in words(figures[0])
    assert "baseline mounting (0.100 bits)" in words(figures[0])


def test_charts_tell_which_objective_is_as_searched_and_that_the_optimum_is_as_hung(tmp_path, figures):
    hung = {**scores(0.7, 3.0, 10.0), "objective_per_vehicle_as_searched": 0.6}
    run = run_of(**hung, lidars=[{"name": "", "installer": {"tilt_deg": 1.0}}])
    plot_convergence(tmp_path / "c.png", run, history())
    plot_score_map(tmp_path / "m.png", run, score_map())
    assert "Search under installation errors: de-pso, seed 1, corrected reading" in words(figures[0])
    legend = [text.get_text() for text in figures[1].legends[0].get_texts()]
    assert [text.split(":")[0] for text in legend[:2]] == ["optimum as hung", "baseline"]
    assert legend[0].split("\n")[1] == "0.600 bits as searched"
    assert "Objective as searched over height and tilt" in words(figures[1])
    assert "best so far as searched (at the end" in words(figures[0])
    for plot, more in ((plot_convergence, history()), (plot_score_map, score_map())):
        plot(tmp_path / "exact.png", run_of(), more)
    assert not any(word in words(figure) for figure in figures[2:] for word in ("as hung", "as searched"))


@pytest.mark.parametrize(("x_m", "marks"), [(0.0, 2), (0.009, 2), (0.02, 1), (14.0, 1)])
def test_a_baseline_of_another_pole_is_not_on_this_poles_map(x_m, marks, tmp_path, figures):
    baseline = scores(0.2, 2.0, 0.0)
    baseline["deployment"]["x_m"] = x_m
    plot_score_map(tmp_path / "m.png", run_of(baseline=baseline), score_map())
    axes = figures[0].axes[0]
    assert len([line for line in axes.lines if line.get_marker() in ("s", "*")]) == marks
    assert ("baseline" in words(figures[0])) == (marks == 2)


def test_the_score_map_outlines_the_mountings_near_the_best(tmp_path, figures, monkeypatch):
    from matplotlib.axes import Axes

    levels, contour = [], Axes.contour

    def note(*args, **keywords):
        levels.append(keywords["levels"])
        return contour(*args, **keywords)

    monkeypatch.setattr(Axes, "contour", note)
    plot_score_map(tmp_path / "m.png", run_of(), score_map())
    assert levels[-1] == [pytest.approx(0.8 - 0.01 * (0.8 - 0.2))]
    assert "within 1 % of the gain" in words(figures[0])


def test_the_score_map_marks_a_mounting_off_the_map_at_its_edge(tmp_path, figures):
    plot_score_map(tmp_path / "m.png", run_of(baseline=scores(0.2, 1.5, -5.0)), score_map())
    marker = next(line for line in figures[0].axes[0].lines if "baseline" in line.get_label())
    assert (marker.get_xdata()[0], marker.get_ydata()[0]) == (0.0, 2.0)
    assert "baseline: 1.50 m, -5.0°, off the map" in words(figures[0])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("values", "best", "text"), [(np.full((6, 6), 0.2), 0.2, "the whole map"), (None, 2.0, "smaller than a cell")]
)
def test_the_score_map_copes_with_flat_and_steep_maps(values, best, text, tmp_path, figures):
    landscape = score_map() if values is None else replace(score_map(), per_vehicle=values)
    plot_score_map(tmp_path / "m.png", run_of(objective_per_vehicle_as_searched=best), landscape)
    assert text in words(figures[0])


def test_bands_with_few_vehicles_are_hollow_and_not_averaged(tmp_path, figures):
    distance = np.repeat([5.0, 15.0, 25.0], [FEWEST_VEHICLES, FEWEST_VEHICLES - 1, 30])
    few = {"distance_m": distance, "detectable": np.ones(39), "entropy_bits": np.full(39, 0.5)}
    plot_by_distance(tmp_path / "d.png", run_of(few))
    share, entropy, count = figures[0].axes
    for axes in (share, entropy):
        for line in axes.lines:
            np.testing.assert_array_equal(np.isnan(line.get_ydata()), [False, True, False])
    filled = {round(bar.get_x() + bar.get_width() / 2): bar.get_facecolor()[3] > 0 for bar in count.patches}
    assert filled == {5: True, 15: False, 25: True}


@pytest.mark.parametrize("name", [OPTIONS["sum_of_views"], OPTIONS["ap_entropy"]])
def test_charts_of_scores_say_the_metric_and_its_unit_and_have_room_for_it(name, tmp_path, figures):
    metric = metric_named(name)
    run = run_of(table(1) | {"metric_value": metric.merit(np.full(200, 2.0))}, metric=name)
    for plot, more in ((plot_by_distance, ()), (plot_convergence, (history(),)), (plot_score_map, (score_map(),))):
        plot(tmp_path / "c.png", run, *more)
    by_distance, convergence, landscape = figures
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
    assert f"at the end {metric.amount(history()['best'][-1])})" in words(convergence)
    assert convergence.axes[0].get_ylabel() == metric.in_unit("Objective per vehicle")
    assert metric.in_unit("Objective per vehicle") in {axes.get_ylabel() for axes in landscape.axes}


def test_a_share_is_drawn_in_per_cent_and_weighed(tmp_path, figures):
    split = np.where(np.arange(200) < 150, "search", "holdout")
    weighed = table(1) | {"metric_value": np.ones(200), "weight": np.full(200, 2.0), "split": split}
    run, rows = run_of(weighed, metric="detectable"), history()
    plot_by_distance(tmp_path / "d.png", run)
    plot_convergence(tmp_path / "c.png", run, rows)
    plot_score_map(tmp_path / "m.png", run, score_map())
    by_distance, convergence, landscape = figures
    assert by_distance.axes[1].get_ylabel() == "Mean PE-VGOP\n[bits]"
    assert convergence.axes[0].get_ylabel() == "Objective per vehicle [%]"
    assert convergence.axes[0].lines[1].get_ydata()[-1] == pytest.approx(100.0 * rows["best"][-1] / 300.0)
    values = landscape.axes[0].collections[0].get_array()
    assert values.max() == pytest.approx(100.0 * score_map().per_vehicle.max())


def test_blind_zones_darken_where_vehicles_are_missed(tmp_path):
    for name, value in (("seen", True), ("missed", False)):
        run = run_of(table(1, 400) | {"detectable": np.full(400, value)})
        plot_blind_zones(tmp_path / f"{name}.png", run, ROAD)
    assert grey_pixels(tmp_path / "seen.png").mean() > grey_pixels(tmp_path / "missed.png").mean() + 0.1


def test_blind_zones_outline_the_zones_that_have_weights(tmp_path, figures):
    zone = ZoneSettings(name="conflict area", polygon_m=((0.0, 5.0), (20.0, 5.0), (20.0, 9.0)), weight=3.0)
    plot_blind_zones(tmp_path / "b.png", run_of(table(1, 400)), ROAD, [zone])
    for axes in figures[0].axes[:2]:
        assert "conflict area x 3" in [text.get_text() for text in axes.texts]
        outlines = [line.get_xydata() for line in axes.lines if line.get_label() == "zone x weight"]
        np.testing.assert_array_equal(outlines, [[*zone.polygon_m, zone.polygon_m[0]]])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("spread", [0.1, 1.0, 3.0])
def test_clouds_are_drawn_to_scale_and_in_one_piece_whatever_the_roads_length(spread, tmp_path, figures):
    road = vehicles(4)
    road.centre_m[:, 0] = spread * np.linspace(-45.0, 45.0, 12)
    plot_clouds(tmp_path / "c.png", road, sights(np.ones(12, dtype=bool)))
    drawings = figures[0].axes[:-1]
    assert len(drawings) == 2
    scales = []
    for axes in drawings:
        box = axes.get_window_extent()
        scales += [box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())]
    np.testing.assert_allclose(scales, scales[0], rtol=1e-9)


def test_clouds_count_what_they_show(tmp_path, figures):
    both = sights(np.arange(12) % 3 > 0)
    plot_clouds(tmp_path / "c.png", vehicles(4), both)
    for sight, title in zip(both, ("Baseline: height 2.00 m", "Optimised: height 4.10 m"), strict=True):
        points = np.count_nonzero(sight.vehicle_id >= 0)
        text = f"{title}, tilt 0.0°\n{sight.detectable.sum()} of 12 vehicles detectable, {points} points on vehicles"
        assert text in words(figures[0])


def test_detections_tell_hits_from_false_alarms_and_count_them(tmp_path, figures):
    from matplotlib.collections import LineCollection, PolyCollection

    shown = detections()
    plot_detections(tmp_path / "d.png", **shown)
    assert "Baseline: height 2.00 m, tilt 0.0°\n5 of 10 vehicles found, 1 false alarm\n" in words(figures[0]) + "\n"
    axes, boxes = figures[0].axes[0], shown["found"][0].boxes
    drawn = [len(shapes.get_paths()) for shapes in axes.collections if isinstance(shapes, PolyCollection)]
    assert drawn == [5, 5, 2, 5, 1, 1]  # vehicles found, missed and not counted; hits, false alarms, not counted
    ticks = np.concatenate([lines.get_segments() for lines in axes.collections if isinstance(lines, LineCollection)])
    forward = ticks[:, 1] - ticks[:, 0]
    order = [0, 1, 2, 3, 4, 6, 5]
    np.testing.assert_allclose(np.arctan2(*forward.T[::-1]), boxes.heading_rad[order], atol=1e-12)
    np.testing.assert_allclose(np.hypot(*forward.T), 0.5 * boxes.size_m[order, 0])
    low, high = axes.get_ylim()
    assert low < 0.0  # the LiDAR
    assert high > 25.0  # the false alarm
    assert axes.get_aspect() == 1.0
    box = axes.get_window_extent()
    assert box.width / np.ptp(axes.get_xlim()) == pytest.approx(box.height / np.ptp(axes.get_ylim()), rel=1e-9)


@pytest.mark.parametrize("holdout", [0.0, 0.4])
def test_nothing_of_a_run_that_holds_nothing_out_speaks_of_held_out_frames(tmp_path, figures, capsys, holdout):
    changes = {"traffic": {"holdout": holdout}, "search": {"iterations": 1}}
    out, _ = done(capsys, "optimise", write_scene(tmp_path, changes), "--out", tmp_path / "run")
    message = [words(figure) for figure in figures]
    assert any("held-out" in text for text in message) == bool(holdout)
    pages = [(tmp_path / "run" / name).read_text(encoding="utf-8") for name in ("report.html", "installation.txt")]
    for text in (out, *pages):
        assert ("held-out" in text) == bool(holdout)


@pytest.mark.parametrize("plot", [plot_by_distance, partial(plot_blind_zones, road=ROAD)])
def test_charts_of_coverage_show_the_frames_that_judge_alone(plot, tmp_path, figures):
    split = np.where(np.arange(200) % 2 == 0, "search", "holdout")
    both = {**table(1), "split": split}
    judged = {key: column[split == "holdout"] for key, column in both.items()}
    holdout = {"vehicles": 100, "frames": 3}
    for name, seen in (("a.png", both), ("b.png", judged)):
        plot(tmp_path / name, run_of(seen, holdout=holdout))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    assert "100 vehicle boxes in 3 held-out frames" in words(figures[0])
