"""Options that several verbs share, and how they replace a scene's settings."""

from __future__ import annotations

import argparse
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from ..errors import InputError, MissingExtraError, unknown_name
from ..names import THE_LIDAR
from ..plugins import IN_A_FILE
from ..scene.deployment import MOUNTING_OR_LEAN, Place, fixed_beside
from ..scene.mounting import Layout, Mounting
from ..scene.settings import DECLARED, INSTALLER
from ..toml_table import Setting, checked, limits_text, settings_of

if TYPE_CHECKING:
    from ..scene.lidars import LidarSpec
    from ..scene.scenario import Scenario

_MOST_FRAMES = 1_000_000
_FRAMES = re.compile(r"\s*(-?\d+)(?::(-?\d+)(?::(\d+))?)?\s*")
_SETTINGS = {
    declared.option: (table, key, declared)
    for table, settings in DECLARED.items()
    for key, declared in settings.items()
    if declared.option and (table not in ("deployment", "baseline", "lidar") or (table, key) == INSTALLER)
}
SEARCH_OPTIONS = ("--search", "--fidelity", "--particles", "--iterations", "--seeds")
_FOR_SEARCHES = (*SEARCH_OPTIONS, "--frames", "--frame-ids", "--metric", "--installer", "--reading", "--workers")
_FOR_SEARCHES += ("--cluster", "--seed", "--pose-error")

# --- Options that are declared as settings are ------------------------------------------------------------


_UNITS = {"m": "m", "deg": "degrees", "s": "s", "hz": "Hz"}  # by how the name of a setting ends
# Groups of a scene's options, by the table that each is of.
_GROUPS = {
    "scene": ("traffic", "road", "world"),
    "sensor": ("sensor",),
    "installation": ("deployment",),
    "objective": ("objective",),
    "search": ("search",),
    "computing": ("model",),
}


class Once(argparse.Action):
    """An option that takes effect once: given again it is refused, not dropped."""

    def __call__(self, parser, namespace, values, option_string=None):
        if getattr(namespace, self.dest) is not self.default:
            parser.error(f"argument {option_string}: is given twice; allowed: once")
        setattr(namespace, self.dest, values)


def _described(declared: Setting, key: str, default: object) -> str:
    """The help of a setting's option: what it is, its limits and unit in brackets, its default."""
    unit = _UNITS.get(key.rpartition("_")[2], "")
    limits = limits_text(declared, declared.kind) if declared.kind in (int, float) else ""
    amount = " ".join(part for part in (limits, unit) if part)
    allowed = (*declared.allowed, *([IN_A_FILE] if declared.plugins else []))
    names = ", ".join(allowed) if allowed and declared.metavar else ""
    text = declared.help + (f": {names}" if names else "") + (f" [{amount}]" if amount else "")
    if not (default is None or default is ... or default is False or default == ()):
        text += f" (default {default:g})" if isinstance(default, float) else f" (default {default})"
    return text.replace("%", "%%")


def add_option(parser, declared: Setting, key: str, default: object = None, *, of_scene: bool = False) -> None:
    """The option of a setting, which `given_options` reads; it must be given where `default` is ``...``.

    `of_scene`: where it is not given the scene's counts, and the default where that says nothing.
    """
    names, parts = tuple(declared.allowed), get_args(declared.kind)
    text = _described(declared, key, declared.default if of_scene else default)
    how = {"default": None if default is ... else default, "help": text}
    if declared.kind is bool:
        how["action"] = "store_true"
    elif names and not declared.metavar:
        how["choices"] = names
    else:
        how["metavar"] = declared.metavar or ("FILE" if declared.is_path else declared.option[2:].upper())
    if parts and declared.option not in _READ_AS:
        how |= {"action": "append"} if ... in parts else {"nargs": len(parts)}
    how.setdefault("action", Once)
    parser.add_argument(declared.option, required=default is ..., **how)


def add_options(parser: argparse.ArgumentParser, declared: type, groups: Mapping[str, Sequence[str]]) -> None:
    """The options that a dataclass declares, which `options_of` reads, by the titles of their groups."""
    settings = settings_of(declared)
    for title, keys in groups.items():
        group = parser.add_argument_group(title)
        for key in keys:
            add_option(group, settings[key], key, settings[key].default)


def options_of(args: argparse.Namespace, declared: type) -> Any:
    """The options that a dataclass declares, as it holds them."""
    return declared(**given_options(args, settings_of(declared)))


def given_options(args: argparse.Namespace, settings: Mapping[str, Setting]) -> dict[str, Any]:
    """The values of the options that are given, by the keys of their settings, checked as these declare."""
    found = {}
    for key, declared in settings.items():
        given = getattr(args, declared.option[2:].replace("-", "_"))
        if given is not None:
            found[key] = checked(_numbers_read(given, declared.kind), declared, declared.option)
    return found


