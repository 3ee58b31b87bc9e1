"""The noise ceiling: how far the reference is from itself on other blocks of the same traffic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..study.statistics import block_sums
from .accuracy import Reference
from .calibration import calibrated_residuals, root_mean_square
from .candidates import BASELINE, FIRST
from .ranking import weighted_tau

SPLITS = 200
_FEWEST_BLOCKS = 4  # two in each half


@dataclass(frozen=True, slots=True)
class Noise:
    """One half of the searched blocks against the other, over many random halvings.

    A difference of halves has twice the standard error of the whole: about what a 95 % interval of the reference
    reaches to either side.

    Attributes
    ----------
    bias, error, tau : float
        As of a fidelity, the one half in its place and the other in the reference's: medians, of the bias without sign.
    error_90 : (float, float)
        Where 90 % of the errors lie.
    regret : float or None
        Mean difference of what the choices of both halves gain on the frames that judge, as a share of the gain.
    """

    bias: float
    error: float
    error_90: tuple[float, float]
    tau: float
    regret: float | None


def noise_ceiling(reference: Reference) -> Noise | None:
    """None for fewer than four blocks with vehicles."""
    searched = reference.searched
    objective = block_sums(searched.objective, reference.searched_block)
    vehicles = block_sums(searched.vehicles, reference.searched_block)
    objective, vehicles = objective[:, vehicles > 0], vehicles[vehicles > 0]
    if len(vehicles) < _FEWEST_BLOCKS:
        return None
    judged = reference.judged.per_vehicle()
    gain = float(reference.chosen @ judged[FIRST:] - judged[BASELINE])
    rng = np.random.default_rng(reference.seed)
    rows = []
    for _ in range(SPLITS):
        order = rng.permutation(len(vehicles))
        halves = order[: len(order) // 2], order[len(order) // 2 :]
        one, other = (objective[FIRST:, half].sum(axis=1) / vehicles[half].sum() for half in halves)
        apart = abs(float(judged[FIRST + int(np.argmax(one))] - judged[FIRST + int(np.argmax(other))]))
        error = root_mean_square(calibrated_residuals(one, other))
        rows.append((abs(float(np.mean(one - other))), error, weighted_tau(one, other), apart))
    bias, error, tau, apart = np.array(rows).T
    tau = np.nan_to_num(tau)  # where a half prefers no mounting, nothing is ranked alike
    low, high = np.quantile(error, [0.05, 0.95]).tolist()
    middle = [float(np.median(column)) for column in (bias, error, tau)]
    return Noise(middle[0], middle[1], (low, high), middle[2], float(apart.mean() / gain) if gain > 0.0 else None)
