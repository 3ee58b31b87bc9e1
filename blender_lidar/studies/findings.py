"""Findings of the study of stability: what one change does to a mounting, and how a number becomes a verdict.

A loss is paired: what the mounting lacks to its rival on the same frames. The rival is the best one under a change, the
mounting as planned, or the best known. A verdict comes from the 90 % interval of a loss, never from the loss alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np

from ..metrics.catalogue import DETECTABLE
from ..metrics.metric import Metric
from ..run.as_hung import LOW_SHARE
from ..scene.deployment import Installer, installers_text, variable_of
from ..scene.installation import limit_errors
from ..scene.mounting import COORDINATE_NAMES
from ..statistics import FEW_VEHICLES, FEWEST_BLOCKS, best_without_block, block_sums, interval_90, student_t_95
from .candidates import BASELINE, FIRST, Candidates
from .driver import HELD_OUT, Landscape, percent
from .effects import Lost, chosen_shares, searched_weights, share_lost
from .variations import MOUNTING, SEARCH, TRAFFIC

RIVAL = FIRST + 1  # rows of what is judged: the baseline, the mounting in question, its rival, and those as likely
MOST_RIVALS = 5
_LIKELY = 0.05  # of the resamples of the searched blocks prefer it

# --- verdicts ---------------------------------------------------------------------------------------------------------

STABLE, FRAGILE, FAILS = LOSS_CLASSES = "stable", "fragile", "fails"
AT_MOST_FRAGILE, AT_LEAST_FRAGILE = f"{STABLE} or {FRAGILE}", f"{FRAGILE} or {FAILS}"
UNDECIDED = "undecided"  # no interval, or one that does not tell
VERDICTS = (STABLE, AT_MOST_FRAGILE, FRAGILE, AT_LEAST_FRAGILE, FAILS, UNDECIDED)
SHARE_LIMITS = (0.01, 0.05)  # of the detectable share: what is lost at most, if stable and if fragile
REAL_GAIN = 2.0  # half-widths of its 90 % interval
VERDICT_RULE = (
    "A verdict compares the mounting with its rival under the same change: even a stable one may see much less than "
    f"without the change. Stable: it loses at most {100 * SHARE_LIMITS[0]:g} percentage point of detectable share to "
    f"the rival. Fragile: at most {100 * SHARE_LIMITS[1]:g}. Fails: more. Where the 90 % interval of a loss crosses a "
    "limit two verdicts are told; where it crosses both, or there is none, it is undecided: too little traffic. The "
    "interval reaches up to what is lost to any mounting that resampled traffic may prefer. The gain over "
    "the baseline is stable where it is at least twice its noise and more vehicles are detectable, fragile where its "
    "interval leaves out 0. No share is told of a gain that is less than twice its noise"
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
    verdict : str or None
        One of `VERDICTS`; None where a number is told that is no loss.
    text : str
        What was found, in a sentence's worth of words.
    numbers : dict
        What the verdict rests on, as JSON holds it.
    """

    section: str
    what: str
    value: str
    verdict: str | None
    text: str
    numbers: dict = field(default_factory=dict)


def by_name(told: Mapping, lidars: Sequence[str]) -> Mapping[str, Mapping]:
    """What is told of each LiDAR by its name; a single one has none, and is told of without."""
    return told if any(lidars) else {"": told}


def by_loss(interval: Sequence[float] | None) -> str:
    """The verdict on a loss by its 90 % interval: all classes that it reaches; undecided without one, or with three."""
    if interval is None:
        return UNDECIDED
    first, last = np.searchsorted(SHARE_LIMITS, interval)
    return " or ".join(LOSS_CLASSES[first : last + 1]) if last - first < len(SHARE_LIMITS) else UNDECIDED


def worst(verdicts: Sequence[str | None]) -> str:
    """The gravest of several verdicts; what is undecided says nothing unless all are."""
    decided = [verdict for verdict in verdicts if verdict not in (UNDECIDED, None)]
    return max(decided, key=VERDICTS.index) if decided else UNDECIDED


