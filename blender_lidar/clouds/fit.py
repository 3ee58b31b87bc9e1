"""Frame check: whether points lie in the boxes given beside them, and which one change of frame brings them in.

Tried are the 48 ways to name three axes (mirrors, turns, frames of other sensors), each at any height; factors; and
offsets, by cross-correlation with the footprints. A change is named where no other brings in nearly as many.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..metrics.assignment import NO_BOX, points_in_boxes
from ..metrics.vgop import to_vehicle_frame
from ..names import FRAMES
from ..sensors.pose import rotation_matrix
from ..traffic.boxes import Boxes, join_boxes
from ..traffic.vehicles import counted

_WAYS = {"r": (1, 0, 0), "l": (-1, 0, 0), "f": (0, 1, 0), "b": (0, -1, 0), "u": (0, 0, 1), "d": (0, 0, -1)}
_SIGN = {axes: np.linalg.det([_WAYS[one] for one in axes]) for axes in map("".join, product(_WAYS, repeat=3))}
# As it is, then upright ones, then those without a mirror: of changes that bring in as many the first is named.
_AXES = sorted(filter(_SIGN.get, _SIGN), key=lambda axes: (axes != "rfu", axes[2] != "u", _SIGN[axes] < 0.0))
_NAMES = {
    "lfu": "a mirror in x",
    "rbu": "a mirror in y",
    "fru": "swapping x and y",
    "blu": "swapping x and y and changing their signs",
    "flu": "a quarter turn to the left",
    "bru": "a quarter turn to the right",
    "lbu": "a half turn",
}
_FACTORS = {0.01: "coordinates (cm)", 0.001: "coordinates (mm)", 100.0: "boxes (cm)", 1000.0: "boxes (mm)"}
_LIKE = 0.7  # of what the best change brings in: another that does as much is as good
_SLACK_M, _AROUND_M, _GROUND_M = 0.2, 0.8, 0.3  # of a box that holds points, and of what others stay out of
_MOST_POINTS, _MOST_BOXES, _FEWEST = 30_000, 300, 5
_CELL_M, _CELLS, _PEAKS = 0.5, 1024, 4  # of the cross-correlation


def in_frame(points: np.ndarray, axes: str, pose: Sequence[float] | None) -> np.ndarray:
    """Points (n, 3) [m] of a sensor's frame in that of the boxes.

    `axes` are letters of where their x, y and z point, such as ``flu``: right or left, forward or back, up or down;
    `pose` is the sensor's: x, y and height [m], tilts and yaw [degrees], as of `Pose`.

    Raises
    ------
    InputError
        For letters that are no three axes of space.
    """
    if axes not in _AXES:
        allowed = "three letters: r or l (right, left), f or b (forward, back), u or d (up, down), such as rfu or flu"
        raise InputError(f"--axes: is {axes!r}; allowed: {allowed}")
    turned = points @ np.array([_WAYS[one] for one in axes], dtype=float)
    return turned if pose is None else pose[:3] + turned @ rotation_matrix(*np.radians(pose[3:]))


class Change(NamedTuple):
    """A change of frame: a factor, axes as of `in_frame`, and what is added to x, y and z [m]."""

    axes: str = "rfu"
    factor: float = 1.0
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def moved(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3), changed."""
        return in_frame(points * self.factor, self.axes, (*self.offset_m, 0.0, 0.0, 0.0))

    def words(self, *, options: bool) -> str:
        """What it does, and with which options where they are exact."""
        parts, given, (x, y, z) = [], "", self.offset_m
        if self.factor != 1.0:
            parts.append(f"dividing the {_FACTORS[self.factor]} by {max(self.factor, 1.0 / self.factor):g}")
        if self.axes != "rfu":
            parts.append(_NAMES.get(self.axes, f"taking the axes as those of another sensor, {self.axes}"))
            given += f" --axes {self.axes}"
        if max(abs(x), abs(y)) > _SLACK_M:
            parts.append(f"adding an offset of about {x:.1f}, {y:.1f}, {z:.1f} m")
        elif abs(z) > _SLACK_M:
            parts.append(f"adding a height of about {z:.1f} m, such as the sensor's")
            given += f" --pose 0 0 {z:.1f} 0 0 0"
        return " and ".join(parts) + (f" ({given[1:]})" if given and options and self.factor == 1.0 else "")


