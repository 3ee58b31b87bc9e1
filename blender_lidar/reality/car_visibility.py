"""Expected visibility of single cars: how free the way to each one usually is, whatever stands there now."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..metrics.context import FrameBoxes
from ..metrics.expected_visibility import box_visibility, reach_probability
from ..metrics.metric import VehicleReturns
from ..metrics.occupancy_prior import OccupiedFrames
from ..metrics.voxel_grid import VoxelGrid

VOXEL_M = 0.4
REACH_M = 80.0  # cars farther away are not looked for
LOWEST_M, HIGHEST_M = -3.2, 2.0  # of the region, above the sensor: a car's LiDAR sits on its roof


class CarVisibility:
    """The mean, over the voxels of a car's box, of the probability that a beam from the sensor gets there.

    `metrics.expected_visibility` has the formula and its source. The prior of a voxel, in the sensor's frame, is the
    share of training frames with a labelled car in it. A beam goes through the centre of every voxel of a car: how
    densely a sensor samples does not enter, nor do the car's returns.

    Parameters
    ----------
    frames : sequence of FrameBoxes
        The training frames, in the sensor's frame.
    """

    def __init__(self, frames: Sequence[FrameBoxes]) -> None:
        corner = np.array([REACH_M, REACH_M, HIGHEST_M])
        self._grid = VoxelGrid.covering((-REACH_M, -REACH_M, LOWEST_M), corner, VOXEL_M)
        self._prior = OccupiedFrames([self._inside(frame) for frame in frames], len(self._grid)).prior

    def __call__(self, returns: VehicleReturns) -> np.ndarray:
        """Of each car, (n,), 0 to 1; their `view` is one sensor in the origin of their frame."""
        boxes = returns.view.boxes
        (origin,) = returns.view.mountings.origin_m
        way = self._grid.centres(self._inside(boxes)) - origin
        beams = way / np.linalg.norm(way, axis=1, keepdims=True)
        reached = reach_probability(self._grid, self._prior, origin, beams, 2.0 * REACH_M)
        return box_visibility(self._grid, reached, boxes.centre_m, boxes.size_m, boxes.heading_rad)

    def _inside(self, boxes: FrameBoxes) -> np.ndarray:
        return self._grid.in_boxes(boxes.centre_m, boxes.size_m, boxes.heading_rad)
