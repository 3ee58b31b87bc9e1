"""Mountings over a tolerance: what each keeps of its gain over the baseline where it hangs a little off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from ..settings import Tolerance
from .evaluation import Evaluator
from .site import Site
from .statistics import statistic_interval_90
from .tolerance import JUDGED_BASE, SEARCHED_BASE, ToleranceLosses, losses_over_tolerance

BASELINE = "baseline"


def judge_over_tolerance(
    site: Site, mountings: Mapping[str, Mapping[str, float]], evaluator: Evaluator, seed: int
) -> dict[str, dict]:
    """Scores of mountings over the scene's tolerance, on the searched and on the held-out frames.

    Parameters
    ----------
    mountings : mapping of str to coordinates
        The mountings by name [m, degrees]; one is the ``"baseline"``. Gains are measured against it as planned.
    evaluator : Evaluator
        Scores the searched frames.
    seed : int
        For the resampling of blocks.

    Returns
    -------
    dict
        For each name ``objective`` and ``objective_per_vehicle`` over the tolerance in the metric's unit,
        ``detectable_share``, ``gain_kept``: the share of the gain as planned that is kept, None without one,
        ``loss_at_limits`` for each coordinate that is not exact, and ``holdout`` with the same per vehicle,
        ``gain_over_baseline`` and its ``interval_90``; and, where a mounting is called ``"sharp"``, for the one called
        ``"optimised"`` also ``over_sharp`` in ``holdout``: by how much it is better, as planned and over the
        tolerance. ``holdout`` is None where nothing was held out. Empty where the scene has no tolerance.
    """
    tolerance = site.scenario.objective.tolerance
    if tolerance is None:
        return {}
    searched = {
        name: losses_over_tolerance(evaluator, plan, tolerance, site.plan.search_block)
        for name, plan in mountings.items()
    }
    held_out = {}
    if sum(int(frame.counted.sum()) for frame in site.holdout):
        with site.evaluator(site.holdout) as judge:
            held_out = {
                name: losses_over_tolerance(judge, plan, tolerance, site.plan.holdout_block)
                for name, plan in mountings.items()
            }
    return {
        name: {
            "objective": losses.aimed_per_vehicle * int(losses.planned.vehicles.sum()),
            **_per_vehicle(losses, searched[BASELINE]),
            "holdout": _held_out(name, held_out, seed) if held_out else None,
        }
        for name, losses in searched.items()
    }


def tolerance_result(
    tolerance: Tolerance | None,
    over_tolerance: Mapping[str, dict],
    sharp: Mapping[str, float] | None = None,
    verdict: Mapping[str, dict] | None = None,
    evaluations: Mapping[str, int] | None = None,
) -> dict | None:
    """The block ``tolerance`` of result.json; None without a tolerance.

    Parameters
    ----------
    over_tolerance : mapping
        What `judge_over_tolerance` says.
    sharp : mapping of str to float, optional
        The best mounting as planned [m, degrees], where there was a search.
    verdict : mapping, optional
        What `judge` says, of ``"sharp"`` too.
    evaluations : mapping of str to int, optional
        How many mountings the search of mountings as planned tried, and the one over the tolerance.
    """
    if tolerance is None:
        return None
    return {
        "settings": asdict(tolerance),
        "searched_errors": evaluations and SEARCHED_BASE[tolerance.aim] ** 2,
        "judged_errors": JUDGED_BASE**2,
        "evaluations": None
        if evaluations is None
        else dict(zip(("sharp", "robust"), evaluations.values(), strict=True)),
        "robust": dict(over_tolerance),
        "sharp": None if sharp is None else {"deployment": dict(sharp), **verdict["sharp"]},
    }


def _per_vehicle(losses: ToleranceLosses, baseline: ToleranceLosses) -> dict:
    return {
        "objective_per_vehicle": losses.aimed_per_vehicle,
        "detectable_share": losses.aimed_share,
        "gain_kept": losses.kept(baseline.planned_per_vehicle),
        "loss_at_limits": {key: list(pair) for key, pair in losses.limit_losses.items()},
    }


def _held_out(name: str, held_out: Mapping[str, ToleranceLosses], seed: int) -> dict:
    losses, baseline = held_out[name], held_out[BASELINE]
    interval = statistic_interval_90(
        lambda weights: losses.aimed_under(weights) - baseline.planned_under(weights), losses.block_vehicles, seed
    )
    scores = {
        **_per_vehicle(losses, baseline),
        "gain_over_baseline": losses.aimed_per_vehicle - baseline.planned_per_vehicle,
        "interval_90": None if interval is None else list(interval),
    }
    if name == "optimised" and "sharp" in held_out:
        scores["over_sharp"] = _over(losses, held_out["sharp"], seed)
    return scores


def _over(robust: ToleranceLosses, sharp: ToleranceLosses, seed: int) -> dict:
    """By how much the one is better than the other per vehicle, each with its 90 % interval."""
    return {
        "as_planned": _difference(
            robust.planned_per_vehicle - sharp.planned_per_vehicle,
            lambda weights: robust.planned_under(weights) - sharp.planned_under(weights),
            robust,
            seed,
        ),
        "over_tolerance": _difference(
            robust.aimed_per_vehicle - sharp.aimed_per_vehicle,
            lambda weights: robust.aimed_under(weights) - sharp.aimed_under(weights),
            robust,
            seed,
        ),
    }


def _difference(value, resampled, losses, seed):
    interval = statistic_interval_90(resampled, losses.block_vehicles, seed)
    return {"objective_per_vehicle": value, "interval_90": None if interval is None else list(interval)}
