"""A swarm whose particles fly (constricted particle swarm) or jump (success-history differential evolution).

Both moves act on one set of personal bests, as in Zhang and Xie's DEPSO (2003). What the moves are made of:

- flight: constriction coefficients of Clerc and Kennedy (2002), fresh draws for every variable, towards the particle's
  own best and one of the swarm's better ones;
- jump: current-to-pbest/1 with an archive of replaced points (Zhang and Sanderson's JADE, 2009), scale factor and
  crossover rate learnt from what succeeded (Tanabe and Fukunaga's SHADE, 2013) but weighted by rank, never by value;
  crossover variable by variable, or along the eigenvectors of the better half (Guo and Yang, 2015), as a landscape
  may follow the variables or be turned;
- bounds reflect, and turn the velocity round; a tie is accepted, so that a swarm drifts over a plateau.

Only the order of values counts. Positions are shares of the box, 0 to 1 in every variable.
"""

from __future__ import annotations

import math

import numpy as np

from .search import distinct_donors, latin_hypercube, wrapped

CONSTRICTION = 0.7298  # Clerc and Kennedy (2002)
ATTRACTION = 1.49618  # each of both: 0.7298 * 4.1 / 2
FLIGHTS = 0.2  # share of the moves, the others are jumps
GREED = 0.1  # share of the personal bests that count as the swarm's better ones, two of them at least
TURNED = 0.3  # share of the jumps that are crossed over along eigenvectors
MEMORY = 5  # entries of the success history
FIRST_SCALE, FIRST_CROSSOVER = 0.5, 0.7
DRAW_WIDTH = 0.1  # of scale factors (Cauchy) and crossover rates (normal) about the memory
LEAST_SCALE = 0.05
COLLAPSED = 1e-3  # of the box: a swarm no wider than that in every variable has nothing left to tell apart
SWARM_PATIENCE = 30  # generations without a better best


