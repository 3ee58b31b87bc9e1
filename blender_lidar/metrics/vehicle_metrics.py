"""Metrics of single vehicles: PE-VGOP, view coverage, detectable share.

Each takes `VehicleReturns` of n vehicles and gives (n,) values; `catalogue` has the name, unit and description of each.
"""

from __future__ import annotations

import math

import numpy as np

from .metric import VehicleReturns, grown
from .vgop import entropy, occupancy

# --- View coverage: our own score of a vehicle, from the same three views as PE-VGOP ----------------------
# C = (s(P_top) + sqrt(s(P_side)^2 + s(P_front)^2)) / (1 + sqrt 2),    s(P) = (1 + h) P / (P + h)
# P are the occupancies of Eqs. 6 to 8 with cells of 0.2 m, and h = 0.5.
# - One more return never lowers it: s rises with P throughout, where -P log2 P turns at P = 1/e.
# - It saturates, as detectors do: the first cells of a view count most. s(0) = 0 and s(1) = 1, so that C is 0 for a
#   vehicle that nothing returns from and 1 for one with every cell of every view hit.
# - It is fair to bearing: what the beams see of a vehicle's upright faces moves from the side to the front view as the
#   line of sight turns, and the root of the sum of squares keeps what moves. For a car in the full view of an HDL-64E
#   at 20 m, C varies over the bearings by a coefficient of variation of 0.09, the number of returns by 0.19.
# - It is fair to size: P is a share, and cells of 0.2 m, about those in which detectors gather points (PointPillars
#   0.16 m), are hit in a lorry as easily as in a car.
# Cell and h are the best of this form on 55 labelled cars of KITTI's train split, frozen before any other car was
# looked at. These cars cannot tell this form from the plain sum of the three s, or from the better of side and front
# in place of the root; bearing decided. `scripts/research/choose_view_coverage.py` of commit 030385c
# does it again, and `docs/evidence/reproduction.md` has what it is worth on the other split.

CELL_M = 0.2
HALF_SHARE = 0.5


def view_coverage(returns: VehicleReturns) -> np.ndarray:
    """C of each vehicle, (n,), from 0 to 1; higher is better. Its cells do not depend on PE-VGOP's."""
    return coverage(occupancy(returns.points, returns.vehicle, returns.size_m, grown(CELL_M, returns.cell_growth)))


def coverage(shares: np.ndarray) -> np.ndarray:
    """C, (...), of the occupancies P of top, side and front view, (..., 3), from 0 to 1."""
    saturated = (1.0 + HALF_SHARE) * shares / (shares + HALF_SHARE)  # s
    top, side, front = np.moveaxis(saturated, -1, 0)
    return (top + np.hypot(side, front)) / (1.0 + math.sqrt(2.0))


# --- Metrics from the shares of a vehicle's three views that the beams hit --------------------------------


def view_entropy(returns: VehicleReturns) -> np.ndarray:
    """PE-VGOP: the sum of -P log2 P over top, side and front [bits], (n,).

    Eq. 9 of He, Cao, Su and Liu (arXiv:2407.17942). Each summand peaks at P = 1/e and is 0 again at P = 1, so that a
    denser view can score less, and the sum is at most 1.592 bits: `vgop` has the rest.
    """
    return entropy(returns.occupancy).sum(axis=-1)


TIE_BREAKER = 1e-8
"""What a bit is worth beside a vehicle: with at most 1.592 bits each, all of 60 million vehicles weigh less than one.

Sums of 100,000 vehicles still tell a thousandth of a bit apart.
"""


def detectable_share(returns: VehicleReturns) -> np.ndarray:
    """Detectable share: 1 for a vehicle at or above the threshold (Eq. 11), 0 for any other, (n,); ties go to PE-VGOP.

    What a planner signs for: the mean over vehicles is their detectable share, and a mounting that finds one vehicle
    more is the better one. Of two that find equally many the one with more bits is, as each vehicle adds
    `TIE_BREAKER` times its PE-VGOP too.
    """
    return returns.detectable + TIE_BREAKER * view_entropy(returns)
