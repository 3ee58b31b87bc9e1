"""Six small scenes of different kinds, for what must hold on every kind: functions that write one into a folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests import sumo_samples
from tests.small_scene import HEADER, REGION, traffic_rows, write_scene, write_table

# The LiDAR hangs off the line y = 0: no side of a vehicle lies on an edge of a detector's pillars, counted from it.
_FEW: dict[str, dict[str, object]] = {
    "deployment": {"y_m": -0.04321},
    "traffic": {"frames": 4, "holdout": 0.4},
    "search": {"particles": 4, "iterations": 2, "seed": 1},
}


def _written(folder: Path, **changes: dict[str, object]) -> Path:
    merged = {name: {**_FEW.get(name, {}), **changes.get(name, {})} for name in {**_FEW, **changes}}
    return write_scene(folder, merged)


def circle(folder: Path) -> Path:
    """A circle, a range gate of its own, and two searched coordinates, so that there is a map."""
    deployment = {"x_m": 0.123456, "height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}
    return _written(folder, deployment=deployment, **REGION)


def stretches(folder: Path) -> Path:
    """A stretch of the carriageway, as `init` proposes it, some spacing of the frames, and imperfect returns."""
    region = {"stretches": [{"x_m": [-18.0, 15.0]}], "keep_out": [[[-3.0, 0.0], [3.0, 0.0], [3.0, 3.0], [-3.0, 3.0]]]}
    sensor = {"range_noise_m": "datasheet", "dropout": 0.123456789, "RS-16": {"range_gate_m": 19.5}}
    return _written(folder, region=region, sensor=sensor, traffic={"frames": None, "spacing_s": 6.0})


def utm_polygon(folder: Path) -> Path:
    """A polygon, and traffic of SUMO on two of three lanes in UTM, where single precision keeps half a metre."""
    east, north, rows = 565432.125, 5812345.625, []
    for frame in range(0, 120, 2):
        for number in range(60):
            lane, x = number % 3, 10.0 * frame - 1200 + 21 * number
            if abs(x) < 45.0:
                place = {"x": round(east - x, 3), "y": north - 3.75 - 3.5 * lane, "lane": f"road_{lane}"}
                kind = "lorry" if number % 5 == 0 else "car"
                rows.append(sumo_samples.row(frame, id=f"v.{number}", angle=270.0, type=kind, **place))
    folder.mkdir(parents=True, exist_ok=True)
    types = '<routes><vType id="car" length="4.4" height="1.5"/><vType id="lorry" vClass="truck" length="11"/></routes>'
    (folder / "types.rou.xml").write_text(types, encoding="utf-8")
    (folder / "run.fcd.xml").write_text(sumo_samples.xml(rows), encoding="utf-8")
    traffic = {"path": "run.fcd.xml", "vehicle_types": "types.rou.xml", "lanes": [0, 1], "heading_deg": 180.0}
    polygon = [[-17.0, 1.0], [14.0, 1.5], [16.0, 8.0], [-12.0, 9.0]]
    return _written(folder, traffic=traffic | {"origin_m": [east, north]}, region={"polygon_m": polygon})


def slope_and_crown(folder: Path) -> Path:
    """A road with grade, cross-fall and crown, things beside it, and a lean that is searched in a fixed direction."""
    road = {"grade_percent": 4.0, "cross_fall_percent": -2.5, "crown_percent": 2.0}
    box = {"name": "cabinet", "centre_m": [6.0, 1.0, 0.6], "size_m": [1.0, 0.5, 1.2]}
    barrier = {"kind": "guard_rail", "y_m": 1.4, "x_m": [-30.0, -5.0]}
    world = {"boxes": [box], "barriers": [barrier], "clutter": 0.5, "clutter_seed": 3, "variety": 0.5}
    lean = {"tilt_x_deg": None, "height_m": 4.0, "lean_deg": [0.0, 20.0], "lean_direction_deg": 33.3, "spin_deg": 12.0}
    return _written(folder, road=road, world=world, deployment=lean, **REGION)


def two_recordings_with_poles(folder: Path) -> Path:
    """A morning and an evening that weigh differently, and candidate places."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(("morning", "evening"), start=1):
        write_table(folder / f"{name}.csv", traffic_rows(seed=seed), HEADER)
    poles = ["name,x_m,y_m,height_min_m,height_max_m", "north,-4.5,0.25,,", "south,6.25,-0.5,2.5,4"]
    (folder / "poles.csv").write_text("\n".join(poles) + "\n", encoding="utf-8")
    deployment = {"poles": "poles.csv", "y_m": None, "height_m": [2.0, 4.5], "tilt_x_deg": 15.0}
    path = _written(folder, deployment=deployment, traffic={"path": "morning.csv", "weight": 3.0}, **REGION)
    text = path.read_text(encoding="utf-8").replace("[traffic]", "[[traffic]]")
    evening = '[[traffic]]\npath = "evening.csv"\nframes = 3\nholdout = 0.4\nblock_s = 20.0\n'
    path.write_text(f"{text}\n{evening}", encoding="utf-8")
    return path


def weights_zones_and_installer(folder: Path) -> Path:
    """Classes and places that count more, a mounting that may end up off its plan, and a search of another method."""
    zone = {"name": "merge", "polygon_m": [[-20.0, 0.0], [0.0, 0.0], [0.0, 9.0], [-20.0, 9.0]], "weight": 2.5}
    objective = {"classes": ["car", "van", "truck"], "class_weights": {"car": 0.5, "truck": 2.0}}
    objective |= {"zones": [zone], "threshold": 0.0123456789}
    objective |= {"loss": -0.5, "view": "max"}
    installer = {"tilt_deg": 1.0, "height_m": 0.05, "yaw_deg": 1.5}
    more = {"search": {"method": "random"}, "baseline": {"lean_deg": 7.5}, "deployment": {"installer": installer}}
    return _written(folder, objective=objective, **more, **REGION)


SCENES: dict[str, Callable[[Path], Path]] = {
    made.__name__: made
    for made in (
        circle,
        stretches,
        utm_polygon,
        slope_and_crown,
        two_recordings_with_poles,
        weights_zones_and_installer,
    )
}
