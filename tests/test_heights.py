"""A map with heights: the surface is the ground, vehicles and masts stand on it, and a level map scores as ever."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.clouds.snapshot import mounted_sensors
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.studies.variations import ablations, traffic_variations
from blender_lidar.toml_table import to_toml

pytestmark = pytest.mark.versions

HEADER = "frame,vehicle_id,class,x_m,y_m,length_m,width_m,height_m,heading_deg,time_s"


def xodr(elevation: str) -> str:
    """A straight road of two lanes of 3.5 m along +x, from x -200 to 200 m, by OpenDRIVE."""
    width = '<width sOffset="0" a="3.5" b="0" c="0" d="0"/>'
    lanes = "".join(
        f'<{side}><lane id="{number}" type="driving" level="false">{width}</lane></{side}>'
        for side, number in (("left", 1), ("right", -1))
    )
    return (
        '<OpenDRIVE><header revMajor="1" revMinor="4"/><road name="" length="400" id="1" junction="-1"><planView>'
        '<geometry s="0" x="-200" y="0" hdg="0" length="400"><line/></geometry></planView>'
        f"<elevationProfile>{elevation}</elevationProfile><lanes><laneSection s='0'>{lanes[: lanes.index('<right>')]}"
        f"<center><lane id='0' type='none' level='false'/></center>{lanes[lanes.index('<right>') :]}"
        "</laneSection></lanes></road></OpenDRIVE>"
    )


def elevation(s, a, b, c=0.0):
    return f'<elevation s="{s}" a="{a}" b="{b}" c="{c}" d="0"/>'


LEVEL = elevation(0, 0, 0)
RISE = 0.06
SLOPE = elevation(0, 50.0, RISE)  # z = 62 at x = 0
CREST = elevation(0, 0, 0) + elevation(200, 0.0, 0.0, -1.0 / 400.0)  # level, then falling as a parabola beyond x = 0


def scene(folder, profile, *, z_m=None, caster="exact", **deployment):
    path, table = folder / "road.xodr", folder / "boxes.csv"
    path.write_text(xodr(profile))
    rows = []
    for frame in range(12):
        for number, (x, y) in enumerate([(-40.0, -1.75), (-12.0, -1.75), (9.0, 1.75), (26.0, -1.75), (45.0, 1.75)]):
            x_m, heading = x + (4.0 if y < 0.0 else -4.0) * 0.5 * frame, 0.0 if y < 0.0 else 180.0
            z = "" if z_m is None else f",{z_m(x_m) + 0.75}"
            rows.append(f"{frame},{number},car,{x_m},{y},4.5,1.8,1.5,{heading},{0.5 * frame}{z}")
    table.write_text("\n".join([HEADER + ("" if z_m is None else ",z_m"), *rows]))
    settings = {
        "traffic": {"path": str(table), "format": "table", "frames": 4, "holdout": 0.0, "accept": ["tracks"]},
        "road": {"opendrive": str(path)},
        "region": {"centre_m": [0.0, 0.0], "radius_m": 60.0},
        "sensor": {"name": "RS-16", "range_gate_m": 80.0},
        "deployment": {"x_m": 0.0, "y_m": -7.0, **deployment},
        "model": {"workers": 1, "caster": caster},
    }
    return scenario_of(settings)


HUNG = {"height_m": 4.0, "tilt_x_deg": 12.0}


def cloud_of(scenario, frame, **hung):
    vehicles = next(one for one in prepare(scenario).search if one.frame >= frame)
    return mounted_sensors(scenario, (scenario.lidar.mounting({**HUNG, **hung}),))[0].scan(vehicles)


def totals(scenario, **hung):
    one = prepare(scenario)
    layout = (scenario.lidar.mounting({**HUNG, **hung}),)
    return one, Evaluator(one.search, one.observation, one.scoring).totals([layout])


def test_a_mast_and_the_vehicles_stand_on_the_slope(tmp_path):
    scenario = scene(tmp_path, SLOPE)
    site = prepare(scenario)
    mounting = scenario.lidar.mounting(HUNG)
    assert mounting.mast.foot_m[2] == pytest.approx(62.0, abs=1e-6)
    assert mounting.pose.position[2] == pytest.approx(66.0, abs=1e-6)
    for frame in site.search:
        centre = frame.centre_m
        np.testing.assert_allclose(centre[:, 2], 62.0 + RISE * centre[:, 0] + 0.75, atol=1e-9)


def test_every_road_point_of_a_cloud_lies_on_the_heights_and_none_on_the_plane(tmp_path):
    scenario = scene(tmp_path, SLOPE)
    cloud = cloud_of(scenario, 0)
    ground = cloud.xyz[cloud.vehicle_id < 0]
    assert len(ground) > 1000
    np.testing.assert_allclose(ground[:, 2], 62.0 + RISE * ground[:, 0], atol=1e-6)
    assert scenario.plane_returns is False


def test_a_crest_hides_the_road_beyond_it_as_geometry_says(tmp_path):
    """A ray that grazes z = -x^2 / 400 from (0, 4) touches it at x = 40: what lies beyond is hidden, at any tilt."""
    scenario = scene(tmp_path, CREST)
    cloud = cloud_of(scenario, 0, tilt_x_deg=0.0)
    ground = cloud.xyz[(cloud.vehicle_id < 0) & (np.abs(cloud.xyz[:, 1] + 7.0) < 3.0) & (cloud.xyz[:, 0] > 5.0)]
    assert len(ground) > 20
    x = ground[:, 0]
    expected = np.where(x > 0.0, -np.square(x) / 400.0, 0.0)
    np.testing.assert_allclose(ground[:, 2], expected, atol=0.02)  # the grid is 2 m wide
    assert x.max() <= 40.5


@pytest.mark.parametrize(("caster", "needs"), [("raster", "numba"), ("embree", "embreex"), ("bvh", "bpy")])
def test_casters_agree_on_heights_to_the_last_digit(tmp_path, caster, needs):
    pytest.importorskip(needs, reason=f"{needs} is not installed")
    _, found = totals(scene(tmp_path, SLOPE, caster=caster))
    (tmp_path / "other").mkdir()
    _, other = totals(scene(tmp_path / "other", SLOPE))
    np.testing.assert_array_equal(found.objective, other.objective)


def test_a_level_map_at_any_altitude_scores_as_one_at_zero(tmp_path):
    (tmp_path / "high").mkdir()
    (_, low), (_, high) = totals(scene(tmp_path, LEVEL)), totals(scene(tmp_path / "high", elevation(0, 300.0, 0.0)))
    np.testing.assert_array_equal(low.objective, high.objective)


def test_boxes_with_the_maps_heights_stay_where_they_are(tmp_path):
    (tmp_path / "given").mkdir()
    lifted, found = totals(scene(tmp_path, SLOPE))
    given, same = totals(scene(tmp_path / "given", SLOPE, z_m=lambda x: 62.0 + RISE * x))
    np.testing.assert_allclose(found.objective, same.objective, atol=1e-6)
    assert not any("not lifted" in note for note in given.recording.report.notes)
    assert not any("not lifted" in note for note in lifted.recording.report.notes)


def test_heights_of_boxes_that_a_level_map_has_not_are_told(tmp_path):
    site = prepare(scene(tmp_path, LEVEL, z_m=lambda x: 0.01 * x + 0.2))
    assert any("they are not lifted to the surface of [road]" in note for note in site.recording.report.notes)


def test_level_boxes_on_a_slope_of_six_per_cent_score_nearly_as_pitched_ones(tmp_path):
    """The pitched oracle is the level road with the mast leant by the slope: the same picture, turned."""
    one, slope = totals(scene(tmp_path, SLOPE))
    (tmp_path / "level").mkdir()
    scenario = scene(tmp_path / "level", LEVEL)
    level = prepare(scenario)
    mounting = scenario.lidar.mounting({**HUNG, "tilt_y_deg": math.degrees(math.atan(RISE))})
    pitched = Evaluator(level.search, level.observation, level.scoring).totals([(mounting,)])
    assert slope.objective == pytest.approx(pitched.objective, rel=0.25)
    assert one.scenario.road_map.surface.is_flat is False


def test_a_detector_refuses_heights_in_one_line(tmp_path, capsys):
    path = tmp_path / "slope.toml"
    path.write_text(to_toml(scene(tmp_path, SLOPE, height_m=[3.0, 5.0]).with_whole_paths()))
    for verb in ("detect", "optimise", "evaluate"):
        words = () if verb == "detect" else ("--detector", "pillars")
        assert main([verb, str(path), *words, "--out", str(tmp_path / verb)]) == 2
        told = capsys.readouterr().err
        assert "[road] opendrive has heights; a detector needs a level map" in told
        assert told.count("\n") == 1


def test_chart_and_stability_can_level_the_road_and_a_level_road_has_no_such_row(tmp_path):
    (tmp_path / "level").mkdir()
    (site, sloped), (flat, level) = totals(scene(tmp_path, SLOPE)), totals(scene(tmp_path / "level", LEVEL))
    ((without, own),) = next(one.pairs for one in ablations(site, 1) if one.what == "heights")
    layout = (site.scenario.lidar.mounting(HUNG),)
    made = without.changed(site)
    found = Evaluator(made.search, made.observation, made.scoring).totals([layout])
    np.testing.assert_allclose(found.objective, level.objective, atol=1e-9)
    assert (found.objective != sloped.objective).any()
    assert own.changed(site) is site or own.changed(site).search == site.search
    assert [one.what for one in traffic_variations(site, 1)].count("heights") == 1
    assert not any(one.what == "heights" for one in (*ablations(flat, 1), *traffic_variations(flat, 1)))
