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
from ..study.site import Site
from ..study.stages import StudyFolder
from .ablation_study import Compared, ablation_rows
from .ablations import OFFSETS, ablations
from .accuracy import Reference
from .candidates import BASELINE, FIRST, Candidates, candidates
from .effort import Effort
from .hits import count_hits
from .ladder import Rung, ladder, missing_casters, other_casters
from .noise import Noise, noise_ceiling
from .recommendation import sentence
from .rungs import recommended, rung_rows
from .scored import Scored, block_of, judging_split, score_ladder
from .sequence import BOUND_LEVEL, SURE, mark_within
from .timing import TOGETHER, Timed, time_fidelities
from .validation import on_other_blocks, on_other_sensor, other_reference

SCHEMA = 2  # of the stages and of the result


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
    rungs, judging = ladder(site), judging_split(site)
    timed = _timed(stages, site, rungs, every, effort)
    found = score_ladder(stages, site, every, effort, rungs)
    reference = Reference.of(
        found.reference, site.plan.search_block, found.judged, block_of(site, judging), site.scenario.search.seed
    )
    noise = noise_ceiling(reference)
    rows = rung_rows(rungs, reference, found.ladder, found.checked, timed)
    mark_within(rows, tolerance, noise, reference.gain)
    best = recommended(rows)
    chosen = rungs[rows.index(best)].fidelity
    beside = None if other is None else other_reference(stages, other, effort)
    floor, of_ablations = _ablated(stages, site, every, reference, found, effort, beside)
    return {
        "schema": SCHEMA,
        **_circumstances(site, effort, reference, judging),
        "tolerance": tolerance,
        "sure": SURE,
        "bound_level": BOUND_LEVEL,
        "reference": rows[0]["name"],
        "noise": None if noise is None else asdict(noise),
        "rungs": rows,
        "hits": _hits(stages, site, every, effort),
        "recommended": best["name"],
        "sentence": sentence(rows[0], best, tolerance, reference.gain),
        "validated": [
            *on_other_blocks(stages, site, chosen, found, every, effort, tolerance),
            *([] if beside is None else [on_other_sensor(stages, beside, chosen, effort, tolerance)]),
        ],
        "ablation_mountings": min(effort.varied_mountings, effort.mountings),
        "ablation_floor": None if floor is None else asdict(floor),
        "ablations": of_ablations,
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
    every: Candidates,
    reference: Reference,
    found: Scored,
    effort: Effort,
    beside: tuple[Site, Candidates, Reference] | None,
) -> tuple[Noise | None, list[dict]]:
    """The floor and a row for every ablation, on the best mountings by the reference.

    Of azimuth offsets, where the scene's sensor has none and the other one does, on that.
    """
    numbers = reference.best(effort.varied_mountings)
    on = Compared.of(site, every.select(numbers), reference.select(numbers))
    known = found.by_stage([BASELINE, *(FIRST + number for number in numbers)])
    rows = ablation_rows(stages, on, ablations(site, effort.draws), known)
    if beside is not None and not site.model.azimuth_offset_rad.any() and beside[0].model.azimuth_offset_rad.any():
        (change,) = (one for one in ablations(beside[0], effort.draws) if one.what == OFFSETS)
        change = replace(change, value=f"{change.value}; {beside[0].model.name} and its own floor")
        (row,) = ablation_rows(stages, Compared.of(*beside), [change], {}, "other sensor")
        rows = [row if one["what"] == OFFSETS else one for one in rows]
    return on.floor, rows
