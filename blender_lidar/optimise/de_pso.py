"""DE-PSO, the paper's Algorithm 1: particle-swarm steps (Eqs. 12, 13), differential jumps (Eq. 14), bounds (Eq. 15).

What the paper leaves open, and how it is read here:

- The first iteration evaluates the initial positions (a Latin hypercube, at rest), since no best is known before;
  T iterations of N particles are T N evaluations, 2,000 with the paper's settings.
- r1, r2 and r3 are scalars, drawn for every particle and iteration, as Algorithm 1 writes them.
- A particle that Eq. 15 puts on a bound keeps its velocity.
- Lines 13 and 16 compare a value with a position, which has no meaning; both readings compare values with values.

The swarm moves in the user's own units. Every equation is linear and acts on each variable alone, so the corrected
reading does not depend on origin or scale; the literal Eq. 14 depends on the origin.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..metrics.view_grids import check_reading
from ..names import ITERATIONS, PARTICLES
from .search import Search, check_number, check_whole, distinct_donors, generator, latin_hypercube, wrapped


@dataclass(frozen=True, slots=True)
class DePsoSettings:
    """Settings of DE-PSO; the defaults are the paper's (section V.A).

    Parameters
    ----------
    particles : int
        N, 3 or more: Eq. 14 takes three different ones.
    iterations : int
        T, 1 or more.
    inertia, differential_weight, cognitive, social : float
        w1, w2, a1 and a2, zero or more.
    differential_threshold : float
        gamma, the chance per particle and iteration of a differential jump, 0 to 1.
    reading : {"corrected", "paper"}
        ``"corrected"``: Eq. 14 without the position that Eq. 13 adds anyway, i, j and k distinct, and the whole swarm
        asked for at once. ``"paper"``: Eq. 14 as printed, j and k any two particles, and one candidate at a time, as
        Algorithm 1 updates the best inside its loop.

    Raises
    ------
    InputError
        If a setting is outside what is said above.
    """

    particles: int = PARTICLES
    iterations: int = ITERATIONS
    inertia: float = 0.7
    differential_weight: float = 0.5
    cognitive: float = 0.3
    social: float = 0.2
    differential_threshold: float = 0.1
    reading: str = "corrected"

    def __post_init__(self) -> None:
        check_whole(self.particles, 3, "particles")
        check_whole(self.iterations, 1, "iterations")
        for name in ("inertia", "differential_weight", "cognitive", "social"):
            check_number(getattr(self, name), 0.0, math.inf, name)
        check_number(self.differential_threshold, 0.0, 1.0, "differential_threshold")
        check_reading(self.reading)


class DePso(Search):
    """DE-PSO as an ask/tell search; see `Search` for the methods.

    Parameters
    ----------
    lower, upper : array_like, (d,)
        Bounds of each variable, in any unit.
    seed : int
        Same seed, same candidates.
    settings : DePsoSettings
    periodic : sequence of bool, (d,), optional
        Which variables are circles: Eq. 15 wraps there, and differences go the short way.

    Raises
    ------
    InputError
        If the bounds or the seed cannot be used.
    """

    name: ClassVar[str] = "de-pso"

    def __init__(
        self,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        seed: int,
        settings: DePsoSettings | None = None,
        periodic: Sequence[bool] | None = None,
    ) -> None:
        self.settings = settings or DePsoSettings()
        particles = self.settings.particles
        budget = particles * self.settings.iterations
        super().__init__(lower, upper, budget=budget, per_iteration=particles, periodic=periodic)
        self._rng = generator(seed)
        self._position = latin_hypercube(self._rng, particles, self.lower, self.upper)  # Algorithm 1, line 1
        self._velocity = np.zeros_like(self._position)  # Algorithm 1, line 1
        self._personal_best = self._position.copy()
        self._personal_best_value = np.full(particles, -math.inf)

    @property
    def _turn(self) -> np.ndarray:
        """The particles whose candidates are asked for together."""
        particles = self.settings.particles
        if self.settings.reading == "paper":
            return np.array([self.evaluations % particles])
        return np.arange(particles)

    def _candidates(self) -> np.ndarray:
        return self._position[self._turn]

    def _learn(self, candidates: np.ndarray, values: np.ndarray) -> None:
        # the best of all is on record: Algorithm 1, lines 16 to 18
        i = np.arange(self.evaluations - len(values), self.evaluations) % self.settings.particles
        better = values > self._personal_best_value[i]  # Algorithm 1, line 13
        self._personal_best[i[better]] = candidates[better]  # Algorithm 1, line 14
        self._personal_best_value[i[better]] = values[better]
        if not self.done and self.evaluations >= self.settings.particles:
            self._move(self._turn)

    def _move(self, i: np.ndarray) -> None:
        """Move the particles `i` by lines 4 to 11 of Algorithm 1, all from the positions before the move."""
        use = self.settings
        draws = self._rng.random((i.size, 5))
        r1, r2, r3 = draws[:, 0:1], draws[:, 1:2], draws[:, 2:3]  # Algorithm 1, lines 4 and 6
        j, k = self._partners(i, draws[:, 3], draws[:, 4])
        position = self._position[i]
        velocity = use.inertia * self._velocity[i]  # Eq. 12
        velocity += use.cognitive * r1 * self._step(position, self._personal_best[i])  # Eq. 12
        velocity += use.social * r2 * self._step(position, self.best_x)  # Eq. 12
        jump = use.differential_weight * self._step(self._position[k], self._position[j])  # Eq. 14
        if use.reading == "paper":
            jump = position + jump  # Eq. 14 as printed: Eq. 13 then adds the position a second time
        velocity = np.where(r3 < use.differential_threshold, jump, velocity)  # Algorithm 1, line 7
        position = position + velocity  # Eq. 13
        turned = self.lower + np.mod(position - self.lower, self.upper - self.lower)
        self._position[i] = np.where(self.periodic, turned, np.clip(position, self.lower, self.upper))  # Eq. 15
        self._velocity[i] = velocity

    def _step(self, start: np.ndarray, end: np.ndarray) -> np.ndarray:
        return wrapped(end - start, self.periodic, self.upper - self.lower)

    def _partners(self, i: np.ndarray, u_j: np.ndarray, u_k: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Particles j and k of Eq. 14 from uniform draws: distinct, and in the corrected reading neither is i."""
        particles = self.settings.particles
        if self.settings.reading == "paper":
            j = (u_j * particles).astype(int)
            k = (u_k * (particles - 1)).astype(int)
            return j, k + (k >= j)
        return distinct_donors(i, (u_j * (particles - 1)).astype(int), (u_k * (particles - 2)).astype(int))
