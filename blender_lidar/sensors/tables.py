"""Beam tables as people and makers write them: CSV of many layouts, Ouster's metadata, Velodyne's calibration.

Azimuth offsets are turned into ours, clockwise seen from above: Ouster's, Hesai's and RoboSense's are; Velodyne's
rot_correction is taken from the encoder's clockwise angle (velodyne_pointcloud, rawdata.cc).
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..csv_header import column_meant, fields_of, first_lines
from ..errors import InputError, MissingExtraError, unknown_name
from ..files import number, read_text, reading

Row = tuple[str, dict[str, object]]
"""Where a beam stands (``file:line`` or ``file:beams[i]``), and its values by the names of the columns."""

COLUMNS = ("ring", "elevation_deg", "azimuth_offset_deg", "fire_offset_us")
_WORDS = {
    "zenith_deg": {"zenith"},
    "elevation_deg": {"elevation", "elev", "vertical", "vert", "altitude", "pitch"},
    "fire_offset_us": {"fire", "firing", "firetime"},
    "azimuth_offset_deg": {"azimuth", "azi", "horizontal", "horiz", "rot", "rotational"},
    "time": {"time", "timestamp"},
    "ring": {"ring", "laser", "channel", "beam", "line", "id", "laserid", "index", "no"},
}  # the first that has a word of a column's name is meant
_DEGREES = {"rad": math.degrees(1.0), "mrad": math.degrees(1e-3), "mdeg": 1e-3}
_UNITS = {"rad": "rad", "radian": "rad", "radians": "rad", "mrad": "mrad", "milliradians": "mrad", "mdeg": "mdeg"}
_PLAUSIBLE_DEG = (8.0, 125.0)  # between the elevations of a sensor's lowest and highest beam
_FEW = 4  # beams, of which a fan may be anything
_MANY_UP = 0.6
_PLAUSIBLE_OFFSET_DEG = (0.5, 15.0)


def read_beam_table(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Settings of a `Datasheet` that a file of beams gives, and its rows, by its suffix.

    Raises
    ------
    InputError
        When it cannot be read as what its suffix says, or has no elevations.
    MissingExtraError
        For YAML without PyYAML.
    """
    reader = {".json": _ouster, ".yaml": _velodyne, ".yml": _velodyne}.get(path.suffix.lower(), _table)
    with reading(path, "a table of beams"):
        settings, rows = reader(path)
    if rows and not any("elevation_deg" in row for _, row in rows):
        raise InputError(f"{rows[0][0]}: has no elevations, which a table of beams needs: {', '.join(COLUMNS)}")
    return settings, rows


# --- CSV: with or without a header, of any separator; RoboSense's angle.csv and Hesai's correction files are such -


def _table(path: Path) -> tuple[dict[str, Any], list[Row]]:
    lines = [(number, line) for number, line in first_lines(path) if not line.startswith("EEFF")]  # Hesai's first line
    separator = next((one for one in ";\t," if lines and one in lines[0][1]), None)
    cells = [(f"{path}:{number}", fields_of(line, separator)) for number, line in lines]
    cells = [(where, [_parsed(cell, separator != ",") for cell in row]) for where, row in cells]
    if not cells:
        return {}, []
    where, head = cells[0]
    if all(isinstance(cell, float) for cell in head):
        columns = _without_header(where, [row for _, row in cells])
    else:
        columns, cells = _columns(where, list(map(str, head))), cells[1:]
    rows = []
    for where, row in cells:
        if len(row) != len(columns):
            raise InputError(f"{where}: {len(row)} values, where the header has {len(columns)}")
        rows.append((where, dict(_value(*pair) for pair in zip(columns, row, strict=True) if pair[0])))
    return {}, rows


def _parsed(cell: str, decimal_comma: bool) -> float | str:
    """A cell as a number; what is none stays a text, for the check of its column to show."""
    value = number(cell.replace(",", ".") if decimal_comma else cell)
    return cell if math.isnan(value) else value


def _without_header(where: str, rows: list[list[float | str]]) -> list[str]:
    """The columns of a table of numbers alone: elevations, then azimuth offsets, after numbers of the rings if any."""
    width, first = len(rows[0]), [row[0] for row in rows]
    counts = first in ([*range(len(rows))], [*range(1, len(rows) + 1)])
    if width > 1 and counts and len(rows) > 1:
        return list(COLUMNS[:width]) if width <= len(COLUMNS) else []
    if width <= 2:  # as RoboSense's angle.csv
        return list(COLUMNS[1 : 1 + width])
    raise InputError(f"{where}: {width} columns without a header; allowed: a header with {', '.join(COLUMNS)}")


def _columns(where: str, names: list[str]) -> list[str]:
    """Of each column the key that is meant, with its unit behind it, or "" where it is left out."""
    meant = []
    for name in names:
        words, key = re.findall("[a-z]+", name.lower()), column_meant(name, _WORDS)
        if key is None and words:
            raise unknown_name(name, COLUMNS, "column", where)
        unit = next((_UNITS[word] for word in words if word in _UNITS), "")
        meant.append(f"{key or ''} {unit}".strip())
    if "time" in meant:
        raise InputError(
            f"{where}: is a scan pattern over time; allowed: rings of a sensor that turns, with {', '.join(COLUMNS)}"
        )
    numbers = [at for at, key in enumerate(meant) if key == "ring"]
    named = next((at for at in numbers if "ring" in names[at].lower()), next(iter(numbers), None))
    meant = ["" if at in numbers and at != named else key for at, key in enumerate(meant)]
    for at, key in enumerate(meant):
        if (key and meant.index(key) < at) or (names[at] and names[at] in names[:at]):
            raise InputError(f"{where}: column {names[at]!r} is given twice")
    return meant


