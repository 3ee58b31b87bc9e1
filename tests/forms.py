"""Small scenes in every form that a scene may have, and a pairwise covering array of these forms.

All scenes see the same vehicles on the same two lanes along x, whatever kind of road these belong to.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from itertools import combinations, product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from blender_lidar.toml_table import to_toml
from tests.small_scene import CASTER, write_table

FACTORS: dict[str, tuple[str, ...]] = {
    "road": ("straight", "two_way", "net", "opendrive", "heights", "driven"),
    "scenery": ("none", "box", "mesh", "blend", "clutter"),
    "lidars": ("short", "one", "two", "one_held"),
    "placing": ("fixed", "x_and_y", "poles", "lean"),
    "region": ("disc", "polygon", "lanes", "approaches"),
    "recorded": ("here", "turned"),
    "scored": ("plain", "weights", "noise", "installer"),
}
USUAL = {name: values[0] for name, values in FACTORS.items()}
REFUSED: dict[tuple[str, str], str] = {
    **{(road, "clutter"): "lie along a straight road" for road in ("net", "opendrive", "heights", "driven")},
    **{(road, "approaches"): "is of a map; allowed: with" for road in ("straight", "two_way", "driven")},
    ("driven", "lanes"): "are of a straight road; allowed here: a circle or a polygon",
}
"""What is said of two forms that do not go together."""
NO_ROAD_HAS = {("clutter", "approaches")}  # both: refused with any

LANES_Y, WIDTH_M, ONCOMING_Y = (3.75, 7.25), 3.5, (14.75, 18.25)
ORIGIN_M, HEADING_DEG = (1000.0, 500.0), 30.0  # of a recording that is turned
_STEP_S, _SPEED_M_S = 2.0, 10.0
# Between masts and lanes, where it hides what passes behind it.
BOX = {"name": "house", "kind": "building", "centre_m": [1.0, 1.3, 1.2], "size_m": [2.5, 0.5, 2.4]}
_HEADER = (
    "frame",
    "vehicle_id",
    "class",
    "x_m",
    "y_m",
    "length_m",
    "width_m",
    "height_m",
    "heading_deg",
    "time_s",
    "lane",
)


def covering(factors: Mapping[str, Sequence[str]], refused: Collection[tuple[str, str]], seed: int = 1) -> list[dict]:
    """Pairwise covering array: rows with a value of each factor in which every two values that may meet do; greedy."""
    rng, names = np.random.default_rng(seed), list(factors)

    def meets(one: str, other: str) -> bool:
        return (one, other) not in refused and (other, one) not in refused

    missing = {
        ((first, one), (second, other))
        for first, second in combinations(names, 2)
        for one, other in product(factors[first], factors[second])
        if meets(one, other)
    }
    rows = []
    while missing:
        best: tuple[int, dict] = (-1, {})
        for _ in range(60):
            row = dict(sorted(missing)[rng.integers(len(missing))])
            for name in rng.permutation([name for name in names if name not in row]).tolist():
                able = [value for value in factors[name] if all(meets(value, other) for other in row.values())]
                if not able:
                    break
                gains = [sum(pair in missing for pair in _pairs({**row, name: value}, names)) for value in able]
                most = [value for value, gain in zip(able, gains, strict=True) if gain == max(gains)]
                row[name] = most[rng.integers(len(most))]
            if len(row) == len(names):
                best = max(best, (sum(pair in missing for pair in _pairs(row, names)), row), key=lambda one: one[0])
        missing -= set(_pairs(best[1], names))
        rows.append({name: best[1][name] for name in names})
    return rows


def _pairs(row: Mapping[str, str], names: Sequence[str]) -> list[tuple]:
    there = [name for name in names if name in row]
    return [((first, row[first]), (second, row[second])) for first, second in combinations(there, 2)]


class Motion(NamedTuple):
    """A site that lies elsewhere: mirrored at its x axis or not, then turned, and in its map moved by `map_m` [m]."""

    turn_deg: float = 0.0
    mirrored: bool = False
    map_m: tuple[float, float] = (0.0, 0.0)

    def site(self, xy: object) -> np.ndarray:
        """Places (..., 2) of the site frame [m]."""
        turn = math.radians(self.turn_deg)
        x, y = np.moveaxis(np.asarray(xy, dtype=float), -1, 0)
        y = -y if self.mirrored else y
        return np.stack([x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn)], axis=-1)

    def map(self, xy: object) -> np.ndarray:
        """The same in the map's frame."""
        return self.site(xy) + self.map_m

    def heading(self, degrees: float) -> float:
        return (-degrees if self.mirrored else degrees) + self.turn_deg


AS_IT_LIES = Motion()


# --- Traffic and roads ------------------------------------------------------------------------------------------------


