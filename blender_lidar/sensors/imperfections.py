"""Measurement effects of a LiDAR: range noise, drop-out, glass and weak returns, the same for the same seed.

Every beam of a revolution draws its own numbers, which belong to the seed, the frame, the ring and the firing column
alone. So they are the same for every mounting (common random numbers: two mountings differ by what they see, not by
luck), the caster, the culling, the number of workers and the order in which anything is asked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError
from ..names import MOST_RANGE_NOISE_M

if TYPE_CHECKING:
    from .beams import BeamLattice

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
        returns more weakly is lost, as `detection_range_m` says. None: nothing is too weak.
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

    @property
    def most_noise_m(self) -> float:
        """The farthest that noise moves a return [m]: beams are cast so far beyond the range gate."""
        return _MOST_DEVIATIONS * self.range_noise_m

    def measurement(
        self,
        lattice: BeamLattice,
        frame: int,
        min_range_m: float = 0.0,
        max_range_m: float = math.inf,
        of_lidar: Sequence[int] = (),
    ) -> MeasurementModel:
        """What the beams of one frame draw, and so measure of what they meet; the range gate is [m].

        `of_lidar` is added to the key of the draws: it tells LiDARs with one seed from one another.
        """
        noise = chance = np.empty(0, dtype=np.float32)
        if self.range_noise_m:
            rng = self._generator(frame, _NOISE, of_lidar)
            deviations = rng.standard_normal((lattice.rings, lattice.columns), np.float32)
            np.clip(deviations, -_MOST_DEVIATIONS, _MOST_DEVIATIONS, out=deviations)
            noise = _by_slot(lattice, deviations * np.float32(self.range_noise_m))
        if self.dropout > 0.0 or 0.0 < self.glass_dropout < 1.0:
            drawn = self._generator(frame, _CHANCE, of_lidar).random((lattice.rings, lattice.columns), np.float32)
            chance = _by_slot(lattice, drawn)
        return MeasurementModel(
            float(min_range_m),
            float(max_range_m),
            noise,
            chance,
            np.float32(self.dropout),
            np.float32(self.dropout + (1.0 - self.dropout) * self.glass_dropout),
            math.inf if self.range_at_10_percent_m is None else float(self.range_at_10_percent_m),
        )

    def _generator(self, frame: int, stream: int, of_lidar: Sequence[int]) -> np.random.Generator:
        key = (int(frame) % _FRAME_NUMBERS, stream, *of_lidar)
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(int(self.seed), spawn_key=key)))


PERFECT = Imperfections()
_LEAST_LOSS = np.float32(1e-30)  # a probability, by which a chance below 0 is lost and no other one


class MeasurementModel(NamedTuple):
    """Measurement model of one frame: the range noise, lost returns and range gate that turn hits into returns.

    `measured` is the one place where a return becomes noisy or lost; compiled code (`compiled_frames`) does the same.
    Draws are by flat index into the lattice, ``ring * columns + slot``. Chances are kept, not what comes of them, which
    depends on what a beam meets.

    Attributes
    ----------
    min_range_m, max_range_m : float
        The range gate [m]. It judges what is measured: noise carries returns across it both ways.
    noise_m : ndarray of float32, (beams,) or (0,)
        Error of the range of each beam's return [m]; empty without noise.
    chance : ndarray of float32, (beams,) or (0,)
        Uniform in [0, 1): the return is lost where the probability of that is greater. Empty, and as if 0, where every
        probability is 0 or 1.
    loss, glass_loss : float32
        That probability, for all but glass and for glass.
    range_at_10_percent_m : float
        As in `Imperfections`; inf where nothing is too weak.
    """

    min_range_m: float
    max_range_m: float
    noise_m: np.ndarray
    chance: np.ndarray
    loss: np.float32
    glass_loss: np.float32
    range_at_10_percent_m: float

    @property
    def asks_for_surface(self) -> bool:
        """Whether it matters what returns come from: `glass`, `reflectivity` and `cosine` are needed then."""
        return self.glass_loss > self.loss or self.range_at_10_percent_m < math.inf

    def without(self, lost: np.ndarray) -> MeasurementModel:
        """The same where some beams (n,) bool return nothing, as outside a sensor's horizontal field of view."""
        chance = self.chance if len(self.chance) else np.ones(len(lost), dtype=np.float32)
        loss, glass_loss = np.maximum([self.loss, self.glass_loss], _LEAST_LOSS)
        return self._replace(chance=np.where(lost, np.float32(-1.0), chance), loss=loss, glass_loss=glass_loss)

    def measured(
        self,
        beam: np.ndarray,
        distance: np.ndarray,
        glass: np.ndarray | None = None,
        reflectivity: np.ndarray | None = None,
        cosine: np.ndarray | None = None,
    ) -> np.ndarray:
        """Ranges as the sensor measures them, (k,) [m]; inf where nothing returns.

        Parameters
        ----------
        beam : ndarray of int, (k,)
            Flat indices of the beams, in range, which is not checked.
        distance : ndarray, (k,)
            Distance to what each met first [m]; inf where it met nothing.
        glass : ndarray of bool, (k,), optional
            Whether that is glass.
        reflectivity, cosine : ndarray, (k,), optional
            Its diffuse reflectivity, 0 to 1, and the cosine of the beam's incidence on it.
        """
        found = distance
        if len(self.noise_m):
            found = found + np.take(self.noise_m, beam, mode="clip")
        kept = (found >= self.min_range_m) & (found <= self.max_range_m)
        chance = np.take(self.chance, beam, mode="clip") if len(self.chance) else np.float32(0.0)
        if self.loss > 0.0:
            kept &= chance >= self.loss
        if self.glass_loss > self.loss:
            kept &= ~glass | (chance >= self.glass_loss)
        if self.range_at_10_percent_m < math.inf:
            kept &= distance <= detection_range_m(self.range_at_10_percent_m, reflectivity, cosine)
        return np.where(kept, found, math.inf)


def _by_slot(lattice: BeamLattice, drawn: np.ndarray) -> np.ndarray:
    """Draws by (ring, firing column), flat in the lattice's order by (ring, slot)."""
    ring = np.arange(lattice.rings)[:, None]
    return drawn[ring, lattice.column(ring, np.arange(lattice.columns))].ravel()


# --- Weak returns: Lambert's law and the inverse square of the range, against the weakest return that counts ----------

STATED_REFLECTIVITY = 0.1


def detection_range_m(
    range_at_10_percent_m: float, reflectivity: np.ndarray | float, cosine: np.ndarray | float
) -> np.ndarray | float:
    """Detection range: farthest range at which surfaces are seen [m], that range included; the latter two broadcast.

    The light that comes back from a surface wider than the beam is as reflectivity x cos(incidence) / range^2, so a
    sensor that needs a certain strength sees a surface as far as the square root of reflectivity x cos(incidence)
    reaches. Makers state that strength as the range at which a target of 10 % reflectivity that faces the sensor is
    still seen.

    Parameters
    ----------
    range_at_10_percent_m : float
        Farthest range at which the sensor sees a target of 10 % reflectivity that faces it [m].
    reflectivity : array_like
        Diffuse reflectivity of each surface, 0 to 1.
    cosine : array_like
        Cosine of each beam's incidence, 0 (grazing) to 1 (head-on).
    """
    return range_at_10_percent_m * np.sqrt(reflectivity * cosine / STATED_REFLECTIVITY)
