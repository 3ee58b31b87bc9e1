"""Scene metrics: S-MIG, covered entropy, M-SOG, expected visibility, density and NUC of ground returns.

    blender-lidar optimise SCENE.toml --metric scripts/research/scene_metrics.py:s_mig

They look at the carriageway within the range gate, not at a vehicle. For the objective the value of a scene counts once
for every counted vehicle of a frame: the mean per vehicle is then the scene's value, and frames weigh as they do with
other metrics, by their vehicles.

Those with a prior learn it from the very frames that they then score, searched or held out, weighted in the same way.
Each frame has its own share of the value: the surprisal of what is and is not occupied in it, or the number of its
voxels that can be expected to be seen. The mean of the shares is the published value under that prior (see
`OccupiedFrames.surprisal`), and their scatter is what intervals over blocks of time need, which take the prior as it
is. For entropies that is as good as learning again from each resample, since to first order entropy changes with the
frames as mean surprisal does; for expected visibility, where the prior also hides voxels, it makes the intervals too
narrow. Ground returns are the same in every frame.

Beams are those of a perfect sensor, and neither the vehicles of the moment nor scenery stop them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property, wraps
from pathlib import Path

import numpy as np

import blender_lidar as bl
from blender_lidar.errors import InputError
from blender_lidar.metrics.metric import Field, Metric, SceneContext, VehicleReturns
from blender_lidar.road.road_map import polygon_holds
from occupancy_prior import OccupiedFrames, reach_probability
from voxel_grid import VoxelGrid, covered_voxels

NAMES = ("s_mig", "covered_entropy", "m_sog", "expected_visibility", "ground_density", "ground_nuc")
OPTIONS = {name: f"{Path(__file__).resolve()}:{name}" for name in NAMES}  # what `--metric` calls each

# --- How densely and how evenly beams sample the empty road: the two surrogate metrics of Cai and others --

DISC_RADIUS_M, DISCS, SEED = 0.7, 6000, 1
"""r and D of `nuc` as in the authors' code; theirs has no fixed seed, and draws no return twice."""
_PAIRS_AT_A_TIME = 1 << 16  # whose temporaries stay in cache


def nuc(
    points_m: np.ndarray, area_m2: float, radius_m: float = DISC_RADIUS_M, discs: int = DISCS, seed: int = SEED
) -> float:
    """Non-uniformity of ground returns, the standard deviation of x_i = n_i / (N p) over discs; lower is better.

    n_i of all N returns lie in the i-th of D discs of radius r about returns drawn at random, with replacement; p = pi
    r^2 / A is a disc's share of the field, so that x is about 1 for returns spread evenly. Cai et al., ICRA 2023,
    arXiv:2211.15975 (PCSim, `ComputeDNUC.py`), after PU-Net's normalised uniformity coefficient.

    As published, discs reach over the field's edge, and are drawn where returns are dense, so that sparse zones hardly
    count. A few returns close together, or a single one, make it 0, which no road can better: read it beside
    `density_on_ground`. Without any return it is taken for its upper bound 1 / (2 p).

    Parameters
    ----------
    points_m : ndarray, (n, 2)
        Returns in the field [m].
    area_m2 : float
        Its area A [m²].
    radius_m : float
        r [m].
    discs : int
        D.
    seed : int
        Of the draws. The same numbers in [0, 1) pick the discs of every cloud.
    """
    share = math.pi * radius_m**2 / area_m2
    if not len(points_m):
        return 0.5 / share  # x lies between 0 and 1 / p
    drawn = (np.random.default_rng(seed).random(discs) * len(points_m)).astype(np.int64)
    within = _neighbours(points_m, points_m[drawn], radius_m)
    return float(np.std(within)) / (len(points_m) * share)


def field_area(field: Field) -> float:
    """Area of the part of a polygon that lies in a circle [m²].

    Raises
    ------
    InputError
        When there is none.
    """
    corners = np.asarray(field.polygon_m, dtype=float) - field.centre_xy_m
    area = abs(sum(_swept(*edge, field.radius_m) for edge in zip(corners, np.roll(corners, -1, axis=0), strict=True)))
    if not area > 1e-9 * field.radius_m**2:
        raise InputError(f"a region of {field.radius_m:g} m about {field.centre_xy_m} holds none of the carriageway")
    return area


def _swept(start, stop, radius):
    """Area within a circle about 0 that the line from there to an edge sweeps along it, counter-clockwise above 0."""
    way = stop - start
    square, middle = way @ way, start @ way
    root = max(middle**2 - square * (start @ start - radius**2), 0.0)  # 0 where the edge's line misses the circle
    enter, leave = (start + np.clip((-middle + side * math.sqrt(root)) / square, 0.0, 1.0) * way for side in (-1, 1))
    turned = _turn(start, enter) + _turn(leave, stop)  # before it enters the circle and after it has left it
    return 0.5 * (radius**2 * turned + enter[0] * leave[1] - enter[1] * leave[0])


