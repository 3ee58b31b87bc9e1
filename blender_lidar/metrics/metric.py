"""Metrics: what one is, and what it is given of vehicles.

A metric scores all vehicles at once, of one frame or of many, under one mounting or under many: to it they are rows. A
new one is a function of `VehicleReturns`, with a line in `catalogue`, or decorated with `metric` in a file of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, unknown_name
from ..names import DEFAULT_CELL_M
from .vgop import occupancy

# --- What a metric is, and what it is given: the returns from vehicles, each in its vehicle's own frame ---

NEEDS_POINTS, NEEDS_DISTANCE, NEEDS_LAYOUTS, NEEDS_DETECTABLE = "points", "distance_m", "layouts", "detectable"
_MISSING = {
    NEEDS_POINTS: "the points themselves, not their number alone",
    NEEDS_DISTANCE: "the place of the LiDAR",
    NEEDS_LAYOUTS: "the mountings and the frame's boxes",
    NEEDS_DETECTABLE: "which vehicles are detectable",
}


_LARGEST_CELL_M = 0.4  # to which cells grow


def grown(cell_m: float, growth: float) -> float:
    """Side of a cell or a voxel where beams are thinned: so many times as large, up to 0.4 m [m]."""
    return max(cell_m, min(cell_m * growth, _LARGEST_CELL_M))


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
    frame : Boxes or None
        The frame with all of its boxes, as `traffic.boxes` has it; None for a cloud, which has no scene.
    layouts : sequence of s tuples of Pose, or None
        From where the frame was looked at: rows are its counted vehicles, layout after layout. Of a layout that leaves
        a LiDAR out its pose is None. None for a cloud.
    detectable : ndarray of bool, (n,), or None
        Whether enough of each is seen (Eq. 11); None where no threshold is known.
    cell_growth : float
        How many times as large cells and voxels are where beams are thinned: see `grown`.
    """

    size_m: np.ndarray
    count: np.ndarray
    occupancy: np.ndarray
    distance_m: np.ndarray | None = None
    points: np.ndarray | None = None
    vehicle: np.ndarray | None = None
    frame: Any = None
    layouts: Sequence[Sequence[Any]] | None = None
    detectable: np.ndarray | None = None
    cell_growth: float = 1.0

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
        When shapes disagree, a row is out of range, a side is not positive or a point is not finite.
    """
    shares = occupancy(points, vehicle, size_m, cell_m, reading)
    points, vehicle, size_m = (np.asarray(values) for values in (points, vehicle, size_m))
    vehicle = vehicle.astype(np.int64, copy=False)
    count = np.bincount(vehicle, minlength=len(size_m))
    return VehicleReturns(size_m.astype(float, copy=False), count, shares, distance_m, points.astype(float), vehicle)


ScoreFunction = Callable[[VehicleReturns], np.ndarray]
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
        Of `VehicleReturns`, what it needs beside sizes, counts and occupancies: of `NEEDS_POINTS`, `NEEDS_DISTANCE`,
        `NEEDS_LAYOUTS` and `NEEDS_DETECTABLE`.
    learn : callable or None
        For a metric with a memory, such as a prior of where vehicles drive: makes the score, given the frames that it
        will score and the `Observation`.
    tells : str
        What it tells of a vehicle, to end a sentence.
    decimals : int
        Digits after the point that matter in a vehicle's value.
    of_share : bool
        Whether its mean is the share of vehicles of which something is true: shown in per cent, its differences in
        percentage points, its sum as a number of vehicles. `decimals` are then those of the per cent.
    """

    name: str
    label: str
    unit: str
    higher_is_better: bool
    score: ScoreFunction | None = None
    needs: frozenset[str] = frozenset()
    learn: Callable[[Sequence[Any], Any], ScoreFunction] | None = None
    tells: str = ""
    decimals: int = 3
    of_share: bool = False

    def values(self, returns: VehicleReturns) -> np.ndarray:
        """Scores of the vehicles, (n,), in the metric's own unit.

        Raises
        ------
        InputError
            When `returns` lacks something that the metric needs, or the metric has to learn from a scene first.
        """
        if self.score is None:
            raise InputError(f"metric {self.name!r} learns from a scene's traffic; allowed: in a run of a scene")
        for what in sorted(self.needs):
            if getattr(returns, what) is None:
                raise InputError(f"metric {self.name!r} needs {_MISSING[what]}")
        return self.score(returns)

    def merit(self, values: np.ndarray) -> np.ndarray:
        """Values with their sign turned where lower is better, so that of two merits the greater one is the better."""
        return values if self.higher_is_better else -values

    @property
    def shown_unit(self) -> str:
        """Unit of shown values: that of its values, or per cent."""
        return "%" if self.of_share else self.unit

    @property
    def per_vehicle(self) -> str:
        """What stands behind a mean: nothing behind a share."""
        return "" if self.of_share else " per vehicle"

    def shown(self, value):
        """A value, or an array of values, as it is shown: itself, or in per cent."""
        return 100.0 * value if self.of_share else value

    def number(self, value: float, more: int = 0, sign: str = "-") -> str:
        """A value, or a mean or sum of some, as text with `more` digits than a vehicle's has; `sign` as in a format."""
        decimals = max(self.decimals + more, 0)
        return f"{round(float(self.shown(value)), decimals) + 0.0:{sign}.{decimals}f}"  # what rounds to 0 has no minus

    def amount(self, value: float, more: int = 0, sign: str = "-") -> str:
        """The same with the unit behind it."""
        return f"{self.number(value, more, sign)} {self.shown_unit}".rstrip()

    def difference(self, value: float, sign: str = "-") -> str:
        """A difference of values with its unit."""
        return f"{self.number(value, 0, sign)} percentage points" if self.of_share else self.amount(value, 0, sign)

    def total(self, value: float, more: int = 0) -> str:
        """A sum over vehicles with its unit."""
        return f"{value:.0f} vehicles" if self.of_share else self.amount(value, more)

    def in_unit(self, what: str) -> str:
        """What a column or an axis shows, with the unit in brackets."""
        return f"{what} [{self.shown_unit}]" if self.shown_unit else what


