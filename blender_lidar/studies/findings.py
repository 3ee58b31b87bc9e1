"""Findings of the study of stability: what one change does to a mounting, and how a number becomes a verdict.

A verdict is on a share of the gain over the baseline that the mounting leaves to the best one: of the grid under the
change, of other traffic, of other seeds, or of installations off the plan.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..metrics.metric import Metric
from ..road import RoadFrame
from ..run.verdict import AXES
from ..scene.mounting import leaning, pose_at, with_lean
from ..scene.scenario import Scenario
from ..sensors.pose import Pose
from ..statistics import FEWEST_BLOCKS, interval_90, linear_interval_90, ratio_interval_90
from .driver import Landscape, percent
from .variations import TRAFFIC

# --- verdicts ---------------------------------------------------------------------------------------------------------

STABLE, FRAGILE, FAILS = "stable", "fragile", "fails"
UNDECIDED = "undecided"  # nothing to judge by: too few blocks, or an objective that gains nothing anywhere
VERDICTS = (STABLE, FRAGILE, FAILS, UNDECIDED)
MOST_STABLE_LOSS, MOST_FRAGILE_LOSS = 0.05, 0.20  # shares of the gain over the baseline
VERDICT_RULE = (
    f"stable: the mounting loses at most {100 * MOST_STABLE_LOSS:g} % of the gain that it could have; fragile: at most "
    f"{100 * MOST_FRAGILE_LOSS:g} %; fails: more, and surely more than {100 * MOST_STABLE_LOSS:g} %; undecided: "
    f"nothing to gain, or too little traffic to tell {100 * MOST_STABLE_LOSS:g} from {100 * MOST_FRAGILE_LOSS:g} %"
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


# --- the mountings that are compared: the one in question, the baseline, and a grid of others -------------------------

REFERENCE, BASELINE, CANDIDATES = 0, 1, 2  # rows: the first two, and where the grid begins


@dataclass(frozen=True, slots=True, eq=False)
class MountingGrid:
    """A reference, the baseline, and candidates on a grid of heights and tilts through the reference.

    Attributes
    ----------
    reference : dict of str to float
        The six coordinates in question, metres and degrees.
    baseline : Pose
    height_m, tilt_deg : ndarray, (k,)
        Of each candidate.
    axes : (str, str)
        What these two are: see `Deployment.axes`.
    road : RoadFrame
        Beside which they hang.
    """

    reference: dict[str, float]
    baseline: Pose
    height_m: np.ndarray
    tilt_deg: np.ndarray
    axes: tuple[str, str] = AXES
    road: RoadFrame = field(default=RoadFrame())

    @property
    def grid(self) -> list[dict[str, float]]:
        """The six coordinates of each candidate, (k)."""
        return [
            leaning(self.reference, **dict(zip(self.axes, (height, tilt), strict=True)))
            for height, tilt in zip(self.height_m.tolist(), self.tilt_deg.tolist(), strict=True)
        ]

    @property
    def steps(self) -> tuple[float, float]:
        """From one height of the grid to the next [m], and from one tilt to the next [deg]; 0 where there is one."""
        height, tilt = (float(np.diff(np.unique(axis)).max(initial=0.0)) for axis in (self.height_m, self.tilt_deg))
        return height, tilt

    @property
    def poses(self) -> tuple[Pose, ...]:
        """All of them, (2 + k)."""
        reference, *grid = (pose_at(one, self.road) for one in (self.reference, *self.grid))
        return reference, self.baseline, *grid


def check_searched(scenario: Scenario) -> None:
    """Refuse a scene that fixes both height and tilt: there is no optimum whose place could be uncertain."""
    axes = scenario.deployment.axes
    if not any(axis in scenario.deployment.bounds for axis in axes):
        raise InputError(
            f"{scenario.source}: [deployment] fixes {' and '.join(axes)}; allowed: at least one a pair [low, high]"
        )


def check_one_place(scenario: Scenario) -> None:
    """Refuse candidate poles and several recordings: a study is about one place and one recording."""
    if scenario.further_traffic:
        raise InputError(
            f"{scenario.source}: [[traffic]]: {len(scenario.recordings)} recordings are for optimise and evaluate; a "
            "study is about one: [traffic]"
        )
    if scenario.deployment.poles:
        raise InputError(
            f"{scenario.source}: [deployment] poles: are for optimise; a study is about one place: x_m and y_m"
        )


def mountings_about(scenario: Scenario, reference: Mapping[str, float], heights: int, tilts: int) -> MountingGrid:
    """Candidates over the searched ones of height and tilt, the other coordinates as in `reference`."""
    names = scenario.deployment.axes
    counts, place = dict(zip(names, (heights, tilts), strict=True)), with_lean(reference)
    axes: list[Sequence[float]] = [
        np.linspace(*scenario.deployment.bounds[axis], counts[axis]).round(9)  # 4.3, not 4.30...01
        if axis in scenario.deployment.bounds
        else np.array([place[axis]])
        for axis in names
    ]
    height, tilt = (grid.ravel() for grid in np.meshgrid(*axes, indexing="ij"))
    return MountingGrid(dict(reference), scenario.baseline_pose, height, tilt, names, scenario.road)


# --- losses -----------------------------------------------------------------------------------------------------------


def best_candidate(landscape: Landscape) -> int:
    """Which candidate is the best; the first of equals."""
    return int(np.argmax(landscape.per_vehicle()[CANDIDATES:]))


def chooses(landscape: Landscape) -> bool:
    """Whether it prefers any mounting to another: the distance, for one, does not."""
    values = landscape.per_vehicle()
    return bool(np.ptp(values) > 1e-9 * np.abs(values).max())


def values_under(weights: np.ndarray, objective: np.ndarray, vehicles: np.ndarray) -> np.ndarray:
    """Objective per vehicle, (m, r), with each block of time counted `weights` (r, b) times."""
    return (objective @ weights.T) / (weights @ vehicles)


def losses_to(best: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Share of the gain that the mounting in question leaves to the `best` (r,), for each column of `values` (m, r).

    Below 0 where it is the better one; NaN where the best is no better than the baseline.
    """
    gain = best - values[BASELINE]
    return np.divide(best - values[REFERENCE], gain, out=np.full(len(gain), np.nan), where=gain > 0.0)


