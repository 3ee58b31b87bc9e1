"""Static scenery that occludes vehicles: boxes, barriers, the ground and meshes of a site, as triangles."""

from __future__ import annotations

import hashlib
from collections import ChainMap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import unknown_name
from ..names import BARRIERS
from ..road.road_map import RoadMap
from .meshes import ROAD, STRUCTURE, VEGETATION, tube
from .shapes import shape
from .triangles import place

# --- Barriers along the road, extruded along x from a cross-section that is the same to the left and to the right -

# Cross-sections from the ground up: height and half-width [m].
# Concrete: the New Jersey profile of FHWA's Roadside Design Guide, 32 in high, 24 in wide at its foot, 6 in at its top.
# Guard rail: the W-beam of the Midwest Guardrail System, 12.25 in high and 3.25 in deep with its top at 31 in.
# Hedge: a clipped one against glare, in a median, through which nothing is seen; round numbers of ours.
_SECTIONS = {
    "concrete": ((0.0, 0.305), (0.075, 0.305), (0.330, 0.127), (0.813, 0.076)),
    "guard_rail": ((0.476, 0.0415), (0.787, 0.0415)),
    "hedge": ((0.0, 0.5), (1.6, 0.5)),
}
_POST_SPACING_M = 1.905  # 6 ft 3 in
_POST_SIZE_M = (0.10, 0.15, 0.70)  # W6 x 9


def barrier_extent(kind: str) -> tuple[float, float]:
    """Half-width and height of a kind of barrier, of its posts as well [m]."""
    heights, halves = zip(*_SECTIONS[kind], strict=True)
    return max(*halves, 0.5 * _POST_SIZE_M[1]), max(heights)


def along_road(road: RoadMap, made: Scenery) -> Scenery:
    """What was made beside a straight road, x and y being station and offset, as it stands beside another."""
    xy = road.at(made.corners[..., 0], made.corners[..., 1])
    return replace(made, corners=np.concatenate([xy, made.corners[..., 2:]], axis=-1))


def barrier(kind: str, y_m: float, x_m: Sequence[float]) -> Scenery:
    """A barrier that stands along the line y = `y_m` from one x to another [m], beside a straight road.

    Parameters
    ----------
    kind : {"concrete", "guard_rail", "hedge"}
        A median barrier of New Jersey's profile, a W-beam on posts, or a hedge 1.6 m high and 1 m wide.
    y_m : float
        Its middle line.
    x_m : sequence of float
        Where it begins, has corners once `along_road` has moved it, and ends, in rising order.
    """
    if kind not in BARRIERS:
        raise unknown_name(kind, BARRIERS, "barrier")
    name = f"{kind} at y {y_m:g} m"
    along = _extruded(_SECTIONS[kind], y_m, x_m)
    if kind != "guard_rail":
        return structure(name, along, VEGETATION if kind == "hedge" else STRUCTURE)
    posts = np.arange(x_m[0], x_m[-1], _POST_SPACING_M)
    standing = [box("post", (x, y_m, _POST_SIZE_M[2] / 2), _POST_SIZE_M).corners for x in posts + 0.5 * _POST_SIZE_M[0]]
    return structure(name, np.concatenate([along, *standing]))


def _extruded(section, y_m, x_m) -> np.ndarray:
    """A closed mesh, (m, 3, 3): the cross-section's outline joined from one end to the other, and both ends closed."""
    outline = [(half, height) for height, half in section]
    outline += [(-half, height) for half, height in outline[::-1]]  # up on the left, and down on the right
    made = tube([[(x, y_m + across, z) for across, z in outline] for x in x_m])
    return made.vertices[made.faces]


# --- What stands still and hides vehicles: boxes, barriers, and the meshes of a site, as triangles in the road frame -


NO_LABEL = -1
SURFACE = "carriageway of [road]"  # the name of its surface, where that is not the plane z = 0


