"""Files that look right and are not: each stops a run or is a note, and right ones like them are silent."""

from __future__ import annotations

import math

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recording
from tests import traffic_samples as ngsim
from tests.small_scene import HEADER, done, traffic_rows, without_charts, write_scene, write_table
from tests.test_plausibility import COLUMN, SIZES, road_at, stream, table

CIRCLE_40 = {"centre_m": [0.0, 0.0], "radius_m": 40.0}
WIDE = {"sensor": {"range_gate_m": 60.0}}


def queue(standing_deg=None):
    """Rows of vehicles on a road at 33 degrees that come, stand for a minute and go on."""
    cos, sin = math.cos(math.radians(33.0)), math.sin(math.radians(33.0))
    rows = []
    for frame in range(240):
        time_s = 0.5 * frame
        for number in range(12):
            stop = 20.0 - 8.0 * number
            along = min(stop, 10.0 * time_s - 150.0 - 8.0 * number)
            if time_s > 60.0:
                along = stop + 10.0 * max(0.0, time_s - 60.0 - 2.0 * number)
            stands = along == stop and standing_deg is not None
            place = [round(along * cos, 3), round(along * sin + 5.5, 3)]
            rows.append([frame, number, "car", *place, 4.4, 1.8, 1.5, standing_deg if stands else 33.0, time_s])
    return rows


def bend(radius_m=300.0, heading_deg=None):
    """Rows of vehicles on a bend to the left; headings along it unless given."""
    rows = []
    for frame in range(240):
        for number in range(40):
            along = 5.0 * frame + 30.0 * number - 1200.0
            turn = along / radius_m
            if abs(along) < 120.0:
                place = [radius_m * math.sin(turn), 5.5 + radius_m * (1.0 - math.cos(turn))]
                heading = math.degrees(turn) if heading_deg is None else heading_deg
                rows.append([frame, number, "car", *place, 4.4, 1.8, 1.5, heading, 0.5 * frame])
    return rows


def both_ways(rows):
    """The same rows, every other vehicle driving the same way backwards in time."""
    last = max(row[0] for row in rows)
    ahead = [row for row in rows if row[1] % 2]
    back = [[last - row[0], *row[1:8], row[8] + 180.0, 0.5 * (last - row[0])] for row in rows if not row[1] % 2]
    return sorted(ahead + back, key=lambda row: row[0])


def drifting(rate_m_s):
    """Rows of a busy road whose places move across it as time goes by."""
    rng = np.random.default_rng(4)
    lane, start = rng.integers(2, size=300), np.sort(rng.uniform(-1800.0, 100.0, 300))
    rows = []
    for frame in range(180):
        for number in np.flatnonzero(np.abs(start + 7.5 * frame) < 100.0).tolist():
            place = [float(start[number]) + 7.5 * frame, 3.75 + 3.5 * int(lane[number]) + rate_m_s * 0.5 * frame]
            rows.append([frame, number, "car", *place, 4.4, 1.8, 1.5, 0.0, 0.5 * frame])
    return rows


def with_trailer():
    """Rows of a tractor and, right behind it, its trailer, as two boxes beside the lanes of `traffic_rows`."""
    rows = []
    for frame in range(8):
        x = -60.0 + 20.0 * frame
        rows.append([frame, 901, "truck", x, 12.5, 6.0, 2.5, 3.6, 0.0, 2.0 * frame])
        rows.append([frame, 902, "truck", x - 9.6, 12.5, 13.0, 2.5, 4.0, 0.0, 2.0 * frame])
    return rows