class AdaptiveSwarm:
    """Particles that fly or jump, generation by generation.

    Parameters
    ----------
    rng : Generator
        Shared with the caller.
    particles, variables : int
        4 or more particles; 1 or more variables.
    periodic : ndarray of bool, (variables,)
        Which variables are circles: there particles go through the walls, and the short way.

    Attributes
    ----------
    candidates : ndarray, (particles, variables)
        What to evaluate next.
    best, value : ndarray, (particles, variables) and (particles,)
        Personal bests and their values; ``-inf`` before the first.
    """

    def __init__(self, rng: np.random.Generator, particles: int, variables: int, periodic: np.ndarray) -> None:
        self._rng, self._periodic = rng, periodic
        self._greedy = max(2, round(GREED * particles))
        self._position = latin_hypercube(rng, particles, np.zeros(variables), np.ones(variables))
        self._velocity = np.zeros((particles, variables))
        self.best, self.value = self._position.copy(), np.full(particles, -math.inf)
        self.candidates = self._position.copy()
        self._next_velocity = self._velocity.copy()
        self._flown = np.zeros(particles, dtype=bool)
        self._scales, self._crossovers = np.full(MEMORY, FIRST_SCALE), np.full(MEMORY, FIRST_CROSSOVER)
        self._oldest = 0  # of the memory
        self._replaced = np.empty((0, variables))
        self._idle = 0
        self._has_values = False  # until then `candidates` are the first positions

    @property
    def order(self) -> np.ndarray:
        """Particles from the best personal best to the worst."""
        return np.argsort(-self.value, kind="stable")

    def shape(self) -> np.ndarray:
        """Covariance of the better half of the personal bests, (variables, variables)."""
        variables = self.best.shape[1]
        better = self._together()[self.order[: max(2, len(self.best) // 2)]]
        return np.cov(better.T).reshape(variables, variables)

    @property
    def exhausted(self) -> bool:
        """Whether the swarm has collapsed, or has long found nothing better."""
        return bool(self._idle >= SWARM_PATIENCE or np.ptp(self._together(), axis=0).max() < COLLAPSED)

    def _together(self) -> np.ndarray:
        """The personal bests, those of a circle cut open opposite the best of them."""
        best = self.best[self.order[0]]
        return np.where(self._periodic, best + self._step(best, self.best), self.best)

    def _step(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        return wrapped(end - start, self._periodic)

    def tell(self, values: np.ndarray) -> None:
        """Take the values, (particles,), of `candidates`, and keep what is at least as good."""
        reached = self.value.max()
        kept, better = values >= self.value, values > self.value
        self._learn(values, better & ~self._flown)
        replaced = self.best[better & np.isfinite(self.value)]
        if len(replaced):
            archive = np.concatenate([self._replaced, replaced])
            self._replaced = archive[np.sort(self._rng.permutation(len(archive))[: len(self.best)])]
        moved = kept | self._flown
        self._position[moved], self._velocity[moved] = self.candidates[moved], self._next_velocity[moved]
        self.best[kept], self.value[kept] = self.candidates[kept], values[kept]
        self._idle = 0 if values.max() > reached else self._idle + 1
        self._has_values = True

    def move(self) -> None:
        """Draw the next `candidates`; the first are where the particles start."""
        if not self._has_values:
            return
        particles, variables = self.best.shape
        guide = self.best[self.order[self._rng.integers(self._greedy, size=particles)]]
        target = self.best + self._jumps(guide)
        self._flown = self._rng.random(particles) < FLIGHTS
        own, social = self._rng.random((2, particles, variables))
        flight = CONSTRICTION * self._velocity
        flight += ATTRACTION * own * self._step(self._position, self.best)
        flight += ATTRACTION * social * self._step(self._position, guide)
        flown = self._flown[:, None]
        velocity = np.where(flown, flight, target - self.best)
        target = np.where(flown, self._position + flight, target)
        self.candidates = np.where(self._periodic, np.mod(target, 1.0), reflected(target))
        hits_wall = ((target < 0.0) | (target > 1.0)) & ~self._periodic
        self._next_velocity = np.where(hits_wall, -0.5 * velocity, velocity)

    def _jumps(self, guide: np.ndarray) -> np.ndarray:
        """Steps of current-to-pbest/1 from the personal bests, crossed over."""
        particles, variables = self.best.shape
        self._draw_rates()
        i, pool = np.arange(particles), np.concatenate([self.best, self._replaced])
        others, left = (self._rng.integers(count, size=particles) for count in (particles - 1, len(pool) - 2))
        j, k = distinct_donors(i, others, left)
        step = self._scale[:, None] * self._jump(guide, self.best[j], pool[k])
        crossed = self._rng.random((particles, variables)) < self._crossover[:, None]
        crossed[i, self._rng.integers(variables, size=particles)] = True
        _, axes = np.linalg.eigh(self.shape())
        turned = (self._rng.random(particles) < TURNED)[:, None]
        return np.where(turned, np.where(crossed, step @ axes, 0.0) @ axes.T, np.where(crossed, step, 0.0))

    def _jump(self, guide: np.ndarray, here: np.ndarray, there: np.ndarray) -> np.ndarray:
        """From the personal bests to the guide, and from there to here; circles the short way."""
        straight = guide - self.best + here - there
        return np.where(self._periodic, self._step(self.best, guide) + self._step(there, here), straight)

    def _draw_rates(self) -> None:
        """Scale factors (Cauchy, redrawn by reflection above 0) and crossover rates (normal) about the memory."""
        particles = len(self.best)
        entry = self._rng.integers(MEMORY, size=particles)
        cauchy = np.tan(math.pi * (self._rng.random(particles) - 0.5))
        self._scale = np.clip(np.abs(self._scales[entry] + DRAW_WIDTH * cauchy), LEAST_SCALE, 1.0)
        self._crossover = np.clip(self._rng.normal(self._crossovers[entry], DRAW_WIDTH), 0.0, 1.0)

    def _learn(self, values: np.ndarray, succeeded: np.ndarray) -> None:
        """Overwrite the oldest entry of the memory by what succeeded, weighted by the rank of what it reached."""
        if not succeeded.any() or not np.isfinite(self.value).all():
            return
        weight = 1.0 + np.argsort(np.argsort(values, kind="stable"), kind="stable")[succeeded]
        scale, crossover = self._scale[succeeded], self._crossover[succeeded]
        self._scales[self._oldest] = (weight * scale**2).sum() / (weight * scale).sum()
        self._crossovers[self._oldest] = (weight * crossover).sum() / weight.sum()
        self._oldest = (self._oldest + 1) % MEMORY


def reflected(target: np.ndarray) -> np.ndarray:
    """Reflecting bounds: points folded back into the unit box at its walls, however far outside they lie."""
    folded = np.mod(target, 2.0)
    return np.where(folded > 1.0, 2.0 - folded, folded)
