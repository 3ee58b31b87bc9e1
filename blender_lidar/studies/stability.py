"""The study of a scene's stability: where its answer holds and where it breaks.

Stage by stage the traffic, the sensor, the metric, the installation and the seeds of the search are varied, and of each
change it is asked what the mounting in question loses to the best one under that change. The result is one dictionary;
`findings` turns numbers into verdicts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from ..metrics.catalogue import METRICS, metric_named
from ..optimise import Search
from ..optimise.multi_fidelity import MultiFidelitySearch
from ..plugins import short_name
from ..run.replay import Replay
from ..run.searches import fresh_search, most_evaluations, search_layout, search_place
from ..run.what_if import mixes
from ..scene.installation import installed_layout, limit_errors, orthogonal_errors
from ..scene.mounting import Layout
from ..scene.scenario import Scenario
from ..scene.site import Site
from ..scoring.evaluation import site_evaluator
from ..scoring.fidelity import with_fewer_frames
from ..statistics import FEWEST_BLOCKS, block_sums
from .candidates import (
    BASELINE,
    FIRST,
    Candidates,
    grid_candidates,
    higher_mountings,
    joint_space,
    on_other_side,
)
from .driver import (
    AS_IT_IS,
    HELD_OUT,
    SEARCHED,
    Job,
    StudyFolder,
    Variation,
    split_of,
    study_head,
)
from .findings import (
    RIVAL,
    SHARE_LIMITS,
    ChangeDraw,
    Finding,
    Judges,
    beside,
    best_row,
    by_name,
    change_finding,
    chooses,
    cross_fitted,
    gain_finding,
    installation_findings,
    likely_rivals,
    optimum_finding,
    repair_finding,
    search_finding,
)
from .variations import MOUNTING, SECTIONS, TRAFFIC, metric_variations, sensor_variations, traffic_variations

STABILITY_SCHEMA = 5  # of the stages and of the result
_ERRORS_BASE = 11  # its square is how many installation errors stand for all


@dataclass(frozen=True, slots=True)
class StabilityEffort:
    """How much of everything is done.

    Attributes
    ----------
    frames : int or None
        Frames that searches look at, spread evenly over the searched ones; None takes them all.
    varied_frames : int
        Those on which the best mounting of each variation is looked for, or all where there are fewer.
    heights, tilts : int
        Points of the grid of mountings on which each variation's optimum is looked for.
    fine_tilts : int
        Tilts of the grid for the scene as it is, whose optimum is resampled.
    seeds : int
        Seeds of the search.
    budget : float
        Share of the scene's evaluations that each of these searches gets.
    draws : int
        Units of a sensor, seeds of its noise, draws of other traffic.
    quick : bool
        Whether this is the quick study, for what knows only that.
    """

    frames: int | None
    varied_frames: int
    heights: int
    tilts: int
    fine_tilts: int
    seeds: int
    budget: float
    draws: int
    quick: bool


FULL_STABILITY = StabilityEffort(
    None, 15, heights=6, tilts=26, fine_tilts=51, seeds=11, budget=1.0, draws=8, quick=False
)
QUICK_STABILITY = StabilityEffort(8, 8, heights=4, tilts=26, fine_tilts=51, seeds=3, budget=0.3, draws=2, quick=True)


def study_identity(
    site: Site, effort: StabilityEffort, layout: Layout | None, rivals: Sequence[str] = ()
) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"study {name}": value for name, value in asdict(effort).items()}
    limits = {"study losses": [*SHARE_LIMITS], "study schema": STABILITY_SCHEMA}
    given = {"study mounting": layout and _told(site.scenario, layout), "study rivals": [*rivals]}
    return {**site.identity, **asked, **limits, **given}


def study_stability(
    site: Site,
    effort: StabilityEffort,
    folder: StudyFolder,
    layout: Layout | None = None,
    rivals: Sequence[str] = (),
) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    site : Site
        The scene, made ready.
    effort : StabilityEffort
    folder : StudyFolder
        Locked by the caller.
    layout : Layout, optional
        The mounting in question, or those of a layout; what `optimise` answers if left out.
    rivals : sequence of str
        Metrics of plug-ins that may choose in the place of the scene's, as those of the catalogue do.

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    scene, judging, seed = site.scenario, _judging_split(site), site.scenario.search.seed
    whole = with_fewer_frames(site, effort.frames)
    few = with_fewer_frames(whole, effort.varied_frames)
    answers = _answers(folder, whole, effort)
    own = tuple(_layout_of(scene, answer) for answer in answers)
    reference, names = layout or _answer(folder, site), scene.names
    installers = scene.studied_installers

    fine = grid_candidates(scene, reference, effort.heights, effort.fine_tilts)
    splits = tuple(dict.fromkeys((SEARCHED, judging)))
    jobs = [Job(AS_IT_IS, (*fine.layouts, *own), split) for split in splits]
    as_it_is = folder.landscapes(site, jobs, "the scene as it is")
    searched, judged = as_it_is[0], as_it_is[-1]
    judges, judges_of_changes = _judges(site, judging), _judges(few, judging)
    kept = FIRST if judging == HELD_OUT or layout else cross_fitted(searched, judges.block)
    findings = [
        gain_finding(beside(judged, BASELINE, kept), judges),
        optimum_finding(searched, judged, fine, site.plan.search_block, seed),
    ]
    limits = limit_errors(installers)
    errors = [one for *_, pair in limits for one in pair] + [*orthogonal_errors(installers, _ERRORS_BASE)]
    off_plan = [installed_layout(reference, error) for error in errors]
    hung = Job(Variation(MOUNTING, "installation", ""), (scene.baselines, reference, *off_plan), judging)
    (off,) = folder.landscapes(few, [hung], "installation errors")
    findings += installation_findings(off, installers, judges_of_changes, names)
    coarse = grid_candidates(scene, reference, effort.heights, effort.tilts)
    varied = [
        replace(AS_IT_IS, section=TRAFFIC),
        *metric_variations(few, rivals),  # which share its cast
        *traffic_variations(site, effort.draws),
        *sensor_variations(few, effort.draws),
    ]
    metrics = {short_name(name): name for name in (*METRICS, *rivals)}
    for change, draws in _draws(folder, few, varied, coarse, judging, given=layout is not None).items():
        unit = metric_named(metrics.get(change[2], site.scoring.metric))
        findings.append(change_finding(change, draws, coarse, judges_of_changes._replace(metric=unit)))
    findings += _for_lorries(folder, few, reference, judging, judges_of_changes)
    best = best_row(searched, np.isin(site.plan.search, whole.plan.search))
    found = [beside(judged, len(fine.layouts) + row, best) for row in range(len(own))]
    findings.append(search_finding(answers, found, judges, names, leans=fine.leans))
    findings.sort(key=lambda finding: SECTIONS.index(finding.section))  # which keeps their order within a section
    values = searched.per_vehicle()
    return {
        **study_head(site, STABILITY_SCHEMA, effort),
        "reading": scene.objective.reading,
        "search": short_name(scene.search.method),
        "answered_frames": len(whole.search),
        "varied_frames": len(few.search),
        "judged_on": judging,
        "judged_frames": len(judges_of_changes.block),
        "vehicles": int(searched.vehicles.sum()),
        "mounting": _told(scene, reference),
        "baseline": _told(scene, scene.baselines),
        "mounting_given": layout is not None,
        "objective_per_vehicle": float(values[FIRST]),
        "baseline_per_vehicle": float(values[BASELINE]),
        "installers": [one.as_setting() for one in installers],
        "seeds": answers,
        "findings": [asdict(finding) for finding in findings],
        **({"leans": True} if fine.leans else {}),
        **({"lidars": names} if any(names) else {}),
    }


def _answer(folder: StudyFolder, site: Site) -> Layout:
    """What `optimise` answers: its search, map and last stage, on all searched frames."""
    scene, stage = site.scenario, "answer"
    if not folder.holds(stage):
        total = sum(most_evaluations(scene, space) for lidar in scene.lidars for space in lidar.deployment.spaces)
        with folder.counting(total, "mountings of the answer") as shown, site_evaluator(site, site.search) as evaluator:
            replay, listener = Replay(None, {}, resume=False), _Counted(shown)
            if scene.is_layout:
                found = search_layout(site, evaluator, replay, listener)
            else:
                found = search_place(site, scene.lidar.deployment.spaces[0], evaluator, replay, listener)
        folder.store(stage, {"mounting": _told(scene, found.layouts["optimised"])})
    return _layout_of(scene, folder.stored(stage))


class _Counted:
    """A `run.replay.Listener` that counts mountings."""

    def __init__(self, shown) -> None:
        self._shown, self._search, self._done = shown, None, 0

    def searching(self, search: Search | MultiFidelitySearch) -> None:
        if search is not self._search:
            self._search, self._done = search, 0
        self._shown.advance(search.evaluations - self._done)
        self._done = search.evaluations

    def mapping(self, points: int) -> None:
        self._shown.advance(points)


def _answers(folder: StudyFolder, site: Site, effort: StabilityEffort) -> list[dict]:
    """What the search finds with the scene's seed and with the ones that follow it: mounting, value, evaluations."""
    scene, space = site.scenario, joint_space(site.scenario)
    iterations = max(1, round(effort.budget * scene.search.iterations)) * len(scene.lidars)
    stages = {seed: f"seed_{seed}" for seed in range(scene.search.seed, scene.search.seed + effort.seeds)}
    searches = {
        seed: fresh_search(replace(scene, search=replace(scene.search, seed=seed, iterations=iterations)), space)
        for seed, stage in stages.items()
        if not folder.holds(stage)
    }
    if searches:
        total = sum(search.budget for search in searches.values())
        with (
            folder.counting(total, f"{len(searches)} searches") as shown,
            site_evaluator(site, site.search) as evaluator,
        ):
            for seed, search in searches.items():
                while not search.done:
                    asked = search.ask()
                    search.tell(evaluator.totals([space.layout(x) for x in asked]).per_vehicle())
                    shown.advance(len(asked))
                answer = {"seed": seed, "mounting": _told(scene, space.layout(search.best_x))}
                answer |= {"per_vehicle": search.best_value, "evaluations": search.evaluations}
                folder.store(stages[seed], answer)
    return [folder.stored(stage) for stage in stages.values()]


