"""The chart of a scene: time against accuracy of cheaper models, and what each ingredient of the model changes.

A ladder of fidelities is timed, scored on the same mountings and compared with its first, the reference; ablations are
scored on the best mountings. The result is one dictionary.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from ..scene.mounting import Layout, poses_of
from ..scene.site import Site
from ..scoring.fidelity import Fidelity, evenly_spread, with_fewer_frames
from ..scoring.frame_scorer import FrameScorer
from ..scoring.scores import VehicleScores
from ..world.shapes import DETAILS
from .candidates import BASELINE, FIRST, Candidates, sobol_candidates
from .driver import HELD_OUT, Job, Landscape, StudyFolder, judging_split, split_of, study_head
from .effects import BOUND_LEVEL, SURE, Noise, Reference, compared, pareto_front, verdict
from .variations import ABLATION, Ablation, Variation, ablations, of_fidelity, whole, with_only

CHART_SCHEMA = 5  # of the stages and of the result
REFERENCE = Fidelity(DETAILS[-1])
STRIDES = (1, 2, 4, 8)
FRAME_SHARES = (1, 2, 4, 8)  # one of so many frames is looked at


@dataclass(frozen=True, slots=True)
class ChartEffort:
    """How much of everything is done.

    Attributes
    ----------
    frames : int or None
        Searched frames that the reference looks at, spread evenly; None takes them all.
    mountings : int
        Of Sobol's sequence, an even number: each half is judged by a calibration fitted on the other.
    varied_mountings : int
        Those on which the ablations are scored: so many of the best by the reference.
    draws : int
        How many units, or draws of noise, stand for a sensor that is imperfect at random.
    phases : int
        How many phases of a stride are averaged at most.
    rounds : int
        How often each evaluation is timed.
    quick : bool
        Whether this is the quick chart, for what knows only that.
    """

    frames: int | None
    mountings: int
    varied_mountings: int
    draws: int
    phases: int
    rounds: int
    quick: bool


FULL_CHART = ChartEffort(None, 128, 64, 6, phases=2, rounds=5, quick=False)
QUICK_CHART = ChartEffort(10, 64, 64, 2, phases=2, rounds=5, quick=True)


def chart_identity(site: Site, effort: ChartEffort) -> dict[str, object]:
    """What two runs of the study must share for the second to go on with the first's stages."""
    asked = {f"chart {name}": value for name, value in asdict(effort).items()}
    return {**site.identity, **asked, "chart schema": CHART_SCHEMA}


def chart_study(site: Site, effort: ChartEffort, tolerance: float, folder: StudyFolder) -> dict:
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

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    site = with_fewer_frames(site, effort.frames)
    every, rungs, judging = sobol_candidates(site.scenario, effort.mountings), ladder(site), judging_split(site)
    timed = _timed(folder, site, list(dict.fromkeys(map(whole, rungs))), every, effort)
    scored, judged = score_ladder(folder, site, every, effort, rungs)
    judged_block = split_of(site, judging)[1]
    reference = Reference(scored[REFERENCE], site.plan.search_block, judged, judged_block, site.scenario.search.seed)
    gain, noise = reference.gain, reference.noise
    rows = rung_rows(rungs, reference, scored, timed, effort.phases)
    mark_within(rows, tolerance, noise, gain)
    best = recommended(rows)
    numbers = reference.best(effort.varied_mountings)
    few, kept = reference.select(numbers), [BASELINE, *(FIRST + number for number in numbers)]
    fusion, alone = _fusion(folder, site, every.select(numbers))
    changes = [*ablations(site, effort.draws), *fusion]
    known = {of_fidelity(one).stage: scored[one].select(kept) for one in map(Fidelity, DETAILS)} | alone
    return {
        **study_head(site, CHART_SCHEMA, effort),
        "range_gate_m": site.scenario.range_gate_m,
        "blocks": len(np.unique(reference.searched_block)),
        "vehicles": int(reference.searched.vehicles.sum()),
        "judged_on": judging,
        "judged_frames": len(judged_block),
        "judged_blocks": len(np.unique(judged_block)),
        "mountings": effort.mountings,
        "baseline_per_vehicle": float(reference.searched.per_vehicle()[BASELINE]),
        "gain_per_vehicle": gain,
        "tolerance": tolerance,
        "sure": SURE,
        "bound_level": BOUND_LEVEL,
        "reference": rows[0]["name"],
        "noise": noise and asdict(noise),
        "rungs": rows,
        "recommended": best["name"],
        "sentence": sentence(rows[0], best, tolerance, gain),
        "ablation_mountings": min(effort.varied_mountings, effort.mountings),
        "ablation_floor": few.noise and asdict(few.noise),
        "ablations": ablation_rows(folder, site, every.select(numbers), few, changes, known, tolerance),
    }


