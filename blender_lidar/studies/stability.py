"""The study of a scene's stability: where its answer holds and where it breaks.

Stage by stage the traffic, the sensor, the metric, the installation, the seeds of the search and the size of the sample
are varied, and of each change it is asked what the mounting in question loses to the best one under that change. The
result is one dictionary.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..run.installation import tolerance_text
from ..run.optimise import fresh_search
from ..run.tolerance import installed, losses_over_tolerance, objective_over
from ..run.verdict import AXES, judge, vehicle_table
from ..scene.provenance import versions
from ..scene.scenario import pose_at
from ..scene.settings import COORDINATES, Tolerance
from ..scene.site import Site
from ..scoring.evaluation import Evaluator, site_evaluator
from ..scoring.fidelity import with_fewer_frames
from .driver import (
    AS_IT_IS,
    HELD_OUT,
    SEARCHED,
    CounterMaker,
    Job,
    Landscape,
    Stages,
    StudyFolder,
    Variation,
    judging_split,
    split_of,
)
from .findings import (
    ASKED_DEG,
    BASELINE,
    CANDIDATES,
    MOST_FRAGILE_LOSS,
    MOST_STABLE_LOSS,
    REFERENCE,
    UNDECIDED,
    Draw,
    Finding,
    Mountings,
    best_candidate,
    by_loss,
    chooses,
    finding_of,
    gain_finding,
    lost,
    mountings_about,
    optimum_finding,
    percent,
    sample_size,
    sample_size_finding,
)
from .variations import (
    METRIC,
    MOUNTING,
    SEARCH,
    SECTIONS,
    TRAFFIC,
    metric_variations,
    sensor_variations,
    traffic_variations,
)

SCHEMA = 1  # of the stages and of the result
TILT = AXES[1]
USUAL = Tolerance(height_m=0.05, tilt_deg=1.0, yaw_deg=2.0, aim="mean")
PROFILES = {"height_m": 0.5, "tilt_x_deg": 5.0, "tilt_y_deg": 5.0, "yaw_deg": 10.0}  # how far off each is drawn
_STEPS = 10  # of a profile, to each side
_PEAK = 1.0 / math.e  # of -P log2 P


@dataclass(frozen=True, slots=True)
class Effort:
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
        Tilts of the grid for the scene as it is, whose optimum is sampled anew.
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


FULL = Effort(None, 15, heights=6, tilts=26, fine_tilts=51, seeds=11, budget=1.0, draws=8, quick=False)
QUICK = Effort(8, 8, heights=4, tilts=26, fine_tilts=51, seeds=3, budget=0.3, draws=2, quick=True)


def study_identity(site: Site, effort: Effort, mounting: Mapping[str, float] | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"study {name}": value for name, value in asdict(effort).items()}
    limits = {"study losses": [MOST_STABLE_LOSS, MOST_FRAGILE_LOSS], "study schema": SCHEMA}
    return {**site.identity, **asked, **limits, "study mounting": None if mounting is None else dict(mounting)}


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
    few = with_fewer_frames(whole, effort.varied_frames)
    seed, metric, judging = scene.search.seed, metric_named(site.scoring.metric), judging_split(site)
    stages = Stages(folder, counter)
    answers = _answers(stages, whole, effort)
    reference = dict(answers[0]["mounting"] if mounting is None else mounting)

    lowest, highest = scene.deployment.bounds.get(TILT, (0.0, 0.0))
    fine_tilts = max(effort.fine_tilts, math.ceil((highest - lowest) / ASKED_DEG) + 1)
    fine = mountings_about(scene, reference, effort.heights, fine_tilts)
    sampled = [Job(AS_IT_IS, fine.poses, split) for split in dict.fromkeys((SEARCHED, judging))]
    as_it_is = stages.landscapes(site, sampled, "the scene as it is")
    optimum, intervals = optimum_finding(as_it_is[0], fine, site.plan.search_block, seed)
    verdict = stages.stage("held_out", lambda: _judged(site, reference, seed))
    findings = [gain_finding(verdict["reference"], metric), optimum]
    if TILT in scene.deployment.bounds:  # else there is no best tilt to be certain of
        of_blocks = [one.blocks(split_of(site, job.split)[1]) for job, one in zip(sampled, as_it_is, strict=True)]
        every = (np.concatenate(parts, axis=-1) for parts in zip(*of_blocks, strict=True))
        findings.append(sample_size_finding(sample_size(*every, fine.tilt_deg, seed)))
    if metric.name == PE_VGOP.name:  # other metrics have no such peak
        findings.append(saturation_finding(stages.stage("views", lambda: _views_beyond_the_peak(site, reference))))
    judged_answers = stages.stage("answers", lambda: _judged_answers(site, judging, answers))

    coarse, tolerance = (
        mountings_about(scene, reference, effort.heights, effort.tilts),
        scene.objective.tolerance or USUAL,
    )
    judges, judged_block = split_of(site if judging == HELD_OUT else few, judging)
    hung = stages.stage(
        "installation", lambda: _installation(stages, site, few, coarse, tolerance, judges, judged_block)
    )
    varied = [
        replace(AS_IT_IS, section=TRAFFIC),
        *metric_variations(few),  # which share its cast
        *traffic_variations(few, effort.draws),
        *sensor_variations(few, effort.draws),
    ]
    block = judged_block if judging == HELD_OUT else None
    findings += installation_findings(hung["off_plan"], hung["robust"], tolerance)
    for change, draws in _draws(stages, few, varied, coarse, judging).items():
        findings.append(finding_of(change, draws, coarse, intervals, block))
    looked_at = np.isin(site.plan.search, whole.plan.search)
    values = Landscape(as_it_is[0].objective[:, looked_at], as_it_is[0].vehicles[looked_at]).per_vehicle()
    findings += search_findings(answers, float(values[CANDIDATES:].max()), float(values[BASELINE]), judged_answers)
    findings.sort(key=lambda finding: SECTIONS.index(finding.section))  # which keeps their order within a section
    values = as_it_is[0].per_vehicle()
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
        "judged_frames": len(judges),
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


def _answers(stages: Stages, site: Site, effort: Effort) -> list[dict]:
    """What the search finds with the scene's seed and with the ones that follow it: mounting, value, evaluations."""
    scene = site.scenario
    iterations = max(1, round(effort.budget * scene.search.iterations))
    seeds = range(scene.search.seed, scene.search.seed + effort.seeds)
    searches = {
        seed: fresh_search(replace(scene, search=replace(scene.search, seed=seed, iterations=iterations)))
        for seed in seeds
        if not stages.folder.holds(f"seed_{seed}")
    }
    if searches:
        total = sum(search.budget for search in searches.values())
        with (
            stages.counting(total, f"{len(searches)} searches") as advance,
            site_evaluator(site, site.search) as evaluator,
        ):
            for seed, search in searches.items():
                while not search.done:
                    asked = search.ask()
                    search.tell(evaluator.totals([scene.deployment.pose(x) for x in asked]).per_vehicle())
                    advance(len(asked))
                answer = {
                    "seed": seed,
                    "mounting": scene.deployment.coordinates(search.best_x),
                    "per_vehicle": search.best_value,
                    "evaluations": search.evaluations,
                }
                stages.folder.store(f"seed_{seed}", answer)
    return [stages.folder.stored(f"seed_{seed}") for seed in seeds]


