"""Scene metrics: S-MIG, covered entropy, M-SOG, expected visibility, density and NUC of ground returns.

    blender-lidar optimise SCENE.toml --metric scripts/research/scene_metrics.py:s_mig

They look at the road, not at a vehicle: at the rectangle, along x and y, about all boxes that count in any frame. Of
several LiDARs they take what at least one sees. For the objective the value of a scene counts once for every counted
vehicle of a frame: the mean per vehicle is then the scene's value, and frames weigh as they do with other metrics, by
their vehicles.

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
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, wraps
from pathlib import Path

import numpy as np

import blender_lidar as bl
from blender_lidar.metrics.metric import Metric, VehicleReturns
from blender_lidar.scene.observation import Observation
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.pose import Pose
from blender_lidar.traffic.boxes import Boxes
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
_LAYOUTS_KEPT = 128  # at least; as many as are scored together, where these are more


class Road:
    """The road of some frames as voxels, with a prior of what occupies them, and the beams over it.

    Parameters
    ----------
    frames : sequence of Boxes
        They weigh by their counted vehicles; one at least is needed. All their vehicles occupy voxels.
    observation : Observation
        Whose LiDARs look.

    Attributes
    ----------
    grid : VoxelGrid
        From the ground to the top of the tallest vehicle, about all boxes that count.
    frames : OccupiedFrames
        The prior.
    low, high : ndarray, (2,)
        Corners of the rectangle about these boxes [m].
    area_m2 : float
        Its area [m²].
    """

    def __init__(self, frames: Sequence[Boxes], observation: Observation) -> None:
        ends = [_ends(frame.select(frame.counted)) for frame in frames]
        self.low, self.high = np.concatenate(ends).min(axis=0), np.concatenate(ends).max(axis=0)
        self.area_m2 = float(np.prod(self.high - self.low))
        top = max(float((boxes.centre_m[:, 2] + 0.5 * boxes.size_m[:, 2]).max(initial=0.0)) for boxes in frames)
        self.grid = VoxelGrid.covering((*self.low, 0.0), (*self.high, max(top, ROAD_VOXEL_M)), ROAD_VOXEL_M)
        self.frames = OccupiedFrames(
            [self.grid.in_boxes(boxes.centre_m, boxes.size_m, boxes.heading_rad) for boxes in frames],
            len(self.grid),
            [np.count_nonzero(frame.counted) for frame in frames],
        )
        self._lidars = [(lidar, thinned(lidar)) for lidar in observation.lidars]

    def covered(self, layout: Sequence[Pose | None]) -> np.ndarray:
        """Which voxels a layout's beams cross, (voxels,) bool."""
        covered = np.zeros(len(self.grid), dtype=bool)
        for lidar, beams, pose in self._hung(layout):
            covered |= covered_voxels(self.grid, pose.position, beams, lidar.max_range_m, lidar.min_range_m)
        return covered

    def surprisal(self, layout: Sequence[Pose | None]) -> np.ndarray:
        """Entropy of the voxels that a layout's beams cross, as each frame's surprisal [nats], (f,)."""
        return self.frames.surprisal(self.covered(layout))

    def reached(self, layout: Sequence[Pose | None]) -> np.ndarray:
        """Probability that a layout's best beam gets to each voxel, (voxels,)."""
        best, prior = np.zeros(len(self.grid)), self.frames.prior
        for lidar, beams, pose in self._hung(layout):
            found = reach_probability(self.grid, prior, pose.position, beams, lidar.max_range_m, lidar.min_range_m)
            np.maximum(best, found, out=best)
        return best

    def ground_points(self, layout: Sequence[Pose | None]) -> np.ndarray:
        """Where a layout's beams, all of them, meet the empty road, (k, 2) [m]."""
        points = [np.zeros((0, 2))]
        for (lidar, _), pose in zip(self._lidars, layout, strict=True):
            if pose is None:
                continue
            directions = _turned(lidar.lattice.directions.reshape(-1, 3), pose.rotation)
            down = directions[directions[:, 2] * lidar.max_range_m <= -pose.position[2]]  # that reach it in range
            away = -pose.position[2] / down[:, 2]
            met = pose.position[:2] + away[:, None] * down[:, :2]
            inside = ((met >= self.low) & (met <= self.high)).all(axis=1)
            points.append(met[(away >= lidar.min_range_m) & inside])
        return np.concatenate(points)

    def _hung(self, layout) -> Iterator[tuple[Lidar, np.ndarray, Pose]]:
        """The LiDARs that hang in a layout, their beams as they point there, and their poses."""
        for (lidar, beams), pose in zip(self._lidars, layout, strict=True):
            if pose is not None:
                yield lidar, _turned(beams, pose.rotation), pose


