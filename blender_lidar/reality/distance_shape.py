"""Does a quantity fall with distance along a straight line or along a logarithm?

The paper's Fig. 5 is read so: detection performance and PE-VGOP fall linearly, the other metrics logarithmically.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..metrics.metric import Metric
from .agreement import resampling_of
from .car_sets import CarSet
from .cars import of_bearing
from .cross_validation import share_foretold
from .matching import JudgedCars
from .resampled_cars import Draws, Resampling
from .significance import Difference, of_difference

PERFORMANCE = " performance"
ANY = "any"
_NEAREST_M = 0.1  # so that a box about the sensor itself has a logarithm


class Shape(NamedTuple):
    """How one quantity falls with distance among some cars.

    Attributes
    ----------
    quantity : str
        A metric, or a detector's name and `PERFORMANCE`.
    of_set, bearing : str
        One of `BEARINGS`, or `ANY`.
    cars, clusters : int
    linear, logarithmic : float
        Share of the variance that each curve foretells in frames that it was not fitted to.
    lead : Difference
        The first less the second: above 0 where the fall is linear.
    """

    quantity: str
    of_set: str
    bearing: str
    cars: int
    clusters: int
    linear: float
    logarithmic: float
    lead: Difference


def shapes(judged: JudgedCars, sets: Sequence[CarSet], metrics: Sequence[Metric], draws: Draws) -> list[Shape]:
    """Of every metric and every detector's performance (cars in its range), among all cars of each set by bearing.

    Those with too few cars or clusters are left out.
    """
    everywhere = np.ones(len(judged), dtype=bool)
    quantities: dict[str, tuple[np.ndarray, np.ndarray]] = {
        detector.name + PERFORMANCE: (detector.performance, detector.in_range) for detector in judged.detectors
    }
    quantities |= {
        metric.name: (judged.cars.scores[metric.name], everywhere) for metric in metrics if metric.name != "distance"
    }
    found = []
    for one in sets:
        for bearing, member in {ANY: everywhere, **of_bearing(judged.cars.bearing_deg)}.items():
            found += _among(judged, one, bearing, one.member & member, quantities, draws)
    return found


def _among(
    judged: JudgedCars,
    one: CarSet,
    bearing: str,
    mine: np.ndarray,
    quantities: Mapping[str, tuple[np.ndarray, np.ndarray]],
    draws: Draws,
) -> list[Shape]:
    found = []
    drawn: dict[bytes, Resampling | None] = {}  # most quantities are known of the same cars
    for name, (values, known) in quantities.items():
        used = mine & known
        if used.tobytes() not in drawn:
            drawn[used.tobytes()] = resampling_of(judged, used, draws)
        resampling = drawn[used.tobytes()]
        if resampling is None:
            continue
        y, distance_m = values[used], judged.cars.boxes.distance_m[used]
        linear, logarithmic = (
            share_foretold(y, resampling.fold, _line(x, y), resampling.weights)
            for x in (distance_m, np.log(np.maximum(distance_m, _NEAREST_M)))
        )
        clusters = resampling.clusters.number
        lead = of_difference(linear, logarithmic, clusters)
        shares = float(linear[0]), float(logarithmic[0])
        found.append(Shape(name, one.name, bearing, len(y), clusters, *shares, lead))
    return found


def _line(x: np.ndarray, y: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """A straight line fitted to some and continued to others."""

    def foretell(fitted: np.ndarray, told: np.ndarray) -> np.ndarray:
        off = x[fitted] - x[fitted].mean()
        spread = float(off @ off)
        slope = float(off @ y[fitted]) / spread if spread > 0.0 else 0.0
        return y[fitted].mean() + slope * (x[told] - x[fitted].mean())

    return foretell
