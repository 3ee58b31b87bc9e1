"""A frame scored the plain way: every beam cast against every triangle, one mounting after another.

Experiments change one step of it; what `FrameScorer` does faster it comes to as well, and so judges both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..casting import CASTERS, RASTER, caster_class, is_available
from ..casting.protocol import Caster, origins_of
from ..errors import InputError
from ..metrics.vgop import occupancy, to_vehicle_frame
from ..sensors.imperfections import PERFECT
from ..sensors.pose import Pose
from ..study.frame_scorer import Observation, Seen
from ..study.scoring import CountedFrame
from ..traffic.vehicles import Vehicles
from ..world.triangles import Triangles, vehicle_triangles


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """Returns from counted vehicles of one mounting.

    Attributes
    ----------
    direction : ndarray, (k, 3)
        Of each beam.
    distance : ndarray, (k,)
        Along it [m].
    row : ndarray of int, (k,)
        Of the counted vehicle that was met.
    centre_m : ndarray, (k, 3)
        Where that vehicle's box is taken to be [m, road frame].
    """

    direction: np.ndarray
    distance: np.ndarray
    row: np.ndarray
    centre_m: np.ndarray


class PlainScorer:
    """As `FrameScorer`, of a perfect sensor.

    Parameters
    ----------
    frame : CountedFrame
    observation : Observation
    triangles : Triangles, optional
        What stands for the frame's vehicles; those of the observation's detail if left out.

    Raises
    ------
    InputError
        For an imperfect sensor: what is drawn belongs to the product's own scorer.
    """

    def __init__(self, frame: CountedFrame, observation: Observation, triangles: Triangles | None = None) -> None:
        check_perfect(observation)
        self._frame, self._observation = frame, observation
        self.vehicles: Vehicles = frame.vehicles.select(frame.counted)
        self._counted_row = np.where(frame.counted, np.cumsum(frame.counted) - 1, -1)
        self._tree, self._owner = self._against(triangles or vehicle_triangles(frame.vehicles, observation.detail))

    def __len__(self) -> int:
        return len(self.vehicles)

    def see(self, poses: Sequence[Pose], *, keep_returns: bool = False) -> Seen:
        """What each of s mountings sees of the n counted vehicles."""
        points, shares, kept = [], [], []
        for number, pose in enumerate(poses):
            shots = self._shots(pose)
            local = self._local(pose.position, shots)
            points.append(np.bincount(shots.row, minlength=len(self)))
            shares.append(self._occupancy(local, shots.row))
            kept.append((local, number * len(self) + shots.row))
        returns = tuple(map(np.concatenate, zip(*kept, strict=True))) if keep_returns and kept else None
        return Seen(np.array(points).reshape(-1, len(self)), np.array(shares).reshape(-1, len(self), 3), returns)

    def _against(self, triangles: Triangles) -> tuple[Caster, np.ndarray]:
        tree = caster_class(_caster_of_rays(self._observation.caster))(triangles.corners, closed=True)
        return tree, self._counted_row[triangles.owner]

    def _shots(self, pose: Pose) -> Shots:
        directions = pose.to_world(self._observation.lattice.directions.reshape(-1, 3))
        return self._met(pose, directions, self._tree, self._owner, self.vehicles.centre_m)

    def _met(self, pose, directions, tree, owner, centre_m) -> Shots:
        """The returns of some beams against a tree whose triangles belong to counted rows, or to -1."""
        seen = self._observation
        found = tree.meet(pose.position, directions, seen.max_range_m)
        row = owner[found.triangle]
        wanted = np.flatnonzero((row >= 0) & (found.distance >= seen.min_range_m))
        ray, distance, row = found.ray[wanted], found.distance[wanted], row[wanted]
        if seen.scenery is not None:
            shown = ~seen.scenery.hides(origins_of(pose.position, ray), directions[ray], distance)
            ray, distance, row = ray[shown], distance[shown], row[shown]
        return Shots(directions[ray], distance, row, centre_m[row])

    def _local(self, origin: np.ndarray, shots: Shots) -> np.ndarray:
        """Returns in the frames of their vehicles, (k, 3) [m]."""
        points = origin + shots.direction * shots.distance[:, None]
        return to_vehicle_frame(points, shots.centre_m, self.vehicles.heading_rad[shots.row])

    def _occupancy(self, local: np.ndarray, row: np.ndarray) -> np.ndarray:
        return occupancy(local, row, self.vehicles.size_m, self._observation.cell_m, self._observation.reading)


def check_perfect(observation: Observation) -> None:
    """Refuse an imperfect sensor."""
    if replace(observation.imperfections, seed=PERFECT.seed) != PERFECT:
        raise InputError("the scene's sensor is imperfect, and this experiment is made with a perfect one")


class SinglePrecisionScorer(PlainScorer):
    """What is cast becomes float32, and so does all that is made of it up to the place in the vehicle."""

    def _local(self, origin, shots):
        narrow = np.float32
        points = origin.astype(narrow) + shots.direction.astype(narrow) * shots.distance.astype(narrow)[:, None]
        away = points - shots.centre_m.astype(narrow)
        heading = self.vehicles.heading_rad.astype(narrow)[shots.row]
        cos, sin = np.cos(heading), np.sin(heading)
        ahead, left = cos * away[:, 0] + sin * away[:, 1], cos * away[:, 1] - sin * away[:, 0]
        return np.stack([ahead, left, away[:, 2]], axis=1).astype(float)


def _caster_of_rays(caster: str) -> str:
    """The scene's caster; for the one that is best at whole turns another that is fast, where one is installed."""
    others = [name for name in CASTERS[:-1] if name != RASTER and is_available(name)]
    return others[0] if caster == RASTER and others else caster
