"""What the case study's pictures show is its result."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.case_study.mountings import baseline_coordinates, coordinates
from blender_lidar.case_study.published import EVEN, SENSORS
from blender_lidar.case_study.sensitivity import setting_of
from blender_lidar.case_study.sites import open_case
from tests.case_study_run import TINY, result_of_a_study, told
from tests.small_scene import MAPPED, write_scene

pytest.importorskip("matplotlib", reason="charts need matplotlib")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The result of a study and its folder."""
    return result_of_a_study(tmp_path_factory.mktemp("study"))


@pytest.fixture
def figures(monkeypatch):
    """The figures of a test by the name of their file; they are written all the same."""
    from blender_lidar.plots import canvas

    saved, save = {}, canvas.save

    def keep(figure, path):
        save(figure, path)
        saved[Path(path).name] = figure

    monkeypatch.setattr(canvas, "save", keep)
    return saved


@pytest.fixture(scope="module")
def telling(finished):
    """The result with shares, changes and tilts that are all different, as those of a few vehicles are not."""
    result, rng = copy.deepcopy(finished[0]), np.random.default_rng(1)
    for row in result["fig9"]:
        row |= {"baseline": rng.uniform(), "optimised": rng.uniform()}
        row["change"] = told(rng.uniform((-0.2, 0.1), (0.1, 0.3)))
    for row in result["sensitivity"]:
        if not row["note"]:
            row["tilt_deg"] = rng.uniform(5.0, 20.0)
    return result


@pytest.fixture
def charts(telling, tmp_path, figures):
    from blender_lidar.case_study.charts import draw_charts

    names = draw_charts(telling, lambda name: tmp_path / name, EVEN)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names) == sorted(figures)
    return figures


def of_sensor(rows, sensor, **wanted):
    return [
        row
        for row in rows
        if row["sensor"] == sensor
        and row.get("band") != "all"
        and all(row[key] == value for key, value in wanted.items())
    ]


def drawn_means(container):
    """Middles and ends of what `errorbar` has drawn, (n,) and (n, 2)."""
    line, _, bars = container
    return line.get_ydata(), np.array([segment[:, 1] for segment in bars[0].get_segments()])


def assert_means(container, found):
    middle, ends = drawn_means(container)
    np.testing.assert_allclose(middle, [of["mean"] for of in found])
    np.testing.assert_allclose(ends, [of["interval_90"] or [of["mean"]] * 2 for of in found], atol=1e-12)


def test_the_chart_of_table_2_has_each_sensor_s_optimum_and_rivals_in_its_own_panel(telling, charts):
    result = telling
    panels = [axes for axes in charts["table2.png"].axes if axes.get_title(loc="left") in SENSORS]
    assert [axes.get_title(loc="left") for axes in panels] == list(SENSORS)
    for sensor, axes in zip(SENSORS, panels, strict=True):
        of = result["sensors"][sensor]
        markers = [tuple(line.get_xydata()[0]) for line in axes.lines if len(line.get_xdata()) == 1]
        published, search = of["published"], of["de_pso"]
        assert markers == [
            (published["tilt_deg"], published["height_m"]),
            (search["tilt_x_deg"], search["height_m"]),
            tuple(of["baseline_mounting"][::-1]),
            (of["tilt_deg"], of["height_m"]),
        ]


def test_the_chart_of_fig_9_has_shares_before_and_after_and_changes_with_intervals(telling, charts):
    result, axes = telling, charts["fig9.png"].axes
    for sensor, upper, lower in zip(SENSORS, axes[:3], axes[3:], strict=True):
        assert upper.get_title(loc="left") == sensor
        shares = of_sensor(result["fig9"], sensor, measure="detectable")
        lines = {line.get_label(): line.get_ydata() for line in upper.lines}
        np.testing.assert_allclose(lines["baseline"], [100 * row["baseline"] for row in shares])
        np.testing.assert_allclose(lines["optimised"], [100 * row["optimised"] for row in shares])
        names = [f"{label.get_text()} m" for label in lower.get_xticklabels()]
        assert names == [row["band"] for row in shares]
        drawn = [sensor, EVEN] if sensor == SENSORS[-1] else [sensor]
        for container, of in zip(lower.containers, drawn, strict=True):
            rows = of_sensor(result["fig9"], of, measure="entropy_bits")
            assert_means(container, [row["change"] for row in rows])


def test_the_chart_of_the_spacing_has_a_bar_for_each_effect_and_their_sum(telling, charts):
    result, (axes,) = telling, charts["spacing.png"].axes
    rows = [row for row in result["spacing"] if row["measure"] == "entropy_bits" and row["band"] != "all"]
    bars = {of.get_label(): of for of in axes.containers if not of.get_label().startswith("_")}
    total = bars.pop("all of the change")
    effects = {"height": "height_evenly_spaced", "tilt": "tilt_evenly_spaced"}
    effects["change of the uneven beams' lead"] = "spacing"
    assert list(bars) == list(effects)
    heights = {name: np.array([bar.get_height() for bar in of]) for name, of in bars.items()}
    for name, effect in effects.items():
        np.testing.assert_allclose(heights[name], [row[effect]["mean"] for row in rows])
    assert_means(total, [row["change"] for row in rows])
    np.testing.assert_allclose(sum(heights.values()), drawn_means(total)[0], atol=1e-12)


def test_the_chart_of_the_settings_has_each_sensor_s_tilts_in_its_own_panel(telling, charts):
    result, panels = telling, charts["sensitivity.png"].axes
    settings = [label.get_text() for label in panels[0].get_yticklabels()]
    for sensor, axes in zip(SENSORS, panels, strict=True):
        assert axes.get_title(loc="left") == sensor
        rows = [row for row in of_sensor(result["sensitivity"], sensor) if not row["note"]]
        points = [tuple(line.get_xydata()[0]) for line in axes.lines if line.get_marker() == "o"]
        assert [tilt for tilt, _ in points] == [row["tilt_deg"] for row in rows]
        for (_, at), row in zip(points, rows, strict=True):
            assert settings[int(at)] == " ".join(setting_of(row)).strip()


def test_headings_fit_their_pictures_and_say_on_how_much_they_stand(finished, charts):
    from matplotlib.text import Text

    for name, figure in charts.items():
        for text in (*figure.texts, *(label for axes in figure.axes for label in (axes.title, axes.xaxis.label))):
            assert text.get_window_extent().x1 <= figure.bbox.x1, f"{name}: {text.get_text()}"
    said = f"{finished[0]['judged_frames']} held-out frames in {finished[0]['judged_blocks']} blocks of time"
    for name in ("fig9.png", "spacing.png"):
        assert said in "\n".join(text.get_text() for text in charts[name].findobj(Text))
    assert said in (finished[1] / "report.md").read_text(encoding="utf-8")


def test_clouds_are_drawn_with_the_sensor_where_each_mounting_has_it(tmp_path, figures):
    from blender_lidar.case_study.clouds import draw_clouds

    site = open_case(str(write_scene(tmp_path, MAPPED | {"baseline": {"y_m": -1.0}})), {}, TINY).site("RS-16")
    mounts = {"baseline": baseline_coordinates(site), "optimised": coordinates(site, (4.0, 20.0))}
    draw_clouds(site, tmp_path / "fig8.png", mounts)
    panels = figures["fig8.png"].axes[:2]
    places = [[tuple(line.get_xydata()[0]) for line in axes.lines if len(line.get_xdata()) == 1] for axes in panels]
    assert places == [[(0.0, -1.0)], [(0.0, 0.0)]]
    assert "height 4.00 m, tilt 20.0°" in panels[1].get_title(loc="left")
