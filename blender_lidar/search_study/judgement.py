"""From the stored runs to shares, quantiles, tests and the verdict on what the search was to achieve."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..reality.significance import holm
from . import bbob
from .counted import checkpoints
from .rules import (
    BBOB_ALSO,
    BBOB_SUCCESS,
    BBOB_TARGETS,
    MARGIN,
    SCENE_ALSO,
    SCENE_SUCCESS,
    SCENE_TARGETS,
)
from .scene_problems import CASES
from .solvers import DE_PSO_FORMS, OURS, SOLVERS
from .statistics import Share, mcnemar, paired_difference, wilcoxon, wilson
from .tasks import Task

Stored = Sequence[tuple[Task, list[dict]]]
_EQUAL_BELOW = 1e-8  # regrets that small are rounding
SHOWN, ESTIMATED, MISSED = "yes", "estimate only", "no"
RIVALS = tuple(name for name in SOLVERS if name != OURS)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The runs of one part of the study, row by row the same problem for every solver.

    Attributes
    ----------
    label : str
    success : float
        The regret that counts as success; `also` are reported besides.
    also, targets : tuple of float
        Of the latter the runtime ECDF is made.
    evaluations : ndarray, (c,)
        When the regrets were taken.
    group : list of str, (n,)
        Which group of problems a row belongs to.
    regret : dict of str to ndarray, (n, c)
        By solver; zero or more.
    on_bound : dict of str to ndarray, (n,)
        Share of evaluations with a variable on a bound.
    """

    label: str
    success: float
    also: tuple[float, ...]
    targets: tuple[float, ...]
    evaluations: np.ndarray
    group: list[str]
    regret: dict[str, np.ndarray]
    on_bound: dict[str, np.ndarray]

    def solved(self, solver: str) -> np.ndarray:
        """Whether each run succeeded, (n,)."""
        return self.regret[solver][:, -1] <= self.success

    def reached(self, solver: str) -> np.ndarray:
        """Runtime ECDF: share of (problem, target) pairs reached after each of `evaluations`, (c,)."""
        return np.mean([(self.regret[solver] <= target).mean(axis=0) for target in self.targets], axis=0)


def parts_of(stored: Stored) -> list[Part]:
    """The parts of the judging that anything is stored of."""
    found = [_bbob_part(stored, dimension) for dimension in bbob.DIMENSIONS]
    found += [_scene_part(stored, case) for case in CASES]
    return [part for part in found if part is not None]


def _bbob_part(stored: Stored, dimension: int) -> Part | None:
    runs = [(task, run) for task, found in stored if task.name.startswith(f"bbob_{dimension}d_") for run in found]
    if not runs:
        return None
    rows = {name: [run for _, run in runs if run["solver"] == name] for name in SOLVERS}
    return Part(
        f"BBOB {dimension}-D",
        BBOB_SUCCESS,
        BBOB_ALSO,
        BBOB_TARGETS,
        np.array(checkpoints(runs[0][0].budget)),
        [bbob.group_of(int(run["problem"][1:])) for run in rows[OURS]],
        {name: np.maximum(0.0, [[r["optimum"] - v for v in r["best"]] for r in rows[name]]) for name in SOLVERS},
        {name: np.array([run["on_bound"] for run in rows[name]]) for name in SOLVERS},
    )


def _scene_part(stored: Stored, case: str) -> Part | None:
    chosen = [(task, found) for task, found in stored if task.part == case]
    if not chosen:
        return None
    rows = {name: [run for _, found in chosen for run in found if run["solver"] == name] for name in SOLVERS}
    best = np.max([[run["best"][-1] for run in runs] for runs in rows.values()], axis=0)  # that anyone has found
    gain = best - [run["baseline"] for run in rows[OURS]]
    if not (gain > 0.0).all():
        raise InputError(f"{chosen[int(np.argmin(gain))][0].name}: no solver found better than the scene's baseline")
    return Part(
        case,
        SCENE_SUCCESS,
        SCENE_ALSO,
        SCENE_TARGETS,
        np.array(checkpoints(chosen[0][0].budget)),
        [task.recording for task, _ in chosen],
        {
            name: (best[:, None] - np.array([run["best"] for run in runs])) / gain[:, None]
            for name, runs in rows.items()
        },
        {name: np.array([run["on_bound"] for run in runs]) for name, runs in rows.items()},
    )


