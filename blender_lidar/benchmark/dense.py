"""Made-up traffic to grow: any number of cars within a half-disc about the sensor, the more the denser."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..study.scoring import CountedFrame
from ..traffic.vehicles import CLASSES, Vehicles

RADIUS_M = 150.0
_SETBACK_M, _LANE_M, _SPACING_M = 2.0, 3.66, 7.5
_SIZES = {"car": (4.5, 1.85, 1.5), "van": (5.2, 2.0, 1.9)}
_VANS = 0.25


def dense_frame(vehicles: int, frame: int = 0) -> CountedFrame:
    """Cars and vans in lanes from y = 2 m on, all within `RADIUS_M` of the origin, apart from each other.

    They stand in places drawn at random for each frame; those of fewer vehicles are among those of more.

    Raises
    ------
    InputError
        For more than there is room for.
    """
    places = _places()
    if not 1 <= vehicles <= len(places):
        raise InputError(f"{vehicles} vehicles within {RADIUS_M:g} m; allowed: 1 to {len(places)}")
    rng = np.random.default_rng(frame)
    chosen = rng.permutation(len(places))[:vehicles]
    is_van = rng.random(len(places))[chosen] < _VANS
    size = np.where(is_van[:, None], _SIZES["van"], _SIZES["car"])
    x, y = (places[chosen] + rng.uniform(-0.4, 0.4, places.shape)[chosen]).T
    heading = rng.normal(0.0, 0.01, len(places))[chosen]
    table = Vehicles(
        frame=frame,
        time_s=float(frame),
        vehicle_id=chosen.astype(np.int64),
        class_index=np.where(is_van, CLASSES.index("van"), CLASSES.index("car")).astype(np.int8),
        centre_m=np.column_stack([x, y, size[:, 2] / 2.0]),
        size_m=size,
        heading_rad=heading,
        lane=np.zeros(vehicles, dtype=np.int16),
    )
    return CountedFrame(table, np.ones(vehicles, dtype=bool))


def _places() -> np.ndarray:
    """Where a vehicle can stand, (p, 2) [m]: middles of equal stretches of lanes within the half-disc."""
    x = np.arange(-RADIUS_M, RADIUS_M, _SPACING_M) + _SPACING_M / 2.0
    y = np.arange(_SETBACK_M, RADIUS_M, _LANE_M) + _LANE_M / 2.0
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return grid[np.hypot(*grid.T) < RADIUS_M - 1.0]
