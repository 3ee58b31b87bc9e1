"""Plans to scale: lanes and stop lines, scale and north, pictures from the air; cells, contour and rings."""

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
from blender_lidar.report.coverage_figures import cells_of, plot_blind_zones
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


@pytest.fixture
def two_zones():
    """A run whose boxes east of x = 0 are detectable and those to its west are not, but for few beyond 40 m."""
    rng = np.random.default_rng(4)
    x = np.concatenate([rng.uniform(-38.0, 38.0, 3000), [45.0, 45.0]])
    y = np.concatenate([rng.uniform(4.0, 16.0, 3000), [8.0, 8.0]])
    size = {"length_m": np.full(3002, 1.0), "width_m": np.full(3002, 1.0), "heading_deg": np.zeros(3002)}
    seen = {"x_m": x, "y_m": y, **size, "distance_m": np.hypot(x, y), "detectable": x > 0.0}
    return run_of(seen, deployment=mount(4.0, x_m=3.0, y_m=1.0))


def test_blind_zones_are_to_scale_shaded_where_boxes_are_enough_and_hatched_where_they_are_few(
    tmp_path,
    figures,  # noqa: F811
    two_zones,
):
    from matplotlib.collections import PolyCollection

    plot_blind_zones(tmp_path / "b.png", two_zones, ROAD)
    counts = cells_of(two_zones.baseline, 2.0).boxes
    enough = counts >= coverage.FEW_BOXES
    for axes in figures[0].axes[:2]:
        squares = [shapes for shapes in axes.collections if isinstance(shapes, PolyCollection)]
        (shades,) = (shapes for shapes in squares if shapes.get_clim() == (0.0, 100.0))
        (hatched,) = (shapes for shapes in squares if shapes.get_hatch() == coverage._FEW["hatch"])
        assert len(shades.get_paths()) == enough.sum()
        assert len(hatched.get_paths()) == ((counts > 0) & ~enough).sum() > 0
        corners = np.array([path.vertices[:4] for path in (*shades.get_paths(), *hatched.get_paths())])
        np.testing.assert_allclose(np.ptp(corners, axis=1), 2.0)
        assert any((np.abs(path.vertices - (45.0, 8.0)) < 2.0).all(axis=1).any() for path in hatched.get_paths())
        assert axes.get_aspect() == 1.0
    markers = [line.get_xydata()[0] for axes in figures[0].axes[:2] for line in axes.lines if line.get_marker() == "^"]
    np.testing.assert_array_equal(markers, [(0.0, 0.0), (3.0, 1.0)])
    for text in ("half of the boxes detectable, in squares of 10 m", "fewer than 5 boxes", "no vehicle was there"):
        assert text in words(figures[0])


def test_the_contour_is_where_half_of_the_boxes_are_detectable_and_not_where_boxes_are_few(
    tmp_path, monkeypatch, two_zones
):
    from matplotlib.axes import Axes

    lines, contour = [], Axes.contour
    monkeypatch.setattr(Axes, "contour", lambda *args, **look: lines.append(contour(*args, **look)) or lines[-1])
    plot_blind_zones(tmp_path / "b.png", two_zones, ROAD)
    assert len(lines) == 4  # in white below, on either panel
    for line in lines:
        places = np.concatenate(line.allsegs[0])
        np.testing.assert_allclose(places[:, 0], 0.0, atol=1.5)
        assert places[:, 1].min() < 6.0
        assert places[:, 1].max() > 14.0
    few = {key: values[::120] for key, values in two_zones.baseline.items()}
    plot_blind_zones(tmp_path / "few.png", run_of(few), ROAD)
    assert not any(map(len, (places for line in lines[4:] for places in line.allsegs[0])))


@given(seed=st.integers(0, 2**32 - 1))
def test_smoothing_sums_the_cells_of_a_square(seed):
    counts = np.random.default_rng(seed).integers(0, 9, (6, 9))
    half = coverage._SPAN // 2
    for row, column in np.ndindex(*counts.shape):
        square = counts[max(row - half, 0) : row + half + 1, max(column - half, 0) : column + half + 1]
        assert coverage.smoothed(counts)[row, column] == square.sum()


def test_rings_of_distance_are_about_every_lidar_and_their_labels_clear_of_each_other(tmp_path, figures):  # noqa: F811
    mounts = {"north": mount(4.0, x_m=-12.0, y_m=14.0), "a south one": mount(4.0, x_m=11.0, y_m=-13.0)}
    of_each = {"installer": False, "leans": False, "range_gate_m": 60.0}
    rows = [{"name": name, "deployment": at, "baseline": at, **of_each} for name, at in mounts.items()]
    several = {"lidars": rows, "spread": None}
    plot_blind_zones(tmp_path / "r.png", run_of(table(1), **several), crossing())
    figure = figures[0]
    for axes in figure.axes[:2]:
        rings = [line.get_xydata() for line in axes.lines if line.get_color() == coverage._RING["color"]]
        for xy in [(at["x_m"], at["y_m"]) for at in mounts.values()]:
            radii = [np.hypot(*(ring - xy).T) for ring in rings]
            found = sorted(round(one.mean(), 6) for one in radii if np.ptp(one) < 1e-9)
            assert found[:3] == [20.0, 40.0, 60.0]
        labels = [text for text in axes.texts if text.get_text().strip()]
        assert {"20 m", "40 m", "north", "a south one"} <= {text.get_text() for text in labels}
        boxes = [text.get_window_extent() for text in labels]
        assert not any(one.overlaps(other) for number, one in enumerate(boxes) for other in boxes[number + 1 :])
        distances = [box for text, box in zip(labels, boxes, strict=True) if text.get_fontsize() == 6.0]
        assert len(distances) > 3
        assert all(axes.bbox.contains(*box.min) and axes.bbox.contains(*box.max) for box in distances)


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
