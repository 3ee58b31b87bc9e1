"""Verbs and their options as they are declared, for argparse; the standard library alone, so that help opens at once.

An option is a `Setting`, be it of a scene, a mounting or a verb: its name, type, help and check come from there.
"""

from __future__ import annotations

import argparse
import inspect
import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, NamedTuple, get_args

from ..errors import InputError
from ..plugins import IN_A_FILE
from ..scene.deployment import MOUNTING_OR_LEAN
from ..scene.settings import DECLARED, INSTALLER
from ..toml_table import Setting, checked, limits_text, setting, settings_of

_MOUNTING, _OUTPUT = "mounting", "output"  # groups: that with all coordinates, and the last one
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
_ABOUT = {_MOUNTING: "coordinates that are not given are as the scene fixes them, else its baseline's"}
_COORDINATES = {
    key: replace(declared, metavar=key.rsplit("_", 1)[1].upper(), default=None)
    for key, declared in MOUNTING_OR_LEAN.items()
}
_MOST_FRAMES = 1_000_000
_MOST_IN_RANGE = 40
_FRAMES = re.compile(r"\s*(-?\d+)(?::(-?\d+)(?::(\d+))?)?\s*")

# --- Verbs ------------------------------------------------------------------------------------------------


class Verb(NamedTuple):
    """A verb of the command line.

    Attributes
    ----------
    usage : str
        Its name, and what has to follow it.
    run : str
        What carries it out, ``module.function`` of this room, which is imported when it is run.
    options : type
        The dataclass of its own options, whose docstring is its help: what it does in a line and in a paragraph, and
        examples.
    without : collection of str, optional
        Options of a scene's settings that it does not have; for verbs that are about a scene.
    """

    usage: str
    run: str
    options: type
    without: Collection[str] | None = None


def add_verbs(subparsers, verbs: Collection[Verb], words: Collection[str] | None = None) -> None:
    """Describe verbs to argparse, their options too unless `words` are given and are not about the verb."""
    for verb in verbs:
        name, _, must = verb.usage.partition(" ")
        aliases = ["optimize"] if name == "optimise" else []
        doc = inspect.getdoc(verb.options) or ""
        what, description, *_ = (*doc.split("\n\n"), "")  # python -OO has no docstrings
        examples = re.search(r"^Examples\n-+\n((?:.+\n?)+)", doc, re.MULTILINE)
        lines = [f"\n  blender-lidar {name} {line}" for line in examples[1].splitlines()] if examples else []
        parser = subparsers.add_parser(
            name,
            aliases=aliases,
            help=what[:1].lower() + what[1:].removesuffix("."),
            usage=f"%(prog)s {must} [options]".replace("  ", " "),
            description=" ".join(description.split()),
            epilog=f"examples:{''.join(lines)}" if lines else "",
        )
        parser.set_defaults(run=verb.run, given=())
        if words is None or not {name, *aliases}.isdisjoint(words):
            _add_options(parser, verb)


def _add_options(parser: argparse.ArgumentParser, verb: Verb) -> None:
    """The options of a verb, in their groups."""
    for title, members in sorted(_groups(verb).items(), key=lambda group: group[0] == _OUTPUT):
        group = parser.add_argument_group(title, _ABOUT.get(title)) if title else parser
        for one in members:
            _add_option(group, *one)


def _groups(verb: Verb) -> dict[str, list[tuple[str, str, Setting, object]]]:
    """The options of a verb by the titles of their groups: name in Python, key, declaration, value if not given."""
    groups: dict[str, list] = {}
    for title, tables in _GROUPS.items() if verb.without is not None else ():
        asked = ((option, *one) for option, one in SCENE_OPTIONS.items() if option not in verb.without)
        if found := [(as_name(option), key, one, None) for option, table, key, one in asked if table in tables]:
            groups[title] = found
    title = ""
    for key, declared in settings_of(verb.options).items():
        title = title if declared.group is None else declared.group
        groups.setdefault(title, []).append((key, key, declared, declared.default))
        if declared.group == _MOUNTING:
            groups[title] += [(key, key, one, None) for key, one in _COORDINATES.items()]
    return groups


