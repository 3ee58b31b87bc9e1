"""What a metric is, and what it is given: the returns from vehicles, each in its vehicle's own frame.

A metric scores all vehicles at once, of one frame or of many, under one mounting or under many: to it they are rows. A
new one is a file of this room that defines its `Metric`, and its name in `catalogue`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from .context import SceneContext, View
from .vgop import occupancy
from .view_grids import DEFAULT_CELL_M

POINTS, DISTANCE, VIEW = "points", "distance_m", "view"
_MISSING = {
    POINTS: "the points themselves, not their number alone",
    DISTANCE: "the place of the LiDAR",
    VIEW: "the mountings and the frame's boxes",
}


@dataclass(frozen=True, slots=True, eq=False)
class VehicleReturns:
    """What came back from n vehicles.

    Attributes
    ----------
    size_m : ndarray, (n, 3)
        Length, width and height of each vehicle's box [m].
    count : ndarray of int64, (n,)
        Returns from each vehicle.
    occupancy : ndarray, (n, 3)
        P of its top, side and front view (Eqs. 6 to 8): made once for all metrics.
    distance_m : ndarray, (n,), or None
        Horizontal distance from the LiDAR to the box centre [m]; None where the LiDAR's place is not known.
    points : ndarray, (k, 3), or None
        The returns, each in the frame of its own vehicle [m]; None where no metric asked for them.
    vehicle : ndarray of int64, (k,), or None
        Row of the vehicle that each return belongs to.
    view : View or None
        From where the vehicles were looked at, for metrics that learn from a scene.
    """

    size_m: np.ndarray
    count: np.ndarray
    occupancy: np.ndarray
    distance_m: np.ndarray | None = None
    points: np.ndarray | None = None
    vehicle: np.ndarray | None = None
    view: View | None = None

    def __len__(self) -> int:
        return len(self.size_m)


def vehicle_returns(
    points: np.ndarray,
    vehicle: np.ndarray,
    size_m: np.ndarray,
    distance_m: np.ndarray | None = None,
    cell_m: float = DEFAULT_CELL_M,
    reading: str = "corrected",
) -> VehicleReturns:
    """Count returns and the cells that they occupy.

    Parameters
    ----------
    points : ndarray, (k, 3)
        Returns, each in the frame of its own vehicle [m]: see `vgop.to_vehicle_frame`.
    vehicle : ndarray of int, (k,)
        Row of `size_m` that each return belongs to.
    size_m : ndarray, (n, 3)
        Length, width and height of each vehicle's box [m].
    distance_m : ndarray, (n,), optional
        Horizontal distance from the LiDAR to the box centre [m].
    cell_m, reading
        As for `vgop.occupancy`.

    Raises
    ------
    InputError
        When shapes disagree, a row is out of range, a side is not positive, a point is not finite or a distance is
        negative or not finite.
    """
    shares = occupancy(points, vehicle, size_m, cell_m, reading)
    points, vehicle, size_m = (np.asarray(values) for values in (points, vehicle, size_m))
    vehicle = vehicle.astype(np.int64, copy=False)
    if distance_m is not None:
        distance_m = np.asarray(distance_m, dtype=float)
        if distance_m.shape != (len(size_m),):
            raise InputError(
                f"distance_m has shape {distance_m.shape}; allowed: ({len(size_m)},), one for each vehicle"
            )
        if not ((distance_m >= 0.0) & (distance_m < np.inf)).all():
            raise InputError("distance_m holds a distance that is negative or not finite")
    count = np.bincount(vehicle, minlength=len(size_m))
    return VehicleReturns(size_m.astype(float, copy=False), count, shares, distance_m, points.astype(float), vehicle)


Score = Callable[[VehicleReturns], np.ndarray]
"""Scores n vehicles: (n,), in the metric's own unit."""


@dataclass(frozen=True, slots=True)
class Metric:
    """A score of vehicles, by name.

    Attributes
    ----------
    name : str
        As scenes and options give it.
    label : str
        For axes and tables, in lower case unless a name.
    unit : str
        Of its values, in the plural; empty for a share or any other plain number.
    higher_is_better : bool
        False where a low value means that a vehicle is seen well.
    score : callable or None
        Makes (n,) values of `VehicleReturns`; None for a metric that must learn from a scene first.
    needs : frozenset of str
        Of `VehicleReturns`, what it needs beside sizes, counts and occupancies: `POINTS`, `DISTANCE`, `VIEW`.
    learn : callable or None
        For a metric with a memory, such as a prior of where vehicles drive: makes the score of a `SceneContext`.
    tells : str
        What it tells of a vehicle or of the scene, to end a sentence.
    decimals : int
        Digits after the point that matter in a vehicle's value.
    of_scene : bool
        Whether it scores a frame as a whole, whose vehicles then all have the same value.
    """

    name: str
    label: str
    unit: str
    higher_is_better: bool
    score: Score | None = None
    needs: frozenset[str] = frozenset()
    learn: Callable[[SceneContext], Score] | None = None
    tells: str = ""
    decimals: int = 3
    of_scene: bool = False

    def learnt(self, context: SceneContext | None) -> Metric:
        """The metric made ready to score: itself, or what it becomes once it has learnt from a scene.

        Raises
        ------
        InputError
            When it has to learn and there is nothing to learn from.
        """
        if self.learn is None:
            return self
        if context is None:
            raise InputError(f"metric {self.name!r} learns from a scene's traffic; allowed: in a run of a scene")
        return replace(self, score=self.learn(context), learn=None)

    def values(self, returns: VehicleReturns) -> np.ndarray:
        """Scores of the vehicles, (n,), in the metric's own unit.

        Raises
        ------
        InputError
            When `returns` lacks something that the metric needs, or the metric has to learn first: see `learnt`.
        """
        score = self.learnt(None).score
        for what in sorted(self.needs):
            if getattr(returns, what) is None:
                raise InputError(f"metric {self.name!r} needs {_MISSING[what]}")
        return score(returns)

    def merit(self, values: np.ndarray) -> np.ndarray:
        """Values with their sign turned where lower is better, so that of two merits the greater one is the better."""
        return values if self.higher_is_better else -values

    def number(self, value: float, more: int = 0, sign: str = "-") -> str:
        """A value, or a mean or sum of some, as text with `more` digits than a vehicle's has; `sign` as in a format."""
        return f"{value:{sign}.{max(self.decimals + more, 0)}f}"

    def amount(self, value: float, more: int = 0, sign: str = "-") -> str:
        """The same with the unit behind it."""
        return f"{self.number(value, more, sign)} {self.unit}".rstrip()

    def in_unit(self, what: str) -> str:
        """What a column or an axis shows, with the unit in brackets."""
        return f"{what} [{self.unit}]" if self.unit else what
