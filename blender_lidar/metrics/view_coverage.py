"""View coverage: our own score of a vehicle, from the same three views as PE-VGOP.

    C = (s(P_top) + sqrt(s(P_side)^2 + s(P_front)^2)) / (1 + sqrt 2),    s(P) = (1 + h) P / (P + h)

P are the occupancies of Eqs. 6 to 8 with cells of 0.2 m, and h = 0.5.

- One more return never lowers it: s rises with P throughout, where -P log2 P turns at P = 1/e.
- It saturates, as detectors do: the first cells of a view count most. s(0) = 0 and s(1) = 1, so that C is 0 for a
  vehicle that nothing returns from and 1 for one with every cell of every view hit.
- It is fair to bearing: what the beams see of a vehicle's upright faces moves from the side to the front view as the
  line of sight turns, and the root of the sum of squares keeps what moves. For a car in the full view of an HDL-64E at
  20 m, C varies over the bearings by a coefficient of variation of 0.09, the number of returns by 0.19.
- It is fair to size: P is a share, and cells of 0.2 m, about those in which detectors gather points (PointPillars 0.16
  m), are hit in a lorry as easily as in a car.

Cell and h are the best of this form on 55 labelled cars of KITTI's train split, frozen before any other car was looked
at. These cars cannot tell this form from the plain sum of the three s, or from the better of side and front in
place of the root; bearing decided. `scripts/choose_view_coverage.py` does it again, and `docs/reproduction.md` has what
it is worth on the other split.
"""

from __future__ import annotations

import math

import numpy as np

from .metric import POINTS, Metric, VehicleReturns
from .vgop import occupancy

CELL_M = 0.2
HALF_SHARE = 0.5


def view_coverage(returns: VehicleReturns) -> np.ndarray:
    """C of each vehicle, (n,), from 0 to 1; higher is better. Its cells are its own, whatever PE-VGOP's."""
    return coverage(occupancy(returns.points, returns.vehicle, returns.size_m, CELL_M))


def coverage(shares: np.ndarray, half_share: float = HALF_SHARE) -> np.ndarray:
    """C of the occupancies of top, side and front view.

    Parameters
    ----------
    shares : ndarray, (..., 3)
        P of top, side and front, from 0 to 1.
    half_share : float
        h: the smaller, the sooner a view saturates.

    Returns
    -------
    ndarray, (...)
    """
    top, side, front = np.moveaxis(saturated(shares, half_share), -1, 0)
    return (top + np.hypot(side, front)) / (1.0 + math.sqrt(2.0))


def saturated(shares: np.ndarray, half_share: float) -> np.ndarray:
    """s of each occupancy, in the shape of `shares`."""
    return (1.0 + half_share) * shares / (shares + half_share)


VIEW_COVERAGE = Metric(
    "view-coverage",
    "view coverage",
    "",
    higher_is_better=True,
    score=view_coverage,
    needs=frozenset({POINTS}),
    tells="how much of its top, side and front the beams hit, from 0 to 1",
)
