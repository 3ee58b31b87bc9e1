"""Roadside clutter: signs, cabinets, guard rails, bushes and trees as porous volumes, people who walk; drawn by seed.

It returns and is no vehicle, and hides vehicles behind it. Rates, sizes and distances from the edge of the carriageway
are round numbers of ours, not a survey.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..road.road_map import RoadMap
from .meshes import CYCLIST, PERSON, VEGETATION
from .scenery import Scenery, along_road, barrier, box, join, structure

_CELL_M = 50.0  # along the road: what stands in a cell depends on the seed alone, not on how far one looks
_CLEAR_M = 2.5  # about places where the LiDAR may hang
_LEAF_M = 0.2  # side of the triangles of leaves
_LEAF_AREA_M2 = 0.25 * math.sqrt(3.0) * _LEAF_M**2
_OPTICAL_DEPTH = 1.0  # of a crown, from the side: 37 % of the beams through its middle pass


def clutter(
    road: RoadMap,
    strength: float,
    seed: int,
    s_m: tuple[float, float],
    keep_clear: Sequence[tuple[Sequence[float], Sequence[float]]],
) -> Scenery:
    """Roadside clutter along a stretch of road, to its right and to its left.

    Parameters
    ----------
    road : RoadMap
        Whose lanes stay free.
    strength : float
        How much there is: with 1 the rates of `_KINDS`, with 2 twice as much.
    seed : int
        What else it depends on.
    s_m : (float, float)
        Stations of its ends [m].
    keep_clear : sequence of (low, high)
        Corners x, y of rectangles in which the LiDAR may hang [m]: nothing stands within 2.5 m of one.
    """
    clear = [(np.asarray(low) - _CLEAR_M, np.asarray(high) + _CLEAR_M) for low, high in keep_clear]
    parts = []
    first, last = (math.floor(end / _CELL_M) for end in s_m)
    for cell in range(first, last + 1):
        for side in (0, 1):
            for number, kind in enumerate(_KINDS):
                for made in _things(kind, road, strength, cell, side, [seed, cell + 2**31, side, number]):
                    corners = made.corners[..., :2].reshape(-1, 2)
                    if all(((corners.max(axis=0) < low) | (corners.min(axis=0) > high)).any() for low, high in clear):
                        parts.append(made)
    return join(parts)


def _things(
    kind: _Kind, road: RoadMap, strength: float, cell: int, side: int, seeds: Sequence[int]
) -> Iterator[Scenery]:
    """What stands of a kind in a cell, on its right (0) or left side (1): a Poisson process beside the carriageway."""
    right, left = road.edges_t
    for number in range(np.random.default_rng(seeds).poisson(strength * kind.rate * _CELL_M / 100.0)):
        rng = np.random.default_rng([*seeds, number])
        x, away = (cell + rng.random()) * _CELL_M, rng.uniform(*kind.away_m)
        yield along_road(road, kind.made(x, right - away if side == 0 else left + away, rng))


# --- What stands there: each at station x and offset y of a straight road [m], by draws of its own --------------------


def _sign(x: float, y: float, rng: np.random.Generator) -> Scenery:
    """A plate that faces the traffic, on a post."""
    size, bottom = rng.uniform(0.6, 1.0), rng.uniform(1.8, 2.3)
    plate = box("plate", (x, y, bottom + 0.5 * size), (0.03, size, size))
    return _one("sign", box("post", (x + 0.05, y, 0.5 * bottom), (0.07, 0.07, bottom)), plate)


def _cabinet(x: float, y: float, rng: np.random.Generator) -> Scenery:
    """A switch box or a litter bin."""
    length, width, height = rng.uniform((0.4, 0.3, 0.9), (1.2, 0.5, 1.4))
    return box("cabinet", (x, y, 0.5 * height), (length, width, height))


def _guard_rail(x: float, y: float, rng: np.random.Generator) -> Scenery:
    """A guard rail along the road."""
    length = rng.uniform(15.0, 40.0)
    return _one("guard rail", barrier("guard_rail", y, (x - 0.5 * length, x + 0.5 * length)))


def _bush(x: float, y: float, rng: np.random.Generator) -> Scenery:
    """Leaves from the ground up."""
    across, high = rng.uniform(0.5, 1.2), rng.uniform(0.6, 1.8)
    return structure("bush", leaves((x, y, 0.5 * high), (across, across, 0.5 * high), rng), VEGETATION)


def _tree(x: float, y: float, rng: np.random.Generator) -> Scenery:
    """A crown of leaves on a trunk."""
    across, bottom, high = rng.uniform(1.2, 2.2), rng.uniform(1.8, 3.0), rng.uniform(2.5, 4.5)
    crown = structure("crown", leaves((x, y, bottom + 0.5 * high), (across, across, 0.5 * high), rng))
    return _one("tree", box("trunk", (x, y, 0.5 * bottom), (0.25, 0.25, bottom)), crown, surface=VEGETATION)


def leaves(centre: Sequence[float], half: Sequence[float], rng: np.random.Generator) -> np.ndarray:
    """A porous volume: triangles anywhere in an ellipsoid, in any orientation, (m, 3, 3) [m].

    So many that a level beam through the middle passes with a probability of 37 % (Beer and Lambert, optical depth 1):
    a triangle in any orientation shows half its area.

    Parameters
    ----------
    centre, half : (float, float, float)
        The ellipsoid's middle and half axes [m].
    rng : Generator
    """
    volume, way = 4.0 / 3.0 * math.pi * math.prod(half), half[0] + half[1]  # m3, and the length of that beam in it
    count = max(4, round(_OPTICAL_DEPTH * volume / (way * 0.5 * _LEAF_AREA_M2)))
    middle = _directions(count, rng) * np.cbrt(rng.random((count, 1))) * half + centre
    normal = _directions(count, rng)
    other = np.cross(normal, _directions(count, rng))
    one = other / np.linalg.norm(other, axis=1, keepdims=True)
    two = np.cross(normal, one)
    angles = np.array([0.0, 2.0, 4.0]) * math.pi / 3.0
    ring = np.cos(angles)[:, None] * one[:, None] + np.sin(angles)[:, None] * two[:, None]
    corners = middle[:, None] + _LEAF_M / math.sqrt(3.0) * ring
    corners[..., 2] = np.maximum(corners[..., 2], 0.0)
    return corners


def _directions(count: int, rng: np.random.Generator) -> np.ndarray:
    """Unit vectors, uniform on the sphere, (count, 3)."""
    drawn = rng.normal(size=(count, 3))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def _one(name: str, *parts: Scenery, surface: int | None = None) -> Scenery:
    """Several parts as one object, all of one surface where it is said."""
    whole = join(parts)
    surfaces = whole.surface if surface is None else np.full(len(whole), surface, np.uint8)
    return Scenery(whole.corners, np.zeros(len(whole), np.int32), surfaces, (name,))


@dataclass(frozen=True, slots=True)
class _Kind:
    """How often it stands there on 100 m of a roadside, and how far from the edge of the carriageway [m]."""

    made: Callable[[float, float, np.random.Generator], Scenery]
    rate: float
    away_m: tuple[float, float]


_KINDS = (
    _Kind(_sign, 2.0, (0.6, 2.0)),
    _Kind(_cabinet, 1.0, (1.0, 4.0)),
    _Kind(_guard_rail, 0.5, (0.5, 0.8)),
    _Kind(_bush, 6.0, (1.5, 5.0)),
    _Kind(_tree, 3.0, (2.8, 8.0)),
)


# --- Who moves along the roadside -------------------------------------------------------------------------------------

_RING_M = 1000.0  # of road, at whose end they come in again at its beginning
_WALKERS = 1.5  # on 100 m of a roadside with strength 1
_AWAY_M = (1.0, 4.0)
_CYCLISTS = 0.3  # share
_SPEEDS_M_S = ((0.0, 1.8), (3.0, 6.0))  # of pedestrians, some of whom hardly move, and of cyclists
_TALL_M = (1.5, 1.9)
_BESIDE_M = 1.0  # about places where the LiDAR may hang


@dataclass(frozen=True, slots=True, eq=False)
class Walkers:
    """Pedestrians and cyclists who move along both roadsides, over and over on each km: no learnable background.

    Attributes
    ----------
    road : RoadMap
        Whose lanes they keep off.
    strength, seed, keep_clear
        As of `clutter`.
    """

    road: RoadMap
    strength: float
    seed: int
    keep_clear: Sequence[tuple[Sequence[float], Sequence[float]]]

    def at(self, time_s: float) -> Scenery:
        """Those within 500 m along the road of where the LiDAR may hang, at a time [s]."""
        right, left = self.road.edges_t
        hung = self.road.locate(np.array([corner for corners in self.keep_clear for corner in corners])).s_m
        first_m, last_m = float(hung.min()), float(hung.max())
        parts = []
        for side in (0, 1):
            seeds = [self.seed, side, _WALKER_SEED]
            for number in range(np.random.default_rng(seeds).poisson(self.strength * _WALKERS * _RING_M / 100.0)):
                rng = np.random.default_rng([*seeds, number])
                cycles = int(rng.random() < _CYCLISTS)
                along = rng.choice([-1.0, 1.0]) * rng.uniform(*_SPEEDS_M_S[cycles])
                nearest = first_m - 0.5 * _RING_M + (rng.random() * _RING_M + along * time_s - first_m) % _RING_M
                away, tall = rng.uniform(*_AWAY_M), rng.uniform(*_TALL_M)
                y = right - away if side == 0 else left + away
                made = _cyclist if cycles else _pedestrian
                # The same ones again on the next km.
                for x in np.arange(nearest, last_m + 0.5 * _RING_M, _RING_M).tolist():
                    xy = self.road.at(x, y)
                    if not any((abs(np.clip(xy, low, high) - xy) <= _BESIDE_M).all() for low, high in self.keep_clear):
                        who = made(x, y, 0.0 if along >= 0.0 else math.pi, tall)
                        parts.append(along_road(self.road, who))
        return join(parts)


_WALKER_SEED = 2**32 - 1  # no cell of `clutter`


def _pedestrian(x: float, y: float, heading: float, tall: float) -> Scenery:
    """Legs, trunk and head, as boxes."""
    legs = box("legs", (x, y, 0.24 * tall), (0.25, 0.3, 0.48 * tall), heading)
    trunk = box("trunk", (x, y, 0.66 * tall), (0.28, 0.45, 0.36 * tall), heading)
    head = box("head", (x, y, 0.93 * tall), (0.2, 0.17, 0.14 * tall), heading)
    return _one("pedestrian", legs, trunk, head, surface=PERSON)


def _cyclist(x: float, y: float, heading: float, tall: float) -> Scenery:
    """A cycle and its rider, as boxes."""
    rider = box("rider", (x, y, 0.72 * tall), (0.5, 0.45, 0.5 * tall), heading)
    return _one("cyclist", box("cycle", (x, y, 0.5), (1.75, 0.1, 1.0), heading), rider, surface=CYCLIST)
