"""Options that several verbs share, and how they replace a scene's settings."""

from __future__ import annotations

import argparse
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..scene.scenario import DECLARED, Scenario, load_scenario
from ..scene.settings import MOUNTING
from ..toml_table import Setting, checked

_MOST_FRAMES = 1_000_000
_FRAMES = re.compile(r"\s*(-?\d+)(?::(-?\d+)(?::(\d+))?)?\s*")
_SETTINGS = {
    declared.option: (table, key, declared)
    for table, settings in DECLARED.items()
    for key, declared in settings.items()
    if declared.option and table not in ("deployment", "baseline")
}
SEARCH_OPTIONS = ("--search", "--fidelity", "--particles", "--iterations")
_FOR_SEARCHES = (*SEARCH_OPTIONS, "--frames", "--frame-ids", "--metric", "--tolerance", "--reading", "--workers")
_FOR_SEARCHES += ("--cluster", "--seed")

# --- Options that are declared as settings are ------------------------------------------------------------


def add_option(parser, declared: Setting, default: object = None, **more: str) -> None:
    """The option of a setting; what is given is read by `option_value`, `more` is argparse's."""
    names = tuple(declared.allowed)
    listed = None if declared.metavar else names or None
    metavar = declared.metavar or (None if listed else declared.option[2:].upper())
    told = f"{declared.help}: {', '.join(names)}" if declared.metavar and names else declared.help
    parser.add_argument(declared.option, choices=listed, metavar=metavar, help=told, default=default, **more)


def option_value(given: object, declared: Setting) -> Any:
    """What an option is given, checked as its setting declares it."""
    return checked(_number_or_text(given, declared.kind), declared, declared.option)


def _number_or_text(given, kind=float):
    """A text as the number that it is, if numbers are asked for; the checks see to texts that are none."""
    try:
        return kind(given) if kind in (int, float) else given
    except ValueError:
        return given


def add_scene(parser: argparse.ArgumentParser, *, leave_out: tuple[str, ...] = ()) -> None:
    """The scene file, and the options that replace its settings but for those left out."""
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    for option, (_, _, declared) in _SETTINGS.items():
        if option not in leave_out:
            add_option(parser, declared)
    parser.set_defaults(left_out=leave_out)


def add_moments(parser: argparse.ArgumentParser, many: str) -> None:
    """A scene, one or many of its frames, and a mounting, for verbs without a search; `many` says what many make."""
    add_scene(parser, leave_out=_FOR_SEARCHES)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--frame", type=int, metavar="K", help="frame number, as the recording counts them")
    which.add_argument(
        "--frame-ids", dest="sequence", metavar="IDS", help=f"{many}: 100,150 or 100:160:5, its end included"
    )
    add_pose(parser)


def add_pose(parser: argparse.ArgumentParser) -> None:
    """The six coordinates of one mounting."""
    group = parser.add_argument_group("mounting", "metres and degrees; what is left out is the scene's baseline")
    for key, declared in MOUNTING.items():
        add_option(group, replace(declared, metavar=key.rsplit("_", 1)[1].upper()), dest=f"pose_{key}")


def scenario_from(args: argparse.Namespace) -> Scenario:
    """The scene with the options given in place of its settings."""
    overrides = {}
    for option, (table, key, declared) in _SETTINGS.items():
        given = getattr(args, option[2:].replace("-", "_"), None)
        if given is not None and option not in args.left_out:
            read = _READ_AS.get(option, lambda text, _, kind=declared.kind: _number_or_text(text, kind))
            overrides[table, key] = (read(given, option), option)
    return load_scenario(args.scene, overrides)


def mounting_from(args: argparse.Namespace, scenario: Scenario) -> dict[str, float]:
    """The mounting that the options name, in metres and degrees."""
    given = {key: getattr(args, f"pose_{key}") for key in MOUNTING}
    named = {key: option_value(text, MOUNTING[key]) for key, text in given.items() if text is not None}
    return {**scenario.baseline, **named}


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
            raise InputError(
                f"{option}: {part!r}; allowed: a range from:to:step with to not below from, step 1 or more, and not "
                f"more than {_MOST_FRAMES:,} frames in all"
            )
        frames += range(first, last + 1, step)
    return frames


def parse_tolerance(text: str, option: str) -> dict[str, float | str] | None:
    """A table of half-widths from "tilt_deg=1,height_m=0.05", None from "none"; the scene's checks see to its keys."""
    if text == "none":
        return None
    table: dict[str, float | str] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals or not value or key in table:
            fault = "is there twice" if key in table else "is no key=value"
            raise InputError(f"{option}: {part!r} {fault}; allowed: such as tilt_deg=1,height_m=0.05, or none")
        table[key] = _number_or_text(value)
    return table


_READ_AS = {"--tolerance": parse_tolerance, "--frame-ids": parse_frames}


def label_classes(args: argparse.Namespace) -> tuple[str, ...]:
    """What ``--class`` calls a car, in the words of a data set's labels."""
    classes = tuple(name.strip() for name in args.classes or ["Car"])
    if not all(classes):
        raise InputError("--class: is empty; allowed: a name that the labels use")
    return classes


# --- Folders of results -----------------------------------------------------------------------------------


def default_folder(scenario: Scenario, *more: str) -> Path:
    """A folder under runs/ that is not there yet, named after scene, sensor and perhaps more."""
    return new_folder("_".join([Path(scenario.source).stem, Path(scenario.sensor.name).stem, *more]))


def new_folder(name: str) -> Path:
    """A folder under runs/ that is not there yet: of that name, in small letters, with a number where it is taken."""
    stem = name.lower()
    candidates = (Path("runs") / (stem if number == 1 else f"{stem}_{number}") for number in range(1, 1_000_000))
    return next(path for path in candidates if not path.exists())