def losses_to_best(values: np.ndarray) -> np.ndarray:
    """The same beside the best of all: the mounting may itself be that, as candidates are a grid."""
    return losses_to(np.maximum(values[CANDIDATES:].max(axis=0), values[REFERENCE]), values)


# --- the sample of traffic: is the gain real, where does the optimum stray, how much more would be needed -------------

ASKED_DEG = 1.0  # steps of the tilts that it is told from must not be wider
_RESAMPLES = 1000
_SLOWEST, _FASTEST = 1.0 / 3.0, 0.5  # powers of the sample that an optimum's error can fall with: of jumps, of a hill
_SIZES = 8


@dataclass(frozen=True, slots=True)
class SampleSize:
    """How far the best tilt strays in samples of several sizes.

    Attributes
    ----------
    vehicles : tuple of float
        Vehicle observations of each size; the last is what is at hand.
    reach_deg : tuple of float
        Half of the 90 % interval of the best tilt [deg]; half a step of the grid where that is more.
    power : float
        The interval falls with this power of the observations: fitted, between 1/3 (Kim and Pollard 1990, where the
        objective jumps) and 1/2 (where it is a smooth hill).
    needed : float
        Observations that make the best tilt certain to `ASKED_DEG`; beyond those at hand by that power.
    """

    vehicles: tuple[float, ...]
    reach_deg: tuple[float, ...]
    power: float
    needed: float


