"""Candidate places: a table of poles, each of which is searched and all of which are judged on the same traffic."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError, shown
from ..traffic.source import Column, TableLayout, delimiter_of, fields_of, first_lines, known_names, read_rows
from .deployment import COORDINATE_LIMITS, Pole

_NEEDED = ("name", "x_m", "y_m")
_OPTIONAL = ("foot_z_m", "height_min_m", "height_max_m", "cost", "existing", "facing_deg")
_PLACE = Column("a number, -100000 to 100000", *COORDINATE_LIMITS["x_m"])
_HEIGHT = Column("0 to 100", 0.0, 100.0, optional=True)
_NUMBERS = {
    "x_m": _PLACE,
    "y_m": _PLACE,
    "foot_z_m": Column("-100 to 100", -100.0, 100.0, optional=True),
    "height_min_m": _HEIGHT,
    "height_max_m": _HEIGHT,
    "cost": Column("a number", optional=True),
    "facing_deg": Column("-360 to 360", -360.0, 360.0, optional=True),
}
_EXISTS = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False, "": None}
_MOST = 1000
_NEAREST_M = 0.05


def read_poles(path: str | Path) -> tuple[Pole, ...]:
    """Read a table of candidate poles, with a header: name, x_m and y_m, and further columns as far as there are any.

    Raises
    ------
    MissingFileError, InputError
        When the file cannot be used; the text names the line and the column.
    """
    line, header = first_lines(path)[0]
    known = (*_NEEDED, *_OPTIONAL)
    delimiter = delimiter_of(header, known)
    layout = TableLayout(known_names(fields_of(header, delimiter), known), delimiter, line + 1)
    layout.check(_NEEDED, _OPTIONAL, f"{path}:{line}")
    poles: dict[str, Pole] = {}
    for rows in read_rows(path, layout, _NUMBERS, ["name", "existing"]):
        numbers = {key: rows.numbers(key, column).tolist() for key, column in _NUMBERS.items() if key in rows.columns}
        texts = {key: rows.columns[key].tolist() for key in ("name", "existing") if key in rows.columns}
        for row in range(len(rows)):
            where = rows.where(row)
            values = {key: None if np.isnan(column[row]) else column[row] for key, column in numbers.items()}
            pole = _pole(where, values, {key: str(column[row]).strip() for key, column in texts.items()})
            if pole.name in poles:
                raise InputError(f"{where}: name is {shown(pole.name)}, as in a line before; allowed: each pole once")
            poles[pole.name] = pole
    if not poles or len(poles) > _MOST:
        raise InputError(f"{path}: has {len(poles)} poles; allowed: 1 to {_MOST}")
    places = np.array([(pole.x_m, pole.y_m) for pole in poles.values()])
    if 0.0 < np.hypot(*np.ptp(places, axis=0)) < _NEAREST_M:
        raise InputError(
            f"{path}: all {len(poles)} poles stand within {_NEAREST_M:g} m, about x_m {places[0, 0]:g} and y_m "
            f"{places[0, 1]:g}; probably degrees of longitude and latitude; allowed: metres in the road frame"
        )
    return tuple(poles.values())


def _pole(where: str, values: Mapping[str, float | None], texts: Mapping[str, str]) -> Pole:
    existing = texts.get("existing", "").lower()
    if not texts["name"]:
        raise InputError(f"{where}: name is nothing; allowed: what the pole is called")
    if existing not in _EXISTS:
        raise InputError(f"{where}: existing is {shown(existing)}; allowed: yes, no or nothing")
    low, high = values.get("height_min_m"), values.get("height_max_m")
    if low is not None and high is not None and low > high:
        raise InputError(
            f"{where}: height_min_m is {low:g}, height_max_m {high:g}; allowed: the first at most the second"
        )
    values = {key: value for key, value in values.items() if value is not None}
    return Pole(texts["name"], existing=_EXISTS[existing], **values)
