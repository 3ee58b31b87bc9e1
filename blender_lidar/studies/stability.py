"""The study of a scene's stability: where its answer holds and where it breaks.

Stage by stage the traffic, the sensor, the metric, the installation and the seeds of the search are varied, and of each
change it is asked what the mounting in question loses to the best one under that change. The result is one dictionary;
`findings` turns numbers into verdicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..plugins import short_name
from ..run.optimise import fresh_search
from ..run.tolerance import losses_over_tolerance
from ..run.vehicle_table import vehicle_table
from ..scene.mounting import Mounting
from ..scene.settings import Tolerance
from ..scene.site import Site
from ..scoring.evaluation import site_evaluator
from ..scoring.fidelity import with_fewer_frames
from .candidates import BASELINE, FIRST, Candidates, grid_candidates
from .driver import (
    AS_IT_IS,
    HELD_OUT,
    SEARCHED,
    Job,
    Landscape,
    StudyFolder,
    Variation,
    judging_split,
    split_of,
    study_head,
)
from .findings import (
    GRID,
    MOST_FRAGILE_LOSS,
    MOST_STABLE_LOSS,
    PEAK,
    ChangeDraw,
    change_finding,
    chooses,
    gain_finding,
    installation_findings,
    optimum_finding,
    saturation_finding,
    search_finding,
)
from .variations import SECTIONS, TRAFFIC, metric_variations, sensor_variations, traffic_variations

STABILITY_SCHEMA = 3  # of the stages and of the result
USUAL = Tolerance(height_m=0.05, tilt_deg=1.0, yaw_deg=2.0, aim="mean")


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


def study_identity(site: Site, effort: StabilityEffort, mounting: Mounting | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"study {name}": value for name, value in asdict(effort).items()}
    limits = {"study losses": [MOST_STABLE_LOSS, MOST_FRAGILE_LOSS], "study schema": STABILITY_SCHEMA}
    return {**site.identity, **asked, **limits, "study mounting": None if mounting is None else mounting.as_table()}


def study_stability(site: Site, effort: StabilityEffort, folder: StudyFolder, mounting: Mounting | None = None) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    site : Site
        The scene, made ready.
    effort : StabilityEffort
    folder : StudyFolder
        Locked by the caller.
    mounting : Mounting, optional
        The mounting in question; what the scene's search finds with its own seed if left out.

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    scene, judging, seed = site.scenario, judging_split(site), site.scenario.search.seed
    whole = with_fewer_frames(site, effort.frames)
    few = with_fewer_frames(whole, effort.varied_frames)
    judges, judged_block = split_of(site if judging == HELD_OUT else few, judging)
    answers = _answers(folder, whole, effort)
    reference = scene.mounting(answers[0]["mounting"]) if mounting is None else mounting
    tolerance = scene.objective.tolerance or USUAL

    fine = grid_candidates(scene, reference, effort.heights, effort.fine_tilts)
    splits = tuple(dict.fromkeys((SEARCHED, judging)))
    as_it_is = folder.landscapes(site, [Job(AS_IT_IS, fine.layouts, split) for split in splits], "the scene as it is")
    held_out = as_it_is[1] if judging == HELD_OUT else None
    findings = [
        gain_finding(held_out, site.plan.holdout_block, seed, metric_named(site.scoring.metric)),
        optimum_finding(as_it_is[0], fine, site.plan.search_block, seed),
    ]
    if site.scoring.metric == PE_VGOP.name:  # other metrics have no such peak
        findings.append(saturation_finding(folder.stage("views", lambda: _views_beyond_the_peak(site, reference))))

    hung = folder.stage("installation", lambda: _installation(folder, few, judging, reference, tolerance))
    findings += installation_findings(hung, tolerance)
    coarse = grid_candidates(scene, reference, effort.heights, effort.tilts)
    varied = [
        replace(AS_IT_IS, section=TRAFFIC),
        *metric_variations(few),  # which share its cast
        *traffic_variations(effort.draws),
        *sensor_variations(few, effort.draws),
    ]
    for change, draws in _draws(folder, few, varied, coarse, judging).items():
        findings.append(change_finding(change, draws, coarse, judged_block if judging == HELD_OUT else None))
    looked_at = np.isin(site.plan.search, whole.plan.search)
    searched = as_it_is[0].per_vehicle(looked_at)
    best, baseline = float(searched[GRID:].max()), float(searched[BASELINE])
    findings.append(search_finding(answers, best, baseline, leans=fine.leans))
    findings.sort(key=lambda finding: SECTIONS.index(finding.section))  # which keeps their order within a section
    values = as_it_is[0].per_vehicle()
    return {
        **study_head(site, STABILITY_SCHEMA, effort),
        "reading": scene.objective.reading,
        "search": short_name(scene.search.method),
        "answered_frames": len(whole.search),
        "varied_frames": len(few.search),
        "judged_on": judging,
        "judged_frames": len(judges),
        "vehicles": int(as_it_is[0].vehicles.sum()),
        "mounting": reference.as_table(),
        "baseline": scene.baseline.as_table(),
        "mounting_given": mounting is not None,
        "objective_per_vehicle": float(values[FIRST]),
        "baseline_per_vehicle": float(values[BASELINE]),
        "tolerance": asdict(tolerance),
        "seeds": answers,
        "findings": [asdict(finding) for finding in findings],
        **({"leans": True} if fine.leans else {}),
    }


def _answers(folder: StudyFolder, site: Site, effort: StabilityEffort) -> list[dict]:
    """What the search finds with the scene's seed and with the ones that follow it: mounting, value, evaluations."""
    scene, (space,) = site.scenario, site.scenario.deployment.spaces
    iterations = max(1, round(effort.budget * scene.search.iterations))
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
                answer = {"seed": seed, "mounting": space.layout(search.best_x)[0].as_table()}
                answer |= {"per_vehicle": search.best_value, "evaluations": search.evaluations}
                folder.store(stages[seed], answer)
    return [folder.stored(stage) for stage in stages.values()]


