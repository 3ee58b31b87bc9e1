"""Findings of the study of stability: what one change does to a mounting, and how a number becomes a verdict.

A verdict is on a share of the gain over the baseline that the mounting leaves to the best one: of the grid under the
change, of other traffic, of other seeds, or of installations off the plan. Beside a loss stand its 90 % interval, or
None, and the shares of the vehicles that are detectable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np

from ..metrics.metric import Metric
from ..run.tolerance import tolerance_text
from ..scene.mounting import COORDINATE_NAMES
from ..scene.settings import Tolerance
from ..statistics import FEWEST_BLOCKS, interval_90, ratio_interval_90
from .candidates import BASELINE, FIRST, Candidates
from .driver import Landscape, percent
from .effects import share_lost
from .variations import METRIC, MOUNTING, SEARCH, TRAFFIC

GRID = FIRST + 1  # rows of a landscape: the baseline, the mounting in question, and where the grid begins

# --- verdicts ---------------------------------------------------------------------------------------------------------

STABLE, FRAGILE, FAILS = "stable", "fragile", "fails"
UNDECIDED = "undecided"  # nothing to judge by: too few blocks, or an objective that gains nothing anywhere
VERDICTS = (STABLE, FRAGILE, FAILS, UNDECIDED)
MOST_STABLE_LOSS, MOST_FRAGILE_LOSS = 0.05, 0.20  # shares of the gain over the baseline
VERDICT_RULE = (
    f"stable: the mounting loses at most {100 * MOST_STABLE_LOSS:g} % of the possible gain; fragile: at most "
    f"{100 * MOST_FRAGILE_LOSS:g} %; fails: more, and surely more than {100 * MOST_STABLE_LOSS:g} %; undecided: "
    "either every mounting is equally good, or there is too little traffic"
)


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report.

    Attributes
    ----------
    section : str
        One of the study's sections.
    what, value : str
        What was changed or asked, and to what; `value` may be empty.
    verdict : str
        One of `VERDICTS`.
    text : str
        What was found, in a sentence's worth of words.
    numbers : dict
        What the verdict rests on, as JSON holds it.
    """

    section: str
    what: str
    value: str
    verdict: str
    text: str
    numbers: dict = field(default_factory=dict)


def by_loss(loss: float | None, interval: Sequence[float] | None = None) -> str:
    """The verdict on a share of the gain that is lost; None where there is no gain to lose.

    Where its 90 % interval is known, a loss that may be none does not fail, and one that may be large is not stable.
    """
    if loss is None:
        return UNDECIDED
    low, high = (loss, loss) if interval is None else interval
    if loss <= MOST_STABLE_LOSS:
        return STABLE if high <= MOST_FRAGILE_LOSS else UNDECIDED
    if loss <= MOST_FRAGILE_LOSS:
        return FRAGILE
    return FAILS if low > MOST_STABLE_LOSS else UNDECIDED


def worst(verdicts: Sequence[str]) -> str:
    """The gravest of several verdicts; what is undecided says nothing unless all are."""
    decided = [verdict for verdict in verdicts if verdict != UNDECIDED]
    return max(decided, key=VERDICTS.index) if decided else UNDECIDED


def lost(share: float, interval: Sequence[float] | None = None) -> str:
    """What a mounting loses, or by what it is better, as text; with its 90 % interval where there is one."""
    sign, words = (1.0, "loses") if share > -0.0005 else (-1.0, "is better by")
    return f"{words} {percent(sign * share, interval and sorted(sign * end for end in interval))}"


# --- losses -----------------------------------------------------------------------------------------------------------


def chooses(landscape: Landscape) -> bool:
    """Whether it prefers any mounting to another: the distance, for one, does not."""
    values = landscape.per_vehicle()
    return bool(np.ptp(values) > 1e-9 * np.abs(values).max())


def values_under(weights: np.ndarray, objective: np.ndarray, vehicles: np.ndarray) -> np.ndarray:
    """Objective per vehicle, (m, r), with each block of time counted `weights` (r, b) times."""
    return (objective @ weights.T) / (weights @ vehicles)


def losses_to_best(values: np.ndarray) -> np.ndarray:
    """Share of the gain that the mounting in question leaves to the best of all, for each column of `values` (m, r).

    It may itself be that, as candidates are a grid; NaN where the best is no better than the baseline.
    """
    best = values[FIRST:].max(axis=0)
    gain = best - values[BASELINE]
    return np.divide(best - values[FIRST], gain, out=np.full(len(gain), np.nan), where=gain > 0.0)


# --- the sample of traffic: is the gain real, and where does the optimum stray? ---------------------------------------

_RESAMPLES = 1000


