"""The chart of a scene: time against accuracy of every fidelity, and what of the model the scene needs.

Stage by stage: the ladder is timed and scored, the cheapest fidelity that is near enough is validated on other blocks
of traffic and with another sensor, and ablations are scored on the best mountings. The result is one dictionary.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ..casting import CASTERS, is_available
from ..errors import InputError
from ..files import read_text
from ..metrics.catalogue import metric_named
from ..scene.provenance import versions
from ..scene.site import Site
from ..scoring.fidelity import Fidelity, evenly_spread, with_fewer_frames
from .ablations import OFFSETS, Compared, ablation_rows, ablations
from .compare.paired_findings import RESULT, judging
from .driver import HELD_OUT, SEARCHED, CounterMaker, Job, Landscape, Stages, StudyFolder, judging_split, split_of
from .effects import BASELINE, FIRST, Candidates, Reference, accuracy, candidates
from .ladder import (
    BOUND_LEVEL,
    ORACLE,
    REFERENCE,
    SURE,
    TOGETHER,
    Effort,
    Times,
    count_hits,
    ladder,
    looked_at,
    mark_within,
    other_casters,
    phased,
    recommended,
    rung_rows,
    score_ladder,
    sentence,
    time_fidelities,
    variation,
    whole,
)

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
        What `read_paired` gave.

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    site = with_fewer_frames(site, effort.frames)
    stages, every, seed = (
        Stages(folder, counter),
        candidates(site.scenario, effort.mountings),
        site.scenario.search.seed,
    )
    rungs, judging = ladder(site), judging_split(site)
    timed = _timed(stages, site, list(dict.fromkeys(whole(rung.fidelity) for rung in rungs)), every, effort)
    found = score_ladder(stages, site, every, effort, rungs)
    searched, judged_block = found.ladder[REFERENCE][0], split_of(site, judging)[1]
    reference = Reference(searched, site.plan.search_block, found.judged, judged_block, seed)
    gain = reference.gain
    rows = rung_rows(rungs, reference, found, timed)
    mark_within(rows, tolerance, reference.noise, gain)
    best = recommended(rows)
    chosen = rungs[rows.index(best)].fidelity
    validated = []
    if judging == HELD_OUT:
        swapped = Reference(found.judged, judged_block, searched, site.plan.search_block, seed + 1)
        where = "other blocks: the held-out ones choose, the searched ones judge"
        validated.append((where, "other blocks", "on other blocks", Compared(site, every, swapped), HELD_OUT))
    beside = None if other is None else _other_reference(stages, other, effort)
    if beside is not None:
        where = f"{other.model.name}, range gate {other.observation.max_range_m:g} m"
        validated.append((where, "other sensor", f"with {other.model.name}", beside, SEARCHED))
    numbers = reference.best(effort.varied_mountings)
    on = Compared(site, every.select(numbers), reference.select(numbers))
    rows_scored = [BASELINE, *(FIRST + number for number in numbers)]
    known = {variation(fidelity).stage: phases[0].select(rows_scored) for fidelity, phases in found.ladder.items()}
    metric = metric_named(site.scoring.metric)
    return {
        "schema": SCHEMA,
        "scene": Path(site.scenario.source).name,
        "sensor": site.model.name,
        "range_gate_m": site.observation.max_range_m,
        "caster": site.observation.caster,
        "casters_not_installed": [name for name in CASTERS if not is_available(name)],
        "detail": site.observation.detail,
        "metric": metric.name,
        "metric_unit": metric.unit,
        "seed": seed,
        "frames": len(site.search),
        "blocks": len(np.unique(site.plan.search_block)),
        "vehicles": int(searched.vehicles.sum()),
        "judged_on": judging,
        "judged_frames": len(judged_block),
        "judged_blocks": len(np.unique(judged_block)),
        "mountings": effort.mountings,
        "effort": asdict(effort),
        "baseline_per_vehicle": float(searched.per_vehicle()[BASELINE]),
        "gain_per_vehicle": gain,
        "tolerance": tolerance,
        "sure": SURE,
        "bound_level": BOUND_LEVEL,
        "reference": rows[0]["name"],
        "noise": reference.noise and asdict(reference.noise),
        "rungs": rows,
        "hits": _hits(stages, site, every, effort),
        "recommended": best["name"],
        "sentence": sentence(rows[0], best, tolerance, gain),
        "validated": [_validated(stages, chosen, effort, tolerance, *one) for one in validated],
        "ablation_mountings": min(effort.varied_mountings, effort.mountings),
        "ablation_floor": on.reference.noise and asdict(on.reference.noise),
        "ablations": _ablated(stages, on, effort, known, beside),
        "paired": paired,
        "notes": list(site.plan.notes),
        "versions": versions(site.observation.caster),
    }


def _timed(stages: Stages, site: Site, fidelities: Sequence[Fidelity], every: Candidates, effort: Effort) -> Times:
    """Each fidelity on all frames."""

    def measure() -> list:
        poses = every.poses[FIRST : FIRST + effort.rounds + TOGETHER]
        with stages.counting(len(site.search), "frames timed") as advance:
            timed = time_fidelities(site, fidelities, poses, effort.rounds, advance)
        return [[part.tolist() for part in timed[fidelity]] for fidelity in fidelities]

    stored = stages.stage("times", measure)
    return {fidelity: tuple(map(np.array, both)) for fidelity, both in zip(fidelities, stored, strict=True)}


def _hits(stages: Stages, site: Site, every: Candidates, effort: Effort) -> list[dict]:
    """The casters beside the oracle."""
    frames = [site.search[row] for row in evenly_spread(len(site.search), min(effort.hit_frames, len(site.search)))]
    poses = every.poses[FIRST : FIRST + effort.hit_mountings]
    casters = [name for name in (site.observation.caster, *other_casters(site)) if name != ORACLE]
    return stages.stage("hits", lambda: count_hits(site, frames, poses, casters))


def _ablated(
    stages: Stages, on: Compared, effort: Effort, known: Mapping[str, Landscape], beside: Compared | None
) -> list[dict]:
    """A row for every ablation, on the best mountings by the reference.

    Of azimuth offsets, where the scene's sensor has none and the other one does, on that.
    """
    rows = ablation_rows(stages, on, ablations(on.site, effort.draws), known)
    if beside is not None and not on.site.model.azimuth_offset_rad.any() and beside.site.model.azimuth_offset_rad.any():
        (change,) = (one for one in ablations(beside.site, effort.draws) if one.what == OFFSETS)
        change = replace(change, value=f"{change.value}; {beside.site.model.name} and its own floor")
        (row,) = ablation_rows(stages, beside, [change], {}, "other sensor")
        rows = [row if one["what"] == OFFSETS else one for one in rows]
    return rows


# --- does the recommendation hold on a scene that it has not seen? ----------------------------------------------------

HOLDS, LIKELY, FAILS, UNTOLD = "holds", "likely", "fails", "cannot be told"


def _other_reference(stages: Stages, other: Site, effort: Effort) -> Compared:
    """The reference of the same scene with another sensor."""
    site = with_fewer_frames(other, effort.frames)
    every, judging = candidates(site.scenario, effort.other_mountings), judging_split(site)
    change = variation(REFERENCE, "other sensor reference")
    jobs = [Job(change, every.poses, split) for split in dict.fromkeys((SEARCHED, judging))]
    scored = stages.landscapes(site, jobs, f"reference with {site.model.name}")
    blocks = site.plan.search_block, split_of(site, judging)[1]
    return Compared(site, every, Reference(scored[0], blocks[0], scored[-1], blocks[1], site.scenario.search.seed))


def _validated(
    stages: Stages,
    chosen: Fidelity,
    effort: Effort,
    tolerance: float,
    where: str,
    section: str,
    told: str,
    on: Compared,
    split: str,
) -> dict:
    """What the recommended fidelity loses where it was not chosen, as JSON holds it.

    It looks at as large a share of the frames of that `split` as it does of the searched ones.
    """
    jobs = [Job(variation(phase, section), on.every.poses, split) for phase in phased(whole(chosen), effort.phases)]
    phases = stages.landscapes(on.site, jobs, f"recommendation {told}")
    frames = looked_at(chosen, len(on.site.search), len(split_of(on.site, split)[0]))
    found, gain = accuracy(on.reference, phases, frames), on.reference.gain
    share, interval, _ = found.regret or (None, None, None)
    return {
        "where": where,
        "verdict": verdict(share, interval, tolerance),
        "regret": share,
        "regret_interval_90": None if interval is None else list(interval),
        "error_share": found.error / gain if gain > 0.0 else None,
        "tau": found.tau if np.isfinite(found.tau) else None,
    }


def verdict(share: float | None, interval: tuple[float, float] | None, tolerance: float) -> str:
    """Whether a loss is within the tolerance: by its whole 90 % interval, or likely; or surely is not."""
    if share is None or (share > tolerance and (interval is None or interval[0] <= tolerance)):
        return UNTOLD
    if share > tolerance:
        return FAILS
    return HOLDS if interval is not None and interval[1] <= tolerance else LIKELY


# --- beside a real LiDAR ----------------------------------------------------------------------------------------------

OPTION = "--paired"


def read_paired(path: str | Path) -> dict:
    """The errors of a paired comparison, from its `paired.json` or the folder that holds it.

    Returns
    -------
    dict
        ``file``, ``set``, ``cars`` and ``variants``: of each detail and losses the median absolute error of PE-VGOP per
        car and its 90 % interval [bits], or None.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file, or it is not of a paired comparison.
    """
    path = Path(path)
    path = path / RESULT if path.is_dir() else path
    try:
        sets = json.loads(read_text(path))["sets"]
        name = judging(sets)
        variants = [_variant(one) for one in sets[name]["variants"]]
        return {"file": path.name, "set": name, "cars": int(sets[name]["cars"]), "variants": variants}
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{OPTION}: {path}: is no {RESULT} of blender-lidar compare --paired") from error


def _variant(one: Mapping) -> dict:
    error = one["absolute_error_bits"]
    interval = error["interval_90"]
    return {
        "detail": str(one["detail"]),
        "losses": str(one["losses"]),
        "error_bits": float(error["median"]),
        "interval_90": None if interval is None else [float(end) for end in interval],
    }
