"""The verdict on mountings: beside the baseline, as planned and as hung; and over a score map.

The score map is the objective over height and tilt: a picture of the whole landscape, and how certain its top is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..metrics.catalogue import metric_named
from ..metrics.vehicle_metrics import TIE_BREAKER
from ..scene.deployment import SearchSpace
from ..scene.mounting import Layout
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..statistics import block_sums, drawn_blocks, interval_90, of_blocks
from .as_hung import HungObjective, HungScores, hung_scores, judge_as_hung, two_wheelers_as_hung
from .comparison import Comparison
from .vehicle_table import vehicle_tables

REGION_SHARE = 0.01  # mountings that lose at most this share of the gain are as good
BASELINE_NAME = "baseline"

# --- Beside the baseline: on the frames that chose a mounting, and on frames that did not -----------------------------


def judge(
    site: Site,
    layouts: Mapping[str, Layout],
    tables: Mapping[str, Mapping[str, np.ndarray]],
    evaluator: Evaluator,
    seed: int | None,
) -> tuple[dict[str, dict], dict[str, Comparison]]:
    """Scores of mountings on the searched and on the held-out frames.

    Parameters
    ----------
    layouts : mapping of str to Layout
        The mountings by name; one is the ``"baseline"`` that the others' gains are measured against.
    tables : mapping of str to vehicle table
        Of each, on both splits.
    evaluator : Evaluator
        Of the searched frames, and of the held-out ones apart.
    seed : int or None
        For the resampling of blocks of searched frames, None where they have chosen a mounting; held-out ones take the
        scene's.

    Returns
    -------
    dict
        For each name ``objective`` in the metric's unit and `Comparison.scores` on the searched frames, and ``holdout``
        with the same on held-out ones; None where nothing was held out. ``recordings`` has the same of each recording
        alone, where there are several.
    dict of str to Comparison
        Each mounting beside the baseline on the frames that judge it.
    """
    splits = {"search": seed, "holdout": site.scenario.search.seed}
    if not evaluator.held_out.weight.sum():
        del splits["holdout"]
    base, verdict, judging = tables[BASELINE_NAME], {}, {}
    objective = dict(zip(layouts, evaluator.totals(list(layouts.values())).objective.sum(axis=1).tolist(), strict=True))
    for name, table in tables.items():
        compared = {split: Comparison.of_split(base, table, split, site, by) for split, by in splits.items()}
        searched, held_out = compared["search"], compared.get("holdout")
        verdict[name] = {"objective": objective[name], **_searched(searched), "holdout": None}
        if held_out is not None:
            size = {"vehicles": len(held_out.block), "frames": len(site.holdout), "blocks": held_out.blocks}
            verdict[name]["holdout"] = {**held_out.scores(), **size}
        if len(site.scenario.recordings) > 1:
            verdict[name]["recordings"] = _by_recording(site, searched, held_out)
        judging[name] = held_out or searched
    return verdict, judging


def _searched(compared: Comparison) -> dict[str, object]:
    """Scores on searched frames, on which no gain in the objective is told."""
    return {key: value for key, value in compared.scores().items() if key not in ("gain_over_baseline", "interval_90")}


def _by_recording(site: Site, searched: Comparison, held_out: Comparison | None) -> list[dict]:
    """What `judge` says of a mounting on each recording alone."""
    rows = []
    for number, settings in enumerate(site.scenario.recordings):
        scores = _searched(searched.of(searched.recording == number))
        row = {"name": settings.name, "weight": settings.weight, **scores, "holdout": None}
        if held_out is not None and held_out.weight[own := held_out.recording == number].sum():
            row["holdout"] = held_out.of(own).scores()
        rows.append(row)
    return rows


def judge_cross_fitted(
    site: Site,
    evaluator: Evaluator,
    layouts: Mapping[str, Layout],
    without_block: Sequence[Layout],
    tables: Mapping[str, Mapping[str, np.ndarray]],
) -> tuple[dict[str, dict], Comparison]:
    """Cross-fitting: every block of time judges a mounting that was chosen without it (Chernozhukov et al. 2018).

    Held-out blocks judge the answer, and each searched block the best of the mountings that were tried without it. So
    the figures are those of the way of choosing: the answer itself was chosen with more traffic.

    Parameters
    ----------
    layouts, tables : mapping
        The ``"optimised"`` layout and the ``"baseline"``, and their vehicle tables on both splits.
    without_block : sequence of Layout, b
        What is best without each searched block, in their order.

    Returns
    -------
    dict
        For both names what `judge` has as ``holdout``, of all boxes that judge.
    Comparison
        Of all boxes that judge.
    """
    plan, seed, base = site.plan, site.scenario.search.seed, tables[BASELINE_NAME]
    distinct = list(dict.fromkeys(without_block))
    own = np.array([distinct.index(one) for one in without_block])
    of_frame = own[np.unique(plan.search_block, return_inverse=True)[1]]
    chosen = vehicle_tables(distinct, search=evaluator)
    frame = np.searchsorted(plan.search, chosen[0]["frame"])
    rows, held = (of_frame[frame], np.arange(len(frame))), tables["optimised"]["split"] == "holdout"
    after = {
        key: np.concatenate([np.stack([one[key] for one in chosen])[rows], values[held]])
        for key, values in tables["optimised"].items()
    }
    block = np.concatenate([plan.search_block, plan.search_block.max() + 1 + plan.holdout_block])
    recording = np.concatenate([plan.search_recording, plan.holdout_recording])
    in_held = len(plan.search) + np.searchsorted(plan.holdout, tables["optimised"]["frame"][held])
    of_box = np.concatenate([frame, in_held])
    where = block[of_box], recording[of_box], site.scoring, seed
    compared, same = Comparison(base, after, *where), Comparison(base, base, *where)
    size = {"vehicles": len(of_box), "frames": len(block), "blocks": compared.blocks}
    hung = _hung_cross_fitted(site, evaluator, layouts, distinct, of_frame[frame], compared)
    return {
        name: {**one.scores(), **size, "as_hung": hung[name]}
        for name, one in (("optimised", compared), (BASELINE_NAME, same))
    }, compared


def _hung_cross_fitted(
    site: Site,
    evaluator: Evaluator,
    layouts: Mapping[str, Layout],
    distinct: Sequence[Layout],
    of_box: np.ndarray,
    boxes: Comparison,
) -> dict[str, dict]:
    """The same as hung: of each searched box the layout of `distinct` (n,) that judges it, then the held-out boxes."""
    before, chosen = _hung(site, evaluator, {BASELINE_NAME: layouts[BASELINE_NAME], **dict(enumerate(distinct))})
    after = HungScores.chosen(list(chosen.values()), of_box)
    if evaluator.held_out.weight.sum():
        held_before, held = _hung(site, evaluator.held_out, layouts)
        before, after = HungScores.joined([before, held_before]), HungScores.joined([after, held["optimised"]])
    base, found = judge_as_hung(boxes, before, after)
    found["two_wheelers"] = two_wheelers_as_hung(boxes, before, after)
    return {BASELINE_NAME: base, "optimised": found}


def figures_as_hung(
    site: Site,
    evaluator: Evaluator,
    layouts: Mapping[str, Layout],
    of_maps: Mapping[str, Layout],
    boxes: Comparison,
) -> tuple[dict[str, dict], dict[str, float]]:
    """Figures as hung on the frames that judge, and gains in the objective over the baseline, each by name.

    Figures are those of `judge_as_hung`, of the baseline and the answer; gains are of the answer and of the maps' best.
    """
    _, judging = evaluator.judging
    before, found = _hung(site, judging, layouts)
    base, figures = judge_as_hung(boxes, before, found["optimised"])
    figures["two_wheelers"] = two_wheelers_as_hung(boxes, before, found["optimised"])
    gains = {"optimised": figures["objective_gain"]}
    best = hung_scores(site.scenario, judging, list(of_maps.values()), singles=False) if of_maps else []
    for name, one in zip(of_maps, best, strict=True):
        gains[name] = boxes.with_scores(before.mean, one.mean).objective()["gain"]
    return {BASELINE_NAME: base, "optimised": figures}, gains


def _hung(site: Site, judging: Evaluator, layouts: Mapping[str, Layout]) -> tuple[HungScores, dict[str, HungScores]]:
    """Scores as hung of the baseline, and of the others by name."""
    scenario, shaken = site.scenario, not site.scenario.baseline_hangs
    others = {name: plan for name, plan in layouts.items() if name != BASELINE_NAME}
    (before,) = hung_scores(scenario, judging, [layouts[BASELINE_NAME]], shaken=shaken, singles=False)
    return before, dict(zip(others, hung_scores(scenario, judging, list(others.values())), strict=True))


# --- Candidate places, all on the same frames ------------------------------------------------------------------------


def rank_places(
    site: Site, evaluator: Evaluator, spaces: Sequence[SearchSpace], plans: Sequence[Layout]
) -> tuple[list[dict], int]:
    """The best mountings of candidate poles side by side, the best on the searched frames first.

    Parameters
    ----------
    spaces : sequence of SearchSpace, k
        One for each pole.
    plans : sequence of Layout, k
        What was found on each.

    Returns
    -------
    rows : list of dict, k
        Of each pole its table's values, ``deployment``, ``height_on_pole_m`` above its foot, scores as planned on the
        searched frames and in ``holdout``, ``objective_per_vehicle_as_hung``, by which they are ranked, and in
        ``holdout`` ``as_hung``: the detectable share, and of the objective per vehicle ``difference_to_best``, its
        ``interval_90``, which hold for all poles together (see `many_to_one_reach_90`), and whether that leaves nought
        out, ``differs``, by more than what breaks ties. ``holdout`` is None where nothing was held out, the interval
        and ``differs`` where there are too few blocks, and for the best.
    best : int
        Which of the poles is the first row.
    """
    searched, hung = evaluator.totals(plans), HungObjective(site, evaluator)(plans)
    order = np.argsort(-hung, kind="stable")
    held_out = _places_held_out(site, evaluator.held_out, [plans[row] for row in order])
    rows = []
    for rank, number in enumerate(order.tolist()):
        (place,), (mounting,) = spaces[number].places, plans[number]
        pole = place.pole
        rows.append(
            {
                "rank": rank + 1,
                "name": pole.name,
                "foot_z_m": pole.foot_z_m,
                "cost": pole.cost,
                "existing": pole.existing,
                "deployment": mounting.as_table(),
                "height_on_pole_m": mounting.height_m - pole.foot_z_m,
                "objective_per_vehicle": float(searched.per_vehicle()[number]),
                "detectable_share": float(searched.detectable_share()[number]),
                "objective_per_vehicle_as_hung": float(hung[number] / evaluator.weight.sum()),
                "holdout": None if held_out is None else held_out[rank],
            }
        )
    return rows, int(order[0])


_OF_A_PLACE = "objective_per_vehicle", "detectable_share", "detectable_share_interval_90"


def _places_held_out(site: Site, judging: Evaluator, plans: Sequence[Layout]) -> list[dict] | None:
    """What `rank_places` says of each plan on held-out frames, beside the first of them."""
    if not judging.weight.sum():
        return None
    seed = site.scenario.search.seed
    tables, hung = vehicle_tables(plans, holdout=judging), hung_scores(site.scenario, judging, plans, singles=False)
    compared = [Comparison.of_split(tables[0], table, "holdout", site, seed) for table in tables]
    reach = compared[0].reach_90("objective", [one.mean for one in hung])
    ties, found = 2.0 * TIE_BREAKER if metric_named(site.scoring.metric).of_share else 0.0, []
    for rank, (planned, one) in enumerate(zip(compared, hung, strict=True)):
        less = planned.with_scores(hung[0].mean, one.mean).objective()["gain"]
        off = None if reach is None or not rank else float(reach[rank])
        _, figures = judge_as_hung(planned, hung[0], one)
        scores = planned.scores()
        found.append(
            {
                **{key: scores[key] for key in _OF_A_PLACE},
                "as_hung": {key: figures[key] for key in ("detectable_share", "interval_90", "nine_of_ten")},
                "difference_to_best": less,
                "interval_90": None if off is None else [less - off, less + off],
                "differs": None if off is None else bool(abs(less) > off + ties),
            }
        )
    return found


# --- The objective over height and tilt: a picture of the whole landscape, and how certain its top is -----

AXES = ("height_m", "tilt_x_deg")
POINTS = (11, 26)  # a quarter metre by 1 degree over the paper's ranges: enough to see the landscape


@dataclass(frozen=True, slots=True, eq=False)
class ScoreMap:
    """The objective on a grid of heights and tilts, or leans, the other coordinates fixed.

    Attributes
    ----------
    height_m : ndarray, (h,)
    tilt_deg : ndarray, (t,)
    per_vehicle : ndarray, (h, t)
        Objective per vehicle, in the metric's unit.
    detectable_share : ndarray, (h, t)
    block_objective : ndarray, (h, t, b)
        Objective summed over each block of time that has vehicles.
    block_vehicles : ndarray, (b,)
        Vehicles of each block, or the sum of their weights.
    tilt : str
        The coordinate that `tilt_deg` is: the tilt across the road, or the lean.
    block_recording : ndarray, (b,), or None
        Recording of each block, counted from 0; None where there is one.
    """

    height_m: np.ndarray
    tilt_deg: np.ndarray
    per_vehicle: np.ndarray
    detectable_share: np.ndarray
    block_objective: np.ndarray
    block_vehicles: np.ndarray
    tilt: str = AXES[1]
    block_recording: np.ndarray | None = None

    @property
    def axes(self) -> tuple[str, str]:
        """The coordinates that the grid spans."""
        return AXES[0], self.tilt

    @property
    def best(self) -> tuple[float, float, float]:
        """Height [m], tilt [deg] and objective per vehicle of the best grid point."""
        row, column = np.unravel_index(np.argmax(self.per_vehicle), self.per_vehicle.shape)
        return float(self.height_m[row]), float(self.tilt_deg[column]), float(self.per_vehicle[row, column])

    def best_under(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Height [m] and tilt [deg] of the best grid point, (r,) each, with each block counted `weights` (r, b) times.

        Every row of the weights must leave some vehicles.
        """
        objective = self.block_objective.reshape(-1, len(self.block_vehicles))
        values = weights @ objective.T / (weights @ self.block_vehicles)[:, None]
        row, column = np.unravel_index(np.argmax(values, axis=1), self.per_vehicle.shape)
        return self.height_m[row], self.tilt_deg[column]

    def optimum_intervals_90(self, seed: int) -> dict[str, tuple[float, float]] | None:
        """90 % intervals of the best height and tilt under block resampling; None for too few blocks."""
        if (drawn := drawn_blocks(self.block_vehicles, seed, self.block_recording)) is None:
            return None
        resampled = self.best_under(drawn[1])
        return {axis: interval_90(values) for axis, values in zip(self.axes, resampled, strict=True)}


