"""From the stored runs of the searches to shares, quantiles, tests and the verdict on what ours was to achieve.

The rules, fixed before anything was judged, are the constants at the top; docs/evidence/search.md tells them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from blender_lidar.errors import InputError
from search_problems import BBOB_DIMENSIONS, BBOB_GROUPS, CASES
from search_solvers import DE_PSO_FORMS, OURS, RIVALS, SOLVERS, checkpoints

BBOB_SUCCESS = 1e-2  # f - f*
BBOB_ALSO = (1e-1, 1e-4)  # reported besides
SCENE_SUCCESS = 0.01  # regret as a share of [best known - baseline]
SCENE_ALSO = (0.05, 0.001)
MARGIN = 0.05  # share of successes by which the best rival may at most be ahead, interval included
BBOB_TARGETS = tuple(10.0 ** (2.0 - 0.2 * k) for k in range(51))  # of the runtime ECDF: 1e2 to 1e-8
SCENE_TARGETS = tuple(10.0 ** (-0.1 * k) for k in range(41))  # 1 to 1e-4

SHOWN, ESTIMATED, MISSED = "yes", "estimate only", "no"
_EQUAL_BELOW = 1e-8  # regrets that small are rounding


# --- statistics -------------------------------------------------------------------------------------------------------


def wilson(successes: int, runs: int) -> list[float]:
    """Share of successes with the ends of Wilson's 95 % interval (1927)."""
    interval = stats.binomtest(successes, runs).proportion_ci(0.95, method="wilson")
    return [successes / runs, float(interval.low), float(interval.high)]


def paired_difference(first: np.ndarray, second: np.ndarray) -> list[float]:
    """Share of successes of the first less that of the second on the same problems, with a 95 % interval.

    Bonett and Price's (2012): Wald's with one added to either kind of disagreement, and two to the runs.
    """
    only_first, only_second, runs = int((first & ~second).sum()), int((~first & second).sum()), first.size
    p, q = (only_first + 1) / (runs + 2), (only_second + 1) / (runs + 2)
    reach = stats.norm.ppf(0.975) * math.sqrt((p + q - (p - q) ** 2) / (runs + 2))
    return [(only_first - only_second) / runs, max(-1.0, p - q - reach), min(1.0, p - q + reach)]


def mcnemar(first: np.ndarray, second: np.ndarray) -> float:
    """Exact two-sided p-value of McNemar's test: of the disagreements, as many favour the first as the second."""
    only_first, only_second = int((first & ~second).sum()), int((~first & second).sum())
    disagree = only_first + only_second
    return float(stats.binomtest(only_first, disagree).pvalue) if disagree else 1.0


def wilcoxon(first: np.ndarray, second: np.ndarray) -> float:
    """Two-sided p-value of Wilcoxon's signed-rank test; NaN where all pairs are equal."""
    difference = (first - second)[first != second]
    return float(stats.wilcoxon(difference).pvalue) if difference.size else math.nan


# --- runs as arrays ---------------------------------------------------------------------------------------------------


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
    group : ndarray of str, (n,)
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
    group: np.ndarray
    regret: dict[str, np.ndarray]
    on_bound: dict[str, np.ndarray]

    def solved(self, solver: str) -> np.ndarray:
        """Whether each run succeeded, (n,)."""
        return self.regret[solver][:, -1] <= self.success

    def reached(self, solver: str) -> np.ndarray:
        """Runtime ECDF: share of (problem, target) pairs reached after each of `evaluations`, (c,)."""
        return np.mean([(self.regret[solver] <= target).mean(axis=0) for target in self.targets], axis=0)


def parts_of(stored: Sequence) -> list[Part]:
    """The parts of the judging that anything is stored of: pairs of a task and its runs, as `search_study` has them."""
    found = [
        _part(stored, f"BBOB {d}-D", lambda task, d=d: task.name.startswith(f"bbob_{d}d_"), _bbob_rules)
        for d in BBOB_DIMENSIONS
    ]
    found += [_part(stored, case, lambda task, case=case: task.part == case, _scene_rules) for case in CASES]
    return [part for part in found if part is not None]


def _part(stored: Sequence, label: str, belongs: Callable, rules: Callable) -> Part | None:
    runs = [(task, run) for task, found in stored if belongs(task) for run in found]
    if not runs:
        return None
    rows = {name: [(task, run) for task, run in runs if run["solver"] == name] for name in SOLVERS}
    best = {name: np.array([run["best"] for _, run in own]) for name, own in rows.items()}
    *constants, group, optimum, scale = rules(rows[OURS], best)
    return Part(
        label,
        *constants,
        np.array(checkpoints(runs[0][0].budget)),
        np.array(group),
        {name: np.maximum(0.0, (optimum[:, None] - of) / scale[:, None]) for name, of in best.items()},
        {name: np.array([run["on_bound"] for _, run in own]) for name, own in rows.items()},
    )