def traffic(
    form: Mapping[str, str], motion: Motion = AS_IT_LIES, frames: int = 40, vehicles: int = 70
) -> list[list[object]]:
    """Rows of a table: vehicles at 10 m/s on the two lanes, and the other way on two more of a road of two ways."""
    rng, rows = np.random.default_rng(5), []
    sizes = {"car": (4.4, 1.8, 1.5), "van": (5.2, 2.0, 1.9), "truck": (9.0, 2.5, 3.6)}
    kinds = rng.choice(list(sizes), 2 * vehicles, p=[0.6, 0.25, 0.15])
    ways = [(0.0, LANES_Y)] + [(180.0, ONCOMING_Y)] * (form["road"] == "two_way")
    turn = math.radians(HEADING_DEG) if form["recorded"] == "turned" else 0.0
    cos, sin, (x0, y0) = math.cos(turn), math.sin(turn), ORIGIN_M if turn else (0.0, 0.0)
    for frame, (way, (heading, lanes)), number in product(range(frames), enumerate(ways), range(vehicles)):
        along = 13.7 * number - _SPEED_M_S * _STEP_S * frames + 3.0 * (number % 2) + _SPEED_M_S * _STEP_S * frame
        x, y = (along if heading == 0.0 else -along), lanes[number % 2]
        if abs(x) < 45.0:
            identity = way * vehicles + number
            x, y = motion.map((x, y)).tolist()
            place = x0 + x * cos - y * sin, y0 + x * sin + y * cos
            said = [*place, *sizes[kinds[identity]], motion.heading(heading) + math.degrees(turn)]
            rows.append([frame, identity + 1, kinds[identity], *said, _STEP_S * frame, 1 + number % 2])
    return rows


def _net() -> str:
    """A SUMO net by hand: two lanes that lead into a junction at x 10 to 30 m, and on; and a side road."""

    def edge(name, ends, low, high):
        lanes = "".join(
            f'<lane id="{name}_{k}" index="{k}" speed="13" length="{high - low}" width="{WIDTH_M}" '
            f'shape="{low},{y} {high},{y}"/>'
            for k, y in enumerate(LANES_Y)
        )
        return f'<edge id="{name}" {ends}>{lanes}</edge>'

    corners = "10,2 30,2 30,9 10,9"
    links = "".join(
        f'<connection from="in" to="out" fromLane="{k}" toLane="{k}" via=":J_0_{k}" dir="s" state="M"/>'
        f'<connection from=":J_0" to="out" fromLane="{k}" toLane="{k}" dir="s" state="M"/>'
        for k in (0, 1)
    )
    ends = "".join(
        f'<junction id="{name}" type="dead_end" x="{x}" y="5.5" incLanes="{lanes}" intLanes="" shape="{x},2 {x},9"/>'
        for name, x, lanes in (("W", -100, ""), ("E", 130, "out_0 out_1"), ("S", 28, ""))
    )
    return (
        '<net version="1.9"><location netOffset="0.00,0.00" convBoundary="-100.00,0.00,130.00,9.00" '
        'origBoundary="-100.00,0.00,130.00,9.00" projParameter="!"/>'
        + edge(":J_0", 'function="internal"', 10, 30)
        + edge("in", 'from="W" to="J" priority="1"', -100, 10)
        + edge("out", 'from="J" to="E" priority="1"', 30, 130)
        + '<edge id="side" from="S" to="J" priority="1"><lane id="side_0" index="0" speed="13" length="62" width="3.5" '
        'shape="28,-60 28,2"/></edge>'
        + f'<junction id="J" type="priority" x="20" y="5.5" incLanes="in_0 in_1 side_0" intLanes=":J_0_0 :J_0_1" '
        f'shape="{corners}"/>{ends}{links}<connection from="side" to="out" fromLane="0" toLane="0" dir="r" state="m"/>'
        "</net>"
    )


def _opendrive(rise: float) -> str:
    """The same by OpenDRIVE, which climbs by so much a metre."""

    def road(name, first, last, junction, to_lane, links):
        lanes = "".join(
            f'<lane id="-{k}" type="driving"><link>{to_lane.format(k)}</link>'
            f'<width sOffset="0" a="{WIDTH_M}" b="0" c="0" d="0"/></lane>'
            for k in (1, 2)
        )
        return (
            f'<road id="{name}" length="{last - first}" junction="{junction}"><link>{links}</link>'
            f'<planView><geometry s="0" x="{first}" y="9" hdg="0" length="{last - first}"><line/></geometry></planView>'
            f'<elevationProfile><elevation s="0" a="{rise * (first + 100)}" b="{rise}" c="0" d="0"/></elevationProfile>'
            f'<lanes><laneSection s="0"><center><lane id="0" type="none"/></center><right>{lanes}</right></laneSection>'
            "</lanes></road>"
        )

    across = (
        '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
        '<successor elementType="road" elementId="3" contactPoint="start"/>'
    )
    both = "".join(f'<laneLink from="-{k}" to="-{k}"/>' for k in (1, 2))
    return (
        '<OpenDRIVE><header revMajor="1" revMinor="4"/>'
        + road(1, -100, 10, -1, "", '<successor elementType="junction" elementId="J"/>')
        + road(10, 10, 30, "J", '<predecessor id="-{0}"/><successor id="-{0}"/>', across)
        + road(3, 30, 130, -1, "", '<predecessor elementType="junction" elementId="J"/>')
        + f'<junction id="J"><connection id="0" incomingRoad="1" connectingRoad="10" contactPoint="start">{both}'
        "</connection></junction></OpenDRIVE>"
    )


