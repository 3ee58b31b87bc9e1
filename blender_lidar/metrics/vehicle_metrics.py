"""Metrics of single vehicles: PE-VGOP, view coverage, point counts and densities, voxel entropy, AP entropy, distance.

Each takes `VehicleReturns` of n vehicles and gives (n,) values; `catalogue` has the name, unit and description of each.
"""

from __future__ import annotations

import math

import numpy as np

from .metric import VehicleReturns, grown
from .vgop import entropy, occupancy
from .view_grids import ViewGrids, cell_counts

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


def sum_of_views(returns: VehicleReturns) -> np.ndarray:
    """P_top + P_side + P_front, (n,): from 0 to 3, and never less for one more point.

    The plain, monotone neighbour of PE-VGOP from the same three shares (Eq. 8); it saturates nowhere, so that close
    vehicles rule a sum over many. On real cars it ranks detections as well as PE-VGOP does (Spearman 0.85 and 0.85) but
    is less linear in them (Pearson 0.60 and 0.77; 383 cars of KITTI, SECOND detector).
    """
    return returns.occupancy.sum(axis=-1)


# --- How near a vehicle is: the yardstick that every other metric has to beat -----------------------------


def distance(returns: VehicleReturns) -> np.ndarray:
    """Horizontal distance from the LiDAR to the box centre [m], (n,); lower is better.

    No published metric but a control: detectors do worse far away, so that a metric which rises and falls with distance
    correlates with them whether it measures anything else or not. It knows nothing of beams, height, tilt or occlusion:
    between mountings in one place it does not choose. What is maximised is minus the distance.
    """
    return returns.distance_m.astype(float)


# --- Perception entropy by Ma, Liu and Li: how uncertain a detector fed with so many returns leaves a position -

SLOPE, INTERCEPT, MARGIN = 0.152, 0.659, 1e-3
"""a, b and epsilon of `expected_precision` for a LiDAR, as go4robo has them."""


def expected_precision(count: np.ndarray) -> np.ndarray:
    """Average precision that a detector is expected to have with m returns, clip(a ln m + b, eps, 1 - eps), (n,).

    Without any it is eps.
    """
    fitted = SLOPE * np.log(np.maximum(count, 1)) + INTERCEPT
    return np.where(count > 0, np.clip(fitted, MARGIN, 1.0 - MARGIN), MARGIN)


def ap_entropy(returns: VehicleReturns) -> np.ndarray:
    """Entropy of a vehicle's position, 2 ln sigma + 1 + ln 2 pi with sigma = 1 / AP - 1 [nats], (n,); lower is better.

    The differential entropy of a position in the plane with a normal error of spread sigma in both directions, where AP
    is the `expected_precision` with the vehicle's returns. Ma, Liu and Li, arXiv:2104.06615; constants as in go4robo's
    `bot_3d_rep.py`, which gives the same formulas.

    With these constants AP reaches its upper bound at 10 returns and the metric is blind above, so that it does little
    more than count the vehicles with so many: refit a and b to the detector meant. H has no bounds but those that eps
    sets: 16.7 nats for a vehicle without returns, -11.0 for one that is seen well.
    """
    precision = expected_precision(returns.count)
    return 2.0 * np.log(1.0 / precision - 1.0) + 1.0 + math.log(2.0 * math.pi)


# --- Metrics from the number of a vehicle's returns, and from that number over the size of its box --------


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


# --- Metrics from cubic voxels in a vehicle's box: how evenly returns fill them, and what share of them they fill -
# Voxels start in the box's rear right lower corner and are whole, `ceil` of each side over theirs, as the cells of
# PE-VGOP's views; returns on the rim or up to one voxel beyond it fall into the rim's voxel, further ones are dropped.

OCCUPANCY_VOXEL_M = 0.1


def voxel_entropy(returns: VehicleReturns, voxel_m: float) -> np.ndarray:
    """Shannon entropy of the returns' distribution over voxels, -sum (c/n) log2 (c/n) [bits], (n,).

    c of a vehicle's n returns lie in a voxel. 0 without returns, with one, and with all in one voxel; at most log2 n.
    Unlike PE-VGOP it has no ceiling. More returns can lower it, where they crowd into few voxels. On real cars it is
    more linear in a detector's output than PE-VGOP (Pearson 0.85 at 0.1 and at 0.2 m, and 0.77; 383 cars of KITTI,
    SECOND detector); there is no outer source for it as a metric of placement.

    Parameters
    ----------
    voxel_m : float
        Side of a voxel [m].
    """
    row, count = _filled(returns, voxel_m)
    total = np.bincount(row, weights=count, minlength=len(returns))
    # log2 n - (1/n) sum c log2 c: the same without dividing each count, and exactly 0 for n returns in one voxel.
    crowding = np.bincount(row, weights=count * np.log2(count), minlength=len(returns))
    seen = np.where(total > 0.0, total, 1.0)
    return np.maximum(np.log2(seen) - crowding / seen, 0.0)


def voxel_occupancy(returns: VehicleReturns) -> np.ndarray:
    """Share q of all the box's voxels that hold a return, (n,).

    Never less for one more return. Only the surface of a vehicle returns, and one side of it, so that q stays far below
    1, and the farther the larger the vehicle.
    """
    row, _ = _filled(returns, OCCUPANCY_VOXEL_M)
    voxels = cell_counts(returns.size_m, grown(OCCUPANCY_VOXEL_M, returns.cell_growth)).prod(axis=1)
    return np.bincount(row, minlength=len(returns)) / voxels


def voxel_occupancy_entropy(returns: VehicleReturns) -> np.ndarray:
    """-q log2 q of the share q of occupied voxels [bits], (n,).

    It stands where the perception entropy of Roos et al. (IEEE ITSC 2021, 3231-3237) would: it is known that theirs
    divides the space of a vehicle into voxels and turns the proportion of occupied ones into an entropy, but its
    formula is not public, so this is not it and does not bear its name. It rises with q up to 1/e, which the surface of
    a vehicle hardly reaches at 0.1 m.
    """
    return entropy(voxel_occupancy(returns))


def _filled(returns, voxel_m):
    """Vehicle (u,) and number of returns (u,) of every voxel that holds any, vehicle after vehicle."""
    voxel_m = grown(voxel_m, returns.cell_growth)
    cells = cell_counts(returns.size_m, voxel_m)
    (x, y, z), vehicle = ViewGrids(returns.size_m, voxel_m).cells_of(returns.points, returns.vehicle)
    voxels = cells.prod(axis=1)
    first = np.cumsum(voxels) - voxels  # number of each box's first voxel
    voxel = first[vehicle] + (x * cells[vehicle, 1] + y) * cells[vehicle, 2] + z
    filled, count = np.unique(voxel, return_counts=True)
    return np.searchsorted(first, filled, side="right") - 1, count