def sample_size(objective: np.ndarray, vehicles: np.ndarray, tilt_deg: np.ndarray, seed: int) -> SampleSize | None:
    """See where the optimum goes in samples of fewer blocks of time.

    Blocks are drawn without replacement, up to half of them: of an argmax, unlike a mean, the bootstrap tells too
    little (Abrevaya and Huang 2005), as resamples share the accidents of the sample. A sample of m of b blocks strays
    from the whole as an independent one of m / (1 - m / b) blocks strays from the truth, and counts as that many:
    exactly so for a mean, about so for an argmax.

    Parameters
    ----------
    objective : ndarray, (m, b)
        Of each mounting in each block, as a `Landscape` has them.
    vehicles : ndarray, (b,)
        Of each block; those without any are left out.
    tilt_deg : ndarray, (k,)
        Tilt of each candidate [deg].
    seed : int

    Returns
    -------
    SampleSize or None
        None for too few blocks.
    """
    filled = vehicles > 0
    objective, vehicles, blocks = objective[:, filled], vehicles[filled], int(filled.sum())
    if blocks < 2 * FEWEST_BLOCKS:
        return None
    rng, finest = np.random.default_rng(seed), 0.5 * float(np.diff(np.unique(tilt_deg)).max(initial=0.0))
    sizes = np.unique(np.geomspace(FEWEST_BLOCKS, blocks // 2, _SIZES).round().astype(int))
    counts, reach = sizes / (1.0 - sizes / blocks) * vehicles.mean(), np.empty(len(sizes))
    for row, size in enumerate(sizes):
        weights = samples_without_replacement(blocks, size, rng)
        best = np.argmax(values_under(weights, objective, vehicles)[CANDIDATES:], axis=0)
        low, high = interval_90(tilt_deg[best])
        reach[row] = max(finest, 0.5 * (high - low))
    power, strays = _FASTEST, reach > finest  # by more than the grid tells
    if strays.sum() >= 2:
        slope = np.polyfit(np.log(counts[strays]), np.log(reach[strays]), 1)[0]
        power = float(np.clip(-slope, _SLOWEST, _FASTEST))  # kept to what theory allows
    too_wide = np.flatnonzero(reach > ASKED_DEG)
    if reach[-1] > ASKED_DEG:
        needed = counts[-1] * (reach[-1] / ASKED_DEG) ** (1.0 / power)
    else:  # from where on it stays narrow enough
        needed = counts[too_wide[-1] + 1 if len(too_wide) else 0]
    return SampleSize(tuple(counts.tolist()), tuple(reach.tolist()), power, float(needed))


def samples_without_replacement(blocks: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """Which of `blocks` are in each of many samples of `size`, 1 or 0, (r, blocks)."""
    order = rng.permuted(np.tile(np.arange(blocks), (_RESAMPLES, 1)), axis=1)
    weights = np.zeros((_RESAMPLES, blocks))
    np.put_along_axis(weights, order[:, :size], 1.0, axis=1)
    return weights


_MOST_FRAGILE_DEG = 5.0
_SURE_SHARE = 0.5  # of the gain that the lower end of its interval must keep


class Intervals(NamedTuple):
    """Where resampled traffic puts the optimum: 90 % intervals of height [m] and tilt [deg]."""

    height_m: tuple[float, float]
    tilt_deg: tuple[float, float]

    def hold(self, height_m: float, tilt_deg: float, steps: tuple[float, float] = (0.0, 0.0)) -> bool:
        """Whether an optimum lies in both, which neither rounding nor the grid that it is on decides.

        `steps` of that grid, [m] and [deg]: no more is known of the optimum than that it is within half a step.
        """
        pairs = ((self.height_m, height_m, steps[0]), (self.tilt_deg, tilt_deg, steps[1]))
        return all(low - 0.5 * step - 1e-6 <= value <= high + 0.5 * step + 1e-6 for (low, high), value, step in pairs)


def gain_finding(judged: Landscape | None, block: np.ndarray, seed: int, metric: Metric) -> Finding:
    """Whether the mounting gains on traffic that had no say in its choice: on held-out frames, None without any.

    `block` (f,) labels them; `seed` is that of resampled blocks.
    """
    what, interval = "gain on held-out traffic", None
    if judged is not None:
        (reference, baseline), vehicles = judged.select([REFERENCE, BASELINE]).blocks(block)
        interval = ratio_interval_90(reference - baseline, vehicles, seed)
    if interval is None:
        held_out = "nothing is held out" if judged is None else "too little traffic is held out for an interval"
        return Finding(TRAFFIC, what, "", UNDECIDED, held_out)
    values, (low, high) = judged.per_vehicle(), interval
    gain = float(values[REFERENCE] - values[BASELINE])
    decided = FAILS if low <= 0.0 else STABLE if low >= _SURE_SHARE * gain else FRAGILE
    text = f"{metric.difference(gain)}{metric.per_vehicle}, 90 % interval {metric.number(low)} to {metric.number(high)}"
    numbers = {"gain_over_baseline": gain, "interval_90": [low, high]}
    numbers |= {"vehicles": int(judged.vehicles.sum()), "blocks": int((vehicles > 0).sum())}
    return Finding(TRAFFIC, what, "", decided, text, numbers)


def optimum_finding(
    landscape: Landscape, mountings: MountingGrid, block: np.ndarray, seed: int
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
    (lowest, highest), (least, most) = intervals
    text = f"height {lowest:.2f} to {highest:.2f} m, tilt {least:.1f} to {most:.1f} deg (90 %); {left}"
    numbers = {"height_interval_90_m": [lowest, highest], "tilt_interval_90_deg": [least, most], "loss_95": loss}
    return Finding(TRAFFIC, what, "", by_loss(loss), text, numbers), intervals


def sample_size_finding(found: SampleSize | None) -> Finding:
    """How certain the tilt is, and how many vehicles would make it certain to a degree."""
    what = f"best tilt to {ASKED_DEG:g} deg"
    if found is None:
        return Finding(TRAFFIC, what, "", UNDECIDED, "too few blocks of time")
    reach, here = found.reach_deg[-1], found.vehicles[-1]
    verdict = STABLE if reach <= ASKED_DEG else FRAGILE if reach <= _MOST_FRAGILE_DEG else FAILS
    needed = f"{float(f'{found.needed:.1e}'):,.0f}"  # two digits: no more are known
    more = f"as this falls with their power {-found.power:.2f}, it takes about {needed}"
    text = f"+/-{reach:.1f} deg from {here:,.0f} vehicle observations, searched and held out; "
    text += more if reach > ASKED_DEG else f"from about {needed} on"
    return Finding(TRAFFIC, what, "", verdict, text, asdict(found))


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
        The mounting in question, the baseline and that candidate on the frames that judge.
    """

    best: int
    chooses: bool
    judged: Landscape


def finding_of(
    change: tuple[str, str, str],
    draws: Sequence[ChangeDraw | str],
    mountings: MountingGrid,
    intervals: Intervals | None,
    block: np.ndarray | None,
) -> Finding:
    """What one change does to the mounting in question; several draws of it are judged by their mean.

    Parameters
    ----------
    change : (str, str, str)
        Section, what and value.
    draws : sequence of Draw or str
        A text tells why the site does not allow the change.
    mountings : MountingGrid
    intervals : Intervals or None
        Where resampled traffic puts the optimum of the scene as it is.
    block : ndarray of int, (f,), or None
        Block of each frame that judges; None where the same frames chose the best mounting, whose luck no interval has.
    """
    refused = [draw for draw in draws if isinstance(draw, str)]
    if refused:
        return Finding(*change, UNDECIDED, refused[0])
    if not all(draw.chooses for draw in draws):
        return Finding(*change, UNDECIDED, "does not choose: it is the same wherever the LiDAR hangs")
    best = [draw.best for draw in draws]
    places = mountings.height_m[best].tolist(), mountings.tilt_deg[best].tolist()
    held = intervals and [intervals.hold(*place, mountings.steps) for place in zip(*places, strict=True)]
    numbers = {"best_height_m": places[0], "best_tilt_deg": places[1], "inside": held}
    numbers["vehicles_per_frame"] = float(np.mean([draw.judged.vehicles.mean() for draw in draws]))
    values = np.array([draw.judged.per_vehicle() for draw in draws]).T
    losses = losses_to(values[CANDIDATES], values).tolist()
    if np.isnan(losses).any():
        text = "what is best on the searched frames gains nothing on those that judge"
        return Finding(*change, UNDECIDED, text, numbers)
    loss, interval = float(np.mean(losses)), None
    if block is not None:
        objective, vehicles = zip(*(draw.judged.blocks(block) for draw in draws), strict=True)
        influence = np.mean([_influence(one) for one in objective], axis=0)
        interval = linear_interval_90(loss, influence[sum(vehicles) > 0])
    text = f"{lost(loss, interval)}; {_places(*places, held)}"
    numbers |= {"loss": loss, "interval_90": interval and list(interval), "losses": losses}
    return Finding(*change, by_loss(loss, interval), text, numbers)


def _influence(objective: np.ndarray) -> np.ndarray:
    """How far each block moves the loss, (b,), from the objective of a draw's three mountings, (3, b).

    The loss is a ratio of sums over blocks, what the mounting leaves over what there is to gain.
    """
    rival = objective[CANDIDATES]
    left, gain = rival - objective[REFERENCE], rival - objective[BASELINE]
    return (left - left.sum() / gain.sum() * gain) / gain.sum()


def _places(heights: Sequence[float], tilts: Sequence[float], inside: Sequence[bool] | None) -> str:
    """Where the optimum would be under each draw, and how many of these places are inside."""
    text = f"best at {_range(heights, 2)} m, {_range(tilts, 0)} deg"
    if inside is None:
        return text
    some = "inside" if all(inside) else f"{sum(inside)} of {len(inside)} inside"
    return f"{text}: {some if any(inside) else 'outside'}"


def _range(values: Sequence[float], digits: int) -> str:
    return " to ".join(dict.fromkeys(f"{end:.{digits}f}" for end in (min(values), max(values))))