# --- losses -----------------------------------------------------------------------------------------------------------


class Judges(NamedTuple):
    """What judges.

    Attributes
    ----------
    block : ndarray of int, (f,)
        Block of time of each frame.
    distinct : float
        Different vehicles there are for each that is counted, as a vehicle may count in several frames.
    metric : Metric
        Whose unit the objective has.
    """

    block: np.ndarray
    distinct: float
    metric: Metric


class Losses(NamedTuple):
    """What a mounting loses to its rival, each with its 90 % interval over blocks of time.

    Attributes
    ----------
    share : Lost
        Of the vehicles, those that are detectable.
    objective, gain : Lost
        Objective per vehicle, and what the rival gains of it over the baseline.
    of_gain : Lost or None
        The one over the other; None where the gain is less than `REAL_GAIN` times its noise.
    """

    share: Lost
    objective: Lost
    gain: Lost
    of_gain: Lost | None

    @property
    def numbers(self) -> dict:
        """As JSON holds them; ``loss`` is the one of the gain."""
        known = {"detectable_share_lost": self.share, "objective_lost": self.objective, "gain": self.gain}
        known["loss"] = self.of_gain or Lost(None, None, 0)
        ends = {f"{name}_interval_90": one.interval_90 and list(one.interval_90) for name, one in known.items()}
        return {name: one.share for name, one in known.items()} | ends


def losses_of(draws: Sequence[Landscape], judges: Judges) -> Losses:
    """What the mounting loses to its rival, a mean over draws of a change; rows of each draw as of `RIVAL`.

    The rival is the best on the frames that choose, and another may be the best on all traffic: intervals reach up to
    what is lost to any of those as likely.
    """
    totals = [(one.objective, one.detectable, one.weight, one.vehicles) for one in draws]
    parts = zip(*([block_sums(each, judges.block) for each in one] for one in totals), strict=True)
    objective, noticed, weight, vehicles = map(np.array, parts)
    (baseline, own, *rivals), filled = objective.transpose(1, 0, 2), vehicles.sum(axis=0) > 0
    rival = rivals[0]
    gain, of_gain = share_lost(rival - baseline, weight, filled), None
    if gain.interval_90 is not None and gain.share >= REAL_GAIN * (gain.interval_90[1] - gain.share):
        of_gain = share_lost(rival - own, rival - baseline, filled)
    distinct = judges.distinct * vehicles.sum() / len(draws)
    _, seen, *by_rivals = noticed.transpose(1, 0, 2)
    share = _to_any(of_vehicles(share_lost(each - seen, vehicles, filled), distinct) for each in by_rivals)
    return Losses(share, _to_any(share_lost(each - own, weight, filled) for each in rivals), gain, of_gain)


def _to_any(losses: Iterable[Lost]) -> Lost:
    """The loss to the first rival, with an interval that reaches up to the highest that any allows."""
    first, *others = losses
    if first.interval_90 is None:
        return first
    low, *highest = first.interval_90[0], first.interval_90[1], *(one.interval_90[1] for one in others)
    return first._replace(interval_90=(low, max(highest)))


def of_vehicles(share: Lost, distinct: float) -> Lost:
    """A difference of two shares of the same vehicles with an interval that holds for few of them.

    Half a vehicle is added to each of those that only the one and only the other detects (Agresti and Min 2005): where
    no vehicle differs the next one may. None for fewer than ten different vehicles, `distinct`.
    """
    if share.interval_90 is None or distinct < FEW_VEHICLES:
        return share._replace(interval_90=None)
    reach = math.hypot(share.interval_90[1] - share.share, student_t_95(share.blocks - 1) / (distinct + 2.0))
    return share._replace(interval_90=(share.share - reach, share.share + reach))


