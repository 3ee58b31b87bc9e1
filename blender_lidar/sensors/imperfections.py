"""What a LiDAR measures beside the truth: noisy ranges and lost returns, the same for the same seed.

Every beam of a turn draws its own numbers, which belong to the seed, the frame, the ring and the firing column alone.
So they are the same whatever the mounting (common random numbers: two mountings differ by what they see, not by luck),
the caster, the culling, the number of workers and the order in which anything is asked.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass

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
    glass_dropout : float
        Probability that a return from glass is lost, in [0, 1], besides; 1: windows return nothing. Panes mirror light
        away or let it pass. What lies behind a window does not return in its place: the light would have to pass glass
        twice, in and out again, and vehicles have no inside here.
    range_at_10_percent_m : float or None
        Farthest range at which a target of 10 % reflectivity that faces the sensor is seen [m], more than 0: what
        returns more weakly is lost, as `detection_range` says. None: nothing is too weak.
    seed : int
        Of all draws, 0 or more.

    Raises
    ------
    InputError
        When one of them is out of its range or not a number.
    """

    range_noise_m: float = 0.0
    dropout: float = 0.0
    _: KW_ONLY
    glass_dropout: float = 0.0
    range_at_10_percent_m: float | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        if not 0.0 <= self.range_noise_m <= MOST_RANGE_NOISE_M:  # NaN fails too
            raise InputError(f"range_noise_m is {self.range_noise_m}; allowed: 0 to {MOST_RANGE_NOISE_M:g}")
        if not 0.0 <= self.dropout < 1.0:
            raise InputError(f"dropout is {self.dropout}; allowed: at least 0 and below 1")
        if not 0.0 <= self.glass_dropout <= 1.0:
            raise InputError(f"glass_dropout is {self.glass_dropout}; allowed: 0 to 1")
        if self.range_at_10_percent_m is not None and not 0.0 < self.range_at_10_percent_m < math.inf:
            raise InputError(f"range_at_10_percent_m is {self.range_at_10_percent_m}; allowed: more than 0")
        if self.seed < 0 or self.seed != int(self.seed):
            raise InputError(f"seed is {self.seed}; allowed: a whole number, 0 or more")

    @property
    def most_noise_m(self) -> float:
        """The farthest that noise moves a return [m]: beams are cast so far beyond the range gate."""
        return _MOST_DEVIATIONS * self.range_noise_m

    @property
    def _loses_by_chance(self) -> bool:
        return self.dropout > 0.0 or 0.0 < self.glass_dropout < 1.0

    def draws(self, lattice: BeamLattice, frame: int) -> FrameDraws | None:
        """What the beams of one frame draw, and so measure; None where that is the truth."""
        if not (self.range_noise_m or self.dropout or self.glass_dropout):
            return None
        noise = chance = None
        if self.range_noise_m:
            deviations = self._generator(frame, _NOISE).standard_normal((lattice.rings, lattice.columns), np.float32)
            np.clip(deviations, -_MOST_DEVIATIONS, _MOST_DEVIATIONS, out=deviations)
            deviations *= np.float32(self.range_noise_m)
            noise = _by_slot(lattice, deviations)
        if self._loses_by_chance:
            chance = _by_slot(
                lattice, self._generator(frame, _CHANCE).random((lattice.rings, lattice.columns), np.float32)
            )
        return FrameDraws(noise, chance, self.dropout, self.dropout + (1.0 - self.dropout) * self.glass_dropout)

    def _generator(self, frame: int, stream: int) -> np.random.Generator:
        key = (int(frame) % _FRAME_NUMBERS, stream)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(self.seed), spawn_key=key)))


PERFECT = Imperfections()


@dataclass(frozen=True, slots=True, eq=False)
class FrameDraws:
    """What the beams of one frame have drawn; by flat index into the lattice, ``ring * columns + slot``.

    Chances are kept, not what comes of them, which depends on what a beam meets.

    Attributes
    ----------
    noise_m : ndarray of float32, (beams,), or None
        Error of the range of each beam's return [m].
    chance : ndarray of float32, (beams,), or None
        Uniform in [0, 1): the return is lost where the probability of that is greater. None where every probability is
        0 or 1.
    loss : float
        That probability, for all but glass.
    glass_loss : float
        That for glass, `loss` or more.
    """

    noise_m: np.ndarray | None
    chance: np.ndarray | None
    loss: float
    glass_loss: float

    @property
    def asks_for_glass(self) -> bool:
        """Whether it matters which returns are from glass."""
        return self.glass_loss > self.loss

    def measured(self, beam: np.ndarray, distance: np.ndarray, of_glass: np.ndarray | None = None) -> np.ndarray:
        """Ranges as the sensor measures them, (k,) [m]; inf where the return is lost.

        To be judged by the range gate afterwards: noise carries returns across it both ways.

        Parameters
        ----------
        beam : ndarray of int, (k,)
            Flat indices of the beams, in range, which is not checked.
        distance : ndarray, (k,)
            Distance to what each met first [m]; inf where it met nothing.
        of_glass : ndarray of bool, (k,), optional
            Whether that is glass; needed where `asks_for_glass`.
        """
        if self.noise_m is not None:
            distance = distance + np.take(self.noise_m, beam, mode="clip")
        if self.chance is None:
            lost = of_glass if self.asks_for_glass else None
        else:
            chance = np.take(self.chance, beam, mode="clip")
            lost = chance < self.loss
            if self.asks_for_glass:
                lost |= of_glass & (chance < self.glass_loss)
        return distance if lost is None else np.where(lost, math.inf, distance)


def _by_slot(lattice: BeamLattice, drawn: np.ndarray) -> np.ndarray:
    """Draws by (ring, firing column), flat in the lattice's order by (ring, slot)."""
    ring = np.arange(lattice.rings)[:, None]
    return drawn[ring, lattice.column(ring, np.arange(lattice.columns))].ravel()
