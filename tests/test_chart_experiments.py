"""What the chart switches on and off: every ablation of a scene."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.sensors.model import load_model
from blender_lidar.studies.driver import Job, landscapes
from blender_lidar.studies.variations import ablations, without_offsets
from tests.small_scene import MAPPED, mounting, traffic_rows, write_scene, write_table

LAYOUTS = tuple((mounting({"height_m": height, "tilt_x_deg": tilt}),) for height, tilt in ((3.0, 14.0), (4.4, 6.0)))


def test_every_ablation_can_be_sent_to_a_worker_and_has_a_name_of_its_own(site):
    changes = ablations(site, 3)
    sides = {one.stage: one for change in changes for pair in change.pairs for one in pair}
    assert len({(change.what, change.value) for change in changes}) == len(changes)
    assert [one.stage for one in pickle.loads(pickle.dumps(list(sides.values())))] == list(sides)
    wanted = "median barrier, body shape, finer shape, glass drop-out, azimuth offsets, range noise, drop-out"
    wanted += ", weak returns, unit spread"
    assert {change.what for change in changes} >= set(wanted.split(", "))


def test_ablations_change_scores(site):
    """At 20 m from two lanes weak returns need not matter."""
    for change in ablations(site, 1):
        if change.pairs and change.what != "weak returns":
            both = [next(landscapes(site, [Job(one, LAYOUTS)])).objective for one in change.pairs[0]]
            assert not np.allclose(*both, rtol=1e-9), change


def test_offsets_left_out_are_all_0_and_the_other_rings_keep_their_beams(tmp_path):
    settings = {**MAPPED, "sensor": {"name": "RS-80", "rotation_hz": 10.0}}
    site = prepare(load_scenario(write_scene(tmp_path, settings)))
    assert load_model("RS-80").azimuth_offset_rad.any()
    level = without_offsets(site).observation.lattice
    assert not level.slot_azimuth0_rad.any()
    assert not level.shift.any()
    np.testing.assert_array_equal(level.elevation_rad, site.observation.lattice.elevation_rad)
    assert level.columns == site.observation.lattice.columns
    assert all(one.pairs for one in ablations(site, 1))


def test_a_sensor_without_offsets_says_so(site):
    (change,) = (one for one in ablations(site, 2) if one.what == "azimuth offsets")
    assert (change.pairs, change.note) == ((), "the beam table of the RS-16 has none")


def test_a_sensor_that_is_imperfect_at_random_is_drawn_several_times_and_no_other_is(site):
    changes = {one.what: one for one in ablations(site, 3)}
    drawn = {what for what, change in changes.items() if len(change.pairs) == 3}
    assert drawn == {"glass drop-out", "range noise", "drop-out", "unit spread"}
    assert all(len(change.pairs) == 1 for what, change in changes.items() if what not in {*drawn, "azimuth offsets"})
    for what in drawn:
        perfect, imperfect = zip(*changes[what].pairs, strict=True)
        assert len({one.stage for one in perfect}) == 1
        scores = [next(landscapes(site, [Job(one, LAYOUTS)])).objective for one in imperfect]
        assert not np.allclose(scores[0], scores[1])


@pytest.mark.parametrize("key", ["glass_dropout", "dropout"])
def test_what_the_scene_has_is_left_out_once_and_both_sides_draw_the_same(key, tmp_path):
    write_table(tmp_path / "traffic.csv", traffic_rows())
    noisy = prepare(load_scenario(write_scene(tmp_path, {**MAPPED, "sensor": {key: 0.2, "unit_spread_deg": 0.1}})))
    changes = ablations(noisy, 2)
    assert len({(one.what, one.value) for one in changes}) == len(changes)
    ours = [one for one in changes if one.value == "0.2, as the scene has it"]
    assert len(ours) == 1
    for draw, (without, having) in enumerate(ours[0].pairs, start=1):
        left_out, there = (one.changed(noisy) for one in (without, having))
        assert (left_out.scenario.sensor.unit_spread_deg, left_out.observation.lidar.imperfections.seed) == (0.1, draw)
        assert getattr(left_out.observation.lidar.imperfections, key) == 0.0
        assert getattr(there.observation.lidar.imperfections, key) == 0.2
        assert there.observation.lidar.imperfections.seed == draw
    spread = next(one for one in changes if one.what == "unit spread")
    assert [one.stage for _, one in spread.pairs] == [one.stage for _, one in ours[0].pairs]
