"""How near a vehicle is: the yardstick that every other metric has to beat."""

from __future__ import annotations

import numpy as np

from .metric import DISTANCE, Metric, VehicleReturns


def distance(returns: VehicleReturns) -> np.ndarray:
    """Horizontal distance from the LiDAR to the box centre [m], (n,); lower is better.

    No published metric but a control: detectors do worse far away, so that a metric which rises and falls with distance
    correlates with them whether it measures anything else or not. It knows nothing of beams, height, tilt or occlusion:
    between mountings in one place it does not choose. What is maximised is minus the distance.
    """
    return returns.distance_m.astype(float)


DISTANCE_METRIC = Metric(
    "distance",
    "distance",
    "m",
    higher_is_better=False,
    score=distance,
    needs=frozenset({DISTANCE}),
    tells="how far from the LiDAR it is, horizontally",
    decimals=2,
)