def losses_text(losses: Losses, metric: Metric) -> str:
    """What is lost, and what is not, with 90 % intervals."""
    unit_of_metric = "% of the metric" if metric.of_share else metric.unit or "of the metric"
    scales = (losses.share, DETECTABLE.number, "percentage points"), (losses.objective, metric.number, unit_of_metric)
    lost, kept = [], []
    for one, number, unit in scales:
        value, *ends = (number(each) for each in (one.share, *(one.interval_90 or ())))
        if float(value) > 0.0:
            lost.append(f"{value} {unit}" + f" ({' to '.join(ends)})" * bool(ends))
        else:
            kept.append(f"{' to '.join(ends) or value} {unit}")
        if one is losses.objective and float(value) > 0.0 and losses.of_gain is not None:
            lost.append(f"{percent(*losses.of_gain[:2])} of the gain")
    found = [f"loses {', '.join(lost)}"] * bool(lost) + [f"no loss found ({', '.join(kept)})"] * bool(kept)
    return "; ".join(found)


def judged_finding(
    change: tuple[str, str, str],
    draws: Sequence[Landscape],
    judges: Judges,
    rival: str = "the rival",
    more: str = "",
    numbers: Mapping = {},
) -> Finding:
    """What a mounting loses to its rival: both detectable shares, the losses, the verdict.

    Parameters
    ----------
    change : (str, str, str)
        Section, what and value.
    draws : sequence of Landscape
        Rows as of `RIVAL`, on the frames that judge.
    judges : Judges
    rival, more : str
        What the rival is called, and what else is told.
    numbers : mapping
        Further ones.
    """
    losses = losses_of(draws, judges)
    baseline, own, best, *_ = np.mean([one.detectable_share() for one in draws], axis=0).tolist()
    text = f"{percent(own)} detectable, {rival} {percent(best)}: {losses_text(losses, judges.metric)}{more}"
    told = {**numbers, "vehicles_per_frame": float(np.mean([one.vehicles.mean() for one in draws]))}
    told["detectable_share"] = {"baseline": baseline, "mounting": own, "best": best}
    return Finding(*change, by_loss(losses.share.interval_90), text, told | losses.numbers)


# --- rivals -----------------------------------------------------------------------------------------------------------


def chooses(landscape: Landscape) -> bool:
    """Whether it prefers any mounting to another: the distance, for one, does not."""
    values = landscape.per_vehicle()
    return bool(np.ptp(values) > 1e-9 * np.abs(values).max())


def best_row(landscape: Landscape, frames: np.ndarray | slice = slice(None)) -> int:
    """The row of the best mounting, the one in question among them; the first of equals."""
    return FIRST + int(np.argmax(landscape.per_vehicle(frames)[FIRST:]))


def cross_fitted(landscape: Landscape, block: np.ndarray) -> np.ndarray:
    """Cross-fitting: for each frame the row that is best on the blocks of time that do not judge it, (f,)."""
    best = best_without_block(block_sums(landscape.objective[FIRST:], block))
    return FIRST + best[np.unique(block, return_inverse=True)[1]]


def likely_rivals(landscape: Landscape, block: np.ndarray, seed: int) -> list[int]:
    """The row of the best mounting and of those that resampled blocks of time may prefer, `MOST_RIVALS` in all.

    Each of them is the best in 5 % of the resamples or more; with fewer the best is repeated. `block` (f,) are the
    blocks of the frames, `seed` resamples them.
    """
    best, often = best_row(landscape), chosen_shares(landscape, searched_weights(block, seed))
    rows = [best] + [FIRST + row for row in np.argsort(-often, kind="stable").tolist() if often[row] >= _LIKELY]
    rows = list(dict.fromkeys(rows))
    return (rows + [best] * MOST_RIVALS)[:MOST_RIVALS]


def beside(landscape: Landscape, own: int | np.ndarray, *rivals: int | np.ndarray) -> Landscape:
    """The baseline, the mounting in question and its rivals, given by their rows: one for all frames, or (f,)."""
    frames = np.arange(len(landscape.vehicles))
    rows = np.stack([np.broadcast_to(row, frames.shape) for row in (BASELINE, own, *rivals)])
    picked = landscape.objective[rows, frames], landscape.detectable[rows, frames]
    return Landscape(picked[0], landscape.vehicles, landscape.weight, picked[1])


