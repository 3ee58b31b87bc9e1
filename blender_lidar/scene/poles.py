"""Candidate poles: the table of [deployment] poles, and which of them are free where several LiDARs want one."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..csv_header import laid_out
from ..csv_tables import Column, read_whole
from ..errors import InputError, shown
from .deployment import COORDINATE_LIMITS, Deployment, Place, Pole

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
    layout = laid_out(path, _NEEDED, _OPTIONAL)
    poles: dict[str, Pole] = {}
    rows = read_whole(path, layout, _NUMBERS, ["name", "existing"])
    for row in range(len(rows)):
        where, cells = rows.where(row), {key: column[row] for key, column in rows.columns.items()}
        values = {key: None if np.isnan(cells[key]) else float(cells[key]) for key in cells if key in _NUMBERS}
        pole = _pole(where, values, {key: cells[key].strip() for key in cells if key not in _NUMBERS})
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


# --- Poles for several LiDARs -----------------------------------------------------------------------------------------


def each_has_one(choices: Sequence[Iterable[Hashable]]) -> bool:
    """Bipartite matching by augmenting paths (Kuhn): whether each can have one of its choices, none of them twice."""
    holder: dict[Hashable, int] = {}

    def has(number: int, seen: set[Hashable]) -> bool:
        for one in choices[number]:
            if one not in seen:
                seen.add(one)
                if one not in holder or has(holder[one], seen):
                    holder[one] = number
                    return True
        return False

    return all(has(number, set()) for number in range(len(choices)))


def free_places(lidars: Sequence[Deployment], number: int, hung: Mapping[int, tuple[float, float]]) -> list[Place]:
    """The places of a LiDAR that leave one to each of the others, of which some are `hung` at x, y already [m]."""
    single = {k: one.places[0].xy for k, one in enumerate(lidars) if len(one.places) == 1}
    taken = {xy for k, xy in {**single, **hung}.items() if k != number}
    rest = [one for k, one in enumerate(lidars) if k != number and k not in hung and len(one.places) > 1]
    choices = [{place.xy for place in one.places} - taken for one in rest]
    return [
        place
        for place in lidars[number].places
        if place.pole is None or (place.xy not in taken and each_has_one([choice - {place.xy} for choice in choices]))
    ]
