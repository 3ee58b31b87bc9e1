"""Triangles of a frame's vehicles, placed in the road frame, with the vehicle that owns each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..traffic.boxes import Boxes
from ..traffic.fleet import BODIES, FLEET
from ..traffic.vehicles import FLEET_KINDS, fleet_kind
from .shapes import shape

STATIC = -1  # owner of what belongs to no vehicle
MOST_M = 1e15  # of a coordinate: of what is farther away not even casters in float64 can tell the shape


@dataclass(frozen=True, slots=True)
class Triangles:
    """Triangles in the road frame.

    Attributes
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m], counter-clockwise seen from outside.
    owner : ndarray of int32, (m,)
        Row of the vehicle that a triangle belongs to, or `STATIC`.
    surface : ndarray of uint8, (m,)
        Index into `meshes.SURFACES`.
    """

    corners: np.ndarray
    owner: np.ndarray
    surface: np.ndarray

    def __len__(self) -> int:
        return len(self.corners)


def vehicle_triangles(vehicles: Boxes, detail: str = "body", own: np.ndarray | None = None) -> Triangles:
    """Every vehicle of a frame as triangles at the level of detail `detail` of `names.DETAILS`.

    Those that are `own`, (n,) bool, are left out: they have a mesh of the user's.

    Raises
    ------
    InputError
        For a vehicle whose place is not finite or whose size is not above 0, by its number: rays would miss it.
    """
    _check_boxes(vehicles)
    names = shape_names(vehicles)
    ours = np.ones(len(vehicles), dtype=bool) if own is None else ~own
    corners, owner, surface = [np.empty((0, 3, 3))], [np.empty(0, np.int32)], [np.empty(0, np.uint8)]
    for name in sorted(set(names[ours].tolist())):
        rows = np.flatnonzero(ours & (names == name))
        unit = shape(name, detail)
        placed = place(unit.vertices, vehicles.centre_m[rows], vehicles.size_m[rows], vehicles.heading_rad[rows])
        corners.append(placed[:, unit.faces].reshape(-1, 3, 3))
        owner.append(np.repeat(rows.astype(np.int32), len(unit.faces)))
        surface.append(np.tile(unit.surface, len(rows)))
    return Triangles(np.concatenate(corners), np.concatenate(owner), np.concatenate(surface))


def _check_boxes(vehicles):
    placed = (np.abs(vehicles.centre_m) < MOST_M).all(axis=1) & np.isfinite(vehicles.heading_rad)
    sized = ((vehicles.size_m > 0.0) & (vehicles.size_m < MOST_M)).all(axis=1)
    if (placed & sized).all():
        return
    row = int(np.flatnonzero(~(placed & sized))[0])
    who = f"vehicle {vehicles.vehicle_id[row]} of frame {vehicles.frame}"
    if not placed[row]:
        at = f"{vehicles.centre_m[row].tolist()} m, its heading {vehicles.heading_rad[row]} rad"
        raise InputError(f"{who}: its centre is {at}; allowed: finite, and less than {MOST_M:g} m from 0")
    raise InputError(f"{who}: its size is {vehicles.size_m[row].tolist()} m; allowed: lengths above 0 m")


def shape_names(vehicles: Boxes) -> np.ndarray:
    """Name of the shape of each vehicle, (n,) str."""
    kind = fleet_kind(vehicles.class_index, vehicles.size_m[:, 0])
    usual = np.array([FLEET[name][0].name for name in FLEET_KINDS])[kind]
    return usual if vehicles.body is None else np.where(vehicles.body, np.array(BODIES)[vehicles.body - 1], usual)


def place(unit_points: np.ndarray, centre: np.ndarray, size: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """Points of the unit box, scaled, turned and moved into each of several vehicles' boxes.

    Parameters
    ----------
    unit_points : ndarray, (p, 3) or (n, p, 3)
        Points with coordinates in [-0.5, 0.5], the same for all vehicles or of each.
    centre, size : ndarray, (n, 3)
        Box centres and length, width, height [m].
    heading : ndarray, (n,)
        Counter-clockwise from +x [rad].

    Returns
    -------
    ndarray, (n, p, 3)
        Points in the frame of `centre` [m].
    """
    local = unit_points * size[:, None, :]
    cos, sin = np.cos(heading)[:, None], np.sin(heading)[:, None]
    placed = np.empty_like(local)
    placed[..., 0] = cos * local[..., 0] - sin * local[..., 1]
    placed[..., 1] = sin * local[..., 0] + cos * local[..., 1]
    placed[..., 2] = local[..., 2]
    placed += centre[:, None, :]
    return placed
