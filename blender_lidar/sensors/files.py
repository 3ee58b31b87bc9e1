"""Sensor files: a TOML per model or a CSV of beams, checked as they are read. Units are the files' own: degrees, us."""

from __future__ import annotations

import csv
import math
import reprlib
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args, get_origin

import numpy as np

from ..errors import InputError, MissingFileError, unknown_name
from ..files import read_file
from ..toml_table import Setting, setting, settings_of
from .imperfections import STATED_RANGE_LIMITS_M

SUFFIXES = (".toml", ".csv")
MAX_FILE_BYTES = 4_000_000
MAX_RINGS = 4096
MAX_BEAMS_PER_TURN = 10_000_000  # twenty times a 128-ring sensor at 5 Hz; directions alone would take 240 MB

_BEAM = {
    "ring": Setting(),
    "elevation_deg": Setting(low=-90.0, high=90.0),
    "azimuth_offset_deg": Setting(default=0.0, low=-180.0, high=180.0),
    "fire_offset_us": Setting(default=math.nan, low=0.0, high=1e6),  # NaN where it is not known, in a file too
}
BEAM_COLUMNS = tuple(_BEAM)
REQUIRED_COLUMNS = tuple(column for column, declared in _BEAM.items() if declared.default is ...)

Row = tuple[str, dict[str, float]]  # where the row stands (file:line or file:beams[i]), {column: value}


@dataclass(frozen=True, slots=True)
class SensorFile:
    """What a sensor file says, checked, in the file's units.

    Attributes
    ----------
    name, description, source, confidence : str
        `name` is the file's stem when the file gives none; the others may be empty.
    aliases : tuple of str
        Other names of the same sensor.
    rotation_hz : tuple of float
        Rotation rates the sensor has [Hz].
    default_rotation_hz : float
        One of them; when not given 10 if the sensor has it, else the first.
    block_time_us : float
        Time between firing columns [us].
    range_min_m, range_max_m, range_noise_m : float
        Range gate and standard deviation of the range noise [m].
    range_at_10_percent_m : float or None
        Farthest range at which a target of 10 % reflectivity is seen [m]; None when not given.
    beams : ndarray, (r, 4)
        Columns as in `BEAM_COLUMNS`, in ring order, which is from the lowest beam up. A column that is not given is 0
        for the azimuth offset and NaN (unknown) for the fire offset.
    """

    name: str = setting("")
    description: str = setting("")
    source: str = setting("")
    confidence: str = setting("")
    aliases: tuple[str, ...] = setting(())
    rotation_hz: tuple[float, ...] = setting((10.0,), low=0.01, high=1000.0)
    default_rotation_hz: float = setting(None, low=0.01, high=1000.0)
    block_time_us: float = setting(55.55, low=0.01, high=1e6)
    range_min_m: float = setting(0.4, low=0.0, high=1e5)
    range_max_m: float = setting(200.0, high=1e5)
    range_noise_m: float = setting(0.02, low=0.0, high=1e3)
    range_at_10_percent_m: float | None = setting(None, low=STATED_RANGE_LIMITS_M[0], high=STATED_RANGE_LIMITS_M[1])
    beams: np.ndarray


