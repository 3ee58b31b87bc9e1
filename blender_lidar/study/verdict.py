"""Mountings against the baseline: on the frames that chose them, and on frames that did not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..sensors.pose import Pose
from .evaluation import Evaluator, Totals
from .site import Site
from .statistics import block_sums, ratio_interval_90


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
