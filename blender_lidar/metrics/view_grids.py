"""The grids over a vehicle's top, side and front view, and what share of their cells holds a point (Eqs. 6 to 8)."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .cell_marks import VIEW_AXES, fastest_marks, places_kept, places_of, whole_cells
from .readings import check_reading

VIEWS = ("top", "side", "front")
DEFAULT_CELL_M = 0.05

_WHOLE_CELL_TOLERANCE = 1e-9  # a box of 4.50 m is 90 cells of 0.05 m, whatever the rounding of 4.5 / 0.05


def cell_counts(size: np.ndarray, cell_m: float = DEFAULT_CELL_M) -> np.ndarray:
    """Whole cells along each side of a box: Eq. 8 with `ceil`, so that no occupancy exceeds 1.

    Parameters
    ----------
    size : ndarray, (n, 3)
        Length, width and height of each box [m].
    cell_m : float
        Side of a square cell [m].

    Returns
    -------
    ndarray of int64, (n, 3)
    """
    size = np.asarray(size, dtype=float)
    if size.ndim != 2 or size.shape[1] != 3:
        raise InputError(f"size has shape {size.shape}; allowed: (n, 3)")
    if not (np.isfinite(size).all() and (size > 0).all()):
        raise InputError("size holds a side that is not a positive, finite number of metres")
    if not (np.isfinite(cell_m) and cell_m > 0):
        raise InputError(f"cell_m is {cell_m}; allowed: a positive number of metres")
    return np.maximum(np.ceil(size / cell_m - _WHOLE_CELL_TOLERANCE), 1).astype(np.int64)


class ViewGrids:
    """The three grids of each of n boxes, made once for any number of clouds.

    Parameters
    ----------
    size : ndarray, (n, 3)
        Length, width and height of each box [m].
    cell_m : float
        Side of a square cell [m].
    reading : {"corrected", "paper"}
        What Eq. 8 divides by: the number of whole cells, or, as printed, the area of the view over that of a cell.

    Raises
    ------
    InputError
        When a side or the cell is not positive and finite, or the reading is unknown.
    """

    def __init__(self, size: np.ndarray, cell_m: float = DEFAULT_CELL_M, reading: str = "corrected") -> None:
        check_reading(reading)
        cells = cell_counts(size, cell_m)
        size = np.asarray(size, dtype=float)
        self._cell_m = cell_m
        self._half, self._cells = 0.5 * size.T, np.ascontiguousarray(cells.T)  # (3, n): one side after another
        sides = cells if reading == "corrected" else size / cell_m
        self._whole = np.stack([sides[:, row] * sides[:, column] for row, column in VIEW_AXES], axis=1)  # Eq. 8
        self.marks = fastest_marks()(self._cells)

    def __len__(self) -> int:
        return len(self._whole)

    @property
    def clouds_at_a_time(self) -> int:
        """How many clouds can be scored together within the memory that is kept; 1 at least."""
        return self.marks.clouds_at_a_time

    def occupancy(self, points: np.ndarray, vehicle: np.ndarray) -> np.ndarray:
        """P of the top, side and front view of each box (Eqs. 6 to 8), (n, 3).

        Parameters
        ----------
        points : ndarray, (k, 3)
            Points, each in the frame of its own vehicle [m]; finite, which is not checked here. On the rim, or up to
            one cell beyond it, they fall into the rim's cell; further ones are dropped.
        vehicle : ndarray of int64, (k,)
            The box that each point belongs to; in range, which is not checked here either.
        """
        self.marks.begin(1)
        self.marks.mark_points(points, vehicle, self._half, self._cell_m)
        return self.shares(self.marks.counts())[0]

    def shares(self, counts: np.ndarray) -> np.ndarray:
        """P of views (Eq. 7) from the marked cells of each box's views, both (..., n, 3)."""
        return counts / self._whole

    def cells_of(self, points: np.ndarray, vehicle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cell of each point along each axis, (3, j), and its vehicle, (j,), without the points that are dropped."""
        place = places_of(points, vehicle, self._half, self._cell_m)
        place, vehicle, _ = places_kept(place, vehicle, self._cells)
        return whole_cells(place, vehicle, self._cells), vehicle


class PlacedGrids(ViewGrids):
    """The grids of boxes that stand somewhere, for returns as a LiDAR measures them: a direction and a distance.

    Parameters
    ----------
    centre, size : ndarray, (n, 3)
        Box centres; length, width and height [m].
    heading : ndarray, (n,)
        Counter-clockwise from +x [rad].
    cell_m, reading
        As for `ViewGrids`.
    """

    def __init__(
        self,
        centre: np.ndarray,
        size: np.ndarray,
        heading: np.ndarray,
        cell_m: float = DEFAULT_CELL_M,
        reading: str = "corrected",
    ) -> None:
        super().__init__(size, cell_m, reading)
        centre, heading = np.asarray(centre, dtype=float), np.asarray(heading, dtype=float)
        if centre.shape != (len(self), 3) or heading.shape != (len(self),):
            raise InputError(
                f"centre and heading have shapes {centre.shape} and {heading.shape}; "
                f"allowed: {(len(self), 3)} and {(len(self),)}"
            )
        self._centre = centre
        self._cos, self._sin = np.cos(heading), np.sin(heading)

    def returns_occupancy(
        self,
        origins: np.ndarray,
        cloud: np.ndarray | None,
        directions: np.ndarray,
        distance: np.ndarray,
        vehicle: np.ndarray,
        noisy: bool = False,
    ) -> np.ndarray:
        """P of the top, side and front view of each box in each of s clouds (Eqs. 2 to 8), (s, n, 3).

        The same as `occupancy` of each cloud with its returns in their vehicles' frames, in fewer passes over them.

        Parameters
        ----------
        origins : ndarray, (s, 3)
            Optical centre of each cloud, in the frame of the boxes [m].
        cloud : ndarray of int64, (k,), or None
            The cloud that each return belongs to, rising; None where there is one.
        directions : ndarray, (3, k)
            Unit vectors in the frame of the boxes, coordinate by coordinate.
        distance : ndarray, (k,)
            Distance of each return [m].
        vehicle : ndarray of int64, (k,)
            The box whose surface each return comes from.
        noisy : bool
            Whether returns may lie off that surface: those more than a cell beyond the box are then dropped. Otherwise
            that is not checked, and what lies beside the box falls into the rim's cell.
        """
        self.marks.begin(len(origins))
        self.marks.mark_returns(directions, distance, vehicle, cloud, self.starts(origins), self.turning, noisy)
        return self.shares(self.marks.counts())

    def starts(self, origins: np.ndarray) -> np.ndarray:
        """Origins (s, 3) [m] as the grids count them, in cells from each box's rear right lower corner, (3, s n)."""
        x, y, z = np.moveaxis(origins[:, None] - self._centre, -1, 0)
        turned = np.stack([self._cos * x + self._sin * y, self._cos * y - self._sin * x, z])  # Eqs. 4 and 5
        return ((turned + self._half[:, None]) / self._cell_m).reshape(3, -1)

    @property
    def placing(self) -> tuple[np.ndarray, np.ndarray]:
        """The boxes' centres, (n, 3), and half of their sides, (3, n) [m]."""
        return self._centre, self._half

    @property
    def turning(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Cosine and sine of the boxes' headings, (n,) each, and the side of a cell [m]."""
        return self._cos, self._sin, self._cell_m