def _told(scene: Scenario, layout: Layout) -> dict:
    """The coordinates of a layout as JSON holds them, of several LiDARs by their names."""
    tables = {name: mounting.as_table() for name, mounting in zip(scene.names, layout, strict=True)}
    return tables.get("", tables)


def _layout_of(scene: Scenario, answer: Mapping) -> Layout:
    """The layout of one of `_answers`."""
    told = by_name(answer["mounting"], scene.names)
    return tuple(one.mounting(table) for one, table in zip(scene.lidars, told.values(), strict=True))


def _judging_split(site: Site) -> str:
    """The held-out frames; the searched ones where too little is held out for an interval."""
    weights = block_sums(np.array([frame.counted_weight.sum() for frame in site.holdout]), site.plan.holdout_block)
    return HELD_OUT if (weights > 0.0).sum() >= FEWEST_BLOCKS else SEARCHED


def _judges(site: Site, judging: str) -> Judges:
    frames, block = split_of(site, judging)
    counted = np.concatenate([frame.vehicle_id[frame.counted] for frame in frames])
    return Judges(block, len(np.unique(counted)) / max(1, len(counted)), metric_named(site.scoring.metric))


def _draws(
    folder: StudyFolder,
    site: Site,
    variations: Sequence[Variation],
    mountings: Candidates,
    judging: str,
    *,
    given: bool,
) -> dict[tuple[str, str, str], list[ChangeDraw | str]]:
    """The best mounting of each variation beside the one in question, on frames that did not choose it.

    These are the held-out ones, or the searched ones with cross-fitting; then the mounting in question, unless it was
    `given`, stands for what the scene as it is, the first of the variations, would choose without each block.

    By section, what and value, as several draws of one change share them; a text where the site allows no such change.
    """
    searched = folder.landscapes(site, [Job(one, mountings.layouts) for one in variations], "the scene varied")
    known = [(one, found) for one, found in zip(variations, searched, strict=True) if not isinstance(found, str)]
    block = site.plan.search_block
    rivals = [likely_rivals(found, block, site.scenario.search.seed) for _, found in known]
    if judging == HELD_OUT:
        first = mountings.layouts[: FIRST + 1]
        distinct = [tuple(dict.fromkeys(rows)) for rows in rivals]
        jobs = [
            Job(one, (*first, *(mountings.layouts[row] for row in rows)), HELD_OUT)
            for (one, _), rows in zip(known, distinct, strict=True)
        ]
        judged = [
            seen if isinstance(seen, str) else beside(seen, FIRST, *(RIVAL + own.index(row) for row in rows))
            for seen, own, rows in zip(
                folder.landscapes(site, jobs, "variations judged"), distinct, rivals, strict=True
            )
        ]
    else:
        own = FIRST if given else cross_fitted(searched[0], block)
        judged = [
            beside(found, own, cross_fitted(found, block), *rows[1:])
            for (_, found), rows in zip(known, rivals, strict=True)
        ]
    values = {
        one: seen if isinstance(seen, str) else ChangeDraw(rows[0] - FIRST, chooses(found), seen)
        for (one, found), rows, seen in zip(known, rivals, judged, strict=True)
    }
    draws: dict[tuple[str, str, str], list[ChangeDraw | str]] = {}
    for one, found in zip(variations, searched, strict=True):
        draws.setdefault((one.section, one.what, one.value), []).append(values.get(one, found))
    return draws


