"""One frame of traffic, made ready once, seen from any number of layouts of LiDARs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..casting import EXACT, caster_class
from ..casting.culling import Pieces, cut_vehicles, revolutions
from ..casting.protocol import Revolution, dot, take
from ..compiled import numba_works
from ..metrics.vgop import to_vehicle_frame
from ..metrics.view_grids import ViewGrids
from ..scene.observation import Observation
from ..sensors.pose import Pose
from ..signals import stops_recognised
from ..traffic.vehicles import Vehicles
from ..world.meshes import GLASS, REFLECTIVITY
from ..world.triangles import vehicle_triangles

# --- The vehicles of a frame as shapes, ready to be cast against: made once for any sensor and mounting ---


class FrameShapes:
    """Triangles of a frame's vehicles at one level of detail, in the tree of one caster.

    Parameters
    ----------
    vehicles : Vehicles
        All vehicles of the frame; each can hide another.
    counted : ndarray of bool, (n,)
        Those that are scored.
    detail : str
        Level of detail, of `world.shapes.DETAILS`.
    caster : str
        A name of `casting.CASTERS`.

    Attributes
    ----------
    counted : Vehicles
        The vehicles that are scored.
    tree : Caster
        Of all triangles.
    owner : ndarray of int32, (m,)
        Row of each triangle's vehicle in the frame.
    counted_row : ndarray of int64, (m,)
        Row of each triangle's vehicle among the counted; -1 where it does not count.
    surface : ndarray of uint8, (m,)
        What each triangle is made of, an index into `world.meshes.SURFACES`.
    """

    def __init__(self, vehicles: Vehicles, counted: np.ndarray, detail: str, caster: str) -> None:
        self.frame, self.detail, self.caster = vehicles.frame, detail, caster
        self.counted = vehicles.select(counted)
        triangles = vehicle_triangles(vehicles, detail)
        self.owner, self.surface = triangles.owner, triangles.surface
        rows = np.append(np.where(counted, np.cumsum(counted) - 1, -1), -1)  # the last is that of `STATIC`
        self.counted_row = rows[triangles.owner].astype(np.int64)
        self.tree = caster_class(caster)(triangles.corners, closed=True)

    @cached_property
    def pieces(self) -> Pieces:
        """The counted vehicles cut for culling: beams that can reach only others hide nothing from them."""
        return cut_vehicles(self.counted, self.detail)


# --- The frame scorer -------------------------------------------------------------------------------------------------


class Seen(NamedTuple):
    """What layouts saw of the counted vehicles of one frame, all their LiDARs together.

    Attributes
    ----------
    points : ndarray of int64, (s, n)
        Returns from each vehicle, for each layout.
    occupancy : ndarray, (s, n, 3)
        P of the top, side and front view; a cell that several LiDARs see is occupied once.
    returns : (ndarray, ndarray) or None
        If they were asked for: the returns of all layouts, each in its vehicle's frame, (k, 3) [m], and the row that
        each belongs to, (k,): vehicles are counted on from layout to layout, 0 to s n - 1.
    """

    points: np.ndarray
    occupancy: np.ndarray
    returns: tuple[np.ndarray, np.ndarray] | None = None


def singles(poses: Iterable[Pose]) -> list[tuple[Pose]]:
    """Layouts of one LiDAR each."""
    return [(pose,) for pose in poses]


class FrameScorer:
    """Frame scorer: casts the beams that can reach a vehicle of one frame and counts what they occupy.

    Compiled code (`compiled_frames`) does so where Numba is installed; NumPy's way is the one to read beside the paper,
    and decides where compiled code leaves something to rounding. Both find the same to the last digit.

    Parameters
    ----------
    vehicles : Vehicles
        All vehicles of the frame; each can hide another.
    counted : ndarray of bool, (n,)
        Those whose occupancy is wanted.
    observation : Observation
        The LiDARs of a layout, caster and detail. What their imperfections draw is kept: up to 8 bytes for each beam.
    shapes : FrameShapes, optional
        Of the same frame at the same detail behind the same caster, where they are made already.

    Attributes
    ----------
    vehicles : Vehicles
        The counted vehicles.
    shapes : FrameShapes
    grids : ViewGrids
        Of the counted vehicles.
    compiled : CompiledScorer or None
        Who does the same where Numba is installed, for a frame in which something counts.
    """

    def __init__(
        self,
        vehicles: Vehicles,
        counted: np.ndarray,
        observation: Observation,
        shapes: FrameShapes | None = None,
    ) -> None:
        self._observation = seen = observation.at(vehicles.time_s)
        self.shapes = shapes or FrameShapes(vehicles, counted, seen.detail, seen.caster)
        self.vehicles = self.shapes.counted
        self._measurements = [lidar.measurement(vehicles.frame) for lidar in seen.lidars]
        self.grids = ViewGrids(self.vehicles.size_m, seen.cell_m, seen.reading)
        self.compiled = None
        if numba_works() and seen.caster != EXACT and len(self) and len(self.shapes.tree.rows):
            from .compiled_frames import CompiledScorer

            self.compiled = CompiledScorer(self.shapes, self.grids, seen, self._measurements)

    def __len__(self) -> int:
        return len(self.vehicles)

    @stops_recognised()
    def see(self, layouts: Sequence[Sequence[Pose]], *, keep_returns: bool = False) -> Seen:
        """What each of s layouts sees of the n counted vehicles; the returns themselves only where they are kept.

        A layout is a pose for each LiDAR, in their order.
        """
        if self.compiled is None or keep_returns:
            return self.seen_of(layouts, self._revolutions(layouts), keep_returns=keep_returns)
        points, cells, undecided = self.compiled.see(layouts)
        shares = self.grids.shares(cells)
        for row in undecided.tolist():
            one = layouts[row : row + 1]
            seen = self.seen_of(one, self._revolutions(one))
            points[row], shares[row] = seen.points[0], seen.occupancy[0]
        return Seen(points, shares)

    def vehicle_points(self, *layout: Pose) -> tuple[np.ndarray, np.ndarray]:
        """Returns from counted vehicles: points (k, 3), each in its vehicle's frame [m], and vehicle rows (k,)."""
        (found,) = self._revolutions([layout])
        return self._returns(layout, found)

    def _returns(self, layout, turn):
        """The same, given what the beams of each LiDAR met."""
        parts = [
            self.returns_of(pose, hits, lidar) for lidar, (pose, hits) in enumerate(zip(layout, turn, strict=True))
        ]
        return parts[0] if len(parts) == 1 else tuple(map(np.concatenate, zip(*parts, strict=True)))

    def returns_of(self, pose: Pose, hits: Revolution, lidar: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Returns of one LiDAR from counted vehicles, as `vehicle_points`, given what its beams met."""
        scenery, measurement = self._observation.scenery, self._measurements[lidar]
        row = take(self.shapes.counted_row, hits.triangle)
        surface = self._surface(hits) if measurement.asks_for_surface else ()
        distance = measurement.measured(hits.beam, hits.distance, *surface)
        wanted = np.flatnonzero((row >= 0) & (distance < np.inf))
        directions = take(hits.directions, wanted, axis=1)
        if scenery is not None:
            shown = ~scenery.hides(pose.position, directions.T, take(hits.distance, wanted))
            wanted, directions = wanted[shown], directions[:, shown]
        distance, row = take(distance, wanted), take(row, wanted)
        points = pose.position + (distance * directions).T  # Eqs. 2 and 3, the range scaling the direction alone
        return to_vehicle_frame(points, self.vehicles.centre_m, self.vehicles.heading_rad, row), row  # Eqs. 4 and 5

    def _revolutions(self, layouts):
        """What the beams of each LiDAR of each layout meet, layout after layout."""
        tree, pieces = self.shapes.tree, self.shapes.pieces if self._observation.culled else None
        turns = [
            revolutions(tree, lidar.lattice, [layout[number] for layout in layouts], lidar.reach_m, pieces)
            for number, lidar in enumerate(self._observation.lidars)
        ]
        return zip(*turns, strict=True)

    def _surface(self, hits):
        """Whether hits are on glass, their reflectivity and the cosine of their incidence."""
        surface = take(self.shapes.surface, hits.triangle)
        cosine = np.abs(dot(self.shapes.tree.normals(hits.triangle).T, hits.directions))
        return surface == GLASS, REFLECTIVITY[surface], cosine

    def seen_of(
        self, layouts: Sequence[Sequence[Pose]], turns: Iterable[Sequence[Revolution]], *, keep_returns: bool = False
    ) -> Seen:
        """As `see`, given what the beams of each LiDAR of each layout met, in turn."""
        points = np.zeros((len(layouts), len(self)), dtype=np.int64)
        shares = np.zeros((len(layouts), len(self), 3))
        kept = [(np.empty((0, 3)), np.empty(0, dtype=np.int64))]
        for number, (layout, turn) in enumerate(zip(layouts, turns, strict=True)):
            local, row = self._returns(layout, turn)
            points[number] = np.bincount(row, minlength=len(self))
            shares[number] = self.grids.occupancy(local, row)  # Eqs. 6 to 8
            if keep_returns:
                kept.append((local, number * len(self) + row))
        return Seen(points, shares, tuple(map(np.concatenate, zip(*kept, strict=True))) if keep_returns else None)
