"""A frame's scorer: against a pipeline without any short cut, compiled against NumPy's, and against scans.

The pipeline casts all beams in float64 and loops over points.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.casting import caster_class, is_available
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.clouds.files import write_npz
from blender_lidar.clouds.points import read_points
from blender_lidar.compiled import numba_works
from blender_lidar.metrics import view_grids
from blender_lidar.metrics.vgop import entropy, occupancy, pe_vgop, to_vehicle_frame
from blender_lidar.names import THE_LIDAR
from blender_lidar.scene.observation import Observation
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import PERFECT, Imperfections
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model, unit_of
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.meshes import GLASS
from blender_lidar.world.scenery import barrier, box, join, structure
from blender_lidar.world.shapes import DETAILS
from blender_lidar.world.triangles import vehicle_triangles
from tests.sample_traffic import dense_traffic, joined, one_vehicle, scan

pytestmark = pytest.mark.versions

LATTICES = {name: beam_lattice(load_model(name), stride=20) for name in ("RS-16", "RS-LiDAR-32", "RS-BPearl")}
LATTICES["a unit of RS-80"] = beam_lattice(unit_of(load_model("RS-80"), 0.1, 3), stride=50)
POSE = Pose(height_m=4.1, tilt_x=math.radians(19.0))
ROUGH = Imperfections(0.05, 0.2, glass_dropout=0.4, seed=5)
NOISE_M, SHARE = st.sampled_from([0.0, 0.02, 0.3, 3.0]), st.sampled_from([0.0, 0.1, 0.7])
GLASS_SHARE = st.sampled_from([0.0, 0.5, 1.0])


def observation(
    lattice=LATTICES["RS-16"],
    *,
    gate=50.0,
    near=0.4,
    detail="body",
    cell=0.05,
    reading="corrected",
    imperfections=PERFECT,
    **more,
):
    lidar = Lidar(lattice, gate, near, imperfections)
    return Observation((lidar,), observation.caster, detail, cell, reading, **more)


def together(*observations):
    """Several LiDARs beside the scenery of the first."""
    return replace(observations[0], lidars=tuple(one.lidar for one in observations))


@pytest.fixture(params=["exact", "raster", "embree", "bvh"], autouse=True)
def caster(request):
    """All that follows is asked of the path through NumPy and of the compiled ones."""
    if not is_available(request.param):
        pytest.skip(f"{request.param} is not installed")
    observation.caster = request.param
    return request.param


def everyone(vehicles):
    return np.ones(len(vehicles), dtype=bool)


def slow_pipeline(vehicles, counted, seen, *poses):
    """Points by LiDAR and occupancies of the counted vehicles: every beam cast, every draw and point looked at alone.

    Of several LiDARs the occupancies are those of the union of their cells.
    """
    triangles = vehicle_triangles(vehicles, seen.detail)
    points = np.zeros((len(poses), len(vehicles)), dtype=int)
    cells: list[tuple[set, set, set]] = [(set(), set(), set()) for _ in range(len(vehicles))]
    for number, (lidar, pose) in enumerate(zip(seen.lidars, poses, strict=True)):
        lattice, effects = lidar.lattice, lidar.imperfections
        rays = pose.to_world(lattice.directions.reshape(-1, 3))
        hits = caster_class("exact")(triangles.corners).cast(pose.position, rays)
        draws = lidar.measurement(vehicles.frame)
        for beam in np.flatnonzero(hits.triangle >= 0):
            owner = int(triangles.owner[hits.triangle[beam]])
            distance = hits.distance[beam] + (float(draws.noise_m[beam]) if len(draws.noise_m) else 0.0)
            glass = effects.glass_dropout if triangles.surface[hits.triangle[beam]] == GLASS else 0.0
            loss = 1.0 - (1.0 - effects.dropout) * (1.0 - glass)
            lost = loss == 1.0 or (len(draws.chance) and draws.chance[beam] < np.float32(loss))
            if lost or not lidar.min_range_m <= distance <= lidar.max_range_m:
                continue
            points[number, owner] += 1
            away = pose.position + distance * rays[beam] - vehicles.centre_m[owner]
            heading, size = vehicles.heading_rad[owner], vehicles.size_m[owner]
            forward = away[0] * math.cos(heading) + away[1] * math.sin(heading)
            left = -away[0] * math.sin(heading) + away[1] * math.cos(heading)
            place = [(at + 0.5 * side) / seen.cell_m for at, side in zip((forward, left, away[2]), size, strict=True)]
            count = [math.ceil(side / seen.cell_m - 1e-9) for side in size]
            if any(at < -1.0 or at >= cells_ + 1.0 for at, cells_ in zip(place, count, strict=True)):
                continue  # noise has carried it away from its vehicle
            cell = [min(max(math.floor(at), 0), cells_ - 1) for at, cells_ in zip(place, count, strict=True)]
            for view, (a, b) in zip(cells[owner], ((0, 1), (0, 2), (1, 2)), strict=True):
                view.add((cell[a], cell[b]))
    whole = [[math.ceil(side / seen.cell_m - 1e-9) for side in size] for size in vehicles.size_m]
    shares = [
        [len(view) / (n[a] * n[b]) for view, (a, b) in zip(views, ((0, 1), (0, 2), (1, 2)), strict=True)]
        for views, n in zip(cells, whole, strict=True)
    ]
    return points[:, counted], np.array(shares).reshape(-1, 3)[counted]


@settings(max_examples=10)
@given(
    seed=st.integers(0, 2**32 - 1),
    sensor=st.sampled_from(sorted(LATTICES)),
    detail=st.sampled_from(DETAILS),
    height=st.floats(0.5, 6.0),
    angles=st.tuples(st.floats(-0.7, 0.7), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0)),
    near=st.sampled_from([0.0, 5.0]),
    effects=st.just(PERFECT)
    | st.builds(Imperfections, NOISE_M, SHARE, glass_dropout=GLASS_SHARE, seed=st.integers(0, 9)),
)
def test_points_and_occupancies_equal_those_of_the_slow_pipeline(seed, sensor, detail, height, angles, near, effects):
    rng = np.random.default_rng(seed)
    vehicles = dense_traffic(seed=seed, vehicles=8, length_m=30.0, frame=seed % 100)
    counted = rng.random(8) < 0.7
    seen = observation(LATTICES[sensor], gate=20.0, near=near, detail=detail, imperfections=effects)
    pose = Pose(0.0, 0.0, height, *angles)
    found = FrameScorer(replace(vehicles, counted=counted), seen).see(singles([pose]))
    points, shares = slow_pipeline(vehicles, counted, seen, pose)
    np.testing.assert_array_equal(found.by_lidar[0], points)
    np.testing.assert_allclose(found.occupancy[0], shares, rtol=1e-12, atol=0.0)


def test_a_vehicle_that_does_not_count_still_hides_another():
    car, bus = one_vehicle("car", centre=(0.0, 12.0)), one_vehicle("bus", centre=(0.0, 7.0))
    pose, seen = Pose(height_m=2.0, tilt_x=0.1), observation()
    alone = FrameScorer(car, seen).see(singles([pose])).points[0]
    both = joined(car, bus)
    behind = FrameScorer(replace(both, counted=np.array([True, False])), seen).see(singles([pose])).points[0]
    assert alone[0] > 5
    assert behind.tolist() == [0]
    np.testing.assert_array_equal(FrameScorer(both, seen).see(singles([pose])).points[0, 0], behind[0])


@pytest.mark.parametrize("effects", [PERFECT, ROUGH], ids=["perfect", "rough"])
def test_mountings_together_and_one_by_one_and_in_any_order_see_the_same(effects):
    vehicles = dense_traffic(vehicles=40, length_m=100.0)
    seen = observation(LATTICES["RS-LiDAR-32"], imperfections=effects)
    rng = np.random.default_rng(3)
    poses = [Pose(0.0, 0.0, rng.uniform(2, 4.5), rng.uniform(0, 0.4)) for _ in range(5)]
    scorer = FrameScorer(vehicles, seen)
    together = scorer.see(singles(poses))
    np.testing.assert_array_equal(scorer.see(singles(poses[::-1])).occupancy[::-1], together.occupancy)
    assert (together.points.shape, together.occupancy.shape) == ((5, 40), (5, 40, 3))
    for number, pose in enumerate(poses):
        alone = FrameScorer(vehicles, seen).see(singles([pose]))
        np.testing.assert_array_equal(together.points[number], alone.points[0])
        np.testing.assert_array_equal(together.occupancy[number], alone.occupancy[0])
    assert scorer.see(singles([])).points.shape == (0, 40)


def test_points_lie_on_their_vehicle_and_are_as_many_as_counted():
    vehicles, seen = dense_traffic(vehicles=40, length_m=100.0), observation()
    counted = np.random.default_rng(4).random(40) < 0.5
    scorer = FrameScorer(replace(vehicles, counted=counted), seen)
    local, row = scorer.vehicle_points(POSE)
    np.testing.assert_array_equal(np.bincount(row, minlength=len(scorer)), scorer.see(singles([POSE])).points[0])
    assert (np.abs(local) <= 0.5 * vehicles.size_m[counted][row] + 1e-9).all()


@pytest.mark.parametrize("vehicles", [0, 5])
def test_a_frame_in_which_nothing_counts_has_no_points(vehicles):
    frame = dense_traffic(vehicles=vehicles, length_m=40.0)
    scorer = FrameScorer(replace(frame, counted=np.zeros(vehicles, dtype=bool)), observation())
    seen = scorer.see(singles([POSE, POSE]))
    assert len(scorer) == 0
    assert (seen.points.shape, seen.occupancy.shape) == ((2, 0), (2, 0, 3))
    assert len(scorer.vehicle_points(POSE)[0]) == 0


def test_the_literal_reading_and_the_cell_reach_the_metric():
    vehicles = dense_traffic(vehicles=10, length_m=40.0)
    counted = everyone(vehicles)
    corrected, literal, coarse = (
        FrameScorer(replace(vehicles, counted=counted), observation(**settings)).see(singles([POSE])).occupancy[0]
        for settings in ({}, {"reading": "paper"}, {"cell": 0.5})
    )
    assert (literal >= corrected).all()
    assert literal.sum() > corrected.sum()
    assert coarse.sum() > 2.0 * corrected.sum()


# --- compiled passes against NumPy's ----------------------------------------------------------------------------------

TRAFFIC = dense_traffic(seed=6, vehicles=40, length_m=120.0, frame=7)
ROOF = TRAFFIC.centre_m[3] + [0.0, 0.0, 0.5 * TRAFFIC.size_m[3, 2]]
POSES = [
    Pose(height_m=4.1, tilt_x=0.3),
    Pose(2.0, 30.0, 1.5, -0.4, 0.2, 2.0),
    Pose(*TRAFFIC.centre_m[3].tolist()),  # inside
    Pose(*ROOF.tolist()),  # on the roof
    Pose(x_m=10_000.0),  # from where nothing is in range
]
STANDING = join(
    [
        barrier("concrete", 10.0, (-40.0, 40.0)),
        barrier("guard_rail", 6.0, (-30.0, 50.0)),
        box("gantry", (4.0, 9.0, 4.0), (0.4, 12.0, 0.6), 0.2),
    ]
)
EFFECTS = {
    "perfect": Imperfections(),
    "drop-out": Imperfections(dropout=0.2),
    "noise": Imperfections(range_noise_m=0.3),
    "glass": Imperfections(glass_dropout=1.0),
    "some glass": Imperfections(glass_dropout=0.5),
    "weak": Imperfections(range_at_10_percent_m=9.0),
    "all": Imperfections(0.05, 0.1, glass_dropout=0.4, range_at_10_percent_m=15.0, seed=5),
}


def assert_same(found, expected):
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.occupancy, expected.occupancy)


@pytest.fixture
def _compiles(caster):
    if caster == "exact" or not numba_works():
        pytest.skip("this one has no compiled passes")


@pytest.mark.usefixtures("_compiles")
@pytest.mark.parametrize(
    ("effects", "scenery"),
    [*((effects, effects in ("drop-out", "glass", "weak")) for effects in EFFECTS), ("all", True)],
)
def test_compiled_passes_count_what_numpys_count_to_the_last_digit(caster, effects, scenery, monkeypatch):
    """Whatever the sensor loses and whatever stands about, which once went through NumPy, more than twice as slow."""
    counted = np.random.default_rng(1).random(len(TRAFFIC)) < 0.7
    standing = StandingScenery(STANDING, caster) if scenery else None
    lattice = beam_lattice(load_model("RS-LiDAR-32"), stride=10)
    seen = observation(lattice, gate=60.0, near=3.0, imperfections=EFFECTS[effects], scenery=standing)
    scorer = FrameScorer(replace(TRAFFIC, counted=counted), seen)
    slow = []
    monkeypatch.setattr(
        scorer, "returns_of", lambda pose, *hits: slow.append(pose) or FrameScorer.returns_of(scorer, pose, *hits)
    )
    found = scorer.see(singles(POSES))
    assert slow in ([], POSES[3:4])  # on a roof all may be left to the float64 caster
    assert found.points[:2].sum() > 150
    assert not found.points[-1].any()
    assert_same(found, scorer.see(singles(POSES), keep_returns=True))  # whose returns are wanted goes through NumPy
    monkeypatch.setattr(view_grids, "numba_works", lambda: False)
    assert_same(found, scorer.see(singles(POSES), keep_returns=True))


@pytest.mark.usefixtures("_compiles")
@pytest.mark.parametrize(("detail", "culled"), [("box", False), ("detailed", True)])
def test_compiled_passes_do_so_at_every_detail_and_without_culling(detail, culled):
    scorer = FrameScorer(TRAFFIC, observation(detail=detail, culled=culled))
    assert_same(scorer.see(singles(POSES)), scorer.see(singles(POSES), keep_returns=True))


@pytest.mark.usefixtures("_compiles")
def test_a_mounting_at_a_surface_is_left_to_the_float64_caster():
    bus, seen = one_vehicle("bus", centre=(0.0, 5.0)), observation(detail="box")
    top = Pose(0.0, 5.0, float(bus.size_m[0, 2]))
    oracle = FrameScorer(bus, replace(seen, caster="exact"))
    assert_same(FrameScorer(bus, seen).see(singles([top])), oracle.see(singles([top])))


@pytest.mark.usefixtures("_compiles")
def test_a_beam_along_the_edge_of_what_hides_it_is_left_to_the_float64_caster(caster):
    """A wall whose top lies in the beams' way to the bus, to the last digit."""
    lattice, bus = beam_lattice(load_model("RS-16")), one_vehicle("bus", centre=(0.0, 10.0))
    corners = np.array([[[-9, 4, 0], [9, 4, 0], [9, 4, 2]], [[-9, 4, 0], [9, 4, 2], [-9, 4, 2]]], dtype=float)
    level = Pose(height_m=2.0, tilt_x=math.radians(1.0))  # the ring at 1 degree looks along the top
    seen = observation(lattice, scenery=StandingScenery(structure("wall", corners), caster))
    oracle = replace(seen, caster="exact", scenery=StandingScenery(structure("wall", corners), "exact"))
    found = FrameScorer(bus, seen).see(singles([level]))
    assert found.points[0, 0] > 100
    assert_same(found, FrameScorer(bus, oracle).see(singles([level])))


