"""OpenDRIVE files: curves against closed forms, lanes, links, junctions, heights, another reader; what is refused."""

from __future__ import annotations

import math
import pickle
import warnings
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.road.approaches import approach_spans, ends_of
from blender_lidar.road.opendrive import read_opendrive
from blender_lidar.road.road_map import Flat, Junction, Lane, RoadMap
from blender_lidar.scene.region import region_of
from blender_lidar.scene.settings import RegionSettings

pytestmark = pytest.mark.versions

SITES = Path(__file__).parents[2] / "shared" / "data" / "sites" / "opendrive"
LINE = ("<line/>", 100.0)


def element(tag, inside="", **attributes):
    return f"<{tag} {' '.join(f'{key}={str(value)!r}' for key, value in attributes.items())}>{inside}</{tag}>"


def cubic(tag, *coefficients, at=0.0, start="s"):
    return element(tag, **{start: at}, **dict(zip("abcd", (*coefficients, 0.0, 0.0, 0.0), strict=False)))


def plan(*curves, x=0.0, y=0.0, hdg=0.0, s=0.0):
    """A reference line of one curve, or of several straight ones after each other."""
    text = ""
    for curve, length in curves:
        text += element(
            "geometry", curve, s=s, x=x + s * math.cos(hdg), y=y + s * math.sin(hdg), hdg=hdg, length=length
        )
        s += length
    return element("planView", text)


def lane(number, *widths, kind="driving", links="", **more):
    width = "".join(cubic("width", *each[1:], at=each[0], start="sOffset") for each in widths or [(0.0, 3.5)])
    return element("lane", f"<link>{links}</link>{width}", id=number, type=kind, **more)


def section(*lanes, s=0.0):
    return element("laneSection", element("right", "".join(lanes)), s=s)


def road(name=1, curve=LINE, lanes=None, *, line=None, offset="", links="", profile="", length=100.0, **more):
    lanes = section(lane(1), lane(-1)) if lanes is None else lanes
    inside = f"<link>{links}</link>{line or plan(curve)}{profile}{element('lanes', offset + lanes)}"
    return element("road", inside, id=name, length=length, **{"junction": -1, **more})


@pytest.fixture
def read(tmp_path):
    def of(*parts, root="OpenDRIVE", **options):
        path = tmp_path / "map.xodr"
        path.write_text(f"<{root}>{''.join(parts)}</{root.split()[0]}>", encoding="utf-8")
        return read_opendrive(path, **options)

    return of


def leads(found):
    return {one.name: [found.lanes[other].name for other in one.leads_to] for one in found.lanes}


def line_of(found, name):
    return found.points_m[[one.name for one in found.lanes].index(name)]


def apart(places, line):
    """How far places (n, 2) lie from a line (k, 2)."""
    start, step = line[:-1], np.diff(line, axis=0)
    off = places[:, None] - start
    part = ((off * step).sum(axis=-1) / np.square(step).sum(axis=-1)).clip(0.0, 1.0)
    return np.linalg.norm(off - part[..., None] * step, axis=-1).min(axis=1)


def between(line, steps=20):
    part = np.arange(steps)[:, None, None] / steps
    return (line[:-1] + part * np.diff(line, axis=0)).reshape(-1, 2)


@pytest.mark.parametrize("curvature", [0.02, -0.02, 0.1, -0.1])
def test_lanes_along_an_arc_are_circles(read, curvature):
    radius, side = 1.0 / abs(curvature), math.copysign(1.0, curvature)
    found = read(road(curve=(element("arc", curvature=curvature), 2.0 * math.pi * radius), length=2 * math.pi * radius))
    for name, towards in (("1:1", side), ("1:-1", -side)):
        own = radius - 1.75 * towards
        away = np.hypot(*(line_of(found, name) - [0.0, side * radius]).T)
        np.testing.assert_allclose(away, own, atol=1e-9)
        away = np.hypot(*(between(line_of(found, name)) - [0.0, side * radius]).T)
        assert own - 0.01 <= away.min()
        assert away.max() <= own + 1e-9
        turned = np.unwrap(np.arctan2(*(line_of(found, name) - [0.0, side * radius]).T[::-1]))
        assert turned[-1] - turned[0] == pytest.approx(side * (1 if name == "1:-1" else -1) * 2.0 * math.pi, abs=1e-5)


