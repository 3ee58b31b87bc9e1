"""Where the beams point during one turn: Eq. 1, and the turn as a lattice of rings and azimuth slots."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .model import LidarModel

TURN_RAD = 2.0 * math.pi


def beam_directions(azimuth: np.ndarray | float, elevation: np.ndarray | float) -> np.ndarray:
    """Unit vectors of beams in the sensor frame (Eq. 1).

    Parameters
    ----------
    azimuth : array_like, (...)
        Azimuth [rad] from +y, clockwise seen from above, towards +x.
    elevation : array_like, (...)
        Angle above the xy plane [rad]; broadcast against `azimuth`.

    Returns
    -------
    ndarray, (..., 3)
        ``(sin a cos b, cos a cos b, sin b)``, C-contiguous float64.
    """
    azimuth, elevation = np.broadcast_arrays(azimuth, elevation)
    level = np.cos(elevation)
    return np.stack([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(elevation)], axis=-1)  # Eq. 1


@dataclass(frozen=True, slots=True, eq=False)
class BeamLattice:
    """All beams of one turn, each ring sorted by azimuth.

    A sensor fires column after column; a ring whose azimuth offset is not 0 looks away from its column's azimuth, so
    that beams of one column do not lie side by side. Here each ring is turned back: its beams are numbered by **slot**,
    in the order of their true azimuth, and ::

        azimuth of (ring, slot)       = slot_azimuth0_rad[ring] + slot * step_rad, in [0, 2 pi)
        firing column of (ring, slot) = (slot - shift[ring]) % columns

    The first says that in every ring an interval of azimuths is a contiguous range of slots (two, if it contains
    azimuth 0), found by one division: this is what culling uses. The second leads back to the sensor's own order,
    which carries the time.

    Attributes
    ----------
    model : LidarModel
        The sensor.
    rotation_hz : float
        Its rotation rate [Hz].
    columns : int
        Firing columns in this turn, and so slots in each ring.
    step_rad : float
        Azimuth between neighbouring slots [rad]: 2 pi / columns.
    slot_azimuth0_rad : ndarray, (rings,)
        Azimuth of slot 0 [rad], in [0, step_rad).
    shift : ndarray of int, (rings,)
        Slot of firing column 0, in [0, columns).
    components : ndarray, (3, rings, columns)
        Unit vectors by (ring, slot) in the sensor frame, coordinate by coordinate; C-contiguous float64, read-only.
    """

    model: LidarModel
    rotation_hz: float
    columns: int
    step_rad: float
    slot_azimuth0_rad: np.ndarray
    shift: np.ndarray
    components: np.ndarray

    @property
    def directions(self) -> np.ndarray:
        """Unit vectors by (ring, slot) in the sensor frame, (rings, columns, 3): a view of `components`."""
        return np.moveaxis(self.components, 0, -1)

    @property
    def rings(self) -> int:
        """Number of rings; ring 0 is the lowest."""
        return self.model.rings

    @property
    def elevation_rad(self) -> np.ndarray:
        """Elevation of each ring, (rings,) [rad], rising."""
        return self.model.elevation_rad

    @property
    def outside(self) -> np.ndarray | None:
        """Which beams point outside the sensor's horizontal field of view, (rings * columns,); None in a full turn."""
        if self.model.azimuth_deg is None:
            return None
        low, high = np.radians(self.model.azimuth_deg)
        azimuth = self.azimuth_rad(np.arange(self.rings)[:, None], np.arange(self.columns))
        return ((azimuth - low) % TURN_RAD > high - low).ravel()

    def column(self, ring: np.ndarray | int, slot: np.ndarray | int) -> np.ndarray:
        """Firing column of beams, in [0, columns); `ring` and `slot` broadcast."""
        return (slot - self.shift[ring]) % self.columns

    def azimuth_rad(self, ring: np.ndarray | int, slot: np.ndarray | int) -> np.ndarray:
        """Azimuth of beams [rad], in [0, 2 pi), rising with the slot; `ring` and `slot` broadcast."""
        azimuth = self.slot_azimuth0_rad[ring] + slot * self.step_rad
        return np.minimum(azimuth, math.nextafter(TURN_RAD, 0.0))  # the sum may round up to a full turn

    def time_s(self, ring: np.ndarray | int, slot: np.ndarray | int) -> np.ndarray:
        """Firing time of beams after the start of the turn [s]; `ring` and `slot` broadcast.

        The column's time plus the ring's own; where no source gives the latter, the column's time alone.
        """
        within_column = np.nan_to_num(self.model.fire_time_s[ring], nan=0.0)
        return self.column(ring, slot) / (self.rotation_hz * self.columns) + within_column


def beam_lattice(
    model: LidarModel, rotation_hz: float | None = None, phase_rad: float = 0.0, stride: int = 1
) -> BeamLattice:
    """All beams of one turn of a sensor.

    Parameters
    ----------
    model : LidarModel
        The sensor.
    rotation_hz : float, optional
        One of its rotation rates [Hz]; its default when None.
    phase_rad : float
        Azimuth of firing column 0 [rad].
    stride : int
        Keep every `stride`-th firing column, for a coarser and faster turn. Where it does not divide the number of
        columns, ``round(columns / stride)`` columns are spread evenly, so that the turn stays a lattice.

    Raises
    ------
    InputError
        A rate that the sensor does not have, or a stride out of range.
    """
    all_columns = model.columns(rotation_hz)
    if not 1 <= stride <= all_columns or stride != int(stride):
        raise InputError(f"stride is {stride}; allowed: whole numbers from 1 to the {all_columns} columns of a turn")
    columns = round(all_columns / stride)
    step = TURN_RAD / columns
    first_column = np.mod(phase_rad + model.azimuth_offset_rad, TURN_RAD)
    shift, slot_azimuth0 = np.divmod(first_column, step)
    shift = shift.astype(np.intp) % columns
    slot_azimuth = slot_azimuth0[:, None] + step * np.arange(columns)
    directions = beam_directions(slot_azimuth, model.elevation_rad[:, None])
    components = np.ascontiguousarray(np.moveaxis(directions, -1, 0))
    for array in (shift, slot_azimuth0, components):
        array.setflags(write=False)
    return BeamLattice(
        model=model,
        rotation_hz=model.rotation_rate(rotation_hz),
        columns=columns,
        step_rad=step,
        slot_azimuth0_rad=slot_azimuth0,
        shift=shift,
        components=components,
    )
