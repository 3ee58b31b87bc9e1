"""The whole study of a scene's stability, stage by stage, and its result as one dictionary."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..metrics.catalogue import metric_named
from ..metrics.views import PE_VGOP
from ..provenance import versions
from ..scenario import pose_at
from ..settings import Tolerance
from ..study.fewer_frames import with_fewer_frames
from ..study.landscape import Landscape
from ..study.landscape_stages import CounterMaker
from ..study.landscapes import HELD_OUT, SEARCHED, Job
from ..study.score_map import AXES
from ..study.scoring import CountedFrame
from ..study.site import Site
from ..study.stages import StudyFolder
from ..study.variation import AS_IT_IS
from ..study.verdict import judge
from .answers import search_findings
from .effort import Effort
from .findings import MOST_FRAGILE_LOSS, MOST_STABLE_LOSS
from .installation import USUAL, beside_robust, installation_findings, off_plan, profiles, robust_candidate
from .metric_variations import metric_variations
from .mountings import BASELINE, CANDIDATES, REFERENCE, Mountings, mountings_about
from .sample_size import ASKED_DEG, sample_size
from .saturation import saturation_finding, views_beyond_the_peak
from .sensor_variations import sensor_variations
from .stored import StoredStages, attacked_casters
from .traffic_sample import gain_finding, optimum_finding, sample_size_finding
from .traffic_variations import traffic_variations
from .variations import SECTIONS, TRAFFIC
from .varied import finding_of

SCHEMA = 1  # of the stages and of the result
TILT = AXES[1]


def study_identity(site: Site, effort: Effort, mounting: Mapping[str, float] | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"study {name}": value for name, value in asdict(effort).items()}
    limits = {"study losses": [MOST_STABLE_LOSS, MOST_FRAGILE_LOSS], "study schema": SCHEMA}
    given = {"study mounting": None if mounting is None else dict(mounting), "study casters": attacked_casters()}
    return {**site.identity, **asked, **limits, **given}


def study_stability(
    site: Site, effort: Effort, folder: StudyFolder, counter: CounterMaker, mounting: Mapping[str, float] | None = None
) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    site : Site
        The scene, made ready.
    effort : Effort
    folder : StudyFolder
        Locked by the caller.
    counter : callable
        Told of progress.
    mounting : mapping of str to float, optional
        The mounting in question, in metres and degrees; what the scene's search finds with its own seed if left out.

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    scene, whole = site.scenario, with_fewer_frames(site, effort.frames)
    seed, metric = scene.search.seed, metric_named(site.scoring.metric)
    stages = StoredStages(folder, counter)
    answers = stages.answers(whole, effort)
    reference = dict(answers[0]["mounting"] if mounting is None else mounting)
    judging = HELD_OUT if sum(int(frame.counted.sum()) for frame in site.holdout) else SEARCHED

    lowest, highest = scene.deployment.bounds.get(TILT, (0.0, 0.0))
    fine_tilts = max(effort.fine_tilts, math.ceil((highest - lowest) / ASKED_DEG) + 1)
    fine = mountings_about(scene, reference, effort.heights, fine_tilts)
    sampled = [Job(AS_IT_IS, fine.poses, split) for split in dict.fromkeys((SEARCHED, judging))]
    as_it_is = stages.landscapes(site, sampled, "the scene as it is")
    optimum, intervals = optimum_finding(as_it_is[0], fine, site.plan.search_block, seed)
    certainty = (
        [sample_size_finding(sample_size(*_blocks_of_all(site, as_it_is), fine.tilt_deg, seed))]
        if TILT in scene.deployment.bounds
        else []  # there is no best tilt to be certain of
    )

    tolerance = scene.objective.tolerance or USUAL
    verdict = stages.stage("held_out", lambda: _judged(site, reference, seed))
    views = (
        [saturation_finding(stages.stage("views", lambda: views_beyond_the_peak(site, reference)))]
        if metric.name == PE_VGOP.name
        else []  # other metrics have no such peak
    )
    judged_answers = stages.stage("answers", lambda: _judged_answers(site, judging, answers))

    few = with_fewer_frames(whole, effort.varied_frames)
    coarse = mountings_about(scene, reference, effort.heights, effort.tilts)
    hung = stages.stage("installation", lambda: _installation(site, few, coarse, judging, tolerance, stages))
    varied = [
        replace(AS_IT_IS, section=TRAFFIC),
        *traffic_variations(few, effort.draws),
        *metric_variations(few),
        *sensor_variations(few, effort.draws),
    ]
    draws = stages.draws(few, varied, coarse, judging)
    judged_block = site.plan.holdout_block if judging == HELD_OUT else None
    values = as_it_is[0].per_vehicle()
    findings = [
        gain_finding(verdict["reference"], metric),
        optimum,
        *certainty,
        *installation_findings(hung["off_plan"], hung["robust"], tolerance),
        *views,
        *(finding_of(change, of, coarse, intervals, judged_block) for change, of in draws.items()),
        *search_findings(answers, *_best_and_baseline(site, whole, as_it_is[0]), judged_answers),
        *stages.attacks(quick=effort.quick),
    ]
    findings.sort(key=lambda finding: SECTIONS.index(finding.section))  # which keeps their order within a section
    return {
        "schema": SCHEMA,
        "scene": Path(scene.source).name,
        "sensor": site.model.name,
        "caster": site.observation.caster,
        "detail": site.observation.detail,
        "metric": metric.name,
        "metric_unit": metric.unit,
        "reading": scene.objective.reading,
        "search": scene.search.method,
        "seed": seed,
        "frames": len(site.search),
        "answered_frames": len(whole.search),
        "varied_frames": len(few.search),
        "judged_on": judging,
        "judged_frames": len(_frames(site if judging == HELD_OUT else few, judging)[0]),
        "vehicles": int(as_it_is[0].vehicles.sum()),
        "effort": asdict(effort),
        "mounting": reference,
        "baseline": dict(scene.baseline),
        "mounting_given": mounting is not None,
        "objective_per_vehicle": float(values[REFERENCE]),
        "baseline_per_vehicle": float(values[BASELINE]),
        "tolerance": asdict(tolerance),
        "profiles": hung["profiles"],
        "seeds": answers,
        "findings": [asdict(finding) for finding in findings],
        "notes": list(site.plan.notes),
        "versions": versions(site.observation.caster),
    }


def _blocks_of_all(site: Site, landscapes: Sequence[Landscape]) -> tuple[np.ndarray, np.ndarray]:
    """Objective and vehicles of every block of time, of the searched frames and of the held-out ones."""
    blocks = [landscapes[0].blocks(site.plan.search_block)]
    blocks += [landscape.blocks(site.plan.holdout_block) for landscape in landscapes[1:]]
    return tuple(np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True))


def _best_and_baseline(site: Site, whole: Site, landscape: Landscape) -> tuple[float, float]:
    """Objective per vehicle of the best grid point and of the baseline, on the frames that the search looks at."""
    looked_at = np.isin(site.plan.search, whole.plan.search)
    values = Landscape(landscape.objective[:, looked_at], landscape.vehicles[looked_at]).per_vehicle()
    return float(values[CANDIDATES:].max()), float(values[BASELINE])


def _frames(site: Site, split: str) -> tuple[tuple[CountedFrame, ...], np.ndarray]:
    """Frames and their blocks."""
    return (site.search, site.plan.search_block) if split == SEARCHED else (site.holdout, site.plan.holdout_block)


def _installation(
    site: Site, few: Site, mountings: Mountings, judging: str, tolerance: Tolerance, stages: StoredStages
) -> dict:
    """The mounting off its plan, on the frames that judge; the robust optimum is looked for as each variation's is."""
    frames, block = _frames(site if judging == HELD_OUT else few, judging)
    with stages.counting(3, "installed only nearly so") as advance:
        with few.evaluator(few.search) as evaluator:
            robust = robust_candidate(evaluator, mountings, tolerance)
        advance(1)
        with site.evaluator(frames) as evaluator:
            found = {"profiles": profiles(evaluator, mountings)}
            advance(1)
            found["off_plan"] = off_plan(evaluator, mountings, tolerance, block)
            found["robust"] = beside_robust(evaluator, mountings, robust, tolerance)
            advance(1)
    return found


def _judged(site: Site, reference: Mapping[str, float], seed: int) -> dict:
    mountings = {"reference": pose_at(reference), "baseline": site.scenario.baseline_pose}
    with site.evaluator(site.search) as evaluator:
        return judge(site, mountings, evaluator, seed)


def _judged_answers(site: Site, judging: str, answers: Sequence[Mapping]) -> dict:
    """What the baseline and the answers of all seeds come to on the frames that judge."""
    poses = [site.scenario.baseline_pose, *(pose_at(answer["mounting"]) for answer in answers)]
    with site.evaluator(_frames(site, judging)[0]) as evaluator:
        values = evaluator.totals(poses).per_vehicle().tolist()
    return {"baseline": values[0], "answers": values[1:]}