@pytest.mark.parametrize(("first", "last", "length"), [(0.0, 0.02, 80.0), (-0.01, 0.03, 120.0), (0.3, -0.3, 60.0)])
def test_a_spiral_follows_its_dense_quadrature(read, first, last, length):
    lanes = section(lane(-1, (0.0, 0.002)))
    found = read(road(curve=(element("spiral", curvStart=first, curvEnd=last), length), lanes=lanes))
    s = (np.arange(400_000) + 0.5) * length / 400_000
    angle = first * s + 0.5 * (last - first) / length * s * s
    dense = np.cumsum(np.stack([np.cos(angle), np.sin(angle)], axis=1), axis=0) * length / 400_000
    np.testing.assert_allclose(line_of(found, "1:-1")[-1], dense[-1], atol=1.1e-3)
    assert apart(dense[::500], line_of(found, "1:-1")).max() < 0.011


def test_cubics_follow_their_polynomials_whatever_their_parameter(read):
    u, v, length = np.array([0.0, 30.0, 12.0, -4.0]), np.array([0.0, 0.0, 22.0, -14.0]), 0.0
    p = np.linspace(0.0, 1.0, 100_001)
    dense = np.stack([np.polyval(u[::-1], p), np.polyval(v[::-1], p)], axis=1)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(dense, axis=0).T))])
    length = arc[-1]

    def poly(scale, **more):
        terms = {f"{key}{axis}": k / scale**n for axis, of in zip("UV", (u, v), strict=True)
                 for n, (key, k) in enumerate(zip("abcd", of, strict=True))}  # fmt: skip
        return element("paramPoly3", **terms, **more), length

    half = cubic("width", 0.002, 0.0, at=0.5 * length, start="sOffset")
    one_lane = section(lane(-1, (0.0, 0.002)).replace("</lane>", half + "</lane>"))
    by_range = [read(road(curve=curve, lanes=one_lane)) for curve in
                (poly(1.0), poly(1.0, pRange="normalized"), poly(length, pRange="arcLength"))]  # fmt: skip
    lines = [line_of(found, "1:-1") for found in by_range]
    for line in lines:
        np.testing.assert_allclose(line, lines[0], atol=1e-9)
        assert apart(dense[::100], line).max() < 0.011
    middle = np.stack([np.interp(0.5 * length, arc, axis) for axis in dense.T])
    assert np.hypot(*(lines[0] - middle).T).min() < 2e-3  # stations are lengths along the curve

    found = read(
        road(curve=(element("poly3", a=0.0, b=0.0, c=0.01, d=1e-4), 50.0), lanes=section(lane(-1, (0.0, 0.002))))
    )
    x, y = line_of(found, "1:-1").T
    np.testing.assert_allclose(y, 0.01 * x**2 + 1e-4 * x**3, atol=2e-3)
    assert np.hypot(*np.diff(line_of(found, "1:-1"), axis=0).T).sum() == pytest.approx(50.0, abs=0.02)


