"""What the options of several verbs mean: settings of a scene, mountings, and folders of results."""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import InputError, MissingExtraError, unknown_name
from ..names import THE_LIDAR
from ..scene.deployment import MOUNTING_OR_LEAN, Place, fixed_beside
from ..scene.mounting import Layout, Mounting
from ..toml_table import checked
from .parsers import SCENE_OPTIONS, as_name, given_options, parse_pairs

if TYPE_CHECKING:
    from ..scene.lidars import LidarSpec
    from ..scene.scenario import Scenario

# --- A scene ----------------------------------------------------------------------------------------------


def scenario_from(args: argparse.Namespace, sensor: str | None = None) -> Scenario:
    """The scene with the options given in place of its settings, and a sensor by its name."""
    from ..scene.scenario import load_scenario

    given = {option: as_name(option) for option in args.given if option in SCENE_OPTIONS}
    overrides = {
        SCENE_OPTIONS[option][:2]: (getattr(args, name), option)
        for option, name in given.items()
        if hasattr(args, name)  # else it is the verb's own
    }
    if sensor is not None:
        overrides["sensor", "name"] = (sensor, "--sensor")
    return load_scenario(args.scene, overrides)


def scene_settings() -> dict[str, tuple[str, str]]:
    """Table and key of each setting that has an option, by the option's name as Python writes it."""
    return {as_name(option): (table, key) for option, (table, key, _) in SCENE_OPTIONS.items()}


def in_words(name: str, value: object, where: str) -> object:
    """The value of a scene's setting that is written as its option is, such as "100:160:5"; any other as it is."""
    *_, declared = SCENE_OPTIONS["--" + name.replace("_", "-")]
    return declared.read(value, where) if declared.read and isinstance(value, str) else value


# --- Mountings --------------------------------------------------------------------------------------------


def layout_from(args: argparse.Namespace, scenario: Scenario) -> Layout:
    """The mountings that the options name, one for each LiDAR of the scene."""
    single = given_options(args, (*MOUNTING_OR_LEAN, "pole"))
    options = list(map(_option, single))
    if args.of_run is not None:
        if single or args.lidar:
            raise InputError(f"--run: is given beside {(options or ['--lidar'])[0]}; allowed: one of both")
        return layout_of_run(args.of_run, scenario)
    if not scenario.is_layout and not args.lidar:
        return (_mounting_of(scenario.lidar, single),)
    if single:
        names = ", ".join(lidar.name for lidar in scenario.lidars)
        raise InputError(
            f"{options[0]}: is of one LiDAR, but the scene has {names}; allowed: --lidar NAME,height_m=4.1"
        )
    given = {}
    for text in args.lidar or ():
        name, _, rest = (part.strip() for part in text.partition(","))
        if name in given:
            raise InputError(f"--lidar: {name} is given twice; allowed: once for each LiDAR")
        given[name] = parse_pairs(rest, f"--lidar {name}", "height_m=4.1,tilt_x_deg=19") if rest else {}
    return layout_of(scenario, given, "--lidar")


def _option(key: str) -> str:
    return "--pole" if key == "pole" else MOUNTING_OR_LEAN[key].option


def layout_of(scenario: Scenario, given: Mapping[str, Mapping[str, object]], where: str) -> Layout:
    """The mountings of all LiDARs by their names: see `_mounting_of`."""
    names, found = [lidar.name for lidar in scenario.lidars], []
    poles = {(pole.x_m, pole.y_m): pole.name for lidar in scenario.lidars for pole in lidar.deployment.poles}
    for name in given:
        if name not in names:
            raise unknown_name(name, names, "LiDAR", where)
    for one in scenario.lidars:
        name, others = one.name, {mounting.xy: name for name, mounting in zip(names, found, strict=False)}
        found.append(_mounting_of(one, given.get(name, {}), f"{where} {name}"))
        if (xy := found[-1].xy) in others and xy in poles:
            raise InputError(f"{where} {name}: hangs on pole {poles[xy]}, as {others[xy]} does; allowed: a pole each")
    return tuple(found)


def layout_of_run(folder: str, scenario: Scenario) -> Layout:
    """The mountings of a run of the same LiDARs, by their names."""
    from ..run.folder import RunFolder

    rows = {row["name"] or THE_LIDAR: row["deployment"] for row in RunFolder(folder).result["lidars"]}
    if set(rows) != {lidar.name for lidar in scenario.lidars}:
        there = ", ".join(rows)
        raise InputError(f"--run: {folder}: has other LiDARs ({there}) than the scene; allowed: a run of the same")
    return tuple(one.mounting(rows[one.name], f"{folder}: result.json") for one in scenario.lidars)


def _mounting_of(lidar: LidarSpec, given: Mapping[str, object], where: str = "") -> Mounting:
    """The mounting of one LiDAR by pole and coordinates; others are as its one place fixes them, or its baseline's.

    `where` they are given; each by an option of its own unless said.
    """
    known = [*MOUNTING_OR_LEAN, "pole"]
    for key in given:
        if key not in known:
            raise unknown_name(key, known, "coordinate", where)
    called = {key: f"{where}: {key}" if where else _option(key) for key in known}
    pairs = {key: checked(one, MOUNTING_OR_LEAN[key], called[key]) for key, one in given.items() if key != "pole"}
    if "pole" in given:
        if key := next((key for key in ("x_m", "y_m") if key in pairs), None):
            raise InputError(f"{called[key]}: is given beside {'pole' if where else '--pole'}; allowed: one of both")
        place = lidar.deployment.on_pole(str(given["pole"]), called["pole"])
        if "height_m" in pairs:
            _check_height(place, pairs["height_m"], called["height_m"])
        facing = {"facing_deg": place.facing.at(place.xy, place.road)}
        pairs = fixed_beside(place.fixed, pairs) | facing | pairs
    return lidar.mounting(pairs, where or "mounting")


def _check_height(place: Place, height_m: float, where: str) -> None:
    """Refuse a height at which nothing can hang on a pole."""
    pole, (low, high) = place.pole, place.span("height_m")
    allowed = f"{low:g} to {high:g} m above the road"
    if pole.height_max_m is None:
        low, high = pole.foot_z_m + (pole.height_min_m or 0.0), math.inf
        allowed = f"{low:g} m above the road or more"
    if not low <= height_m <= high:
        raise InputError(f"{where}: is {height_m:g}; allowed on pole {pole.name}: {allowed}")


# --- What is there, and folders of results ----------------------------------------------------------------


def check_scipy(what: str) -> None:
    """Refuse early what needs SciPy where it is not installed, as within a real Blender."""
    if find_spec("scipy") is None:
        raise MissingExtraError(f"{what} needs scipy (pip install scipy)")


def default_folder(scenario: Scenario, *more: str) -> Path:
    """A folder under runs/ that is not there yet, named after scene, sensor and perhaps more."""
    return new_folder("_".join([Path(scenario.source).stem, Path(scenario.lidars[0].sensor.name).stem, *more]))


def new_folder(name: str) -> Path:
    """A folder under runs/ that is not there yet: of that name, in small letters, with a number where it is taken."""
    stem = name.lower()
    candidates = (Path("runs") / (stem if number == 1 else f"{stem}_{number}") for number in itertools.count(1))
    return next(path for path in candidates if not path.exists())