def jam(ahead=0.0):
    """Rows of a dense jam of cars and trucks; places so many lengths ahead of the boxes' middles."""
    rng = np.random.default_rng(1)
    rows = []
    for lane in range(2):
        rear = 0.0
        for number in range(60):
            kind, size = [("car", (4.4, 1.8, 1.5)), ("truck", (12.0, 2.5, 3.5))][rng.random() < 0.25]
            middle, rear = rear - 0.5 * size[0], rear - size[0] - rng.uniform(1.5, 3.0)
            for frame in range(60):
                x_m = middle + 4.0 * frame + 60.0
                if abs(x_m) < 60.0:
                    place = [x_m + ahead * size[0], 3.75 + 3.5 * lane]
                    rows.append([frame, 100 * lane + number, kind, *place, *size, 0.0, 2.0 * frame])
    return rows


def of_class(kind, factor):
    """The usual rows with the sizes of one class multiplied."""
    rows = table()
    for row in rows:
        for name in SIZES if row[COLUMN["class"]] == kind else ():
            row[COLUMN[name]] *= factor
    return rows


def again(share):
    """The usual rows, and some vehicles of them once more under another id."""
    rows = table()
    return rows + [[row[0], row[1] + 1000, *row[2:]] for row in table() if row[1] % round(1 / share) == 0]


def shifted(y_m=0.0, x_m=0.0):
    return table(x_m=lambda row: row["x_m"] + x_m, y_m=lambda row: row["y_m"] + y_m)


def two_carriageways(mirrored=False):
    """Traffic to the left of the oncoming one, as where one drives on the right; in a mirror it is to its right."""
    rows = stream(1, 0, 3.75, 2.0) + stream(2, 0, 7.25, 3.0) + stream(3, 180, 13.0, 2.0) + stream(4, 180, 16.5, 3.0)
    for row in rows if mirrored else ():
        row[COLUMN["y_m"]] = 11.0 - row[COLUMN["y_m"]]
        row[COLUMN["heading_deg"]] *= -1.0
    return rows


def beside_a_motorway():
    """A carriageway of few vehicles, one every half minute, under 2 % of all in a circle."""
    return stream(1, 0, 5.5, 20.0) + [row for lane in range(6) for row in stream(10 + lane, 0, 16.0 + 4.0 * lane, 1.0)]


def at_another_time(which, by_s):
    rows = table()
    for row in rows:
        row[COLUMN["time_s"]] += by_s * which(row[COLUMN["frame"]])
    return rows


def seen(folder, rows, changes=None):
    """Notes of a site with such a table."""
    write_table(folder / "traffic.csv", rows, HEADER)
    site = prepare(load_scenario(write_scene(folder, changes)))
    assert site.recording.report.warnings == ()
    return " | ".join([*site.recording.report.notes, *site.plan.notes])


def one_id_for(count):
    """The usual rows with ids that several vehicles have at the same time."""
    return table(vehicle_id=lambda row: row["vehicle_id"] % count)


def anew(ids):
    """The usual rows, numbered on from row to row, so that an id is another vehicle's in each frame."""
    return [[row[0], number % ids, *row[2:]] for number, row in enumerate(dense())]


def dense(shift_m=(0.0, 0.0)):
    """Four lanes of traffic in steps of half a second, whose second minute is shifted."""
    rows = []
    for row in (row for lane in range(4) for row in stream(1 + lane, 0, 3.75 + 3.5 * lane, 2.5)):
        later = row[0] >= 60
        rows.append([*row[:3], row[3] + shift_m[0] * later, row[4] + shift_m[1] * later, *row[5:]])
    return sorted(row for row in rows if row[0] < 120)


def again_from_behind():
    """Vehicles that drive through a second time, a minute later, as others whose ids are used again."""
    first = [row for row in dense() if row[0] < 40]
    return first + [[row[0] + 60, *row[1:9], row[9] + 60.0] for row in first]


def once_more(x_m=0.0):
    """The usual two minutes, and the same with other ids two minutes later, so many metres ahead."""
    later = [[row[0] + 60, row[1] + 1000, row[2], row[3] + x_m, *row[4:9], row[9] + 120.0] for row in table()]
    return table() + later


def in_lanes(factor=1.0, y_m=0.0):
    """Four lanes whose places across are multiplied and moved."""
    return [[*row[:4], factor * row[4] + y_m, *row[5:]] for row in dense()]