def _bbob_rules(rows: Sequence, best: dict[str, np.ndarray]) -> tuple:
    of = {function: name for name, functions in BBOB_GROUPS.items() for function in functions}
    group = [of[int(run["problem"][1:])] for _, run in rows]
    optimum = np.array([run["optimum"] for _, run in rows])
    return BBOB_SUCCESS, BBOB_ALSO, BBOB_TARGETS, group, optimum, np.ones(len(rows))


def _scene_rules(rows: Sequence, best: dict[str, np.ndarray]) -> tuple:
    known = np.max([of[:, -1] for of in best.values()], axis=0)  # the best that anyone has found
    gain = known - [run["baseline"] for _, run in rows]
    if not (gain > 0.0).all():
        raise InputError(f"{rows[int(np.argmin(gain))][0].name}: no solver found better than the scene's baseline")
    return SCENE_SUCCESS, SCENE_ALSO, SCENE_TARGETS, [task.recording for task, _ in rows], known, gain


# --- judgement --------------------------------------------------------------------------------------------------------


def holm(p_values: Sequence[float]) -> list[float]:
    """Holm-Bonferroni: p-values adjusted for their number (Holm 1979), in the order given; NaN does not count."""
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p, kind="stable")[: int(np.isfinite(p).sum())]  # NaN comes last
    adjusted = np.full(len(p), np.nan)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(order), 0, -1)), 1.0)
    return adjusted.tolist()


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
        "verdict": [_verdict(part, compared, groups) for part in parts],
    }


def _summary(part: Part) -> dict:
    solvers = {}
    for name in SOLVERS:
        final = part.regret[name][:, -1]
        solvers[name] = {
            "success": wilson(int(part.solved(name).sum()), final.size),
            "also": {f"{target:g}": float((final <= target).mean()) for target in part.also},
            "regret": [float(q) for q in np.quantile(final, [0.5, 0.9], method="inverted_cdf")],
            "on_bound": float(part.on_bound[name].mean()),
            "reached": float(part.reached(name)[-1]),
        }
    by_group = {
        group: {name: float(part.solved(name)[part.group == group].mean()) for name in SOLVERS}
        for group in dict.fromkeys(part.group.tolist())
    }
    return {"label": part.label, "runs": len(part.group), "solvers": solvers, "by_group": by_group}


def _compared(part: Part, rival: str) -> dict:
    ours, theirs = part.solved(OURS), part.solved(rival)
    tests = {"difference": paired_difference(ours, theirs), "mcnemar": mcnemar(ours, theirs)}
    return {"part": part.label, "rival": rival, **tests, **_ranks(part, rival, slice(None))}


def _by_group(part: Part, rival: str) -> list[dict]:
    return [
        {"part": part.label, "group": group, "rival": rival, **_ranks(part, rival, part.group == group)}
        for group in dict.fromkeys(part.group.tolist())
    ]


def _ranks(part: Part, rival: str, rows: np.ndarray | slice) -> dict:
    """Wilcoxon's test of the final regrets, and how often either is lower."""
    ours, theirs = (np.maximum(part.regret[name][rows, -1], _EQUAL_BELOW) for name in (OURS, rival))
    lower, higher = int((ours < theirs).sum()), int((ours > theirs).sum())
    return {"wilcoxon": wilcoxon(np.log10(ours), np.log10(theirs)), "lower": lower, "higher": higher}


def _verdict(part: Part, compared: list[dict], groups: list[dict]) -> dict:
    """Against both DE-PSO forms, the rival that did best, and whether any is ahead by too much."""
    rows = {row["rival"]: row for row in compared if row["part"] == part.label}
    best = max(RIVALS, key=lambda rival: part.solved(rival).mean())
    leads = {rival: paired_difference(part.solved(rival), part.solved(OURS)) for rival in RIVALS}
    worse = [row for row in groups if row["part"] == part.label and _differs(row) and row["higher"] > row["lower"]]
    return {
        "part": part.label,
        "de_pso": {form: _against(rows[form]) for form in DE_PSO_FORMS},
        "best_rival": best,
        "ahead": leads[best],
        "within_margin": _within(leads.values()),
        "worse_groups": [f"{row['group']} ({row['rival']})" for row in worse],
    }


def _within(leads: Iterable[Sequence[float]]) -> str:
    """Whether no rival is ahead by more than `MARGIN`: shown by the intervals, so by the estimates alone, or not so."""
    values, _, highs = zip(*leads, strict=True)
    return SHOWN if max(highs) <= MARGIN else ESTIMATED if max(values) <= MARGIN else MISSED


def _against(row: dict) -> str:
    """In one word how we do: by success if that differs significantly, else by regret."""
    if row["mcnemar_holm"] < 0.05:
        return "better" if row["difference"][0] > 0.0 else "worse"
    if _differs(row):
        return "better" if row["lower"] > row["higher"] else "worse"
    return "no different"


def _differs(row: dict) -> bool:
    return row["wilcoxon_holm"] < 0.05  # a NaN is not
