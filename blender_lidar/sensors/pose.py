"""Where the LiDAR hangs and where it looks: position, tilt and yaw (Eq. 2 and its tilt matrices, 2a to 2c)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import InputError


def rotation_matrix(tilt_x: float, tilt_y: float, yaw: float) -> np.ndarray:
    """The sensor's orientation, for row vectors: ``world = sensor @ R``.

    Parameters
    ----------
    tilt_x, tilt_y : float
        Tilt about the x axis (Eq. 2a) and the y axis (Eq. 2b) [rad]. Without yaw, positive `tilt_x` looks down towards
        +y and positive `tilt_y` raises +x.
    yaw : float
        Rotation about the vertical, of the tilted sensor and so of the direction it leans in [rad], counter-clockwise
        seen from above.

    Returns
    -------
    ndarray, (3, 3)
        ``Rx(tilt_x) @ Ry(tilt_y) @ Rz(yaw)``: Eq. 2c, and the yaw that the paper leaves out because it matters only
        to a tilted sensor.
    """
    cy, sy = math.cos(tilt_y), math.sin(tilt_y)
    about_y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])  # Eq. 2b
    return _about_x(tilt_x) @ about_y @ _about_z(yaw)  # Eq. 2c


def _about_x(angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])  # Eq. 2a


def _about_z(angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


# --- Axis and angle: how far the sensor leans, and which way. Tilts and yaw say one lean in many ways ---------------


def lean_matrix(lean: float, direction: float, spin: float) -> np.ndarray:
    """The orientation of a sensor that leans, for row vectors: ``world = sensor @ R``.

    Parameters
    ----------
    lean : float
        Between the sensor's upright axis and the vertical [rad], 0 or more.
    direction : float
        Which way the axis leans, and the beams look down [rad]: counter-clockwise seen from above, 0 towards +y.
    spin : float
        Turn of the sensor about its own axis [rad], counter-clockwise seen from above.

    Returns
    -------
    ndarray, (3, 3)
        ``Rz(spin) @ Rz(-direction) @ Rx(lean) @ Rz(direction)``: without a lean all directions are the same.
    """
    return _about_z(spin - direction) @ _about_x(lean) @ _about_z(direction)


def lean_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Lean, its direction and the spin [rad] of an orientation (3, 3), as `lean_matrix` takes them.

    The direction is from -pi to pi; without a lean it is 0.
    """
    x, y, z = rotation[2].tolist()  # the sensor's upright axis
    lean = math.atan2(math.hypot(x, y), z)
    direction = math.atan2(-x, y) if lean else 0.0
    turned = rotation @ lean_matrix(lean, direction, 0.0).T
    return lean, direction, math.atan2(turned[0, 1] - turned[1, 0], turned[0, 0] + turned[1, 1])


def tilts_of(rotation: np.ndarray) -> tuple[float, float, float]:
    """Tilts and yaw [rad] of an orientation (3, 3), as `rotation_matrix` takes them."""
    upright = float(rotation[0, 2]), math.hypot(rotation[1, 2], rotation[2, 2])
    tilt_x = math.atan2(-rotation[1, 2], rotation[2, 2])
    level = turned(_about_x(tilt_x).T, rotation)
    return tilt_x, math.atan2(*upright), math.atan2(-level[1, 0], level[1, 1])


def turned(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """``one @ other`` of (3, 3) each, to the last digit the same in every process, as BLAS does not promise."""
    return np.einsum("ij,jk->ik", one, other)


def degrees_of(angle: float) -> float:
    """An angle [rad] in degrees: those that are read as the very same angle, where there are such."""
    near = math.degrees(angle)
    above, below = math.nextafter(near, math.inf), math.nextafter(near, -math.inf)
    degrees = (round(near, 12), near, above, below, math.nextafter(above, math.inf), math.nextafter(below, -math.inf))
    return next((one for one in degrees if math.radians(one) == angle), degrees[0]) + 0.0


@lru_cache(maxsize=1024)  # more than a swarm, which meets frame after frame
def _kept_rotation(tilt_x: float, tilt_y: float, yaw: float) -> np.ndarray:
    rotation = rotation_matrix(tilt_x, tilt_y, yaw)
    rotation.flags.writeable = False
    return rotation


@dataclass(frozen=True, slots=True)
class Pose:
    """One mounting of the LiDAR in the road frame.

    Attributes
    ----------
    x_m, y_m, height_m : float
        Position of the optical centre [m]; `height_m` above the road's plane, square to it.
    tilt_x, tilt_y, yaw : float
        Orientation [rad], as in `rotation_matrix`.

    Raises
    ------
    InputError
        For a coordinate that is not finite: all rays from there would miss without a word.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    height_m: float = 2.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            if not math.isfinite(getattr(self, name)):
                raise InputError(f"the mounting's {name} is {getattr(self, name)}; allowed: a finite number")

    @classmethod
    def from_table(cls, table: Mapping[str, float]) -> Pose:
        """The pose that a table gives, as of `as_table`; what it leaves out is 0, and 2 m of height."""
        given = {key.removesuffix("_deg"): value for key, value in table.items() if value is not None}
        angles = {key: math.radians(given[key]) for key in ("tilt_x", "tilt_y", "yaw") if key in given}
        return cls(**{key: given[key] for key in ("x_m", "y_m", "height_m") if key in given}, **angles)

    def as_table(self) -> dict[str, float]:
        """Its six numbers for a file [m, degrees]."""
        angles = {f"{key}_deg": degrees_of(getattr(self, key)) for key in ("tilt_x", "tilt_y", "yaw")}
        return {"x_m": self.x_m, "y_m": self.y_m, "height_m": self.height_m, **angles}

    @property
    def position(self) -> np.ndarray:
        """Optical centre, (3,) [m, road frame]."""
        return np.array([self.x_m, self.y_m, self.height_m])

    @property
    def rotation(self) -> np.ndarray:
        """Orientation, (3, 3): ``world = sensor @ rotation``; not to be written to, as it is kept."""
        return _kept_rotation(self.tilt_x + 0.0, self.tilt_y + 0.0, self.yaw + 0.0)  # -0 is the same key as 0

    def to_world(self, directions: np.ndarray) -> np.ndarray:
        """Directions (n, 3) from the sensor frame into the road frame; in memory coordinate after coordinate."""
        x, y, z = directions.T
        # Added up in this order everywhere, so that all casters get the same rays; `@` may do it otherwise.
        turned, part = np.empty((3, len(x))), np.empty(len(x))
        for out, (a, b, c) in zip(
            turned, self.rotation.T.tolist(), strict=True
        ):  # in place: memory is slower than sums
            np.multiply(x, a, out=out)
            out += np.multiply(y, b, out=part)
            out += np.multiply(z, c, out=part)
        return turned.T

    def to_sensor(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the road frame in the sensor frame [m]: the inverse of Eq. 2."""
        return (points - self.position) @ self.rotation.T