def with_coordinates(space: SearchSpace, x: Sequence[float], **changes: float) -> list[float]:
    """A point of a search space with some of its searched coordinates changed."""
    return [changes.get(key, value) for key, value in zip(space.variables, x, strict=True)]


def map_scores(
    evaluator: Evaluator,
    space: SearchSpace,
    optimum: Sequence[float],
    block: np.ndarray,
    progress: Callable[[int], None] = lambda points: None,
    grid: tuple[int, int] = POINTS,
    recording: np.ndarray | None = None,
) -> ScoreMap | None:
    """Score a grid over the searched heights and tilts through the `optimum`; None unless both are searched.

    Parameters
    ----------
    evaluator : Evaluator
        What scores.
    space : SearchSpace
        Bounds of both axes.
    optimum : sequence of float, (d,)
        The point that was found, which fixes the other coordinates.
    block : ndarray of int, (f,)
        Block of time of each of the evaluator's frames.
    progress : callable
        Called with the number of grid points that have been scored since the last call.
    grid : (int, int)
        Number of heights and of tilts.
    recording : ndarray of int, (f,), optional
        Recording of each frame, where there are several.
    """
    axes, bounds = space.axes, space.places[0].bounds
    if not all(axis in bounds for axis in axes):
        return None
    height, tilt = (np.linspace(*bounds[axis], points) for axis, points in zip(axes, grid, strict=True))
    parts = []
    for h in height.tolist():
        points = (with_coordinates(space, optimum, **dict(zip(axes, (h, t), strict=True))) for t in tilt.tolist())
        parts.append(evaluator.totals([space.layout(x) for x in points]))
        progress(len(tilt))
    objective, detectable, *_ = zip(*parts, strict=True)
    totals = parts[0]._replace(objective=np.concatenate(objective), detectable=np.concatenate(detectable))
    block_vehicles = block_sums(totals.weight, block)
    filled = block_vehicles > 0  # an empty block prefers no mounting
    return ScoreMap(
        height_m=height,
        tilt_deg=tilt,
        per_vehicle=totals.per_vehicle().reshape(grid),
        detectable_share=totals.detectable_share().reshape(grid),
        block_objective=block_sums(totals.objective, block)[:, filled].reshape(*grid, -1),
        block_vehicles=block_vehicles[filled],
        tilt=axes[1],
        block_recording=None if recording is None else of_blocks(recording, block)[filled],
    )