def test_lanes_lie_beside_each_other_from_the_lane_offset(read):
    lanes = section(lane(2, (0.0, 2.0)), lane(1, (0.0, 3.0)), lane(-1, (0.0, 4.0)), lane(-2, (0.0, 1.0), kind="border"),
                    lane(-3, (0.0, 2.5), kind="sidewalk"), lane(-4, (0.0, 1.5), kind="biking"))  # fmt: skip
    found = read(road(lanes=lanes, offset=cubic("laneOffset", 0.5)))
    assert {one.name: (line[0, 1], one.use) for one, line in zip(found.lanes, found.points_m, strict=True)} == {
        "1:1": (pytest.approx(2.0), "vehicles"),
        "1:2": (pytest.approx(4.5), "vehicles"),
        "1:-1": (pytest.approx(-1.5), "vehicles"),
        "1:-3": (pytest.approx(-5.75), "pedestrians"),
        "1:-4": (pytest.approx(-7.75), "bicycles"),
    }
    np.testing.assert_allclose(found.width_m, [3.0, 2.0, 4.0, 2.5, 1.5])
    assert (found.drives_on, found.widths_m, found.against.any()) == ("right", (), False)
    ahead = np.array([np.sign(line[-1, 0] - line[0, 0]) for line in found.points_m])
    np.testing.assert_array_equal(ahead, [-1, -1, 1, 1, 1])
    assert [one.road for one in found.lanes] == ["1 backward"] * 2 + ["1 forward"] * 3

    borders = lanes.replace("<width", "<border").replace("</width", "</border")
    for width, border in ((4.0, -4.0), (1.0, -5.0), (2.5, -7.5), (1.5, -9.0)):
        borders = borders.replace(f"a='{width}'", f"a='{border}'")
    borders = borders.replace("id='2' type='driving'><link></link><border sOffset='0.0' a='2.0'",
                              "id='2' type='driving'><link></link><border sOffset='0.0' a='5.0'")  # fmt: skip
    for one, other in zip(read(road(lanes=borders)).points_m, read(road(lanes=lanes)).points_m, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_in_left_hand_traffic_lanes_drive_the_other_way(read):
    right, left = read(road()), read(road(rule="LHT"))
    assert (right.drives_on, left.drives_on) == ("right", "left")
    for one, other in zip(right.points_m, left.points_m, strict=True):
        np.testing.assert_allclose(one, other[::-1])
    turned = read(road(lanes=section(lane(1, direction="reversed"), lane(-1))))
    np.testing.assert_allclose(turned.points_m[0], left.points_m[0])


def test_a_road_described_from_its_other_end_has_the_same_lanes(read):
    one = read(road(curve=(element("arc", curvature=0.01), 100.0), lanes=section(lane(1, (0.0, 3.0)), lane(-1))))
    place, heading = [100.0 * math.sin(1.0), 100.0 - 100.0 * math.cos(1.0)], 1.0 + math.pi
    back = plan((element("arc", curvature=-0.01), 100.0), x=place[0], y=place[1], hdg=heading)
    other = read(road(line=back, lanes=section(lane(1), lane(-1, (0.0, 3.0)))))
    for name, same in (("1:1", "1:-1"), ("1:-1", "1:1")):
        np.testing.assert_allclose(line_of(one, name), line_of(other, same), atol=1e-5)


def test_lanes_taper_and_are_cut_where_they_have_no_width(read):
    lanes = section(lane(-1), lane(-2, (0.0, 0.0), (40.0, 0.0, 0.175), (60.0, 3.5)), lane(-3, (0.0, 0.0)))
    found = read(road(lanes=lanes))
    assert [one.name for one in found.lanes] == ["1:-1", "1:-2"]
    x, y = line_of(found, "1:-2").T
    assert x[[0, -1]] == pytest.approx([40.0, 100.0], abs=1e-5)
    width = np.interp(x, [40.0, 60.0], [0.0, 3.5])
    np.testing.assert_allclose(found.widths_m[1], width, atol=1e-9)
    np.testing.assert_allclose(y, -3.5 - 0.5 * width, atol=1e-9)
    np.testing.assert_allclose(found.width_m, 3.5)


def test_lanes_go_on_through_lane_sections_and_merge(read):
    def to(number, tag="successor"):
        return element(tag, id=number)

    first = section(lane(1, links=to(2)), lane(-1, links=to(-1)), lane(-2, links=to(-2)), lane(-3, links=to(-2)))
    second = section(lane(1), lane(2, links=to(1, "predecessor")), lane(-1), lane(-2), s=60.0)
    found = read(road(lanes=first + second, line=plan(("<line/>", 60.0), ("<line/>", 40.0))))
    assert leads(found) == {"1.0:-1": [], "1.0:-2": ["1.1:-2"], "1.0:-3": ["1.1:-2"], "1.1:-2": [], "1.0:1": [],
                     "1.1:1": [], "1.1:2": ["1.0:1"]}  # fmt: skip
    np.testing.assert_allclose(line_of(found, "1.0:-1")[[0, -1]], [[0.0, -1.75], [100.0, -1.75]], atol=1e-5)


def test_roads_lead_into_roads_whichever_end_touches(read):
    link = {"elementType": "road", "contactPoint": "end"}
    lanes = section(lane(1, links=element("successor", id=-1)), lane(-1, links=element("successor", id=1)))
    one = road(1, links=element("successor", elementId=2, **link), lanes=lanes)
    found = read(one, road(2, line=plan(LINE, x=200.0, hdg=math.pi)))
    assert leads(found) == {"1:-1": ["2:1"], "2:-1": ["1:1"], "1:1": [], "2:1": []}


def crossing(signals="", controller="", links=True):
    """One-way roads 1 from the west and 2 from the south into the junction "J", and 3 to the east out of it."""

    def at(tag):
        return element(tag, elementType="junction", elementId="J")

    one_lane = section(lane(-1))
    arms = road(1, lanes=one_lane, links=at("successor"), profile=element("signals", signals))
    arms += road(2, line=plan(LINE, x=115.0, y=-115.0, hdg=0.5 * math.pi), lanes=one_lane, links=at("successor"))
    arms += road(3, line=plan(LINE, x=130.0), lanes=one_lane, links=at("predecessor"))
    onto = element("predecessor", elementId=1, elementType="road", contactPoint="end")
    onto += element("successor", elementId=3, elementType="road", contactPoint="start")
    joined = section(lane(-1, links=element("predecessor", id=-1) + element("successor", id=-1)))
    arms += road(4, line=plan(("<line/>", 30.0), x=100.0), links=onto, lanes=joined, length=30.0, junction="J")
    turn = plan((element("arc", curvature=-1.0 / 15.0), 7.5 * math.pi), x=115.0, y=-15.0, hdg=0.5 * math.pi)
    arms += road(5, line=turn, lanes=one_lane, length=7.5 * math.pi, junction="J")
    lane_link = element("laneLink", **{"from": -1, "to": -1})
    turns = element("connection", lane_link, incomingRoad=2, connectingRoad=5, contactPoint="start")
    return arms + element("junction", controller + turns, id="J")


def test_a_junction_is_what_its_lanes_cover(read):
    found = read(crossing())
    assert leads(found) == {"1:-1": ["4:-1"], "2:-1": ["5:-1"], "3:-1": [], "4:-1": ["3:-1"], "5:-1": []}
    assert [one.junction for one in found.lanes] == ["", "", "", "J", "J"]
    (junction,) = found.junctions
    assert (junction.name, junction.signalised) == ("J", None)
    shapely = pytest.importorskip("shapely")
    area, lanes = (
        shapely.Polygon(junction.outline_m),
        shapely.union_all([shapely.Polygon(one) for one in found.area([3, 4])]),
    )
    assert area.is_valid
    assert lanes.difference(area).area < 0.02 * lanes.area
    assert not area.contains(shapely.Point(105.0, -6.0))  # a corner between the arms is none of it


def test_a_junction_is_signalised_where_lights_or_controllers_say_so(read):
    def signal(kind, s=95.0):
        return element("signal", s=s, id="7", type=kind)

    for signals, controller, expected in (
        (signal("1000001"), "", True),
        (signal("1000001", s=20.0), "", False),  # at the road's other end
        (signal("274"), "", False),
        ("", element("controller", id=1), True),
    ):
        assert read(crossing(signals, controller)).junctions[0].signalised is expected


def test_the_surface_is_the_elevation_and_level_across(read):
    rise = (1.0, 0.05, -4e-4, 2e-6)
    profile = element("elevationProfile", cubic("elevation", *rise) + cubic("elevation", 4.0, at=70.0))
    found = pickle.loads(pickle.dumps(read(road(profile=profile))))
    x = np.linspace(0.0, 99.9, 300)
    z = np.where(x < 70.0, np.polyval(rise[::-1], x), 4.0)
    clear = np.abs(x - 70.0) > 0.3
    for y in (-30.0, -2.0, 0.0, 1.0, 25.0):
        np.testing.assert_allclose(found.surface.height(np.stack([x, 0 * x + y], axis=1))[clear], z[clear], atol=0.011)
    assert not found.surface.is_flat
    corners = found.surface.triangles((30.0, 0.0), 20.0)
    np.testing.assert_allclose(corners[..., 2], found.surface.height(corners))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normal[:, 2] > 0.0).all()
    assert 0.5 * normal[:, 2].sum() == pytest.approx(1600.0)
    level = read(road(profile=element("elevationProfile", cubic("elevation", 312.5))))
    assert level.surface.is_flat
    assert not level.surface.height(np.array([10.0, 2.0]))
    assert not len(level.surface.triangles((0.0, 0.0), 10.0))