def _ends(boxes: Boxes) -> np.ndarray:
    """The least and the greatest x and y of each box, (2 v, 2) [m]."""
    cos, sin = np.abs([np.cos(boxes.heading_rad), np.sin(boxes.heading_rad)])
    length, width, _ = 0.5 * boxes.size_m.T
    reach = np.stack([cos * length + sin * width, sin * length + cos * width], axis=1)
    return np.concatenate([boxes.centre_m[:, :2] - reach, boxes.centre_m[:, :2] + reach])


def thinned(lidar: Lidar) -> np.ndarray:
    """Of each ring as many beams as keep neighbours less than a voxel apart up to the range gate, (b, 3).

    In the sensor's frame; which voxels these cross is exact.
    """
    directions = lidar.lattice.directions  # (rings, columns, 3)
    apart = 2.0 * np.pi / directions.shape[1] * lidar.max_range_m
    return directions[:, :: max(int(ROAD_VOXEL_M / apart), 1)].reshape(-1, 3)


def _turned(directions, rotation):
    """``directions @ rotation`` (b, 3), bit by bit the same however many threads a matrix product would take."""
    return np.einsum("ij,jk->ik", directions, rotation)


class SceneScore:
    """Scores a frame's vehicles by the value of their frame under each layout.

    Parameters
    ----------
    frames, observation
        What the `Road` is made of, once, when first needed.
    values : callable
        Makes of it and a layout the value of every frame, (f,) or one for all.
    """

    def __init__(self, frames: Sequence[Boxes], observation: Observation, values: Callable) -> None:
        self._scene, self._values = (frames, observation), values
        self._row = {frame.frame: row for row, frame in enumerate(frames)}
        self._kept: dict[bytes, np.ndarray] = {}

    def __call__(self, returns: VehicleReturns) -> np.ndarray:
        """The value of each vehicle's frame under each layout, (s n,)."""
        if not len(returns):
            return np.zeros(0)
        most = max(_LAYOUTS_KEPT, len(returns.layouts))
        row, counted = self._row[returns.frame.frame], np.count_nonzero(returns.frame.counted)
        return np.repeat([self._of(layout, most)[row] for layout in returns.layouts], counted)

    @cached_property
    def _road(self):
        return Road(*self._scene)

    def _of(self, layout, most):
        """Values of all frames under a layout, (f,), kept with those of `most` for the other frames to come."""
        key = b"".join(b"-" if one is None else one.position.tobytes() + one.rotation.tobytes() for one in layout)
        if key not in self._kept:
            if len(self._kept) >= most:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = np.broadcast_to(self._values(self._road, layout), len(self._row))
        return self._kept[key]


def _of_scene(**described) -> Callable:
    """Decorator: a metric from the values that `SceneScore` takes; `described` goes to `blender_lidar.metric`."""

    def decorated(values: Callable) -> Metric:
        @wraps(values)
        def learn(frames: Sequence[Boxes], observation: Observation) -> SceneScore:
            return SceneScore(frames, observation, values)

        return bl.metric(learn, needs=["layouts"], learns=True, **described)

    return decorated


_TOGETHER = {"unit": "nats", "decimals": 1}


@_of_scene(label="entropy of covered voxels", tells=_UNSURE + "together, that beams cross", **_TOGETHER)
def covered_entropy(road: Road, layout: Sequence[Pose | None]) -> np.ndarray:
    """Entropy H(POG | L) of the voxels that a layout's beams cross, as surprisal in each frame [nats], (f,).

    S-MIG of Hu, Liu, Chitlangia, Agnihotri and Zhao (CVPR 2022, arXiv:2105.00373) is minus it: this has the sign that
    rewards a sensor for covering what is uncertain, where vehicles are sometimes but not always. No published metric
    has this sign with this formula; see `s_mig` for why it is needed. Higher is better.
    """
    return road.surprisal(layout)