def test_beams_that_meet_but_the_margin_of_a_triangle_are_decided_in_float64(caster):
    """Past a box's upright edge by less than float32 can tell, to either side, in a scene that makes float32 coarse."""
    if caster not in ("embree", "bvh") or not numba_works():
        pytest.skip("of trees in float32, compiled")
    lattice, decided, beside = beam_lattice(load_model("RS-16")), 0, np.array([1e-9, 1e-8, -1e-9, -1e-8])
    pose, points = Pose(height_m=1.0), []
    for number, slot in enumerate(range(5, 205, 25)):
        azimuth = lattice.slot_azimuth0_rad[0] + slot * lattice.step_rad - beside[number % 4]
        car = one_vehicle("car", centre=(3.0 * math.tan(azimuth) - 2.0, 3.9), size=[4.0, 1.8, 1.5])
        both = joined(car, one_vehicle("car", centre=(200.0, 200.0)))
        seen = observation(lattice, near=0.0, detail="box")
        scorer, rays = FrameScorer(both, seen), []
        tree, decide = scorer.shapes.tree, scorer.shapes.tree.decide
        tree.decide = lambda *given, decide=decide, rays=rays: rays.append(len(given[1])) or decide(*given)
        found = scorer.see(singles([pose]))
        assert_same(found, FrameScorer(both, replace(seen, caster="exact")).see(singles([pose])))
        decided += sum(rays)
        points.append(int(found.points[0, 0]))
    assert decided > 0
    assert min(points) > 0