def map_verdict(
    score_map: ScoreMap,
    hung: Mapping[str, float],
    searched: Mapping[str, float],
    gains: Mapping[str, float] | None,
    seed: int,
) -> dict:
    """The score map in numbers, regret of the search among them; shares of the gain are None without a gain.

    Parameters
    ----------
    hung : mapping of str to float
        Objective per vehicle as hung, on the searched frames: of the ``"optimised"`` mounting, of the ``"baseline"``
        and of the ``"best_of_map"``.
    searched : mapping of str to float
        That of the first two under the errors that the map is of.
    gains : mapping of str to float, or None
        Gains of the first and the last over the baseline on held-out frames, as hung; None where nothing was held out.
    seed : int
        For the resampling of blocks.
    """
    height, tilt, value = score_map.best
    base, reached = hung[BASELINE_NAME], hung["optimised"]
    best = max(hung["best_of_map"], reached)
    top, bottom = max(value, searched["optimised"]), searched[BASELINE_NAME]
    near_best = near_best_threshold(top, bottom, REGION_SHARE)
    intervals = score_map.optimum_intervals_90(seed)
    return {
        "points": list(score_map.per_vehicle.shape),
        "best": {"height_m": height, score_map.tilt: tilt, "objective_per_vehicle": value},
        "search_shortfall": (best - reached) / (best - base) if best > base else None,
        "holdout_regret": gains and _regret(gains["best_of_map"], gains["optimised"]),
        "optimum_interval_90": None if intervals is None else {key: list(pair) for key, pair in intervals.items()},
        "share_within_1_percent": float((score_map.per_vehicle >= near_best).mean()) if top > bottom else None,
    }


def near_best_threshold(best: float, baseline: float, share: float) -> float:
    """The least value within `share` of the gain ``best - baseline`` below the best; the best itself without a gain."""
    return best - share * max(best - baseline, 0.0)


def _regret(best: float, found: float) -> float | None:
    """Share of the gain of the map's best mounting that the found one lacks; below 0 if that is better."""
    return 1.0 - found / best if best > 0.0 else None