def judgement(parts: Sequence[Part]) -> dict:
    """Shares, quantiles, comparisons and the verdict, as JSON holds them."""
    compared = [_compared(part, rival) for part in parts for rival in RIVALS]
    tests = [(row, key) for row in compared for key in ("mcnemar", "wilcoxon")]  # a verdict may rest on either
    for (row, key), p in zip(tests, holm([row[key] for row, key in tests]), strict=True):
        row[f"{key}_holm"] = p
    groups = [row for part in parts for rival in RIVALS for row in _by_group(part, rival)]
    for row, p in zip(groups, holm([row["wilcoxon"] for row in groups]), strict=True):
        row["wilcoxon_holm"] = p
    return {
        "parts": [_summary(part) for part in parts],
        "compared": compared,
        "groups": groups,
        "verdict": _verdict(parts, compared, groups),
    }


def _summary(part: Part) -> dict:
    solvers = {}
    for name in SOLVERS:
        final = part.regret[name][:, -1]
        solvers[name] = {
            "success": list(wilson(int(part.solved(name).sum()), final.size)),
            "also": {f"{target:g}": float((final <= target).mean()) for target in part.also},
            "regret": [float(q) for q in np.quantile(final, [0.5, 0.9], method="inverted_cdf")],
            "on_bound": float(part.on_bound[name].mean()),
            "reached": float(part.reached(name)[-1]),
        }
    by_group = {
        group: {name: float(part.solved(name)[np.array(part.group) == group].mean()) for name in SOLVERS}
        for group in dict.fromkeys(part.group)
    }
    return {"label": part.label, "runs": len(part.group), "solvers": solvers, "by_group": by_group}


def _compared(part: Part, rival: str) -> dict:
    ours, theirs = part.solved(OURS), part.solved(rival)
    return {
        "part": part.label,
        "rival": rival,
        "difference": list(paired_difference(ours, theirs)),
        "mcnemar": mcnemar(ours, theirs),
        **_ranks(part.regret[OURS][:, -1], part.regret[rival][:, -1]),
    }


def _by_group(part: Part, rival: str) -> list[dict]:
    groups = np.array(part.group)
    return [
        {
            "part": part.label,
            "group": group,
            "rival": rival,
            **_ranks(part.regret[OURS][groups == group, -1], part.regret[rival][groups == group, -1]),
        }
        for group in dict.fromkeys(part.group)
    ]


def _ranks(ours: np.ndarray, theirs: np.ndarray) -> dict:
    """Wilcoxon's test of the final regrets, and how often either is lower."""
    ours, theirs = np.maximum(ours, _EQUAL_BELOW), np.maximum(theirs, _EQUAL_BELOW)
    lower, higher = int((ours < theirs).sum()), int((ours > theirs).sum())
    return {"wilcoxon": wilcoxon(np.log10(ours), np.log10(theirs)), "lower": lower, "higher": higher}


def _verdict(parts: Sequence[Part], compared: list[dict], groups: list[dict]) -> list[dict]:
    """For every part: against both DE-PSO forms, the rival that did best, and whether any is ahead by too much."""
    found = []
    for part in parts:
        rows = {row["rival"]: row for row in compared if row["part"] == part.label}
        best = max(RIVALS, key=lambda rival, part=part: part.solved(rival).mean())
        leads = {rival: paired_difference(part.solved(rival), part.solved(OURS)) for rival in RIVALS}
        found.append(
            {
                "part": part.label,
                "de_pso": {form: _against(rows[form]) for form in DE_PSO_FORMS},
                "best_rival": best,
                "ahead": list(leads[best]),
                "within_margin": _within(leads.values()),
                "worse_groups": [
                    f"{row['group']} ({row['rival']})" for row in groups if row["part"] == part.label and _worse(row)
                ],
            }
        )
    return found


def _within(leads: Iterable[Share]) -> str:
    """Whether no rival is ahead by more than `MARGIN`: shown by the intervals, so by the estimates alone, or not so."""
    leads = list(leads)
    if all(lead.high <= MARGIN for lead in leads):
        return SHOWN
    return ESTIMATED if all(lead.value <= MARGIN for lead in leads) else MISSED


def _against(row: dict) -> str:
    """In one word how we do: by success if that differs significantly, else by regret."""
    if row["mcnemar_holm"] < 0.05:
        return "better" if row["difference"][0] > 0.0 else "worse"
    if not math.isnan(row["wilcoxon_holm"]) and row["wilcoxon_holm"] < 0.05:
        return "better" if row["lower"] > row["higher"] else "worse"
    return "no different"


def _worse(row: dict) -> bool:
    return not math.isnan(row["wilcoxon_holm"]) and row["wilcoxon_holm"] < 0.05 and row["higher"] > row["lower"]
