"""The study of a scene's stability: where its answer holds and where it breaks.

Stage by stage the traffic, the sensor, the metric, the installation, the seeds of the search and the size of the sample
are varied, and of each change it is asked what the mounting in question loses to the best one under that change. The
result is one dictionary.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..plugins import short_name
from ..road import RoadFrame
from ..run.optimise import fresh_search
from ..run.tolerance import installed, losses_over_tolerance, objective_over, tolerance_text
from ..run.verdict import vehicle_table
from ..scene.mounting import ANGLES, COORDINATES, Tolerance, with_lean
from ..scene.site import Site
from ..scoring.evaluation import Evaluator, site_evaluator
from ..scoring.fidelity import with_fewer_frames
from .driver import (
    AS_IT_IS,
    HELD_OUT,
    SEARCHED,
    Job,
    Landscape,
    StudyFolder,
    Variation,
    judging_split,
    percent,
    split_of,
    study_head,
)
from .findings import (
    ASKED_DEG,
    BASELINE,
    CANDIDATES,
    MOST_FRAGILE_LOSS,
    MOST_STABLE_LOSS,
    REFERENCE,
    UNDECIDED,
    ChangeDraw,
    Finding,
    MountingGrid,
    best_candidate,
    by_loss,
    chooses,
    finding_of,
    gain_finding,
    lost,
    mountings_about,
    optimum_finding,
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

STABILITY_SCHEMA = 1  # of the stages and of the result
USUAL = Tolerance(height_m=0.05, tilt_deg=1.0, yaw_deg=2.0, aim="mean")
PROFILES = {"height_m": 0.5, "tilt_x_deg": 5.0, "tilt_y_deg": 5.0, "yaw_deg": 10.0}  # how far off each is drawn
_STEPS = 10  # of a profile, to each side
_PEAK = 1.0 / math.e  # of -P log2 P


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


FULL_STABILITY = StabilityEffort(
    None, 15, heights=6, tilts=26, fine_tilts=51, seeds=11, budget=1.0, draws=8, quick=False
)
QUICK_STABILITY = StabilityEffort(8, 8, heights=4, tilts=26, fine_tilts=51, seeds=3, budget=0.3, draws=2, quick=True)


def study_identity(site: Site, effort: StabilityEffort, mounting: Mapping[str, float] | None) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"study {name}": value for name, value in asdict(effort).items()}
    limits = {"study losses": [MOST_STABLE_LOSS, MOST_FRAGILE_LOSS], "study schema": STABILITY_SCHEMA}
    return {**site.identity, **asked, **limits, "study mounting": None if mounting is None else dict(mounting)}


def study_stability(
    site: Site, effort: StabilityEffort, folder: StudyFolder, mounting: Mapping[str, float] | None = None
) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    site : Site
        The scene, made ready.
    effort : StabilityEffort
    folder : StudyFolder
        Locked by the caller.
    mounting : mapping of str to float, optional
        The mounting in question, in metres and degrees; what the scene's search finds with its own seed if left out.

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
    reference = dict(answers[0]["mounting"] if mounting is None else mounting)
    tolerance = scene.objective.tolerance or USUAL

    _, tilt = scene.deployment.axes
    lowest, highest = scene.deployment.bounds.get(tilt, (0.0, 0.0))
    fine_tilts = max(effort.fine_tilts, math.ceil((highest - lowest) / ASKED_DEG) + 1)
    fine = mountings_about(scene, reference, effort.heights, fine_tilts)
    splits = tuple(dict.fromkeys((SEARCHED, judging)))
    as_it_is = folder.landscapes(site, [Job(AS_IT_IS, fine.poses, split) for split in splits], "the scene as it is")
    held_out = as_it_is[1] if judging == HELD_OUT else None
    optimum, intervals = optimum_finding(as_it_is[0], fine, site.plan.search_block, seed)
    findings = [gain_finding(held_out, site.plan.holdout_block, seed, metric_named(site.scoring.metric)), optimum]
    if tilt in scene.deployment.bounds:  # else there is no best tilt to be certain of
        of_blocks = [one.blocks(split_of(site, split)[1]) for split, one in zip(splits, as_it_is, strict=True)]
        for_each = sum(one.vehicles.sum() for one in as_it_is) / sum(one.weight.sum() for one in as_it_is)
        every = (for_each * np.concatenate(parts, axis=-1) for parts in zip(*of_blocks, strict=True))
        findings.append(sample_size_finding(sample_size(*every, fine.tilt_deg, seed)))
    if site.scoring.metric == PE_VGOP.name:  # other metrics have no such peak
        findings.append(saturation_finding(folder.stage("views", lambda: _views_beyond_the_peak(site, reference))))

    coarse = mountings_about(scene, reference, effort.heights, effort.tilts)
    hung = folder.stage("installation", lambda: _installation(folder, few, judging, coarse, tolerance))
    findings += installation_findings(hung["off_plan"], hung["robust"], tolerance)
    varied = [
        replace(AS_IT_IS, section=TRAFFIC),
        *metric_variations(few),  # which share its cast
        *traffic_variations(effort.draws),
        *sensor_variations(few, effort.draws),
    ]
    for change, draws in _draws(folder, few, varied, coarse, judging).items():
        findings.append(finding_of(change, draws, coarse, intervals, judged_block if judging == HELD_OUT else None))
    looked_at = np.isin(site.plan.search, whole.plan.search)
    searched = Landscape(as_it_is[0].objective[:, looked_at], as_it_is[0].weight[looked_at]).per_vehicle()
    best, baseline = float(searched[CANDIDATES:].max()), float(searched[BASELINE])
    judged = _judged_answers(folder, site, judging, answers)
    findings += search_findings(answers, best, baseline, judged, leans=tilt == "lean_deg")
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
        "mounting": reference,
        "baseline": dict(scene.baseline),
        "mounting_given": mounting is not None,
        "objective_per_vehicle": float(values[REFERENCE]),
        "baseline_per_vehicle": float(values[BASELINE]),
        "tolerance": asdict(tolerance),
        "profiles": hung["profiles"],
        "seeds": answers,
        "findings": [asdict(finding) for finding in findings],
    }


def _answers(folder: StudyFolder, site: Site, effort: StabilityEffort) -> list[dict]:
    """What the search finds with the scene's seed and with the ones that follow it: mounting, value, evaluations."""
    scene = site.scenario
    iterations = max(1, round(effort.budget * scene.search.iterations))
    stages = {seed: f"seed_{seed}" for seed in range(scene.search.seed, scene.search.seed + effort.seeds)}
    searches = {
        seed: fresh_search(replace(scene, search=replace(scene.search, seed=seed, iterations=iterations)))
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
                    search.tell(evaluator.totals([scene.deployment.pose(x) for x in asked]).per_vehicle())
                    shown.advance(len(asked))
                answer = {"seed": seed, "mounting": scene.deployment.coordinates(search.best_x)}
                answer |= {"per_vehicle": search.best_value, "evaluations": search.evaluations}
                folder.store(stages[seed], answer)
    return [folder.stored(stage) for stage in stages.values()]


def _judged_answers(folder: StudyFolder, site: Site, judging: str, answers: Sequence[Mapping]) -> list[float]:
    """What the baseline and the answers of all seeds come to, per vehicle, on the frames that judge."""
    poses = (site.scenario.baseline_pose, *(site.scenario.pose(answer["mounting"]) for answer in answers))
    (judged,) = folder.landscapes(site, [Job(replace(AS_IT_IS, section="answers"), poses, judging)], "answers judged")
    return judged.per_vehicle().tolist()


def _draws(
    folder: StudyFolder, site: Site, variations: Sequence[Variation], mountings: MountingGrid, judging: str
) -> dict[tuple[str, str, str], list[ChangeDraw | str]]:
    """The best mounting of each variation, chosen on the searched frames and judged beside the one in question.

    By section, what and value, as several draws of one change share them; a text where the site allows no such change.
    """
    searched = folder.landscapes(site, [Job(one, mountings.poses) for one in variations], "the scene varied")
    known = [(one, found) for one, found in zip(variations, searched, strict=True) if not isinstance(found, str)]
    rows = [[REFERENCE, BASELINE, CANDIDATES + best_candidate(found)] for _, found in known]
    if judging == HELD_OUT:
        every = mountings.poses
        jobs = [Job(one, tuple(every[row] for row in of), HELD_OUT) for (one, _), of in zip(known, rows, strict=True)]
        judged = folder.landscapes(site, jobs, "variations judged")
    else:
        judged = [found.select(of) for (_, found), of in zip(known, rows, strict=True)]
    told = {
        one: seen if isinstance(seen, str) else ChangeDraw(of[-1] - CANDIDATES, chooses(found), seen)
        for (one, found), of, seen in zip(known, rows, judged, strict=True)
    }
    draws: dict[tuple[str, str, str], list[ChangeDraw | str]] = {}
    for one, found in zip(variations, searched, strict=True):
        draws.setdefault((one.section, one.what, one.value), []).append(told.get(one, found))
    return draws


def _installation(
    folder: StudyFolder, site: Site, judging: str, mountings: MountingGrid, tolerance: Tolerance
) -> dict[str, dict]:
    """The mounting off its plan, on the frames that judge; the robust optimum is looked for as each variation's is."""
    plan, block, road = mountings.reference, split_of(site, judging)[1], site.scenario.road
    with (
        folder.counting(3, "installed only nearly so") as shown,
        site_evaluator(site, site.search, site.holdout) as evaluator,
    ):
        # Best where it hangs only nearly as planned:
        robust = mountings.grid[int(np.argmax(objective_over(evaluator, mountings.grid, tolerance, road=road)))]
        shown.advance(1)
        judge = evaluator.held_out if judging == HELD_OUT else evaluator
        planned, baseline = judge.totals(list(mountings.poses[:CANDIDATES])).per_vehicle().tolist()
        profiles = _profiles(judge, plan, planned, baseline, road)
        shown.advance(1)
        losses = losses_over_tolerance(judge, plan, tolerance, block, road=road)
        over = objective_over(judge, [plan, robust], tolerance, road=road) / judge.weight.sum()
        nominal, best = (over - baseline).tolist()
        shown.advance(1)
    off_plan = {"gain": planned - baseline, "kept": losses.kept(baseline), "limits": losses.limit_losses}
    beside = {"mounting": robust, "sharp_gain": nominal, "robust_gain": best}
    return {"profiles": profiles, "off_plan": off_plan, "robust": beside}


def _profiles(
    evaluator: Evaluator, plan: Mapping[str, float], planned: float, baseline: float, road: RoadFrame
) -> dict[str, dict]:
    """Share of the gain that is kept with one coordinate off at a time: offsets [m or degrees] and shares of each.

    Empty where the mounting gains nothing over the baseline.
    """
    found = {}
    for key, reach in PROFILES.items() if planned > baseline else ():
        offsets = np.linspace(-reach, reach, 2 * _STEPS + 1)
        values = evaluator.totals(installed(plan, np.outer(offsets, np.array(COORDINATES) == key), road)).per_vehicle()
        found[key] = {"offset": offsets.tolist(), "kept": ((values - baseline) / (planned - baseline)).tolist()}
    return found


def _views_beyond_the_peak(site: Site, mounting: Mapping[str, float]) -> dict:
    """Share of the views with any return whose occupancy exceeds 1/e, of all and of those nearer than 10 m."""
    with site_evaluator(site, site.search) as evaluator:
        table = vehicle_table(site.scenario.pose(mounting), search=evaluator)
    views = np.stack([table[view] for view in ("p_top", "p_side", "p_front")], axis=1)
    every, near = (seen[seen > 0] for seen in (views, views[table["distance_m"] < 10.0]))
    shares = [float((seen > _PEAK).mean()) if len(seen) else None for seen in (every, near)]
    return {"seen": len(every), "share": shares[0], "share_within_10_m": shares[1]}


# --- views so full that PE-VGOP falls where it should rise ------------------------------------------------------------


def saturation_finding(found: Mapping) -> Finding:
    """How much of what is seen lies where a denser view scores less: -P log2 P falls beyond P = 1/e.

    `found`: how many views were ``seen`` at all, the ``share`` of them beyond that, and ``share_within_10_m``.
    """
    share, near, text = found["share"], found["share_within_10_m"], "no view of any vehicle has a return"
    if share is not None:
        text = f"{percent(share)} of {found['seen']:,} seen views"
        text += "" if near is None else f", {percent(near)} of those nearer than 10 m: there a denser view scores less"
    return Finding(METRIC, "views beyond P = 1/e", "", by_loss(share), text, dict(found))


# --- an installer's errors --------------------------------------------------------------------------------------------

_ACROSS = " across the road"
_NAMES = {  # name, unit, digits
    "height_m": ("height", "m", 2),
    "tilt_x_deg": (f"tilt{_ACROSS}", "deg", 1),
    "x_m": ("x", "m", 2),
    "y_m": ("y", "m", 2),
    "tilt_y_deg": ("tilt along the road", "deg", 1),
    "yaw_deg": ("yaw", "deg", 1),
    "lean_deg": ("lean", "deg", 1),
    "lean_direction_deg": ("direction of the lean", "deg", 1),
    "spin_deg": ("spin", "deg", 1),
}


def installation_findings(found: Mapping, robust: Mapping, tolerance: Tolerance) -> list[Finding]:
    """A line for each coordinate that is off, one for all, and one for the robust optimum beside this mounting."""
    if not found["gain"] > 0.0:
        return [Finding(MOUNTING, "installation", "", UNDECIDED, "the mounting gains nothing over the baseline")]
    lines = []
    for key, limits in found["limits"].items():
        name, unit, _ = _NAMES[key]
        minus, plus = (loss / found["gain"] for loss in limits)
        text = f"{lost(minus)} where it is less, {lost(plus)} where it is more"
        value = f"+/-{tolerance.half_widths[key]:g} {unit}"
        lines.append(Finding(MOUNTING, name, value, by_loss(max(minus, plus)), text, {"limits": [minus, plus]}))
    loss = 1.0 - found["kept"]
    aim = "on average" if tolerance.aim == "mean" else "in nine of ten installations"
    text = f"keeps {percent(found['kept'])} of its gain {aim} within {tolerance_text(asdict(tolerance))}"
    lines.append(Finding(MOUNTING, "all of these together", "", by_loss(loss), text, {"loss": loss}))
    return [*lines, _robust(robust)]


def _robust(found: Mapping) -> Finding:
    """What the mounting in question leaves to the robust optimum where both hang only nearly as planned."""
    gain, loss, text = found["robust_gain"], None, "which gains nothing over the baseline"
    if gain > 0.0:
        loss = 1.0 - found["sharp_gain"] / gain
        text = f"best on the searched frames where all of these may be off; there the mounting {lost(loss)}"
    text = f"{found['mounting']['height_m']:.2f} m, {found['mounting']['tilt_x_deg']:.1f} deg, {text}"
    numbers = {**found} if loss is None else {"loss": loss, **found}
    return Finding(MOUNTING, "robust optimum", "", by_loss(loss), text, numbers)


# --- the search: do other seeds find the same, and as good? -----------------------------------------------------------


def search_findings(
    answers: Sequence[dict], best: float, baseline: float, judged: Sequence[float], *, leans: bool = False
) -> list[Finding]:
    """What the answers of several seeds leave to the best known mounting, and how far apart they lie.

    Parameters
    ----------
    answers : sequence of dict
        Of each seed: ``mounting``, its value ``per_vehicle``, and ``evaluations``.
    best, baseline : float
        Objective per vehicle of the best grid point and of the baseline, on the frames of the search.
    judged : sequence of float
        Objective per vehicle of the baseline and of each answer, on the frames that judge.
    leans : bool
        Whether orientations are told by their lean, not by tilts and yaw.
    """
    value = f"{len(answers)} seeds of {answers[0]['evaluations']:,} evaluations"
    values = np.array([answer["per_vehicle"] for answer in answers])
    best = max(best, float(values.max()))
    if not best > baseline:
        return [Finding(SEARCH, "regret", value, UNDECIDED, "no mounting is better than the baseline")]
    left = (best - values) / (best - baseline)
    text = f"median {percent(float(np.median(left)))}, worst {percent(float(left.max()))} of the gain"
    regret = Finding(SEARCH, "regret", value, by_loss(float(left.max())), text, {"regrets": left.tolist()})
    return [regret, _spread(answers, value, judged, leans)]


def _spread(answers: Sequence[dict], value: str, judged: Sequence[float], leans: bool) -> Finding:
    """How far apart answers lie, judged by what the least of them loses to the best on other traffic."""
    mountings = [with_lean(answer["mounting"]) if leans else answer["mounting"] for answer in answers]
    places, texts = {}, []
    for key, (name, unit, digits) in _NAMES.items():
        found = [mounting[key] for mounting in mountings if mounting.get(key) is not None]
        if not found or (leans and key in ANGLES):
            continue
        if key == "lean_direction_deg":  # on the circle, told about the first
            found = [found[0] + math.remainder(angle - found[0], 360.0) for angle in found]
        if (
            key in ("height_m", "tilt_x_deg", "lean_deg") or len(set(found)) > 1
        ):  # of the others nothing is told that all answers share
            places[key] = found
            texts.append(f"{name.removesuffix(_ACROSS)} {min(found):.{digits}f} to {max(found):.{digits}f} {unit}")
    gains = np.array(judged[1:]) - judged[0]
    loss = float(1.0 - gains.min() / gains.max()) if gains.max() > 0.0 else None
    if loss is not None:
        texts.append(f"on the frames that judge the least of them gains {percent(loss)} less than the best")
    return Finding(SEARCH, "spread of the answers", value, by_loss(loss), ", ".join(texts), {"loss": loss, **places})
