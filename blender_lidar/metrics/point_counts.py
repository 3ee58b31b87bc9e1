"""Metrics from the number of a vehicle's returns, and from that number over the size of its box."""

from __future__ import annotations

import numpy as np

from .metric import Metric, VehicleReturns


def points(returns: VehicleReturns) -> np.ndarray:
    """Number of returns n, (n,).

    Falls with the square of distance, so that a sum over vehicles is ruled by the nearest few, and large vehicles weigh
    more than small ones. Every added return counts as much as the first.
    """
    return returns.count.astype(float)


def log_points(returns: VehicleReturns) -> np.ndarray:
    """ln(1 + n) of the number of returns n, (n,): 0 without any.

    The logarithm that detection studies fit to point counts; it keeps near vehicles from ruling a sum. No outer source:
    a baseline. On real cars it is about as linear in a detector's output as PE-VGOP (Pearson 0.79 and 0.77; 383 cars of
    KITTI, SECOND detector).
    """
    return np.log1p(returns.count)


def areal_density(returns: VehicleReturns) -> np.ndarray:
    """Returns per area of the box's footprint, n / (l w) [points/m²], (n,).

    It stands where the density metric of Jin et al. (IEEE Sensors Journal 22(21):21009-21023, 2022) would: of that one
    it is known that it takes "the density of point clouds in the RoI", but its formula is not public, so this is not it
    and does not bear its name. Falls with the square of distance like the number of returns; between boxes of one size
    it orders them alike.
    """
    return returns.count / (returns.size_m[:, 0] * returns.size_m[:, 1])


def volumetric_density(returns: VehicleReturns) -> np.ndarray:
    """Returns per volume of the box, n / (l w h) [points/m³], (n,).

    As `areal_density`, per volume. Returns come from surfaces, so that a large vehicle seen as densely as a small one
    has the lower value.
    """
    return returns.count / returns.size_m.prod(axis=1)


POINTS = Metric(
    "points",
    "number of returns",
    "points",
    higher_is_better=True,
    score=points,
    tells="how many beams return from it",
    decimals=1,
)
LOG_POINTS = Metric(
    "log-points",
    "ln(1 + returns)",
    "",
    higher_is_better=True,
    score=log_points,
    tells="how many beams return from it, on a logarithmic scale",
)
AREAL_DENSITY = Metric(
    "areal-density",
    "areal density",
    "points/m²",
    higher_is_better=True,
    score=areal_density,
    tells="how many beams return from it for each square metre of its footprint",
)
VOLUMETRIC_DENSITY = Metric(
    "volumetric-density",
    "volumetric density",
    "points/m³",
    higher_is_better=True,
    score=volumetric_density,
    tells="how many beams return from it for each cubic metre of its box",
)
