"""One sweep twice, ray by ray: what each ray gave in reality, and what it gives against our shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..casting import caster_class
from ..metrics.vgop import to_vehicle_frame
from .labelled import LabelledSweep
from .labelled_scene import scene_triangles
from .rays import NO_POINT, Firings, Rays, crossing
from .rings import Rings

CLEARANCE_M = 0.15
"""Hits less than this above a box's floor are left out, of both sides: in KITTI the road shows as a hump of returns
from 0.2 m below the floors of the labels (they are drawn by hand, and roads slope) to 0.1 m above."""
RIM_M = 0.05
"""Returns up to this far outside a box are the car's as well: one cell, as the metric has it."""
GROWN_M = 0.3  # a ray is a car's if it meets its box grown by this to all sides and up, above the clearance
SHORT_M = 0.3  # a return so far before the grown box came from something else, which hides the car


@dataclass(frozen=True, slots=True, eq=False)
class CarRays:
    """The rays towards the chosen boxes of one sweep, box after box; a ray that meets two is there twice.

    Attributes
    ----------
    rays : Rays
    box : ndarray of int64, (k,)
        Row of the sweep's box.
    real : ndarray of bool, (k,)
        Whether the real return came from the box.
    hidden : ndarray of bool, (k,)
        Whether it came from something well before the box: the ray says nothing of the car.
    """

    rays: Rays
    box: np.ndarray
    real: np.ndarray
    hidden: np.ndarray

    def __len__(self) -> int:
        return len(self.box)


@dataclass(frozen=True, slots=True, eq=False)
class Simulated:
    """What the same rays meet in a scene of shapes.

    Attributes
    ----------
    distance_m : ndarray, (k,)
        To the first thing [m]; inf where there is none.
    surface : ndarray of uint8, (k,)
        What that is made of, an index into `shapes.SURFACES`; meaningless where there is nothing.
    cosine : ndarray, (k,)
        Cosine of the incidence on it; 1 where there is nothing.
    of_car : ndarray of bool, (k,)
        Whether that is the car whose ray it is.
    """

    distance_m: np.ndarray
    surface: np.ndarray
    cosine: np.ndarray
    of_car: np.ndarray


def car_rays(sweep: LabelledSweep, which: np.ndarray, rings: Rings) -> CarRays:
    """The rays towards the boxes `which`, (c,) rows, of a sweep; `rings` as `recover_rings` finds them."""
    firings, boxes = Firings(sweep.points, rings), sweep.boxes
    found = []
    for row in which.tolist():
        centre, size, heading = boxes.centre_m[row], boxes.size_m[row], float(boxes.heading_rad[row])
        around, grown = _grown(centre, size)
        rays = firings.towards(around, grown, heading)
        entry, _ = crossing(rays, around, grown, heading)
        real = np.zeros(len(rays), dtype=bool)
        returned = rays.point != NO_POINT
        local = to_vehicle_frame(sweep.points[rays.point[returned]], centre, heading)
        real[returned] = on_vehicle(local, size)
        found.append((rays, np.full(len(rays), row), real, ~real & (rays.range_m < entry - SHORT_M)))
    return CarRays(
        Rays(*(np.concatenate([getattr(rays, name) for rays, *_ in found]) for name in Rays.__slots__)),
        *(np.concatenate(parts) for parts in list(zip(*found, strict=True))[1:]),
    )


def _grown(centre: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and size of the box that a car's rays meet: larger than its own, but without its floor."""
    lift = 0.5 * (GROWN_M + CLEARANCE_M)
    more = np.array([2.0 * GROWN_M, 2.0 * GROWN_M, GROWN_M - CLEARANCE_M])
    return centre + np.array([0.0, 0.0, lift]), size + more


def on_vehicle(local: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Which points (k, 3) in a vehicle's frame count as its own [m]; `size` (3,) or (k, 3)."""
    inside = (np.abs(local) <= 0.5 * size + RIM_M).all(axis=1)
    return inside & (local[:, 2] >= CLEARANCE_M - 0.5 * np.broadcast_to(size, local.shape)[:, 2])


def simulate(sweep: LabelledSweep, cars: CarRays, detail: str, caster: str, margin_m: np.ndarray) -> Simulated:
    """Cast the rays against the sweep's scene at a level of detail."""
    scene = scene_triangles(sweep.boxes, detail, margin_m)
    tree = caster_class(caster)(scene.corners, closed=True)
    hits = tree.cast(cars.rays.origin, cars.rays.direction)
    met = hits.triangle >= 0
    surface, cosine = np.zeros(len(cars), dtype=np.uint8), np.ones(len(cars))
    of_car = np.zeros(len(cars), dtype=bool)
    surface[met] = scene.surface[hits.triangle[met]]
    cosine[met] = np.abs(np.einsum("ij,ij->i", tree.normals(hits.triangle[met]), cars.rays.direction[met]))
    of_car[met] = scene.owner[hits.triangle[met]] == cars.box[met]
    return Simulated(hits.distance, surface, cosine, of_car)


def points_along(sweep: LabelledSweep, cars: CarRays, distance_m: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Points at the distances (k,) of all rays, for some `rows` of them, in the frames of their boxes [m]."""
    points = cars.rays.origin[rows] + distance_m[rows, None] * cars.rays.direction[rows]
    return to_vehicle_frame(points, sweep.boxes.centre_m, sweep.boxes.heading_rad, cars.box[rows])


def hits_of(sweep: LabelledSweep, cars: CarRays, distance_m: np.ndarray, of_car: np.ndarray) -> np.ndarray:
    """Rows of the rays that hit their car at the distances (k,), on it and above the clearance."""
    rows = np.flatnonzero(of_car & np.isfinite(distance_m))
    points = points_along(sweep, cars, distance_m, rows)
    return rows[on_vehicle(points, sweep.boxes.size_m[cars.box[rows]])]