# --- scans ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("effects", "scenery"), [("perfect", False), ("all", True)], ids=["open", "hidden"])
@pytest.mark.parametrize("detail", DETAILS)
def test_a_scan_that_is_scored_has_the_scorers_occupancy_to_the_last_bit(caster, detail, effects, scenery, tmp_path):
    """In memory and from a file; a car's detailed roof once fell into another cell, where a face lies between two."""
    lattice, pose = beam_lattice(load_model("RS-80"), stride=12), Pose(0.3, -0.2, 4.1, 0.3, 0.02, 0.1)
    standing = StandingScenery(STANDING, caster) if scenery else None
    how = {"scenery": standing, "imperfections": EFFECTS[effects]}
    seen = FrameScorer(TRAFFIC, observation(lattice, detail=detail, **how)).see(singles([pose]))
    cloud = scan(TRAFFIC, lattice, pose, caster=caster, detail=detail, min_range_m=0.4, max_range_m=50.0, **how)
    write_npz(tmp_path / "cloud.npz", cloud, {})
    for points, vehicle_id in ((cloud.xyz, cloud.vehicle_id), read_points(tmp_path / "cloud.npz")):
        mine = vehicle_id >= 0
        row = np.searchsorted(TRAFFIC.vehicle_id, vehicle_id[mine])
        local = to_vehicle_frame(points[mine], TRAFFIC.centre_m, TRAFFIC.heading_rad, row)
        np.testing.assert_array_equal(np.bincount(row, minlength=len(TRAFFIC)), seen.points[0])
        np.testing.assert_array_equal(occupancy(local, row, TRAFFIC.size_m), seen.occupancy[0])
        np.testing.assert_array_equal(pe_vgop(local, row, TRAFFIC.size_m), entropy(seen.occupancy[0]).sum(axis=1))
    assert seen.points.sum() > 250


