"""What the searches of a run come to: of one place with its score map, or of several LiDARs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import fields, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..optimise import DePso, DePsoSettings, Hardened, Search, make_search
from ..optimise.hardened import Polish
from ..optimise.multi_fidelity import MultiFidelitySearch, far_apart_best
from ..optimise.search import joined_history
from ..scene.deployment import MOUNTING_OR_LEAN, SearchSpace
from ..scene.mounting import Layout
from ..scene.scenario import Scenario
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..scoring.fidelity import screened_with
from ..statistics import FEW_BLOCKS, FEWEST_BLOCKS, best_intervals_90, best_without_block, block_sums, of_blocks
from .as_hung import HungObjective, searching
from .layout_search import LayoutObjective, LayoutSearch, coordinates_of, layout_history, on_same_masts
from .replay import Listener, Replay
from .verdict import (
    AXES,
    BASELINE_NAME,
    POINTS,
    ScoreMap,
    map_scores,
    with_coordinates,
)

_EQUAL = 1e-9  # of the objective: values nearer to one another differ by rounding
_POLISH = 60  # evaluations for each coordinate
_CANDIDATES, _CANDIDATES_AUTO = 10, 4  # that are compared under more installation errors
_POLISH_HUNG = 12  # evaluations for each coordinate, under these
_APART = 0.04  # of the box, in one coordinate at least: nearer ones are polished into one another
AUTO = "auto"  # the [search] fidelity of a search over several fidelities


class SearchOutcome(NamedTuple):
    """What the searches of one search space, or of a layout, have come to.

    Attributes
    ----------
    layouts : dict of str to Layout
        The answer and the baseline.
    searches : sequence of searches
        In the order in which they were carried out; the last is under more installation errors, if there are any.
    histories : sequence of (rows, variables)
        As files have them: of what found the answer, and where that had candidates from a search, of that.
    spaces : tuple of SearchSpace or None
        For each LiDAR what was searched, the others held; None where it was given.
    maps : tuple of (ScoreMap, Layout) or None
        For each LiDAR the score map and its best layout, the others held.
    spread : dict or None
        What several coordinates came to.
    polished : set of int
        For which LiDARs a point of their map is where the search went on from.
    without_block : sequence of Layout, b, or None
        The best without each searched block, where too little is held out.
    steps : sequence of Layout
        The layout with each number of its LiDARs.
    """

    layouts: Mapping[str, Layout]
    searches: Sequence[Search | MultiFidelitySearch] = ()
    histories: Sequence[tuple[np.ndarray, Sequence[str]]] = ()
    spaces: tuple[SearchSpace | None, ...] = (None,)
    maps: tuple[tuple[ScoreMap, Layout] | None, ...] = (None,)
    spread: Mapping | None = None
    polished: AbstractSet[int] = frozenset()
    without_block: Sequence[Layout] | None = None
    steps: Sequence[Layout] = ()

    @property
    def evaluations(self) -> int:
        """Mountings that the searches have scored."""
        return sum(len(search.history) for search in self.searches)


def search_place(
    site: Site, space: SearchSpace, evaluator: Evaluator, replay: Replay, listener: Listener
) -> SearchOutcome:
    """Search the best layout of a search space."""
    scenario, label, score_map = site.scenario, space.places[0].label, None
    searched = searching(site, evaluator)
    objective, first = LayoutObjective(site, searched), scenario.search.seed
    score = partial(objective.of_points, space)
    seeds = [_seeded(site, space, seed) for seed in range(first, first + scenario.search.seeds)]
    for search in seeds:
        replay.carry_out(search, score, listener)
    best = max(seeds, key=lambda search: search.best_value)  # the first of equals
    if scenario.search.fidelity != AUTO:  # it takes many times what such a search does
        plan, progress = site.plan, listener.mapping
        recording = plan.search_recording
        score_map = map_scores(searched, space, best.best_x, plan.search_block, progress, recording=recording)
    polish = _polish(site, space, score_map, best, label)
    if polish is not None:
        replay.carry_out(polish, score, listener)
    searches = [*seeds, *([] if polish is None else [polish])]
    polished = polish is not None and polish.best_value > best.best_value
    answer = (polish if polished else best).best_x
    spread = without_block = None
    spreads = len(space.variables) > len(AXES) and scenario.search.fidelity != AUTO
    if spreads or _cross_fits(site):
        tried, sums = objective.tried([(space, search) for search in searches])
    if _cross_fits(site):
        without_block = [tried[row] for row in best_without_block(sums)]
    histories = [(joined_history([search.history for search in searches]), space.variables)]
    x = np.concatenate([search.history[:, 3:-2] for search in searches])
    if not scenario.is_exact:
        values = np.concatenate([search.history[:, -2] for search in searches])
        hung = _final_search(site, space, evaluator, (x, values), score_map, label, replay, listener)
        searches, answer = [*searches, hung], hung.best_x
        histories.insert(0, (hung.history, space.variables))
    if spreads:
        spread = _spread(site, space, seeds, (x, sums), evaluator.weight, answer)
    layouts = {"optimised": space.layout(answer), BASELINE_NAME: scenario.baselines}
    on_map = None if score_map is None else (score_map, space.layout(_on_map(space, score_map, best.best_x)))
    return SearchOutcome(
        layouts, searches, histories, (space,), (on_map,), spread, {0} if polished else set(), without_block
    )


def _final_search(
    site: Site,
    space: SearchSpace,
    evaluator: Evaluator,
    tried: tuple[np.ndarray, np.ndarray],
    score_map: ScoreMap | None,
    label: str,
    replay: Replay,
    listener: Listener,
) -> Polish:
    """The last stage: the best few mountings that lie far apart, under more installation errors, and the best polished.

    They are the best that were `tried`, x (n, d) and their objective (n,), and of the map.
    """
    x, values = tried
    if score_map is not None:
        on_grid = _grid_points(space, score_map, x[int(np.argmax(values))])
        x = np.concatenate([x, on_grid])
        values = np.concatenate([values, score_map.block_objective.sum(axis=-1).ravel()])
    most, polish = _final_budget(site.scenario, space)
    lower, upper, periodic = (np.array(one) for one in (space.lower, space.upper, space.periodic))
    starts = x[far_apart_best((x - lower) / (upper - lower), values, _APART, most, periodic)]
    final = Polish(
        space.lower,
        space.upper,
        start=starts,
        seed=site.scenario.search.seed,
        evaluations=len(starts) + polish,
        step=_APART / 2.0,
        periodic=space.periodic,
    )
    final.label, final.is_final = ", ".join(filter(None, [label, "under more installation errors"])), True
    final.variables, objective = space.variables, HungObjective(site, evaluator)
    replay.carry_out(final, lambda x: objective([space.layout(row) for row in x]), listener)
    return final


def _final_budget(scenario: Scenario, space: SearchSpace) -> tuple[int, int]:
    """How many mountings the last stage compares at most, and evaluations with which it polishes the best.

    After a search over several fidelities, which is there to be fast, they are fewer and nothing is polished.
    """
    if scenario.search.fidelity == AUTO:
        return _CANDIDATES_AUTO, 0
    return _CANDIDATES, _POLISH_HUNG * len(space.variables)


def most_evaluations(scenario: Scenario, space: SearchSpace) -> int:
    """How many mountings a search of one place scores at most, its map and its last stage among them."""
    use = scenario.search
    on_map = math.prod(POINTS) if all(axis in space.variables for axis in space.axes) else 0
    return (
        use.seeds * use.particles * use.iterations
        + on_map
        + (0 if scenario.is_exact else sum(_final_budget(scenario, space)))
    )


def _grid_points(space: SearchSpace, score_map: ScoreMap, x: Sequence[float]) -> np.ndarray:
    """All points of a score map, row by row, through a point `x` (d,), (h * t, d)."""
    axes = score_map.axes
    pairs = ((h, t) for h in score_map.height_m.tolist() for t in score_map.tilt_deg.tolist())
    return np.array([with_coordinates(space, x, **dict(zip(axes, pair, strict=True))) for pair in pairs])


def search_layout(site: Site, evaluator: Evaluator, replay: Replay, listener: Listener) -> SearchOutcome:
    """Search the best layout of several LiDARs."""
    scenario, searched = site.scenario, searching(site, evaluator)
    objective = LayoutObjective(site, searched)
    found = layout_search(site, objective, replay, listener)
    found.run()
    polished = set()
    maps = [_map_of(site, searched, found, number, listener) for number in range(len(found.places))]
    for number, on_map in enumerate(maps):
        if on_map is None:
            continue
        best = float(on_map[0].block_objective.sum(axis=-1).max())
        if best > found.value + _EQUAL * abs(found.value):
            space = found.space(number)
            start = _on_map(space, on_map[0], found.point(number))
            if found.accept(space, found.polish(space, start, f"{scenario.lidars[number].name}, polish")):
                polished.add(number)
    searches, histories = [search for _, search in found.searches], [layout_history(found)]
    free = [number for number, place in enumerate(found.places) if place is not None and place.bounds]
    joint, without_block, spread = found.space(*free), None, None
    tried, sums = objective.tried(found.searches)
    if _cross_fits(site) and tried:
        without_block = [tried[row] for row in best_without_block(sums)]
    alike = [row for row, one in enumerate(tried) if on_same_masts(one, tuple(found.layout), joint)]
    x = coordinates_of(joint, [tried[row] for row in alike]) if free and alike else None
    if free and not scenario.is_exact:
        known = (np.array([found.point(*free)]), np.array([found.value])) if x is None else (x, sums[alike].sum(axis=1))
        hung = _final_search(site, joint, evaluator, known, None, "", replay, listener)
        found.layout = list(joint.layout(hung.best_x))
        searches.append(hung)
        histories.insert(0, (hung.history, joint.variables))
    if polished or len(histories) > 1:  # the others hang elsewhere now than when the maps were made
        maps = [_map_of(site, searched, found, number, listener) for number in range(len(found.places))]
    spaces = [None if place is None else found.space(number) for number, place in enumerate(found.places)]
    answer = tuple(found.layout)
    layouts = {"optimised": answer, BASELINE_NAME: scenario.baselines}
    steps = [*found.steps[:-1], answer]
    if x is not None:
        spread = _spread(site, joint, [], (x, sums[alike]), evaluator.weight, found.point(*free))
    return SearchOutcome(
        layouts, searches, histories, tuple(spaces), tuple(maps), spread, polished, without_block, tuple(steps)
    )


def _map_of(
    site: Site, evaluator: Evaluator, found: LayoutSearch, number: int, listener: Listener
) -> tuple[ScoreMap, Layout] | None:
    """The score map of one LiDAR, the others held where they hang, and its best layout; None where it has none."""
    place, plan = found.places[number], site.plan
    if place is None or not place.bounds:
        return None
    space, point = found.space(number), found.point(number)
    progress, of = listener.mapping, plan.search_recording
    score_map = map_scores(evaluator, space, point, plan.search_block, progress, recording=of)
    return None if score_map is None else (score_map, space.layout(_on_map(space, score_map, point)))


def layout_search(site: Site, objective: LayoutObjective, replay: Replay, listener: Listener) -> LayoutSearch:
    """The search of a scene's layout, before it is carried out: each LiDAR by the scene's own method."""
    scenario, use = site.scenario, site.scenario.search

    def make(space: SearchSpace, budget: int, seed: int) -> Search:
        return fresh_search(replace(scenario, search=replace(use, seed=seed)), space, budget)

    return LayoutSearch(site, objective, replay, listener, make, use.particles * use.iterations)


def _cross_fits(site: Site) -> bool:
    """Whether too few blocks of time are held out, and those searched can judge as well."""
    scenario, plan = site.scenario, site.plan
    held_out = {int(one) for one, frame in zip(plan.holdout_block, site.holdout, strict=True) if frame.counted.any()}
    poles = any(len(lidar.deployment.places) > 1 for lidar in scenario.lidars)
    able = not poles and scenario.search.fidelity != AUTO
    return able and len(held_out) < FEW_BLOCKS and len(np.unique(plan.search_block)) >= FEWEST_BLOCKS


def _on_map(space: SearchSpace, score_map: ScoreMap, x: Sequence[float]) -> list[float]:
    """The best point of a score map, through a point `x` (d,) that fixes what the map does not span."""
    return with_coordinates(space, x, **dict(zip(score_map.axes, score_map.best, strict=False)))


def fresh_search(scenario: Scenario, space: SearchSpace, evaluations: int | None = None) -> Search:
    """The search that a scene asks for, before its first evaluation; with another budget where one is given."""
    use = scenario.search
    settings: dict[str, object] = {}
    if use.method == DePso.name:
        own = {field.name for field in fields(DePsoSettings)} - {"iterations", "reading"}
        settings = {key: getattr(use, key) for key in own} | {"reading": scenario.objective.reading}
    elif use.method == Hardened.name:
        settings = {"particles": use.particles}
    settings |= {"seed": use.seed, "evaluations": evaluations or use.particles * use.iterations}
    return make_search(use.method, space.lower, space.upper, periodic=space.periodic, **settings)


def fresh_auto_search(site: Site, space: SearchSpace) -> MultiFidelitySearch:
    """The search of `[search] fidelity = "auto"`, before its first evaluation: the scene's own method screens."""
    use, variables = site.scenario.search, len(space.variables)
    screened = min(use.particles * use.iterations, max(screening(variables), use.particles, 2**variables))
    weight = [float(frame.counted_weight.sum()) for frame in site.search]
    screen = fresh_search(site.scenario, space, screened)
    return MultiFidelitySearch(screen, *screened_with(site.observation, weight), seed=use.seed)