def _numbers_read(given, kind):
    """Texts as the numbers that they are, where numbers are asked for; the checks see to those that are none."""
    if isinstance(given, list):
        return [_numbers_read(one, get_args(kind)[0]) for one in given]
    try:
        return kind(given) if kind in (int, float) else given
    except ValueError:
        return given


def add_scene(parser: argparse.ArgumentParser, *, leave_out: tuple[str, ...] = ()) -> None:
    """The scene file, and the options that replace its settings except for those left out."""
    meant = "scene file, or the name of a shipped scene: i80; options replace what the file says"
    parser.add_argument("scene", metavar="SCENE.toml", help=meant)
    for title, tables in _GROUPS.items():
        asked = {option: of for option, of in _SETTINGS.items() if of[0] in tables and option not in leave_out}
        group = parser.add_argument_group(title) if asked else None
        for _, key, declared in asked.values():
            add_option(group, declared, key, of_scene=True)
    parser.set_defaults(left_out=leave_out)


def add_moments(parser: argparse.ArgumentParser, many: str) -> None:
    """A scene, one or many of its frames, and a mounting, for verbs without a search; `many` says what many make."""
    add_scene(parser, leave_out=_FOR_SEARCHES)
    frames = parser.add_argument_group("frames", "one, or many")
    which = frames.add_mutually_exclusive_group(required=True)
    which.add_argument("--frame", type=int, metavar="K", help="number of the frame in the recording")
    which.add_argument(
        "--frame-ids", dest="sequence", metavar="IDS", help=f"{many}: 100,150 or 100:160:5 (its end included)"
    )
    add_pose(parser)


def add_pose(parser: argparse.ArgumentParser, *, on_poles: bool = True) -> None:
    """The coordinates of one mounting, on a candidate pole or not: the orientation by tilts and yaw, or by its lean."""
    group = parser.add_argument_group(
        "mounting", "coordinates that are not given are as the scene fixes them, else its baseline's"
    )
    if on_poles:
        said = "candidate pole of the scene on which the LiDAR hangs"
        group.add_argument("--pole", metavar="NAME", help=said)
    for key, declared in MOUNTING_OR_LEAN.items():
        add_option(group, replace(declared, metavar=key.rsplit("_", 1)[1].upper()), key)
    said = "of a scene with several LiDARs, where one hangs: its name and coordinates, north,height_m=4.1,pole=NE; "
    said += "what is not given is as its table fixes it, else its baseline's; may be repeated"
    group.add_argument("--lidar", action="append", metavar="NAME,...", help=said)
    said = "folder of a run whose mountings are taken, in place of coordinates"
    group.add_argument("--run", dest="of_run", action=Once, metavar="DIR", help=said)


def scenario_from(args: argparse.Namespace) -> Scenario:
    """The scene with the options given in place of its settings."""
    from ..scene.scenario import load_scenario

    overrides = {}
    for option, (table, key, declared) in _SETTINGS.items():
        given = getattr(args, option[2:].replace("-", "_"), None)
        if given is not None and option not in args.left_out:
            read = _READ_AS.get(option)
            overrides[table, key] = (read(given, option) if read else _numbers_read(given, declared.kind), option)
    return load_scenario(args.scene, overrides)


def scene_settings() -> dict[str, tuple[str, str]]:
    """Table and key of each setting that has an option, by the option's name as Python writes it."""
    return {option[2:].replace("-", "_"): (table, key) for option, (table, key, _) in _SETTINGS.items()}


def mounting_from(args: argparse.Namespace, scenario: Scenario) -> Mounting:
    """The mounting that the options name."""
    given = given_options(args, MOUNTING_OR_LEAN)
    if getattr(args, "pole", None) is not None:
        place = scenario.lidar.deployment.on_pole(args.pole)
        if xy := [key for key in ("x_m", "y_m") if key in given]:
            raise InputError(f"{MOUNTING_OR_LEAN[xy[0]].option}: is given beside --pole; allowed: one of both")
        pole, height, (low, high) = place.pole, given.get("height_m"), place.span("height_m")
        allowed = f"{low:g} to {high:g} m above the road"
        if pole.height_max_m is None:
            low, high = pole.foot_z_m + (pole.height_min_m or 0.0), math.inf
            allowed = f"{low:g} m above the road or more"
        if height is not None and not low <= height <= high:
            raise InputError(f"--height: is {height:g}; allowed on pole {pole.name}: {allowed}")
        given = _on(place, given)
    return scenario.lidar.mounting(given)


