"""Metrics from cubic voxels in a vehicle's box: how evenly returns fill them, and what share of them they fill.

Voxels start in the box's rear right lower corner and are whole, `ceil` of each side over theirs, as the cells of
PE-VGOP's views; returns on the rim or up to one voxel beyond it fall into the rim's voxel, further ones are dropped.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from ..errors import InputError
from .metric import POINTS, Metric, VehicleReturns
from .vgop import entropy
from .view_grids import ViewGrids, cell_counts

OCCUPANCY_VOXEL_M = 0.1
_MOST_VOXELS = 2**62  # of all boxes together: they are numbered with 64 bits


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


def voxel_occupancy(returns: VehicleReturns, voxel_m: float = OCCUPANCY_VOXEL_M) -> np.ndarray:
    """Share q of all the box's voxels that hold a return, (n,).

    Never less for one more return. Only the surface of a vehicle returns, and one side of it, so that q stays far below
    1, and the farther the larger the vehicle.
    """
    row, _ = _filled(returns, voxel_m)
    return np.bincount(row, minlength=len(returns)) / cell_counts(returns.size_m, voxel_m).prod(axis=1)


def voxel_occupancy_entropy(returns: VehicleReturns, voxel_m: float = OCCUPANCY_VOXEL_M) -> np.ndarray:
    """-q log2 q of the share q of occupied voxels [bits], (n,).

    It stands where the perception entropy of Roos et al. (IEEE ITSC 2021, 3231-3237) would: it is known that theirs
    divides the space of a vehicle into voxels and turns the proportion of occupied ones into an entropy, but its
    formula is not public, so this is not it and does not bear its name. It rises with q up to 1/e, which the surface of
    a vehicle hardly reaches at 0.1 m.
    """
    return entropy(voxel_occupancy(returns, voxel_m))


def _filled(returns, voxel_m):
    """Vehicle (u,) and number of returns (u,) of every voxel that holds any, vehicle after vehicle."""
    cells = cell_counts(returns.size_m, voxel_m)
    if float(cells.prod(axis=1, dtype=float).sum()) > _MOST_VOXELS:
        raise InputError(f"boxes have too many voxels of {voxel_m:g} m; allowed: {_MOST_VOXELS:,} together")
    (x, y, z), vehicle = ViewGrids(returns.size_m, voxel_m).cells_of(returns.points, returns.vehicle)
    voxels = cells.prod(axis=1)
    first = np.cumsum(voxels) - voxels  # number of each box's first voxel
    voxel = first[vehicle] + (x * cells[vehicle, 1] + y) * cells[vehicle, 2] + z
    filled, count = np.unique(voxel, return_counts=True)
    return np.searchsorted(first, filled, side="right") - 1, count


def _metric(name, label, unit, score, tells, decimals=3):
    return Metric(name, label, unit, True, score, frozenset({POINTS}), tells=tells, decimals=decimals)


VOXEL_ENTROPY_01, VOXEL_ENTROPY_02 = (
    _metric(
        f"voxel-entropy-{voxel_m}",
        f"voxel entropy ({voxel_m} m)",
        "bits",
        partial(voxel_entropy, voxel_m=voxel_m),
        f"how evenly its returns spread over voxels of {voxel_m} m",
    )
    for voxel_m in (0.1, 0.2)
)
VOXEL_OCCUPANCY = _metric(
    "voxel-occupancy",
    "share of occupied voxels",
    "",
    voxel_occupancy,
    f"what share of the voxels of {OCCUPANCY_VOXEL_M} m in its box hold a return",
    decimals=5,
)
VOXEL_OCCUPANCY_ENTROPY = _metric(
    "voxel-occupancy-entropy",
    "voxel occupancy entropy",
    "bits",
    voxel_occupancy_entropy,
    f"what share of the voxels of {OCCUPANCY_VOXEL_M} m in its box hold a return, turned into an entropy",
    decimals=4,
)
