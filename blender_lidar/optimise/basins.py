"""Where else a landscape may have a maximum, told from points that were evaluated.

A point whose nearest better one is far is the best of a basin as far as anybody knows; on a slope the nearest better
one is near (nearest-better clustering: Preuss, Niching the CMA-ES via nearest-better clustering, GECCO 2010). Points
are shares of the box, 0 to 1 in every variable; distances are root mean squares over the variables. Only the order of
values counts.
"""

from __future__ import annotations

import math

import numpy as np

WATCHED = 1000  # the best points; what they say of each other does not depend on worse ones


class Basins:
    """The best points so far, and how far each is from the nearest better one.

    Of equal points the earlier counts as better.

    Parameters
    ----------
    variables : int
    """

    def __init__(self, variables: int) -> None:
        self._points = np.empty((0, variables))  # best first, as all three
        self._values = np.empty(0)
        self._nearest = np.empty(0)

    def add(self, points: np.ndarray, values: np.ndarray) -> None:
        """Take further points, (n, d), and their values, (n,); ``-inf`` says that one is infeasible."""
        feasible = values > -math.inf
        if not feasible.any():
            return
        known, new = len(self._points), points[feasible]
        points = np.concatenate([self._points, new])
        values = np.concatenate([self._values, values[feasible]])
        order = np.argsort(-values, kind="stable")
        rank = np.empty(len(order), dtype=int)
        rank[order] = np.arange(len(order))
        distances = _distances(new[:, None], points)
        is_better = rank < rank[known:, None]  # of two points, columns over rows
        of_new = np.where(is_better, distances, math.inf).min(axis=1)
        of_known = np.where(is_better, math.inf, distances)[:, :known].min(axis=0)
        nearest = np.concatenate([np.minimum(self._nearest, of_known), of_new])
        best = order[:WATCHED]
        self._points, self._values, self._nearest = points[best], values[best], nearest[best]

    def unclimbed(self, climbed: np.ndarray) -> tuple[np.ndarray, float] | None:
        """The best point that tops a basin nobody has climbed, and its distance to the nearest better one.

        Parameters
        ----------
        climbed : ndarray, (n, d)
            Where climbs began and ended; one or more.

        Returns
        -------
        start, distance : ndarray, (d,), and float
            The distance is ``inf`` for the best point of all. None where every point has a better one, or a climb's
            beginning or end, within the mean distance of a point to its nearest better one.
        """
        if len(self._points) < 2:
            return None
        near = self._nearest[1:].mean()
        for place in np.flatnonzero(self._nearest >= near):
            if _distances(climbed, self._points[place]).min() >= near:
                return self._points[place], float(self._nearest[place])
        return None


def _distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.sqrt(np.square(points - others).mean(axis=-1))
