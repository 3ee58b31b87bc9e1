"""Rival metrics of single vehicles, as plug-ins: counts, densities, voxels, entropy of the position, distance.

    blender-lidar optimise SCENE.toml --metric scripts/research/rival_metrics.py:voxel_entropy_20_cm

What others place LiDARs by, plain baselines and a control, to compare PE-VGOP with: docs/evidence has what each is
worth, and recommends none of them. Each takes the returns from n vehicles, `VehicleReturns`, and gives n values. All
need the returns of single vehicles alone: `scene_metrics` beside this file has metrics that learn from a scene.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

import blender_lidar as bl
from blender_lidar.metrics.metric import VehicleReturns, grown
from blender_lidar.metrics.vgop import entropy
from blender_lidar.metrics.view_grids import ViewGrids, cell_counts

NAMES = (
    *("sum_of_views", "number_of_returns", "log_returns", "areal_density", "volumetric_density"),
    *("voxel_entropy_10_cm", "voxel_entropy_20_cm", "voxel_occupancy", "voxel_occupancy_entropy"),
    *("ap_entropy", "distance"),
)
OPTIONS = {name: f"{Path(__file__).resolve()}:{name}" for name in NAMES}  # what `--metric` calls each

# --- From the shares of a vehicle's three views that the beams hit ----------------------------------------------------


@bl.metric(label="sum of the views' occupancies", decimals=4, tells="what shares of its three views the beams hit")
def sum_of_views(returns: VehicleReturns) -> np.ndarray:
    """P_top + P_side + P_front, (n,): from 0 to 3, and never less for one more point.

    The plain, monotone neighbour of PE-VGOP from the same three shares (Eq. 8); it saturates nowhere, so that close
    vehicles rule a sum over many. On real cars it ranks detections as well as PE-VGOP does (Spearman 0.85 and 0.85) but
    is less linear in them (Pearson 0.60 and 0.77; 383 cars of KITTI, SECOND detector).
    """
    return returns.occupancy.sum(axis=-1)


# --- From the number of a vehicle's returns, and from that number over the size of its box ----------------------------


@bl.metric(unit="points", decimals=1, tells="how many beams return from it")
def number_of_returns(returns: VehicleReturns) -> np.ndarray:
    """Number of returns n, (n,).

    Falls with the square of distance, so that a sum over vehicles is ruled by the nearest few, and large vehicles weigh
    more than small ones. Every added return counts as much as the first.
    """
    return returns.count


@bl.metric(label="ln(1 + returns)", tells="how many beams return from it, on a logarithmic scale")
def log_returns(returns: VehicleReturns) -> np.ndarray:
    """ln(1 + n) of the number of returns n, (n,): 0 without any.

    The logarithm that detection studies fit to point counts; it keeps near vehicles from ruling a sum. No outer source:
    a baseline. On real cars it is about as linear in a detector's output as PE-VGOP (Pearson 0.79 and 0.77; 383 cars of
    KITTI, SECOND detector).
    """
    return np.log1p(returns.count)


@bl.metric(unit="points/m²", tells="how many beams return from it for each square metre of its footprint")
def areal_density(returns: VehicleReturns) -> np.ndarray:
    """Returns per area of the box's footprint, n / (l w) [points/m²], (n,).

    It stands where the density metric of Jin et al. (IEEE Sensors Journal 22(21):21009-21023, 2022) would: of that one
    it is known that it takes "the density of point clouds in the RoI", but its formula is not public, so this is not it
    and does not bear its name. Falls with the square of distance like the number of returns; between boxes of one size
    it orders them alike.
    """
    return returns.count / (returns.size_m[:, 0] * returns.size_m[:, 1])


@bl.metric(unit="points/m³", tells="how many beams return from it for each cubic metre of its box")
def volumetric_density(returns: VehicleReturns) -> np.ndarray:
    """Returns per volume of the box, n / (l w h) [points/m³], (n,).

    As `areal_density`, per volume. Returns come from surfaces, so that a large vehicle seen as densely as a small one
    has the lower value.
    """
    return returns.count / returns.size_m.prod(axis=1)


# --- From cubic voxels in a vehicle's box: how evenly returns fill them, and what share of them they fill -------------
# Voxels start in the box's rear right lower corner and are whole, `ceil` of each side over theirs, as the cells of
# PE-VGOP's views; returns on the rim or up to one voxel beyond it fall into the rim's voxel, further ones are dropped.

OCCUPANCY_VOXEL_M = 0.1


@bl.metric(unit="bits", needs=["points"], tells="how evenly its returns spread over voxels of 0.1 m")
def voxel_entropy_10_cm(returns: VehicleReturns) -> np.ndarray:
    """`spread` over voxels of 0.1 m [bits], (n,)."""
    return spread(returns, 0.1)


@bl.metric(unit="bits", needs=["points"], tells="how evenly its returns spread over voxels of 0.2 m")
def voxel_entropy_20_cm(returns: VehicleReturns) -> np.ndarray:
    """`spread` over voxels of 0.2 m [bits], (n,)."""
    return spread(returns, 0.2)


def spread(returns: VehicleReturns, voxel_m: float) -> np.ndarray:
    """Shannon entropy of the returns' distribution over voxels, -sum (c/n) log2 (c/n) [bits], (n,).

    c of a vehicle's n returns lie in a voxel. 0 without returns, with one, and with all in one voxel; at most log2 n.
    Unlike PE-VGOP it has no ceiling. More returns can lower it, where they crowd into few voxels. On real cars it is
    more linear in a detector's output than PE-VGOP (Pearson 0.85 at 0.1 and at 0.2 m, and 0.77; 383 cars of KITTI,
    SECOND detector); there is no outer source for it as a metric of placement.
    """
    row, count = _filled(returns, voxel_m)
    total = np.bincount(row, weights=count, minlength=len(returns))
    # log2 n - (1/n) sum c log2 c: the same without dividing each count, and exactly 0 for n returns in one voxel.
    crowding = np.bincount(row, weights=count * np.log2(count), minlength=len(returns))
    seen = np.where(total > 0.0, total, 1.0)
    return np.maximum(np.log2(seen) - crowding / seen, 0.0)


_IN_VOXELS = f"what share of the voxels of {OCCUPANCY_VOXEL_M} m in its box hold a return"


@bl.metric(label="share of occupied voxels", decimals=5, needs=["points"], tells=_IN_VOXELS)
def voxel_occupancy(returns: VehicleReturns) -> np.ndarray:
    """Share q of all the box's voxels that hold a return, (n,).

    Never less for one more return. Only the surface of a vehicle returns, and one side of it, so that q stays far below
    1, and the farther the larger the vehicle.
    """
    return share_filled(returns)


@bl.metric(unit="bits", decimals=4, needs=["points"], tells=f"{_IN_VOXELS}, turned into an entropy")
def voxel_occupancy_entropy(returns: VehicleReturns) -> np.ndarray:
    """-q log2 q of the share q of occupied voxels [bits], (n,).

    It stands where the perception entropy of Roos et al. (IEEE ITSC 2021, 3231-3237) would: it is known that theirs
    divides the space of a vehicle into voxels and turns the proportion of occupied ones into an entropy, but its
    formula is not public, so this is not it and does not bear its name. It rises with q up to 1/e, which the surface of
    a vehicle hardly reaches at 0.1 m.
    """
    return entropy(share_filled(returns))


def share_filled(returns: VehicleReturns) -> np.ndarray:
    """Share q of each box's voxels of 0.1 m that hold a return, (n,)."""
    row, _ = _filled(returns, OCCUPANCY_VOXEL_M)
    voxels = cell_counts(returns.size_m, grown(OCCUPANCY_VOXEL_M, returns.cell_growth)).prod(axis=1)
    return np.bincount(row, minlength=len(returns)) / voxels


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


