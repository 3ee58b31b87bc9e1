"""The pictures of a comparison with detectors show its findings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.reality.agreement_charts import draw_charts
from blender_lidar.reality.chosen_metrics import chosen_metrics
from blender_lidar.reality.detections import read_detections
from blender_lidar.reality.detector_study import Settings, compare
from blender_lidar.reality.layouts import open_labelled
from blender_lidar.reality.resampled_cars import Draws
from tests.chart_samples import words
from tests.labelled_samples import sample_cars, write_detections, write_kitti

pytest.importorskip("matplotlib", reason="charts need matplotlib")
DRAWS = Draws(resamples=200)


@pytest.fixture(scope="module")
def findings(tmp_path_factory):
    folder, found = tmp_path_factory.mktemp("sample"), sample_cars()
    write_kitti(folder / "kitti", found)
    detections = read_detections(write_detections(folder / "cars.csv", found))
    metrics = chosen_metrics("pe-vgop,points,ap-entropy,distance")
    return compare(open_labelled(folder / "kitti"), detections, metrics, Settings(draws=DRAWS))


@pytest.fixture
def charts(findings, tmp_path, monkeypatch):
    """The figures by the names of their files."""
    from blender_lidar.plots import canvas

    saved, save = {}, canvas.save

    def keep(figure, path):
        save(figure, path)
        saved[Path(path).name] = figure

    monkeypatch.setattr(canvas, "save", keep)
    names = draw_charts(findings, DRAWS, tmp_path.joinpath)
    assert names == list(saved) == ["by_distance.png", "against_good.png", "against_blind.png"]
    return saved


def line_of(axes, start):
    return next(line for line in axes.lines if line.get_label().startswith(start))


def test_means_by_distance_are_those_of_the_main_sets_cars(charts, findings):
    mine = findings.main.member
    distance_m, bits = findings.judged.cars.boxes.distance_m[mine], findings.judged.cars.scores["pe-vgop"][mine]
    band = np.floor(distance_m / 10.0)
    used = [one for one in np.unique(band) if np.count_nonzero(band == one) >= 5]
    means = np.array([bits[band == one].mean() for one in used])
    x, y = line_of(charts["by_distance.png"].axes[0], "the panel's metric").get_data()
    np.testing.assert_allclose(x, [10.0 * one + 5.0 for one in used])
    np.testing.assert_allclose(y, (means - means.min()) / (means.max() - means.min()), atol=1e-9)


def test_metrics_that_are_good_when_low_are_turned_over(charts, findings):
    """Distance then falls with distance, as all others do."""
    panel = next(axes for axes in charts["by_distance.png"].axes if axes.get_title("left") == "distance")
    y = line_of(panel, "the panel's metric").get_ydata()
    assert (np.diff(y) < 0.0).all()
    assert (y[0], y[-1]) == (1.0, 0.0)


def test_each_panel_shows_every_car_in_range_a_rising_curve_and_the_tables_spearman(charts, findings):
    for name, detector in zip(("against_good.png", "against_blind.png"), findings.judged.detectors, strict=True):
        mine = findings.main.member & detector.in_range
        for metric, axes in zip(findings.metrics, charts[name].axes, strict=True):
            x, y = line_of(axes, "one car").get_data()
            np.testing.assert_array_equal(x, findings.judged.cars.scores[metric.name][mine])
            np.testing.assert_array_equal(y, detector.performance[mine])
            knots, curve = line_of(axes, "rising").get_data()
            order = np.argsort(knots if metric.higher_is_better else -knots)
            assert (np.diff(curve[order]) >= -1e-12).all()
        of = next(one for one in findings.agreements if (one.detector, one.metric) == (detector.name, "points"))
        assert of.statistics["spearman"].text() in words(charts[name])


def test_a_detectors_name_cannot_leave_the_folder_nor_take_anothers_file(findings, tmp_path):
    names = {"good": "../good/x", "blind": "../good x"}
    named = [replace(one, name=names[one.name]) for one in findings.judged.detectors]
    agreements = [one._replace(detector=names[one.detector]) for one in findings.agreements]
    odd = replace(findings, judged=replace(findings.judged, detectors=tuple(named)), agreements=tuple(agreements))
    names = draw_charts(odd, DRAWS, tmp_path.joinpath)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names)
    assert names[1:] == ["against_.._good_x.png", "against_.._good_x_2.png"]