# --- the rungs --------------------------------------------------------------------------------------------------------


def ladder(site: Site) -> list[Fidelity]:
    """Every level of detail with every share of beams and frames, the reference first.

    Strides leave a turn at least a few columns.
    """
    columns = min(lidar.lattice.columns for lidar in site.observation.lidars)
    strides = [stride for stride in STRIDES if columns >= 4 * stride]
    return [
        Fidelity(detail, stride, frames=frames)
        for detail in reversed(DETAILS)
        for stride in strides
        for frames in frame_counts(len(site.search))
    ]


def frame_counts(frames: int) -> list[int | None]:
    """How many frames each share leaves, None for all of them; a count that another share has too is left out."""
    counts = [max(round(frames / share), 1) for share in FRAME_SHARES[1:]]
    return [None, *dict.fromkeys(count for count in counts if count != frames)]


def phased(fidelity: Fidelity, most: int) -> list[Fidelity]:
    """The fidelity on all frames, at all phases of its stride or at so many of them, spread evenly."""
    kept = min(fidelity.stride, most)
    return [replace(whole(fidelity), phase=fidelity.stride * number // kept) for number in range(kept)]


def looked_at(fidelity: Fidelity, searched: int, frames: int | None = None) -> np.ndarray:
    """Rows of the frames that a fidelity looks at: of the searched ones, or as large a share of so many others."""
    frames = searched if frames is None else frames
    kept = frames if fidelity.frames is None else max(round(fidelity.frames * frames / searched), 1)
    return evenly_spread(frames, kept)


# --- times ------------------------------------------------------------------------------------------------------------

TOGETHER = 4  # mountings that are scored together; a search asks for a swarm of them
Times = Mapping[Fidelity, tuple[np.ndarray, np.ndarray]]
"""Of each fidelity on all frames: seconds of one mounting of those scored together, (rounds, f), and to build, (f,)."""


def _timed(
    folder: StudyFolder, site: Site, fidelities: Sequence[Fidelity], every: Candidates, effort: ChartEffort
) -> Times:
    """Each fidelity on all frames, from the folder if it holds the times."""

    def measure() -> list:
        layouts = every.layouts[FIRST : FIRST + effort.rounds + TOGETHER]
        with folder.counting(len(site.search), "frames timed") as shown:
            timed = time_fidelities(site, fidelities, layouts, effort.rounds, shown.advance)
        return [[part.tolist() for part in both] for both in timed.values()]

    stored = folder.stage("times", measure)
    return {fidelity: tuple(map(np.array, both)) for fidelity, both in zip(fidelities, stored, strict=True)}


def time_fidelities(
    site: Site,
    fidelities: Sequence[Fidelity],
    layouts: Sequence[Layout],
    rounds: int,
    progress: Callable[[int], None] = lambda frames: None,
) -> Times:
    """Time fidelities frame by frame, in one process, warm; all of them have every frame.

    On each frame they take turns, each round with other mountings, so that a moment in which the machine is busy with
    something else falls on all. The first round, in which caches fill, is not counted. To build is to make triangles
    and tree; `progress` is called with the number of frames timed since the last call.
    """
    poses = list(map(poses_of, layouts))
    sites = [of_fidelity(fidelity).changed(site) for fidelity in fidelities]
    scores = [VehicleScores(one.scoring, one.observation, site.search) for one in sites]
    evaluation, build = np.empty((len(sites), rounds, len(site.search))), np.empty((len(sites), len(site.search)))
    for column, frame in enumerate(site.search):
        scorers = []
        for row, one in enumerate(sites):
            start = time.perf_counter()
            scorers.append(FrameScorer(frame, one.observation))
            build[row, column] = time.perf_counter() - start
        for turn in range(-1, rounds):
            some = [poses[(turn + number) % len(poses)] for number in range(TOGETHER)]
            for row in np.roll(np.arange(len(sites)), turn).tolist():
                start = time.perf_counter()
                scores[row].of(frame, scorers[row], some).objective.sum(axis=1)
                if turn >= 0:
                    evaluation[row, turn, column] = (time.perf_counter() - start) / TOGETHER
        progress(1)
    return dict(zip(fidelities, zip(evaluation, build, strict=True), strict=True))


# --- scores and rows of the ladder ------------------------------------------------------------------------------------


def score_ladder(
    folder: StudyFolder, site: Site, every: Candidates, effort: ChartEffort, rungs: Sequence[Fidelity]
) -> tuple[dict[Fidelity, Landscape], Landscape]:
    """Landscapes of all fidelities and phases on all frames, and that of the reference on the frames that judge."""
    phases = list(dict.fromkeys(phase for rung in rungs for phase in phased(rung, effort.phases)))
    jobs = [Job(of_fidelity(one), every.layouts) for one in phases]
    if judging_split(site) == HELD_OUT:
        jobs.append(Job(of_fidelity(REFERENCE), every.layouts, HELD_OUT))
    found = folder.landscapes(site, jobs, "mountings scored")
    scored = dict(zip(phases, found, strict=False))
    return scored, found[-1] if judging_split(site) == HELD_OUT else scored[REFERENCE]


def rung_rows(
    rungs: Iterable[Fidelity], reference: Reference, scored: Mapping[Fidelity, Landscape], timed: Times, phases: int
) -> list[dict]:
    """A row for each rung, the reference first: its time and its accuracy, as JSON holds it."""
    frames, rows = len(reference.searched.vehicles), []
    of_reference = np.median(_seconds(REFERENCE, timed))
    for rung in rungs:
        first, median, third = 1e3 * np.quantile(_seconds(rung, timed), [0.25, 0.5, 0.75])
        row = {"name": rung.name, "text": rung.text, "detail": rung.detail, "stride": rung.stride}
        row["frames"] = rung.frames or frames
        row["milliseconds"] = {"first_quartile": first, "median": median, "third_quartile": third}
        row["build_milliseconds_per_frame"] = float(1e3 * np.median(timed[whole(rung)][1]))
        row["speedup"] = float(of_reference * 1e3 / median)
        found = [(scored[phase], reference.searched, reference.judged) for phase in phased(rung, phases)]
        rows.append(row | accuracy(compared(found, reference, looked_at(rung, frames)), reference.gain))
    front = pareto_front(*np.array([(row["milliseconds"]["median"], row["error"]) for row in rows]).T)
    return [{**row, "pareto": number in front} for number, row in enumerate(rows)]


def accuracy(found: Mapping, gain: float) -> dict[str, object]:
    """How near a fidelity comes to the reference, of what it is `compared` by, as JSON holds it.

    Its ``error_share`` of the gain, and an upper ``regret_bound`` at `BOUND_LEVEL`; None for what cannot be known.
    """
    lost, error = found["lost"], found["error"]
    return {
        "bias": found["bias"],
        "error": error,
        "error_share": error / gain if gain > 0.0 else None,
        "tau": found["tau"],
        "regret": lost and lost.share,
        "regret_interval_90": lost and lost.interval_90,
        "regret_bound": lost and lost.bound(BOUND_LEVEL),
    }


def _seconds(fidelity: Fidelity, timed: Times) -> np.ndarray:
    """Seconds that one evaluation by a fidelity took in each round, (rounds,)."""
    each, _ = timed[whole(fidelity)]
    return each[:, looked_at(fidelity, each.shape[1])].sum(axis=1)


# --- which are near enough: asked in an order that does not depend on their losses, so that luck passes none ----------
# Of fifty fidelities, each asked by itself at 95 %, the fastest that passes may well owe its place to luck. So each
# level of detail is a sequence of its own, from the fidelity that casts the most beams to the one that casts the
# fewest, which ends at the first that cannot be shown to be near enough: in a fixed sequence every test may take the
# whole level (Maurer, Hothorn and Lehmacher 1995). Times, which a busy machine may turn round, do not count
# either. The levels of detail share the 5 % evenly (Bonferroni). With 95 % or more, then, none of those that pass loses
# more than the tolerance, given what was chosen on the searched frames: the bounds tell of other frames that judge, not
# of others that choose, which the exchange of blocks asks for once.


def mark_within(rows: Sequence[dict], tolerance: float, noise: Noise | None, gain: float) -> None:
    """Mark the rows that are asked, and those near enough to the reference, which is the first row.

    What a fidelity is for is to choose: so what its choices lose on held-out frames must be within the tolerance, by an
    upper bound at `BOUND_LEVEL`. And its error after calibration must be within it too, or within the noise ceiling: no
    closer does the traffic tell the truth itself.
    """
    most = max(tolerance, 0.0 if noise is None else noise.error / gain) if gain > 0.0 else 0.0
    for row in rows:
        row["asked"] = row["within"] = row is rows[0]
    for detail in DETAILS:
        own = [row for row in rows[1:] if row["detail"] == detail]
        for row in sorted(own, key=lambda row: (row["frames"] / row["stride"], row["frames"]), reverse=True):
            bound, error = row["regret_bound"], row["error_share"]
            row["asked"] = True
            row["within"] = bool(None not in (bound, error) and bound <= tolerance and error <= most)
            if not row["within"]:
                break


def recommended(rows: Sequence[dict]) -> dict:
    """The fastest of those that are near enough, the reference being one."""
    return min((row for row in rows if row["within"]), key=lambda row: row["milliseconds"]["median"])


def sentence(reference: Mapping, best: Mapping, tolerance: float, gain: float) -> str:
    """Which fidelity is the cheapest within the tolerance, what it costs, and by how much it is the faster."""
    if not gain > 0.0:
        return "No mounting gains anything over the baseline: there is nothing that a fidelity could lose."
    share, took = f"{100.0 * tolerance:g} % of the gain", milliseconds(best["milliseconds"]["median"])
    if best["name"] == reference["name"]:
        only = f"only the reference, {best['text']}: {took} an evaluation"
        return f"No cheaper fidelity can be shown to be within {share}: {only}."
    return (
        f"Cheapest within {share}: {best['text']}: {took} an evaluation, {best['speedup']:.2g} times faster than the "
        f"reference ({reference['text']})."
    )


def milliseconds(value: float) -> str:
    """A time in three digits: ms, or s from a second on."""
    if value >= 1000.0:
        return f"{value / 1000.0:.3g} s"
    return f"{value:.3g} ms" if value < 100.0 else f"{value:.0f} ms"


# --- the ablations: a row for each ------------------------------------------------------------------------------------


def ablation_rows(
    folder: StudyFolder,
    site: Site,
    every: Candidates,
    reference: Reference,
    changes: Sequence[Ablation],
    known: Mapping[str, Landscape],
    tolerance: float,
) -> list[dict]:
    """A row for every ablation; what either side would choose is judged where the scene has the thing.

    Parameters
    ----------
    folder : StudyFolder
    site : Site
    every : Candidates
        On which they are compared.
    reference : Reference
        Of these candidates.
    changes : sequence of Ablation
    known : mapping of str to Landscape
        By a variation's stage, what has been scored already.
    tolerance : float
        Share of the gain that may be lost where a thing is left out.
    """
    sides = {one.stage: one for change in changes for pair in change.pairs for one in pair}
    jobs = [Job(one, every.layouts) for stage, one in sides.items() if stage not in known]
    found = folder.landscapes(site, jobs, "ablations scored")
    scored = {**known, **{job.variation.stage: one for job, one in zip(jobs, found, strict=True)}}
    judged = scored
    if judging_split(site) == HELD_OUT:
        having = {there.stage: replace(there, section="judged") for change in changes for _, there in change.pairs}
        jobs = [Job(one, every.layouts, HELD_OUT) for one in having.values()]
        judged = dict(zip(having, folder.landscapes(site, jobs, "ablations judged"), strict=True))
    rows = []
    for change in changes:
        draws = [(scored[without.stage], scored[there.stage], judged[there.stage]) for without, there in change.pairs]
        refused = next((one for draw in draws for one in draw if isinstance(one, str)), None)
        rows.append(ablation_row(change, refused, [] if refused else draws, every, reference, tolerance))
    return rows


def _fusion(folder: StudyFolder, site: Site, every: Candidates) -> tuple[list[Ablation], dict[str, Landscape]]:
    """The ablation of fusing several LiDARs; its side without is the mean of what each comes to alone, by its stage."""
    names = [lidar.name for lidar in site.observation.lidars]
    if len(names) == 1:
        return [], {}
    alone = [Variation(ABLATION, "only", name, partial(with_only, names=[name])) for name in names]
    found = folder.landscapes(site, [Job(one, every.layouts) for one in alone], "LiDARs scored alone")
    mean = replace(found[0], objective=np.mean([one.objective for one in found], axis=0))
    without = Variation(ABLATION, "fusion", "each alone")
    own = of_fidelity(Fidelity(site.scenario.world.detail))
    return [Ablation("fusion", "scored together, not one by one", ((without, own),))], {without.stage: mean}


def ablation_row(
    change: Ablation,
    refused: str | None,
    draws: Sequence[tuple[Landscape, Landscape, Landscape]],
    every: Candidates,
    reference: Reference,
    tolerance: float,
) -> dict:
    """One ablation as JSON holds it: all but its name is None where there is nothing to compare.

    ``bias``: what the thing adds to the mean score per vehicle. ``regret``: what is lost where it is left out.
    """
    row = {"what": change.what, "value": change.value, "note": refused or change.note, "draws": len(change.pairs)}
    if not draws:
        return row | dict.fromkeys(("bias", "tau", "regret", "regret_interval_90", "shift", "beyond_noise", "verdict"))
    found, floor = compared(draws, reference), reference.noise
    without, having = found["chosen"] @ every.points
    lost, shift = found["lost"], dict(zip(every.variables, (having - without).tolist(), strict=True))
    interval = lost and lost.interval_90
    row |= {"bias": -found["bias"], "tau": found["tau"], "regret": lost and lost.share, "regret_interval_90": interval}
    row |= {"shift": shift, "beyond_noise": None}
    if floor is not None:
        low = found["tau"] is not None and found["tau"] < floor.tau
        row["beyond_noise"] = {"score": abs(found["bias"]) > floor.bias, "ranking": low}
    return row | {"verdict": verdict(interval, tolerance)}