def _turn(one, other):
    return math.atan2(one[0] * other[1] - one[1] * other[0], one @ other)


def _neighbours(points, centres, radius):
    """How many points lie within `radius` of each centre, rim included, (c,).

    Points are sorted into columns as wide as `radius`, and by y within each: a disc's neighbours then lie in one run of
    each of three columns.
    """
    low, reach = points.min(axis=0), radius * (1.0 + 1e-9)  # more than enough for rounding; the distance decides
    x, y = (points - low).T
    height = y.max() + 3.0 * reach  # of a column, so that no run leaves its own
    place = np.floor(x / reach) * height + y
    order = np.argsort(place, kind="stable")
    x, y, place = x[order], y[order], place[order]
    middle_x, middle_y = (centres - low).T
    middle = (np.floor(middle_x / reach)[:, None] + np.array([-1.0, 0.0, 1.0])) * height + middle_y[:, None]
    first = np.searchsorted(place, middle - reach, side="left")
    length = np.searchsorted(place, middle + reach, side="right") - first
    within = np.zeros(len(centres), dtype=np.int64)
    for some in np.array_split(np.arange(len(centres)), length.sum() // _PAIRS_AT_A_TIME + 1):
        many = length[some].ravel()
        candidate = np.arange(many.sum()) + np.repeat(first[some].ravel() - (np.cumsum(many) - many), many)
        disc = np.repeat(some, length[some].sum(axis=1))
        across, along = x[candidate] - middle_x[disc], y[candidate] - middle_y[disc]
        within += np.bincount(disc[across * across + along * along <= radius * radius], minlength=len(within))
    return within


# --- Metrics of a whole scene: S-MIG, its positive form, M-SOG, expected visibility, density and evenness on the ground

ROAD_VOXEL_M = 0.4
"""That of the published code for expected visibility: a car is about 11 x 5 x 4 voxels. S-MIG's authors take 0.05 m,
with which a carriageway has 70 million. Sums grow with the number of voxels: those of two sizes do not compare."""
_SURE, _UNSURE = "how certain the voxels of the road are, ", "how uncertain the voxels of the road are, "
_NUC = "non-uniformity of ground returns (NUC)"
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
        corners, centre = np.asarray(field.polygon_m, dtype=float), np.asarray(field.centre_xy_m)
        low, high = np.clip(
            [corners.min(axis=0), corners.max(axis=0)], centre - field.radius_m, centre + field.radius_m
        )
        top = max(float((boxes.centre_m[:, 2] + 0.5 * boxes.size_m[:, 2]).max(initial=0.0)) for boxes in context.frames)
        self.grid = VoxelGrid.covering((*low, 0.0), (*high, max(top, ROAD_VOXEL_M)), ROAD_VOXEL_M)
        self.frames = OccupiedFrames(
            [self.grid.in_boxes(boxes.centre_m, boxes.size_m, boxes.heading_rad) for boxes in context.frames],
            len(self.grid),
            [np.count_nonzero(boxes.counted) for boxes in context.frames],
        )
        if not self.frames.prior.any():
            raise InputError("no vehicle of the frames is on the carriageway of [road]; check [road] and [traffic]")
        apart = 2.0 * np.pi / context.directions.shape[1] * context.max_range_m
        self.beams = context.directions[:, :: max(int(ROAD_VOXEL_M / apart), 1)].reshape(-1, 3)
        self._ranges = context.max_range_m, context.min_range_m

    def covered(self, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Which voxels a mounting's beams cross, (voxels,) bool."""
        return covered_voxels(self.grid, origin_m, _turned(self.beams, rotation), *self._ranges)

    def surprisal(self, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
        """Entropy of the voxels that a mounting's beams cross, as each frame's surprisal [nats], (f,)."""
        return self.frames.surprisal(self.covered(origin_m, rotation))

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
    """

    def __init__(self, context: SceneContext, prepare: Callable, values: Callable) -> None:
        self._context, self._prepare, self._values = context, prepare, values
        self._row = {boxes.frame: row for row, boxes in enumerate(context.frames)}
        self._kept: dict[bytes, np.ndarray] = {}

    def __call__(self, returns: VehicleReturns) -> np.ndarray:
        """The value of each vehicle's frame under each mounting, (s n,)."""
        view = returns.view
        if not len(returns):
            return np.zeros(0)
        most = max(_MOUNTINGS_KEPT, len(view.origin_m))
        of_frames = [self._of(*mount, most) for mount in zip(view.origin_m, view.rotation, strict=True)]
        row, counted = self._row[view.boxes.frame], np.count_nonzero(view.boxes.counted)
        return np.repeat([value[row] for value in of_frames], counted)

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
    within = np.hypot(*(points - field.centre_xy_m).T) <= field.radius_m
    return within & polygon_holds(field.polygon_m, points)


def _of_scene(prepare: Callable, **described) -> Callable:
    """Decorator: a metric from the values that `SceneScore` takes; `described` goes to `blender_lidar.metric`."""

    def decorated(values: Callable) -> Metric:
        @wraps(values)
        def learn(scene: SceneContext) -> SceneScore:
            return SceneScore(scene, prepare, values)

        return bl.metric(learn, needs=["view"], learns=True, **described)

    return decorated


def _itself(scene: SceneContext) -> SceneContext:
    return scene


_TOGETHER = {"unit": "nats", "decimals": 1}


@_of_scene(Road, label="entropy of covered voxels", tells=_UNSURE + "together, that beams cross", **_TOGETHER)
def covered_entropy(road: Road, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Entropy H(POG | L) of the voxels that a mounting's beams cross, as surprisal in each frame [nats], (f,).

    S-MIG of Hu, Liu, Chitlangia, Agnihotri and Zhao (CVPR 2022, arXiv:2105.00373) is minus it: this has the sign that
    rewards a sensor for covering what is uncertain, where vehicles are sometimes but not always. No published metric
    has this sign with this formula; see `s_mig` for why it is needed. Higher is better.
    """
    return road.surprisal(origin_m, rotation)


@_of_scene(Road, label="S-MIG", tells=_SURE + "together, that beams cross", **_TOGETHER)
def s_mig(road: Road, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """S-MIG as published, minus the sum of H(p) over covered voxels, as surprisal in each frame [nats], (f,).

    Hu, Liu, Chitlangia, Agnihotri and Zhao, "Investigating the Impact of Multi-LiDAR Placement on Object Detection for
    Autonomous Driving", CVPR 2022, arXiv:2105.00373. Their information gain IG = H(POG) - H(POG | L) differs from it by
    a constant. Written from the definition: their released code counts a voxel once for every beam.

    The sign makes it degenerate: a sensor whose beams miss the road altogether gets 0, the greatest value there is, and
    every voxel that a beam adds lowers it. It was meant for set-ups with as many beams in the same region, and is of
    use between such alone; a search that may turn beams away from the road will do so.
    """
    return 0.0 - road.surprisal(origin_m, rotation)


@_of_scene(Road, label="M-SOG", unit="nats", decimals=4, tells=_SURE + "in the mean, that beams cross")
def m_sog(road: Road, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """M-SOG, minus the mean of H(p) over covered voxels, as surprisal in each frame [nats], (f,); 0 without any.

    Li, Kong, Hu, Xu and Huang, "Is Your LiDAR Placement Optimized for 3D Scene Understanding?" (Place3D), NeurIPS 2024,
    arXiv:2403.17009, section 3, as for car detection: two classes, vehicle and anything else. Theirs learns classes
    from dense merged clouds and follows beams as `voxel_grid.traverse` does; code for the metric was not released.

    As a mean of -H it rises with every *certain* voxel that is covered, such as the air above the roofs, and is
    greatest for a sensor that covers nothing uncertain, or nothing at all: degenerate as `s_mig` is. Between set-ups
    with as many covered voxels both say the same.
    """
    covered = road.covered(origin_m, rotation)
    return 0.0 - road.frames.surprisal(covered) / max(np.count_nonzero(covered), 1)


@_of_scene(Road, unit="voxels", decimals=1, tells="how many occupied voxels beams can be expected to meet")
def expected_visibility(road: Road, origin_m: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Expected visibility: occupied voxels that a beam can be expected to meet in each frame, (f,); higher is better.

    What the group of Ma, Zheng and Easa places roadside LiDARs by, sum of p_k prod_{j<k} (1 - p_j) in the mean over the
    frames, as read in their code (github.com/yangma93/Roadside-LiDAR-placement-), for one sensor: its cap at p_k holds
    because the best beam counts. They go on to compare histograms of the true and the seen grid, which is left out.
    Occlusion by traffic enters as an expectation, from one prior and without casting a beam at a vehicle. How densely
    beams sample a voxel does not enter.
    """
    return road.frames.sums(road.reached(origin_m, rotation))


@_of_scene(
    _itself, label="density of ground returns", unit="points/m²", tells="how densely beams sample the empty road"
)
def ground_density(context: SceneContext, origin_m: np.ndarray, rotation: np.ndarray) -> float:
    """Returns of a mounting from the empty road per area of the field, N / A [points/m²]; higher is better.

    Cai et al., ICRA 2023, arXiv:2211.15975 (PCSim, `ComputeDNUC.py`). It falls with the square of distance, so that the
    metres next to the pole decide it. It knows no vehicles: neither where they drive nor what they hide.
    """
    return len(ground_points(context, origin_m, rotation)) / field_area(context.field)


@_of_scene(_itself, label=_NUC, lower_is_better=True, tells="how unevenly beams sample the empty road")
def ground_nuc(context: SceneContext, origin_m: np.ndarray, rotation: np.ndarray) -> float:
    """`nuc` of a mounting over the empty road."""
    return nuc(ground_points(context, origin_m, rotation), field_area(context.field))
