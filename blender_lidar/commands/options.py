"""Options that several verbs share, and how they replace a scene's settings."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from ..scene.scenario import DECLARED, Scenario, load_scenario
from ..scene.settings import MOUNTING
from ..toml_table import Setting

_MOST_FRAMES = 1_000_000
_SETTINGS = {
    declared.option: (table, key, declared)
    for table, settings in DECLARED.items()
    for key, declared in settings.items()
    if declared.option and not MOUNTING.keys() & settings.keys()
}
SEARCH_OPTIONS = ("--search", "--fidelity", "--particles", "--iterations")
_FOR_SEARCHES = (
    *SEARCH_OPTIONS,
    "--frames",
    "--frame-ids",
    "--metric",
    "--tolerance",
    "--reading",
    "--workers",
    "--cluster",
    "--seed",
)


def add_scene(parser: argparse.ArgumentParser, *, leave_out: tuple[str, ...] = ()) -> None:
    """The scene file, and the options that replace its settings but for those left out."""
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    for option, (_, _, declared) in _SETTINGS.items():
        if option not in leave_out:
            listed = None if declared.metavar else tuple(declared.allowed) or None
            metavar = declared.metavar or (None if listed else option[2:].upper())
            parser.add_argument(option, type=_type_of(declared), choices=listed, metavar=metavar, help=declared.help)
    parser.set_defaults(left_out=leave_out)


def _type_of(declared: Setting) -> Callable[[str], object]:
    """What argparse makes of an option's text; the scene's checks see to the rest, and to texts that stay."""
    if declared.word:
        return _number_or_text
    return declared.kind if declared.kind in (int, float) else str


def _number_or_text(given: str) -> float | str:
    try:
        return float(given)
    except ValueError:
        return given


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
        metavar = key.rsplit("_", 1)[1].upper()
        group.add_argument(declared.option, type=float, metavar=metavar, dest=f"pose_{key}", help=declared.help)


def scenario_from(args: argparse.Namespace) -> Scenario:
    """The scene with the options given in place of its settings."""
    overrides = {}
    for option, (table, key, _) in _SETTINGS.items():
        value = getattr(args, option[2:].replace("-", "_"), None)
        if value is not None and option not in args.left_out:
            overrides[table, key] = (_READ_AS[option](value, option) if option in _READ_AS else value, option)
    return load_scenario(args.scene, overrides)


def mounting_from(args: argparse.Namespace, scenario: Scenario) -> dict[str, float]:
    """The mounting that the options name, in metres and degrees."""
    mount = dict(scenario.baseline)
    for key, declared in MOUNTING.items():
        value = getattr(args, f"pose_{key}")
        if value is None:
            continue
        if not declared.low <= value <= declared.high:
            raise InputError(f"{declared.option}: is {value}; allowed: {declared.low:g} to {declared.high:g}")
        mount[key] = value
    return mount


def checked_number(value: float, option: str, *, low: float) -> float:
    """`value`, if it is finite and at least `low`."""
    if not low <= value < math.inf:
        raise InputError(f"{option}: is {value}; allowed: at least {low:g}")
    return value


def parse_frames(text: str, option: str) -> list[int]:
    """Frame numbers from "100,150" or "100:160:5" or both mixed; the end of a range is included."""
    frames: list[int] = []
    for part in text.split(","):
        try:
            numbers = [int(number) for number in part.split(":")]
            if len(numbers) > 3:
                raise ValueError
            first, last, step = [*numbers, *([numbers[0], 1][len(numbers) - 1 :])]
        except ValueError:
            raise InputError(f"{option}: {part!r}; allowed: frame numbers such as 100,150 or 100:160:5") from None
        if step < 1 or last < first or (last - first) // step >= _MOST_FRAMES:
            raise InputError(
                f"{option}: {part!r}; allowed: a range from:to:step with to not below from and step 1 or more"
            )
        frames += range(first, last + 1, step)
        if len(frames) > _MOST_FRAMES:
            raise InputError(f"{option}: names more than {_MOST_FRAMES:,} frames")
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


# Settings that an option writes in another way than a scene.
_READ_AS = {"--tolerance": parse_tolerance, "--frame-ids": parse_frames}


def default_folder(scenario: Scenario, *more: str) -> Path:
    """A folder under runs/ that is not there yet, named after scene, sensor and perhaps more."""
    return new_folder("_".join([Path(scenario.source).stem, Path(scenario.sensor.name).stem, *more]))


def new_folder(name: str) -> Path:
    """A folder under runs/ that is not there yet: of that name, in small letters, with a number where it is taken."""
    stem = name.lower()
    candidates = (Path("runs") / (stem if number == 1 else f"{stem}_{number}") for number in range(1, 1_000_000))
    return next(path for path in candidates if not path.exists())


def label_classes(args: argparse.Namespace) -> tuple[str, ...]:
    """What ``--class`` calls a car, in the words of a data set's labels."""
    classes = tuple(name.strip() for name in args.classes or ["Car"])
    if not all(classes):
        raise InputError("--class: is empty; allowed: a name that the labels use")
    return classes
