"""OpenDRIVE's numbers, piecewise cubics and reference lines: line, arc, spiral, poly3, paramPoly3."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, shown, unknown_name
from ..files import number

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_CURVATURES = {"line": (), "arc": ("curvature", "curvature"), "spiral": ("curvStart", "curvEnd")}
_CURVES = (*_CURVATURES, "poly3", "paramPoly3")
_GAP_M = 1.0  # that a file may have between its geometries, or between one and its length
_NO_LENGTH_M = 1e-6
_LARGEST = 1e9  # sums and squares stay finite
_MOST_M, _MOST_TURN_RAD = 1e5, 1e3  # of one geometry
_STEPS = 1024  # in which a cubic's arc length is summed: exact to 0.01 mm on 100 m

Curve = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


def finite(element: Element, key: str, where: str, default: float | None = None) -> float:
    """A finite number of an element; `default` where it has none."""
    text = element.get(key)
    if text is None and default is not None:
        return default
    value = number((text or "").strip())
    if not abs(value) <= _LARGEST:
        raise InputError(f"{where}: <{element.tag}> has {key} {shown(text)}; allowed: a number of {_LARGEST:g} at most")
    return value


def whole(element: Element, key: str, where: str) -> int:
    """A whole number of an element."""
    value = finite(element, key, where)
    if value != int(value):
        raise InputError(f"{where}: <{element.tag}> has {key} {value:g}; allowed: a whole number")
    return int(value)


def cubics(elements: Iterable[Element], start: str, where: str) -> np.ndarray:
    """Records of cubic polynomials, (k, 5): from where on they hold [m], and a, b, c, d."""
    rows = [[finite(element, key, where) for key in (start, *"abcd")] for element in elements]
    return np.array(sorted(rows, key=lambda row: row[0])).reshape(-1, 5)


def cubic(records: np.ndarray, s_m: np.ndarray) -> np.ndarray:
    """Values (n,) of a piecewise cubic at stations (n,) [m]; 0 without records."""
    if not len(records):
        return np.zeros(len(s_m))
    start, a, b, c, d = records[(np.searchsorted(records[:, 0], s_m, side="right") - 1).clip(0)].T
    ds = (s_m - start).clip(0.0)
    return a + ds * (b + ds * (c + ds * d))


class ReferenceLine:
    """The reference line of a road: places and headings by its station.

    Attributes
    ----------
    start_m : ndarray, (g,)
        Station at which each geometry begins [m].
    end_m : float
        Station of its end [m].
    """

    def __init__(self, road: Element, where: str, shift_m: np.ndarray) -> None:
        """Read a `<road>`; `shift_m` (2,) is subtracted from all places."""
        elements = sorted(road.iterfind("planView/geometry"), key=lambda element: finite(element, "s", where))
        elements = [element for element in elements if finite(element, "length", where) > _NO_LENGTH_M]
        if not elements:
            raise InputError(f"{where}: its <planView> has no <geometry> with a length")
        keys = ("s", "length", "x", "y", "hdg")
        table = np.array([[finite(element, key, where) for key in keys] for element in elements])
        self.start_m, length, self._turn = table[:, 0], table[:, 1], table[:, 4]
        if length.max() > _MOST_M:
            raise InputError(
                f"{where}: a <geometry> is {length.max():g} m long; allowed: up to {_MOST_M:g} m, in metres"
            )
        for s, due in zip(self.start_m, [0.0, *(self.start_m + length)], strict=False):
            if abs(s - due) > _GAP_M:
                raise InputError(f"{where}: a <geometry> is at s {s:g}; allowed: {due:g}, where the one before it ends")
        self._place = table[:, 2:4] - shift_m
        self._curves = [_curve(*each, where) for each in zip(elements, length, strict=True)]
        self.end_m = float(self.start_m[-1] + length[-1])
        for piece, s in enumerate(self.start_m[1:]):
            gap = math.dist(self._along(piece, length[piece : piece + 1])[0][0], self._place[piece + 1])
            if gap > _GAP_M:
                raise InputError(f"{where}: <geometry> at s {s:g} begins {gap:.2f} m from where the one before it ends")

    def at(self, s_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (n, 2) [m] and headings (n,) [rad] at stations (n,) [m]."""
        which = (np.searchsorted(self.start_m, s_m, side="right") - 1).clip(0)
        xy, heading = np.empty((len(s_m), 2)), np.empty(len(s_m))
        for piece in np.unique(which):
            own = which == piece
            xy[own], heading[own] = self._along(piece, s_m[own] - self.start_m[piece])
        return xy, heading

    def _along(self, piece: int, ds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of one geometry, by the distance from its start."""
        uv, turn = self._curves[piece](ds)
        cos, sin = math.cos(self._turn[piece]), math.sin(self._turn[piece])
        return self._place[piece] + uv @ np.array([[cos, sin], [-sin, cos]]), self._turn[piece] + turn


def _curve(geometry: Element, length: float, where: str) -> Curve:
    """Places (n, 2) [m] and tangents (n,) [rad] of a geometry by arc length (n,) [m], from the origin along +x."""
    shape = next((child for child in geometry if child.tag in _CURVES), None)
    where = f"{where}: <geometry> at s {geometry.get('s')}"
    if shape is None:
        raise unknown_name(", ".join(child.tag for child in geometry), _CURVES, "geometry", where)
    if shape.tag in _CURVATURES:
        first, last = [finite(shape, key, where) for key in _CURVATURES[shape.tag]] or (0.0, 0.0)
        turn = length * max(abs(first), abs(last))
        if turn > _MOST_TURN_RAD:
            raise InputError(f"{where}: its <{shape.tag}> turns by {turn:g} rad; allowed: up to {_MOST_TURN_RAD:g}")
        return partial(_clothoid, first=first, rate=(last - first) / length, panels=1 + math.ceil(turn))
    if shape.tag == "poly3":
        u, v = np.array([0.0, 1.0, 0.0, 0.0]), np.array([finite(shape, key, where) for key in "abcd"])
        end = length
    else:
        u, v = (np.array([finite(shape, key + axis, where) for key in "abcd"]) for axis in "UV")
        ranges = {"normalized": 1.0, "arcLength": length}
        if (given := shape.get("pRange", "normalized")) not in ranges:
            raise unknown_name(given, ranges, "pRange", where)
        end = ranges[given]
    p = np.linspace(0.0, end, _STEPS + 1)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(_values(u, v, p), axis=0).T))])
    if shape.tag == "paramPoly3":
        if abs(arc[-1] - length) > max(_GAP_M, 0.1 * length):
            raise InputError(f"{where}: its <paramPoly3> is {arc[-1]:.2f} m long, its length says {length:.2f} m")
        arc *= length / arc[-1]
    return partial(_by_arc_length, u=u, v=v, p=p, arc_m=arc)


def _clothoid(ds: np.ndarray, first: float, rate: float, panels: int) -> tuple[np.ndarray, np.ndarray]:
    """Euler spiral, a circle or a line among them, by Gauss-Legendre quadrature in panels of a radian or less."""
    node, weight = np.polynomial.legendre.leggauss(8)
    part = ((np.arange(panels)[:, None] + 0.5 * (node + 1.0)) / panels).ravel()
    at, weight = ds[:, None] * part, np.tile(0.5 * weight / panels, panels)
    angle = at * (first + 0.5 * rate * at)
    uv = ds[:, None] * np.stack([np.cos(angle) @ weight, np.sin(angle) @ weight], axis=1)
    return uv, ds * (first + 0.5 * rate * ds)


def _by_arc_length(
    ds: np.ndarray, u: np.ndarray, v: np.ndarray, p: np.ndarray, arc_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Two cubics of a parameter p at distances along the curve, its arc length from p to p being known."""
    at, power = np.interp(ds, arc_m, p), np.arange(1, 4)
    slope = _values(power * u[1:], power * v[1:], at)
    return _values(u, v, at), np.arctan2(slope[:, 1], slope[:, 0])


def _values(u: np.ndarray, v: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Two polynomials of one parameter (n,), (n, 2)."""
    return np.stack([np.polyval(u[::-1], p), np.polyval(v[::-1], p)], axis=1)