@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """Triangles that belong to no vehicle.

    Attributes
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m, road frame].
    owner : ndarray of int32, (m,)
        Row in `names` of the object that a triangle belongs to.
    surface : ndarray of uint16, (m,)
        Index into `meshes.REFLECTIVITY`.
    names : tuple of str
        The objects.
    label : ndarray of int32, (m,)
        Number of each triangle's label, -1 where it has none, as all have where it is left out.
    labels : mapping of int to str
        The names of labels.
    """

    corners: np.ndarray
    owner: np.ndarray
    surface: np.ndarray
    names: tuple[str, ...]
    label: np.ndarray | None = None
    labels: Mapping[int, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.label is None:
            object.__setattr__(self, "label", np.full(len(self.corners), NO_LABEL, np.int32))

    def __len__(self) -> int:
        return len(self.corners)

    @property
    def digest(self) -> str:
        """SHA-256 of its triangles: what it hides depends on nothing else."""
        content = hashlib.sha256()
        for array in (self.corners, self.owner, self.surface):
            content.update(np.ascontiguousarray(array).tobytes())
        return content.hexdigest()

    @property
    def beside_road(self) -> Scenery:
        """What of it is not the crowned carriageway."""
        kept = np.array([name != SURFACE for name in self.names], dtype=bool)[self.owner]
        return self._only(kept)

    def within(self, centre_xy: tuple[float, float], radius_m: float) -> Scenery:
        """What of it may lie within a horizontal distance of a place [m]: triangles whose bounding box does."""
        return self._only(boxes_reach(self.corners, centre_xy, radius_m))

    def _only(self, kept: np.ndarray) -> Scenery:
        columns = {name: getattr(self, name)[kept] for name in ("corners", "owner", "surface", "label")}
        return replace(self, **columns)


def boxes_reach(corners: np.ndarray, centre_xy: tuple[float, float], radius_m: float) -> np.ndarray:
    """Whether bounding boxes come within a horizontal distance of a place, (...) bool, by `corners` (..., k, 3) [m]."""
    level = corners[..., :2]
    nearest = np.clip(centre_xy, level.min(axis=-2), level.max(axis=-2))
    return np.hypot(*np.moveaxis(nearest - centre_xy, -1, 0)) <= radius_m


def structure(name: str, corners: np.ndarray, surface: int = STRUCTURE) -> Scenery:
    """One object: `corners` (m, 3, 3) [m, road frame]; `surface` is an index into `meshes.SURFACES`."""
    owner, made_of = np.zeros(len(corners), np.int32), np.full(len(corners), surface, np.uint8)
    return Scenery(np.asarray(corners, dtype=float), owner, made_of, (name,))


def box(
    name: str,
    centre_m: Sequence[float],
    size_m: Sequence[float],
    heading_rad: float = 0.0,
    surface: int = STRUCTURE,
) -> Scenery:
    """A box by its centre (3,), its length, width and height (3,) [m], and its heading, counter-clockwise from +x."""
    unit = shape("car", "box")
    corners = place(unit.vertices, np.array([centre_m]), np.array([size_m]), np.array([heading_rad]))[0]
    return structure(name, corners[unit.faces], surface)


def road_surface(road: RoadMap, centre_xy: tuple[float, float], reach_m: float) -> Scenery:
    """What of a road's surface is not the plane z = 0, within reach of a place [m]."""
    corners = road.surface.triangles(centre_xy, reach_m)
    return Scenery(corners, np.zeros(len(corners), np.int32), np.full(len(corners), ROAD, np.uint8), (SURFACE,))


def join(parts: Iterable[Scenery]) -> Scenery:
    """Several as one; an empty one where there are none."""
    parts = [Scenery(np.empty((0, 3, 3)), np.empty(0, np.int32), np.empty(0, np.uint8), ()), *parts]
    first = np.cumsum([0, *(len(part.names) for part in parts[:-1])])
    return Scenery(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([part.owner + start for part, start in zip(parts, first, strict=True)]).astype(np.int32),
        np.concatenate([part.surface for part in parts]),
        tuple(name for part in parts for name in part.names),
        np.concatenate([part.label for part in parts]),
        dict(ChainMap(*(part.labels for part in parts))),
    )