def _value(column: str, value: float | str) -> tuple[str, float | str]:
    key, _, unit = column.partition(" ")
    if isinstance(value, float):
        value *= _DEGREES.get(unit, 1.0)
        value = 90.0 - value if key == "zenith_deg" else value
    return ("elevation_deg" if key == "zenith_deg" else key), value


# --- Makers' own formats ----------------------------------------------------------------------------------------------


def _ouster(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Ouster's metadata, of firmware 1 and 2 (all keys at the top) or later (in groups)."""
    try:
        table = json.loads(read_text(path).removeprefix("\ufeff"))
        groups = dict(table)
        for group in table.values():
            groups |= group if isinstance(group, dict) else {}
        angles = groups["beam_altitude_angles"], groups["beam_azimuth_angles"]
        rows = list(zip(*(np.array(one, dtype=float).reshape(-1).tolist() for one in angles), strict=True))
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise InputError(
            f"{path}: is no metadata of an Ouster, with beam_altitude_angles and beam_azimuth_angles ({error})"
        ) from None
    settings: dict[str, Any] = {"name": str(groups.get("prod_line", "")), "source": "its metadata"}
    mode = re.fullmatch(r"(\d+)x(\d+)", str(groups.get("lidar_mode", "")))
    columns = groups.get("columns_per_frame") or (mode and int(mode[1]))
    if columns and mode:
        settings |= {"columns_a_turn": [int(columns)], "rotation_hz": [float(mode[2])]}
        settings["block_time_us"] = 1e6 / (int(columns) * float(mode[2]))
    return settings, [(f"{path}:beams[{at}]", dict(zip(COLUMNS[1:3], row, strict=True))) for at, row in enumerate(rows)]


def _velodyne(path: Path) -> tuple[dict[str, Any], list[Row]]:
    """Velodyne's calibration as velodyne_pointcloud has it: radians, in the order of the lasers."""
    try:
        import yaml
    except ImportError:
        raise MissingExtraError(f'{path}: needs PyYAML: pip install "blender_lidar[formats]"') from None
    try:
        lasers = yaml.safe_load(read_text(path))["lasers"]
        angles = [(laser["vert_correction"], -laser["rot_correction"]) for laser in lasers]
        rows = [[math.degrees(angle) + 0.0 for angle in pair] for pair in angles]
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        what = str(error).splitlines()[0]
        raise InputError(
            f"{path}: is no calibration of a Velodyne, with lasers, vert_correction and rot_correction ({what})"
        ) from None
    return {}, [(f"{path}:lasers[{at}]", dict(zip(COLUMNS[1:3], row, strict=True))) for at, row in enumerate(rows)]


# --- What cannot be degrees -------------------------------------------------------------------------------------------


def check_degrees(path: Path, elevation: np.ndarray) -> None:
    """Refuse elevations (r,) in another unit than degrees, or counted from the zenith.

    Raises
    ------
    InputError
        Naming the unit in which they would be those of a sensor.
    """
    low, high = float(elevation.min()), float(elevation.max())
    if len(elevation) < _FEW:
        return
    if low < 90.0 < high <= 180.0 and low >= 0.0:
        raise InputError(
            f"{path}: elevations from {low:g} to {high:g} degrees are counted from the zenith; allowed: degrees above "
            "the horizontal, or a column zenith_deg"
        )
    units = {"radians": _DEGREES["rad"]} if high - low < 3.2 else {}
    if max(-low, high) > 90.0:
        units = {"millidegrees": 1e-3, "hundredths of a degree": 1e-2, "milliradians": _DEGREES["mrad"]}
    for unit, degrees in units.items():
        if _PLAUSIBLE_DEG[0] <= (high - low) * degrees <= _PLAUSIBLE_DEG[1]:
            raise InputError(
                f"{path}: elevations from {low:g} to {high:g} are no degrees of a sensor; in {unit} they are "
                f"{low * degrees:.4g} to {high * degrees:.4g} degrees: give degrees, or say the unit in the column's "
                "name (elevation_rad, elevation_mrad)"
            )


def notes_on(elevation: np.ndarray, azimuth_offset: np.ndarray) -> list[str]:
    """What is unusual about elevations and azimuth offsets, (r,) each [degrees], and may be meant otherwise."""
    notes, up, most = [], int((elevation > 0.0).sum()), float(np.abs(azimuth_offset).max(initial=0.0))
    if len(elevation) >= _FEW and up > _MANY_UP * len(elevation):
        notes.append(f"{up} of {len(elevation)} beams look up: are the signs turned?")
    if _PLAUSIBLE_OFFSET_DEG[0] <= math.degrees(most) <= _PLAUSIBLE_OFFSET_DEG[1]:
        notes.append(
            f"azimuth offsets of at most {most:.3g} degrees: in radians they would be {math.degrees(most):.2g}"
        )
    return notes
