"""A whole run: search the best mounting of a scene, or take one as given, judge it, and leave a folder of results."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import asdict, fields, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..metrics.catalogue import metric_named
from ..optimise import DePso, DePsoSettings, Hardened, Search, make_search
from ..optimise.hardened import Polish
from ..optimise.multi_fidelity import Asked, MultiFidelitySearch
from ..optimise.search import joined_history
from ..plugins import short_name
from ..scene.deployment import MOUNTING_OR_LEAN, Pole, SearchSpace
from ..scene.directions import pointing
from ..scene.mounting import Layout
from ..scene.provenance import versions
from ..scene.scenario import Scenario
from ..scene.settings import Tolerance
from ..scene.site import Site
from ..scoring.evaluation import Evaluator, site_evaluator
from ..scoring.fidelity import Fidelity, make_rungs
from ..statistics import FEW_BLOCKS, FEWEST_BLOCKS, best_intervals_90, best_without_block, block_sums, of_blocks
from ..traffic.frames import NOTHING_HELD_OUT
from .approach_files import write_approaches
from .assumptions import assumptions, site_name
from .folder import CHECKPOINT, HISTORY, HISTORY_NOMINAL, RUN_SCHEMA, RunFolder
from .layout_search import LayoutObjective, LayoutSearch, coordinates_of, layout_history, on_same_masts
from .layouts import judge_layout, pole_under
from .replay import Listener, Replay
from .tolerance import JUDGED_BASE, SEARCHED_BASE, best_over_tolerance, objective_over
from .vehicle_table import add_shares, vehicle_tables
from .verdict import (
    AXES,
    BASELINE_NAME,
    NOMINAL,
    ROBUST,
    ScoreMap,
    judge,
    judge_cross_fitted,
    judge_over_tolerance,
    map_scores,
    map_verdict,
    rank_places,
    with_coordinates,
)
from .what_if import next_metre, other_traffic

_BATCH = 100  # mountings of a record that are scored again together
_EQUAL = 1e-9  # of the objective: values nearer to one another differ by rounding
_POLISH = 60  # evaluations for each coordinate
AUTO = "auto"  # the [search] fidelity of a search over several fidelities


def optimise_site(site: Site, folder: RunFolder, listener: Listener, *, resume: bool = False) -> dict:
    """Search the best mounting, storing the search as it goes, and write the results.

    Parameters
    ----------
    site : Site
        The scene made ready.
    folder : RunFolder
        Where the results go; locked by the caller.
    listener : Listener
        Called as the run goes on.
    resume : bool
        Go on from what the folder holds. The result is the same as that of a run that was never stopped.

    Returns
    -------
    dict
        The content of result.json.

    Raises
    ------
    InputError
        When the folder holds a run with other settings.
    """
    started = time.perf_counter()
    spaces, pole = site.scenario.deployment.spaces, None
    replay = Replay(folder, site.identity, resume=resume)
    folder.write_scene(site.scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        if site.scenario.further_lidars:
            return _conclude(site, folder, evaluator, started, _search_layout(site, evaluator, replay, listener))
        every = [_search_space(site, space, evaluator, replay, listener) for space in spaces]
        rows, best = None, 0
        if site.scenario.deployment.poles:
            rows, best = rank_places(site, evaluator, spaces, [found.layouts["optimised"] for found in every])
            pole = spaces[best].places[0].pole
        others = sum(
            len(search.history) for found in every if found is not every[best] for search in found.searches[NOMINAL]
        )
        return _conclude(site, folder, evaluator, started, every[best], rows, pole, others)


class _Found(NamedTuple):
    """What the searches of one search space, or of a layout, have come to.

    Attributes
    ----------
    layouts : dict of str to Layout
        The answer, the baseline and, over a tolerance, the best that hangs as planned.
    searches : dict of str to searches
        Of mountings as planned and over the tolerance, one after the other.
    histories : dict of str to (rows, variables)
        Of both, as files have them.
    spaces : tuple of SearchSpace or None
        For each LiDAR what was searched, the others held; None where it was given.
    maps : tuple of (ScoreMap, Layout) or None
        For each LiDAR the score map and its best layout, the others held.
    spread : dict or None
        What several coordinates came to.
    polished : set of int
        For which LiDARs a point of their map is where the answer was found.
    without_block : sequence of Layout, b, or None
        The best without each searched block, where too little is held out.
    steps : sequence of Layout
        The layout with each number of its LiDARs.
    """

    layouts: Mapping[str, Layout]
    searches: Mapping[str, Sequence[Search | MultiFidelitySearch]]
    histories: Mapping[str, tuple[np.ndarray, Sequence[str]]] = MappingProxyType({})
    spaces: tuple[SearchSpace | None, ...] = (None,)
    maps: tuple[tuple[ScoreMap, Layout] | None, ...] = (None,)
    spread: Mapping | None = None
    polished: AbstractSet[int] = frozenset()
    without_block: Sequence[Layout] | None = None
    steps: Sequence[Layout] = ()


def _search_space(site: Site, space: SearchSpace, evaluator: Evaluator, replay: Replay, listener: Listener) -> _Found:
    """Search the best layout of a search space."""
    scenario, label = site.scenario, space.places[0].label
    tolerance, score_map = scenario.objective.tolerance, None
    objective, first = _SearchedObjective(site, space, evaluator), scenario.search.seed
    seeds = [_seeded(site, space, seed) for seed in range(first, first + scenario.search.seeds)]
    for search in seeds:
        replay.carry_out(search, objective, listener)
    best = max(seeds, key=lambda search: search.best_value)  # the first of equals
    if scenario.search.fidelity != AUTO:  # it takes many times what such a search does
        plan, progress = site.plan, listener.mapping
        recording = plan.search_recording
        score_map = map_scores(evaluator, space, best.best_x, plan.search_block, progress, recording=recording)
    polish = _polish(site, space, score_map, best, label)
    if polish is not None:
        replay.carry_out(polish, objective, listener)
    searches = {NOMINAL: [*seeds, *([] if polish is None else [polish])]}
    polished = polish is not None and polish.best_value > best.best_value
    answer = (polish if polished else best).best_x
    sharp = space.layout(answer)
    layouts = {"optimised": sharp, BASELINE_NAME: (scenario.baseline,)}
    spread = without_block = None
    if _cross_fits(site):
        tried, sums = objective.by_block(searches[NOMINAL])
        without_block = [space.layout(tried[row]) for row in best_without_block(sums)]
    if len(space.variables) > len(AXES) and scenario.search.fidelity != AUTO:
        spread = _spread(site, space, seeds, objective.by_block(searches[NOMINAL]), evaluator.weight, answer)
    if tolerance is not None:
        robust = fresh_search(scenario, space)
        robust.label = "search over the tolerance"
        replay.carry_out(robust, objective.over_tolerance, listener)
        plans = [space.layout(robust.best_x), sharp]
        layouts["optimised"] = best_over_tolerance(evaluator, plans, tolerance)
        layouts[NOMINAL], searches[ROBUST] = sharp, [robust]
    on_map = None if score_map is None else (score_map, space.layout(_on_map(space, score_map, best.best_x)))
    histories = {
        name: (joined_history([search.history for search in parts]), space.variables)
        for name, parts in searches.items()
    }
    return _Found(layouts, searches, histories, (space,), (on_map,), spread, {0} if polished else set(), without_block)


def _search_layout(site: Site, evaluator: Evaluator, replay: Replay, listener: Listener) -> _Found:
    """Search the best layout of several LiDARs."""
    scenario, _plan = site.scenario, site.plan
    use, tolerance, objective = scenario.search, scenario.objective.tolerance, LayoutObjective(site, evaluator)
    found = layout_search(site, objective, replay, listener)
    found.run()
    polished = set()
    maps = [_map_of(site, evaluator, found, number, listener) for number in range(len(found.places))]
    for number, on_map in enumerate(maps):
        if on_map is None:
            continue
        best = float(on_map[0].block_objective.sum(axis=-1).max())
        if best > found.value + _EQUAL * abs(found.value):
            space = found.space(number)
            start = _on_map(space, on_map[0], found.point(number))
            if found.accept(space, found.polish(space, start, f"{scenario.lidars[number].name}, polish")):
                polished.add(number)
    if polished:  # the others hang elsewhere now than when the maps were made
        maps = [_map_of(site, evaluator, found, number, listener) for number in range(len(found.places))]
    spaces = [None if place is None else found.space(number) for number, place in enumerate(found.places)]
    sharp, searches = tuple(found.layout), {NOMINAL: [search for _, search in found.searches]}
    layouts = {"optimised": sharp, BASELINE_NAME: scenario.baselines}
    histories = {NOMINAL: layout_history(found)}
    steps = [*found.steps[:-1], sharp]
    free = [number for number, place in enumerate(found.places) if place is not None and place.bounds]
    joint, without_block, spread = found.space(*free), None, None
    tried, sums = objective.tried(found.searches)
    if _cross_fits(site) and tried:
        without_block = [tried[row] for row in best_without_block(sums)]
    alike = [row for row, one in enumerate(tried) if on_same_masts(one, sharp, joint)]
    if free and alike:
        at = found.point(*free)
        spread = _spread(
            site, joint, [], (coordinates_of(joint, [tried[row] for row in alike]), sums[alike]), evaluator.weight, at
        )
    if tolerance is not None and free:
        robust = Polish(
            joint.lower,
            joint.upper,
            start=np.array(found.point(*free)),
            seed=use.seed,
            evaluations=min(_POLISH * len(joint.lower), use.particles * use.iterations),
            periodic=joint.periodic,
        )
        robust.label, robust.variables = "search over the tolerance", joint.variables
        replay.carry_out(robust, partial(_over_tolerance, evaluator, joint, tolerance), listener)
        layouts["optimised"] = best_over_tolerance(evaluator, [joint.layout(robust.best_x), sharp], tolerance)
        layouts[NOMINAL], searches[ROBUST] = sharp, [robust]
        histories[ROBUST] = robust.history, joint.variables
    return _Found(
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


def _over_tolerance(evaluator: Evaluator, space: SearchSpace, tolerance: Tolerance, x: np.ndarray) -> np.ndarray:
    """The objective over a tolerance at points of a space, (s,)."""
    return objective_over(evaluator, [space.layout(row) for row in x], tolerance)


def _cross_fits(site: Site) -> bool:
    """Whether too few blocks of time are held out, and those searched can judge as well."""
    scenario, plan = site.scenario, site.plan
    held_out = {int(one) for one, frame in zip(plan.holdout_block, site.holdout, strict=True) if frame.counted.any()}
    poles = any(len(lidar.deployment.places) > 1 for lidar in scenario.lidars)
    able = scenario.objective.tolerance is None and not poles and scenario.search.fidelity != AUTO
    return able and len(held_out) < FEW_BLOCKS and len(np.unique(plan.search_block)) >= FEWEST_BLOCKS


def _on_map(space: SearchSpace, score_map: ScoreMap, x: Sequence[float]) -> list[float]:
    """The best point of a score map, through a point `x` (d,) that fixes what the map does not span."""
    return with_coordinates(space, x, **dict(zip(score_map.axes, score_map.best, strict=False)))


def ended_search(site: Site, folder: RunFolder, note: Callable[[str], object]) -> dict | None:
    """The result of the search that has ended in a folder that a run goes on in; None where there is more to search.

    `note` is called where nothing is stored there to go on with.

    Raises
    ------
    InputError
        When the folder holds a run with other settings, or the evaluation of one mounting.
    """
    result = folder.read_result(site.identity)
    if result is not None and result.get("search") is None:
        raise InputError(f"--resume: {folder.path}: holds one mounting's evaluation, not a search; give another --out")
    if result is None and not folder.file(CHECKPOINT).exists():
        note(f"{folder.path}: nothing is stored there to go on with; the search starts from its beginning")
    return result


def evaluate_site(site: Site, folder: RunFolder, layout: Layout, pole: Pole | None = None) -> dict:
    """Score one layout; write and return the result.

    `pole` is the candidate pole that a single LiDAR hangs on, if it was named.
    """
    started = time.perf_counter()
    folder.write_scene(site.scenario)
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        layouts, none = {"optimised": layout, BASELINE_NAME: site.scenario.baselines}, (None,) * len(layout)
        return _conclude(site, folder, evaluator, started, _Found(layouts, {}, spaces=none, maps=none), pole=pole)


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
    use, block, variables = site.scenario.search, site.plan.search_block, len(space.variables)
    screened = min(use.particles * use.iterations, max(screening(variables), use.particles, 2**variables))
    weight = [float(frame.counted_weight.sum()) for frame in site.search]
    rungs = make_rungs(site.observation, block, weight, variables)
    screen = fresh_search(site.scenario, space, screened)
    return MultiFidelitySearch(screen, rungs, block, seed=use.seed)


def screening(variables: int) -> int:
    """Evaluations on the cheapest rung before halving begins."""
    return 20 + 40 * variables


def rung_costs(search: MultiFidelitySearch) -> list[dict[str, object]]:
    """What each rung has taken, for result.json: detail, stride, frames, candidates, casts of a frame, seconds."""
    fidelities = (rung.fidelity for rung in search.rungs)
    return [
        {"detail": fidelity.detail, "stride": fidelity.stride, **spent}
        for fidelity, spent in zip(fidelities, search.spent, strict=True)
    ]


_BELOW_M = 0.05  # of the road: what stands there may reach so far into it


def scenery_counts(site: Site) -> dict[str, object] | None:
    """How much scenery stands within reach, and how high; None where there is none but the road's own surface.

    ``objects``, ``triangles``, ``z_m`` from where to where [m], and the share of corners ``below_road``.
    """
    standing = site.observation.scenery
    if standing is None:
        return None
    beside = standing.scenery.beside_road
    if not len(beside) and not site.scenario.road_map.surface.is_flat:
        return None
    z = beside.corners[..., 2]
    heights = {"z_m": [float(z.min()), float(z.max())], "below_road": float((z < -_BELOW_M).mean())} if len(z) else {}
    return {"objects": len(np.unique(beside.owner)), "triangles": len(beside), **heights}


class _SearchedObjective:
    """The objective of mountings on the searched frames, and of those scored as planned the sums over each block."""

    def __init__(self, site: Site, space: SearchSpace, evaluator: Evaluator) -> None:
        self._site, self._space, self._evaluator = site, space, evaluator
        self._blocks: dict[bytes, np.ndarray] = {}

    def __call__(self, asked: np.ndarray | Asked) -> np.ndarray:
        """Of mountings as planned: (s,), or (s, frames) where a search over several fidelities asks."""
        if isinstance(asked, Asked):
            fidelity = None if asked.fidelity == Fidelity(self._site.observation.detail) else asked.fidelity
            layouts = [self._space.layout(row) for row in asked.x]
            return self._evaluator.totals(layouts, asked.frames, fidelity).objective
        objective = self._evaluator.totals([self._space.layout(row) for row in asked]).objective
        blocks = block_sums(objective, self._site.plan.search_block)
        self._blocks |= {row.tobytes(): sums for row, sums in zip(asked, blocks, strict=True)}
        return objective.sum(axis=1)

    def over_tolerance(self, x: np.ndarray) -> np.ndarray:
        """Over the scene's tolerance, (s,)."""
        return _over_tolerance(self._evaluator, self._space, self._site.scenario.objective.tolerance, x)

    def by_block(self, searches: Sequence[Search]) -> tuple[np.ndarray, np.ndarray]:
        """All mountings that were tried, (n, d), and their objective in each block, (n, b)."""
        x = np.concatenate([search.history[:, 3:-2] for search in searches])
        # Those of a run that this one goes on with.
        unknown = np.array([row.tobytes() not in self._blocks for row in x])
        for start in range(0, int(unknown.sum()), _BATCH):
            self(x[unknown][start : start + _BATCH])
        return x, np.array([self._blocks[row.tobytes()] for row in x])


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