def across():
    """Dense traffic, in which a tenth of the vehicles points to the left and a tenth to the right."""
    return [[*row[:8], {0: 90.0, 5: -90.0}.get(row[1] % 10, 0.0), row[9]] for row in dense()]


def standing():
    return table(x_m=lambda row: 12.0 * row["vehicle_id"] - 240.0)


FOUR_LANES = {"road": {"lanes": 4}, **WIDE}
AT_33 = {"traffic": {"heading_deg": 33.0}}
STOPS = {  # by name: the rows, the scene, and what the line says
    "headings of vehicles that stand": (queue(0.0), AT_33, "standing boxes point more than 30.*--accept headings"),
    "one heading on a bend": (
        bend(heading_deg=0.0),
        {},
        "one heading for all although the road bends.*--accept headings",
    ),
    "a bend in a long region": (
        bend(100.0),
        {"region": CIRCLE_40, "sensor": {"range_gate_m": 60.0}},
        r"the road bends by 4\d deg within the region, [678]\.\d m off a straight line.*--accept bend",
    ),
    "a bend that is driven both ways": (
        both_ways(bend(100.0)),
        {"region": CIRCLE_40, "sensor": {"range_gate_m": 60.0}, "road": {"lanes": 1, "carriageways": 2}},
        r"the road bends by 4\d deg within the region, [678]\.\d m off a straight line.*--accept bend",
    ),
    "a drone that drifts": (
        drifting(0.05),
        WIDE,
        r"all lanes move to the left of x by (4\.[5-9]|5\.[0-3]) cm/s.*--accept drift",
    ),
    "front bumpers": (jam(0.5), {}, "bumpers and not box centres.*--accept overlaps"),
    "rear bumpers": (jam(-0.5), {}, "bumpers and not box centres.*--accept overlaps"),
    "trucks ten times too small": (of_class("truck", 0.1), {}, "median truck is 1.1 .*another unit.*--accept sizes"),
    "cars ten times too small": (of_class("car", 0.1), {}, "median car is 0.44 .*another unit.*--accept sizes"),
    "vans of a third": (of_class("van", 0.3048), {}, "median van is 1.58 .*another unit.*--accept sizes"),
    "trucks of no unit": (
        of_class("truck", 0.15),
        {},
        "another unit, swapped columns .*--accept sizes",
    ),
    "one height for all": (
        table(height_m=lambda row: 1.5),
        {},
        "11 by 2.5 by 1.5 m, is as high as the median car.*one size or height.*--accept sizes",
    ),
    "one in twenty-five there twice": (
        again(0.04),
        {},
        "boxes stand where another one stands.*listed twice.*--accept overlaps",
    ),
    "a fifth there twice": (again(0.2), {}, "boxes overlap.*listed twice.*--accept overlaps"),
    "one size for all": (
        table(length_m=lambda row: 4.4, width_m=lambda row: 1.8, height_m=lambda row: 1.5),
        {},
        "4.4 by 1.8 by 1.5 m, is as high as the median car.*one size or height.*--accept sizes",
    ),
    "trucks whose width and height are swapped": (
        [[*row[:6], row[7], row[6], *row[8:]] if row[2] == "truck" else row for row in table()],
        {},
        "median truck is 11 by 3.6 by 2.5 m .*swapped columns.*--accept sizes",
    ),
    "headings 4 degrees off": (
        table(heading_deg=lambda row: 4.0),
        {},
        "headings of moving vehicles are 4 degrees off their motion.*headings",
    ),
    "some headings across": (across(), {}, "20 % of them more than 30.*--accept headings"),
    "several vehicles under one id": (
        one_id_for(2),
        {},
        "elsewhere in the same frame.*share a vehicle_id.*--accept tracks",
    ),
    "ids of another vehicle in each frame": (
        anew(50),
        {},
        "vehicles jump by 20 m.*share a vehicle_id.*--accept tracks",
    ),
    "lanes that no table names": (
        traffic_rows(),
        {"region": {"stretches": [{"x_m": [-20.0, 20.0], "lanes": [1, 2]}]}},
        "check .region. stretches: of lanes 1, 2, it names no lanes",
    ),
    "half of it shifted across": (dense((0.0, 3.0)), {}, "all vehicles jump together by 3.0 m from frame 59 to 60"),
    "half of it shifted along": (dense((40.0, 0.0)), {}, "all vehicles jump together by 40.0 m from frame 59 to 60"),
    "a region that no mount can see": (
        shifted(x_m=100.0),
        {"region": {"centre_m": [100.0, 0.0], "radius_m": 30.0}},
        "100 % of the boxes .* beyond the range gate of 20 m from any mount, and can never be seen",
    ),
}
NOTES = {  # by name: the rows, the scene, and what is said
    "heading_deg 3 degrees off": (
        road_at(33),
        {"traffic": {"heading_deg": 30.0}},
        "at 3 degrees to the road's x axis, 2.1 m across it in 40 m: check [traffic] heading_deg (such as 33)",
    ),
    "a trailer as a box of its own": (
        [*traffic_rows(), *with_trailer()],
        {"traffic": {"accept": ["overlaps"]}},
        "1 pair of boxes touch from end to end as they drive: tractors and trailers as two boxes each?",
    ),
    "y mirrored": (
        two_carriageways(mirrored=True),
        {"region": CIRCLE_40, **WIDE},
        "this is left-hand traffic ([road] drives_on",
    ),
    "an origin 4 m off": (shifted(y_m=4.0), {}, "they drive at y 8 to 11 m: check [traffic] and [road]"),
    "a region that is half seen": (
        traffic_rows(),
        {"region": {"centre_m": [15.0, 0.0], "radius_m": 20.0}},
        "from any mount, and count as missed",
    ),
    "ids that are used again": (again_from_behind(), WIDE, "of the vehicles jump back and drive past again"),
    "headings that are noise": (
        table(heading_deg=lambda row: 20.0 * math.sin(7.0 * row["frame"] + row["vehicle_id"])),
        {},
        "from row to row (usual: under 1): are they noise?",
    ),
    "every other frame of a vehicle": (
        [row for row in dense() if (row[0] + row[1]) % 2],
        WIDE,
        "% of the frames between their first and their last",
    ),
    "the same minutes twice": (
        once_more(),
        {},
        "50 % of the frames come again to the centimetre 120 s later, under other vehicle numbers: if the",
    ),
    "lengths that vary": (
        table(length_m=lambda row: row["length_m"] * (1.0 + 0.3 * math.sin(3.0 * row["frame"]))),
        {},
        "lengths of one vehicle vary by",
    ),
    "some pedestrians": (
        [[*row[:5], 0.5, 0.5, 1.75, *row[8:]] if row[1] % 5 == 0 else row for row in table()],
        {},
        "% of the boxes have impossible sizes for their class, as a ",
    ),
    "a car park": (standing(), {}, "almost no vehicle moves in 118 s: a jam, or a car park?"),
    "new ids in every frame": (anew(10**6), WIDE, "almost no vehicle is in more than one frame"),
    "lanes of 2 m": (traffic_rows(), {"road": {"lane_width_m": 2.0}}, "lane_width_m is 2 m (usual: 2.4 to 5.2)"),
    "some boxes in one another": (
        [
            *dense(),
            *([*row[:1], row[1] + 10_000, *row[2:4], row[4] + 0.6, *row[5:]] for row in dense() if row[1] % 12 == 0),
        ],
        WIDE,
        "pairs among 100 boxes overlap",
    ),
    "places multiplied by 1.1": (in_lanes(factor=1.1), FOUR_LANES, "3.85 m apart, but [road] lane_width_m is 3.5 m"),
    "an origin 1.5 m off": (in_lanes(y_m=1.5), FOUR_LANES, "vehicles drive 1.5 m beside the lane centres of"),
    "few beside a motorway": (beside_a_motorway(), {"region": CIRCLE_40, **WIDE}, "% of the boxes in the region lie"),
    "a last frame of another day": (
        at_another_time(lambda frame: frame >= 58, 86_400.0),
        {},
        "nothing is held out: 86402 of the recording's 86520 s are one pause, after 58 frames (frame 57)",
    ),
    "a first frame of another day": (
        at_another_time(lambda frame: frame >= 2, 86_400.0),
        {},
        "86402 of the recording's 86520 s are one pause, after 2 frames (frame 1) and before 58 (2)",
    ),
}
RIGHT = {  # the same without the fault
    "vehicles that stand": (queue(), AT_33),
    "a bend": (bend(), {}),
    "a jam": (jam(), {}),
    "a road at 33 degrees": (road_at(33), AT_33),
    "a road at 32 degrees": (road_at(33), {"traffic": {"heading_deg": 32.0}}),
    "two carriageways": (two_carriageways(), {"region": CIRCLE_40, **WIDE}),
    "two carriageways, of one": (two_carriageways(), {"region": {"stretches": [{"x_m": [-40.0, 40.0]}]}, **WIDE}),
    "dense traffic": (dense(), WIDE),
    "four lanes": (in_lanes(), FOUR_LANES),
    "four lanes, driven on the left of each": (in_lanes(y_m=0.6), FOUR_LANES),
    "minutes that are alike": (once_more(1.7), {}),
    "a minute without anybody": (at_another_time(lambda frame: frame >= 30, 60.0), {}),
}