def test_origin_and_header_offset_move_the_map_without_loss(read):
    shift = element("header", element("offset", x=100.0, y=-50.0, z=0.0, hdg=0.0))
    arc = (element("arc", curvature=0.01), 100.0)
    far = road(line=plan(arc, x=4.5e6, y=5.4e6))
    found = read(shift, far, origin_m=(4.5e6 + 100.0, 5.4e6 - 50.0), root="OpenDRIVE xmlns='http://of.a.schema'")
    for one, other in zip(found.points_m, read(road(curve=arc)).points_m, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)


TILT = element("lateralProfile", cubic("superelevation", 0.0, 1e-3))
HIGH = element("elevationProfile", cubic("elevation", 5.0))
ACROSS = plan(LINE, x=50.0, y=-50.0, hdg=0.5 * math.pi)
TURNED = element("header", element("offset", x=0.0, y=0.0, hdg=0.1))


@pytest.mark.parametrize(
    ("parts", "told"),
    [
        ([], "has no <road>"),
        ([road(profile=TILT)], "road 1: <superelevation> tilts"),
        ([road(profile=TILT.replace("superelevation", "shape"))], "road 1: <shape>"),
        ([road(profile=TILT.replace("superelevation", "crossfall"))], "road 1: <crossfall>"),
        ([road(profile=element("objects", element("bridge", s=3)))], "road 1: has a bridge at s 3"),
        ([road(profile=element("objects", element("object", type="tunnel", s=3)))], "road 1: has a tunnel at s 3"),
        ([road(1), road(2, line=ACROSS, profile=HIGH)], r"lanes 1:1 and 2:-?1 lie 5\.0 m above each other"),
        ([TURNED, road()], "turns the map by hdg 0.1"),
        ([road(line="<planView/>")], "road 1: its <planView> has no <geometry>"),
        ([road(curve=("<helix/>", 9.0))], "at s 0.0: unknown geometry 'helix'"),
        ([road(line=plan(LINE).replace("hdg='0.0'", "hdg='nan'"))], "<geometry> has hdg 'nan'"),
        ([road(line=plan(LINE) .replace("x='0.0'", ""))], "<geometry> has x None"),
        ([road(line=plan(LINE, s=0.0).replace("</planView>", "") + plan(LINE, s=100.0, x=40.0)[len("<planView >"):])],
         "geometry> at s 100 begins 40.00 m from"),
        ([road(curve=(element("paramPoly3", aU=0, bU=1, cU=0, dU=0, aV=0, bV=0, cV=0, dV=0), 90.0))], "is 1.00 m long"),
        ([road(lanes=section(lane(-1, kind="border")))], "no lane for vehicles .* types are border"),
        ([road(lanes=section(lane(-1, (0.0, 0.0))))], "no lane for vehicles that is wider than 0 m"),
        ([road(lanes=section(lane(-1, (0.0, 3.0, -0.1))))], "lane -1 is -7.00 m wide at s 100"),
        ([road(line=plan(LINE, s=40.0))], "a <geometry> is at s 40; allowed: 0"),
        ([road(curve=("<line/>", 1e6))], "a <geometry> is 1e\\+06 m long"),
        ([road(curve=(element("arc", curvature=50.0), 100.0))], "its <arc> turns by 5000 rad"),
        ([road(lanes=section(lane(-1, (0.0, 1e300))))], "lane -1: <width> has a '1e\\+300'"),
        ([road(lanes=section(lane(-1.5)))], "<lane> has id -1.5"),
        ([road(1), road(2, line=plan(LINE, y=50.0), rule="LHT")], "of rule RHT and of rule LHT"),
        ([road(rule="left")], "unknown rule 'left'"),
        ([road(), road()], "road 1 is there twice"),
    ],
)  # fmt: skip
def test_what_cannot_be_shown_is_refused_in_one_line(read, parts, told):
    with pytest.raises(InputError, match=told) as refusal:
        read(*parts)
    assert len(str(refusal.value).split("map.xodr: ")) == 2
    assert "\n" not in str(refusal.value)