def _draws(
    folder: StudyFolder, site: Site, variations: Sequence[Variation], mountings: Candidates, judging: str
) -> dict[tuple[str, str, str], list[ChangeDraw | str]]:
    """The best mounting of each variation, chosen on the searched frames and judged beside the one in question.

    By section, what and value, as several draws of one change share them; a text where the site allows no such change.
    """
    searched = folder.landscapes(site, [Job(one, mountings.layouts) for one in variations], "the scene varied")
    known = [(one, found) for one, found in zip(variations, searched, strict=True) if not isinstance(found, str)]
    rows = [[BASELINE, FIRST, _best_of_grid(found)] for _, found in known]
    if judging == HELD_OUT:
        every = mountings.layouts
        jobs = [Job(one, tuple(every[row] for row in of), HELD_OUT) for (one, _), of in zip(known, rows, strict=True)]
        judged = folder.landscapes(site, jobs, "variations judged")
    else:
        judged = [found.select(of) for (_, found), of in zip(known, rows, strict=True)]
    values = {
        one: seen if isinstance(seen, str) else ChangeDraw(of[-1] - FIRST, chooses(found), seen)
        for (one, found), of, seen in zip(known, rows, judged, strict=True)
    }
    draws: dict[tuple[str, str, str], list[ChangeDraw | str]] = {}
    for one, found in zip(variations, searched, strict=True):
        draws.setdefault((one.section, one.what, one.value), []).append(values.get(one, found))
    return draws


def _best_of_grid(landscape: Landscape) -> int:
    """The row of the grid's best; the first of equals."""
    return GRID + int(np.argmax(landscape.per_vehicle()[GRID:]))


def _installation(
    folder: StudyFolder, site: Site, judging: str, plan: Mounting, tolerance: Tolerance
) -> dict[str, object]:
    """The mounting off its plan, on the frames that judge: its gain, what errors keep of it and what each costs."""
    block = split_of(site, judging)[1]
    with (
        folder.counting(1, "installation errors") as shown,
        site_evaluator(site, site.search, site.holdout) as evaluator,
    ):
        judge = evaluator.held_out if judging == HELD_OUT else evaluator
        planned, baseline = judge.totals([(plan,), (site.scenario.baseline,)]).per_vehicle().tolist()
        losses = losses_over_tolerance(judge, (plan,), tolerance, block)
        shown.advance(1)
    return {"gain": planned - baseline, "kept": losses.kept(baseline), "limits": losses.limit_losses}


def _views_beyond_the_peak(site: Site, mounting: Mounting) -> dict:
    """Share of the views with any return whose occupancy exceeds 1/e, of all and of those nearer than 10 m."""
    with site_evaluator(site, site.search) as evaluator:
        table = vehicle_table((mounting,), search=evaluator)
    views = np.stack([table[view] for view in ("p_top", "p_side", "p_front")], axis=1)
    every, near = (seen[seen > 0] for seen in (views, views[table["distance_m"] < 10.0]))
    shares = [float((seen > PEAK).mean()) if len(seen) else None for seen in (every, near)]
    return {"seen": len(every), "share": shares[0], "share_within_10_m": shares[1]}