# --- several LiDARs under one mark ------------------------------------------------------------------------------------

SECOND = Pose(4.0, 24.0, 5.0, -0.3, 0.0, 0.5)


@pytest.mark.parametrize("effects", ["perfect", "all"])
@pytest.mark.parametrize("scenery", [False, True], ids=["open", "hidden"])
def test_two_lidars_see_the_union_that_numpy_gets_from_concatenated_points(caster, effects, scenery):
    """Sensors that differ in beams, range and noise; on a roof the whole layout is cast again."""
    standing = StandingScenery(STANDING, caster) if scenery else None
    first = observation(LATTICES["RS-16"], gate=60.0, imperfections=EFFECTS[effects], scenery=standing)
    second = observation(LATTICES["a unit of RS-80"], gate=40.0, near=3.0, scenery=standing)
    frame = replace(TRAFFIC, counted=np.random.default_rng(1).random(len(TRAFFIC)) < 0.7)
    both = FrameScorer(frame, together(first, second))
    singly = [FrameScorer(frame, each) for each in (first, second)]
    layouts = [(pose, SECOND) for pose in POSES] + [(SECOND, pose) for pose in POSES]
    found = both.see(layouts)
    for row, layout in enumerate(layouts):
        parts = [scorer.vehicle_points(pose) for scorer, pose in zip(singly, layout, strict=True)]
        local, rows = map(np.concatenate, zip(*parts, strict=True))
        np.testing.assert_array_equal(found.points[row], np.bincount(rows, minlength=len(both)))
        np.testing.assert_array_equal(found.occupancy[row], occupancy(local, rows, both.vehicles.size_m))
    assert_same(found, both.see(layouts, keep_returns=True))
    turned = FrameScorer(frame, together(second, first)).see([layout[::-1] for layout in layouts])
    assert_same(turned, found)