def layout_from(args: argparse.Namespace, scenario: Scenario) -> Layout:
    """The mountings that the options name, one for each LiDAR of the scene."""
    single = [MOUNTING_OR_LEAN[key].option for key in given_options(args, MOUNTING_OR_LEAN)]
    single += ["--pole"] if getattr(args, "pole", None) is not None else []
    named, folder = getattr(args, "lidar", None), getattr(args, "of_run", None)
    if folder is not None:
        if single or named:
            raise InputError(f"--run: is given beside {(single or ['--lidar'])[0]}; allowed: one of both")
        return layout_of_run(folder, scenario)
    if not scenario.is_layout and not named:
        return (mounting_from(args, scenario),)
    names = [lidar.name for lidar in scenario.lidars]
    if single:
        raise InputError(
            f"{single[0]}: is of one LiDAR, but the scene has {', '.join(names)}; allowed: --lidar NAME,height_m=4.1"
        )
    given = {}
    for text in named or ():
        name, _, rest = (part.strip() for part in text.partition(","))
        if name in given:
            raise InputError(f"--lidar: {name} is given twice; allowed: once for each LiDAR")
        given[name] = parse_pairs(rest, f"--lidar {name}", "height_m=4.1,tilt_x_deg=19") if rest else {}
    return layout_of(scenario, given, "--lidar")


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


def _mounting_of(lidar: LidarSpec, given: Mapping[str, object], where: str) -> Mounting:
    """The mounting of one LiDAR by pole and coordinates; others are as its one place fixes them, or its baseline's."""
    pairs = {key: value for key, value in given.items() if key != "pole"}
    for key in pairs:
        if key not in MOUNTING_OR_LEAN:
            raise unknown_name(key, [*MOUNTING_OR_LEAN, "pole"], "coordinate", where)
    pairs = {key: checked(value, MOUNTING_OR_LEAN[key], f"{where}: {key}") for key, value in pairs.items()}
    if "pole" in given:
        if place := next((key for key in ("x_m", "y_m") if key in pairs), None):
            raise InputError(f"{where}: {place}: is given beside pole; allowed: one of both")
        pairs = _on(lidar.deployment.on_pole(str(given["pole"]), f"{where}: pole"), pairs)
    return lidar.mounting(pairs, where)


def _on(place: Place, given: Mapping[str, float]) -> dict[str, float]:
    """Coordinates of a mounting on a pole: those that are given, else those that are fixed there."""
    facing = {"facing_deg": place.facing.at(place.xy, place.road)}
    return fixed_beside(place.fixed, given) | facing | given


# --- Options that are written in another way than a scene's settings --------------------------------------


def parse_frames(text: str, option: str) -> list[int]:
    """Frame numbers from "100,150" or "100:160:5" or both mixed; the end of a range is included."""
    frames: list[int] = []
    for part in text.split(","):
        found = _FRAMES.fullmatch(part)
        if not found:
            raise InputError(f"{option}: {part!r}; allowed: frame numbers such as 100,150 or 100:160:5")
        first, last, step = int(found[1]), int(found[2] or found[1]), int(found[3] or 1)
        if step < 1 or last < first or len(frames) + (last - first) // step >= _MOST_FRAMES:
            allowed = f"a range from:to:step that rises, and not more than {_MOST_FRAMES:,} frames"
            raise InputError(f"{option}: {part!r}; allowed: {allowed}")
        frames += range(first, last + 1, step)
    return frames


def parse_installer(text: str, option: str) -> dict[str, float | str] | bool:
    """A table of half-widths from "tilt_deg=1,height_m=0.05", or false; the scene's checks see to its keys."""
    return text != "false" and parse_pairs(text, option, "tilt_deg=1,height_m=0.05, or false")


def parse_pose_error(text: str, option: str) -> dict[str, float | str] | None:
    """The same, None from "none"."""
    return None if text == "none" else parse_pairs(text, option, "tilt_deg=1,height_m=0.05, or none")


def parse_pairs(text: str, option: str, such_as: str) -> dict[str, float | str]:
    """A table from "key=value,key=value"."""
    table: dict[str, float | str] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not value or key in table:
            fault = "is there twice" if key in table else "is no key=value"
            raise InputError(f"{option}: {part!r} {fault}; allowed: such as {such_as}")
        table[key] = _numbers_read(value, float)
    return table


_READ_AS = {"--installer": parse_installer, "--pose-error": parse_pose_error, "--frame-ids": parse_frames}


def in_words(name: str, value: object, where: str) -> object:
    """The value of a scene's setting that is written as its option is, such as "100:160:5"; any other as it is."""
    read = _READ_AS.get("--" + name.replace("_", "-"))
    return read(value, where) if read and isinstance(value, str) else value


def check_scipy(what: str) -> None:
    """Refuse early what needs SciPy where it is not installed, as within a real Blender."""
    if find_spec("scipy") is None:
        raise MissingExtraError(f"{what} needs scipy (pip install scipy)")


# --- Folders of results -----------------------------------------------------------------------------------


def default_folder(scenario: Scenario, *more: str) -> Path:
    """A folder under runs/ that is not there yet, named after scene, sensor and perhaps more."""
    return new_folder("_".join([Path(scenario.source).stem, Path(scenario.lidars[0].sensor.name).stem, *more]))


def new_folder(name: str) -> Path:
    """A folder under runs/ that is not there yet: of that name, in small letters, with a number where it is taken."""
    stem = name.lower()
    candidates = (Path("runs") / (stem if number == 1 else f"{stem}_{number}") for number in itertools.count(1))
    return next(path for path in candidates if not path.exists())
