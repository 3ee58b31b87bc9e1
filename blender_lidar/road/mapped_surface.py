"""Height field of a mapped road: as high as the nearest lane there, and level across, on its lanes and beside them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

_CELL_M = 2.0  # of the height field's grid
_MOST_CELLS = 128  # on a side: over 200 m a crest of 136 m radius is then off by 9 mm
_LEVEL_M = 1e-3  # heights this near to each other are one
_PAIRS = 2**17  # of places and segments at a time
_ALONG_M = 2.0  # less than the width of any road that another may cross
_BRIDGE_M = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class MappedSurface:
    """Heights along the centre lines of lanes, each in straight segments.

    Attributes
    ----------
    start_m : ndarray, (m, 3)
        First end of each segment [m, site frame].
    end_m : ndarray, (m, 3)
        Its other end, elsewhere in x, y [m].
    """

    start_m: np.ndarray
    end_m: np.ndarray

    @classmethod
    def of_lines(cls, lines: Sequence[np.ndarray]) -> MappedSurface:
        """The surface of centre lines with heights, (k, 3) each [m]; one height everywhere becomes z = 0."""
        level = np.ptp(np.concatenate([line[:, 2] for line in lines])) < _LEVEL_M
        lines = [line * [1.0, 1.0, 0.0] for line in lines] if level else lines
        return cls(*(np.concatenate([line[part] for line in lines]) for part in (slice(-1), slice(1, None))))

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0."""
        return not (self.start_m[:, 2].any() or self.end_m[:, 2].any())

    @property
    def is_ground(self) -> bool:
        """Whether it lies everywhere in place of the plane z = 0."""
        return not self.is_flat

    def height(self, xy: np.ndarray) -> np.ndarray:
        """Height above the plane z = 0 at places (..., 2 or 3) [m], (...); that of the nearest centre line."""
        places = np.asarray(xy, dtype=float)[..., :2]
        flat = places.reshape(-1, 2)
        found, rows = np.zeros(len(flat)), max(1, _PAIRS // len(self.start_m))
        for first in range(0, 0 if self.is_flat else len(flat), rows):
            away, z = self.feet(flat[first : first + rows])
            found[first : first + rows] = np.take_along_axis(z, away.argmin(axis=1)[:, None], axis=1)[:, 0]
        return found.reshape(places.shape[:-1])

    def feet(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances of places (n, 2) from all segments [m] and the heights of their feet on them [m], (n, m) each."""
        x, y, z = self.start_m.T
        dx, dy, dz = (self.end_m - self.start_m).T
        off_x, off_y = xy[:, :1] - x, xy[:, 1:] - y
        part = ((off_x * dx + off_y * dy) / (dx * dx + dy * dy)).clip(0.0, 1.0)
        return np.hypot(off_x - part * dx, off_y - part * dy), z + part * dz

    def triangles(self, centre_m: Sequence[float], reach_m: float) -> np.ndarray:
        """A square of the height field about a place, as triangles (m, 3, 3) that face up; nothing where it is flat."""
        if self.is_flat:
            return np.empty((0, 3, 3))
        steps = np.linspace(-reach_m, reach_m, 1 + min(math.ceil(2.0 * reach_m / _CELL_M), _MOST_CELLS))
        grid = np.stack(np.meshgrid(centre_m[0] + steps, centre_m[1] + steps, indexing="ij"), axis=-1)
        grid = np.concatenate([grid, self.height(grid)[..., None]], axis=-1)
        a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
        return np.stack([a, b, c, a, c, d], axis=2).reshape(-1, 3, 3)


def two_levels(
    lines: Sequence[np.ndarray], width_m: np.ndarray, junction: Sequence[str]
) -> tuple[int, int, np.ndarray, float] | None:
    """A place at which one lane lies far above another, as on a bridge; None without one.

    Parameters
    ----------
    lines : sequence of ndarray, (k, 3) each
        Centre lines of l lanes, with heights [m].
    width_m : ndarray, (l,)
        Their widths [m].
    junction : sequence of str
        The junction that each crosses, or nothing; lanes of one junction are not compared.

    Returns
    -------
    tuple
        Rows of both lanes, the place on the first (3,) [m], and how much higher the other lies [m].
    """
    surface, junction = MappedSurface.of_lines(lines), np.array(junction)
    owner = np.repeat(np.arange(len(lines)), [len(line) - 1 for line in lines])
    for row, line in enumerate(lines if np.ptp(np.concatenate(lines)[:, 2]) > _BRIDGE_M else ()):
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line[:, :2], axis=0).T))])
        s = np.linspace(0.0, along[-1], 1 + math.ceil(along[-1] / _ALONG_M))
        places = np.stack([np.interp(s, along, axis) for axis in line.T], axis=1)
        for some in np.array_split(places, 1 + len(places) * len(owner) // _PAIRS):
            away, z = surface.feet(some[:, :2])
            above = z - some[:, 2:]
            found = (away < 0.5 * width_m[owner]) & (np.abs(above) > _BRIDGE_M)
            found &= (junction[owner] != junction[row]) | (junction[row] == "")
            if found.any():
                place, segment = np.argwhere(found)[0]
                return row, int(owner[segment]), some[place], float(above[place, segment])
    return None
