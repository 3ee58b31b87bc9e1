"""The hardened search: a swarm for breadth, CMA-ES for depth, and restarts of either when it has nothing left to do.

A swarm (`AdaptiveSwarm`: particle swarm and differential evolution) opens, with up to half of the budget; the climbs
are left what one usually needs. Then a Gaussian climbs (`CovarianceAdaptation`) from the swarm's best point, with the
width and shape of its better half. When that has arrived, or is stuck, the swarm goes on until it has had as many
evaluations as the climbs; then the next climb starts, with twice the samples. A swarm that has collapsed, or has long
found nothing better, is replaced by a new one.

It works in shares of the box and by the order of values alone, so that its candidates do not depend on origin and unit
of a variable, nor on anything that raises all values in order. docs/search.md tells how it was chosen and judged.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, Self

import numpy as np

from ..errors import InputError
from .adaptive_swarm import AdaptiveSwarm
from .checks import check_number, check_whole
from .covariance_adaptation import CovarianceAdaptation
from .recorded import RecordedSearch
from .sampling import generator
from .stored import read_count

_FEWEST = 4  # particles of a swarm, samples of a climb
_NARROWEST, _WIDEST = 1e-3, 0.25  # step sizes that a climb may start with, in shares of the box
_FEWEST_GENERATIONS = 3  # of the opening
_ROUND = 0.1  # share of a round shape in that of a climb that starts: no direction is left out
_MOST_SAMPLES = 1000


@dataclass(frozen=True, slots=True)
class HardenedSettings:
    """Settings of the hardened search; the defaults are what docs/search.md measured.

    Parameters
    ----------
    particles : int
        Of the swarm, 1 or more; fewer where the budget is below ten generations of them, but never fewer than 4.
    evaluations : int
        The budget, 1 or more.
    opening : float
        Largest share of the budget that the swarm opens with.
    reserve : int
        Evaluations for each variable that the opening leaves to the climbs, as far as three generations allow.
    flights : float
        Chance per particle and generation of a particle-swarm move in place of a differential jump.
    greed : float
        Share of the swarm that counts as its better ones.
    turned : float
        Chance of a jump that is crossed over along the eigenvectors of the swarm in place of the variables.
    climbs : bool
        False leaves the whole budget to swarms.

    Raises
    ------
    InputError
        If a setting is outside what is said above.
    """

    particles: int = 20
    evaluations: int = 2000
    opening: float = 0.5
    reserve: int = 250
    flights: float = 0.2
    greed: float = 0.1
    turned: float = 0.3
    climbs: bool = True

    def __post_init__(self) -> None:
        for name, least in (("particles", 1), ("evaluations", 1), ("reserve", 0)):
            object.__setattr__(self, name, check_whole(getattr(self, name), least, name))
        for name in ("opening", "flights", "greed", "turned"):
            object.__setattr__(self, name, check_number(getattr(self, name), 0.0, 1.0, name))
        if not isinstance(self.climbs, bool):
            raise InputError(f"climbs: {self.climbs!r}; allowed: True or False")

    @property
    def swarm(self) -> int:
        """Particles of a swarm within the budget."""
        return max(_FEWEST, min(self.particles, self.evaluations // 10))

    def opening_evaluations(self, variables: int) -> int:
        """Evaluations of the swarm before the first climb."""
        left = max(self.evaluations - self.reserve * variables, _FEWEST_GENERATIONS * self.swarm)
        return min(left, int(self.opening * self.evaluations))


class Hardened(RecordedSearch):
    """The hardened search as an ask/tell search; see `Search` for the methods.

    Parameters
    ----------
    lower, upper : array_like, (d,)
        Bounds of each variable, in any unit.
    seed : int
        Same seed, same candidates.
    settings : HardenedSettings

    Raises
    ------
    InputError
        If the bounds or the seed cannot be used.
    """

    name: ClassVar[str] = "hardened"

    def __init__(
        self, lower: np.ndarray, upper: np.ndarray, *, seed: int, settings: HardenedSettings | None = None
    ) -> None:
        self.settings = settings or HardenedSettings()
        super().__init__(lower, upper, budget=self.settings.evaluations, per_iteration=self.settings.swarm)
        self._seed = check_whole(seed, 0, "seed")
        self._rng = generator(self._seed)
        self._swarm = self._fresh_swarm()
        self._climb: CovarianceAdaptation | None = None
        self._climbing = False  # whose candidates are asked for
        self._climbs = 0
        self._spent = {"swarm": 0, "climbs": 0}
        self._batches: list[int] = []

    def _fresh_swarm(self) -> AdaptiveSwarm:
        use = self.settings
        moves = {"flights": use.flights, "greed": use.greed, "turned": use.turned}
        return AdaptiveSwarm(self._rng, use.swarm, self._lower.size, **moves)

    def _shares(self) -> np.ndarray:
        batch = self._climb.candidates if self._climbing else self._swarm.candidates
        return batch[: self._budget - self.evaluations]

    def _candidates(self) -> np.ndarray:
        scaled = self._lower + self._shares() * (self._upper - self._lower)
        return np.clip(scaled, self._lower, self._upper)

    def tell(self, values: np.ndarray) -> None:
        super().tell(values)
        values = np.asarray(values, dtype=float)
        self._batches.append(values.size)
        if self.done:
            return
        (self._climb if self._climbing else self._swarm).tell(values)
        self._spent["climbs" if self._climbing else "swarm"] += values.size
        self._choose()
        (self._climb if self._climbing else self._swarm).move()

    def _choose(self) -> None:
        """Whose turn it is: the climb's until it is exhausted, the swarm's until it has had its share."""
        if self._climbing and not self._climb.exhausted:
            return
        self._climbing = False
        if self.best_value == -math.inf:  # nothing feasible yet: there is nothing to learn from
            self._swarm = self._fresh_swarm()
            return
        if not self.settings.climbs:
            if self._swarm.exhausted:
                self._swarm = self._fresh_swarm()
            return
        opening = self.settings.opening_evaluations(self._lower.size)
        share = self._spent["climbs"] if self._climbs else opening
        if self._spent["swarm"] >= share or self._swarm.exhausted:
            self._start_climb()

    def _start_climb(self) -> None:
        swarm, d = self._swarm, self._lower.size
        shape = swarm.shape()
        mean_variance = max(float(np.trace(shape)) / d, _NARROWEST**2)
        step = min(math.sqrt(mean_variance), _WIDEST)
        shape = (1.0 - _ROUND) * shape / mean_variance + _ROUND * np.eye(d)
        samples = min((_FEWEST + int(3.0 * math.log(d))) * 2**self._climbs, _MOST_SAMPLES)
        self._climb = CovarianceAdaptation(self._rng, swarm.best[swarm.order[0]], step, samples, shape)
        self._climbing, self._climbs = True, self._climbs + 1
        if swarm.exhausted:
            self._swarm = self._fresh_swarm()

    @property
    def iteration(self) -> int:
        return len(self._batches)

    def _numbering(self) -> tuple[np.ndarray, np.ndarray]:
        batches = np.array(self._batches, dtype=int)
        first = np.repeat(np.cumsum(batches) - batches, batches)
        return np.repeat(np.arange(batches.size), batches), np.arange(self.evaluations) - first

    def _arguments(self) -> dict[str, Any]:
        return {"seed": self._seed, "settings": asdict(self.settings)}

    @classmethod
    def _from_arguments(cls, arguments: dict[str, Any]) -> Self:
        return cls(**{**arguments, "settings": HardenedSettings(**arguments["settings"])})

    def state(self) -> dict[str, Any]:
        return {
            **super().state(),
            "batches": list(self._batches),
            "swarm": self._swarm.state(),
            "climb": None if self._climb is None else self._climb.state(),
            "climbing": self._climbing,
            "climbs": self._climbs,
            "spent": dict(self._spent),
            "random": self._rng.bit_generator.state,
        }

    def _restore(self, state: dict[str, Any]) -> None:
        super()._restore(state)
        self._batches = [read_count({"batches": size}, "batches") for size in state["batches"]]
        if sum(self._batches) != self.evaluations:
            raise InputError(f"batches: {sum(self._batches)} evaluations in all, not {self.evaluations}")
        self._swarm.restore(state["swarm"])
        climb = state["climb"]
        self._climb = None if climb is None else CovarianceAdaptation.restored(self._rng, self._lower.size, climb)
        self._climbing = bool(state["climbing"])
        if self._climbing and climb is None:
            raise InputError("climb: none is stored, but it is its turn")
        self._climbs = read_count(state, "climbs")
        self._spent = {name: read_count(state["spent"], name) for name in ("swarm", "climbs")}
        self._rng.bit_generator.state = state["random"]