def samples_without_replacement(blocks: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """Which of `blocks` are in each of many samples of `size`, 1 or 0, (r, blocks)."""
    order = rng.permuted(np.tile(np.arange(blocks), (_RESAMPLES, 1)), axis=1)
    weights = np.zeros((_RESAMPLES, blocks))
    np.put_along_axis(weights, order[:, :size], 1.0, axis=1)
    return weights


_SURE_SHARE = 0.5  # of the gain that the lower end of its interval must keep


def gain_finding(judged: Landscape | None, block: np.ndarray, seed: int, metric: Metric) -> Finding:
    """Whether the mounting gains on held-out frames; None without any.

    `block` (f,) labels them; `seed` is that of resampled blocks.
    """
    what, interval = "gain on held-out traffic", None
    if judged is not None:
        (baseline, reference), vehicles = judged.select([BASELINE, FIRST]).blocks(block)
        interval = ratio_interval_90(reference - baseline, vehicles, seed)
    if interval is None:
        held_out = "nothing is held out" if judged is None else "too little traffic is held out for an interval"
        return Finding(TRAFFIC, what, "", UNDECIDED, held_out)
    values, (low, high) = judged.per_vehicle(), interval
    gain = float(values[FIRST] - values[BASELINE])
    decided = FAILS if low <= 0.0 else STABLE if low >= _SURE_SHARE * gain else FRAGILE
    text = f"{metric.difference(gain)}{metric.per_vehicle}, 90 % interval {metric.number(low)} to {metric.number(high)}"
    numbers = {"gain_over_baseline": gain, "interval_90": [low, high]}
    numbers["detectable_share"] = dict(
        zip(("baseline", "mounting"), judged.detectable_share()[:GRID].tolist(), strict=True)
    )
    numbers |= {"vehicles": int(judged.vehicles.sum()), "blocks": int((vehicles > 0).sum())}
    return Finding(TRAFFIC, what, "", decided, text, numbers)


def optimum_finding(landscape: Landscape, mountings: Candidates, block: np.ndarray, seed: int) -> Finding:
    """Where other traffic would put the optimum, and what the mounting leaves to it in 95 % of such traffic.

    Halves of the blocks of time, drawn without replacement, stand for samples as large as the whole: a sample of m of b
    blocks strays from the whole as an independent one of m / (1 - m / b) blocks strays from the truth, exactly so for a
    mean, about so for an argmax, of which the bootstrap tells too little (Abrevaya and Huang 2005).
    """
    what = "optimum on other traffic of this kind"
    objective, vehicles = landscape.blocks(block)
    filled = vehicles > 0
    blocks = int(filled.sum())
    if blocks < FEWEST_BLOCKS:
        return Finding(TRAFFIC, what, "", UNDECIDED, "too few blocks of time")
    weights = samples_without_replacement(blocks, max(1, blocks // 2), np.random.default_rng(seed))
    values = values_under(weights, objective[:, filled], vehicles[filled])
    best = GRID - FIRST + np.argmax(values[GRID:], axis=0)
    (lowest, highest), (least, most) = (interval_90(column[best]) for column in mountings.points.T)
    losses = losses_to_best(values)
    loss = None if np.isnan(losses).all() else float(np.nanquantile(losses, 0.95))
    left = "nothing is gained" if loss is None else f"in 95 % of them the mounting loses at most {percent(loss)}"
    tilt = "lean" if mountings.leans else "tilt"
    text = f"height {lowest:.2f} to {highest:.2f} m, {tilt} {least:.1f} to {most:.1f} deg (90 %); {left}"
    numbers = {"height_interval_90_m": [lowest, highest], "tilt_interval_90_deg": [least, most], "loss_95": loss}
    return Finding(TRAFFIC, what, "", by_loss(loss), text, numbers)


# --- one change: where the optimum would go, and what the mounting leaves to it on other traffic ----------------------


class ChangeDraw(NamedTuple):
    """One draw of a change.

    Attributes
    ----------
    best : int
        The candidate that is best on the searched frames.
    chooses : bool
        Whether the objective prefers any candidate there.
    judged : Landscape
        The baseline, the mounting in question and that candidate on the frames that judge.
    """

    best: int
    chooses: bool
    judged: Landscape


def change_finding(
    change: tuple[str, str, str],
    draws: Sequence[ChangeDraw | str],
    mountings: Candidates,
    block: np.ndarray | None,
) -> Finding:
    """What one change does to the mounting in question; several draws of it are judged by their mean.

    Parameters
    ----------
    change : (str, str, str)
        Section, what and value.
    draws : sequence of ChangeDraw or str
        A text tells why the site does not allow the change.
    mountings : Candidates
    block : ndarray of int, (f,), or None
        Block of each frame that judges; None where the same frames chose the best mounting, whose luck no interval has.
    """
    refused = [draw for draw in draws if isinstance(draw, str)]
    if refused:
        return Finding(*change, UNDECIDED, refused[0])
    if not all(draw.chooses for draw in draws):
        return Finding(*change, UNDECIDED, "does not choose: it is the same wherever the LiDAR hangs")
    heights, tilts = mountings.points[[draw.best for draw in draws]].T.tolist()
    numbers = {"best_height_m": heights, "best_tilt_deg": tilts}
    numbers["vehicles_per_frame"] = float(np.mean([draw.judged.vehicles.mean() for draw in draws]))
    shares = np.mean([draw.judged.detectable_share() for draw in draws], axis=0).tolist()
    numbers["detectable_share"] = dict(zip(("baseline", "mounting", "best"), shares, strict=True))
    by = np.arange(len(draws[0].judged.vehicles)) if block is None else block
    of_blocks, vehicles = zip(*(draw.judged.blocks(by) for draw in draws), strict=True)
    baseline, mounting, best = np.array(of_blocks).transpose(1, 0, 2)
    found = share_lost(best - mounting, best - baseline, sum(vehicles) > 0)
    if found is None:
        text = "the mounting that it prefers is no better than the baseline on held-out frames"
        return Finding(*change, UNDECIDED, text, numbers)
    interval = None if block is None else found.interval_90
    text = f"{lost(found.share, interval)}; best at {_range(heights, 2)} m, {_range(tilts, 0)} deg"
    losses = ((best - mounting).sum(axis=1) / (best - baseline).sum(axis=1)).tolist()
    numbers |= {"loss": found.share, "interval_90": interval and list(interval), "losses": losses}
    return Finding(*change, by_loss(found.share, interval), text, numbers)


def _range(values: Sequence[float], digits: int) -> str:
    return " to ".join(dict.fromkeys(f"{end:.{digits}f}" for end in (min(values), max(values))))


# --- an installer's errors --------------------------------------------------------------------------------------------


def installation_findings(found: Mapping, tolerance: Tolerance) -> list[Finding]:
    """A line for each coordinate that is off, and one for all; `found` has ``gain``, ``kept`` and ``limits``."""
    if not found["gain"] > 0.0:
        return [Finding(MOUNTING, "installation", "", UNDECIDED, "the mounting gains nothing over the baseline")]
    lines = []
    for key, limits in found["limits"].items():
        (name, unit), (minus, plus) = COORDINATE_NAMES[key], (loss / found["gain"] for loss in limits)
        text = f"{lost(minus)} where it is less, {lost(plus)} where it is more"
        value = f"+/-{tolerance.half_widths[key]:g} {unit}"
        lines.append(Finding(MOUNTING, name, value, by_loss(max(minus, plus)), text, {"limits": [minus, plus]}))
    loss = 1.0 - found["kept"]
    aim = "on average" if tolerance.aim == "mean" else "in nine of ten installations"
    text = f"keeps {percent(found['kept'])} of its gain {aim} within {tolerance_text(asdict(tolerance))}"
    return [*lines, Finding(MOUNTING, "all of these together", "", by_loss(loss), text, {"loss": loss})]


# --- views so full that PE-VGOP falls where it should rise, and other seeds of the search -----------------------------

PEAK = 1.0 / math.e  # of -P log2 P


def saturation_finding(found: Mapping) -> Finding:
    """How much of what is seen lies where a denser view scores less: -P log2 P falls beyond P = 1/e.

    `found`: how many views were ``seen`` at all, the ``share`` of them beyond that, and ``share_within_10_m``.
    """
    share, near, text = found["share"], found["share_within_10_m"], "no view of any vehicle has a return"
    if share is not None:
        text = f"{percent(share)} of {found['seen']:,} seen views"
        text += "" if near is None else f", {percent(near)} of those nearer than 10 m: there a denser view scores less"
    return Finding(METRIC, "views beyond P = 1/e", "", by_loss(share), text, dict(found))


def search_finding(answers: Sequence[dict], best: float, baseline: float, *, leans: bool = False) -> Finding:
    """What the answers of several seeds leave to the best known mounting, and how far apart they lie.

    Parameters
    ----------
    answers : sequence of dict
        Of each seed: ``mounting``, its value ``per_vehicle``, and ``evaluations``.
    best, baseline : float
        Objective per vehicle of the best grid point and of the baseline, on the frames of the search.
    leans : bool
        Whether orientations are given as leans.
    """
    what, value = "regret", f"{len(answers)} seeds of {answers[0]['evaluations']:,} evaluations"
    values = np.array([answer["per_vehicle"] for answer in answers])
    best = max(best, float(values.max()))
    if not best > baseline:
        return Finding(SEARCH, what, value, UNDECIDED, "no mounting is better than the baseline")
    left = (best - values) / (best - baseline)
    key = "lean_deg" if leans else "tilt_x_deg"
    heights, tilts = ([answer["mounting"][name] for answer in answers] for name in ("height_m", key))
    text = f"median {percent(float(np.median(left)))}, worst {percent(float(left.max()))} of the gain; "
    text += f"height {_range(heights, 2)} m, {key.split('_')[0]} {_range(tilts, 1)} deg"
    numbers = {"regrets": left.tolist(), "height_m": heights, key: tilts}
    return Finding(SEARCH, what, value, by_loss(float(left.max())), text, numbers)
