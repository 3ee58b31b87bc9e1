"""What stands still and hides vehicles: boxes, barriers, and the meshes of a site, as triangles in the road frame."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from .shapes import STRUCTURE, shape
from .triangles import place


@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """Triangles that belong to no vehicle.

    Attributes
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m, road frame].
    owner : ndarray of int32, (m,)
        Row in `names` of the object that a triangle belongs to.
    surface : ndarray of uint8, (m,)
        Index into `shapes.SURFACES`.
    names : tuple of str
        The objects.
    """

    corners: np.ndarray
    owner: np.ndarray
    surface: np.ndarray
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def digest(self) -> str:
        """SHA-256 of its triangles: what it hides depends on nothing else."""
        content = hashlib.sha256()
        for array in (self.corners, self.owner, self.surface):
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()

    def within(self, centre_xy: tuple[float, float], radius_m: float) -> Scenery:
        """What of it may lie within a horizontal distance of a place [m]: triangles whose bounding box does."""
        kept = boxes_reach(self.corners, centre_xy, radius_m)
        return Scenery(self.corners[kept], self.owner[kept], self.surface[kept], self.names)


def boxes_reach(corners: np.ndarray, centre_xy: tuple[float, float], radius_m: float) -> np.ndarray:
    """Whether bounding boxes come within a horizontal distance of a place, (...) bool, by `corners` (..., k, 3) [m]."""
    level = corners[..., :2]
    nearest = np.clip(centre_xy, level.min(axis=-2), level.max(axis=-2))
    return np.hypot(*np.moveaxis(nearest - centre_xy, -1, 0)) <= radius_m


def structure(name: str, corners: np.ndarray) -> Scenery:
    """One object of bare structure: `corners` (m, 3, 3) [m, road frame]."""
    owner, surface = np.zeros(len(corners), np.int32), np.full(len(corners), STRUCTURE, np.uint8)
    return Scenery(np.asarray(corners, dtype=float), owner, surface, (name,))


def box(name: str, centre_m: Sequence[float], size_m: Sequence[float], heading_rad: float = 0.0) -> Scenery:
    """A box by its centre (3,), its length, width and height (3,) [m], and its heading, counter-clockwise from +x."""
    unit = shape("car", "box")
    corners = place(unit.vertices, np.array([centre_m]), np.array([size_m]), np.array([heading_rad]))[0]
    return structure(name, corners[unit.faces])


def join(parts: Iterable[Scenery]) -> Scenery:
    """Several as one; an empty one where there are none."""
    parts = [Scenery(np.empty((0, 3, 3)), np.empty(0, np.int32), np.empty(0, np.uint8), ()), *parts]
    first = np.cumsum([0, *(len(part.names) for part in parts[:-1])])
    return Scenery(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.owner + start for part, start in zip(parts, first, strict=True)]).astype(np.int32),
        np.concatenate([part.surface for part in parts]),
        tuple(name for part in parts for name in part.names),
    )
