"""How near a fidelity comes to the reference: bias, error after calibration, ranking and what its choices lose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..study.landscape import Landscape
from .calibration import calibrated_residuals, root_mean_square
from .candidates import BASELINE, FIRST
from .choices import Regret, chosen_shares, mean_shares, regret, searched_weights
from .ranking import weighted_tau

_ROUNDING = 1e-12  # of the largest score: an error that is no greater is none


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """What fidelities are compared with.

    Attributes
    ----------
    searched : Landscape
        Of the baseline and the candidates, on the frames that choose.
    judged : Landscape
        The same on those that judge.
    searched_block, judged_block : ndarray of int, (f,)
        Blocks of both.
    weights : ndarray, (r, f)
        From `choices.searched_weights`.
    chosen : ndarray, (k,)
        How often each candidate is chosen.
    seed : int
    """

    searched: Landscape
    judged: Landscape
    searched_block: np.ndarray
    judged_block: np.ndarray
    weights: np.ndarray
    chosen: np.ndarray
    seed: int

    @classmethod
    def of(
        cls, searched: Landscape, searched_block: np.ndarray, judged: Landscape, judged_block: np.ndarray, seed: int
    ) -> Reference:
        """With its own choices."""
        weights = searched_weights(searched_block, seed)
        return cls(searched, judged, searched_block, judged_block, weights, chosen_shares(searched, weights), seed)

    def select(self, numbers: Sequence[int]) -> Reference:
        """Of some of the candidates."""
        rows = [BASELINE, *(FIRST + number for number in numbers)]
        searched, judged = self.searched.select(rows), self.judged.select(rows)
        return Reference.of(searched, self.searched_block, judged, self.judged_block, self.seed)

    def best(self, count: int) -> list[int]:
        """So many of the best candidates, in the order in which they come."""
        return sorted(np.argsort(-self.searched.per_vehicle()[FIRST:], kind="stable")[:count].tolist())

    @property
    def gain(self) -> float:
        """What the best candidate gains over the baseline on the frames that choose, per vehicle."""
        values = self.searched.per_vehicle()
        return float(values[FIRST:].max() - values[BASELINE])


@dataclass(frozen=True, slots=True)
class Accuracy:
    """How near a fidelity comes to the reference, its phases averaged.

    Attributes
    ----------
    bias : float
        What it scores more, in the metric's unit per vehicle; mean over the candidates.
    error : float
        Root mean square of what is left after calibration, in the metric's unit per vehicle.
    tau : float
        `ranking.weighted_tau`.
    regret : Regret or None
    chosen : tuple of float, (k,)
        How often each candidate is chosen.
    """

    bias: float
    error: float
    tau: float
    regret: Regret | None
    chosen: tuple[float, ...]


def accuracy(reference: Reference, phases: Sequence[Landscape], frames: np.ndarray | None = None) -> Accuracy:
    """Of a fidelity whose phases come to `phases` on all frames and which looks at the rows `frames` of them."""
    frames = np.arange(len(reference.searched.vehicles)) if frames is None else frames
    truth = reference.searched.per_vehicle()[FIRST:]
    values = [
        phase.objective[FIRST:, frames].sum(axis=1) / max(int(phase.vehicles[frames].sum()), 1) for phase in phases
    ]
    chosen = mean_shares([chosen_shares(phase, reference.weights, frames) for phase in phases])
    error = root_mean_square(np.array([calibrated_residuals(each, truth) for each in values]))
    return Accuracy(
        bias=float(np.mean([each - truth for each in values])),
        error=0.0 if error <= _ROUNDING * float(np.abs(truth).max()) else error,
        tau=float(np.mean([weighted_tau(each, truth) for each in values])),
        regret=regret(chosen, reference.chosen, reference.judged, reference.judged_block),
        chosen=tuple(chosen.tolist()),
    )