# --- A scene ----------------------------------------------------------------------------------------------------------

_STRAIGHT = {"setback_m": 2.0, "lanes": 2, "lane_width_m": WIDTH_M}
_ROADS: dict[str, dict[str, object]] = {
    "straight": _STRAIGHT,
    "two_way": {**_STRAIGHT, "carriageways": 2, "median_m": 4.0, "drives_on": "right"},
    "net": {"net": "site.net.xml"},
    "opendrive": {"opendrive": "site.xodr"},
    "heights": {"opendrive": "site.xodr"},
    "driven": {"driven": True},
}
_SCORED: dict[str, dict[str, dict[str, object]]] = {
    "plain": {},
    "weights": {
        "objective": {
            "class_weights": {"car": 0.5, "truck": 2.0},
            "zones": [
                {"name": "near", "polygon_m": [[-9.0, 0.0], [9.0, 0.0], [9.0, 20.0], [-9.0, 20.0]], "weight": 2.5}
            ],
        }
    },
    "noise": {"sensor": {"range_noise_m": 0.02, "dropout": 0.2, "unit_spread_deg": 0.05}},
    "installer": {},
}


def _region(form: Mapping[str, str]) -> dict[str, object]:
    kind, of_map = form["region"], form["road"] in ("net", "opendrive", "heights")
    if kind == "lanes" and of_map:
        return {"lanes": ["in_0"] if form["road"] == "net" else ["1:-2"]}
    return {
        "disc": {"centre_m": [0.0, 5.5], "radius_m": 18.0},
        "polygon": {"polygon_m": [[-15.0, 1.0], [14.0, 1.5], [15.0, 19.0], [-12.0, 19.5]]},
        "lanes": {"stretches": [{"x_m": [-15.0, 15.0], "lanes": [1]}]},
        "approaches": {"junction": "J", "approach_m": 25.0},
    }[kind]


def _stand(form: Mapping[str, str], x_m: float) -> dict[str, object]:
    """Where one LiDAR may hang."""
    stand: dict[str, object] = {"x_m": x_m, "y_m": -0.6, "height_m": [3.0, 4.0], "tilt_x_deg": 15.0}
    if form["placing"] == "fixed":
        stand["height_m"] = 3.5
    elif form["placing"] == "x_and_y":
        stand |= {"x_m": [x_m - 2.0, x_m + 2.0], "y_m": [-3.0, -0.6]}
    elif form["placing"] == "poles":
        stand = {"poles": "poles.csv", "height_m": [3.0, 4.0], "tilt_x_deg": 15.0}
    else:
        del stand["tilt_x_deg"]
        stand |= {"lean_deg": [5.0, 20.0], "lean_direction_deg": 20.0, "spin_deg": 10.0}
    return stand | ({} if form["scored"] == "installer" else {"installer": False})


def lidars(form: Mapping[str, str]) -> list[dict[str, object]]:
    """The entries of [[lidar]], or the one [deployment]."""
    stands = [_stand(form, x_m) for x_m in ((-4.0, 6.0) if form["lidars"] in ("two", "one_held") else (-4.0,))]
    if form["lidars"] == "one_held":
        stands[1] = {"x_m": 9.0, "y_m": -0.9, "height_m": 3.8, "tilt_x_deg": 12.0}
    if form["lidars"] == "short":
        return stands
    return [{"name": name, **stand} for name, stand in zip(("west", "east"), stands, strict=False)]


def house_of(form: Mapping[str, str]) -> dict[str, object]:
    """The house as an entry of [[world.boxes]]; on a map with heights the road lies 2 m high there."""
    x, y, z = BOX["centre_m"]
    return {**BOX, "centre_m": [x, y, z + 2.0 * (form["road"] == "heights")]}


def _moved_net(motion: Motion) -> str:
    """The net's places, pairs "x,y" of its shapes, moved."""

    def moved(pair: re.Match) -> str:
        return "{!r},{!r}".format(*motion.map((float(pair[1]), float(pair[2]))).tolist())

    return re.sub(r"(?<=[\" ])(-?[\d.]+),(-?[\d.]+)(?=[\" ])", moved, _net())


