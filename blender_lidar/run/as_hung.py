"""What a mounting is worth as hung: the expectation over installation errors, and what nine of ten installations reach.

A search sees the expectation as a sample average approximation (Kleywegt, Shapiro and Homem-de-Mello 2002): every frame
under an installation error of its own, the same for all mountings. The best few are compared under more, and what
a run tells of its answer stands on errors that chose nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..scene.installation import installed_layout, latin_errors, orthogonal_errors, single_errors
from ..scene.mounting import Layout
from ..scene.scenario import Scenario
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from .comparison import Comparison

SEARCHED_ERRORS = 24  # installation errors of a search, at least, however few frames it has
FINAL_EACH = 8  # of each frame, under which the best few are compared and the best is polished
LOW_BASE = 7  # its square is how many errors, of all frames each, a quantile is searched over
JUDGED_BASE = 5  # its square is how many errors the figures stand on, of all frames each
FEW_ERRORS = 12  # of what is told besides, at least, however few frames it has
LOW_SHARE = 0.1  # the share of installations that may fall below what "low" aims at
DEGREE, HEIGHT_M = 1.0, 0.1  # errors that are told each alone
_SEARCH, _FINAL, _BESIDES = 1, 2, 3  # streams of random numbers

# --- The objective as hung, on the searched frames --------------------------------------------------------------------


def searching(site: Site, evaluator: Evaluator) -> Evaluator:
    """What a search scores mountings with: each frame under its own error, the fewer frames the more errors each.

    Their mean, whatever the scene's `aim`, which the last stage alone has: see `HungObjective`.
    """
    return evaluator.under(_of_frames(site.scenario, len(site.search), SEARCHED_ERRORS, _SEARCH))


class HungObjective:
    """The objective as hung on the searched frames: the mean over errors, or what nine of ten installations reach.

    Every frame has `FINAL_EACH` errors of its own, other ones than the search has. On scenes/i80.toml and an
    intersection (RESCO's cologne1, 16 good mountings each) differences between mountings err by 0.0021 and 0.0035 bits
    per vehicle (root mean square); 25 errors, each of all frames, by 0.0011 and 0.0042 at three times the cost. A
    quantile needs each error on all frames: it is that of `LOW_BASE` squared.
    """

    def __init__(self, site: Site, evaluator: Evaluator) -> None:
        self._scenario, self._evaluator = site.scenario, evaluator
        frames = len(site.search)
        self._mean = evaluator.under(_of_frames(site.scenario, frames, FINAL_EACH * frames, _FINAL))

    def __call__(self, layouts: Sequence[Layout]) -> np.ndarray:
        """Of each layout, (s,), in the metric's unit."""
        if self._scenario.aim == "mean":
            return self._mean.totals(layouts).objective.sum(axis=1)
        errors = orthogonal_errors(self._scenario.installers, LOW_BASE)
        hung = [installed_layout(plan, error) for plan in layouts for error in errors]
        objective = self._evaluator.totals(hung).objective.sum(axis=1).reshape(len(layouts), len(errors))
        return np.quantile(objective, LOW_SHARE, axis=1, method="hazen")  # each of m stands for 1 / m of the errors


def errors_of_frames(scenario: Scenario, frames: int) -> np.ndarray | None:
    """Installation errors of each frame on which something is told besides, (frames, e, l, 4); None without any."""
    return _of_frames(scenario, frames, FEW_ERRORS, _BESIDES)


def _of_frames(scenario: Scenario, frames: int, least: int, stream: int) -> np.ndarray | None:
    """Installation errors of each frame, (frames, e, l, 4), at least so many in all; None where nothing is shaken."""
    if scenario.is_exact:
        return None
    each = math.ceil(least / max(frames, 1))
    return latin_errors(scenario.installers, frames, each, [scenario.search.seed, stream])


# --- Figures, on the frames that judge --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class HungScores:
    """Scores of the n boxes of some frames under m installation errors, which stand for the same share of all each.

    Attributes
    ----------
    objective : ndarray, (m, n)
        In the metric's unit, weighted.
    detectable : ndarray of bool, (m, n)
    degree_off, height_off : ndarray of bool, (k, n)
        Detectable where one tilt alone is off by `DEGREE`, or one height alone by `HEIGHT_M`, to either side.
    """

    objective: np.ndarray
    detectable: np.ndarray
    degree_off: np.ndarray
    height_off: np.ndarray

    @property
    def mean(self) -> dict[str, np.ndarray]:
        """Means over the errors, (n,) each."""
        return {"objective": self.objective.mean(axis=0), "detectable": self.detectable.mean(axis=0)}

    @staticmethod
    def chosen(several: Sequence[HungScores], of_box: np.ndarray) -> HungScores:
        """Of each box the scores of that one of several which `of_box` (n,) names."""
        box = np.arange(len(of_box))
        stacked = (np.stack([getattr(one, field.name) for one in several]) for field in fields(HungScores))
        return HungScores(*(np.moveaxis(values, 1, 0)[:, of_box, box] for values in stacked))

    @staticmethod
    def joined(parts: Sequence[HungScores]) -> HungScores:
        """Of the boxes of several, one after the other."""
        return HungScores(
            *(np.concatenate([getattr(one, field.name) for one in parts], axis=1) for field in fields(HungScores))
        )


def _installations(scenario: Scenario, plan: Layout) -> list[Layout]:
    """Equally likely installations of a plan, `JUDGED_BASE` squared of them: it alone where nothing shakes it."""
    if scenario.is_exact:
        return [plan]
    return [installed_layout(plan, error) for error in orthogonal_errors(scenario.installers, JUDGED_BASE)]


def hung_scores(
    scenario: Scenario, evaluator: Evaluator, plans: Sequence[Layout], *, shaken: bool = True, singles: bool = True
) -> list[HungScores]:
    """Scores of each plan as hung, boxes in the order of `vehicle_tables`; all in one call.

    Not `shaken`, as a baseline that hangs already, a plan has the scores of itself under every error. Without `singles`
    errors of one coordinate alone are left out.
    """
    degrees, heights = single_errors(scenario.installers, DEGREE, HEIGHT_M) if singles else ([], [])
    layouts, count = [], 1
    for plan in plans:
        hung = _installations(scenario, plan) if shaken else [plan]
        count = len(hung)
        layouts += [*hung, *(installed_layout(plan, error) for error in (*degrees, *heights))]
    rows = evaluator.by_box(layouts)
    objective, detectable = (np.reshape(one, (len(plans), len(layouts) // len(plans), -1)) for one in rows)
    ends = count, count + len(degrees)
    return [
        HungScores(values[:count], found[:count], found[slice(*ends)], found[ends[1] :])
        for values, found in zip(objective, detectable, strict=True)
    ]


def judge_as_hung(boxes: Comparison, before: HungScores, after: HungScores) -> tuple[dict, dict]:
    """Figures of the baseline and of a mounting as hung, under the same errors, as JSON holds them.

    Parameters
    ----------
    boxes : Comparison
        The boxes that judge, as planned.
    before, after : HungScores

    Returns
    -------
    dict, dict
        Of both ``detectable_share``, the mean over errors, with its ``interval_90`` over blocks of time;
        ``nine_of_ten``, the 10 % quantile of the share over a resampled set of blocks and one error;
        ``objective_per_vehicle``. Of the mounting besides ``gain`` in detectable share over the baseline and
        ``objective_gain``, with intervals; ``worst_degree`` and ``worst_10_cm``, the least share where one tilt is off
        by a degree, one height by 10 cm, and nothing else. Intervals are None as in `Comparison`, and so is
        ``nine_of_ten``.
    """
    hung = boxes.with_scores(before.mean, after.mean)
    shares, objective = hung.shares(), hung.objective()
    base, found = (
        {
            "detectable_share": shares[name],
            "interval_90": shares[f"{name}_interval_90"],
            "nine_of_ten": boxes.low_share(one.detectable, LOW_SHARE),
            "objective_per_vehicle": objective[name],
        }
        for name, one in (("before", before), ("after", after))
    )
    planned = float(boxes.after["detectable"].mean())
    return base, {
        **found,
        "gain": shares["gain"],
        "gain_interval_90": shares["gain_interval_90"],
        "objective_gain": objective["gain"],
        "objective_gain_interval_90": objective["gain_interval_90"],
        "worst_degree": float(after.degree_off.mean(axis=1).min(initial=planned)),
        "worst_10_cm": float(after.height_off.mean(axis=1).min(initial=planned)),
    }


TWO_WHEELERS = ("motorcycle", "bicycle")


def two_wheelers_as_hung(boxes: Comparison, before: HungScores, after: HungScores) -> dict | None:
    """`Comparison.shares` of motorcycles and bicycles alone, as hung; None where there are none."""
    chosen = np.isin(boxes.before["class"], TWO_WHEELERS)
    return boxes.with_scores(before.mean, after.mean).of(chosen).shares() if chosen.any() else None


AS_PLANNED = {
    "interval_90": "detectable_share_interval_90",
    "gain": "detectable_share_gain",
    "gain_interval_90": "detectable_share_gain_interval_90",
    "objective_gain": "gain_over_baseline",
    "objective_gain_interval_90": "interval_90",
}
"""The names that figures as planned have in result.json, by those of figures as hung."""


def as_planned(figures: Mapping[str, object]) -> dict[str, object]:
    """Figures as hung by the names that those as planned have in result.json."""
    return {AS_PLANNED.get(key, key): value for key, value in figures.items()}
