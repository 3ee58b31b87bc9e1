"""The whole study of a scene's stability, stage by stage, and its result as one dictionary."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ..casting import is_available
from ..metrics.catalogue import metric_named
from ..metrics.views import PE_VGOP
from ..provenance import versions
from ..scenario import pose_at
from ..settings import Tolerance
from ..study.score_map import AXES
from ..study.scoring import CountedFrame
from ..study.site import Site
from ..study.stages import StudyFolder
from ..study.verdict import judge
from .answers import search_findings
from .attacked import attack_finding
from .attacks import ATTACKS
from .caster_attacks import TREES, AttackCount, count_attack
from .effort import Effort
from .findings import MOST_FRAGILE_LOSS, MOST_STABLE_LOSS, UNDECIDED, Finding
from .installation import USUAL, beside_robust, installation_findings, off_plan, profiles, robust_candidate
from .landscape import Landscape
from .landscapes import HELD_OUT, SEARCHED, Job, landscapes
from .metric_variations import metric_variations
from .mountings import BASELINE, CANDIDATES, REFERENCE, Mountings, mountings_about
from .sample_size import ASKED_DEG, sample_size
from .saturation import saturation_finding, views_beyond_the_peak
from .seeds import answer_of_seed, evaluations_of
from .sensor_variations import sensor_variations
from .traffic_sample import gain_finding, optimum_finding, sample_size_finding
from .traffic_variations import traffic_variations
from .variations import AS_IT_IS, CASTERS, SECTIONS, TRAFFIC, Variation
from .varied import Draw, finding_of

SCHEMA = 1  # of the stages and of the result
TILT = AXES[1]


class Counter(Protocol):
    """Shows how far a part of the study has come."""

    def advance(self, steps: int) -> None:
        """Count `steps` more."""

    def close(self) -> None:
        """The part has ended."""


CounterMaker = Callable[[int, str], Counter]
"""Makes a counter up to a total, for what is counted."""


def study_identity(site: Site, effort: Effort, mounting: Mapping[str, float] | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"study {name}": value for name, value in asdict(effort).items()}
    limits = {"study losses": [MOST_STABLE_LOSS, MOST_FRAGILE_LOSS], "study schema": SCHEMA}
    given = {"study mounting": None if mounting is None else dict(mounting), "study casters": _attacked_casters()}
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
    answers = list(_answers(whole, effort, folder, counter))
    reference = dict(answers[0]["mounting"] if mounting is None else mounting)
    judging = HELD_OUT if sum(int(frame.counted.sum()) for frame in site.holdout) else SEARCHED

    lowest, highest = scene.deployment.bounds.get(TILT, (0.0, 0.0))
    fine_tilts = max(effort.fine_tilts, math.ceil((highest - lowest) / ASKED_DEG) + 1)
    fine = mountings_about(scene, reference, effort.heights, fine_tilts)
    sampled = [Job(AS_IT_IS, fine.poses, split) for split in dict.fromkeys((SEARCHED, judging))]
    as_it_is = _landscapes(site, sampled, folder, counter, "the scene as it is")
    optimum, intervals = optimum_finding(as_it_is[0], fine, site.plan.search_block, seed)
    certainty = (
        [sample_size_finding(sample_size(*_blocks_of_all(site, as_it_is), fine.tilt_deg, seed))]
        if TILT in scene.deployment.bounds
        else []  # there is no best tilt to be certain of
    )

    tolerance = scene.objective.tolerance or USUAL
    verdict = folder.stage("held_out", lambda: _judged(site, reference, seed))
    views = (
        [saturation_finding(folder.stage("views", lambda: views_beyond_the_peak(site, reference)))]
        if metric.name == PE_VGOP.name
        else []  # other metrics have no such peak
    )
    judged_answers = folder.stage("answers", lambda: _judged_answers(site, judging, answers))

    few = with_fewer_frames(whole, effort.varied_frames)
    coarse = mountings_about(scene, reference, effort.heights, effort.tilts)
    hung = folder.stage("installation", lambda: _installation(site, few, coarse, judging, tolerance, counter))
    varied = [
        replace(AS_IT_IS, section=TRAFFIC),
        *traffic_variations(few, effort.draws),
        *metric_variations(few),
        *sensor_variations(few, effort.draws),
    ]
    draws = _draws(few, varied, coarse, judging, folder, counter)
    judging_block = site.plan.holdout_block if judging == HELD_OUT else few.plan.search_block
    values = as_it_is[0].per_vehicle()
    findings = [
        gain_finding(verdict["reference"], metric),
        optimum,
        *certainty,
        *installation_findings(hung["off_plan"], hung["robust"], tolerance),
        *views,
        *(finding_of(change, of, coarse, intervals, judging_block) for change, of in draws.items()),
        *search_findings(answers, *_best_and_baseline(site, whole, as_it_is[0]), judged_answers),
        *_attacked(effort, folder, counter),
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
        "judged_frames": len(judging_block),
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


def with_fewer_frames(site: Site, frames: int | None) -> Site:
    """The site with at most that many of its searched frames, spread evenly; all for None, or where those are empty."""
    if frames is None or frames >= len(site.search):
        return site
    kept = ((np.arange(frames) + 0.5) * len(site.search) / frames).astype(int)
    if not any(site.search[row].counted.any() for row in kept):
        return site
    plan = replace(site.plan, search=site.plan.search[kept], search_block=site.plan.search_block[kept])
    return replace(site, plan=plan, search=tuple(site.search[row] for row in kept))


def _answers(site: Site, effort: Effort, folder: StudyFolder, counter: CounterMaker) -> Iterator[dict]:
    """What the search finds with the scene's seed, and with the ones that follow it."""
    first = site.scenario.search.seed
    seeds = range(first, first + effort.seeds)
    names = {seed: f"seed_{seed}" for seed in seeds}
    missing = [seed for seed in seeds if not folder.holds(names[seed])]
    total = len(missing) * evaluations_of(site, effort.budget)
    if missing:
        with _counting(counter, total, f"{len(missing)} searches") as advance, site.evaluator(site.search) as evaluator:
            for seed in missing:
                answer = answer_of_seed(site, evaluator, seed, effort.budget, advance)
                folder.stage(names[seed], lambda answer=answer: answer)
    for seed in seeds:
        yield folder.stage(names[seed], _never)


