"""What a LiDAR measures beside the truth: noisy ranges and lost returns, the same for the same seed.

Every beam of a turn draws its own numbers, which belong to the seed, the frame, the ring and the firing column alone.
So they are the same whatever the mounting (common random numbers: two mountings differ by what they see, not by luck),
the caster, the culling, the number of workers and the order in which anything is asked.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .beams import BeamLattice

MOST_RANGE_NOISE_M = 10.0
_MOST_DEVIATIONS = 6.0  # noise is cut off here, so that its reach is known; a normal draw is beyond once in 5e8
_NOISE, _CHANCE = range(2)  # streams of random numbers: one is the same whether or not the other is drawn
_FRAME_NUMBERS = 2**64  # seeds are not negative; frame numbers may be


@dataclass(frozen=True, slots=True)
class Imperfections:
    """How a sensor's returns differ from the truth; by default not at all.

    Attributes
    ----------
    range_noise_m : float
        Standard deviation of the Gaussian error of a range [m], 0 to `MOST_RANGE_NOISE_M`.
    dropout : float
        Probability that a return is lost, in [0, 1); independent from beam to beam and from frame to frame.
    seed : int
        Of both, 0 or more.

    Raises
    ------
    InputError
        When one of them is out of its range or not a number.
    """

    range_noise_m: float = 0.0
    dropout: float = 0.0
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0.0 <= self.range_noise_m <= MOST_RANGE_NOISE_M:  # NaN fails too
            raise InputError(f"range_noise_m is {self.range_noise_m}; allowed: 0 to {MOST_RANGE_NOISE_M:g}")
        if not 0.0 <= self.dropout < 1.0:
            raise InputError(f"dropout is {self.dropout}; allowed: at least 0 and below 1")
        if self.seed < 0 or self.seed != int(self.seed):
            raise InputError(f"seed is {self.seed}; allowed: a whole number, 0 or more")

    @property
    def most_noise_m(self) -> float:
        """The farthest that noise moves a return [m]: beams are cast so far beyond the range gate."""
        return _MOST_DEVIATIONS * self.range_noise_m

    def draws(self, lattice: BeamLattice, frame: int) -> FrameDraws | None:
        """What the beams of one frame draw; None where nothing is drawn."""
        if not (self.range_noise_m or self.dropout):
            return None
        noise = chance = None
        if self.range_noise_m:
            deviations = self._generator(frame, _NOISE).standard_normal((lattice.rings, lattice.columns), np.float32)
            np.clip(deviations, -_MOST_DEVIATIONS, _MOST_DEVIATIONS, out=deviations)
            deviations *= np.float32(self.range_noise_m)
            noise = _by_slot(lattice, deviations)
        if self.dropout:
            chance = _by_slot(
                lattice, self._generator(frame, _CHANCE).random((lattice.rings, lattice.columns), np.float32)
            )
        return FrameDraws(noise, chance, self.dropout)

    def _generator(self, frame: int, stream: int) -> np.random.Generator:
        key = (int(frame) % _FRAME_NUMBERS, stream)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(self.seed), spawn_key=key)))


PERFECT = Imperfections()


@dataclass(frozen=True, slots=True, eq=False)
class FrameDraws:
    """What the beams of one frame have drawn; by flat index into the lattice, ``ring * columns + slot``.

    Chances are kept, not what comes of them: a drop-out that depends on range or incidence needs nothing else here.

    Attributes
    ----------
    noise_m : ndarray of float32, (beams,), or None
        Error of the range of each beam's return [m].
    chance : ndarray of float32, (beams,), or None
        Uniform in [0, 1): the return is lost where the probability of that is greater.
    dropout : float
        That probability.
    """

    noise_m: np.ndarray | None
    chance: np.ndarray | None
    dropout: float

    def measured(self, beam: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Ranges as the sensor measures them, (k,) [m]; inf where the return is lost.

        To be judged by the range gate afterwards: noise carries returns across it both ways.

        Parameters
        ----------
        beam : ndarray of int, (k,)
            Flat indices of the beams, in range, which is not checked.
        distance : ndarray, (k,)
            Distance to what each met first [m]; inf where it met nothing.
        """
        if self.noise_m is not None:
            distance = distance + np.take(self.noise_m, beam, mode="clip")
        if self.chance is not None:
            distance = np.where(np.take(self.chance, beam, mode="clip") < self.dropout, math.inf, distance)
        return distance


def _by_slot(lattice: BeamLattice, drawn: np.ndarray) -> np.ndarray:
    """Draws by (ring, firing column), flat in the lattice's order by (ring, slot)."""
    ring = np.arange(lattice.rings)[:, None]
    return drawn[ring, lattice.column(ring, np.arange(lattice.columns))].ravel()