def _moved_opendrive(motion: Motion, rise: float) -> str:
    """The map's reference lines moved."""

    def moved(line: re.Match) -> str:
        x, y = motion.map((float(line[1]), float(line[2]))).tolist()
        return f'x="{x!r}" y="{y!r}" hdg="{math.radians(motion.turn_deg)!r}"'

    return re.sub(r'x="([^"]+)" y="([^"]+)" hdg="0"', moved, _opendrive(rise))


def _moved_tables(tables: dict, motion: Motion) -> None:
    """Move what a scene says in its site frame: region, boxes and where LiDARs hang; in place."""
    region = tables["region"]
    for key in ("centre_m", "polygon_m"):
        if key in region:
            region[key] = motion.site(region[key]).tolist()
    for box in tables.get("world", {}).get("boxes", ()):
        box["centre_m"] = [*motion.site(box["centre_m"][:2]).tolist(), box["centre_m"][2]]
        box["heading_deg"] = motion.heading(0.0)
    for stand in (*tables.get("lidar", ()), tables.get("deployment", {})):
        if "x_m" in stand:
            stand["x_m"], stand["y_m"] = motion.site((stand["x_m"], stand["y_m"])).tolist()
        if motion.mirrored and "lean_direction_deg" in stand:
            stand |= {key: -stand[key] for key in ("lean_direction_deg", "spin_deg")}
    if motion.map_m != (0.0, 0.0):
        tables["road"]["origin_m"] = list(motion.map_m)


def write_form(folder: Path, form: Mapping[str, str], motion: Motion = AS_IT_LIES, **changes: Mapping) -> Path:
    """Write a scene in some forms, and the files that it names but for Blender's; returns scene.toml.

    The test is skipped where what reads these files is not installed.
    """
    if form["road"] == "net":
        pytest.importorskip("sumolib", reason="sumolib, of the extra maps, is not installed")
    if form["scenery"] in ("mesh", "blend"):
        pytest.importorskip("bpy", reason="files of meshes are read by Blender")
    folder.mkdir(parents=True, exist_ok=True)
    write_table(folder / "traffic.csv", traffic(form, motion), _HEADER)
    (folder / "site.net.xml").write_text(_moved_net(motion), encoding="utf-8")
    rise = 0.02 if form["road"] == "heights" else 0.0
    (folder / "site.xodr").write_text(_moved_opendrive(motion, rise), encoding="utf-8")
    poles = {"north": (-6.0, -0.6), "middle": (1.5, -0.8), "south": (7.0, -0.7)}
    lines = ["{},{!r},{!r}".format(name, *motion.site(place).tolist()) for name, place in poles.items()]
    (folder / "poles.csv").write_text("\n".join(["name,x_m,y_m", *lines, ""]), encoding="utf-8")
    house = house_of(form)
    half = np.array(list(product((-0.5, 0.5), repeat=3)))
    corners = house["centre_m"] + half * house["size_m"]
    quads = (1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4)
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f " + " ".join(map(str, quad)) for quad in quads]
    (folder / "house.obj").write_text("\n".join([*lines, ""]), encoding="utf-8")
    placed = {"origin_m": list(ORIGIN_M), "heading_deg": HEADING_DEG} if form["recorded"] == "turned" else {}
    tables: dict[str, object] = {
        "traffic": {"path": "traffic.csv", "frames": 3, "holdout": 0.3, **placed},
        "road": _ROADS[form["road"]],
        "sensor": {"name": "RS-16", "rotation_hz": 20.0, "range_gate_m": 40.0},
        "region": _region(form),
        "search": {"particles": 4, "iterations": 2},
        "model": {"caster": CASTER, "workers": 1},
    }
    world = {"box": {"boxes": [house]}, "mesh": {"mesh": "house.obj", "up": "z"}, "blend": {"blend": "house.blend"}}
    world["clutter"] = {"clutter": 1.0}
    if form["scenery"] in world:
        tables["world"] = world[form["scenery"]]
    for name, more in _SCORED[form["scored"]].items():
        tables[name] = {**tables.get(name, {}), **more}
    stands = lidars(form)
    if form["lidars"] == "short":
        (tables["deployment"],) = stands
    else:
        tables["lidar"] = stands
        tables["search"] = {"particles": 6, "iterations": 30}
    tables = {
        name: {**tables.get(name, {}), **changes.get(name, {})} if name != "lidar" else tables[name]
        for name in {**tables, **changes}
    }
    if motion != AS_IT_LIES:
        tables = deepcopy(tables)
        _moved_tables(tables, motion)
    path = folder / "scene.toml"
    path.write_text(to_toml(tables), encoding="utf-8")
    return path