# --- Perception entropy by Ma, Liu and Li: how uncertain a detector fed with so many returns leaves a position --------

SLOPE, INTERCEPT, MARGIN = 0.152, 0.659, 1e-3
"""a, b and epsilon of `expected_precision` for a LiDAR, as go4robo has them."""


@bl.metric(
    label="entropy of the position",
    unit="nats",
    lower_is_better=True,
    tells="how uncertain a detector is expected to leave its position",
)
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


def expected_precision(count: np.ndarray) -> np.ndarray:
    """Average precision that a detector is expected to have with m returns, clip(a ln m + b, eps, 1 - eps), (n,).

    Without any it is eps.
    """
    fitted = SLOPE * np.log(np.maximum(count, 1)) + INTERCEPT
    return np.where(count > 0, np.clip(fitted, MARGIN, 1.0 - MARGIN), MARGIN)


# --- How near a vehicle is: the yardstick that every other metric has to beat -----------------------------------------


@bl.metric(
    unit="m",
    decimals=2,
    lower_is_better=True,
    needs=["distance_m"],
    tells="how far from the LiDAR it is, horizontally",
)
def distance(returns: VehicleReturns) -> np.ndarray:
    """Horizontal distance from the LiDAR to the box centre [m], (n,); lower is better.

    No published metric but a control: detectors do worse far away, so that a metric which rises and falls with distance
    correlates with them whether it measures anything else or not. It knows nothing of beams, height, tilt or occlusion:
    between mountings in one place it does not choose. What is maximised is minus the distance.
    """
    return returns.distance_m
