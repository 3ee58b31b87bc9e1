"""Findings on the search: do other seeds find the same, and as good?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .findings import UNDECIDED, Finding, by_loss, percent
from .seeds import regrets
from .variations import SEARCH

_TEXTS = {  # name, unit, digits; those that all answers share are told of the first two alone
    "height_m": ("height", "m", 2),
    "tilt_x_deg": ("tilt", "deg", 1),
    "x_m": ("x", "m", 2),
    "y_m": ("y", "m", 2),
    "tilt_y_deg": ("tilt along the road", "deg", 1),
    "yaw_deg": ("yaw", "deg", 1),
}
_ALWAYS_TOLD = ("height_m", "tilt_x_deg")


def search_findings(answers: Sequence[dict], best: float, baseline: float, judged: Mapping) -> list[Finding]:
    """What the answers of several seeds leave to the best known mounting, and how far apart they lie.

    Parameters
    ----------
    answers : sequence of dict
        From `seeds.answer_of_seed`.
    best, baseline : float
        Objective per vehicle of the best grid point and of the baseline, on the frames of the search.
    judged : mapping
        Objective per vehicle of the ``"baseline"`` and of the ``"answers"``, on the frames that judge.
    """
    value = f"{len(answers)} seeds of {answers[0]['evaluations']:,} evaluations"
    left = regrets(list(answers), best, baseline)
    if left is None:
        return [Finding(SEARCH, "regret", value, UNDECIDED, "no mounting is better than the baseline")]
    text = f"median {percent(float(np.median(left)))}, worst {percent(float(left.max()))} of the gain"
    regret = Finding(SEARCH, "regret", value, by_loss(float(left.max())), text, {"regrets": left.tolist()})
    return [regret, _spread(answers, value, judged)]


def _spread(answers: Sequence[dict], value: str, judged: Mapping) -> Finding:
    """How far apart answers lie, judged by what the least of them loses to the best on other traffic."""
    places, texts = {}, []
    for key, (name, unit, digits) in _TEXTS.items():
        found = [answer["mounting"][key] for answer in answers]
        if key not in _ALWAYS_TOLD and len(set(found)) == 1:
            continue
        places[key] = found
        low, high = (f"{end:.{digits}f}" for end in (min(found), max(found)))
        texts.append(f"{name} {low} to {high} {unit}")
    gains = np.array(judged["answers"]) - judged["baseline"]
    loss = float(1.0 - gains.min() / gains.max()) if gains.max() > 0.0 else None
    if loss is not None:
        texts.append(f"on the frames that judge the least of them gains {percent(loss)} less than the best")
    return Finding(SEARCH, "spread of the answers", value, by_loss(loss), ", ".join(texts), {"loss": loss, **places})
