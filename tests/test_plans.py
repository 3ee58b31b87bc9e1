"""Plans to scale: lanes and stop lines, scale and north, pictures from the air; cells and reach against oracles."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.report import coverage_figures as coverage
from blender_lidar.report import figure as canvas
from blender_lidar.report import plan
from blender_lidar.report.coverage_figures import Reach, cells_of, plot_blind_zones, plot_reach, reaches, unimodal
from blender_lidar.report.road_plan import draw_road, road_lines
from blender_lidar.report.run_figures import approach_rows, plot_by_approach
from blender_lidar.report.site_plan import plot_mapped_plan
from blender_lidar.road.road_map import Junction, Lane, RoadMap
from blender_lidar.road.straight import CrownedSurface
from tests.chart_samples import ROAD, approach_groups, grey_pixels, mount, run_of, table, words
from tests.test_plots import figures  # noqa: F401

pytest.importorskip("matplotlib", reason="charts need matplotlib")

WINDOW = np.array([[-40.0, -40.0], [40.0, 40.0]])
WIDTH_M, HALF_M, ARM_M = 3.5, 8.0, 60.0


def crossing(signalised: bool | None = True) -> RoadMap:
    """Four arms with a lane to and a lane from the junction each, and curved lanes across it."""
    points, lanes = [], []
    for arm in range(4):  # rows 2 arm and 2 arm + 1; both as seen from the junction along +x, right-hand traffic
        turn = 0.5 * math.pi * arm
        rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        for y, ends, way in ((0.5 * WIDTH_M, (ARM_M, HALF_M), "in"), (-0.5 * WIDTH_M, (HALF_M, ARM_M), "out")):
            points.append(np.array([[end, y] for end in ends]) @ rotation.T)
            lanes.append(Lane(f"{way}{arm}_0", f"{way}{arm}"))
    for arm in range(4):
        across = []
        for other in set(range(4)) - {arm}:
            start, end = points[2 * arm][-1], points[2 * other + 1][0]
            t = np.linspace(0.0, 1.0, 9)[:, None]
            points.append(
                (1.0 - t) ** 2 * start + t**2 * end if other != (arm + 2) % 4 else (1.0 - t) * start + t * end
            )
            across.append(len(points) - 1)
            lanes.append(Lane(f"{arm}to{other}", f"{arm}to{other}", "middle", (2 * other + 1,)))
        lanes[2 * arm] = lanes[2 * arm]._replace(leads_to=tuple(across))
    count, corner = len(points), np.array([[HALF_M, WIDTH_M], [WIDTH_M, HALF_M]])
    turns = [np.array([[0, -1], [1, 0]]) if number else np.eye(2) for number in range(2)]
    outline = np.concatenate([corner @ np.linalg.matrix_power(turns[1], number).T for number in range(4)])
    return RoadMap(
        tuple(points),
        np.zeros(count),
        np.zeros(count),
        np.full(count, WIDTH_M),
        np.zeros(count, dtype=bool),
        CrownedSurface((), 0.0),
        lanes=tuple(lanes),
        junctions=(Junction("middle", outline, signalised),),
    )


def outlines_of(road: RoadMap) -> list[tuple[int, np.ndarray]]:
    lanes = [(row, area) for row in range(len(road)) for area in road.area([row])]
    return lanes + [(-1, junction.outline_m) for junction in road.junctions]


# --- the road ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("signalised", "kind"), [(True, "stop line"), (None, "stop line"), (False, "entry")])
def test_a_line_lies_across_the_end_of_each_lane_that_leads_into_the_junction(signalised, kind):
    road = crossing(signalised)
    lines = road_lines(road, outlines_of(road))
    ends = [road.points_m[2 * arm][-1] for arm in range(4)]
    assert len(lines[kind]) == 4
    assert len(lines["stop line"]) + len(lines["entry"]) == 4
    for line, end in zip(lines[kind], ends, strict=True):
        np.testing.assert_allclose(line.mean(axis=0), end, atol=1e-12)
        assert np.hypot(*(line[1] - line[0])) == pytest.approx(WIDTH_M)


def test_edges_lie_on_the_rim_of_the_road_and_lines_between_directions_within_it():
    road = crossing()
    lines = road_lines(road, outlines_of(road))
    along = np.concatenate([0.5 * (line[:-1] + line[1:]) for line in lines["edge"]])
    arms = np.maximum(np.abs(along[:, 0]), np.abs(along[:, 1])) > HALF_M + 0.5
    np.testing.assert_allclose(np.abs(along[arms]).min(axis=1), WIDTH_M, atol=1e-9)
    assert lines["lane"] == []
    for line in lines["centre"]:
        np.testing.assert_allclose(np.abs(line).min(axis=1), 0.0, atol=1e-9)
    for arm in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        assert any((line @ arm > HALF_M).any() for line in lines["centre"])


def test_a_straight_road_has_two_edges_and_a_dashed_line_between_each_two_lanes():
    lines = road_lines(ROAD, [(row, area) for row in range(len(ROAD)) for area in ROAD.area([row], (-20.0, 30.0))])
    assert sorted(line[0, 1].round(9) for line in lines["edge"]) == [pytest.approx(end) for end in ROAD.edges_t]
    between = [line[0, 1] for line in lines["lane"]]
    np.testing.assert_allclose(sorted(between), ROAD.offset_m[:-1] + 0.5 * ROAD.width_m[0])
    assert all(np.ptp(line[:, 0]) == pytest.approx(50.0) for line in lines["edge"] + lines["lane"])
    assert not lines["stop line"]


def test_a_road_without_lanes_is_its_area(tmp_path, figures):  # noqa: F811
    class Area:
        endless, lanes, junctions = False, (), ()
        against = np.zeros(0, dtype=bool)

        def __len__(self):
            return 0

        def area(self):
            return [np.array([(-10.0, -5.0), (10.0, -5.0), (10.0, 5.0), (-10.0, 5.0)])]

    with plan.plans(tmp_path / "a.png", WINDOW, [""], 5.0, road=Area()) as (_, (axes,), _):
        draw_road(axes, Area(), WINDOW)
        assert plan.north_name(Area()) == "+y of the recording"
    (areas,) = figures[0].axes[0].collections
    np.testing.assert_allclose(areas.get_paths()[0].vertices[:4], Area().area()[0])


# --- the sheet --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(100.0, 30.0), (60.0, 60.0), (40.0, 150.0), (3.0, 2.0)])
@pytest.mark.parametrize("number", [1, 2])
def test_panels_share_one_scale_and_fit_a4_whatever_the_shape(size, number, tmp_path, figures):  # noqa: F811
    window = np.array([(5.0, -7.0), np.add((5.0, -7.0), size)])
    with plan.plans(tmp_path / "p.png", window, ["One\ntwo"] * number, 20.0, "Title", "Under") as (_, panels, _):
        bars = [plan.scale_bar(axes) for axes in panels if axes.get_xlabel()]
    assert len(panels) == number
    height_mm = canvas.MM_PER_INCH * figures[0].get_size_inches()[1]
    assert height_mm <= plan.HIGHEST_MM + 1e-6
    scales = []
    for axes in panels:
        box = axes.get_window_extent()
        assert axes.get_aspect() == 1.0
        scales += [box.width / np.ptp(axes.get_xlim()), box.height / np.ptp(axes.get_ylim())]
        assert box.x0 >= 0.0
        assert box.x1 <= figures[0].bbox.x1
    np.testing.assert_allclose(scales, scales[0], rtol=1e-9)
    for bar in bars:
        length = np.ptp(bar.get_xdata())
        assert f"{length:.0e}"[0] in "125"
        x = bar.get_transform().transform(bar.get_xydata())[:, 0]
        assert np.ptp(x) / length == pytest.approx(scales[0])
    assert bars


@pytest.mark.parametrize("bearing", [0.0, 90.0, 200.0])
def test_the_north_arrow_points_to_bearing_0(bearing, tmp_path, figures):  # noqa: F811
    from matplotlib.patches import FancyArrowPatch

    with plan.plans(tmp_path / "n.png", WINDOW, [""], 5.0) as (_, (axes,), _):
        plan.north_arrow(axes, bearing)
    (patch,) = (one for one in axes.patches if isinstance(one, FancyArrowPatch))
    x, y = np.subtract(*patch._posA_posB[::-1])
    up = math.radians(90.0)  # the site's +y, which has that bearing: bearings fall as angles rise
    assert math.degrees(up - math.atan2(y, x)) % 360.0 == pytest.approx(-bearing % 360.0, abs=1e-9)
    assert "N" in words(figures[0]).split("\n")


# --- pictures from the air --------------------------------------------------------------------------------------------

FINITE = st.floats(-1e4, 1e4)


@given(pixels=st.tuples(FINITE, FINITE, FINITE, FINITE), site=st.tuples(FINITE, FINITE, FINITE, FINITE))
def test_a_similarity_maps_both_points_exactly_and_keeps_shapes_unmirrored(pixels, site):
    one, two = (np.array(pair).reshape(2, 2) for pair in (pixels, site))
    if min(np.hypot(*(pair[1] - pair[0])) for pair in (one, two)) < 1e-2:
        return
    matrix = plan.similarity_of(np.column_stack([one, two]))
    np.testing.assert_allclose(np.column_stack([one, np.ones(2)]) @ matrix.T, two, atol=1e-6, rtol=1e-9)
    turn = matrix[:, :2] @ np.diag([1.0, -1.0])  # pixels count downwards
    scale = math.sqrt(np.linalg.det(turn))
    np.testing.assert_allclose(turn @ turn.T, scale**2 * np.eye(2), rtol=1e-9, atol=1e-12 * scale**2)


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([[0, 0, 1, 1], [0, 0, 2, 2]], "both points are one in the picture"),
        ([[0, 0, 1, 1], [5, 0, 1, 1]], "both points are one on the site"),
        ([[0, 0, 1, 1]], "allowed: two points"),
        ([[0, 0, 1, math.nan], [5, 0, 1, 1]], "allowed: two points"),
    ],
)
def test_two_points_that_scale_no_picture_are_refused(points, text):
    with pytest.raises(InputError, match=f"^image_points: .*{text}"):
        plan.similarity_of(points)


def test_a_picture_lies_where_its_points_say_and_one_that_cannot_be_read_is_named(tmp_path, figures):  # noqa: F811
    from matplotlib.image import imsave

    pixels = np.ones((40, 60, 3))
    pixels[10:20, 30:40] = 0.0  # 0 to 10 m right and 20 to 30 m up, by the points below
    imsave(tmp_path / "air.png", pixels)
    points = [[30, 40, 0.0, 0.0], [30, 20, 0.0, 20.0]]
    with plan.plans(tmp_path / "p.png", WINDOW, [""], 5.0) as (_, (axes,), _):
        plan.background(axes, tmp_path / "air.png", points)
    np.testing.assert_array_equal([axes.get_xlim(), axes.get_ylim()], WINDOW.T)
    grey = grey_pixels(tmp_path / "p.png")
    for place, dark in (((5.0, 25.0), True), ((5.0, 15.0), False), ((-5.0, 25.0), False), ((5.0, 32.0), False)):
        x, y = axes.transData.transform(place)
        assert (grey[round(grey.shape[0] - y), round(x)] < 0.6) == dark, place
    (tmp_path / "text.png").write_text("no picture")
    for name, error in (("text.png", InputError), ("none.png", MissingFileError)):
        with pytest.raises(error, match=rf"{name}: "):
            plan.background(axes, tmp_path / name, points)


# --- cells ------------------------------------------------------------------------------------------------------------


def boxes(seed: int, number: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-9.0, 9.0, (2, number))
    return {
        **{"x_m": x, "y_m": y, "length_m": rng.uniform(0.4, 13.0, number), "width_m": rng.uniform(0.3, 2.6, number)},
        "heading_deg": rng.choice([0.0, 90.0, -180.0, *rng.uniform(-180.0, 180.0, 3)], number),
        "detectable": rng.random(number) < 0.5,
    }


@given(seed=st.integers(0, 2**32 - 1), side_m=st.sampled_from([1.0, 2.0]))
def test_cells_count_the_boxes_whose_footprints_overlap_them(seed, side_m):
    """Against places in each footprint at most 0.05 m apart: all their cells count it, and no cell farther off."""
    seen = boxes(seed, 4)
    cells = cells_of(seen, side_m)
    least, most = np.zeros((2, *cells.boxes.shape), dtype=int)
    x0, y0 = cells.corner_m
    for number in range(4):
        turn = np.exp(1j * np.radians(seen["heading_deg"][number]))
        half = 0.5 * seen["length_m"][number], 0.5 * seen["width_m"][number]
        for counts, more in ((least, -1e-6), (most, 0.04)):
            u, v = (np.linspace(-one - more, one + more, 2 + int(2.0 * (one + more) / 0.05)) for one in half)
            place = (u[:, None] + 1j * v) * turn + seen["x_m"][number] + 1j * seen["y_m"][number]
            column, row = (np.floor((of - at) / side_m).astype(int) for of, at in ((place.real, x0), (place.imag, y0)))
            inside = (column >= 0) & (row >= 0) & (row < cells.boxes.shape[0]) & (column < cells.boxes.shape[1])
            assert inside.all() or more > 0.0
            found = np.unique(np.stack([row[inside], column[inside]]), axis=1)
            counts[tuple(found)] += 1
    assert (least <= cells.boxes).all()
    assert (cells.boxes <= most).all()
    assert (cells.below <= cells.boxes).all()
    missed = cells_of({**seen, "detectable": np.zeros(4, dtype=bool)}, side_m)
    np.testing.assert_array_equal(missed.below, cells.boxes)


def test_cells_do_not_depend_on_how_many_boxes_are_looked_at_together(monkeypatch):
    seen = boxes(3, 50)
    whole = cells_of(seen, 2.0)
    monkeypatch.setattr(coverage, "_AT_ONCE", 7)
    for one, two in zip(whole, cells_of(seen, 2.0), strict=True):
        np.testing.assert_array_equal(one, two)


def test_blind_zones_are_to_scale_and_cells_of_few_boxes_are_small(tmp_path, figures):  # noqa: F811
    from matplotlib.collections import PolyCollection

    run = run_of(table(1), deployment=mount(4.0, x_m=3.0, y_m=1.0))
    plot_blind_zones(tmp_path / "b.png", run, ROAD)
    counts = cells_of(run.baseline, 2.0).boxes
    for axes in figures[0].axes[:2]:
        (shades,) = (
            one for one in axes.collections if isinstance(one, PolyCollection) and one.get_clim() == (0.0, 100.0)
        )
        sides = np.array([np.ptp(path.vertices[:, 0]) for path in shades.get_paths()])
        np.testing.assert_allclose(sides, np.where(counts[counts > 0] < coverage.FEW_BOXES, 1.0, 2.0))
        assert axes.get_aspect() == 1.0
    markers = [line.get_xydata()[0] for axes in figures[0].axes[:2] for line in axes.lines if line.get_marker() == "^"]
    np.testing.assert_array_equal(markers, [(0.0, 0.0), (3.0, 1.0)])


# --- reach ------------------------------------------------------------------------------------------------------------


def along(distance_m, detectable, bearing_deg=37.0, xy=(10.0, -4.0)):
    turn = math.radians(bearing_deg)
    return {
        "x_m": xy[0] + np.asarray(distance_m) * math.cos(turn),
        "y_m": xy[1] + np.asarray(distance_m) * math.sin(turn),
        "detectable": np.asarray(detectable),
    }


def test_reach_ends_with_the_last_band_of_which_half_is_detectable():
    distance = np.repeat(np.arange(12.0, 60.0, 5.0), 10)  # bands from 10 to 60 m
    share = np.array([0.2, 0.6, 1.0, 0.9, 0.4, 0.7, 0.5, 0.4, 0.1, 0.0])
    seen = np.concatenate([np.arange(10) < 10 * one for one in share])
    # 0.4 and 0.7 violate the fall and are pooled to 0.55; then 0.5, which is still half: 10 + 7 x 5 m.
    assert reaches(along(distance, seen), (10.0, -4.0)) == [Reach(2, 15.0, 45.0, False, 57.0)]


def test_reach_goes_on_where_the_boxes_end_and_is_nothing_where_fewer_than_half_are_seen():
    distance = np.linspace(8.0, 33.0, 30)
    assert reaches(along(distance, np.ones(30, dtype=bool)), (10.0, -4.0)) == [
        Reach(2, pytest.approx(8.0), pytest.approx(33.0), True, pytest.approx(33.0))
    ]
    assert reaches(along(distance, np.zeros(30, dtype=bool)), (10.0, -4.0)) == [
        Reach(2, 0.0, 0.0, False, pytest.approx(33.0))
    ]
    few = coverage.FEW_IN_SECTOR - 1
    assert reaches(along(distance[:few], np.ones(few, dtype=bool)), (10.0, -4.0)) == []


@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(1, 20)), min_size=1, max_size=5))
def test_isotonic_regression_on_both_sides_of_the_peak_is_the_nearest_such_fit(pairs):
    share, weight = np.array(pairs).T
    fitted, peak = unimodal(share, weight), int(np.argmax(share))
    assert (np.diff(fitted[: peak + 1]) >= -1e-12).all()
    assert (np.diff(fitted[peak:]) <= 1e-12).all()
    # The projection on a convex cone: no mean over a level set differs from the data's there.
    for level in np.unique(fitted):
        same = fitted == level
        assert np.average(share[same], weights=weight[same]) == pytest.approx(level, abs=1e-9)
    assert (weight * (share - fitted) * fitted).sum() == pytest.approx(0.0, abs=1e-9)


def test_reach_is_drawn_on_the_plan_of_any_road(tmp_path, figures):  # noqa: F811
    seen = along(np.linspace(8.0, 33.0, 40), np.arange(40) < 30)
    run = run_of({**table(1, 40), **seen}, deployment=mount(4.0, x_m=10.0, y_m=-4.0))
    for name, road in (("straight", ROAD), ("crossing", crossing())):
        plot_reach(tmp_path / f"{name}.png", run, road)
    for figure in figures:
        assert all(axes.get_aspect() == 1.0 for axes in figure.axes)
        assert "sectors of 15°" in words(figure).replace("\n", " ")


# --- approaches, and the plan of a mapped site ------------------------------------------------------------------------


def test_approaches_are_followed_by_their_movements_and_a_side_without_an_interval_is_a_dot(tmp_path, figures):  # noqa: F811
    result = run_of(groups=approach_groups()[::-1]).result
    assert [row["name"] for row in approach_rows(result)] == ["west", "north", "north, straight", "north, left"]
    plot_by_approach(tmp_path / "a.png", result)
    axes = figures[0].axes[0]
    texts = [label.get_text() for label in axes.get_yticklabels()]
    assert texts == ["west (43 boxes)", "north (40 boxes)", "straight (42 boxes)", "left (41 boxes)"]
    assert approach_rows(run_of().result) == []


def test_the_plan_of_a_mapped_site_names_every_pole_in_reach_of_its_marker(tmp_path, figures):  # noqa: F811
    rng = np.random.default_rng(2)
    recording = SimpleNamespace(
        centre_m=rng.uniform(-30.0, 30.0, (60, 3)),
        heading_rad=rng.uniform(-4.0, 4.0, 60),
        vehicle_id=np.repeat(np.arange(6), 10),
        source="some.csv",
    )
    stands = [plan.Stand(f"pole {number}", (12.0 + number, 12.0), -2.0) for number in range(3)]
    road = crossing()
    plot_mapped_plan(tmp_path / "m.png", road, [road.junctions[0].outline_m], stands, recording)
    (axes,) = figures[0].axes
    assert axes.get_aspect() == 1.0
    names = {text.get_text(): text for text in axes.texts if text.get_text().startswith("pole")}
    assert set(names) == {"pole 0", "pole 1", "pole 2"}
    spans = [names[f"pole {number}"].get_window_extent() for number in range(3)]
    assert not any(one.overlaps(two) for at, one in enumerate(spans) for two in spans[at + 1 :])
    assert {"towards north", "towards west", "stop line", "region", "N"} <= set(words(figures[0]).split("\n"))
    legend = figures[0].legends[0].get_window_extent()
    assert not legend.overlaps(axes.get_tightbbox())