class Misfit(NamedTuple):
    """What does not fit, in words; `sure` where one change was found that mends it, None where none was."""

    text: str
    sure: bool | None


class _Pairs(NamedTuple):
    """Points, boxes with the rows of those points that may lie in each, and which boxes hold what they should.

    `holds` is given how many points lie in each box, how many around it, and how many may; those that are no higher
    than `ground_m` above its floor are left out.
    """

    points: np.ndarray
    rows: Sequence[np.ndarray]
    centre_m: np.ndarray
    size_m: np.ndarray
    heading_rad: np.ndarray
    holds: Callable[..., np.ndarray]
    ground_m: float = -_SLACK_M

    def held(self, change: Change = Change(), *, at_any_height: bool = True) -> tuple[int, int, Change]:  # noqa: B008
        """How many boxes hold their points after a change, by how many more lie in than around, and the change.

        At any height it is moved to where most lie in their boxes.
        """
        moved, unit, parts = change.moved(self.points), max(change.factor, 1.0), [np.zeros((0, 3))]
        half = 0.5 * self.size_m / unit
        for box, rows in enumerate(self.rows):
            here, reach = moved[rows], unit * (np.hypot(*half[box, :2]) + _AROUND_M)
            here = here[(np.abs(here[:, :2] - self.centre_m[box, :2]) <= reach).all(axis=1)]
            local = to_vehicle_frame(here, self.centre_m[box], float(self.heading_rad[box])) / unit
            out = (np.abs(local[:, :2]) - half[box, :2]).max(axis=1)
            parts.append(np.column_stack([out, local[:, 2], np.full(len(out), box)]))
        out, z, box = np.concatenate(parts).T
        box, up = box.astype(int), 0.0
        top = half[box, 2]
        if at_any_height:
            lows, highs = (side * top[out <= _SLACK_M] - z[out <= _SLACK_M] for side in (-1.0, 1.0))
            ups = np.concatenate([[0.0], lows, highs])
            within = np.searchsorted(np.sort(lows), ups, "right") - np.searchsorted(np.sort(highs), ups)
            up = 0.0 if within[0] >= 0.9 * within.max() else float(ups[within == within.max()].mean())
        level = (z + up > self.ground_m - top) & (z + up <= top + _SLACK_M)
        inside, near = (
            np.bincount(box[level & (out <= slack)], minlength=len(half)) for slack in (_SLACK_M, _AROUND_M)
        )
        boxes = self.holds(inside, near - inside, np.array([len(rows) for rows in self.rows]))
        x, y, height = change.offset_m
        return int(boxes.sum()), int((2 * inside - near).sum()), change._replace(offset_m=(x, y, height + up * unit))

    def offsets(self, axes: str, least: float) -> Iterator[tuple[int, int, Change]]:
        """The offsets at which most footprints hold points: peaks of the cross-correlation, the highest first."""
        moved, votes = Change(axes).moved(self.points), np.zeros(_CELLS**2)
        start = np.round(np.median(self.centre_m[:, :2], axis=0) - np.median(moved[:, :2], axis=0))
        cell = np.floor((moved[:, :2] + start) / _CELL_M).astype(np.int64)
        block, lowest = np.unique(cell // 8, axis=0, return_inverse=True)[1].ravel(), np.full(len(moved), np.inf)
        np.minimum.at(lowest, block, moved[:, 2])
        raised = moved[:, 2] - lowest[block] > self.ground_m
        for rows, centre, size, heading in zip(self.rows, self.centre_m, self.size_m, self.heading_rad, strict=True):
            u, v = np.meshgrid(*(np.arange(-far, far + _CELL_M, _CELL_M) for far in 0.5 * size[:2] + _AROUND_M))
            turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
            places = np.floor((np.column_stack([u.ravel(), v.ravel()]) @ turn + centre[:2]) / _CELL_M).astype(np.int64)
            away = places[:, None] - np.unique(cell[rows[raised[rows]]], axis=0) + _CELLS // 2
            known = ((away >= 0) & (away < _CELLS)).all(axis=2)
            inside = np.where((np.abs(u) <= 0.5 * size[0]) & (np.abs(v) <= 0.5 * size[1]), 1.0, -1.0).ravel()
            weight = np.broadcast_to(inside[:, None], known.shape)[known]
            votes += np.bincount(away[known] @ (_CELLS, 1), weight, _CELLS**2)
        votes = votes.reshape(_CELLS, _CELLS)
        for _ in range(_PEAKS):
            x, y = np.unravel_index(votes.argmax(), votes.shape)
            votes[max(x - 4, 0) : x + 5, max(y - 4, 0) : y + 5] = 0.0
            best = self.held(Change(axes, 1.0, (*(start + _CELL_M * (np.array([x, y]) - _CELLS // 2)), 0.0)))
            for step in (0.25, 0.1, 0.1) if best[0] >= 0.5 * least else ():
                dx, dy, _ = best[2].offset_m
                near = (
                    Change(axes, 1.0, (dx + step * i, dy + step * j, 0.0)) for i, j in product((-1, 0, 1), repeat=2)
                )
                best = max((best, *map(self.held, near)), key=lambda one: one[:2])
            yield best

    def changes(self, least: float, moved: float) -> list[tuple[int, Change]]:
        """The changes after which at least `least` boxes hold their points, how many, and others nearly as good.

        Offsets must bring in at least `moved`, and twice as many as axes and factors do, as more of them are tried.
        """
        units = [one for one in _FACTORS if one < 1.0 or 1.0 < np.median(self.size_m[:, 0]) / one < 30.0]
        fixed = map(self.held, [*map(Change, _AXES), *(Change(factor=one) for one in units)])
        turned = (one for axes in _AXES[1:8] for one in self.offsets(axes, moved))
        some, found, most = self.points[:: len(self.points) // 500 + 1], [], 0.5 * least

        def alike(one: Change, other: Change) -> bool:
            apart = np.abs(one.moved(some) - other.moved(some))[:, :2].max()
            return apart < (4.0 if any(one.offset_m[:2]) and any(other.offset_m[:2]) else 1.0)

        for stage in (fixed, self.offsets("rfu", moved), turned):
            tried = list(stage)
            best = max(boxes for boxes, _, _ in tried)
            if best >= max(2.0 * most, least if stage is fixed else moved):
                found, most = [], best
                for boxes, _, change in tried:
                    if boxes >= max(least, _LIKE * most) and not any(alike(change, other) for _, other in found):
                        found.append((boxes, change))
            if most >= 0.5 * len(self.rows):
                break
        return sorted(found, key=lambda one: -one[0])

    def misfit(self, what: str, least: float, moved: float, fewest: int, *, options: bool) -> Misfit:
        """That `what` is seen, and which of `changes` would bring boxes in; it is sure of `fewest` or more."""
        found = self.changes(least, max(least, moved)) if len(self.points) and len(self.rows) else []
        if not found:
            return Misfit(f"{what}, and no change of frame that was tried explains it: perhaps none is in sight", None)
        would = " or ".join(change.words(options=options) for _, change in found[:3])
        return Misfit(f"{what}, but {found[0][0]:,} would after {would}", len(found) == 1 and found[0][0] >= fewest)


def cloud_misfit(
    points: np.ndarray, boxes: Boxes, own: np.ndarray | None = None, *, options: bool = True
) -> Misfit | None:
    """What does not fit between a cloud (n, 3) [m] and b boxes; None where nothing seems wrong.

    `own` (n,) is the box that each point is said to belong to, -1 for none; `options` that mend it are named.
    """
    shape, many = (boxes.centre_m, boxes.size_m, boxes.heading_rad), len(boxes)
    some = np.arange(len(points)) if own is None else np.flatnonzero(own >= 0)
    some = some[:: len(some) // _MOST_POINTS + 1]
    if own is None:
        every = [np.arange(len(some))] * many
        pairs = _Pairs(
            points[some], every, *shape, lambda one, near, _: one >= np.maximum(_FEWEST, 3 * near), _GROUND_M
        )
        held = pairs.held(at_any_height=False)[0]
        if held >= max(1.0, 0.4 * many):
            return None
        touched = (points_in_boxes(points, *shape, 0.5 * _SLACK_M) != NO_BOX).any()
        of = counted(many, "box")
        what = f"{held} of {of} hold clusters of points" if touched else f"no point lies in any of {of}"
        least, moved, fewest = max(1.0, 0.25 * many, 3.0 * held), max(_FEWEST, 0.5 * many), min(max(many, 2), 3)
        found = pairs.misfit(what, least, moved, fewest, options=options)
        return None if touched and found.sure is None else found
    seen, mine = np.unique(own[some], return_inverse=True)
    rows = [np.flatnonzero(mine == box) for box in range(len(seen))]
    pairs = _Pairs(points[some], rows, *(one[seen] for one in shape), lambda one, _, of: one >= 0.5 * of)
    off = len(seen) - pairs._replace(holds=lambda one, _, of: one >= 0.1 * of).held(at_any_height=False)[0]
    what = f"under a tenth of the points of {off} of {counted(len(seen), 'vehicle')} lie in their own boxes"
    if off <= 0.5 * len(seen) or len(some) < _FEWEST:
        return Misfit(what, False) if off else None
    return pairs.misfit(what, 0.5 * len(seen) + 0.1, 0.0, 1, options=options)


def detections_misfit(detected: Sequence[Boxes], frames: Sequence[Boxes]) -> Misfit | None:
    """What does not fit between the detections and the vehicles of f frames; None where nothing seems wrong."""
    both = [(one, other) for one, other in zip(detected, frames, strict=True) if len(one) and len(other)]
    both = both[:: sum(len(other) for _, other in both) // _MOST_BOXES + 1]
    found, ends = join_boxes([one for one, _ in both]), np.cumsum([len(one) for one, _ in both])
    each = zip(ends, both, strict=True)
    rows = [np.arange(end - len(one), end) for end, (one, other) in each for _ in range(len(other))]
    if not rows:
        return None
    centre, size, heading = (
        np.concatenate([getattr(one, key) for _, one in both]) for key in ("centre_m", "size_m", "heading_rad")
    )
    pairs = _Pairs(found.centre_m, rows, centre, np.full_like(size, 2.0), heading, lambda one, *_: one > 0)
    most, held = sum(min(map(len, one)) for one in both), pairs.held()[0]
    if held < 0.3 * most:
        what = f"{held:,} of {counted(most, 'detection')} lie near the middle of a vehicle"
        misfit = pairs.misfit(what, max(1.0, 0.5 * most, 3.0 * held), 0.0, _FEWEST, options=False)
        return None if misfit.sure is None and held >= 0.1 * most else misfit
    near = []
    for box in np.flatnonzero(size[:, 0] > 1.5 * size[:, 1]):
        away = np.linalg.norm(found.centre_m[rows[box], :2] - centre[box, :2], axis=1)
        near += [(rows[box][away.argmin()], heading[box])] if away.min() <= 2.0 else []
    of, turn = np.array(near).reshape(-1, 2).T
    size, given = found.size_m[of.astype(int)], found.heading_rad[of.astype(int)]
    swapped = size[:, 0] < size[:, 1]
    across = np.abs(np.sin(given + 0.5 * np.pi * swapped - turn)) > np.cos(np.radians(30.0))
    if len(near) < _FEWEST or across.mean() <= 0.5:
        return None
    why = "length and width are swapped" if swapped.mean() > 0.5 else "the headings are off by 90 degrees"
    return Misfit(f"{across.sum():,} of {len(near):,} detections lie across their vehicles: probably {why}", True)


def accepted(misfit: Misfit | None, where: str, accept: Iterable[str] | None) -> list[dict[str, str]]:
    """The warnings for a result file of two inputs that do not fit; what is not sure is noted.

    Raises
    ------
    InputError
        For what is sure, unless `accept` holds ``frames``.
    """
    if misfit is None:
        return []
    if misfit.sure and FRAMES not in (accept or ()):
        raise InputError(f"{where}: {misfit.text}; if it is right as it is, go on with --accept {FRAMES}")
    if not misfit.sure:
        warnings.warn(f"{where}: {misfit.text}", stacklevel=2)
    return [{"name": FRAMES, "text": f"{where}: {misfit.text}"}] * bool(misfit.sure)
