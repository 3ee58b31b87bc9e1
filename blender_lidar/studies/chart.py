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
from ..files import read_text, reading
from ..scene.site import Site
from ..scoring.fidelity import Fidelity, evenly_spread, with_fewer_frames
from .ablations import OFFSETS, Compared, ablation_rows, ablations
from .driver import HELD_OUT, SEARCHED, Job, Landscape, StudyFolder, judging_split, split_of, study_head
from .effects import BASELINE_ROW, BOUND_LEVEL, FIRST, SURE, Candidates, Reference, accuracy, candidates
from .ladder import (
    ORACLE,
    REFERENCE,
    TOGETHER,
    ChartEffort,
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

COMPARISON = "compare.json"
CHART_SCHEMA = 2  # of the stages and of the result


def chart_identity(site: Site, effort: ChartEffort, other: Site | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"chart {name}": value for name, value in asdict(effort).items()}
    casters = [site.observation.caster, *other_casters(site)]
    sensor = None if other is None else other.identity
    return {**site.identity, **asked, "chart schema": CHART_SCHEMA, "chart casters": casters, "chart other": sensor}


def chart_study(
    site: Site,
    effort: ChartEffort,
    tolerance: float,
    folder: StudyFolder,
    other: Site | None = None,
    paired: Mapping | None = None,
) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    site : Site
        The scene, made ready.
    effort : ChartEffort
    tolerance : float
        Share of the gain that a fidelity may lose.
    folder : StudyFolder
        Locked by the caller.
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
    every, rungs, judging = candidates(site.scenario, effort.mountings), ladder(site), judging_split(site)
    timed = _timed(folder, site, list(dict.fromkeys(whole(rung.fidelity) for rung in rungs)), every, effort)
    scored, judged = score_ladder(folder, site, every, effort, rungs)
    on = _compared(site, every, scored[REFERENCE], judged)
    reference, gain = on.reference, on.reference.gain
    rows = rung_rows(rungs, reference, scored, timed, effort.phases)
    mark_within(rows, tolerance, reference.noise, gain)
    best = recommended(rows)
    numbers = reference.best(effort.varied_mountings)
    few = Compared(site, every.select(numbers), reference.select(numbers))
    few_rows = [BASELINE_ROW, *(FIRST + number for number in numbers)]
    plain = [one for one, found in scored.items() if len(found.objective) == len(every.poses)]
    known = {variation(one).stage: scored[one].select(few_rows) for one in plain}
    beside = None if other is None else _other_sensor(folder, with_fewer_frames(other, effort.frames), effort)
    validated = []
    if judging == HELD_OUT:
        swapped = _compared(site, every, scored[REFERENCE], judged, swapped=True)
        where = "other blocks: the held-out ones choose, the searched ones judge"
        validated.append((where, "other blocks", swapped, HELD_OUT))
    if beside is not None:
        where = f"{beside.site.model.name}, range gate {beside.site.observation.max_range_m:g} m"
        validated.append((where, "other sensor", beside, SEARCHED))
    return {
        **study_head(site, CHART_SCHEMA, effort),
        "range_gate_m": site.observation.max_range_m,
        "casters_not_installed": [name for name in CASTERS if not is_available(name)],
        "blocks": len(np.unique(reference.searched_block)),
        "vehicles": int(reference.searched.vehicles.sum()),
        "judged_on": judging,
        "judged_frames": len(reference.judged_block),
        "judged_blocks": len(np.unique(reference.judged_block)),
        "mountings": effort.mountings,
        "baseline_per_vehicle": float(reference.searched.per_vehicle()[BASELINE_ROW]),
        "gain_per_vehicle": gain,
        "tolerance": tolerance,
        "sure": SURE,
        "bound_level": BOUND_LEVEL,
        "reference": rows[0]["name"],
        "noise": reference.noise and asdict(reference.noise),
        "rungs": rows,
        "hits": _hits(folder, site, every, effort),
        "recommended": best["name"],
        "sentence": sentence(rows[0], best, tolerance, gain),
        "validated": [
            _validated(folder, rungs[rows.index(best)].fidelity, effort, tolerance, *where) for where in validated
        ],
        "ablation_mountings": min(effort.varied_mountings, effort.mountings),
        "ablation_floor": few.reference.noise and asdict(few.reference.noise),
        "ablations": _ablated(folder, few, effort, known, beside),
        "paired": paired,
    }


def _compared(
    site: Site, every: Candidates, searched: Landscape, judged: Landscape, *, swapped: bool = False
) -> Compared:
    """The reference by what it scores on the frames that choose and that judge; or with these `swapped`."""
    splits = [(searched, site.plan.search_block), (judged, split_of(site, judging_split(site))[1])]
    chose, judges = reversed(splits) if swapped else splits
    return Compared(site, every, Reference(*chose, *judges, site.scenario.search.seed + swapped))


def _timed(
    folder: StudyFolder, site: Site, fidelities: Sequence[Fidelity], every: Candidates, effort: ChartEffort
) -> Times:
    """Each fidelity on all frames."""

    def measure() -> list:
        poses = every.poses[FIRST : FIRST + effort.rounds + TOGETHER]
        with folder.counting(len(site.search), "frames timed") as shown:
            timed = time_fidelities(site, fidelities, poses, effort.rounds, shown.advance)
        return [[part.tolist() for part in both] for both in timed.values()]

    stored = folder.stage("times", measure)
    return {fidelity: tuple(map(np.array, both)) for fidelity, both in zip(fidelities, stored, strict=True)}


def _hits(folder: StudyFolder, site: Site, every: Candidates, effort: ChartEffort) -> list[dict]:
    """What the installed casters hit beside the float64 oracle, on a few frames from a few mountings."""
    frames = [site.search[row] for row in evenly_spread(len(site.search), min(effort.hit_frames, len(site.search)))]
    poses = every.poses[FIRST : FIRST + effort.hit_mountings]
    casters = [name for name in (site.observation.caster, *other_casters(site)) if name != ORACLE]
    return folder.stage("hits", lambda: count_hits(site, frames, poses, casters))


def _ablated(
    folder: StudyFolder, on: Compared, effort: ChartEffort, known: Mapping[str, Landscape], beside: Compared | None
) -> list[dict]:
    """A row for every ablation, on the best mountings by the reference.

    Of azimuth offsets, where the scene's sensor has none and the other one does, on that.
    """
    rows = ablation_rows(folder, on, ablations(on.site, effort.draws), known)
    if beside is not None and not on.site.model.azimuth_offset_rad.any() and beside.site.model.azimuth_offset_rad.any():
        (change,) = (one for one in ablations(beside.site, effort.draws) if one.what == OFFSETS)
        change = replace(change, value=f"{change.value}; {beside.site.model.name} and its own floor")
        (row,) = ablation_rows(folder, beside, [change], {}, "other sensor")
        rows = [row if one["what"] == OFFSETS else one for one in rows]
    return rows


# --- does the recommendation hold on a scene that it has not seen? ----------------------------------------------------

HOLDS, LIKELY, FAILS, UNTOLD = "holds", "likely", "fails", "cannot be told"


def _other_sensor(folder: StudyFolder, site: Site, effort: ChartEffort) -> Compared:
    """The reference of the same scene with another sensor."""
    every, change = candidates(site.scenario, effort.other_mountings), variation(REFERENCE, "other sensor reference")
    jobs = [Job(change, every.poses, split) for split in dict.fromkeys((SEARCHED, judging_split(site)))]
    scored = folder.landscapes(site, jobs, f"reference with {site.model.name}")
    return _compared(site, every, scored[0], scored[-1])


def _validated(
    folder: StudyFolder,
    chosen: Fidelity,
    effort: ChartEffort,
    tolerance: float,
    where: str,
    section: str,
    on: Compared,
    split: str,
) -> dict:
    """What the recommended fidelity loses where it was not chosen, as JSON holds it.

    It looks at as large a share of the frames of that `split` as it does of the searched ones.
    """
    jobs = [Job(variation(phase, section), on.every.poses, split) for phase in phased(chosen, effort.phases)]
    phases = folder.landscapes(on.site, jobs, f"recommendation, {section}")
    frames = looked_at(chosen, len(on.site.search), len(split_of(on.site, split)[0]))
    found = accuracy(on.reference, phases, frames)
    kept = {key: found[key] for key in ("regret", "regret_interval_90", "error_share", "tau")}
    return {
        "where": where,
        "verdict": within_tolerance(found["regret"], found["regret_interval_90"], tolerance),
        **kept,
    }


def within_tolerance(share: float | None, interval: tuple[float, float] | None, tolerance: float) -> str:
    """Whether a loss is within the tolerance: by its whole 90 % interval, or likely; or surely is not."""
    if share is None or (share > tolerance and (interval is None or interval[0] <= tolerance)):
        return UNTOLD
    if share > tolerance:
        return FAILS
    return HOLDS if interval is not None and interval[1] <= tolerance else LIKELY


# --- beside a real LiDAR ----------------------------------------------------------------------------------------------


def read_paired(path: str | Path) -> dict:
    """The errors of a comparison with recorded clouds, from its `compare.json` or the folder that holds it.

    Returns
    -------
    dict
        ``file``, ``cars``, ``losses`` and ``variants``: of each level of detail the median absolute error of PE-VGOP
        per vehicle and its 90 % interval [bits], or None.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file, or it is not of a comparison.
    """
    path = Path(path)
    path = path / COMPARISON if path.is_dir() else path
    try:
        with reading(path, COMPARISON):
            found, variants = json.loads(read_text(path)), []
        for one in found["variants"]:
            error = one["absolute_error_bits"]
            interval = error["interval_90"] and [float(end) for end in error["interval_90"]]
            variants.append(
                {"detail": str(one["detail"]), "error_bits": float(error["median"]), "interval_90": interval}
            )
        losses = str(found["losses"])
        return {"file": path.name, "cars": int(found["vehicles"]), "losses": losses, "variants": variants}
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"--paired-errors: {path}: is no {COMPARISON} of blender-lidar compare") from error