def _landscapes(
    site: Site, jobs: Sequence[Job], folder: StudyFolder, counter: CounterMaker, what: str
) -> list[Landscape | str]:
    """What the mountings of each job come to, stored as soon as it is known."""
    names = [f"{job.variation.stage}_{job.split.replace(' ', '_')}" for job in jobs]
    missing = [(name, job) for name, job in zip(names, jobs, strict=True) if not folder.holds(name)]
    if missing:
        frames = sum(len(site.search if job.split == SEARCHED else site.holdout) for _, job in missing)
        scored = [job for _, job in missing]
        with (
            _counting(counter, frames, what) as advance,
            closing(landscapes(site, scored, advance)) as found,  # a stop ends its processes
        ):
            for (name, _), landscape in zip(missing, found, strict=True):
                stored = landscape if isinstance(landscape, str) else landscape.as_dict()
                folder.stage(name, lambda stored=stored: stored)
    every = (folder.stage(name, _never) for name in names)
    return [stored if isinstance(stored, str) else Landscape.from_dict(stored) for stored in every]


def _draws(
    site: Site,
    variations: Sequence[Variation],
    mountings: Mountings,
    judging: str,
    folder: StudyFolder,
    counter: CounterMaker,
) -> dict[tuple[str, str, str], list[Draw | str]]:
    """The best mounting of each variation, chosen on the searched frames and judged beside the one in question.

    By section, what and value, as several draws of one change share them.
    """
    searched = _landscapes(site, [Job(one, mountings.poses) for one in variations], folder, counter, "the scene varied")
    known = [number for number, found in enumerate(searched) if not isinstance(found, str)]
    rows = {number: [REFERENCE, BASELINE, CANDIDATES + searched[number].best] for number in known}
    if judging == HELD_OUT:
        jobs = [
            Job(variations[number], tuple(mountings.poses[row] for row in rows[number]), HELD_OUT) for number in known
        ]
        judged = dict(zip(known, _landscapes(site, jobs, folder, counter, "variations judged"), strict=True))
    else:
        judged = {number: searched[number].select(rows[number]) for number in known}
    draws: dict[tuple[str, str, str], list[Draw | str]] = {}
    for number, (variation, found) in enumerate(zip(variations, searched, strict=True)):
        draw = judged.get(number, found)
        if not isinstance(draw, str):
            draw = Draw(found.best, found.chooses, draw)
        draws.setdefault((variation.section, variation.what, variation.value), []).append(draw)
    return draws


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
    site: Site, few: Site, mountings: Mountings, judging: str, tolerance: Tolerance, counter: CounterMaker
) -> dict:
    """The mounting off its plan, on the frames that judge; the robust optimum is looked for as each variation's is."""
    frames, block = _frames(site if judging == HELD_OUT else few, judging)
    with _counting(counter, 3, "installed only nearly so") as advance:
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


def _attacked_casters() -> list[str]:
    return [caster for caster in TREES if is_available(caster)]


def _attacked(effort: Effort, folder: StudyFolder, counter: CounterMaker) -> list[Finding]:
    """Every caster that is installed under every attack."""
    casters, found = _attacked_casters(), []
    if not casters:
        return [Finding(CASTERS, "under attack", "", UNDECIDED, "none is installed but the oracle itself")]
    with _counting(counter, len(ATTACKS), "casters under attack") as advance:
        for name in ATTACKS:

            def count(name=name) -> list[dict]:
                return [asdict(count_attack(caster, name, quick=effort.quick)) for caster in casters]

            stored = folder.stage("_".join(["attack", *name.split()]), count)
            found.append(attack_finding([AttackCount(**one) for one in stored]))
            advance(1)
    return found


def _never() -> object:
    raise RuntimeError("this stage is stored before it is read")


@contextmanager
def _counting(counter: CounterMaker, total: int, what: str) -> Iterator[Callable[[int], None]]:
    """A counter that is closed when the block ends."""
    shown = counter(total, what)
    try:
        yield shown.advance
    finally:
        shown.close()
