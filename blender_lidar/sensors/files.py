"""Sensor files: a TOML per model or a CSV of beams, checked as they are read. Units are the files' own: degrees, us."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError, shown
from ..names import SENSOR_SUFFIXES, STATED_RANGE_LIMITS_M
from ..toml_table import Setting, TomlTable, read_toml, setting, settings_of
from .tables import Row, check_degrees, notes_on, read_beam_table

MAX_RINGS = 4096
_MOST_BEAMS_PER_TURN = 10_000_000  # twenty times a 128-ring sensor at 5 Hz; directions alone would take 240 MB

_BEAM = {
    "ring": Setting(),
    "elevation_deg": Setting(low=-90.0, high=90.0),
    "azimuth_offset_deg": Setting(default=0.0, low=-180.0, high=180.0),
    "fire_offset_us": Setting(default=math.nan, low=0.0, high=1e6),  # NaN where it is not known, in a file too
}
_LAYOUT = f"[{', '.join(_BEAM)}]"

ASSUMED = ("rotation_hz", "block_time_us", "range_min_m", "range_max_m", "range_noise_m", *list(_BEAM)[2:])
"""Keys of which something is assumed where a file leaves them out."""


@dataclass(frozen=True, slots=True)
class Datasheet:
    """A sensor's datasheet: what its file says beside the beams, and what is taken where it does not, in its units.

    Attributes
    ----------
    name, description, source, confidence : str
        What it is (the file's stem if it gives no name), where the numbers come from, and how far to trust them.
    aliases : tuple of str
        Other names of the same sensor.
    rotation_hz : tuple of float
        Rotation rates the sensor has [Hz].
    default_rotation_hz : float
        The one used when none is asked for; when not given 10 if the sensor has it, else the first.
    block_time_us : float
        Time between firing columns [us]; the shortest one where their number is chosen.
    columns_a_turn : tuple of int
        Numbers of columns that the sensor may be set to; none where rate and block time make the number.
    default_columns : int or None
        The one used when none is asked for; when not given the first.
    range_min_m, range_max_m : float
        Distances that the sensor reports [m].
    range_noise_m : float
        Standard deviation of a measured range [m].
    range_at_10_percent_m : float or None
        Farthest range at which it sees a target of 10 % reflectivity [m]; None where no source gives it.
    azimuth_deg : (float, float) or None
        Horizontal field of view, clockwise from zero azimuth seen from above [degrees]; None for a full turn.
    assumed : tuple of str
        Keys that its file leaves out and of which something is assumed; those of its beams too.
    notes : tuple of str
        What reading its file has changed, or found unusual.
    """

    name: str = setting("")
    description: str = setting("")
    source: str = setting("")
    confidence: str = setting("")
    aliases: tuple[str, ...] = setting(())
    rotation_hz: tuple[float, ...] = setting((10.0,), low=0.01, high=1000.0)
    default_rotation_hz: float = setting(None)
    block_time_us: float = setting(55.55, low=0.01, high=1e6)
    columns_a_turn: tuple[int, ...] = setting((), low=1, high=10_000_000)
    default_columns: int | None = setting(None, low=1)
    range_min_m: float = setting(0.4, low=0.0, high=1e5)
    range_max_m: float = setting(200.0, high=1e5)
    range_noise_m: float = setting(0.02, low=0.0, high=1e3)
    range_at_10_percent_m: float | None = setting(None, low=STATED_RANGE_LIMITS_M[0], high=STATED_RANGE_LIMITS_M[1])
    azimuth_deg: tuple[float, float] | None = setting(None, low=-360.0, high=360.0)
    assumed: tuple[str, ...] = field(default=(), kw_only=True)
    notes: tuple[str, ...] = field(default=(), kw_only=True)


def read_sensor_file(path: Path) -> tuple[dict[str, Any], np.ndarray]:
    """Read and check a sensor's TOML, or a table of its beams (what that does not say then takes its default).

    Returns
    -------
    settings : dict
        Values by the names of `Datasheet`.
    beams : ndarray, (r, 4)
        Ring, elevation [degrees], azimuth offset [degrees] and fire offset [us; NaN where not known], in ring order,
        which is from the lowest beam up.

    Raises
    ------
    MissingFileError
        The file is not there.
    InputError
        Anything else that is wrong with it, as ``file:key`` or ``file:line``.
    """
    suffix = path.suffix.lower()
    if suffix not in SENSOR_SUFFIXES:
        raise InputError(f"{path}: a sensor file ends in {', '.join(SENSOR_SUFFIXES)}")
    if suffix == ".toml":
        settings = _checked_settings(read_toml(path), path)
        rows = _toml_rows(settings.pop("beams"), path)
    else:
        given, rows = read_beam_table(path)
        settings = _checked_settings(given, path)
        del settings["beams"]
    given = {key for _, row in rows for key in row}
    settings["assumed"] += tuple(key for key in ("azimuth_offset_deg", "fire_offset_us") if key not in given)
    beams, settings["notes"] = _checked_beams(rows, path)
    for rate in settings["rotation_hz"]:
        columns = max(settings["columns_a_turn"], default=round(1e6 / (rate * settings["block_time_us"])))
        if not 1 <= columns <= _MOST_BEAMS_PER_TURN // len(beams):
            raise InputError(
                f"{path}:block_time_us: {settings['block_time_us']:g} us at {rate:g} Hz make {columns} columns of "
                f"{len(beams)} beams a turn; allowed: 1 column to {_MOST_BEAMS_PER_TURN} beams"
            )
    return settings, beams


def _checked_settings(table: dict[str, Any], path: Path) -> dict[str, Any]:
    """The file's settings and the rows of its beams, each as declared, and what they must be to one another."""
    given = {key: value for key, value in table.items() if value not in ("", [])}
    values = TomlTable(given, str(path), origins={key: f"{path}:{key}" for key in given})
    found = values.read({**settings_of(Datasheet), "beams": Setting(kind=list, default=())})
    found = {key: " ".join(value.split()) if isinstance(value, str) else value for key, value in found.items()}
    found["name"] = found["name"] or path.stem
    low, high = found["range_min_m"], found["range_max_m"]
    if not low < high:
        raise InputError(f"{path}:range_max_m: is {high:g}; allowed: more than range_min_m, {low:g}")
    sector = found["azimuth_deg"]
    if sector and not 0.0 < sector[1] - sector[0] <= 360.0:
        raise InputError(f"{path}:azimuth_deg: is {list(sector)}; allowed: [from, to] clockwise, such as [-60, 60]")
    rates, default = found["rotation_hz"], found["default_rotation_hz"]
    if default is None:
        found["default_rotation_hz"] = 10.0 if 10.0 in rates else rates[0]
    elif default not in rates:
        allowed = ", ".join(f"{rate:g}" for rate in rates)
        raise InputError(f"{path}:default_rotation_hz: is {default:g}; allowed: one of rotation_hz, {allowed}")
    for columns in found["columns_a_turn"]:
        if not rates_with(columns, rates, found["block_time_us"]):
            raise InputError(
                f"{path}:columns_a_turn: {columns} columns a turn need less than block_time_us, "
                f"{found['block_time_us']:g}, between two at any rate; allowed: at most "
                f"{math.floor(1e6 / (min(rates) * found['block_time_us']))}"
            )
    if found["default_columns"] is None and found["columns_a_turn"]:
        found["default_columns"] = found["columns_a_turn"][0]
    elif found["default_columns"] not in (found["columns_a_turn"] or [None]):
        allowed = ", ".join(map(str, found["columns_a_turn"])) or "none without columns_a_turn"
        raise InputError(f"{path}:default_columns: is {found['default_columns']}; allowed: {allowed}")
    found["assumed"] = tuple(key for key in ASSUMED if key in settings_of(Datasheet) and key not in given)
    return found


def rates_with(columns: int, rates: tuple[float, ...], block_time_us: float) -> tuple[float, ...]:
    """Rotation rates [Hz] at which so many columns a turn lie no less than the block time apart."""
    return tuple(rate for rate in rates if rate * columns * block_time_us <= 1e6 * (1.0 + 1e-9))


def _toml_rows(beams: list, path: Path) -> list[Row]:
    for row in beams:
        if not isinstance(row, list) or len(row) > len(_BEAM):
            raise InputError(f"{path}:beams: {shown(row)}, where {_LAYOUT} is needed; the last two may be left out")
    return [(f"{path}:beams[{at}]", dict(zip(_BEAM, row, strict=False))) for at, row in enumerate(beams)]


def _checked_beams(rows: list[Row], path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """The beams (r, 4), numbered from the lowest one up, and what is noted of them."""
    count = len(rows)
    if not 1 <= count <= MAX_RINGS:
        raise InputError(f"{path}:beams: {count} rings; allowed: 1 to {MAX_RINGS}")
    for _, row in rows:
        if str(row.get("fire_offset_us")).lower() == "nan":
            del row["fire_offset_us"]
    elevation = [row.get("elevation_deg") for _, row in rows]
    if all(isinstance(one, float | int) for one in elevation):
        check_degrees(path, np.array(elevation, dtype=float))
    numbered = any("ring" in row for _, row in rows)
    if not numbered:
        rows = [(where, {"ring": place, **row}) for place, (where, row) in enumerate(rows)]
    found = [(where, [*TomlTable(row, where).read(_BEAM).values()]) for where, row in rows]
    found.sort(key=lambda beam: beam[1][0])
    first = 1 if found[0][1][0] == 1 else 0
    for place, (where, (ring, *_)) in enumerate(found, start=first):
        if ring != place:
            raise InputError(f"{where}: ring is {ring:g}; {count} rings are numbered 0 to {count - 1}, each once")
    beams = np.array([beam for _, beam in found])
    order = np.argsort(beams[:, 1], kind="stable")
    sorted_ = numbered and (first or (np.diff(order) < 0).any())
    notes = ["rings are numbered again, from the lowest beam up"] if sorted_ else []
    beams = beams[order]
    beams[:, 0] = np.arange(count)
    return beams, (*notes, *notes_on(beams[:, 1], beams[:, 2]))
