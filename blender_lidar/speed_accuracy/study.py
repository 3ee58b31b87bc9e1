"""The whole chart of a scene, stage by stage, and its result as one dictionary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..metrics.catalogue import metric_named
from ..provenance import versions
from ..study.fewer_frames import evenly_spread, with_fewer_frames
from ..study.fidelity import Fidelity
from ..study.landscape_stages import CounterMaker, LandscapeStages
from ..study.landscapes import HELD_OUT, Job
from ..study.site import Site
from ..study.stages import StudyFolder
from .ablated import ablation_row, kept_candidates
from .ablations import Ablation, ablations
from .accuracy import Reference
from .candidates import BASELINE, FIRST, Candidates, candidates
from .effort import Effort
from .hits import count_hits
from .ladder import Rung, ladder, missing_casters, other_casters
from .noise import Noise, noise_ceiling
from .recommendation import sentence
from .rungs import mark_within, recommended, rung_rows
from .scored import Scored, block_of, judging_split, score_all
from .timing import TOGETHER, Timed, time_fidelities
from .validation import on_other_blocks, on_other_sensor

SCHEMA = 1  # of the stages and of the result


def chart_identity(site: Site, effort: Effort, other: Site | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"chart {name}": value for name, value in asdict(effort).items()}
    casters = [site.observation.caster, *other_casters(site)]
    sensor = None if other is None else other.identity
    return {**site.identity, **asked, "chart schema": SCHEMA, "chart casters": casters, "chart other": sensor}


def chart_study(
    site: Site,
    effort: Effort,
    tolerance: float,
    folder: StudyFolder,
    counter: CounterMaker,
    other: Site | None = None,
    paired: Mapping | None = None,
) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    site : Site
        The scene, made ready.
    effort : Effort
    tolerance : float
        Share of the gain that a fidelity may lose.
    folder : StudyFolder
        Locked by the caller.
    counter : callable
        Told of progress.
    other : Site, optional
        The same scene with another sensor, to hold the recommendation against.
    paired : mapping, optional
        What `paired.read_paired` gave.

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    site = with_fewer_frames(site, effort.frames)
    stages, every = LandscapeStages(folder, counter), candidates(site.scenario, effort.mountings)
    rungs, changes, judging = ladder(site), ablations(site), judging_split(site)
    timed = _timed(stages, site, rungs, every, effort)
    found = score_all(stages, site, every, effort, rungs, changes)
    reference = Reference.of(
        found.reference, site.plan.search_block, found.judged, block_of(site, judging), site.scenario.search.seed
    )
    noise = noise_ceiling(reference)
    rows = rung_rows(rungs, reference, found.ladder, found.checked, timed)
    mark_within(rows, tolerance, noise, reference.gain)
    best = recommended(rows)
    chosen = rungs[rows.index(best)].fidelity
    return {
        "schema": SCHEMA,
        **_circumstances(site, effort, reference, judging),
        "tolerance": tolerance,
        "reference": rows[0]["name"],
        "noise": None if noise is None else asdict(noise),
        "rungs": rows,
        "hits": _hits(stages, site, every, effort),
        "recommended": best["name"],
        "sentence": sentence(rows[0], best, tolerance, reference.gain),
        "validated": [
            *on_other_blocks(stages, site, chosen, found, every, effort, tolerance),
            *on_other_sensor(stages, other, chosen, effort, tolerance),
        ],
        "ablations": _ablated(stages, site, changes, found, reference, noise, every, effort),
        "paired": paired,
        "notes": list(site.plan.notes),
        "versions": versions(site.observation.caster),
    }


def _circumstances(site: Site, effort: Effort, reference: Reference, judging: str) -> dict:
    metric = metric_named(site.scoring.metric)
    return {
        "scene": Path(site.scenario.source).name,
        "sensor": site.model.name,
        "range_gate_m": site.observation.max_range_m,
        "caster": site.observation.caster,
        "casters_not_installed": missing_casters(),
        "detail": site.observation.detail,
        "metric": metric.name,
        "metric_unit": metric.unit,
        "seed": site.scenario.search.seed,
        "frames": len(site.search),
        "blocks": len(np.unique(site.plan.search_block)),
        "vehicles": int(reference.searched.vehicles.sum()),
        "judged_on": judging,
        "judged_frames": len(reference.judged_block),
        "judged_blocks": len(np.unique(reference.judged_block)),
        "mountings": effort.mountings,
        "effort": asdict(effort),
        "baseline_per_vehicle": float(reference.searched.per_vehicle()[BASELINE]),
        "gain_per_vehicle": reference.gain,
    }


def _timed(
    stages: LandscapeStages, site: Site, rungs: Sequence[Rung], every: Candidates, effort: Effort
) -> dict[Fidelity, Timed]:
    """Each fidelity on all frames."""
    whole = list(dict.fromkeys(replace(rung.fidelity, frames=None) for rung in rungs))

    def measure() -> list:
        poses = every.poses[FIRST : FIRST + effort.rounds + TOGETHER]
        with stages.counting(len(site.search), "frames timed") as advance:
            timed = time_fidelities(site, whole, poses, effort.rounds, advance)
        return [[one.evaluation_s.tolist(), one.build_s.tolist()] for one in timed]

    stored = stages.stage("times", measure)
    return {fidelity: Timed(*map(np.array, both)) for fidelity, both in zip(whole, stored, strict=True)}


def _hits(stages: LandscapeStages, site: Site, every: Candidates, effort: Effort) -> list[dict]:
    """The casters beside the oracle."""
    frames = [site.search[row] for row in evenly_spread(len(site.search), min(effort.hit_frames, len(site.search)))]
    poses = every.poses[FIRST : FIRST + effort.hit_mountings]
    casters = [name for name in (site.observation.caster, *other_casters(site)) if name != "exact"]
    return stages.stage("hits", lambda: count_hits(site, frames, poses, casters))


def _ablated(
    stages: LandscapeStages,
    site: Site,
    changes: Sequence[Ablation],
    found: Scored,
    reference: Reference,
    noise: Noise | None,
    every: Candidates,
    effort: Effort,
) -> list[dict]:
    """Every ablation; what either side would choose is judged where the scene has it."""
    sides = [
        tuple(None if one is None else found.varied[one.stage] for one in (change.without, change.having))
        for change in changes
    ]
    split, jobs = judging_split(site), {}
    for number, (change, both) in enumerate(zip(changes, sides, strict=True)):
        if not all(one is not None and not isinstance(one, str) for one in both):
            continue
        kept = kept_candidates(*both, reference)
        rows = [BASELINE, *(FIRST + kept).tolist()]
        named = replace(change.having, section="judged", what=change.what, value=change.value)
        jobs[number] = (Job(named, tuple(every.poses[row] for row in rows), HELD_OUT), both[1].select(rows))
    if split == HELD_OUT:
        scored = stages.landscapes(site, [job for job, _ in jobs.values()], "ablations judged")
        judged = dict(zip(jobs, scored, strict=True))
    else:
        judged = {number: searched for number, (_, searched) in jobs.items()}
    return [
        ablation_row(change, *both, judged.get(number), every, reference, noise)
        for number, (change, both) in enumerate(zip(changes, sides, strict=True))
    ]