@_of_scene(label="S-MIG", tells=_SURE + "together, that beams cross", **_TOGETHER)
def s_mig(road: Road, layout: Sequence[Pose | None]) -> np.ndarray:
    """S-MIG as published, minus the sum of H(p) over covered voxels, as surprisal in each frame [nats], (f,).

    Hu, Liu, Chitlangia, Agnihotri and Zhao, "Investigating the Impact of Multi-LiDAR Placement on Object Detection for
    Autonomous Driving", CVPR 2022, arXiv:2105.00373. Their information gain IG = H(POG) - H(POG | L) differs from it by
    a constant. Written from the definition: their released code counts a voxel once for every beam.

    The sign makes it degenerate: a sensor whose beams miss the road altogether gets 0, the greatest value there is, and
    every voxel that a beam adds lowers it. It was meant for set-ups with as many beams in the same region, and is of
    use between such alone; a search that may turn beams away from the road will do so.
    """
    return 0.0 - road.surprisal(layout)


@_of_scene(label="M-SOG", unit="nats", decimals=4, tells=_SURE + "in the mean, that beams cross")
def m_sog(road: Road, layout: Sequence[Pose | None]) -> np.ndarray:
    """M-SOG, minus the mean of H(p) over covered voxels, as surprisal in each frame [nats], (f,); 0 without any.

    Li, Kong, Hu, Xu and Huang, "Is Your LiDAR Placement Optimized for 3D Scene Understanding?" (Place3D), NeurIPS 2024,
    arXiv:2403.17009, section 3, as for car detection: two classes, vehicle and anything else. Theirs learns classes
    from dense merged clouds and follows beams as `voxel_grid.traverse` does; code for the metric was not released.

    As a mean of -H it rises with every *certain* voxel that is covered, such as the air above the roofs, and is
    greatest for a sensor that covers nothing uncertain, or nothing at all: degenerate as `s_mig` is. Between set-ups
    with as many covered voxels both say the same.
    """
    covered = road.covered(layout)
    return 0.0 - road.frames.surprisal(covered) / max(np.count_nonzero(covered), 1)


@_of_scene(unit="voxels", decimals=1, tells="how many occupied voxels beams can be expected to meet")
def expected_visibility(road: Road, layout: Sequence[Pose | None]) -> np.ndarray:
    """Expected visibility: occupied voxels that a beam can be expected to meet in each frame, (f,); higher is better.

    What the group of Ma, Zheng and Easa places roadside LiDARs by, sum of p_k prod_{j<k} (1 - p_j) in the mean over the
    frames, as read in their code (github.com/yangma93/Roadside-LiDAR-placement-), for one sensor: its cap at p_k holds
    because the best beam counts. They go on to compare histograms of the true and the seen grid, which is left out.
    Occlusion by traffic enters as an expectation, from one prior and without casting a beam at a vehicle. How densely
    beams sample a voxel does not enter.
    """
    return road.frames.sums(road.reached(layout))


@_of_scene(label="density of ground returns", unit="points/m²", tells="how densely beams sample the empty road")
def ground_density(road: Road, layout: Sequence[Pose | None]) -> float:
    """Returns of a layout from the empty road per area of the field, N / A [points/m²]; higher is better.

    Cai et al., ICRA 2023, arXiv:2211.15975 (PCSim, `ComputeDNUC.py`). It falls with the square of distance, so that the
    metres next to the pole decide it. It knows no vehicles: neither where they drive nor what they hide.
    """
    return len(road.ground_points(layout)) / road.area_m2


@_of_scene(label=_NUC, lower_is_better=True, tells="how unevenly beams sample the empty road")
def ground_nuc(road: Road, layout: Sequence[Pose | None]) -> float:
    """`nuc` of a layout over the empty road."""
    return nuc(road.ground_points(layout), road.area_m2)
