"""How certain the optimum's tilt is, by the number of vehicles that were looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..study.statistics import FEWEST_BLOCKS, interval_90
from .landscape import values_under
from .mountings import CANDIDATES

ASKED_DEG = 1.0  # steps of the tilts that it is told from must not be wider
_RESAMPLES = 1000
_SLOWEST, _FASTEST = 1.0 / 3.0, 0.5  # powers of the sample that an optimum's error can fall with: of jumps, of a hill
_SIZES = 8


@dataclass(frozen=True, slots=True)
class SampleSize:
    """How far the best tilt strays in samples of several sizes.

    Attributes
    ----------
    vehicles : tuple of float
        Vehicle observations of each size; the last is what is at hand.
    reach_deg : tuple of float
        Half of the 90 % interval of the best tilt [deg]; half a step of the grid where that is more.
    power : float
        The interval falls with this power of the observations: fitted, between 1/3 (Kim and Pollard 1990, where the
        objective jumps) and 1/2 (where it is a smooth hill).
    needed : float
        Observations that make the best tilt certain to `ASKED_DEG`; beyond those at hand by that power.
    """

    vehicles: tuple[float, ...]
    reach_deg: tuple[float, ...]
    power: float
    needed: float


def sample_size(objective: np.ndarray, vehicles: np.ndarray, tilt_deg: np.ndarray, seed: int) -> SampleSize | None:
    """See where the optimum goes in samples of fewer blocks of time.

    Blocks are drawn without replacement, up to half of them: of an argmax, unlike a mean, the bootstrap tells too
    little (Abrevaya and Huang 2005), as resamples share the accidents of the sample. A sample of m of b blocks strays
    from the whole as an independent one of m / (1 - m / b) blocks strays from the truth, and counts as that many:
    exactly so for a mean, about so for an argmax.

    Parameters
    ----------
    objective : ndarray, (m, b)
        Of each mounting in each block, as a `Landscape` has them.
    vehicles : ndarray, (b,)
        Of each block; those without any are left out.
    tilt_deg : ndarray, (k,)
        Tilt of each candidate [deg].
    seed : int

    Returns
    -------
    SampleSize or None
        None for too few blocks.
    """
    filled = vehicles > 0
    objective, vehicles, blocks = objective[:, filled], vehicles[filled], int(filled.sum())
    if blocks < 2 * FEWEST_BLOCKS:
        return None
    rng = np.random.default_rng(seed)
    sizes = np.unique(np.geomspace(FEWEST_BLOCKS, blocks // 2, _SIZES).round().astype(int))
    counts = [float(size / (1.0 - size / blocks) * vehicles.mean()) for size in sizes]
    finest = 0.5 * float(np.diff(np.unique(tilt_deg)).max(initial=0.0))
    reach = [max(finest, _reach_deg(objective, vehicles, tilt_deg, rng, size)) for size in sizes]
    power = _power(counts, reach, finest)
    return SampleSize(tuple(counts), tuple(reach), power, _needed(counts, reach, power))


def samples_without_replacement(blocks: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """Which of `blocks` are in each of many samples of `size`, 1 or 0, (r, blocks)."""
    order = rng.permuted(np.tile(np.arange(blocks), (_RESAMPLES, 1)), axis=1)
    weights = np.zeros((_RESAMPLES, blocks))
    np.put_along_axis(weights, order[:, :size], 1.0, axis=1)
    return weights


def _reach_deg(objective, vehicles, tilt_deg, rng, size) -> float:
    weights = samples_without_replacement(len(vehicles), size, rng)
    best = np.argmax(values_under(weights, objective, vehicles)[CANDIDATES:], axis=0)
    low, high = interval_90(tilt_deg[best])
    return 0.5 * (high - low)


def _needed(counts, reach, power) -> float:
    """Where the interval falls to what is asked and stays there, or will by its power."""
    if reach[-1] > ASKED_DEG:
        return float(counts[-1] * (reach[-1] / ASKED_DEG) ** (1.0 / power))
    too_wide = np.flatnonzero(np.array(reach) > ASKED_DEG)
    return counts[too_wide[-1] + 1] if len(too_wide) else counts[0]


def _power(counts, reach, finest) -> float:
    """The slope through the sizes at which the optimum strays by more than the grid tells, kept to what theory allows.

    `finest` is the reach that the grid tells [deg].
    """
    strays = np.array(reach) > finest
    if strays.sum() < 2:
        return _FASTEST
    slope = np.polyfit(np.log(np.array(counts)[strays]), np.log(np.array(reach)[strays]), 1)[0]
    return float(np.clip(-slope, _SLOWEST, _FASTEST))
