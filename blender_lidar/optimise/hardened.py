"""The hardened search: in rounds, a swarm for breadth and then CMA-ES for depth, from one top to the next.

A swarm (`AdaptiveSwarm`: particle swarm and differential evolution) opens, with a third of a round, or until it has
collapsed. Then a Gaussian climbs (`CovarianceAdaptation`) from the swarm's best point, with the width and shape of its
better half; further ones climb other basins, the best first, as the points evaluated so far tell of them (`Basins`).
A climb ends when it has arrived, is stuck, or has become narrow below the best that is known. After 1,000 evaluations
for each variable, or when no basin is left, the next round begins with another swarm.

It works in shares of the box and by the order of values alone, so that its candidates do not depend on origin and unit
of a variable, nor on anything that raises all values in order. How it was chosen and judged: docs/evidence/search.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ..names import PARTICLES
from .adaptive_swarm import AdaptiveSwarm
from .cma_es import NARROW, CovarianceAdaptation
from .search import Search, check_whole, generator, in_box, wrapped

# --- Where else a landscape may have a maximum, guessed from evaluated points -----------------------------
# A point whose nearest better one is far tops a basin, as far as anybody knows; on a slope the nearest better one is
# near (after nearest-better clustering: Preuss, Niching the CMA-ES via nearest-better clustering, GECCO 2010). Points
# are shares of the box, 0 to 1 in every variable; distances are root mean squares over the variables. Only the order
# of values counts.

WATCHED = 1000  # the best points alone are kept; their nearest better ones are among them


class Basins:
    """Nearest-better clustering: the best points so far, and how far each is from the nearest better one.

    Of equal points the earlier counts as better.

    Parameters
    ----------
    periodic : ndarray of bool, (d,)
        Which variables are circles.
    """

    def __init__(self, periodic: np.ndarray) -> None:
        self._periodic = periodic
        self._points = np.empty((0, len(periodic)))  # this and the others from the best point to the worst
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
            distances = self._distances(self._points, self._points[place])
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
            if self._distances(climbed, self._points[place]).min() > near:
                return self._points[place], float(self._nearest[place])
        return None

    def _distances(self, points: np.ndarray, point: np.ndarray) -> np.ndarray:
        return np.sqrt(np.square(wrapped(points - point, self._periodic)).mean(axis=1))


# --- The search, round after round ------------------------------------------------------------------------------------

_FEWEST = 4  # particles of a swarm, samples of a climb
_OPENING = 0.35  # share of a round that a swarm opens with
_NARROWEST, _WIDEST = 1e-3, 0.25  # step sizes that a climb may start with, in shares of the box
_FEWEST_GENERATIONS = 3  # of the opening
_ROUNDNESS = 0.1  # share of a round shape in that of a climb that starts: no direction is left out
_ROUND = 1000  # evaluations for each variable
_HOPELESS = 0.01  # of the box: a generation no wider than that, below the best known, will hardly get there
_HOPE = 3  # generations that a climb has in any case, and that one point has to find a better


class Polish(Search):
    """Local search by CMA-ES from a point that is known to be good, the best of some; see `Search` for the methods.

    Parameters
    ----------
    lower, upper : array_like, (d,)
        Bounds of each variable, in any unit.
    start : ndarray, (d,) or (n, d)
        The point, or several, which are evaluated first: the best of them is where the climb starts.
    seed : int
        Same seed, same candidates.
    evaluations : int
        The most that it makes, or as many as there are points; it ends earlier where it has arrived.
    step : float
        Step size that the climb starts with, in shares of the box.
    periodic : sequence of bool, (d,), optional
        Which variables are circles.
    """

    name: ClassVar[str] = "polish"
    label = "polish"

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        start: np.ndarray,
        seed: int,
        evaluations: int,
        step: float = 0.03,
        periodic: Sequence[bool] | None = None,
    ) -> None:
        starts = np.atleast_2d(np.asarray(start, dtype=float))
        super().__init__(lower, upper, budget=max(evaluations, len(starts)), periodic=periodic)
        self._starts = np.clip(self._shares(starts), 0.0, 1.0)
        self._rng, self._step = generator(seed), step
        self._climb: CovarianceAdaptation | None = None

    def _shares(self, x: np.ndarray) -> np.ndarray:
        return (x - self.lower) / (self.upper - self.lower)

    def _candidates(self) -> np.ndarray:
        shares = self._starts if self._climb is None else self._climb.candidates[: self.budget - self.evaluations]
        return in_box(shares, self.lower, self.upper)

    def _learn(self, candidates: np.ndarray, values: np.ndarray) -> None:
        if self._climb is None:
            samples = _FEWEST + int(3.0 * math.log(self.lower.size))
            best = self._starts[int(np.argmax(values))]
            self._climb = CovarianceAdaptation(self._rng, best, self._step, samples, None, self.periodic)
        elif not self.evaluations >= self.budget:
            self._climb.tell(values)
        self._climb.move()

    @property
    def done(self) -> bool:
        """Whether the budget is spent, or the climb has ended."""
        return super().done or (self._climb is not None and self._climb.exhausted)


class Hardened(Search):
    """The hardened search as an ask/tell search; see `Search` for the methods.

    Parameters
    ----------
    lower, upper : array_like, (d,)
        Bounds of each variable, in any unit.
    seed : int
        Same seed, same candidates.
    particles : int
        Of a swarm, 1 or more; fewer where the budget is below ten generations of them, but never fewer than 4.
    evaluations : int
        The budget, 1 or more.
    periodic : sequence of bool, (d,), optional
        Which variables are circles.

    Raises
    ------
    InputError
        If the bounds, the seed or a number cannot be used.
    """

    name: ClassVar[str] = "hardened"

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        seed: int,
        particles: int = PARTICLES,
        evaluations: int = 2000,
        periodic: Sequence[bool] | None = None,
    ) -> None:
        super().__init__(lower, upper, budget=check_whole(evaluations, 1, "evaluations"), periodic=periodic)
        self._particles = max(_FEWEST, min(check_whole(particles, 1, "particles"), self.budget // 10))
        self._rng = generator(seed)
        self._begin_round()
        self._climb: CovarianceAdaptation | None = None  # whose candidates are asked for, else the swarm's
        self._basins = Basins(self.periodic)
        self._climbed: list[np.ndarray] = []  # where climbs began and ended, in shares of the box

    def _begin_round(self) -> None:
        self._swarm = AdaptiveSwarm(self._rng, self._particles, self.lower.size, self.periodic)
        self._began = self.evaluations
        self._followed = False  # whether a climb has started from its best

    def _candidates(self) -> np.ndarray:
        shares = (self._climb or self._swarm).candidates[: self.budget - self.evaluations]
        return in_box(shares, self.lower, self.upper)

    def _learn(self, candidates: np.ndarray, values: np.ndarray) -> None:
        if self.done:
            return
        self._basins.add((candidates - self.lower) / (self.upper - self.lower), values)
        if self._climb is None:
            self._swarm.tell(values)
        else:
            self._climb.tell(values)
            if self._over():
                self._climbed.append(self._climb.mean)
                self._climb = None
        if self._climb is None:
            self._choose()
        (self._climb or self._swarm).move()

    def _over(self) -> bool:
        """Whether the climb has ended, has become one point, or will hardly reach the best that is known."""
        climb = self._climb
        width = climb.width
        collapsed = width < NARROW and climb.idle > _HOPE
        hopeless = width < _HOPELESS and climb.generation > _HOPE and climb.reached < self.best_value
        return bool(climb.exhausted or collapsed or hopeless)

    def _choose(self) -> None:
        """A climb starts once the swarm has had its share or nothing left to do, as long as the round lasts."""
        swarm, spent = self._swarm, self.evaluations - self._began
        whole = _ROUND * self.lower.size  # the round, after which no climb starts without another swarm
        if swarm.value.max() == -math.inf:  # nothing feasible: there is nothing to learn from
            self._begin_round()
        elif not self._followed:
            share = int(_OPENING * min(whole, self.budget - self._began))
            opening = max(share, _FEWEST_GENERATIONS * self._particles)
            if spent >= opening or swarm.exhausted:
                self._followed = True
                self._start_climb(swarm.best[swarm.order[0]], *self._width_and_shape())
        else:
            found = self._basins.unclimbed(np.array(self._climbed)) if spent < whole else None
            if found is None:
                self._begin_round()
            else:
                start, distance = found
                self._start_climb(start, max(distance / 2.0, _NARROWEST))

    def _width_and_shape(self) -> tuple[float, np.ndarray]:
        """Step size and shape, (d, d), of the swarm's better half."""
        shape, d = self._swarm.shape(), self.lower.size
        mean_variance = max(float(np.trace(shape)) / d, _NARROWEST**2)
        return math.sqrt(mean_variance), (1.0 - _ROUNDNESS) * shape / mean_variance + _ROUNDNESS * np.eye(d)

    def _start_climb(self, start: np.ndarray, step: float, shape: np.ndarray | None = None) -> None:
        samples = _FEWEST + int(3.0 * math.log(self.lower.size))
        self._climb = CovarianceAdaptation(self._rng, start, min(step, _WIDEST), samples, shape, self.periodic)
        self._climbed.append(start.copy())
