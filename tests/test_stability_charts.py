"""The charts of stability: every row, mark and limit is where the numbers say."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.plots import stability

pytest.importorskip("matplotlib")

CHANGES = [
    stability.Change("traffic", "density: light", "stable", -0.02, (-0.04, 0.0), [22.0, 24.0]),
    stability.Change("metric", "cell size: 2.5 cm", "fragile", 0.08, (0.01, 0.15), [19.0]),
    stability.Change("metric", "other metric: s-mig", "fails", 1.8, None, [1.0]),
]


@pytest.fixture
def drawn(monkeypatch):
    """Figures as they are saved."""
    figures = []
    save = stability.sheet.__wrapped__.__globals__["save"]

    def keep(figure, path):
        figures.append(figure)
        save(figure, path)

    monkeypatch.setitem(stability.sheet.__wrapped__.__globals__, "save", keep)
    return figures


def lines_at(axes, row):
    return [line for line in axes.lines if len(line.get_ydata()) and np.all(np.asarray(line.get_ydata()) == row)]


def test_every_change_has_a_row_with_its_loss_its_interval_and_its_optima(drawn, tmp_path):
    stability.plot_changes(
        tmp_path / "changes.png", CHANGES, limits=(0.05, 0.2), reference=23.0, interval=(20.0, 24.0), label="Tilt [deg]"
    )
    lost, moved = drawn[0].axes
    assert [label.get_text() for label in lost.get_yticklabels()] == [one.name for one in CHANGES]
    span, mark = lines_at(lost, 0)
    np.testing.assert_allclose(span.get_xdata(), [-4.0, 0.0])
    np.testing.assert_allclose(mark.get_xdata(), -2.0)
    _, beyond = lines_at(lost, 2)
    assert beyond.get_xdata()[0] == lost.get_xlim()[1]  # a loss beyond the rim is drawn on it
    span, mark = lines_at(moved, 0)
    np.testing.assert_allclose(span.get_xdata(), [22.0, 24.0])
    np.testing.assert_allclose(mark.get_xdata(), 23.0)
    markers = [lines_at(lost, row)[1].get_marker() for row in range(3)]
    assert len(set(markers)) == 3  # verdicts are told apart without colour
    assert (tmp_path / "changes.png").stat().st_size > 1000


def test_without_an_interval_and_without_changes(tmp_path):
    stability.plot_changes(
        tmp_path / "one.png", CHANGES[:1], limits=(0.05, 0.2), reference=23.0, interval=None, label="Tilt [deg]"
    )
    with pytest.raises(InputError, match="none given"):
        stability.plot_changes(
            tmp_path / "none.png", [], limits=(0.05, 0.2), reference=23.0, interval=None, label="Tilt [deg]"
        )
    assert not (tmp_path / "none.png").exists()


@pytest.mark.parametrize("needed", [4000.0, 300.0])
def test_the_curve_ends_at_what_is_at_hand_and_goes_on_by_its_power_to_what_is_needed(drawn, tmp_path, needed):
    stability.plot_sample_size(
        tmp_path / "size.png", [100.0, 300.0, 1000.0], [5.0, 3.0, 2.0], power=0.5, needed=needed, asked=1.0
    )
    (axes,) = drawn[0].axes
    measured, ahead = axes.lines[:2]
    assert measured.get_xdata()[-1] == ahead.get_xdata()[0] == 1000.0
    np.testing.assert_allclose(ahead.get_ydata(), 2.0 * (np.asarray(ahead.get_xdata()) / 1000.0) ** -0.5)
    marks = [line for line in axes.lines if list(line.get_xdata()) == [needed]]
    assert len(marks) == (needed > 1000.0)


def test_a_profile_has_its_tolerance_shaded_and_the_whole_gain_as_a_line(drawn, tmp_path):
    offsets = np.linspace(-5.0, 5.0, 11)
    profiles = {"Tilt [deg]": (offsets, 1.0 - np.abs(offsets) / 50.0), "Yaw [deg]": (offsets, np.ones(11))}
    stability.plot_profiles(tmp_path / "off.png", profiles, {"Tilt [deg]": 1.0})
    tilt, yaw = drawn[0].axes
    np.testing.assert_allclose(tilt.lines[0].get_ydata(), 100.0 - 2.0 * np.abs(offsets))
    (shade,) = tilt.patches
    assert shade.get_x() == -1.0
    assert shade.get_width() == 2.0
    assert not yaw.patches
