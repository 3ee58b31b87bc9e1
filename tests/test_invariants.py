"""What holds of any form of a scene without a golden number: moved, turned, mirrored or weighed, it is the same."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.scene.directions import pointing
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import Evaluator
from tests.forms import AS_IT_LIES, USUAL, Motion, write_form
from tests.small_scene import CASTER

pytestmark = pytest.mark.versions

ANGLE_DEG = 37.0
MOVED = Motion(ANGLE_DEG, map_m=(512.25, -301.5))
PLAIN = USUAL | {"scenery": "box", "placing": "lean"}
FORMS = [
    {"road": "net"},
    {"road": "net", "region": "approaches", "lidars": "two", "placing": "poles"},
    {"road": "opendrive", "lidars": "one_held", "placing": "poles", "scored": "weights", "region": "lanes"},
    {"road": "heights", "region": "approaches", "placing": "fixed"},
    {"road": "driven", "lidars": "two"},
]
WEIGHTS = {"objective": {"class_weights": {"car": 0.5, "truck": 2.0}}}  # zones lie where they lie


def seen(folder, form, motion=None, **changes):
    """The site in some forms, and what a mounting of each LiDAR within its bounds sees of each frame's boxes."""
    form = {**PLAIN, **form}
    changes = {**(WEIGHTS if form["scored"] == "weights" else {}), **changes}
    form |= {"scored": "plain"} if form["scored"] == "weights" else {}
    site = prepare(load_scenario(write_form(folder, form, motion or AS_IT_LIES, **changes)))
    places = [lidar.deployment.places for lidar in site.scenario.lidars]
    chosen = [of[number % len(of)] for number, of in enumerate(places)]
    layout = tuple(place.mounting([0.3 * a + 0.7 * b for a, b in place.bounds.values()]) for place in chosen)
    frames = (*site.search, *site.holdout)
    with Evaluator(frames, site.observation, site.scoring) as evaluator:
        scored = evaluator.by_vehicle([layout])
    points = np.concatenate([one.seen.points[0] for one in scored])
    objective = np.concatenate([one.objective[0] for one in scored])
    return site, layout, points, objective


@pytest.mark.parametrize("caster", ["exact", CASTER, "raster"])
@pytest.mark.parametrize("form", FORMS, ids=lambda form: "-".join(form.values()))
def test_a_site_that_is_moved_and_turned_scores_the_same_and_points_turned(form, caster, tmp_path):
    if caster != "exact" and not is_available(caster):
        pytest.skip(f"{caster} is not installed")
    model = {"model": {"caster": caster, "workers": 1}}
    here, there = (seen(tmp_path / name, form, motion, **model) for name, motion in (("a", None), ("b", MOVED)))
    off = np.abs(here[2] - there[2])
    assert off.sum() <= (0 if caster == "exact" else 1)  # a ray that grazes an edge
    assert here[2].sum() > 1000
    assert there[3].sum() == pytest.approx(here[3].sum(), rel=1e-3)  # a return on the edge of a cell
    for number, (one, other) in enumerate(zip(here[1], there[1], strict=True)):
        np.testing.assert_allclose(MOVED.site(one.xy), other.xy, atol=1e-9)
        before, after = (pointing(site, layout[number]) for site, layout in (here[:2], there[:2]))
        turned = before["facing_bearing_deg"] - after["facing_bearing_deg"] - ANGLE_DEG
        assert math.remainder(turned, 360.0) == pytest.approx(0.0, abs=1e-6)
        assert before["lean_deg"] == pytest.approx(after["lean_deg"])
        place = before["x_m"], before["y_m"]
        if form["road"] != "driven":
            np.testing.assert_allclose(MOVED.map(place), (after["x_m"], after["y_m"]), atol=1e-6)


def test_a_mirrored_site_scores_the_same_from_the_mirrored_place(tmp_path):
    """The RS-16 has no azimuth offsets, so that its beams are their own mirror image."""
    model = {"model": {"caster": "exact", "workers": 1}}
    here, there = (
        seen(tmp_path / name, {"road": "driven"}, motion, **model)
        for name, motion in (("a", None), ("b", Motion(mirrored=True)))
    )
    off = np.abs(here[2] - there[2])
    assert off.sum() == 0
    assert there[3].sum() == pytest.approx(here[3].sum(), rel=5e-3)  # cells begin at a vehicle's right side
    (one,), (other,) = here[1], there[1]
    assert other.xy == pytest.approx((one.xy[0], -one.xy[1]))
    assert math.remainder(one.mast.facing_rad + other.mast.facing_rad, math.tau) == pytest.approx(0.0)


def test_a_class_of_weight_two_counts_as_if_each_of_its_boxes_were_there_twice(tmp_path):
    once = seen(tmp_path / "once", {"road": "net"})
    twice = seen(tmp_path / "twice", {"road": "net"}, objective={"class_weights": {"car": 2.0}})
    cars = np.concatenate([f.class_name[f.counted] == "car" for f in (*once[0].search, *once[0].holdout)])
    np.testing.assert_array_equal(once[2], twice[2])
    np.testing.assert_allclose(twice[3], np.where(cars, 2.0, 1.0) * once[3])
    assert cars.any()
    assert not cars.all()
