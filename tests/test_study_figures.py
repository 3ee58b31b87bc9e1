"""The pictures of chart and stability: points, rows, marks and limits are where numbers say, the front is named."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from blender_lidar.report import chart, stability
from blender_lidar.studies.effects import pareto_front
from tests.test_plots import figures_kept

pytest.importorskip("matplotlib")


@pytest.fixture
def drawn():
    """Figures as they are saved."""
    with figures_kept() as figures:
        yield figures


# --- speed against accuracy -------------------------------------------------------------------------------------------


def rung(name, milliseconds, error, detail, pareto=False):
    times = dict(zip(("first_quartile", "median", "third_quartile"), milliseconds, strict=True))
    return {"name": name, "milliseconds": times, "error": error, "detail": detail, "pareto": pareto}


def rungs(count: int, seed: int = 1) -> list[dict]:
    """A reference without error and so many others, in clusters as a ladder has them."""
    rng = np.random.default_rng(seed)
    time = np.exp(rng.choice([3.0, 4.0, 5.0], count) + rng.normal(scale=0.25, size=count))
    error = 0.02 * np.exp(rng.normal(scale=0.4, size=count))
    details = rng.choice(["box", "body", "detailed"], count).tolist()
    others = [
        rung(f"{detail} 1/{row}", (0.9 * ms, ms, 1.1 * ms), off, detail)
        for row, (detail, ms, off) in enumerate(zip(details, time.tolist(), error.tolist(), strict=True))
    ]
    return [rung("reference", (280.0, 300.0, 320.0), 0.0, "detailed", pareto=True), *others]


def draw(path, given, **changes):
    names = ("sensor", "scene", "mountings", "frames", "reference", "recommended")
    settings = dict.fromkeys(names, "") | {"recommended": given[min(1, len(given) - 1)]["name"] if given else ""}
    settings |= {"noise": {"error": 0.02, "error_90": [0.015, 0.03]}, "tolerance": 0.003, "metric_unit": "bits"}
    chart.draw_chart(path, settings | {"rungs": given, "gain_per_vehicle": 1.0} | changes)


def test_the_front_and_the_recommended_are_named_and_no_name_lies_on_another_or_outside(drawn, tmp_path):
    given = rungs(50)
    places = np.array([(row["milliseconds"]["median"], row["error"]) for row in given])
    front = pareto_front(*places.T)
    given = [{**row, "pareto": number in front} for number, row in enumerate(given)]
    close = [rung(f"box 1/{at}", (at, at, at), 0.001 - 1e-5 * at, "box", pareto=True) for at in (5, 6, 7)]
    draw(tmp_path / "chart.png", given + close)
    (axes,) = drawn[0].axes
    assert [text.get_text() for text in axes.texts if text.get_weight() == "bold"] == [given[1]["name"]]
    named = {row["name"] for row in given + close if row["pareto"]} | {given[1]["name"]}
    assert {text.get_text() for text in axes.texts} == named
    boxes = [text.get_window_extent() for text in axes.texts]
    for one, other in combinations(boxes, 2):
        width = min(one.x1, other.x1) - max(one.x0, other.x0)
        height = min(one.y1, other.y1) - max(one.y0, other.y0)
        assert not (width > 0.5 and height > 0.5)
    inside = axes.get_window_extent()
    assert all(box.x0 >= inside.x0 and box.x1 <= inside.x1 for box in boxes)
    assert (tmp_path / "chart.png").stat().st_size > 1000


def test_points_lie_at_their_median_and_error_and_what_has_none_lies_at_0(drawn, tmp_path):
    given = rungs(6)
    draw(tmp_path / "chart.png", given)
    (axes,) = drawn[0].axes
    shown = {
        (x, y)
        for line in axes.lines
        if line.get_linestyle() == "None"
        for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)
    }
    for row in given:
        assert any(np.allclose(place, (row["milliseconds"]["median"], row["error"])) for place in shown)
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    low, high = axes.get_ylim()
    assert low < 0.0
    assert high > max(0.03, *(row["error"] for row in given))  # the noise ceiling is seen whole


def test_without_error_noise_tolerance_or_unit_there_is_a_picture_all_the_same(drawn, tmp_path):
    draw(tmp_path / "chart.png", rungs(0), noise=None, gain_per_vehicle=0.0, metric_unit="")
    labels = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert not {"tolerance", "reference, half of the blocks against the others"} & set(labels)
    assert drawn[0].axes[0].get_ylabel() == "Error after calibration"
    assert drawn[0].axes[0].get_ylim() == pytest.approx((-0.05, 1.05))  # where nothing errs


def test_nothing_to_draw_leaves_no_picture(tmp_path):
    draw(tmp_path / "chart.png", [])
    assert not (tmp_path / "chart.png").exists()


# --- stability --------------------------------------------------------------------------------------------------------

RESULT = {
    "sensor": "",
    "scene": "",
    "mounting": {"height_m": 4.0, "tilt_x_deg": 23.0},
}


def change(section, what, value, verdict, lost, interval, tilts):
    numbers = {"detectable_share_lost": lost, "detectable_share_lost_interval_90": interval, "best_tilt_deg": tilts}
    return {"section": section, "what": what, "value": value, "verdict": verdict, "numbers": numbers}


CHANGES = [
    change("traffic", "density", "light", "stable", -0.02, [-0.04, 0.0], [22.0, 24.0]),
    change("metric", "cell size", "2.5 cm", "fragile", 0.08, [0.01, 0.15], [19.0]),
    change("metric", "other metric", "points", "fails", 1.8, [0.1, 3.5], [1.0]),
    change("metric", "delta of Eq. 11", "0.02", "undecided", -0.378, None, [18.0]),
]
OPTIMUM = {"section": "traffic", "what": "optimum", "value": "", "verdict": None}
OPTIMUM["numbers"] = {"tilt_interval_90_deg": [20.0, 24.0]}


def lines_at(axes, row):
    return [line for line in axes.lines if len(line.get_ydata()) and np.all(np.asarray(line.get_ydata()) == row)]


def test_every_change_has_a_row_with_its_loss_its_interval_and_its_optima(drawn, tmp_path):
    assert stability.draw_changes(tmp_path / "changes.png", {**RESULT, "findings": [OPTIMUM, *CHANGES]})
    lost, moved = drawn[0].axes
    labels = [label.get_text() for label in lost.get_yticklabels()]
    assert labels == [f"{one['what']}: {one['value']}" for one in CHANGES]
    span, mark = lines_at(lost, 0)
    np.testing.assert_allclose(span.get_xdata(), [-4.0, 0.0])
    np.testing.assert_allclose(mark.get_xdata(), -2.0)
    for row, rim in ((2, 1), (3, 0)):  # a loss beyond a rim is drawn on it
        assert lines_at(lost, row)[1].get_xdata()[0] == lost.get_xlim()[rim]
    span, mark = lines_at(moved, 0)
    np.testing.assert_allclose(span.get_xdata(), [22.0, 24.0])
    np.testing.assert_allclose(mark.get_xdata(), 23.0)
    markers = [lines_at(lost, row)[1].get_marker() for row in range(4)]
    assert len(set(markers)) == 4  # verdicts differ without colour
    assert (tmp_path / "changes.png").stat().st_size > 1000


def test_where_a_scene_is_given_by_leans_the_mounting_stands_at_its_lean(drawn, tmp_path):
    mounting = {**RESULT["mounting"], "lean_deg": 21.5}
    assert stability.draw_changes(
        tmp_path / "leans.png", {**RESULT, "mounting": mounting, "leans": True, "findings": CHANGES}
    )
    _, moved = drawn[0].axes
    assert moved.get_xlabel() == "Best lean under the change [deg]"
    assert any(np.all(np.asarray(line.get_xdata()) == 21.5) for line in moved.lines)


def test_without_an_interval_and_without_changes(tmp_path):
    assert stability.draw_changes(tmp_path / "one.png", {**RESULT, "findings": CHANGES[:1]})
    assert not stability.draw_changes(tmp_path / "none.png", {**RESULT, "findings": [OPTIMUM]})
    assert not (tmp_path / "none.png").exists()
