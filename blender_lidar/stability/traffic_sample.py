"""Findings on the sample of traffic: is the gain real, where does the optimum stray, how much more would be needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from ..metrics.metric import Metric
from ..study.landscape import Landscape
from ..study.statistics import FEWEST_BLOCKS, interval_90
from .findings import FAILS, FRAGILE, STABLE, UNDECIDED, Finding, by_loss, percent
from .landscape import losses_to_best, values_under
from .mountings import CANDIDATES, Mountings
from .sample_size import ASKED_DEG, SampleSize, samples_without_replacement
from .variations import TRAFFIC
from .varied import Intervals

_MOST_FRAGILE_DEG = 5.0
_SURE_SHARE = 0.5  # of the gain that the lower end of its interval must keep


def gain_finding(verdict: Mapping, metric: Metric) -> Finding:
    """Whether traffic that had no say in the choice gains, from what `study.verdict.judge` gave of the mounting."""
    what = "gain on held-out traffic"
    held_out = verdict["holdout"]
    if held_out is None or held_out["interval_90"] is None:
        return Finding(TRAFFIC, what, "", UNDECIDED, "too little traffic is held out for an interval")
    gain, (low, high) = held_out["gain_over_baseline"], held_out["interval_90"]
    decided = FAILS if low <= 0.0 else STABLE if low >= _SURE_SHARE * gain else FRAGILE
    text = f"{metric.amount(gain)} per vehicle, 90 % interval {metric.number(low)} to {metric.number(high)}"
    numbers = {key: held_out[key] for key in ("gain_over_baseline", "interval_90", "vehicles", "blocks")}
    return Finding(TRAFFIC, what, "", decided, text, numbers)


def optimum_finding(
    landscape: Landscape, mountings: Mountings, block: np.ndarray, seed: int
) -> tuple[Finding, Intervals | None]:
    """Where other traffic would put the optimum, and what the mounting leaves to it in 95 % of such traffic.

    Halves of the blocks of time, drawn without replacement, stand for samples as large as the whole: see `sample_size`.
    """
    what = "optimum on other traffic of this kind"
    objective, vehicles = landscape.blocks(block)
    filled = vehicles > 0
    blocks = int(filled.sum())
    if blocks < FEWEST_BLOCKS:
        return Finding(TRAFFIC, what, "", UNDECIDED, "too few blocks of time"), None
    weights = samples_without_replacement(blocks, max(1, blocks // 2), np.random.default_rng(seed))
    values = values_under(weights, objective[:, filled], vehicles[filled])
    best = np.argmax(values[CANDIDATES:], axis=0)
    intervals = Intervals(interval_90(mountings.height_m[best]), interval_90(mountings.tilt_deg[best]))
    losses = losses_to_best(values)
    loss = None if np.isnan(losses).all() else float(np.nanquantile(losses, 0.95))
    left = "nothing is gained" if loss is None else f"in 95 % of them the mounting loses at most {percent(loss)}"
    text = (
        f"height {intervals.height_m[0]:.2f} to {intervals.height_m[1]:.2f} m, tilt {intervals.tilt_deg[0]:.1f} to "
        f"{intervals.tilt_deg[1]:.1f} deg (90 %); {left}"
    )
    numbers = {
        "height_interval_90_m": list(intervals.height_m),
        "tilt_interval_90_deg": list(intervals.tilt_deg),
        "loss_95": loss,
    }
    return Finding(TRAFFIC, what, "", by_loss(loss), text, numbers), intervals


def sample_size_finding(found: SampleSize | None) -> Finding:
    """How certain the tilt is, and how many vehicles would make it certain to a degree."""
    what = f"best tilt to {ASKED_DEG:g} deg"
    if found is None:
        return Finding(TRAFFIC, what, "", UNDECIDED, "too few blocks of time")
    reach, here = found.reach_deg[-1], found.vehicles[-1]
    verdict = STABLE if reach <= ASKED_DEG else FRAGILE if reach <= _MOST_FRAGILE_DEG else FAILS
    text = f"+/-{reach:.1f} deg from {here:,.0f} vehicle observations, searched and held out; "
    if reach > ASKED_DEG:
        text += f"as this falls with their power {-found.power:.2f}, it takes about {_rounded(found.needed):,.0f}"
    else:
        text += f"from about {_rounded(found.needed):,.0f} on"
    return Finding(TRAFFIC, what, "", verdict, text, asdict(found))


def _rounded(count: float) -> float:
    """Two digits: no more are known."""
    return float(f"{count:.1e}")
