"""scripts/research/installation_judgement.py and its sites: errors drawn apart, truths, and what intervals hold."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("pandas")
pytest.importorskip("sumolib")

import tests.research  # noqa: F401
import installation_judgement as script
import installation_sites
from arguments import SCENES
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import prepare
from tests.test_make_traffic import needs_sumo

SITES = installation_sites.sites(None)
CROSSINGS = [one for one in SITES.values() if isinstance(one, installation_sites.Crossing)]


def test_errors_fill_the_installers_box_one_in_each_slice_of_each_coordinate():
    errors = script.errors_drawn(50, 3)
    assert errors == script.errors_drawn(50, 3)
    for key, width in script.HALF_WIDTHS.items():
        values = np.array([error[key] for error in errors]) / width
        assert sorted(np.floor(25.0 * (values + 1.0))) == list(range(50))
    apart = np.corrcoef([list(error.values()) for error in errors], rowvar=False)[~np.eye(4, dtype=bool)]
    assert np.abs(apart).max() < 0.5


def test_a_mounting_hangs_as_planned_then_off_by_each_error_and_at_its_place():
    scenario = scenario_of({"traffic": {"path": str(SCENES / "i80_sample.csv.gz")}})
    planned = scenario.lidar.baseline.as_table() | {"height_m": 3.0, "tilt_x_deg": 10.0}
    layouts = script.hung(scenario, planned, [dict.fromkeys(script.HALF_WIDTHS, 0.01)])
    (first,), (second,) = ([mounting.as_table() for mounting in layout] for layout in layouts)
    for key in script.MOUNTED:
        off = 0.01 if key in script.HALF_WIDTHS else 0.0
        assert first[key] == pytest.approx(planned[key], abs=1e-9)
        assert second[key] == pytest.approx(planned[key] + off, abs=1e-9)


@pytest.fixture
def truth():
    """Ten blocks of ten vehicles; nine found as planned, on average seven under two errors."""
    rows = np.array([[9] * 10, [8] * 10, [4, 8] * 5], dtype=float)
    return script.Truth(rows, np.full(10, 10.0))


def test_a_truth_as_hung_is_the_mean_over_the_errors_with_the_error_of_its_blocks(truth):
    assert (truth.planned, truth.hung) == pytest.approx((0.9, 0.7))
    means = np.array([6.0, 8.0] * 5) / 10.0
    assert truth.standard_error() == pytest.approx(means.std(ddof=1) / np.sqrt(10))
    assert truth.standard_error(truth) == 0.0


def test_what_lies_above_nine_of_ten_is_a_share_of_installations(truth):
    assert truth.share_above(0.3) == 1.0
    assert truth.share_above(0.79) == pytest.approx(0.5, abs=0.01)
    assert truth.share_above(0.8) == 0.0


def test_an_answer_is_held_against_its_truth_as_hung_and_against_the_sharp_one(truth):
    told = {"share": 0.72, "interval_90": [0.68, 0.76], "gain": 0.1, "gain_interval_90": [-0.1, 0.2]}
    base = script.Truth(np.full((3, 10), 4.0), np.full(10, 10.0))
    row = script.row_of({**told, "nine_of_ten": 0.3}, truth, base, sharp=base)
    assert row["held"]
    assert not row["gain_held"]  # it is 0.3
    assert (row["half"], row["over_sharp"], row["above_nine_of_ten"]) == pytest.approx((0.04, 0.3, 1.0))
    assert not script.row_of({**told, "interval_90": None}, truth, base)["held"]


def test_figures_are_those_of_the_blocks_that_judge():
    held_out = {"detectable_share": 0.8, "detectable_share_interval_90": None, "detectable_share_gain": 0.1}
    held_out |= {
        "detectable_share_gain_interval_90": [0.0, 0.2],
        "as_hung": {"detectable_share": 0.7, "nine_of_ten": 0.6},
    }
    result = {"cross_fitted": None, "holdout": held_out}
    assert script.told_of(result, as_hung=False)["share"] == 0.8
    crossed = {"cross_fitted": {"optimised": held_out}, "holdout": None}
    assert script.told_of(crossed, as_hung=True) == {**held_out["as_hung"], "share": 0.7}


def test_sites_are_ten_and_the_same_each_time():
    assert len(SITES) == 10
    assert installation_sites.sites(None) == SITES


@needs_sumo
@pytest.mark.parametrize("number", range(len(CROSSINGS)))
def test_a_crossing_has_traffic_and_a_pole_off_the_lanes(number, tmp_path, monkeypatch):
    monkeypatch.setattr(installation_sites, "SAMPLE_S", 60)
    monkeypatch.setattr(installation_sites, "WARM_UP_S", 30)
    scenario = installation_sites.scene_of(CROSSINGS[number], tmp_path / "site" / "1", 1, 5, model={"workers": 1})
    assert sum(frame.counted.sum() for frame in prepare(scenario).search) > 20
    assert dataclasses.asdict(scenario.region)["junction"] == "middle"