# --- Options ----------------------------------------------------------------------------------------------


options = dataclass(eq=False, repr=False)
"""Makes a dataclass of options: neither compared nor shown, which would take longer to make than help to print."""


def option(usage: str, meaning: str, default: Any = None, **declared: Any) -> Any:
    """A field of a dataclass that is an option, or a place on the command line, of the verb that has the dataclass.

    Parameters
    ----------
    usage : str
        The option and what stands for its value: ``"--at X,Y"``, or that of a place alone.
    meaning : str
        Its help.
    default : object
        Its value where it is not given; ``...`` where it must be.
    **declared
        What else its `Setting` says.
    """
    name, *values = usage.split(" ")
    metavar = tuple(values) if len(values) > 1 else "".join(values)
    return setting(default, option=name, metavar=metavar, help=meaning, **declared)


def option_of(declared: type, key: str, **changes: Any) -> Any:
    """A field that is an option of another dataclass but for what changes."""
    one = settings_of(declared)[key]
    kept = {field.name: getattr(one, field.name) for field in fields(Setting) if field.name != "kind"}
    return setting(**kept | changes)


class _Given(argparse.Action):
    """Keeps what an option is given as it is declared; given again it is refused, unless it may be repeated."""

    def __init__(self, declared: Setting, *, repeated: bool, **how) -> None:
        super().__init__(**how)
        self._declared, self._repeated = declared, repeated

    def __call__(self, parser, namespace, values, option_string=None):
        if not self.option_strings and values is self.default:  # which argparse gives for a place left empty
            return
        given, declared = getattr(namespace, "given", ()), self._declared
        if declared.option in given and not self._repeated and self.nargs != 0:
            parser.error(f"argument {declared.option}: is given twice; allowed: once")
        if self.nargs == 0:
            value = True
        elif declared.read is not None:
            value = declared.read(values, declared.option)
        else:
            texts = [values] if self._repeated else values
            value = checked(_numbers_read(texts, declared.kind), declared, declared.option)
        if self._repeated and declared.option in given:
            value = (*getattr(namespace, self.dest), *value)
        setattr(namespace, self.dest, value)
        namespace.given = (*given, declared.option)


def _add_option(parser, name: str, key: str, declared: Setting, default: object) -> None:
    """The option of a setting, or a place on the command line; it must be given where `default` is ``...``."""
    parts, is_place = get_args(declared.kind), not declared.option.startswith("--")
    several = ... in parts and (is_place or isinstance(declared.metavar, tuple))
    how = {"declared": declared, "action": _Given, "default": None if default is ... else default}
    how["repeated"] = ... in parts and not several and declared.read is None
    if declared.kind is bool:
        how["nargs"] = 0
    elif several:
        how["nargs"] = "+"
    elif parts and ... not in parts and declared.read is None:
        how["nargs"] = len(parts)
    elif is_place and default is not ...:
        how["nargs"] = "?"
    if declared.allowed and not declared.metavar:
        how["choices"] = tuple(declared.allowed)
    elif declared.kind is not bool:
        how["metavar"] = declared.metavar or ("FILE" if declared.is_path else declared.option.lstrip("-").upper())
    how["help"] = _described(declared, key).replace("%", "%%")
    if is_place:
        parser.add_argument(name, **how | {"metavar": declared.option})
    else:
        parser.add_argument(declared.option, dest=name, required=default is ..., **how)


def _described(declared: Setting, key: str) -> str:
    """The help of a setting's option: what it is, its limits and unit in brackets, its default."""
    unit, default = _UNITS.get(key.rpartition("_")[2], ""), declared.default
    limits = limits_text(declared, declared.kind) if declared.kind in (int, float) and declared.read is None else ""
    amount = " ".join(part for part in (limits, unit) if part)
    allowed = (*declared.allowed, *([IN_A_FILE] if declared.plugins else []))
    names = ", ".join(allowed) if allowed and declared.metavar else ""
    text = declared.help + (f": {names}" if names else "") + (f" [{amount}]" if amount else "")
    if not (default is None or default is ... or default is False or default == ()):
        text += f" (default {default:g})" if isinstance(default, float) else f" (default {default})"
    return text