def screening(variables: int) -> int:
    """Evaluations at the coarse fidelity, before a climb begins at the full one."""
    return 20 + 40 * variables


def _seeded(site: Site, space: SearchSpace, seed: int) -> Search | MultiFidelitySearch:
    """The search of a seed, before its first evaluation."""
    use, label = site.scenario.search, space.places[0].label
    scenario = replace(site.scenario, search=replace(use, seed=seed))
    search = fresh_auto_search(site, space) if use.fidelity == AUTO else fresh_search(scenario, space)
    if use.seeds > 1 or label:
        search.label = ", ".join(filter(None, [label, f"seed {seed}" if use.seeds > 1 else ""]))
        search.variables = tuple(MOUNTING_OR_LEAN[key].option.removeprefix("--") for key in space.variables)
    return search


def _polish(
    site: Site, space: SearchSpace, score_map: ScoreMap | None, search: Search | MultiFidelitySearch, label: str
) -> Polish | None:
    """The local search from a point of the map that beats what the hardened search has found; None without one."""
    use = site.scenario.search
    if score_map is None or use.method != Hardened.name:
        return None
    reached = float(score_map.block_objective.sum(axis=-1).max())
    if reached - search.best_value <= _EQUAL * abs(reached):
        return None
    start = np.array(_on_map(space, score_map, search.best_x.tolist()))
    budget = min(_POLISH * len(start), use.particles * use.iterations)
    polish = Polish(space.lower, space.upper, start=start, seed=use.seed, evaluations=budget, periodic=space.periodic)
    polish.label, polish.variables = ", ".join(filter(None, [label, polish.label])), search.variables
    return polish


def _spread(
    site: Site,
    space: SearchSpace,
    seeds: Sequence[Search],
    tried: tuple[np.ndarray, np.ndarray],
    weight: np.ndarray,
    answer: np.ndarray,
) -> dict:
    """How far apart the answers of several seeds lie, and between what coordinates other traffic would put the best."""
    answers = [
        {
            "seed": site.scenario.search.seed + number,
            "deployment": space.layout(search.best_x)[0].as_table(),
            "objective_per_vehicle": search.best_value / float(weight.sum()),
        }
        for number, search in enumerate(seeds)
    ]
    plan, seed = site.plan, site.scenario.search.seed
    weights, strata = block_sums(weight, plan.search_block), of_blocks(plan.search_recording, plan.search_block)
    intervals = best_intervals_90(*tried, weights, answer, space.periodic, seed, strata)
    return {
        "searched": list(space.variables),
        "seeds": answers,
        "mountings": len(tried[0]),
        "optimum_interval_90": None
        if intervals is None
        else {key: list(pair) for key, pair in zip(space.variables, intervals, strict=True)},
    }