def _draws(
    stages: Stages, site: Site, variations: Sequence[Variation], mountings: Mountings, judging: str
) -> dict[tuple[str, str, str], list[Draw | str]]:
    """The best mounting of each variation, chosen on the searched frames and judged beside the one in question.

    By section, what and value, as several draws of one change share them; a text where the site allows no such change.
    """
    searched = stages.landscapes(site, [Job(one, mountings.poses) for one in variations], "the scene varied")
    rows = [
        None if isinstance(found, str) else [REFERENCE, BASELINE, CANDIDATES + best_candidate(found)]
        for found in searched
    ]
    if judging == HELD_OUT:
        known = [(one, of) for one, of in zip(variations, rows, strict=True) if of is not None]
        jobs = [Job(one, tuple(mountings.poses[row] for row in of), HELD_OUT) for one, of in known]
        judged = iter(stages.landscapes(site, jobs, "variations judged"))
    else:
        judged = (found.select(of) for found, of in zip(searched, rows, strict=True) if of is not None)
    draws: dict[tuple[str, str, str], list[Draw | str]] = {}
    for one, found, of in zip(variations, searched, rows, strict=True):
        seen = found if of is None else next(judged)
        draw = seen if isinstance(seen, str) else Draw(of[CANDIDATES] - CANDIDATES, chooses(found), seen)
        draws.setdefault((one.section, one.what, one.value), []).append(draw)
    return draws