def _numbers_read(given, kind):
    """Texts as the numbers that they are, where numbers are asked for; the checks see to those that are none."""
    if isinstance(given, list):
        return [_numbers_read(one, get_args(kind)[0]) for one in given]
    try:
        return kind(given) if kind in (int, float) else given
    except ValueError:
        return given


def options_of(args: argparse.Namespace, declared: type) -> Any:
    """The options that a dataclass declares, as it holds them."""
    return declared(**{key: getattr(args, key) for key in settings_of(declared)})


def given_options(args: argparse.Namespace, keys: Collection[str]) -> dict[str, Any]:
    """The values of those options that are given, by their keys."""
    return {key: getattr(args, key) for key in keys if getattr(args, key) is not None}


def as_name(option: str) -> str:
    """An option of a scene's setting as Python writes it."""
    return option.lstrip("-").replace("-", "_")


# --- Options that are written in a way of their own -------------------------------------------------------


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


def parse_range(text: str, option: str, most: float) -> list[float]:
    """Numbers from "3,4.5,6" or "2:10:2", the end of a range included, or both mixed; each once, rising.

    Raises
    ------
    InputError
        When it is none of these, or a number is not above 0 up to `most`.
    """
    found: list[float] = []
    for part in text.split(","):
        try:
            first, *more = (float(number) for number in part.split(":"))
            last, step = (more or [first, 1.0]) if len(more) != 1 else (math.nan, 0.0)
            count = math.floor((last - first) / step + 1e-9) + 1 if step > 0.0 and math.isfinite(last - first) else 0
        except ValueError:
            count, first = 0, math.nan
        if not 1 <= count <= _MOST_IN_RANGE or not 0.0 < first <= last <= most:
            raise InputError(
                f"{option}: {part!r}; allowed: metres above 0 up to {most:g}, such as 3,4.5,6 or a range 2:10:2, not "
                f"more than {_MOST_IN_RANGE}"
            )
        found += [round(first + number * step, 6) for number in range(count)]
    return sorted(set(found))


def parse_place(text: str, option: str) -> tuple[float, float]:
    """Coordinates from "-5,3"."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != 2 or not all(map(math.isfinite, found)):
        raise InputError(f"{option}: is {text!r}; allowed: X,Y in the map's metres")
    return found


def parse_share(text: str, option: str) -> float:
    """A share from "1%" or "0.01"; above 0, at most 1."""
    number = text.strip()
    try:
        share = float(number.removesuffix("%")) / (100.0 if number.endswith("%") else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 < share <= 1.0:
        raise InputError(f"{option}: is {text!r}; allowed: a share above 0 up to 1, such as 1% or 0.01")
    return share


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


def _parse_errors(text: str, option: str, word: str, no_errors: object) -> Any:
    """Half-widths from "tilt_deg=1,height_m=0.05", or a word for no errors; the scene's checks see to the keys."""
    return no_errors if text == word else parse_pairs(text, option, f"tilt_deg=1,height_m=0.05, or {word}")


_READ = {
    "--installer": partial(_parse_errors, word="false", no_errors=False),
    "--pose-error": partial(_parse_errors, word="none", no_errors=None),
    "--frame-ids": parse_frames,
}
SCENE_OPTIONS: Mapping[str, tuple[str, str, Setting]] = {
    declared.option: (table, key, replace(declared, read=_READ.get(declared.option)))
    for table, settings in DECLARED.items()
    for key, declared in settings.items()
    if declared.option and (table not in ("deployment", "baseline", "lidar") or (table, key) == INSTALLER)
}
"""Table, key and declaration of each setting of a scene that an option replaces."""
