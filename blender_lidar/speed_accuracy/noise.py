"""The noise ceiling: how far the reference is from itself on other blocks of the same traffic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..study.statistics import block_sums
from .accuracy import Reference
from .calibration import calibrated_residuals, root_mean_square
from .candidates import BASELINE, FIRST
from .halves import FEWEST_BLOCKS, chosen_by, halvings
from .ranking import weighted_tau


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
    apart : float or None
        Mean difference, without sign, between what the choices of both halves come to on the frames that judge, as a
        share of what a half's choice gains there; None where that is nothing.
    """

    bias: float
    error: float
    error_90: tuple[float, float]
    tau: float
    apart: float | None


def noise_ceiling(reference: Reference) -> Noise | None:
    """None for fewer than four blocks with vehicles."""
    searched = reference.searched
    objective = block_sums(searched.objective, reference.searched_block)
    vehicles = block_sums(searched.vehicles, reference.searched_block)
    objective, vehicles = objective[FIRST:, vehicles > 0], vehicles[vehicles > 0]
    if len(vehicles) < FEWEST_BLOCKS:
        return None
    halves = halvings(len(vehicles), reference.seed)
    rows = []
    for pair in halves:
        one, other = (objective[:, half].sum(axis=1) / vehicles[half].sum() for half in pair)
        error = root_mean_square(calibrated_residuals(one, other))
        rows.append((abs(float(np.mean(one - other))), error, weighted_tau(one, other)))
    bias, error, tau = np.array(rows).T
    tau = np.nan_to_num(tau)  # where a half prefers no mounting, nothing is ranked alike
    low, high = np.quantile(error, [0.05, 0.95]).tolist()
    middle = [float(np.median(column)) for column in (bias, error, tau)]
    apart = choices_apart(chosen_by(halves, objective), reference.judged.objective.sum(axis=1))
    return Noise(middle[0], middle[1], (low, high), middle[2], apart)


def choices_apart(chosen: np.ndarray, worth: np.ndarray) -> float | None:
    """How far the choices of two halves (s, 2) are apart in what they are worth, as a share of their mean gain.

    `worth` (1 + k,) is that of the baseline and the candidates.
    """
    of_chosen = worth[FIRST + chosen]
    gain = float(of_chosen.mean() - worth[BASELINE])
    return float(np.abs(of_chosen[:, 0] - of_chosen[:, 1]).mean() / gain) if gain > 0.0 else None