def test_what_is_no_opendrive_file_is_refused(tmp_path, read):
    with pytest.raises(MissingFileError):
        read_opendrive(tmp_path / "none.xodr")
    with pytest.raises(InputError, match="its root is <net>"):
        read(road(), root="net")
    for content in (b"", b"<OpenDRIVE><road", b"\x00\x01\x02", b"<?xml version='1.0' encoding='klingon'?><OpenDRIVE/>"):
        (tmp_path / "bad.xodr").write_bytes(content)
        with pytest.raises(InputError, match=r"bad\.xodr: truncated or damaged XML"):
            read_opendrive(tmp_path / "bad.xodr")


# pyxodr's steps: short where roads bend sharply, longer where they are long
STEPS_M = {"crest-curve": 0.2, "curves_elevation": 0.5, "e6mini": 0.5, "e6mini-lht": 0.5}
STEPS_M |= {"fabriksgatan": 0.1, "soderleden": 0.1}


@pytest.mark.parametrize(("name", "step_m"), STEPS_M.items(), ids=list(STEPS_M))
def test_real_roads_lie_where_pyxodr_has_them_and_drive_the_same_way(name, step_m):
    path = SITES / f"{name}.xodr"
    if not path.is_file():
        pytest.skip("the sites of ../shared/data are not here")
    network = pytest.importorskip("pyxodr_omega_prime.road_objects.network")
    found = read_opendrive(path)
    compared = 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        roads = network.RoadNetwork(str(path), resolution=step_m).get_roads()
        for theirs in (lane for one in roads for part in one.lane_sections for lane in part.lanes):
            if theirs.type not in ("driving", "sidewalk"):
                continue
            line = theirs.traffic_flow_line
            own = [row for row, one in enumerate(found.lanes) if one.name.split(":")[0].split(".")[0] == theirs.road_id]
            far = [apart(line[:, :2], found.points_m[row]).max() for row in own]
            nearest = found.points_m[own[int(np.argmin(far))]]
            assert min(far) < 0.05, str(theirs)
            assert np.abs(found.surface.height(line) - line[:, 2]).max() < 0.05 or found.surface.is_flat
            first, last = (np.hypot(*(nearest - end).T).argmin() for end in line[[0, -1], :2])
            assert first < last
            compared += 1
    assert compared >= len(found)


