"""What becomes of each ablation: its effect on score, ranking and optimum, beside the noise floor."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..study.landscape import Landscape
from ..study.statistics import block_sums, ratio_interval_90
from .ablations import Ablation
from .accuracy import Reference
from .calibration import calibrated_residuals, root_mean_square
from .candidates import FIRST, Candidates
from .choices import Regret, chosen_shares, regret
from .noise import Noise
from .ranking import weighted_tau

SCORE, RANKING, OPTIMUM = "score", "ranking", "optimum"


def kept_candidates(without: Landscape, having: Landscape, reference: Reference) -> np.ndarray:
    """Candidates that either would ever choose: all that need be judged, (j,) int."""
    shares = [chosen_shares(one, reference.weights) for one in (without, having)]
    return np.flatnonzero(np.sum(shares, axis=0) > 0.0)


def ablation_row(
    change: Ablation,
    without: Landscape | str | None,
    having: Landscape | str | None,
    judged: Landscape | None,
    every: Candidates,
    reference: Reference,
    noise: Noise | None,
) -> dict:
    """One ablation as JSON holds it: all but its name is None where there is nothing to compare.

    Parameters
    ----------
    change : Ablation
    without, having : Landscape, str or None
        Of both; a text tells why one cannot be had.
    judged : Landscape or None
        The scene that has it, for the baseline and the kept candidates, on the frames that judge.
    every : Candidates
    reference : Reference
        Whose resamples are used.
    noise : Noise or None
        The floor.
    """
    refused = [one for one in (without, having) if isinstance(one, str)]
    row = {"what": change.what, "value": change.value, "note": refused[0] if refused else change.note}
    if refused or without is None or having is None:
        return row | dict.fromkeys((*_NUMBERS, "above_noise"))
    kept = kept_candidates(without, having, reference)
    chosen = [chosen_shares(one, reference.weights) for one in (without, having)]
    values = [one.per_vehicle()[FIRST:] for one in (without, having)]
    lost = None
    if judged is not None:
        lost = regret(chosen[0][kept], chosen[1][kept], judged, reference.judged_block)
    points = every.points[: len(chosen[0])]
    error = root_mean_square(calibrated_residuals(*values))
    numbers = {
        "bias": float(np.mean(values[1] - values[0])),
        "bias_interval_90": _bias_interval(without, having, reference),
        "error": error,
        "error_share": error / reference.gain if reference.gain > 0.0 else None,
        "tau": _number(weighted_tau(*values)),
        "shift": dict(zip(every.variables, ((chosen[1] - chosen[0]) @ points).tolist(), strict=True)),
        "regret": None if lost is None else lost.share,
        "regret_interval_90": None if lost is None or lost.interval_90 is None else list(lost.interval_90),
    }
    return row | numbers | {"above_noise": _above(numbers, lost, noise)}


_NUMBERS = ("bias", "bias_interval_90", "error", "error_share", "tau", "shift", "regret", "regret_interval_90")


def _above(numbers: Mapping, lost: Regret | None, noise: Noise | None) -> list[str] | None:
    """In what an effect exceeds what one half of the traffic differs from the other; None without such a floor."""
    if noise is None:
        return None
    tau = numbers["tau"]
    exceeded = {
        SCORE: abs(numbers["bias"]) > noise.bias,
        RANKING: numbers["error"] > noise.error or (tau is not None and tau < noise.tau),
        OPTIMUM: lost is not None and noise.regret is not None and _surely_lost(lost) and lost.share > noise.regret,
    }
    return [name for name, above in exceeded.items() if above]


def _surely_lost(lost: Regret) -> bool:
    """Whether it may not as well be nothing."""
    return lost.interval_90 is None or lost.interval_90[0] > 0.0


def _bias_interval(without: Landscape, having: Landscape, reference: Reference) -> list[float] | None:
    """Of the mean difference over the candidates, blocks resampled: the same traffic with and without."""
    difference = (having.objective - without.objective)[FIRST:].mean(axis=0)
    sums = block_sums(difference, reference.searched_block)
    interval = ratio_interval_90(sums, block_sums(without.vehicles, reference.searched_block), reference.seed)
    return None if interval is None else list(interval)


def _number(value: float) -> float | None:
    return None if np.isnan(value) else value
