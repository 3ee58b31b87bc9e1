"""Where else a landscape may have a maximum, told from points that were evaluated.

A point whose nearest better one is far tops a basin, as far as anybody knows; on a slope the nearest better one is near
(after nearest-better clustering: Preuss, Niching the CMA-ES via nearest-better clustering, GECCO 2010). Points are
shares of the box, 0 to 1 in every variable; distances are root mean squares over the variables. Only the order of
values counts.
"""

from __future__ import annotations

import math

import numpy as np

WATCHED = 1000  # the best points alone are kept; their nearest better ones are among them


class Basins:
    """The best points so far, and how far each is from the nearest better one.

    Of equal points the earlier counts as better.

    Parameters
    ----------
    variables : int
    """

    def __init__(self, variables: int) -> None:
        self._points = np.empty((0, variables))  # this and the others from the best point to the worst
        self._values = np.empty(0)
        self._nearest = np.empty(0)

    def add(self, points: np.ndarray, values: np.ndarray) -> None:
        """Take further points, (n, d), and their values, (n,); ``-inf`` says that one is infeasible."""
        known, feasible = len(self._points), values > -math.inf
        points = np.concatenate([self._points, points[feasible]])
        values = np.concatenate([self._values, values[feasible]])
        nearest = np.concatenate([self._nearest, np.full(len(values) - known, math.inf)])
        best = np.argsort(-values, kind="stable")[:WATCHED]
        is_new = best >= known
        self._points, self._values, self._nearest = points[best], values[best], nearest[best]
        for place in np.flatnonzero(is_new):
            distances = _distances(self._points, self._points[place])
            self._nearest[place] = distances[:place].min(initial=math.inf)
            self._nearest[place + 1 :] = np.minimum(self._nearest[place + 1 :], distances[place + 1 :])

    def unclimbed(self, climbed: np.ndarray) -> tuple[np.ndarray, float] | None:
        """The best point that may top a basin nobody has climbed, and its distance to the nearest better one.

        Near is the mean distance of a point to its nearest better one: among many points some are farther by chance.
        That costs little climbs, and tries out ragged tops. As climbs add points, near shrinks.

        Parameters
        ----------
        climbed : ndarray, (n, d)
            Where climbs began and ended.

        Returns
        -------
        start, distance : ndarray, (d,), and float
            The distance is ``inf`` for the best point of all. None where every point has a better one, or a climb's
            beginning or end, near.
        """
        if len(self._points) < 2:
            return None
        near = self._nearest[1:].mean()
        for place in np.flatnonzero(self._nearest > near):
            if _distances(climbed, self._points[place]).min() > near:
                return self._points[place], float(self._nearest[place])
        return None


def _distances(points: np.ndarray, point: np.ndarray) -> np.ndarray:
    return np.sqrt(np.square(points - point).mean(axis=1))