# --- the sample of traffic: is the gain real, and where does the optimum stray? ---------------------------------------

_RESAMPLES = 1000


def samples_without_replacement(blocks: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """Which of `blocks` are in each of many samples of `size`, 1 or 0, (r, blocks)."""
    order = rng.permuted(np.tile(np.arange(blocks), (_RESAMPLES, 1)), axis=1)
    weights = np.zeros((_RESAMPLES, blocks))
    np.put_along_axis(weights, order[:, :size], 1.0, axis=1)
    return weights


def gain_finding(judged: Landscape, judges: Judges) -> Finding:
    """Whether the mounting is better than the baseline: the baseline, it and again the baseline, as `beside` has them.

    Stable is a gain in the metric of at least `REAL_GAIN` times its noise with more vehicles detectable, fragile one
    whose interval leaves out 0; fails one below 0, of either.
    """
    change, metric = (TRAFFIC, "gain over the baseline", ""), judges.metric
    gained = losses_of([judged], judges)
    share, gain = gained.share, gained.objective
    before, after = judged.detectable_share()[[FIRST, RIVAL]].tolist()
    numbers = {"detectable_share": {"baseline": before, "mounting": after}, "blocks": gain.blocks}
    numbers["vehicles"] = int(judged.vehicles.sum())
    for name, one in (("detectable_share_gained", share), ("gain_over_baseline", gain)):
        numbers |= {name: one.share, f"{name}_interval_90": one.interval_90 and list(one.interval_90)}
    text = f"{percent(after)} detectable, the baseline's {percent(before)}: "
    if gain.interval_90 is None or share.interval_90 is None:
        return Finding(*change, UNDECIDED, f"{text}too little traffic for an interval", numbers)
    low, high = gain.interval_90
    real = gain.share >= REAL_GAIN * (high - gain.share) and share.interval_90[0] > 0.0
    verdict = UNDECIDED if low <= 0.0 else STABLE if real else FRAGILE
    if high < 0.0 or share.interval_90[1] < 0.0:
        verdict = FAILS
    points = [DETECTABLE.number(one) for one in (share.share, *share.interval_90)]
    text += f"gains {points[0]} percentage points ({points[1]} to {points[2]}), {metric.difference(gain.share)}"
    text += f"{metric.per_vehicle} ({metric.number(low)} to {metric.number(high)})"
    return Finding(*change, verdict, text, numbers)


def optimum_finding(
    searched: Landscape, judged: Landscape, mountings: Candidates, block: np.ndarray, seed: int
) -> Finding:
    """Where other traffic would put the optimum, and how many vehicles are detectable from there on frames that judge.

    Halves of the blocks of time, drawn without replacement, stand for samples as large as the whole: a sample of m of b
    blocks strays from the whole as an independent one of m / (1 - m / b) blocks strays from the truth, exactly so for a
    mean, about so for an argmax, of which the bootstrap tells too little (Abrevaya and Huang 2005). A place is no loss,
    and has no verdict.
    """
    what, objective = "optimum on other traffic of this kind", block_sums(searched.objective, block)
    filled = block_sums(searched.vehicles, block) > 0
    blocks = int(filled.sum())
    if blocks < FEWEST_BLOCKS:
        return Finding(TRAFFIC, what, "", UNDECIDED, "too few blocks of time")
    weights = samples_without_replacement(blocks, max(1, blocks // 2), np.random.default_rng(seed))
    points, shares, texts, numbers = mountings.points, judged.detectable_share(), [], {}
    for number, name in enumerate(mountings.names):
        own = slice(2 * number, 2 * number + 2)
        held = (np.delete(points, own, axis=1) == np.delete(points[0], own)).all(axis=1)  # where only it is moved
        rows = np.flatnonzero(held)
        best = rows[np.argmax(objective[FIRST + rows][:, filled] @ weights.T, axis=0)]
        (lowest, highest), (least, most) = both = [interval_90(column[best]) for column in points[:, own].T]
        fewest, many = interval_90(shares[FIRST + best])
        tilt = mountings.variables[own][1].rpartition(".")[2].split("_")[0]
        place = f"height {lowest:.2f} to {highest:.2f} m, {tilt} {least:.1f} to {most:.1f} deg (90 %)"
        seen = f"from there {percent(fewest)} to {percent(many)} are detectable"
        texts.append(f"{name} {place}; {seen}".lstrip())
        keys = (variable_of(name, key) for key in ("height_interval_90_m", "tilt_interval_90_deg"))
        numbers |= zip(keys, map(list, both), strict=True)
    called = "the layout" if len(texts) > 1 else "the mounting"
    text = f"{'; '.join(texts)}, from {called} {percent(float(shares[FIRST]))}"
    return Finding(TRAFFIC, what, "", None, text, numbers)


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
        The baseline, the mounting in question and its rivals on the frames that judge: see `beside`.
    """

    best: int
    chooses: bool
    judged: Landscape


def change_finding(
    change: tuple[str, str, str], draws: Sequence[ChangeDraw | str], mountings: Candidates, judges: Judges
) -> Finding:
    """What one change does to the mounting in question; several draws of it are judged by their mean.

    Parameters
    ----------
    change : (str, str, str)
        Section, what and value.
    draws : sequence of ChangeDraw or str
        A text tells why the site does not allow the change.
    mountings : Candidates
    judges : Judges
    """
    refused = [draw for draw in draws if isinstance(draw, str)]
    if refused:
        return Finding(*change, UNDECIDED, refused[0])
    if not all(draw.chooses for draw in draws):
        return Finding(*change, UNDECIDED, "does not choose: it is the same wherever the LiDAR hangs")
    columns, places, numbers = mountings.points[[draw.best for draw in draws]].T.tolist(), [], {}
    for name, heights, tilts in zip(mountings.names, columns[::2], columns[1::2], strict=True):
        places.append(f"{name} {_range(heights, 2)} m, {_range(tilts, 0)} deg".lstrip())
        numbers |= {variable_of(name, "best_height_m"): heights, variable_of(name, "best_tilt_deg"): tilts}
    more = f"; rival at {'; '.join(places)}"
    return judged_finding(change, [draw.judged for draw in draws], judges, more=more, numbers=numbers)


def _range(values: Sequence[float], digits: int) -> str:
    return " to ".join(dict.fromkeys(f"{end:.{digits}f}" for end in (min(values), max(values))))


# --- what would see as many with lorries ------------------------------------------------------------------------------


def repair_finding(
    change: tuple[str, str, str], recorded: Landscape, lorries: Landscape, judges: Judges, place: str, judging: str
) -> Finding:
    """What a higher mounting, and one on the other side of the road, see of traffic with lorries, on frames that judge.

    A mounting beyond what is allowed is advice, and no rival: it has no verdict. The higher one was chosen on the
    searched frames; where these judge it, its gain has no interval.

    Parameters
    ----------
    change : (str, str, str)
        Section, what and value.
    recorded : Landscape
        The baseline and the mounting in question on traffic as recorded.
    lorries : Landscape
        With lorries the baseline, the mounting in question, the higher one and, where one can stand there, one on the
        other side.
    judges : Judges
    place : str
        Where the higher one hangs.
    judging : str
        The frames that judge, `HELD_OUT` or `SEARCHED`.
    """
    shares, before = lorries.detectable_share().tolist(), recorded.detectable_share().tolist()[FIRST]
    texts = [f"{percent(shares[FIRST])} detectable, without these lorries {percent(before)}"]
    numbers = {"mounting_share": shares[FIRST], "recorded_share": before}
    others = {"higher": f"at {place}", "other_side": "on the other side of the road"}
    for row, (key, where) in zip(range(RIVAL, len(shares)), others.items(), strict=False):
        gain = losses_of([beside(lorries, FIRST, row)], judges).share
        ends = None if row == RIVAL and judging != HELD_OUT else gain.interval_90
        points = DETECTABLE.number(gain.share) + (f" ({' to '.join(map(DETECTABLE.number, ends))})" if ends else "")
        texts.append(f"{where} {percent(shares[row])}, {points} percentage points more")
        told = {"share": shares[row], "gain": gain.share, "gain_interval_90": ends and list(ends)}
        numbers |= {f"{key}_{name}": one for name, one in told.items()}
    check = "judged on held-out ones" if judging == HELD_OUT else "without an independent check"
    return Finding(*change, None, f"{'; '.join(texts)}; the height was chosen on searched frames, {check}", numbers)


# --- an installer's errors --------------------------------------------------------------------------------------------


def installation_findings(
    hung: Landscape, installers: Sequence[Installer], judges: Judges, names: Sequence[str] = ("",)
) -> list[Finding]:
    """A line for each coordinate that is off to either side, and one for all.

    Parameters
    ----------
    hung : Landscape
        Of the baseline, the mounting as planned, each coordinate less and more by its half-width, in the order of
        `limit_errors`, and errors that stand for all.
    installers : sequence of Installer
        Of each LiDAR.
    judges : Judges
    names : sequence of str
        Names of the LiDARs, where there are several.
    """
    lines, row = [], RIVAL
    for lidar, key, _ in limit_errors(installers):
        (name, unit), widths = COORDINATE_NAMES[key], asdict(installers[lidar])
        half_width = widths.get(key, widths["tilt_deg"])  # of both tilts
        for side in ("less", "more"):
            change = (MOUNTING, f"{names[lidar]} {name}".lstrip(), f"{half_width:g} {unit} {side}")
            lines.append(judged_finding(change, [beside(hung, row, FIRST)], judges, "as planned"))
            row += 1
    errors, aim = np.arange(row, len(hung.objective)), next(one.aim for one in installers if not one.is_exact)
    if aim == "low":  # the installation than which one in ten is worse
        errors = errors[np.argsort(hung.per_vehicle()[errors])[[int(LOW_SHARE * len(errors))]]]
    draws = [beside(hung, error, FIRST) for error in errors]
    on_average = "on average" if aim == "mean" else "in nine of ten installations at most"
    more = f"; {on_average} within {installers_text(installers)}"
    return [*lines, judged_finding((MOUNTING, "all of these together", ""), draws, judges, "as planned", more)]


# --- other seeds of the search ----------------------------------------------------------------------------------------


def search_finding(
    answers: Sequence[dict],
    draws: Sequence[Landscape],
    judges: Judges,
    names: Sequence[str] = ("",),
    *,
    leans: bool = False,
) -> Finding:
    """What the answers of several seeds lose to the best known mounting, and how far apart they lie.

    Parameters
    ----------
    answers : sequence of dict
        Of each seed: ``mounting``, of several LiDARs by name, and ``evaluations``.
    draws : sequence of Landscape
        Of each seed: the baseline, its answer, and what of all that is known is best on the frames of the search.
    judges : Judges
    names : sequence of str
        Names of the LiDARs, where there are several.
    leans : bool
        Whether orientations are given as leans.
    """
    key = "lean_deg" if leans else "tilt_x_deg"
    found = [by_name(answer["mounting"], names) for answer in answers]
    more, numbers = "", {}
    for lidar in names:
        heights, tilts = ([one[lidar][name] for one in found] for name in ("height_m", key))
        more += f"; {f'{lidar} height'.lstrip()} {_range(heights, 2)} m, {key.split('_')[0]} {_range(tilts, 1)} deg"
        numbers |= {variable_of(lidar, "height_m"): heights, variable_of(lidar, key): tilts}
    change = (SEARCH, "regret", f"{len(answers)} seeds of {answers[0]['evaluations']:,} evaluations")
    return judged_finding(change, draws, judges, "the best known", more, numbers)
