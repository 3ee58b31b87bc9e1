"""The picture of speed against accuracy: every point is there and named, and no name lies on another."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.plots import speed_accuracy
from blender_lidar.plots.speed_accuracy import Mark, plot_speed_accuracy

pytest.importorskip("matplotlib")


@pytest.fixture
def drawn(monkeypatch):
    """Figures as they are saved."""
    figures = []
    space = speed_accuracy.sheet.__wrapped__.__globals__
    save = space["save"]

    def keep(figure, path):
        figures.append(figure)
        save(figure, path)

    monkeypatch.setitem(space, "save", keep)
    return figures


def marks(count: int, seed: int = 1) -> list[Mark]:
    """A reference without error and so many others, in clusters as a ladder has them."""
    rng = np.random.default_rng(seed)
    time = np.exp(rng.choice([3.0, 4.0, 5.0], count) + rng.normal(scale=0.25, size=count))
    error = 0.02 * np.exp(rng.normal(scale=0.4, size=count))
    details = rng.choice(["box", "body", "detailed"], count).tolist()
    others = [
        Mark(f"{detail} 1/{row}", (0.9 * ms, ms, 1.1 * ms), off, detail, row % 7 == 0, False, row == 0)
        for row, (detail, ms, off) in enumerate(zip(details, time.tolist(), error.tolist(), strict=True))
    ]
    return [Mark("reference", (280.0, 300.0, 320.0), 0.0, "detailed", False, True, False), *others]


def draw(path, given, **changes):
    settings = {"noise": (0.015, 0.02, 0.03), "tolerance": 0.003, "unit": "bits", "title": "Speed"} | changes
    plot_speed_accuracy(path, given, **settings)


def test_fifty_points_are_named_and_no_name_lies_on_another_or_outside(drawn, tmp_path):
    given = marks(50)
    draw(tmp_path / "chart.png", given)
    (axes,) = drawn[0].axes
    names = {mark.name for mark in given}
    texts = [text for text in axes.texts if text.get_text() in names]
    assert {text.get_text() for text in texts} == names
    boxes = [text.get_window_extent() for text in texts]
    for one, other in combinations(boxes, 2):
        width = min(one.x1, other.x1) - max(one.x0, other.x0)
        height = min(one.y1, other.y1) - max(one.y0, other.y0)
        assert not (width > 0.5 and height > 0.5)
    inside = axes.get_window_extent()
    assert all(box.x0 >= inside.x0 and box.x1 <= inside.x1 for box in boxes)
    assert (tmp_path / "chart.png").stat().st_size > 1000


def test_points_lie_at_their_median_and_error_and_what_has_none_lies_at_0(drawn, tmp_path):
    given = marks(6)
    draw(tmp_path / "chart.png", given)
    (axes,) = drawn[0].axes
    shown = {
        (x, y)
        for line in axes.lines
        if line.get_linestyle() == "None"
        for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)
    }
    for mark in given:
        assert any(np.allclose(place, (mark.milliseconds[1], mark.error)) for place in shown)
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "linear")
    low, high = axes.get_ylim()
    assert low < 0.0
    assert high > max(0.03, *(mark.error for mark in given))  # the noise ceiling is seen whole


def test_where_nothing_errs_there_is_a_picture_all_the_same(drawn, tmp_path):
    draw(tmp_path / "chart.png", marks(0), noise=None, tolerance=None)
    assert drawn[0].axes[0].get_ylim() == pytest.approx((-0.05, 1.05))


def test_without_noise_tolerance_or_unit(drawn, tmp_path):
    draw(tmp_path / "chart.png", marks(3), noise=None, tolerance=None, unit="")
    labels = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert not {"tolerance", "reference, half of the blocks against the others"} & set(labels)
    assert drawn[0].axes[0].get_ylabel() == "Error after calibration"


def test_nothing_to_draw_is_refused(tmp_path):
    with pytest.raises(InputError, match="none given"):
        draw(tmp_path / "chart.png", [])
