"""Rings and beams of recorded clouds: which beam of a known sensor each point came back on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..sensors.beams import TURN_RAD, BeamLattice
from ..sensors.identify import nearest_ring
from .scan import PointCloud

LEAST_ON_RINGS = 0.85
"""Share of the points near the rings of a beam table (`table_rings`) below which the table is not the cloud's."""


@dataclass(frozen=True, slots=True, eq=False)
class Rings:
    """The rings of one revolution; ring 0 is the lowest.

    Attributes
    ----------
    ring : ndarray of int64, (n,)
        Ring of each point.
    elevation_rad : ndarray, (r,)
        Angle of each ring above the horizontal, seen from its own laser [rad]; rising, except for rings of few returns.
    height_m : ndarray, (r,)
        Where the ring's rays cross the sensor's axis, above the origin [m].
    lateral_m : ndarray, (r,)
        How far its rays pass the axis by, to the left of their direction [m]; 0, as the height is, by a beam table.
    step_rad : float
        Mean azimuth from one firing to the next [rad].
    spread_m : float
        Median distance of the points from their rings' cones, upwards [m].
    """

    ring: np.ndarray
    elevation_rad: np.ndarray
    height_m: np.ndarray
    lateral_m: np.ndarray
    step_rad: float
    spread_m: float

    def __len__(self) -> int:
        return len(self.elevation_rad)


def table_rings(points: np.ndarray, lattice: BeamLattice) -> tuple[Rings, float]:
    """The rings of a known sensor, and how well its beam table fits a cloud.

    Parameters
    ----------
    points : ndarray, (n, 3)
        Returns in the sensor's frame, in any order [m].
    lattice : BeamLattice

    Returns
    -------
    rings : Rings
        Every ring of the table; each point belongs to the one with the nearest elevation.
    share : float
        Of the points, how many are within a quarter of the spacing of rings from a ring: about a half where the table
        has nothing to do with the cloud, nearly all where sensor, pose and table are right.
    """
    elevation, rho = lattice.elevation_rad, np.hypot(points[:, 0], points[:, 1])
    seen = np.arctan2(points[:, 2], rho)
    above = np.clip(np.searchsorted(elevation, seen), 1, len(elevation) - 1)
    gap = elevation[above] - elevation[above - 1]
    ring = nearest_ring(seen, elevation)
    share = float((np.abs(seen - elevation[ring]) <= 0.25 * gap).mean()) if len(points) else 0.0
    off = np.abs(points[:, 2] - rho * np.tan(elevation[ring]))
    none = np.zeros(len(elevation))
    spread_m = float(np.median(off)) if len(points) else math.nan
    return Rings(ring, elevation, none, none, lattice.step_rad, spread_m), share


def rings_of(points: np.ndarray, lattice: BeamLattice, where: str) -> tuple[Rings, float]:
    """The same, and refused where the beam table is not the cloud's; `where` it came from.

    Raises
    ------
    InputError
        For fewer than `LEAST_ON_RINGS` near the rings.
    """
    rings, share = table_rings(points, lattice)
    if len(points) and share < LEAST_ON_RINGS:
        raise InputError(
            f"{where}: {100.0 * share:.0f} % of its {len(points)} points are near the rings of "
            f"{lattice.model.name}, where chance gives 50 %; allowed: {100.0 * LEAST_ON_RINGS:.0f} % or more. "
            "Another sensor, or other axes, or another place or tilt of it in the frame of the cloud"
        )
    return rings, share


def beam_phase(clouds: Iterable[np.ndarray], lattice: BeamLattice) -> np.ndarray:
    """How far the columns of a sensor that stands still lie off its lattice, (r,) [rad]: circular means by ring.

    A unit fires its rings a fraction of a step after each other, and a locked one at the same azimuths in each turn.
    `clouds` are points (n, 3) in the sensor's frame [m].
    """
    turns = np.zeros(lattice.rings, dtype=complex)
    for points in clouds:
        ring = table_rings(points, lattice)[0].ring
        np.add.at(turns, ring, np.exp(1j * TURN_RAD / lattice.step_rad * _off_slot_0(points, ring, lattice)))
    return np.angle(turns) / TURN_RAD * lattice.step_rad


def on_beams(points: np.ndarray, xyz: np.ndarray, lattice: BeamLattice, phase: np.ndarray, where: str) -> PointCloud:
    """A recorded cloud with the beam of each point: its ring by elevation, its azimuth the beam's in the lattice.

    Parameters
    ----------
    points, xyz : ndarray, (n, 3)
        In the sensor's frame, and in that of the road [m].
    lattice : BeamLattice
    phase : ndarray, (r,)
        As of `beam_phase`.
    where : str
        For messages: the file.
    """
    ring = rings_of(points, lattice, where)[0].ring
    slot = np.rint((_off_slot_0(points, ring, lattice) - phase[ring]) / lattice.step_rad).astype(np.int64)
    azimuth, none = lattice.azimuth_rad(ring, slot % lattice.columns), np.zeros((6, len(points)))
    return PointCloud(xyz, np.linalg.norm(points, axis=1), ring.astype(np.uint16), azimuth, *none)


def _off_slot_0(points: np.ndarray, ring: np.ndarray, lattice: BeamLattice) -> np.ndarray:
    """Azimuth of points from slot 0 of their rings, clockwise [rad]."""
    return np.arctan2(points[:, 0], points[:, 1]) - lattice.slot_azimuth0_rad[ring]