def test_an_approach_is_measured_from_its_stop_line_where_its_lanes_split(read):
    """A turn pocket of 30 m before the stop line at 230 m: the last 50 m begin at 180 m on the lane before both."""
    link = element("predecessor", id=-1)
    lanes = section(lane(-1, links=element("successor", id=-1))) + section(
        lane(-1, links=link), lane(-2, links=link), s=200.0
    )
    ends = element("successor", elementType="junction", elementId="J")
    across = element("predecessor", elementType="road", elementId=1, contactPoint="end")
    both = "".join(element("laneLink", **{"from": f"-{k}", "to": f"-{k}"}) for k in (1, 2))
    found = read(
        road(1, LINE, lanes, line=plan(("<line/>", 230.0)), links=ends, length=230.0),
        road(
            10,
            LINE,
            section(lane(-1), lane(-2)),
            line=plan(("<line/>", 20.0), x=230.0),
            links=across,
            length=20.0,
            junction="J",
        ),
        element(
            "junction",
            element("connection", both, id=0, incomingRoad=1, connectingRoad=10, contactPoint="start"),
            id="J",
        ),
    )
    spans = approach_spans(found, "1 forward", 50.0, "here")
    stations = {found.lanes[row].name: ends for row, ends in spans.items()}
    assert stations["1.1:-1"] == stations["1.1:-2"] == pytest.approx((0.0, 30.0), abs=1e-3)
    assert stations["1.0:-1"] == pytest.approx((180.0, 200.0), abs=1e-3)
    assert len(stations) == 3
    begins, ends = ends_of(found, "1 forward")
    assert (begins, ends) == (0.0, 0.0)


