"""How the sensor of a recording hangs: as options say, or as `commission` found it and wrote into commission.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError, printable
from ..files import read_text, reading
from ..sensors.model import load_model
from ..sensors.pose import Pose
from ..toml_table import Setting, TomlTable
from .fit import in_frame

COMMISSION = "commission.json"
_TEXTS = dict.fromkeys(("sensor", "axes"), Setting(kind=str))
_POSE = {**dict.fromkeys(("x_m", "y_m"), Setting(low=-1e6, high=1e6)), "height_m": Setting(above=0.0, high=1e3)}
_POSE |= dict.fromkeys(("tilt_x_deg", "tilt_y_deg", "yaw_deg"), Setting(low=-360.0, high=360.0))
_MORE = {
    "blind_sectors_deg": Setting(kind=tuple[tuple[float, float], ...], low=0.0, high=360.0),
    "origin_m": Setting(kind=tuple[float, float, float], low=-1e9, high=1e9),
}
_SPAN = Setting(kind=tuple[float, float], fits=lambda y: y[0] < y[1], form="the lower first, below the upper")


class Hung(NamedTuple):
    """A sensor whose clouds are in its own frame: axes and pose `at` bring them to the road's, as for `in_frame`.

    `sensor` is its model's name; `carriageways` are from which y to which [m, road frame], `blind_deg` sectors of
    azimuth in which nothing returns, clockwise from straight ahead. `origin_m` is its place in the clouds.
    """

    axes: str
    at: Sequence[float]
    sensor: str | None = None
    carriageways: Sequence[tuple[float, float]] = ()
    blind_deg: Sequence[tuple[float, float]] = ()
    origin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def pose(self) -> Pose:
        """Where it hangs in the road frame, with its beams as the lattice has them."""
        return Pose(*self.at[:3], *np.radians(self.at[3:]).tolist())

    def placed(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of its own frame in the road's [m]."""
        return in_frame(points - self.origin_m, self.axes, self.at)

    def seen(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) of its own frame from the sensor, x to the right and y ahead [m]."""
        return in_frame(points - self.origin_m, self.axes, None)


def read_commission(path: str | Path, beside: Sequence[str] = ()) -> Hung:
    """Sensor, axes, pose and carriageways from a commission.json, or from the folder that it is in.

    Raises
    ------
    MissingFileError, InputError
        If there is none, or something in it is missing, unknown or beyond its limits; for options `beside` it.
    """
    if beside:
        raise InputError(f"{', '.join(beside)}: beside --commission, which says it; allowed: one of both")
    path = Path(path) / COMMISSION if Path(path).is_dir() else Path(path)
    with reading(path, f"{COMMISSION}, or its folder"):
        try:
            content = json.loads(read_text(path))
        except (ValueError, RecursionError) as error:
            raise InputError(f"{path}: is not JSON: {printable(str(error))}") from error
    table = TomlTable(content, str(path))
    texts, pose, rows = table.some(_TEXTS), table.table("pose").some(_POSE), content.get("carriageways")
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{path}: carriageways: is {printable(str(rows))}; allowed: a list of tables with y_m")
    each = [TomlTable(row, f"{path}: carriageways {at}") for at, row in enumerate(rows, 1)]
    spans = [one.some({"y_m": _SPAN})["y_m"] for one in each]
    more = {key: content[key] for key in _MORE if content.get(key)}
    more = TomlTable(more, str(path)).read({key: _MORE[key] for key in more})
    blind, origin = more.get("blind_sectors_deg", ()), more.get("origin_m", (0.0, 0.0, 0.0))
    hung = Hung(texts["axes"], tuple(pose.values()), texts["sensor"], spans, blind, origin)
    try:
        load_model(hung.sensor)
        hung.placed(np.zeros((1, 3)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return hung