@pytest.mark.parametrize("case", STOPS)
def test_what_cannot_be_true_stops(case, tmp_path):
    rows, changes, message = STOPS[case]
    with pytest.raises(InputError, match=message):
        seen(tmp_path, rows, changes)


@pytest.mark.parametrize("case", NOTES)
def test_what_may_be_wrong_is_told(case, tmp_path):
    rows, changes, message = NOTES[case]
    assert message in seen(tmp_path, rows, changes)


@pytest.mark.parametrize("case", RIGHT)
def test_what_is_right_is_told_nothing_of(case, tmp_path):
    usual = ("few different vehicles", "nothing is held out", "the first ", "the last ", "queues come and go")
    assert [note for note in seen(tmp_path, *RIGHT[case]).split(" | ") if note and not note.startswith(usual)] == []


@pytest.mark.parametrize("mirrored", [False, True])
def test_init_says_that_y_may_be_mirrored_and_its_scene_does_not_say_it_again(mirrored, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    path = write_table(tmp_path / "traffic.csv", two_carriageways(mirrored), HEADER)
    said, notes = done(capsys, "init", tmp_path / "site", "--from", "table", path)
    assert ("left-hand traffic" in said) is ("y is mirrored in the file" in said) is mirrored
    assert "mirrored" not in notes
    assert f'drives_on = "{"left" if mirrored else "right"}"' in (tmp_path / "site" / "scene.toml").read_text()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, None),
        (
            {"Local_X": lambda feet: (0.3048 * feet).round(3)},
            r"boxes overlap .*not in metres.*--accept overlaps",
        ),
        ({"v_Class": lambda number: 5 - number}, None),
    ],
    ids=["right", "Local_X in metres", "cars that are trucks"],
)
def test_ngsim_with_a_wrong_column(change, message, tmp_path):
    given = ngsim.columns(vehicles=40, frames=60)
    given |= {name: change_of(given[name]) for name, change_of in change.items()}
    ngsim.write(tmp_path, ngsim.native(given))
    scene = load_scenario(write_scene(tmp_path, {"traffic": {"path": "recording.txt"}, "road": {"lanes": 6}}))
    if message is None:
        notes = " | ".join(read_recording(scene).report.notes)
        assert ("absurd for their class" in notes) is ("v_Class" in change)
    else:
        with pytest.raises(InputError, match=message):
            read_recording(scene)
