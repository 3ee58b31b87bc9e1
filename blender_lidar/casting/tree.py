"""Casters with a bounding volume hierarchy in float32: made of a mesh without gaps, and judged in float64.

Near a shared edge `BVHTree.ray_cast` and Embree now and then report neither neighbour, because their float32 tests of
boxes and of triangles do not agree with each other. Here nothing is left to that:

- the tree is made about the place where the rays start, which is where float32 is finest, of triangles that are each
  grown within their plane by a little more than float32 can err there: neighbours overlap, and no ray slips between;
- range and place of every hit are computed again in float64, with the triangle as it was given;
- a ray that met nothing but such a margin is decided by the float64 caster, and so are one that met a triangle so
  nearly edge-on that float32 cannot tell how far away, and one that met the inside of a closed mesh first, having
  leaked where a flat side is seen so nearly edge-on that the margin does not show: a few in 10,000 hits;
- the triangles of a mesh that need not be closed get a fence along each side, which stands square to them and is as
  high as the margin is wide: what slips past a triangle seen edge-on meets its fence, and is decided in float64 too;
- a ray that starts so near a surface that float32 cannot tell on which side is left to the float64 caster.

So all casters find the same hits and ranges, and differ in speed alone; except for what is left to closed meshes, whose
triangles have no fences because these double the time of a cast. A ray within 1e-7 rad of an outline that is so rounded
that the sides about it are all seen edge-on may miss it, and one that leaks between two triangles of a flat side seen
edge-on may meet another solid that stands within the first. Of 1.7 million rays aimed at such places bvh lost 2 and
Embree 1, and none and 7 met what stands within (scripts/research/caster_attacks.py at full size, seeds 1 to 3).
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from .protocol import MISS, Caster, Returns, decide_doubtful, origins_of, take

_AT_A_TIME = 1 << 20  # pairs of a start and a triangle
# Of a triangle's distance from where rays start: float32 keeps 6e-8 of it, and a ray-triangle test loses a few such.
_MARGIN = 2e-7
_MARGIN_OPEN = 16 * _MARGIN  # where no inside tells of a leak
# Of the farthest triangle's distance: how far rays' starts may move before the tree is made again, and how wide a
# region of such starts it may come to serve.
_ROAM, _REGION = 0.05, 0.25
_FAR = 4.0  # times the triangles' median distance at most: one that is farther makes the tree coarser for none
_MUCH_WIDER = 4.0  # than the rays need: a tree made for such wide starts is coarser than it has to be
_LEAST_COSINE_SUM = 1e-5  # at a corner: a sharper one, of 0.26 degrees, would move by more than 450 margins
EDGE_ON = 1e-3  # cosine: what is met so nearly edge-on may lie centimetres behind what float32 takes it to hide
_REACH_SLACK = 1e-5  # relative: back-ends look a little farther than asked and float64 decides at the limit


class NearSurfaces:
    """Near-surface rays: which start so near a triangle that float32 cannot tell on which side.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners of each triangle [m].
    normal : ndarray, (m, 3)
        Unit normals.
    gap : ndarray, (m,)
        How near a start has to be to touch each of them [m].
    low, high : ndarray, (3,)
        Corners of the region that rays start in [m].
    """

    def __init__(
        self, corners: np.ndarray, normal: np.ndarray, gap: np.ndarray, low: np.ndarray, high: np.ndarray
    ) -> None:
        lower, upper = corners.min(axis=1) - gap[:, None], corners.max(axis=1) + gap[:, None]
        near = np.flatnonzero(((lower <= high) & (upper >= low)).all(axis=1))
        self._lower, self._upper, self._gap, self._normal = lower[near], upper[near], gap[near], normal[near]
        self._low, self._high = self._lower.min(axis=0, initial=np.inf), self._upper.max(axis=0, initial=-np.inf)
        self._offset = np.einsum("ti,ti->t", self._normal, corners[near, 0])

    def of(self, origins: np.ndarray) -> np.ndarray:
        """Which starts (n, 3) [m] touch one, (n,) bool."""
        touching = ((origins >= self._low) & (origins <= self._high)).all(axis=1)
        near = np.flatnonzero(touching)
        if len(near) == 0:  # as at most roadsides
            return touching
        for some in np.array_split(near, 1 + len(near) * len(self._gap) // _AT_A_TIME):
            start = origins[some]
            boxed = ((self._lower <= start[:, None]) & (self._upper >= start[:, None])).all(axis=2)
            touching[some] = (boxed & (np.abs(start @ self._normal.T - self._offset) <= self._gap)).any(axis=1)
        return touching


class TreeCaster(Caster):
    """A caster whose back-end answers one question in float32: which triangle does a ray meet first?"""

    @abstractmethod
    def _build(self, corners: np.ndarray) -> None:
        """Make a tree of the triangles `corners` (m, 3, 3), in place of an earlier one."""

    @abstractmethod
    def _first(self, origins: np.ndarray, directions: np.ndarray, reach: float) -> np.ndarray:
        """Row of the triangle that each ray meets first within `reach`, or `MISS`: (n,) whole numbers."""

    def _prepare(self):
        self._margin = _MARGIN if self._closed else _MARGIN_OPEN
        self._low = self._high = None  # of where rays may start; the tree is made at the first cast
        self._stays = False  # however far from each other they start there

    def make_ready(self, low: np.ndarray, high: np.ndarray) -> None:
        """As `Caster.make_ready`; the wider the region, the wider are the margins, and the more is left to float64."""
        if len(self.rows):
            self._low = None
            self._make_tree(low - self.origin, high - self.origin)
            self._stays = True

    def first(self, origin: np.ndarray, directions: np.ndarray, max_range: float) -> np.ndarray | None:
        """What the tree alone says: row of the triangle that each ray meets first, or `MISS`; of closed meshes.

        It is float32's word: place and distance are still to be measured, and what is not met within its triangle and
        from outside, or too nearly edge-on (`EDGE_ON`), is for `decide` to tell.

        Parameters
        ----------
        origin : ndarray, (3,)
            Start of all rays, counted from `self.origin` [m].
        directions : ndarray of float32, (n, 3)
            Unit directions, C-contiguous.
        max_range : float
            Hits somewhat farther away may be among them [m].

        Returns
        -------
        ndarray of int, (n,), or None
            Rows as in `planes`; None where the rays start at a surface, and all is for `decide`.
        """
        self._make_ready(origin, origin)
        if self._near_surfaces.of(origin[None])[0]:
            return None
        return self._first(origin - self._middle, directions, _beyond(max_range))

    def decide(self, origin: np.ndarray, directions: np.ndarray, max_range: float) -> Returns:
        """What rays meet first in float64, slowly; origin and rows as for `first`."""
        return self._sure.meet(origin, directions, max_range)

    def _meet(self, origins, directions, max_range):
        starts = np.atleast_2d(origins)
        self._make_ready(starts.min(axis=0), starts.max(axis=0))
        near = self._near_surfaces.of(starts)
        if not near.any():
            return self._meet_by_tree(origins, directions, max_range)
        if near.all():
            return self._sure.meet(origins, directions, max_range)
        parts = []
        for rays, meet in ((np.flatnonzero(~near), self._meet_by_tree), (np.flatnonzero(near), self._sure.meet)):
            found = meet(origins[rays], directions[rays], max_range)
            parts.append(found._replace(ray=rays[found.ray]))
        both = Returns(*map(np.concatenate, zip(*parts, strict=True)))
        order = np.argsort(both.ray)
        return Returns(*(column[order] for column in both))

    def _meet_by_tree(self, origins, directions, max_range):
        """As `_meet`, where no ray starts at a surface."""
        triangle = self._first(origins - self._middle, directions, _beyond(max_range))
        ray = np.flatnonzero(triangle != MISS)
        fence, triangle = np.divmod(take(triangle, ray).astype(np.int64), len(self._corners))  # which stands on it
        origins, directions = origins_of(origins, ray), take(directions.T, ray, axis=1).T
        distance, facing, inside = self._planes.meet(origins.T, directions.T, triangle)
        doubtful = ~inside | ((facing > -EDGE_ON) if self._closed else (fence > 0) | (np.abs(facing) < EDGE_ON))
        decide_doubtful(self._sure, origins, directions, max_range, np.flatnonzero(doubtful), triangle, distance)
        met = distance <= max_range
        return Returns(ray[met], triangle[met], distance[met])

    def _make_ready(self, low, high):
        """Have a tree for rays that start between two corners, and not one that was made for far wider ones."""
        if self._low is not None and (low >= self._low).all() and (high <= self._high).all():
            roam = _ROAM * self._far
            widest = max(2.0 * (_REGION * self._far + roam), _MUCH_WIDER * (0.5 * (high - low).max() + roam))
            if self._stays or self._reach <= widest:
                return
        self._make_tree(low, high)

    def _make_tree(self, low, high):
        """Make the tree for rays that start between two corners, and where they have started before if that is near."""
        self._stays = False
        if self._low is not None:
            both = np.minimum(low, self._low), np.maximum(high, self._high)
            if 0.5 * (both[1] - both[0]).max() <= _REGION * self._far:
                low, high = both
        self._middle = 0.5 * (low + high)
        away = np.abs(self._corners - self._middle).max(axis=(1, 2))
        self._far = float(min(away.max(), _FAR * np.median(away)))
        self._reach = float(0.5 * (high - low).max() + _ROAM * self._far)
        self._low, self._high = self._middle - self._reach, self._middle + self._reach
        margin = self._margin * (away + self._reach)
        larger = grown(self._corners, self._normal, margin)
        if not self._closed:
            larger = np.concatenate([larger, *fences(larger, self._normal, margin)])
        self._build(larger - self._middle)
        gap = _MARGIN_OPEN * (away + self._reach)
        self._near_surfaces = NearSurfaces(self._corners, self._normal, gap, self._low, self._high)


def _beyond(max_range):
    return max_range * (1.0 + _REACH_SLACK) + _REACH_SLACK


def grown(corners: np.ndarray, normal: np.ndarray, margin: np.ndarray | float) -> np.ndarray:
    """Triangles with every side moved outwards within the plane; for needles larger ones, that hold all that and more.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners [m], counter-clockwise about the normal.
    normal : ndarray, (m, 3)
        Unit normals.
    margin : float or ndarray, (m,)
        How far the sides of each move [m].

    Returns
    -------
    ndarray, (m, 3, 3)
    """
    margin = np.broadcast_to(margin, len(corners))
    side = np.roll(corners, -1, axis=1) - corners  # from each corner to the next
    side /= np.linalg.norm(side, axis=2, keepdims=True)
    outward = np.cross(side, normal[:, None])
    before = np.roll(outward, 1, axis=1)
    # The corner p + d moves both of its sides by the margin: d . outward = d . before = margin.
    cosine_sum = 1.0 + np.einsum("tki,tki->tk", outward, before)
    step = margin[:, None] / np.maximum(cosine_sum, _LEAST_COSINE_SUM)
    larger = corners + step[..., None] * (outward + before)
    needles = np.flatnonzero((cosine_sum < _LEAST_COSINE_SUM).any(axis=1))
    if len(needles):
        larger[needles] = _around_needles(corners[needles], normal[needles], margin[needles, None])
    return larger


def fences(corners: np.ndarray, normal: np.ndarray, height: np.ndarray) -> list[np.ndarray]:
    """Triangles along the sides of triangles and square to them, which hold all that is so near to these sides.

    Parameters
    ----------
    corners : ndarray, (m, 3, 3)
        Corners [m], counter-clockwise about the normal.
    normal : ndarray, (m, 3)
        Unit normals.
    height : ndarray, (m,)
        How far each fence rises at least, to either side of the plane and beyond the ends of the side [m].

    Returns
    -------
    list of three ndarray, (m, 3, 3)
        One for each side: of the first and second corner, of the second and third, of the third and first.
    """
    made = []
    for first, second in ((0, 1), (1, 2), (2, 0)):
        side = corners[:, [first, second, second]]
        along = side[:, 1] - side[:, 0]
        outward = np.cross(along / np.linalg.norm(along, axis=1, keepdims=True), normal)
        made.append(_around_needles(side, outward, height[:, None]))
    return made


def _around_needles(corners, normal, margin):
    """Triangles that hold a rectangle about each needle, which lies along its longest side."""
    rows = np.arange(len(corners))
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).argmax(axis=1)
    first, second, third = (corners[rows, (longest + which) % 3] for which in range(3))
    length = np.linalg.norm(second - first, axis=1, keepdims=True)
    along = (second - first) / length
    inward = np.cross(normal, along)
    height = np.einsum("ti,ti->t", third - first, inward)[:, None]
    # At both ends of the rectangle the sides have risen to half of what they rise to in the middle.
    beyond, below = (0.5 * length + 2.0 * margin) * along, margin * inward
    top = 0.5 * (first + second) + (3.0 * height + 6.0 * margin) * inward
    return np.stack([first - beyond - below, second + beyond - below, top], axis=1)
