"""Made-up traffic for tests: any number of vehicles of every class, side by side on six lanes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from blender_lidar.clouds import scan as clouds
from blender_lidar.scene.observation import Observation
from blender_lidar.sensors.imperfections import PERFECT
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.traffic.boxes import Boxes
from blender_lidar.traffic.vehicles import CLASSES

SIZES = np.array([[4.4, 1.85, 1.5], [5.2, 2.0, 1.9], [12.7, 2.5, 3.8], [12.0, 2.5, 3.2], [2.1, 0.8, 1.4]])
SIZES = np.concatenate([SIZES, [[1.8, 0.6, 1.7], [0.5, 0.6, 1.7]]])


def dense_traffic(seed: int = 1, vehicles: int = 130, length_m: float = 500.0, frame: int = 0) -> Boxes:
    """Bumper to bumper on six lanes from y = 2 m on, boxes apart from each other, headings a little off the road's."""
    rng = np.random.default_rng(seed)
    lane = rng.integers(0, 6, vehicles)
    index = rng.choice(5, vehicles, p=[0.68, 0.22, 0.05, 0.02, 0.03]).astype(np.int8)
    x = np.empty(vehicles)
    for number in range(6):
        mine = np.flatnonzero(lane == number)
        gap = length_m / max(len(mine), 1)
        x[mine] = (np.arange(len(mine)) + 0.5) * gap - length_m / 2
        index[mine] = np.where(SIZES[index[mine], 0] > 0.85 * gap, 0, index[mine])
    size = SIZES[index] * rng.uniform(0.97, 1.03, (vehicles, 3))
    y = 2.0 + 3.66 * (lane + 0.5) + rng.uniform(-0.3, 0.3, vehicles)
    return Boxes(
        frame=frame,
        time_s=0.1 * frame,
        vehicle_id=np.arange(vehicles) + 100,
        class_index=index,
        centre_m=np.column_stack([x, y, size[:, 2] / 2]),
        size_m=size,
        heading_rad=rng.normal(0.0, 0.02, vehicles),
        lane=(6 - lane).astype(np.int16),
    )


def counted_frames(number: int, seed: int = 0) -> list[Boxes]:
    """Frames of 20 vehicles, of which those within 30 m of the origin count."""
    every = [dense_traffic(seed + frame, vehicles=20, length_m=80.0, frame=frame) for frame in range(number)]
    return [replace(one, counted=np.hypot(*one.centre_m[:, :2].T) < 30.0) for one in every]


def joined(*frames: Boxes) -> Boxes:
    """The vehicles of several frames in one, which is the first otherwise."""
    names = ("vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane")
    return replace(frames[0], **{name: np.concatenate([getattr(frame, name) for frame in frames]) for name in names})


def one_vehicle(name: str, centre=(0.0, 10.0), heading: float = 0.0, size=None) -> Boxes:
    """A single vehicle of a class, standing on the road."""
    index = CLASSES.index(name)
    size = np.array([SIZES[index] if size is None else size], dtype=float)
    return Boxes(
        frame=0,
        time_s=0.0,
        vehicle_id=np.array([1]),
        class_index=np.array([index], dtype=np.int8),
        centre_m=np.array([[*centre, size[0, 2] / 2]]),
        size_m=size,
        heading_rad=np.array([heading]),
        lane=np.array([1], dtype=np.int16),
    )


def scan(
    vehicles,
    lattice,
    pose,
    *,
    caster,
    detail="body",
    min_range_m=0.0,
    max_range_m,
    ground=True,
    scenery=None,
    imperfections=PERFECT,
):
    """The cloud of one revolution, without a scene."""
    lidar = Lidar(lattice, max_range_m, min_range_m, imperfections)
    seen = Observation((lidar,), caster, detail, cell_m=np.nan, scenery=scenery)
    return clouds.scan(vehicles, seen, pose, ground=ground)
