"""One unit of a model: its beams as they came out of the factory, not as the data sheet has them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..errors import InputError
from .model import LidarModel

MOST_SPREAD_DEG = 5.0


def unit_of(model: LidarModel, spread_deg: float, unit: int) -> LidarModel:
    """A model as one of its units: every ring's elevation and azimuth offset with a normal error of its own.

    Elevations of real units differ from nominal by about 0.03 degree: those of four RS-LiDAR-16 by 0.031 (standard
    deviation), of three RS-LiDAR-32 by 0.015 to 0.029 (their calibrations, in ros_rslidar and other drivers).

    Where beams of this unit lie in another order than the model's, its rings are numbered anew from its lowest beam up,
    as the maker's driver does from a unit's calibration (rs_driver, ``ChanAngles::genUserChan``). Refusing such units
    would leave out what must be common: errors of 0.03 degree swap neighbours of the RS-80's ladder of 0.1 degree in
    three units out of ten, and in six out of ten of the RS-Ruby-128.

    Parameters
    ----------
    model : LidarModel
        The nominal sensor.
    spread_deg : float
        Standard deviation of both errors [degrees], 0 to `MOST_SPREAD_DEG`; at 0 the model itself is returned.
    unit : int
        Which unit, 0 or more. The same unit draws the same errors, in proportion to the spread.

    Raises
    ------
    InputError
        For a spread or a unit out of range, or a unit with a beam beyond the vertical.
    """
    if not 0.0 <= spread_deg <= MOST_SPREAD_DEG:  # NaN fails too
        raise InputError(f"the spread between units is {spread_deg} degrees; allowed: 0 to {MOST_SPREAD_DEG:g}")
    if unit < 0 or unit != int(unit):
        raise InputError(f"the unit is {unit}; allowed: a whole number, 0 or more")
    if spread_deg == 0.0:
        return model
    error = np.random.Generator(np.random.PCG64(int(unit))).standard_normal((2, model.rings))
    elevation, azimuth_offset = (model.elevation_rad, model.azimuth_offset_rad) + math.radians(spread_deg) * error
    steepest = int(np.argmax(np.abs(elevation)))
    if abs(elevation[steepest]) > 0.5 * math.pi:
        raise InputError(
            f"unit {unit} of {model.name} has ring {steepest} at {math.degrees(elevation[steepest]):.2f} degrees with "
            f"a spread of {spread_deg:g}; allowed: a spread that leaves every beam between -90 and 90"
        )
    upwards = np.argsort(elevation, kind="stable")
    beams = {
        "elevation_rad": elevation[upwards],
        "azimuth_offset_rad": azimuth_offset[upwards],
        "fire_time_s": model.fire_time_s[upwards],
    }
    for values in beams.values():
        values.setflags(write=False)
    return replace(model, **beams)
