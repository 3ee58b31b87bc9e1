"""Options that several verbs share, and how they replace a scene's settings."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from ..casting import CASTERS
from ..errors import InputError
from ..metrics.catalogue import METRICS
from ..optimise import READINGS, SEARCHES
from ..scenario import COORDINATE_LIMITS, COORDINATES, FIDELITIES, Scenario, load_scenario
from ..world.shapes import DETAILS

_MOST_FRAMES = 1_000_000


def _number_or_text(given: str) -> float | str:
    """For settings that take either; the scene's checks refuse other texts by name."""
    try:
        return float(given)
    except ValueError:
        return given


# option, table, key, type, choices, help
_SETTINGS = (
    ("--sensor", "sensor", "name", str, None, "sensor model or the path of a beam table; see `blender-lidar sensors`"),
    (
        "--range-noise",
        "sensor",
        "range_noise_m",
        _number_or_text,
        None,
        "standard deviation of the range noise in metres, or datasheet for the model's own",
    ),
    ("--dropout", "sensor", "dropout", float, None, "probability that a return is lost"),
    (
        "--glass-dropout",
        "sensor",
        "glass_dropout",
        float,
        None,
        "probability that a return from glass is lost besides; 1: windows return nothing",
    ),
    (
        "--range-at-10-percent",
        "sensor",
        "range_at_10_percent_m",
        _number_or_text,
        None,
        "metres to which a target of 10 percent reflectivity is seen, or datasheet; weaker returns are lost",
    ),
    ("--unit-spread", "sensor", "unit_spread_deg", float, None, "standard deviation between units' beams in degrees"),
    ("--traffic", "traffic", "path", str, None, "trajectory file in place of the scene's"),
    ("--vehicle-types", "traffic", "vehicle_types", str, None, "SUMO route or additional file with the <vType>s"),
    ("--period", "traffic", "period", str, None, "recording period of an NGSIM file: 1, 2 ... or 0400-0415"),
    ("--location", "traffic", "location", str, None, "site of a file that mixes several: i-80"),
    ("--frames", "traffic", "frames", int, None, "number of searched frames, spread evenly"),
    ("--caster", "model", "caster", str, ("auto", *CASTERS), "what casts the rays"),
    ("--detail", "world", "detail", str, DETAILS, "level of detail of the vehicles"),
    ("--metric", "objective", "metric", str, None, f"what is maximised: {', '.join(METRICS)}"),
    (
        "--tolerance",
        "objective",
        "tolerance",
        str,
        None,
        "how far off its plan the mounting may end up, as half-widths: tilt_deg=1,height_m=0.05; also yaw_deg, and "
        "aim=mean or aim=low; none: it hangs as planned",
    ),
    ("--reading", "objective", "reading", str, READINGS, "the paper's equations as corrected, or as printed"),
    ("--workers", "model", "workers", int, None, "processes; 0 takes one for each processor"),
    ("--cluster", "model", "cluster", str, None, "dask scheduler whose workers are used instead: tcp://host:8786"),
    ("--search", "search", "method", str, SEARCHES, "how the best mounting is looked for"),
    (
        "--fidelity",
        "search",
        "fidelity",
        str,
        FIDELITIES,
        "full: every mounting is scored on all frames with all beams; auto: most are screened on less, and what is "
        "reported is scored on all of it",
    ),
    ("--seed", "search", "seed", int, None, "seed of everything random"),
    ("--particles", "search", "particles", int, None, "particles of the swarm, hardened or DE-PSO's"),
    (
        "--iterations",
        "search",
        "iterations",
        int,
        None,
        "every search gets particles x iterations evaluations",
    ),
)
_POSE_HELP = {
    "x_m": "along the road, in the direction of travel",
    "y_m": "across the road, to the left",
    "height_m": "above the road",
    "tilt_x_deg": "across the road, positive looks down towards +y",
    "tilt_y_deg": "along the road, positive raises the side ahead",
    "yaw_deg": "counter-clockwise seen from above",
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


def option_name(key: str) -> str:
    """The option that gives a coordinate: ``--tilt-x`` for ``tilt_x_deg``."""
    return f"--{key.removesuffix('_m').removesuffix('_deg').replace('_', '-')}"


def add_scene(parser: argparse.ArgumentParser, *, leave_out: tuple[str, ...] = ()) -> None:
    """The scene file, and the options that replace its settings but for those left out."""
    parser.add_argument("scene", metavar="SCENE.toml", help="the scene file")
    for option, _, _, kind, choices, text in _SETTINGS:
        if option not in leave_out:
            parser.add_argument(
                option, type=kind, choices=choices, metavar=None if choices else option[2:].upper(), help=text
            )
    if "--frame-ids" not in leave_out:
        parser.add_argument(
            "--frame-ids", metavar="IDS", help="the searched frames: 100,150 or 100:160:5, its end included"
        )
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
    for key in COORDINATES:
        group.add_argument(
            option_name(key),
            type=float,
            metavar=key.rsplit("_", 1)[1].upper(),
            dest=f"pose_{key}",
            help=_POSE_HELP[key],
        )


def scenario_from(args: argparse.Namespace) -> Scenario:
    """The scene with the options given in place of its settings."""
    overrides = {}
    for option, table, key, _, _, _ in _SETTINGS:
        value = getattr(args, option[2:].replace("-", "_"), None)
        if value is not None and option not in args.left_out:
            overrides[table, key] = (_READ_AS.get(option, _as_it_is)(value, option), option)
    if getattr(args, "frame_ids", None) is not None:
        overrides["traffic", "frame_ids"] = (parse_frames(args.frame_ids, "--frame-ids"), "--frame-ids")
    return load_scenario(args.scene, overrides)


def mounting_from(args: argparse.Namespace, scenario: Scenario) -> dict[str, float]:
    """The mounting that the options name, in metres and degrees."""
    mount = dict(scenario.baseline)
    for key, (low, high) in COORDINATE_LIMITS.items():
        value = getattr(args, f"pose_{key}")
        if value is None:
            continue
        if not low <= value <= high:
            raise InputError(f"{option_name(key)}: is {value}; allowed: {low:g} to {high:g}")
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


def _as_it_is(value: object, _option: str) -> object:
    return value


_READ_AS = {"--tolerance": parse_tolerance}  # settings that an option writes in another way than a scene


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