def _installation(
    stages: Stages, site: Site, few: Site, mountings: Mountings, tolerance: Tolerance, judges, block: np.ndarray
) -> dict:
    """The mounting off its plan, on the frames that judge; the robust optimum is looked for as each variation's is."""
    with stages.counting(3, "installed only nearly so") as advance:
        with site_evaluator(few, few.search) as evaluator:  # best where it hangs only nearly as planned
            robust = mountings.grid[int(np.argmax(objective_over(evaluator, mountings.grid, tolerance)))]
        advance(1)
        with site_evaluator(site, judges) as evaluator:
            planned, baseline = evaluator.totals(list(mountings.poses[:CANDIDATES])).per_vehicle()
            found = {"profiles": _profiles(evaluator, mountings.reference, planned, baseline)}
            advance(1)
            losses = losses_over_tolerance(evaluator, mountings.reference, tolerance, block)
            found["off_plan"] = {
                "gain": losses.planned_per_vehicle - float(baseline),
                "kept": losses.kept(float(baseline)),
                "limits": {key: list(lost) for key, lost in losses.limit_losses.items()},
            }
            over = objective_over(evaluator, [mountings.reference, robust], tolerance) / evaluator.vehicles.sum()
            sharp, best = (over - baseline).tolist()
            found["robust"] = {"mounting": robust, "sharp_gain": sharp, "robust_gain": best}
            advance(1)
    return found


def _profiles(evaluator: Evaluator, plan: Mapping[str, float], planned: float, baseline: float) -> dict[str, dict]:
    """Share of the gain that is kept with one coordinate off at a time: offsets [m or degrees] and shares of each.

    Empty where the mounting gains nothing over the baseline.
    """
    found = {}
    for key, reach in PROFILES.items() if planned > baseline else ():
        offsets = np.linspace(-reach, reach, 2 * _STEPS + 1)
        errors = np.zeros((len(offsets), len(COORDINATES)))
        errors[:, COORDINATES.index(key)] = offsets
        values = evaluator.totals(installed(plan, errors)).per_vehicle()
        found[key] = {"offset": offsets.tolist(), "kept": ((values - baseline) / (planned - baseline)).tolist()}
    return found


def _judged(site: Site, reference: Mapping[str, float], seed: int) -> dict:
    mountings = {"reference": pose_at(reference), "baseline": site.scenario.baseline_pose}
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        return judge(site, mountings, evaluator, seed)


def _judged_answers(site: Site, judging: str, answers: Sequence[Mapping]) -> dict:
    """What the baseline and the answers of all seeds come to on the frames that judge."""
    poses = [site.scenario.baseline_pose, *(pose_at(answer["mounting"]) for answer in answers)]
    with site_evaluator(site, split_of(site, judging)[0]) as evaluator:
        values = evaluator.totals(poses).per_vehicle().tolist()
    return {"baseline": values[0], "answers": values[1:]}


def _views_beyond_the_peak(site: Site, mounting: Mapping[str, float]) -> dict:
    """Share of the views with any return whose occupancy exceeds 1/e, of all and of those nearer than 10 m."""
    table = vehicle_table(pose_at(mounting), search=Evaluator(site.search, site.observation, site.scoring))
    views = np.stack([table[view] for view in ("p_top", "p_side", "p_front")], axis=1)
    every, near = (seen[seen > 0] for seen in (views, views[table["distance_m"] < 10.0]))
    shares = [float((seen > _PEAK).mean()) if len(seen) else None for seen in (every, near)]
    return {"seen": len(every), "share": shares[0], "share_within_10_m": shares[1]}


# --- views so full that PE-VGOP falls where it should rise ------------------------------------------------------------


def saturation_finding(found: Mapping) -> Finding:
    """How much of what is seen lies where a denser view scores less: -P log2 P falls beyond P = 1/e.

    `found`: how many views were ``seen`` at all, the ``share`` of them beyond that, and ``share_within_10_m``.
    """
    what, share, near = "views beyond P = 1/e", found["share"], found["share_within_10_m"]
    if share is None:
        return Finding(METRIC, what, "", UNDECIDED, "no view of any vehicle has a return", dict(found))
    text = f"{percent(share)} of {found['seen']:,} seen views"
    text += "" if near is None else f", {percent(near)} of those nearer than 10 m: there a denser view scores less"
    return Finding(METRIC, what, "", by_loss(share), text, dict(found))


# --- an installer's errors --------------------------------------------------------------------------------------------

_NAMES = {
    "height_m": ("height", "m", "height_m"),
    "tilt_x_deg": ("tilt across the road", "deg", "tilt_deg"),
    "tilt_y_deg": ("tilt along the road", "deg", "tilt_deg"),
    "yaw_deg": ("yaw", "deg", "yaw_deg"),
}