def _conclude(
    site: Site,
    folder: RunFolder,
    evaluator: Evaluator,
    started: float,
    found: _Found,
    poles: Sequence[Mapping] | None = None,
    pole: Pole | None = None,
    others: int = 0,
) -> dict:
    """Judge the layouts and write all that a run leaves, last of all its result, which is returned.

    `poles` are all candidate places, ranked, of which `found` is the first, on its `pole`; `others` is how many
    evaluations were made on the others.
    """
    layouts, searches, spread, without_block = found.layouts, found.searches, found.spread, found.without_block
    scenario, metric, seed = site.scenario, metric_named(site.scoring.metric), site.scenario.search.seed
    for name, (history, variables) in zip((HISTORY, HISTORY_NOMINAL), reversed(found.histories.values()), strict=False):
        folder.write_history(name, history, variables)
    judged, names = dict(layouts), [lidar.name for lidar in scenario.lidars]
    for name, on_map in zip(names, found.maps, strict=True):
        if on_map is not None:
            folder.write_score_map(on_map[0], name if len(names) > 1 else "")
            judged[best_of_map(name)] = on_map[1]
    if poles is not None:
        folder.write_ranking(poles)
    splits = {"search": evaluator, "holdout": evaluator.held_out}
    tables = dict(zip(judged, vehicle_tables(list(judged.values()), **splits), strict=True))
    folder.write_vehicles(tables["optimised"], tables[BASELINE_NAME])
    verdict = judge(site, judged, evaluator, seed)
    groups = add_shares(site, verdict, tables, None if searches else seed)
    crossed = None
    if without_block is not None:
        crossed, boxes = judge_cross_fitted(site, evaluator, layouts, without_block, tables)
        groups = boxes.groups(site)
    evaluations = {name: sum(len(search.history) for search in parts) for name, parts in searches.items()}
    tolerance = scenario.objective.tolerance
    over_tolerance = (
        None
        if tolerance is None
        else {
            "settings": asdict(tolerance),
            "searched_errors": SEARCHED_BASE[tolerance.aim] ** 2 if searches else None,
            "judged_errors": JUDGED_BASE**2,
            "evaluations": evaluations or None,
            "robust": judge_over_tolerance(site, layouts, evaluator, seed),
            "sharp": {**_deployed(scenario, layouts[NOMINAL]), **verdict[NOMINAL]} if searches else None,
        }
    )
    lidars = _lidar_rows(site, evaluator, found, verdict)
    every = (search for parts in searches.values() for search in parts)
    rungs = [rung_costs(search) for search in every if isinstance(search, MultiFidelitySearch)]
    result = {
        "schema": RUN_SCHEMA,
        "scene": Path(scenario.source).name,
        "site": site_name(scenario),
        "sensor": sensors_text(site),
        "range_gate_m": scenario.range_gate_m,
        "region": scenario.as_tables()["region"],
        "imperfections": scenario.sensor.imperfections_as_table(),
        "scenery": scenery_counts(site),
        "caster": site.observation.caster,
        "detail": site.observation.detail,
        "metric": site.scoring.metric,
        "metric_unit": metric.unit,
        "metric_higher_is_better": metric.higher_is_better,
        "reading": scenario.objective.reading,
        "search": short_name(scenario.search.method) if searches else None,
        "seed": seed,
        "evaluations": (sum(evaluations.values()) or 1) + others,
        "fidelity": scenario.search.fidelity if searches else "full",
        "rungs": rungs[0] if rungs else None,
        "spread": spread,
        **({"pole": _pole_row(pole)} if len(lidars) == 1 else {}),
        "poles": None if poles is None else list(poles),
        "frames": len(site.search),
        "frame_ids": [int(frame) for frame in site.plan.search],
        "holdout_frame_ids": [int(frame) for frame in site.plan.holdout],
        "block_s": site.plan.block_s,
        "vehicles": int(evaluator.vehicles.sum()),
        **({key: value for key, value in lidars[0].items() if key != "name"} if len(lidars) == 1 else {}),
        "lidars": lidars,
        "layout": None
        if len(lidars) == 1
        else judge_layout(site, evaluator, layouts["optimised"], found.steps, searched=bool(searches)),
        **verdict["optimised"],
        "groups": groups,
        "baseline": {**_deployed(scenario, scenario.baselines), **verdict[BASELINE_NAME]},
        "cross_fitted": crossed,
        "tolerance": over_tolerance,
        "other_traffic": other_traffic(site, layouts["optimised"]),
        "assumptions": assumptions(site, tables["optimised"]),
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": [note for note in site.plan.notes if crossed is None or NOTHING_HELD_OUT not in note],
        "traffic_report": site.recording.report.as_dict(),
        "identity": site.identity,
        "seconds": round(time.perf_counter() - started, 3),
        "versions": versions(site.observation.caster),
    }
    write_approaches(folder, site, result)
    return folder.finish(result)