def test_an_approach_goes_on_across_a_junction_between_by_the_length_of_that():
    """Lanes of 30 and 40 m with 8 m of a junction between them: 60 m from the stop line begin 18 m into the first."""
    line = [np.array([(a, 0.0), (b, 0.0)]) for a, b in ((0.0, 40.0), (40.0, 48.0), (48.0, 78.0), (78.0, 90.0))]
    lanes = (
        Lane("in", "in", "", (1,)),
        Lane(":m", ":m", "m", (2,)),
        Lane("on", "on", "", (3,)),
        Lane(":j", ":j", "j", ()),
    )
    outlines = [
        Junction(name, np.array([(x, -3.0), (x + 8, -3.0), (x + 8, 3.0), (x, 3.0)]))
        for name, x in (("m", 40.0), ("j", 78.0))
    ]
    zero = np.zeros(4)
    found = RoadMap(
        tuple(line), zero, zero, np.full(4, 3.5), np.zeros(4, bool), Flat(), lanes=lanes, junctions=tuple(outlines)
    )
    spans = approach_spans(found, "on", 60.0, "here")
    assert spans == {2: (0.0, 30.0), 1: (0.0, 8.0), 0: pytest.approx((18.0, 40.0))}
    assert Flat().triangles((0.0, 0.0), 10.0).shape == (0, 3, 3)


def test_a_mast_in_a_junction_without_lanes_stands_on_the_road():
    lanes = (Lane("in", "in", "", (1,)), Lane("out", "out", "", ()))
    line = [np.array([(0.0, 0.0), (40.0, 0.0)]), np.array([(60.0, 0.0), (90.0, 0.0)])]
    junction = Junction("j", np.array([(40.0, -10.0), (60.0, -10.0), (60.0, 10.0), (40.0, 10.0)]))
    two = np.zeros(2)
    found = RoadMap(
        tuple(line), two, two, np.full(2, 3.5), np.zeros(2, bool), Flat(), lanes=lanes, junctions=(junction,)
    )
    assert found.within(np.array([(50.0, 5.0), (50.0, 12.0), (20.0, 0.0)])).tolist() == [True, False, True]


def test_edges_across_a_tapering_lane_are_where_it_is_as_wide(read):
    found = read(road(lanes=section(lane(-1, (0.0, 2.0, 0.02)))))
    right, left = found.edges_across((50.0, -1.0))
    assert (right[1], left[1]) == (pytest.approx(-3.0, abs=0.02), pytest.approx(0.0, abs=0.02))


