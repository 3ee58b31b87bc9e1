"""Live preview: one frame kept ready, whose cloud and scores come of one cast from wherever the LiDAR is dragged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..casting.protocol import Revolution
from ..scene.observation import Observation, Scoring
from ..scoring.frame_scorer import FrameScorer, FrameShapes
from ..scoring.scores import Scored, VehicleScores
from ..sensors.pose import Pose
from ..traffic.boxes import Boxes
from .scan import FrameScan, PointCloud, Stands

DRAG_M = 60.0  # so far to each side a LiDAR moves before the tree of the scenery is made again


class Look(NamedTuple):
    """What one mounting makes of a frame.

    Attributes
    ----------
    cloud : PointCloud
        As from `scan`.
    scored : Scored or None
        Of this one mounting, as from `VehicleScores`; None where nothing is scored.
    pose, hits : Pose, Revolution
        Where it looked from, and what its beams met of the vehicles, behind nothing that stands still.
    counted : ndarray of bool, (v,)
        Which vehicles are scored.
    """

    cloud: PointCloud
    scored: Scored | None
    pose: Pose
    hits: Revolution
    counted: np.ndarray


class LiveFrame:
    """Live frame: its triangles, pieces, tree and scorer, kept while the LiDAR moves.

    Cloud and scores are those of `scan` and `FrameScorer`, to the last digit.

    Parameters
    ----------
    frame : Boxes
        The frame, and which of its vehicles are scored.
    observation : Observation
        Sensor, range gate, caster, detail, scenery and imperfections.
    scoring : Scoring or None
        How vehicles are scored; None leaves that out. A metric with a memory learns from this frame alone.
    ground : bool
        Whether the road, the plane z = 0, returns. It hides no vehicle from being scored.

    Attributes
    ----------
    frame, observation, scoring, shapes
        What it was made of, the observation as it is at the frame's moment.
    """

    def __init__(self, frame: Boxes, observation: Observation, scoring: Scoring | None, *, ground: bool = True) -> None:
        self.frame, self.scoring = frame, scoring
        self.observation = observation = observation.at(frame.time_s)
        self.shapes = FrameShapes(frame, observation.detail, observation.caster, observation.bodies)
        self._scan = FrameScan(self.shapes, frame, observation, ground=ground)
        self._scenery = observation.scenery
        self._about: np.ndarray | None = None  # the middle of where the scenery's tree is ready
        self._scores = None if scoring is None else FusedScores([self])

    def look(self, pose: Pose, also: Sequence[Stands] = ()) -> Look:
        """The cloud and the scores from a mounting; what `also` stands there returns and hides.

        Raises
        ------
        InputError
            When the sensor is not above the ground.
        """
        moved = self._about is None or (np.abs(pose.position - self._about) > DRAG_M).any()
        if self._scenery is not None and moved:  # may have many triangles; those of vehicles are made again in no time
            self._about = pose.position
            for part in self._scenery.parts:
                part.tree.make_ready(pose.position - DRAG_M, pose.position + DRAG_M)
        turn = self._scan.turn(pose, also)
        hits, nearest = turn.vehicles, np.full(len(turn.directions), np.inf)  # of what stands still, by each beam
        for beam, distance, *_ in turn.standing:
            nearest[beam] = np.minimum(nearest[beam], distance)
        shown = hits.distance <= nearest[hits.beam]
        hits = hits if shown.all() else Revolution(*(column[..., shown] for column in hits))
        look = Look(self._scan.cloud(pose, turn), None, pose, hits, self.frame.counted)
        return look if self._scores is None else look._replace(scored=self._scores.of([look]))


class FusedScores:
    """Scores of LiDARs that hang together, made of what each has cast already of one frame; as `VehicleScores`."""

    def __init__(self, frames: Sequence[LiveFrame]) -> None:
        first, lidars = frames[0], tuple(one.observation.lidar for one in frames)
        observation = replace(first.observation, lidars=lidars)
        self._frame, self._scores = first.frame, VehicleScores(first.scoring, observation, [first.frame])
        # What scenery hides is left out of the hits, as the cloud needs to know of it too.
        observation = replace(observation, scenery=None)
        self._scorer = FrameScorer(first.frame, observation, first.shapes)

    def of(self, looks: Sequence[Look]) -> Scored:
        """Of the layout of which each LiDAR has looked."""
        layouts, turns = [[look.pose for look in looks]], [[look.hits for look in looks]]
        seen = self._scorer.seen_of(layouts, turns, keep_returns=self._scores.needs_returns)
        return self._scores.of_seen(self._frame, self._scorer, seen, layouts)