def test_two_equal_lidars_in_one_place_occupy_what_one_does():
    seen = observation(imperfections=ROUGH)
    one = FrameScorer(TRAFFIC, seen).see(singles(POSES))
    two = FrameScorer(TRAFFIC, together(seen, seen)).see([(pose, pose) for pose in POSES])
    np.testing.assert_array_equal(two.occupancy, one.occupancy)
    np.testing.assert_array_equal(two.points, 2 * one.points)


def test_lidars_with_one_seed_and_other_names_draw_apart_and_of_their_own():
    """That of [sensor] draws as it did before LiDARs had names."""
    rough = Imperfections(0.05, 0.2, seed=5)
    lidars = [Lidar(LATTICES["RS-16"], 50.0, 0.4, rough, name) for name in (THE_LIDAR, "north", "south")]
    noise = [lidar.measurement(7).noise_m for lidar in lidars]
    np.testing.assert_array_equal(noise[0], rough.measurement(LATTICES["RS-16"], 7, 0.4, 50.0).noise_m)
    assert all((one != other).mean() > 0.99 for one, other in itertools.combinations(noise, 2))
    alone = FrameScorer(TRAFFIC, replace(observation(), lidars=(lidars[1],)))
    for neighbour in (lidars[0], lidars[2]):
        both = FrameScorer(TRAFFIC, replace(observation(), lidars=(neighbour, lidars[1])))
        far = Pose(height_m=900.0)  # which sees nothing
        np.testing.assert_array_equal(both.see([(far, POSE)]).points, alone.see([(POSE,)]).points)