def metric(
    score: ScoreFunction | None = None,
    /,
    *,
    label: str = "",
    unit: str = "",
    tells: str = "",
    decimals: int = 3,
    lower_is_better: bool = False,
    needs: Iterable[str] = (),
    learns: bool = False,
) -> Metric | Callable[[ScoreFunction], Metric]:
    """Decorator: a metric of one's own, from a function of `VehicleReturns` that gives (n,) finite values.

    ``--metric own.py:roof`` maximises it::

        @blender_lidar.metric(tells="what share of its roof the beams hit")
        def roof(returns):
            return returns.occupancy[:, 0]

    One that `learns` is given frames and the observation instead, as `scene.observation` has them: once the searched
    frames and once those held out, so that what chose a mounting does not judge it. It gives the function of
    `VehicleReturns` that scores these frames.

    Parameters
    ----------
    score : callable
        The function; its name is the metric's.
    label : str
        For axes and tables; the name unless said.
    unit, tells, decimals
        As the attributes of `Metric`.
    lower_is_better : bool
        Whether a low value means that a vehicle is seen well.
    needs : iterable of str
        What it needs of `VehicleReturns` beside sizes, counts and occupancies: ``"points"`` (and ``vehicle``),
        ``"distance_m"``, ``"layouts"`` (and ``frame``), ``"detectable"``.
    learns : bool
        Whether it learns from a scene before it scores.

    Raises
    ------
    InputError
        For a need that there is not.
    """
    for what in needs:
        if what not in _MISSING:
            raise unknown_name(what, _MISSING, "need", "blender_lidar.metric: needs")

    def decorated(score: ScoreFunction) -> Metric:
        name = score.__name__
        made = {"learn": score} if learns else {"score": score}
        made |= {"needs": frozenset(needs), "tells": tells, "decimals": decimals}
        return Metric(name, label or name.replace("_", " "), unit, not lower_is_better, **made)

    return decorated if score is None else decorated(score)