def installation_findings(found: Mapping, robust: Mapping, tolerance: Tolerance) -> list[Finding]:
    """A line for each coordinate that is off, one for all, and one for the robust optimum beside this mounting."""
    if not found["gain"] > 0.0:
        return [Finding(MOUNTING, "installation", "", UNDECIDED, "the mounting gains nothing over the baseline")]
    lines = []
    for key, limits in found["limits"].items():
        name, unit, width = _NAMES[key]
        minus, plus = (loss / found["gain"] for loss in limits)
        text = f"{lost(minus)} where it is less, {lost(plus)} where it is more"
        value = f"+/-{getattr(tolerance, width):g} {unit}"
        lines.append(Finding(MOUNTING, name, value, by_loss(max(minus, plus)), text, {"limits": [minus, plus]}))
    loss = 1.0 - found["kept"]
    aim = "on average" if tolerance.aim == "mean" else "in nine of ten installations"
    text = f"keeps {percent(found['kept'])} of its gain {aim} within {tolerance_text(asdict(tolerance))}"
    return [
        *lines,
        Finding(MOUNTING, "all of these together", "", by_loss(loss), text, {"loss": loss}),
        _robust(robust),
    ]


def _robust(found: Mapping) -> Finding:
    """What the mounting in question leaves to the robust optimum where both hang only nearly as planned."""
    what, place = "robust optimum", found["mounting"]
    at = f"{place['height_m']:.2f} m, {place['tilt_x_deg']:.1f} deg"
    if not found["robust_gain"] > 0.0:
        return Finding(MOUNTING, what, "", UNDECIDED, f"{at}, which gains nothing over the baseline", dict(found))
    loss = 1.0 - found["sharp_gain"] / found["robust_gain"]
    text = f"{at}, best on the searched frames where all of these may be off; there the mounting {lost(loss)}"
    return Finding(MOUNTING, what, "", by_loss(loss), text, {"loss": loss, **found})


# --- the search: do other seeds find the same, and as good? -----------------------------------------------------------

_TEXTS = {  # name, unit, digits; those that all answers share are told of the first two alone
    "height_m": ("height", "m", 2),
    "tilt_x_deg": ("tilt", "deg", 1),
    "x_m": ("x", "m", 2),
    "y_m": ("y", "m", 2),
    "tilt_y_deg": ("tilt along the road", "deg", 1),
    "yaw_deg": ("yaw", "deg", 1),
}
_ALWAYS_TOLD = ("height_m", "tilt_x_deg")


def search_findings(answers: Sequence[dict], best: float, baseline: float, judged: Mapping) -> list[Finding]:
    """What the answers of several seeds leave to the best known mounting, and how far apart they lie.

    Parameters
    ----------
    answers : sequence of dict
        Of each seed: ``mounting``, its value ``per_vehicle``, and ``evaluations``.
    best, baseline : float
        Objective per vehicle of the best grid point and of the baseline, on the frames of the search.
    judged : mapping
        Objective per vehicle of the ``"baseline"`` and of the ``"answers"``, on the frames that judge.
    """
    value = f"{len(answers)} seeds of {answers[0]['evaluations']:,} evaluations"
    values = np.array([answer["per_vehicle"] for answer in answers])
    best = max(best, float(values.max()))
    if not best > baseline:
        return [Finding(SEARCH, "regret", value, UNDECIDED, "no mounting is better than the baseline")]
    left = (best - values) / (best - baseline)
    text = f"median {percent(float(np.median(left)))}, worst {percent(float(left.max()))} of the gain"
    regret = Finding(SEARCH, "regret", value, by_loss(float(left.max())), text, {"regrets": left.tolist()})
    return [regret, _spread(answers, value, judged)]


def _spread(answers: Sequence[dict], value: str, judged: Mapping) -> Finding:
    """How far apart answers lie, judged by what the least of them loses to the best on other traffic."""
    places, texts = {}, []
    for key, (name, unit, digits) in _TEXTS.items():
        found = [answer["mounting"][key] for answer in answers]
        if key not in _ALWAYS_TOLD and len(set(found)) == 1:
            continue
        places[key] = found
        low, high = (f"{end:.{digits}f}" for end in (min(found), max(found)))
        texts.append(f"{name} {low} to {high} {unit}")
    gains = np.array(judged["answers"]) - judged["baseline"]
    loss = float(1.0 - gains.min() / gains.max()) if gains.max() > 0.0 else None
    if loss is not None:
        texts.append(f"on the frames that judge the least of them gains {percent(loss)} less than the best")
    return Finding(SEARCH, "spread of the answers", value, by_loss(loss), ", ".join(texts), {"loss": loss, **places})
