"""Metrics of a whole scene: S-MIG, its positive form, M-SOG, expected visibility, density and evenness on the ground.

They look at the carriageway within the range gate, not at a vehicle. For the objective the value of a scene counts once
for every counted vehicle of a frame: the mean per vehicle is then the scene's value, and frames weigh as they do with
other metrics, by their vehicles.

Those with a prior learn it from the very frames that they then score, searched or held out, weighted in the same way.
Each frame has its own share of the value: the surprisal of what is and is not occupied in it, or the number of its
voxels that can be expected to be seen. The mean of the shares is the published value under that prior (see
`OccupiedFrames.surprisal`), and their scatter is what intervals over blocks of time need, which take the prior as it
is. For entropies that is as good as learning anew from each resample, since to first order entropy changes with the
frames as mean surprisal does; for expected visibility, where the prior also hides voxels, it makes the intervals too
narrow. Ground returns are the same in every frame.

Beams are those of a perfect sensor, and neither the vehicles of the moment nor scenery stop them.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial

import numpy as np

from ..errors import InputError
from .context import Field, SceneContext
from .expected_visibility import reach_probability
from .ground_returns import field_area, ground_density, nuc
from .metric import VIEW, Metric, VehicleReturns
from .occupancy_prior import OccupiedFrames
from .voxel_grid import VoxelGrid
from .voxel_walk import covered_voxels

VOXEL_M = 0.4
"""That of the published code for expected visibility: a car is about 11 x 5 x 4 voxels. S-MIG's authors take 0.05 m,
with which a carriageway has 70 million. Sums grow with the number of voxels: those of two sizes do not compare."""
_MOUNTINGS_KEPT = 128  # at least; as many as are scored together, where these are more


class Road:
    """The carriageway within the range gate as voxels, with a prior of what occupies them, and the beams over it.

    Parameters
    ----------
    context : SceneContext
        The frames weigh by their counted vehicles; one at least is needed. All their vehicles occupy voxels.

    Attributes
    ----------
    grid : VoxelGrid
        From the ground to the top of the tallest vehicle.
    frames : OccupiedFrames
        The prior.
    beams : ndarray, (b, 3)
        In the sensor's frame. Of each ring only as many as are needed to keep neighbours less than a voxel apart as far
        as the range gate; which voxels these cross is exact.
    """

    def __init__(self, context: SceneContext) -> None:
        field = context.field
        (x, y), reach = field.centre_xy_m, field.radius_m
        top = max(float((boxes.centre_m[:, 2] + 0.5 * boxes.size_m[:, 2]).max(initial=0.0)) for boxes in context.frames)
        right, left = np.clip(field.y_m, y - reach, y + reach)
        self.grid = VoxelGrid.covering((x - reach, right, 0.0), (x + reach, left, max(top, VOXEL_M)), VOXEL_M)
        self.frames = OccupiedFrames(
            [self.grid.in_boxes(boxes.centre_m, boxes.size_m, boxes.heading_rad) for boxes in context.frames],
            len(self.grid),
            [np.count_nonzero(boxes.counted) for boxes in context.frames],
        )
        apart = 2.0 * np.pi / context.directions.shape[1] * context.max_range_m
        self.beams = context.directions[:, :: max(int(VOXEL_M / apart), 1)].reshape(-1, 3)
        self._ranges = context.max_range_m, context.min_range_m

    def covered(self, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Which voxels a mounting's beams cross, (voxels,) bool."""
        return covered_voxels(self.grid, origin_m, _turned(self.beams, rotation), *self._ranges)

    def reached(self, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Probability that a mounting's best beam gets to each voxel, (voxels,)."""
        beams = _turned(self.beams, rotation)
        return reach_probability(self.grid, self.frames.prior, origin_m, beams, *self._ranges)


class SceneScore:
    """Scores a frame's vehicles by the value of their frame under each mounting.

    Parameters
    ----------
    context : SceneContext
        The frames that can be scored.
    prepare : callable
        Makes of the context what values are made of, once, when first needed.
    values : callable
        Makes of that, an origin (3,) and a rotation (3, 3) the value of every frame, (f,) or one for all.

    Raises
    ------
    InputError
        When two frames have the same number, or one is scored that the context does not have.
    """

    def __init__(self, context: SceneContext, prepare: Callable, values: Callable) -> None:
        self._context, self._prepare, self._values = context, prepare, values
        self._row = {boxes.frame: row for row, boxes in enumerate(context.frames)}
        if len(self._row) < len(context.frames):
            raise InputError("two frames have the same number; allowed: each once")
        self._kept: dict[bytes, np.ndarray] = {}

    def __call__(self, returns: VehicleReturns) -> np.ndarray:
        """The value of each vehicle's frame under each mounting, (s n,)."""
        mountings, boxes = returns.view.mountings, returns.view.boxes
        if not len(returns):
            return np.zeros(0)
        if boxes.frame not in self._row:
            raise InputError(f"frame {boxes.frame} is none of those that the metric has learnt from")
        most = max(_MOUNTINGS_KEPT, len(mountings))
        of_frames = [self._of(*mount, most) for mount in zip(mountings.origin_m, mountings.rotation, strict=True)]
        return returns.view.to_rows(np.array([value[self._row[boxes.frame]] for value in of_frames]))

    @cached_property
    def _ready(self):
        return self._prepare(self._context)

    def _of(self, origin, rotation, most):
        """Values of all frames under a mounting, (f,), kept with those of `most` for the other frames to come."""
        key = origin.tobytes() + rotation.tobytes()
        if key not in self._kept:
            if len(self._kept) >= most:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = np.broadcast_to(self._values(self._ready, origin, rotation), len(self._row))
        return self._kept[key]


def ground_points(context: SceneContext, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Where a mounting's beams meet the empty road within the field, (k, 2) [m]."""
    directions = _turned(context.directions.reshape(-1, 3), rotation)
    down = directions[directions[:, 2] * context.max_range_m <= -origin_m[2]]  # that reach the ground in range
    distance = -origin_m[2] / down[:, 2]
    points = origin_m[:2] + distance[:, None] * down[:, :2]
    return points[(distance >= context.min_range_m) & _holds(context.field, points)]


def _turned(directions, rotation):
    """``directions @ rotation`` (b, 3), bit by bit the same however many threads a matrix product would take."""
    return np.einsum("ij,jk->ik", directions, rotation)


def _holds(field: Field, points):
    across = (points[:, 1] >= field.y_m[0]) & (points[:, 1] <= field.y_m[1])
    return across & (np.hypot(*(points - field.centre_xy_m).T) <= field.radius_m)


def _area(field: Field):
    return field_area(field.radius_m, (field.y_m[0] - field.centre_xy_m[1], field.y_m[1] - field.centre_xy_m[1]))


def _covered_entropy(road: Road, origin, rotation):
    return road.frames.surprisal(road.covered(origin, rotation))


def _s_mig(road: Road, origin, rotation):
    return 0.0 - _covered_entropy(road, origin, rotation)


def _m_sog(road: Road, origin, rotation):
    covered = road.covered(origin, rotation)
    return 0.0 - road.frames.surprisal(covered) / max(np.count_nonzero(covered), 1)


def _visibility(road: Road, origin, rotation):
    return road.frames.sums(road.reached(origin, rotation))


def _density(context: SceneContext, origin, rotation):
    return ground_density(ground_points(context, origin, rotation), _area(context.field))


def _nuc(context: SceneContext, origin, rotation):
    return nuc(ground_points(context, origin, rotation), _area(context.field))


def _itself(context: SceneContext) -> SceneContext:
    return context


def _metric(name, label, unit, prepare, values, tells, decimals, higher_is_better=True):
    return Metric(
        name,
        label,
        unit,
        higher_is_better,
        needs=frozenset({VIEW}),
        learn=partial(SceneScore, prepare=prepare, values=values),
        tells=tells,
        decimals=decimals,
        of_scene=True,
    )


COVERED_ENTROPY = _metric(
    "covered-entropy",
    "entropy of covered voxels",
    "nats",
    Road,
    _covered_entropy,
    "how uncertain the voxels of the road are, together, that beams cross",
    1,
)
S_MIG = _metric(
    "s-mig",
    "S-MIG",
    "nats",
    Road,
    _s_mig,
    "how certain the voxels of the road are, together, that beams cross",
    1,
)
M_SOG = _metric(
    "m-sog",
    "M-SOG",
    "nats",
    Road,
    _m_sog,
    "how certain the voxels of the road are, in the mean, that beams cross",
    4,
)
EXPECTED_VISIBILITY = _metric(
    "expected-visibility",
    "expected visibility",
    "voxels",
    Road,
    _visibility,
    "how many occupied voxels beams can be expected to meet",
    1,
)
GROUND_DENSITY = _metric(
    "ground-density",
    "density of ground returns",
    "points/m²",
    _itself,
    _density,
    "how densely beams sample the empty road",
    3,
)
GROUND_NUC = _metric(
    "ground-nuc",
    "non-uniformity of ground returns (NUC)",
    "",
    _itself,
    _nuc,
    "how unevenly beams sample the empty road",
    3,
    higher_is_better=False,
)
