"""Sensor files: a TOML per model or a CSV of beams, checked as they are read. Units are the files' own: degrees, us."""

from __future__ import annotations

import csv
import math
import reprlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, MissingFileError, unknown_name
from ..input_file import read_file
from ..toml_table import parse_toml
from .detection_range import STATED_RANGE_LIMITS_M

SUFFIXES = (".toml", ".csv")
MAX_FILE_BYTES = 4_000_000
MAX_RINGS = 4096
MAX_BEAMS_PER_TURN = 10_000_000  # twenty times a 128-ring sensor at 5 Hz; directions alone would take 240 MB

REQUIRED_COLUMNS = ("ring", "elevation_deg")
BEAM_COLUMNS = (*REQUIRED_COLUMNS, "azimuth_offset_deg", "fire_offset_us")
_TEXT_KEYS = ("name", "description", "source", "confidence")
_NUMBER_DEFAULTS = {"block_time_us": 55.55, "range_min_m": 0.4, "range_max_m": 200.0, "range_noise_m": 0.02}
_KEYS = (
    *_TEXT_KEYS,
    "aliases",
    "rotation_hz",
    "default_rotation_hz",
    *_NUMBER_DEFAULTS,
    "range_at_10_percent_m",
    "beams",
)

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
        Rotation rates the sensor has [Hz]; 10 when the file gives none.
    default_rotation_hz : float
        One of them; when not given 10 if the sensor has it, else the first.
    block_time_us : float
        Time between firing columns [us]; 55.55 when not given.
    range_min_m, range_max_m, range_noise_m : float
        Range gate and standard deviation of the range noise [m]; 0.4, 200 and 0.02 when not given.
    range_at_10_percent_m : float or None
        Farthest range at which a target of 10 % reflectivity is seen [m]; None when not given.
    beams : ndarray, (r, 4)
        Columns as in `BEAM_COLUMNS`, in ring order, which is from the lowest beam up. A column that is not given is 0
        for the azimuth offset and NaN (unknown) for the fire offset.
    """

    name: str
    description: str
    source: str
    confidence: str
    aliases: tuple[str, ...]
    rotation_hz: tuple[float, ...]
    default_rotation_hz: float
    block_time_us: float
    range_min_m: float
    range_max_m: float
    range_noise_m: float
    range_at_10_percent_m: float | None
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
        table = parse_toml(text)
    except (ValueError, RecursionError) as error:  # a number of thousands of digits is a plain ValueError
        raise InputError(f"{path}: not valid TOML: {error}") from None
    for key in table:
        if key not in _KEYS:
            raise unknown_name(key, _KEYS, "key", f"{path}:{key}")
    return _checked(table, list(_toml_rows(table, path)), path)


def _wrong_number(rings: int, path: Path) -> InputError:
    return InputError(f"{path}:beams: {rings} rings; allowed: 1 to {MAX_RINGS}")


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


def _csv_rows(text: str, path: Path) -> Iterator[Row]:
    lines = text.splitlines()
    rings = sum(1 for line in lines if line.strip(" \t,")) - 1
    if rings > MAX_RINGS:
        raise _wrong_number(rings, path)
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


def _toml_rows(table: dict[str, Any], path: Path) -> Iterator[Row]:
    layout = f"[{', '.join(BEAM_COLUMNS)}]"
    beams = table.get("beams")
    if not isinstance(beams, list):
        raise InputError(f"{path}:beams: {_given(beams)}, where a list of {layout} is needed")
    if len(beams) > MAX_RINGS:
        raise _wrong_number(len(beams), path)
    for index, row in enumerate(beams):
        where = f"{path}:beams[{index}]"
        if not isinstance(row, list) or not len(REQUIRED_COLUMNS) <= len(row) <= len(BEAM_COLUMNS):
            raise InputError(f"{where}: {_given(row)}, where {layout} is needed; the last two may be left out")
        yield where, {name: _number(value, f"{where}: {name}") for name, value in zip(BEAM_COLUMNS, row, strict=False)}


def _checked(table: dict[str, Any], rows: Sequence[Row], path: Path) -> SensorFile:
    texts = {key: _text(table.get(key, ""), f"{path}:{key}") for key in _TEXT_KEYS}
    texts["name"] = texts["name"] or path.stem
    aliases = [_text(alias, f"{path}:aliases") for alias in _list(table.get("aliases", []), f"{path}:aliases")]
    numbers = {key: _number(table.get(key, value), f"{path}:{key}") for key, value in _NUMBER_DEFAULTS.items()}
    _check_between(numbers["block_time_us"], 0.01, 1e6, f"{path}:block_time_us")
    _check_between(numbers["range_min_m"], 0.0, 1e5, f"{path}:range_min_m")
    _check_between(numbers["range_max_m"], math.nextafter(numbers["range_min_m"], math.inf), 1e5, f"{path}:range_max_m")
    _check_between(numbers["range_noise_m"], 0.0, 1e3, f"{path}:range_noise_m")
    at_10_percent = table.get("range_at_10_percent_m")
    if at_10_percent is not None:
        at_10_percent = _number(at_10_percent, f"{path}:range_at_10_percent_m")
        _check_between(at_10_percent, *STATED_RANGE_LIMITS_M, f"{path}:range_at_10_percent_m")
    rates, default_rate = _rotation(table, path)
    beams = _checked_beams(rows, path)
    _check_turn(rates, numbers["block_time_us"], len(beams), path)
    return SensorFile(
        **texts,
        aliases=tuple(aliases),
        rotation_hz=rates,
        default_rotation_hz=default_rate,
        **numbers,
        range_at_10_percent_m=at_10_percent,
        beams=beams,
    )


def _rotation(table: dict[str, Any], path: Path) -> tuple[tuple[float, ...], float]:
    where = f"{path}:rotation_hz"
    rates = tuple(_number(rate, where) for rate in _list(table.get("rotation_hz", [10.0]), where))
    if not rates:
        raise InputError(f"{where}: [], where at least one rate is needed")
    for rate in rates:
        _check_between(rate, 0.01, 1000.0, where)
    where = f"{path}:default_rotation_hz"
    default = _number(table.get("default_rotation_hz", 10.0 if 10.0 in rates else rates[0]), where)
    if default not in rates:
        raise InputError(f"{where}: {default:g} is not in rotation_hz = {', '.join(f'{rate:g}' for rate in rates)}")
    return rates, default


def _check_turn(rates: Sequence[float], block_time_us: float, rings: int, path: Path) -> None:
    for rate in rates:
        columns = round(1e6 / (rate * block_time_us))
        if not 1 <= columns <= MAX_BEAMS_PER_TURN // rings:
            raise InputError(
                f"{path}:block_time_us: {block_time_us:g} us at {rate:g} Hz make {columns} columns of {rings} beams a "
                f"turn; allowed: 1 column to {MAX_BEAMS_PER_TURN} beams"
            )


def _checked_beams(rows: Sequence[Row], path: Path) -> np.ndarray:
    count = len(rows)
    if not 1 <= count <= MAX_RINGS:
        raise _wrong_number(count, path)
    beams: dict[int, list[float]] = {}
    places: dict[int, str] = {}
    for where, row in rows:
        ring = _checked_ring(row["ring"], count, where)
        if ring in places:
            raise InputError(f"{where}: ring {ring} is given twice, first at {places[ring]}")
        places[ring] = where
        beams[ring] = [float(ring), *_checked_angles(row, where)]
    # As many different rings as there are rows, each below their number: none is missing.
    for ring in range(1, count):
        below, here = beams[ring - 1][1], beams[ring][1]
        if here < below:
            raise InputError(
                f"{places[ring]}: ring {ring} at {here:g} degrees lies below ring {ring - 1} at {below:g}; "
                "rings are numbered from the lowest beam up"
            )
    return np.array([beams[ring] for ring in range(count)])


def _checked_ring(value: float, count: int, where: str) -> int:
    if not (0 <= value < count and value == int(value)):
        raise InputError(
            f"{where}: ring is {value:g}; {count} rings are numbered 0 (lowest) to {count - 1}, none left out"
        )
    return int(value)


def _checked_angles(row: dict[str, float], where: str) -> tuple[float, float, float]:
    elevation, azimuth = row["elevation_deg"], row.get("azimuth_offset_deg", 0.0)
    fire = row.get("fire_offset_us", math.nan)
    _check_between(elevation, -90.0, 90.0, f"{where}: elevation_deg")
    _check_between(azimuth, -180.0, 180.0, f"{where}: azimuth_offset_deg")
    if not math.isnan(fire):  # not known
        _check_between(fire, 0.0, 1e6, f"{where}: fire_offset_us")
    return elevation, azimuth, fire


def _check_between(value: float, low: float, high: float, where: str) -> None:
    if not low <= value <= high:  # NaN fails too
        raise InputError(f"{where} is {value:g}; allowed: {low:g} to {high:g}")


def _given(value: object) -> str:
    return "missing" if value is None else reprlib.repr(value)


def _list(value: object, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{where}: {_given(value)} is not a list")
    return value


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        raise InputError(f"{where}: {_given(value)} is not text")
    return " ".join(value.split())  # one line, however the file wraps it


def _parsed(cell: str, where: str) -> float:
    try:
        if "_" in cell:  # "1_0" is 10 to Python alone
            raise ValueError(cell)
        return float(cell)
    except ValueError:
        raise InputError(f"{where}: {_given(cell)} is not a number") from None


def _number(value: object, where: str) -> float:
    # To Python a bool is an int.
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{where}: {_given(value)} is not a number")
    try:
        return float(value)
    except OverflowError:
        raise InputError(f"{where}: {_given(value)} is too large a number") from None
