"""Mountings against the baseline: on the frames that chose them, and on frames that did not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..plots.binning import near_best_threshold
from ..sensors.pose import Pose
from .evaluation import Evaluator, Totals
from .score_map import ScoreMap
from .site import Site
from .statistics import block_sums, ratio_interval_90

REGION_SHARE = 0.01  # mountings that lose at most this share of the gain are as good


def judge(site: Site, mountings: Mapping[str, Pose], evaluator: Evaluator, seed: int) -> dict:
    """Scores of mountings on the searched and on the held-out frames.

    Parameters
    ----------
    mountings : mapping of str to Pose
        The mountings by name; one is the ``"baseline"`` that the others' gains are measured against.
    evaluator : Evaluator
        Scores the searched frames.
    seed : int
        For the resampling of blocks.

    Returns
    -------
    dict
        For each name ``objective`` and ``objective_per_vehicle`` in the metric's unit, ``detectable_share`` and
        ``holdout`` with the same per-vehicle scores, ``gain_over_baseline`` and its ``interval_90``. ``holdout`` is
        None where nothing was held out; ``interval_90`` where there are too few blocks.
    """
    poses, base = list(mountings.values()), list(mountings).index("baseline")
    searched = evaluator.totals(poses)
    held_out = None
    if len(site.holdout) and sum(int(frame.counted.sum()) for frame in site.holdout):
        with site.evaluator(site.holdout) as judge_evaluator:
            held_out = judge_evaluator.totals(poses)
    return {
        name: {
            "objective": float(searched.objective[row].sum()),
            **_per_vehicle(searched, row),
            "holdout": None if held_out is None else _held_out(held_out, row, base, site.plan.holdout_block, seed),
        }
        for row, name in enumerate(mountings)
    }


def map_verdict(score_map: ScoreMap, verdict: Mapping[str, dict], found: str, seed: int) -> dict:
    """The landscape in numbers; shares of the gain are None where nothing is better than the baseline.

    Parameters
    ----------
    verdict : mapping
        What `judge` says of the ``"baseline"``, of the ``"best_of_map"`` and of the mounting that was `found`.
    seed : int
        For the resampling of blocks.
    """
    height, tilt, value = score_map.best
    base, reached = (verdict[name]["objective_per_vehicle"] for name in ("baseline", found))
    best = max(value, reached)
    gains = best > base
    near_best = near_best_threshold(best, base, REGION_SHARE)
    intervals = score_map.optimum_intervals_90(seed)
    return {
        "points": list(score_map.per_vehicle.shape),
        "best": {"height_m": height, "tilt_x_deg": tilt, "objective_per_vehicle": value},
        "search_shortfall": (best - reached) / (best - base) if gains else None,
        "holdout_regret": _regret(*(verdict[name]["holdout"] for name in ("best_of_map", found))),
        "optimum_interval_90": None if intervals is None else {key: list(pair) for key, pair in intervals.items()},
        "share_within_1_percent": float((score_map.per_vehicle >= near_best).mean()) if gains else None,
    }


def distance_bands(table: dict[str, np.ndarray], width_m: float = 10.0) -> list[tuple[str, np.ndarray]]:
    """Names of the distance bands that hold vehicles, and which rows of a vehicle table each holds."""
    band = (table["distance_m"] // width_m).astype(int)
    return [(f"{number * width_m:g}-{(number + 1) * width_m:g} m", band == number) for number in np.unique(band)]


def lanes(table: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Names of the lanes that hold vehicles, and which rows of a vehicle table each holds."""
    return [(f"lane {number}" if number else "no lane", table["lane"] == number) for number in np.unique(table["lane"])]


def _per_vehicle(totals: Totals, row: int) -> dict:
    return {
        "objective_per_vehicle": float(totals.per_vehicle()[row]),
        "detectable_share": float(totals.detectable_share()[row]),
    }


def _held_out(totals: Totals, row: int, base: int, block: Sequence[int], seed: int) -> dict:
    gain = totals.objective[row] - totals.objective[base]
    interval = ratio_interval_90(block_sums(gain, block), block_sums(totals.vehicles, block), seed)
    return {
        **_per_vehicle(totals, row),
        "gain_over_baseline": float(gain.sum() / totals.vehicles.sum()),
        "interval_90": None if interval is None else list(interval),
        "vehicles": int(totals.vehicles.sum()),
        "frames": len(totals.vehicles),
        "blocks": len(np.unique(block)),
    }


def _regret(best, found):
    """Share of the gain of the map's best mounting that the found one lacks, on held-out frames; below 0 if better."""
    if best is None or not best["gain_over_baseline"] > 0.0:
        return None
    return 1.0 - found["gain_over_baseline"] / best["gain_over_baseline"]
