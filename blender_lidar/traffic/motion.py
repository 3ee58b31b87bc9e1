"""Motion in a recording: headings and speeds of all rows, directions of travel, the place where most drive."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..road.road_map import wrap_angle
from .boxes import Boxes
from .tracks import central_velocity, held_heading
from .vehicles import Recording

SAME_WAY_RAD = math.radians(15.0)  # of a direction, who drives along it
_MOST_SAMPLES = 200_000
_MOST_BINS = 2000


def thinning(count: int) -> slice:
    """Every so many of `count` rows that at most 200,000 are left."""
    return slice(None, None, max(1, -(-count // _MOST_SAMPLES)))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Samples(Boxes):
    """The boxes of a recording with their motion, by vehicle, counted from 0, and time.

    `heading_rad` is that of the motion, held where a vehicle stands; NaN of one that never moves.

    Attributes
    ----------
    speed : ndarray, (n,)
        [m/s].
    """

    speed: np.ndarray

    @classmethod
    def of(cls, recording: Recording) -> Samples:
        """Motion by central differences over about two seconds."""
        rows = recording.select(np.lexsort((recording.frame, recording.vehicle_id)))
        vehicle = np.unique(rows.vehicle_id, return_inverse=True)[1].reshape(-1)
        if (np.diff(vehicle) > 0).all():
            raise InputError(f"{recording.source}: no road can be proposed: no vehicle is in more than one frame")
        velocity = central_velocity(vehicle, rows.time_s - rows.time_s.min(), rows.xy)
        heading, held = held_heading(vehicle, velocity, np.nan)
        if np.isnan(heading).all():
            raise InputError(f"{recording.source}: no road can be proposed: every vehicle stands")
        columns = rows.columns() | {"vehicle_id": vehicle, "heading_rad": heading}
        return cls(**columns, speed=np.where(held, 0.0, np.hypot(*velocity.T)))

    def mirrored(self) -> Samples:
        """The same with y to the right of x."""
        return replace(self, centre_m=self.centre_m * (1.0, -1.0, 1.0), heading_rad=-self.heading_rad)

    def thinned(self) -> Samples:
        """Every so many of them, see `thinning`."""
        return self.select(thinning(len(self)))

    def off(self, direction: float) -> np.ndarray:
        """Angle between each heading and a direction, (n,) [rad], without sign; NaN where there is no heading."""
        return np.abs(wrap_angle(self.heading_rad - direction))


# --- Directions -------------------------------------------------------------------------------------------------------


def turned(xy: np.ndarray, direction: float) -> tuple[np.ndarray, np.ndarray]:
    """Along a direction, and across it to the left [m]."""
    cos, sin = math.cos(direction), math.sin(direction)
    return xy[:, 0] * cos + xy[:, 1] * sin, xy[:, 1] * cos - xy[:, 0] * sin


def unturned(along: float, across: float, direction: float) -> np.ndarray:
    """A vector, (2,) [m], by its parts along a direction and across it to the left."""
    cos, sin = math.cos(direction), math.sin(direction)
    return np.array([along * cos - across * sin, along * sin + across * cos])


def directions(samples: Samples, follows_x: bool) -> list[float]:
    """The directions that most is driven in, the busiest first [rad]: peaks of a circular histogram."""
    from scipy import ndimage, signal

    if follows_x:
        return [0.0]
    moving = samples.speed > 0.0
    weight = np.histogram(
        np.degrees(samples.heading_rad[moving]) % 360.0, 360, (0.0, 360.0), weights=samples.speed[moving]
    )[0]
    smooth = ndimage.gaussian_filter1d(weight, 4.0, mode="wrap", truncate=3.0)
    peaks, found = signal.find_peaks(np.tile(smooth, 3), height=0.1 * smooth.max(), distance=21)
    order = np.argsort(-found["peak_heights"], kind="stable")
    here = [peak - 360 for peak in peaks[order].tolist() if 360 <= peak < 720]
    return [math.radians(peak + 0.5) for peak in here[:8]]


def sharpest(near: Samples, place: np.ndarray, direction: float) -> float:
    """The direction along which lanes are sharpest: where a histogram of what lies across has the largest squares."""
    for reach_deg, step_deg in ((8.0, 0.5), (0.5, 0.05)):
        candidates = direction + np.radians(np.arange(-reach_deg, reach_deg + step_deg / 2, step_deg))
        sharpness = []
        for candidate in candidates:
            across = turned(near.xy - place, candidate)[1]
            counts = np.bincount(((across + 60.0) / 0.3).astype(int), weights=near.speed)
            sharpness.append((np.convolve(counts, [0.25, 0.5, 0.25]) ** 2).sum())
        best = np.array(sharpness)
        direction = float(candidates[best >= best.max() * (1.0 - 1e-9)].mean())
    return math.radians(round(math.degrees(wrap_angle(direction)), 2))


# --- Places -----------------------------------------------------------------------------------------------------------


def busiest_place(everything: Samples, direction: float) -> np.ndarray:
    """Where most drive in about a direction, (2,) [m]."""
    along = everything.select(everything.off(direction) <= SAME_WAY_RAD).thinned()
    if not len(along):
        return np.full(2, np.nan)
    middle = along.xy.mean(axis=0)
    u, v = turned(along.xy - middle, direction)
    return middle + unturned(*_busiest(u, v, along.speed), direction)


def _busiest(u: np.ndarray, v: np.ndarray, speed: np.ndarray) -> tuple[float, float]:
    """Middle of the 100 m by 20 m through which most drive, along and across [m]; found coarsely first where far."""
    from scipy import ndimage

    steps, windows = np.array([10.0, 4.0]), (11, 5)
    while True:
        low, high = np.array([u.min(), v.min()]), np.array([u.max(), v.max()])
        counts = np.minimum(_MOST_BINS, np.ceil((high - low) / steps) + 1).astype(int)
        size = np.maximum(steps, (high - low) * (1.0 + 1e-9) / counts)
        flow = np.histogram2d(u, v, counts, np.transpose([low, low + counts * size]), weights=speed)[0]
        flow = ndimage.uniform_filter(flow, windows, mode="constant")
        u0, v0 = low + (np.array(np.unravel_index(flow.argmax(), flow.shape)) + 0.5) * size
        if (size == steps).all():
            return float(u0), float(v0)
        reach = 0.5 * (np.array(windows) + 1) * size
        inside = (np.abs(u - u0) <= reach[0]) & (np.abs(v - v0) <= reach[1])
        u, v, speed = u[inside], v[inside], speed[inside]


def near_place(everything: Samples, place: np.ndarray, direction: float, half_m: float) -> Samples:
    """Those that drive along the stretch about a place; a longer one where the file follows the road's bends."""
    u, v = turned(everything.xy - place, direction)
    here = (np.abs(u) <= half_m) & (np.abs(v) <= 25.0) & (everything.off(direction) <= SAME_WAY_RAD)
    return everything.select(here & (everything.speed > 0.0)).thinned()