def lanes_in_a_row(*lanes):
    """Lanes along x from pairs of what a map says of each and where it lies, x from and to [m]."""
    line = tuple(np.array([(low, 0.0), (high, 0.0)]) for _, low, high in lanes)
    zero = np.zeros(len(lanes))
    ends = {lane.junction: high for lane, _, high in lanes if lane.junction}
    junctions = tuple(
        Junction(name, np.array([(x - 9.0, -3.0), (x, -3.0), (x, 3.0), (x - 9.0, 3.0)])) for name, x in ends.items()
    )
    return RoadMap(
        line, zero, zero, zero + 3.5, zero > 1.0, Flat(), lanes=tuple(lane for lane, *_ in lanes), junctions=junctions
    )


def test_an_approach_whose_lanes_split_goes_on_along_the_road_before_it():
    found = lanes_in_a_row(
        (Lane("up", "up", "", (1,)), 0.0, 100.0),
        (Lane("on.0", "on", "", (2, 3)), 100.0, 170.0),
        (Lane("on.1", "on", "", (4,)), 170.0, 200.0),
        (Lane("on.2", "on", "", (4,)), 170.0, 200.0),
        (Lane(":j", ":j", "j"), 200.0, 209.0),
    )
    assert approach_spans(found, "on", 150.0, "here") == {
        2: (0.0, 30.0),
        3: (0.0, 30.0),
        1: (0.0, 70.0),
        0: (50.0, 100.0),
    }


def test_a_lane_that_becomes_one_for_bicycles_does_not_end_at_the_stop_line():
    found = lanes_in_a_row(
        (Lane("on.0", "on", "", (4,)), 0.0, 230.0),
        (Lane("beside", "on", "", (2,)), 0.0, 100.0),
        (Lane("cycle", "on", "", (), "bicycles"), 100.0, 230.0),
        (Lane("unused", "off", ""), 300.0, 310.0),
        (Lane(":j", ":j", "j"), 230.0, 239.0),
    )
    assert approach_spans(found, "on", 50.0, "here") == {0: (180.0, 230.0)}


def test_a_junction_whose_lanes_the_map_does_not_have_counts_by_its_width():
    found = lanes_in_a_row(
        (Lane("in", "in", "", (1,)), 0.0, 40.0),
        (Lane("on", "on", "", (2,)), 48.0, 78.0),
        (Lane(":j", ":j", "j"), 78.0, 87.0),
    )
    assert approach_spans(found, "on", 60.0, "here") == {1: (0.0, 30.0), 0: (18.0, 40.0)}


def test_a_road_ends_where_it_leaves_and_not_where_one_of_its_lanes_does():
    bent = np.array([(0.0, 0.0), (100.0, 0.0), (100.0, 50.0)])
    zero = np.zeros(3)
    line = np.array([(0.0, 3.0), (60.0, 3.0)]), bent, np.array([(100.0, 50.0), (100.0, 60.0)])
    lanes = Lane("ends", "on"), Lane("goes", "on", "", (2,)), Lane(":j", ":j", "j")
    found = RoadMap(line, zero, zero, zero + 3.0, zero > 1.0, Flat(), lanes=lanes)
    assert ends_of(found, "on") == (0.0, pytest.approx(math.pi / 2.0))


def test_a_lane_before_two_approaches_counts_as_far_as_the_longer_reaches():
    lanes = Lane("a", "a", "", (1, 2)), Lane("b", "b", "", (3,)), Lane("c", "c", "", (3,)), Lane(":j", ":j", "j")
    line = [
        np.array(one, dtype=float)
        for one in (((0, 0), (100, 0)), ((100, 0), (159, 0)), ((100, 0), (138, 9)), ((159, 0), (168, 0)))
    ]
    zero = np.zeros(4)
    area = Junction("j", np.array([(138.0, -3.0), (168.0, -3.0), (168.0, 12.0), (138.0, 12.0)]))
    found = RoadMap(tuple(line), zero, zero, zero + 3.0, zero > 1.0, Flat(), lanes=lanes, junctions=(area,))
    of = [
        region_of(RegionSettings(junction="j", approaches=order, approach_m=80.0), found).spans[0][0]
        for order in (("b", "c"), ("c", "b"))
    ]
    assert of[0] == of[1] < 79.0