def read_sensor_file(path: Path) -> SensorFile:
    """Read and check a sensor's TOML, or a CSV of its beams (every other setting then takes its default).

    Raises
    ------
    MissingFileError
        The file is not there.
    InputError
        Anything else that is wrong with it, as ``file:key`` or ``file:line``.
    """
    text = _read_text(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: a sensor file ends in {' or '.join(SUFFIXES)}")
    if suffix == ".csv":
        return _checked({}, list(_csv_rows(text, path)), path)
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # a number of thousands of digits is a plain ValueError
        raise InputError(f"{path}: not valid TOML: {error}") from None
    keys = (*settings_of(SensorFile), "beams")
    for key in table:
        if key not in keys:
            raise unknown_name(key, keys, "key", f"{path}:{key}")
    return _checked(table, list(_toml_rows(table.get("beams"), path)), path)


def _read_text(path: Path) -> str:
    try:
        raw = read_file(path, MAX_FILE_BYTES + 1)
        size = len(raw) if len(raw) <= MAX_FILE_BYTES else path.stat().st_size
    except FileNotFoundError:
        raise MissingFileError(f"{path}: no such sensor file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: a folder, where a sensor file ({' or '.join(SUFFIXES)}) is needed") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    if size > MAX_FILE_BYTES:
        raise InputError(f"{path}: {size / 1e6:.1f} MB, where a sensor file has at most {MAX_FILE_BYTES / 1e6:g} MB")
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file in UTF-8 (byte {error.start})") from None
    if "\0" in text:
        raise InputError(f"{path}: not a text file (byte {text.index(chr(0))} is zero)")
    if not text.strip():
        raise InputError(f"{path}: empty, where a sensor file has at least its beams")
    return text


def _wrong_number(rings: int, path: Path) -> InputError:
    return InputError(f"{path}:beams: {rings} rings; allowed: 1 to {MAX_RINGS}")


def _check_most(rings: int, path: Path) -> None:
    """Refuse too many rings before any is read: a table of something else may have millions of rows."""
    if rings > MAX_RINGS:
        raise _wrong_number(rings, path)


def _csv_rows(text: str, path: Path) -> Iterator[Row]:
    lines = text.splitlines()
    _check_most(sum(1 for line in lines if line.strip(" \t,")) - 1, path)
    reader = csv.reader(lines)
    columns: list[str] = []
    try:
        for cells in reader:
            where = f"{path}:{reader.line_num}"
            cells = [cell.strip() for cell in cells]
            if not any(cells):
                continue
            if not columns:
                columns = _checked_header(cells, where)
                continue
            if len(cells) != len(columns):
                raise InputError(f"{where}: {len(cells)} values, where the header has {len(columns)}")
            yield where, {name: _parsed(cell, f"{where}: {name}") for name, cell in zip(columns, cells, strict=True)}
    except csv.Error as error:
        raise InputError(f"{path}:{reader.line_num}: not valid CSV: {error}") from None


def _checked_header(columns: list[str], where: str) -> list[str]:
    for name in columns:
        if name not in BEAM_COLUMNS:
            raise unknown_name(name, BEAM_COLUMNS, "column", where)
        if columns.count(name) > 1:
            raise InputError(f"{where}: column {name!r} is given twice")
    for name in REQUIRED_COLUMNS:
        if name not in columns:
            raise InputError(f"{where}: column {name!r} is missing; allowed: {', '.join(BEAM_COLUMNS)}")
    return columns


def _parsed(cell: str, where: str) -> float:
    try:
        if "_" in cell:  # "1_0" is 10 to Python alone
            raise ValueError(cell)
        return float(cell)
    except ValueError:
        raise InputError(f"{where}: {reprlib.repr(cell)} is not a number") from None


def _toml_rows(beams: object, path: Path) -> Iterator[Row]:
    layout = f"[{', '.join(BEAM_COLUMNS)}]"
    if not isinstance(beams, list):
        given = "missing" if beams is None else reprlib.repr(beams)
        raise InputError(f"{path}:beams: {given}, where a list of {layout} is needed")
    _check_most(len(beams), path)
    for index, row in enumerate(beams):
        where = f"{path}:beams[{index}]"
        if not isinstance(row, list) or not len(REQUIRED_COLUMNS) <= len(row) <= len(BEAM_COLUMNS):
            given = reprlib.repr(row)
            raise InputError(f"{where}: {given}, where {layout} is needed; the last two may be left out")
        yield where, {name: _number(value, f"{where}: {name}") for name, value in zip(BEAM_COLUMNS, row, strict=False)}


def _checked(table: Mapping[str, Any], rows: Sequence[Row], path: Path) -> SensorFile:
    """The file's settings, each as declared, and what they must be to one another."""
    found = {}
    for key, one in settings_of(SensorFile).items():
        if key == "range_max_m":
            one = replace(one, low=math.nextafter(found["range_min_m"], math.inf))
        given = table.get(key, one.default)
        found[key] = None if given is None else _value(given, one, f"{path}:{key}")
    found["name"] = found["name"] or path.stem
    rates, default = found["rotation_hz"], found["default_rotation_hz"]
    if not rates:
        raise InputError(f"{path}:rotation_hz: [], where at least one rate is needed")
    if default is None:
        found["default_rotation_hz"] = 10.0 if 10.0 in rates else rates[0]
    elif default not in rates:
        allowed = ", ".join(f"{rate:g}" for rate in rates)
        raise InputError(f"{path}:default_rotation_hz: {default:g} is not in rotation_hz = {allowed}")
    beams = _checked_beams(rows, path)
    _check_turn(rates, found["block_time_us"], len(beams), path)
    return SensorFile(**found, beams=beams)


def _check_turn(rates: Sequence[float], block_time_us: float, rings: int, path: Path) -> None:
    for rate in rates:
        columns = round(1e6 / (rate * block_time_us))
        if not 1 <= columns <= MAX_BEAMS_PER_TURN // rings:
            raise InputError(
                f"{path}:block_time_us: {block_time_us:g} us at {rate:g} Hz make {columns} columns of {rings} beams a "
                f"turn; allowed: 1 column to {MAX_BEAMS_PER_TURN} beams"
            )


def _checked_beams(rows: Sequence[Row], path: Path) -> np.ndarray:
    """The beams (r, 4) in ring order, which must be that of their elevations."""
    count = len(rows)
    if not count:
        raise _wrong_number(count, path)
    beams = np.empty((count, len(BEAM_COLUMNS)))
    places: dict[int, str] = {}
    for where, row in rows:
        ring = row["ring"]
        if not (0 <= ring < count and ring == int(ring)):
            raise InputError(
                f"{where}: ring is {ring:g}; {count} rings are numbered 0 (lowest) to {count - 1}, none left out"
            )
        if ring in places:
            raise InputError(f"{where}: ring {ring:g} is given twice, first at {places[ring]}")
        places[int(ring)] = where
        beams[int(ring)] = [_within_limits(row.get(key, _BEAM[key].default), key, where) for key in BEAM_COLUMNS]
    # As many different rings as there are rows, each below their number: none is missing.
    falls = np.flatnonzero(np.diff(beams[:, 1]) < 0.0)
    if len(falls):
        below = int(falls[0])
        raise InputError(
            f"{places[below + 1]}: ring {below + 1} at {beams[below + 1, 1]:g} degrees lies below ring {below} at "
            f"{beams[below, 1]:g}; rings are numbered from the lowest beam up"
        )
    return beams


def _within_limits(value: float, column: str, where: str) -> float:
    unknown = column == "fire_offset_us" and math.isnan(value)
    return value if unknown else _limited(value, _BEAM[column], f"{where}: {column}")


def _value(value: object, declared: Setting, where: str) -> Any:
    """A text, a number or a list of either, as its setting declares it."""
    if get_origin(declared.kind) is tuple:
        if not isinstance(value, list | tuple):
            raise InputError(f"{where}: {reprlib.repr(value)} is not a list")
        one = replace(declared, kind=get_args(declared.kind)[0])
        return tuple(_value(entry, one, where) for entry in value)
    if declared.kind is not str:
        return _limited(_number(value, where), declared, where)
    if not isinstance(value, str):
        raise InputError(f"{where}: {reprlib.repr(value)} is not text")
    return " ".join(value.split())  # one line, however the file wraps it


def _number(value: object, where: str) -> float:
    # To Python a bool is an int.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {reprlib.repr(value)} is not a number")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {reprlib.repr(value)} is too large a number") from None


def _limited(value: float, declared: Setting, where: str) -> float:
    if not declared.low <= value <= declared.high:  # NaN fails too
        raise InputError(f"{where} is {value:g}; allowed: {declared.low:g} to {declared.high:g}")
    return value