# --- Layouts of several LiDARs ----------------------------------------------------------------------------------------

CORNERS = (Pose(-9.0, -4.0, 4.0, 0.2, 0.0, -0.6), Pose(8.0, 30.0, 5.0, -0.3, 0.05, 0.4), Pose(0.0, -2.0, 3.0, 0.1))
NAMED = {"north": LATTICES["RS-16"], "south": LATTICES["RS-LiDAR-32"], "east": LATTICES["RS-BPearl"]}


def layout_of(effects=PERFECT, names=("north", "south", "east"), **more):
    """What LiDARs of these names see with, each of another model."""
    lidars = (observation(NAMED[name], gate=30.0, imperfections=effects, **more) for name in names)
    seen = together(*lidars)
    return replace(
        seen, lidars=tuple(replace(lidar, name=name) for lidar, name in zip(seen.lidars, names, strict=True))
    )


@settings(max_examples=8)
@given(seed=st.integers(0, 2**32 - 1), effects=st.sampled_from([PERFECT, ROUGH]), lidars=st.integers(2, 3))
def test_several_lidars_occupy_the_union_of_the_cells_of_the_slow_pipeline(seed, effects, lidars):
    vehicles, counted = dense_traffic(seed=seed, vehicles=8, length_m=30.0), np.random.default_rng(seed).random(8) < 0.7
    seen, poses = layout_of(effects, tuple(NAMED)[:lidars]), CORNERS[:lidars]
    found = FrameScorer(replace(vehicles, counted=counted), seen).see([poses])
    points, shares = slow_pipeline(vehicles, counted, seen, *poses)
    np.testing.assert_array_equal(found.by_lidar[0], points)
    np.testing.assert_allclose(found.occupancy[0], shares, rtol=1e-12, atol=0.0)


def test_a_lidar_that_is_held_is_cast_once_and_seen_as_if_cast_with_every_layout():
    vehicles, seen = dense_traffic(vehicles=30, length_m=80.0), layout_of(ROUGH)
    moved = [replace(CORNERS[1], height_m=height) for height in (2.0, 3.0, 4.0, 6.0)]
    batches = [[(CORNERS[0], pose, CORNERS[2]) for pose in moved], [(pose, CORNERS[1], None) for pose in moved]]
    batches += [[(moved[0], pose, other) for pose, other in zip(moved, reversed(moved), strict=True)], batches[0]]
    scorer = FrameScorer(vehicles, seen)
    for batch in batches:
        together_seen = scorer.see(batch)
        for row, layout in enumerate(batch):
            alone = FrameScorer(vehicles, seen).see([layout])
            np.testing.assert_array_equal(together_seen.by_lidar[row], alone.by_lidar[0])
            np.testing.assert_array_equal(together_seen.occupancy[row], alone.occupancy[0])


def test_a_layout_without_some_of_its_lidars_sees_what_the_others_see_without_them():
    vehicles, seen = dense_traffic(vehicles=30, length_m=80.0), layout_of(ROUGH)
    scorer = FrameScorer(vehicles, seen)
    north, south, east = CORNERS
    batch = [(north, None, None), (None, south, None), (north, None, east), (None, None, None), (north, south, east)]
    found = scorer.see(batch)
    for row, names in enumerate((["north"], ["south"], ["north", "east"])):
        hung = [pose for pose in batch[row] if pose is not None]
        alone = FrameScorer(vehicles, layout_of(ROUGH, names)).see([hung])
        np.testing.assert_array_equal(found.points[row], alone.points[0])
        np.testing.assert_array_equal(found.occupancy[row], alone.occupancy[0])
    assert not found.points[3].any()
    assert not found.occupancy[3].any()
    np.testing.assert_array_equal(found.by_lidar[4].sum(axis=0), found.points[4])
    np.testing.assert_array_equal(found.by_lidar[4, 0], found.points[0])  # its noise knows no neighbour


def test_the_order_of_the_lidars_changes_nothing():
    vehicles = dense_traffic(vehicles=30, length_m=80.0)
    one = FrameScorer(vehicles, layout_of(ROUGH)).see([CORNERS])
    turned = layout_of(ROUGH, ("east", "north", "south"))
    other = FrameScorer(vehicles, turned).see([(CORNERS[2], CORNERS[0], CORNERS[1])])
    np.testing.assert_array_equal(one.occupancy, other.occupancy)
    np.testing.assert_array_equal(one.by_lidar[0], other.by_lidar[0][[1, 2, 0]])