_REPAIRED = 0.02  # of the recorded share is all that may be missing


def _for_lorries(folder: StudyFolder, site: Site, layout: Layout, judging: str, judges: Judges) -> list[Finding]:
    """What would see as many as recorded where lorries alone drive in the nearest lane, or all over a map.

    It is the least height that misses 2 points at most on the searched frames, or the best. Nothing is looked for where
    these lorries hide no more, or several LiDARs hang.
    """
    alone = (mix for mix in mixes(site, layout[0].xy) if mix.lorries == 1.0 and mix.approach is None)
    mix = next(alone, None)
    if mix is None or len(layout) > 1:
        return []
    scene, change = site.scenario, (TRAFFIC, f"higher for {mix.what}", mix.value)
    recorded = replace(AS_IT_IS, section=TRAFFIC, what="recorded beside lorries")
    lorries = Variation(*change, partial(mix.change, seed=scene.search.seed))
    higher, allowed_m = higher_mountings(scene, layout[0])
    first = (scene.baselines, layout)
    jobs = [Job(recorded, first), Job(lorries, (*first, *((one,) for one in higher)))]
    before, after = folder.landscapes(site, jobs, "higher mountings")
    if isinstance(after, str):
        return []
    enough, shares = before.detectable_share()[FIRST] - _REPAIRED, after.detectable_share()
    if shares[FIRST] >= enough:
        return []
    sufficient = shares[RIVAL:] >= enough
    found = int(np.argmax(sufficient if sufficient.any() else shares[RIVAL:]))
    axis, table = joint_space(scene).axes[1], higher[found].as_table()
    beyond = " (above the allowed heights)" if table["height_m"] > allowed_m else ""
    place = f"{table['height_m']:.2f} m{beyond}, {axis.split('_')[0]} {table[axis]:.0f} deg"
    others = [(one,) for one in (higher[found], on_other_side(scene, layout[0])) if one is not None]
    recorded, lorries = (replace(one, value=f"{one.value} judged") for one in (recorded, lorries))
    jobs = [Job(recorded, first, judging), Job(lorries, (*first, *others), judging)]
    judged = folder.landscapes(site, jobs, "higher mountings judged")
    if isinstance(judged[1], str):
        return []
    return [repair_finding(change, *judged, judges, place, judging)]