def sensors_text(site: Site) -> str:
    """The sensors of a site, such as "RS-16", or "2 x RS-16 and RS-32"."""
    names = [lidar.lattice.model.name for lidar in site.observation.lidars]
    counts = [(name, names.count(name)) for name in dict.fromkeys(names)]
    return " and ".join(name if count == 1 else f"{count} x {name}" for name, count in counts)


def _pole_row(pole: Pole | None) -> dict[str, object] | None:
    return None if pole is None else {"name": pole.name, "foot_z_m": pole.foot_z_m}


def _deployed(scenario: Scenario, layout: Layout) -> dict[str, object]:
    """Where a layout hangs: the one mounting, or that of each LiDAR by its name."""
    if len(layout) == 1:
        return {"deployment": layout[0].as_table()}
    named = zip(scenario.lidars, layout, strict=True)
    return {"deployments": {lidar.name: mounting.as_table() for lidar, mounting in named}}


def _lidar_rows(site: Site, evaluator: Evaluator, found: _Found, verdict: Mapping[str, dict]) -> list[dict]:
    """Of each LiDAR its sensor, where it hangs and points, what was searched, and its score map in numbers."""
    layout, seed, rows = found.layouts["optimised"], site.scenario.search.seed, []
    planned = NOMINAL if NOMINAL in found.layouts else "optimised"
    of_each = zip(site.each, layout, site.scenario.baselines, found.spaces, found.maps, strict=True)
    for number, (one, mounting, baseline, space, on_map) in enumerate(of_each):
        name, map_row = one.scenario.lidar_name, None
        if on_map is not None:
            scores = {**verdict, "best_of_map": verdict[best_of_map(name)]}
            map_row = {**map_verdict(on_map[0], scores, planned, seed), "polished": number in found.polished}
        row = {
            "name": name,
            "sensor": one.model.name,
            "range_gate_m": one.scenario.sensor.range_gate_m,
            "imperfections": one.scenario.sensor.imperfections_as_table(),
            "price": one.scenario.sensor.price,
            "map": map_row,
            "bounds": None if space is None else {key: list(ends) for key, ends in space.places[0].bounds.items()},
            "deployment": mounting.as_table(),
            "pointing": pointing(site, mounting),
            "next_metre": None if space is None else next_metre(site, evaluator, space, layout),
        }
        if len(layout) > 1:
            row["pole"] = _pole_row(pole_under(site, name, mounting))
            row["baseline"] = baseline.as_table()
        rows.append(row)
    return rows


def best_of_map(name: str) -> str:
    """What the best layout of a LiDAR's score map is called in a verdict."""
    return f"best_of_map {name}".rstrip()
