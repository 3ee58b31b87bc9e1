"""The ladder of fidelities: what each costs, how near it comes to the reference, and the cheapest that is near enough.

Every level of detail with every share of beams and frames, and then what changes no result: other casters, casting
without culling, and the ground cast too. Each is timed, scored on the same mountings, and compared with the first.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial

import numpy as np

from ..casting import CASTERS, RASTER, caster_class, is_available
from ..scene.observation import CountedFrame
from ..scene.site import Site
from ..scoring.fidelity import Fidelity, coarse_observation, evenly_spread
from ..scoring.scores import VehicleScores, mountings_of
from ..sensors.beams import beam_lattice
from ..sensors.pose import Pose
from ..world.shapes import DETAILS
from ..world.triangles import vehicle_triangles
from .driver import HELD_OUT, Job, Landscape, StudyFolder, Variation, frame_scorer, judging_split
from .effects import Candidates, Noise, Reference, accuracy, pareto_front
from .experiments import grounded

BEST_DETAIL = DETAILS[-1]
REFERENCE = Fidelity(BEST_DETAIL)
STRIDES = (1, 2, 4, 8)
FRAME_SHARES = (1, 2, 4, 8)  # one of so many frames is looked at
ORACLE = "exact"
LADDER = "ladder"


@dataclass(frozen=True, slots=True)
class ChartEffort:
    """How much of everything is done.

    Attributes
    ----------
    frames : int or None
        Searched frames that the reference looks at, spread evenly; None takes them all.
    mountings : int
        Of Sobol's sequence, an even number: each half is judged by a calibration fitted on the other.
    few_mountings : int
        Of these, those on which it is checked that casters, culling and the ground change nothing.
    varied_mountings : int
        Those on which the ablations are scored: so many of the best by the reference.
    draws : int
        How many units, or draws of noise, stand for a sensor that is imperfect at random.
    other_mountings : int
        Those on which another sensor is scored.
    phases : int
        How many phases of a stride are averaged at most.
    rounds : int
        How often each evaluation is timed.
    hit_frames, hit_mountings : int
        On how many the casters' hits are compared with the float64 oracle's.
    quick : bool
        Whether this is the quick chart, for what knows only that.
    """

    frames: int | None
    mountings: int
    few_mountings: int
    varied_mountings: int
    draws: int
    other_mountings: int
    phases: int
    rounds: int
    hit_frames: int
    hit_mountings: int
    quick: bool


FULL_CHART = ChartEffort(None, 128, 8, 64, 6, 64, phases=2, rounds=5, hit_frames=3, hit_mountings=3, quick=False)
QUICK_CHART = ChartEffort(10, 64, 4, 64, 2, 64, phases=2, rounds=5, hit_frames=1, hit_mountings=2, quick=True)


# --- the rungs --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class LadderRung:
    """One fidelity of the ladder.

    Attributes
    ----------
    fidelity : Fidelity
        Its phase is 0; `phased` has the others.
    twin : Fidelity or None
        Where casting differs in speed alone: the fidelity that must come to the same, and whose figures it then has.
    """

    fidelity: Fidelity
    twin: Fidelity | None = None


def ladder(site: Site) -> list[LadderRung]:
    """All rungs, the reference first; strides leave a turn at least a few columns."""
    strides = [stride for stride in STRIDES if site.observation.lattice.columns >= 4 * stride]
    rungs = [
        LadderRung(Fidelity(detail, stride, frames=frames))
        for detail in reversed(DETAILS)
        for stride in strides
        for frames in frame_counts(len(site.search))
    ]
    others = other_casters(site)
    rungs += [LadderRung(Fidelity(one, caster=caster), Fidelity(one)) for caster in others for one in reversed(DETAILS)]
    own = Fidelity(site.scenario.world.detail)
    rungs.append(LadderRung(replace(own, ground=True), own))
    culling = [None] if site.observation.caster != RASTER else others[:1]  # `raster` never culls: the first other one
    return [*rungs, *(LadderRung(replace(own, caster=caster, culled=False), own) for caster in culling)]


def other_casters(site: Site) -> list[str]:
    """The casters that are installed, but for the scene's own and the oracle."""
    return [name for name in CASTERS if name not in (ORACLE, site.observation.caster) and is_available(name)]


def frame_counts(frames: int) -> list[int | None]:
    """How many frames each share leaves, None for all of them; a count that another share has too is left out."""
    counts = [max(round(frames / share), 1) for share in FRAME_SHARES[1:]]
    return [None, *dict.fromkeys(count for count in counts if count != frames)]


def phased(fidelity: Fidelity, most: int) -> list[Fidelity]:
    """The fidelity on all frames, at all phases of its stride or at so many of them, spread evenly."""
    kept = min(fidelity.stride, most)
    return [replace(whole(fidelity), phase=fidelity.stride * number // kept) for number in range(kept)]


def whole(fidelity: Fidelity) -> Fidelity:
    """The same on all frames: what looks at fewer of them takes their columns of what all come to."""
    return replace(fidelity, frames=None)


def variation(fidelity: Fidelity, section: str = LADDER) -> Variation:
    """A fidelity as a change of the site; the number of frames stays."""
    seen = partial(at_fidelity, fidelity=whole(fidelity))
    scorer = grounded if fidelity.ground else frame_scorer
    return Variation(section, whole(fidelity).name, f"phase {fidelity.phase}", seen, scorer=scorer)


def at_fidelity(site: Site, fidelity: Fidelity) -> Site:
    """The site at a fidelity but for frames and ground; fewer beams are scored on larger cells.

    Raises
    ------
    InputError
        For a stride beyond the columns of a turn.
    """
    return replace(site, observation=coarse_observation(site.observation, fidelity))


# --- times ------------------------------------------------------------------------------------------------------------

TOGETHER = 4  # mountings that are scored together; a search asks for a swarm of them
Times = Mapping[Fidelity, tuple[np.ndarray, np.ndarray]]
"""Of each fidelity on all frames: seconds of one mounting of those scored together, (rounds, f), and to build, (f,)."""


def time_fidelities(
    site: Site,
    fidelities: Sequence[Fidelity],
    poses: Sequence[Pose],
    rounds: int,
    progress: Callable[[int], None] = lambda frames: None,
) -> Times:
    """Time fidelities frame by frame, in one process, warm; all of them have every frame.

    On each frame they take turns, each round with other mountings, so that a moment in which the machine is busy with
    something else falls on all. The first round, in which caches fill, is not counted. To build is to make triangles
    and tree; `progress` is told how many frames have been timed since it was last called.
    """
    changes = [variation(fidelity) for fidelity in fidelities]
    sites = [change.changed(site) for change in changes]
    scores = [VehicleScores(one.scoring, one.observation, site.search) for one in sites]
    evaluation, build = np.empty((len(sites), rounds, len(site.search))), np.empty((len(sites), len(site.search)))
    for column, frame in enumerate(site.search):
        scorers = []
        for row, (change, one) in enumerate(zip(changes, sites, strict=True)):
            start = time.perf_counter()
            scorers.append(change.scorer(one, frame))
            build[row, column] = time.perf_counter() - start
        for turn in range(-1, rounds):
            some = [poses[(turn + number) % len(poses)] for number in range(TOGETHER)]
            for row in np.roll(np.arange(len(sites)), turn).tolist():
                start = time.perf_counter()
                scores[row].of(frame, scorers[row], some, mountings_of(some)).objective.sum(axis=1)
                if turn >= 0:
                    evaluation[row, turn, column] = (time.perf_counter() - start) / TOGETHER
        progress(1)
    return dict(zip(fidelities, zip(evaluation, build, strict=True), strict=True))


# --- hits beside the float64 oracle -----------------------------------------------------------------------------------

_STRIDE = 4  # of the oracle's columns: it is slow


def count_hits(site: Site, frames: Sequence[CountedFrame], poses: Sequence[Pose], casters: Sequence[str]) -> list[dict]:
    """What casters hit beside the oracle, on a few frames from a few mountings: `differing_hits` at each detail."""
    lattice = beam_lattice(site.model, site.observation.lattice.rotation_hz, stride=_STRIDE)
    counts = []
    for detail in DETAILS:
        hits = {name: [] for name in (ORACLE, *casters)}
        for triangles in (vehicle_triangles(frame.vehicles, detail) for frame in frames):
            for name, met in hits.items():
                tree = caster_class(name)(triangles.corners, closed=True)
                for pose in poses:
                    rays = pose.to_world(lattice.directions.reshape(-1, 3))
                    found = tree.cast(pose.position, rays, site.observation.max_range_m)
                    owner = np.where(found.triangle >= 0, triangles.owner[found.triangle], -1)
                    met.append((found.distance, owner))
        oracle, *others = (list(map(np.concatenate, zip(*met, strict=True))) for met in hits.values())
        pairs = zip(casters, others, strict=True)
        counts += [{"caster": name, "detail": detail, **differing_hits(oracle, found)} for name, found in pairs]
    return counts


def differing_hits(oracle: Sequence[np.ndarray], found: Sequence[np.ndarray]) -> dict[str, float]:
    """How many rays differ from the oracle's, both given as ranges [m] and rows of the vehicles that they meet, (n,).

    Returns
    -------
    dict
        ``rays`` cast, ``hits`` by the oracle, ``hit_or_miss``: rays that only one of the two has meeting anything,
        ``vehicle``: rays that meet different vehicles, ``largest_range_m`` between ranges to the same vehicle [m].
    """
    (true_range, true_owner), (range_m, owner) = oracle, found
    hit, true_hit = np.isfinite(range_m), np.isfinite(true_range)
    both = hit & true_hit
    same = both & (owner == true_owner)
    return {
        "rays": len(hit),
        "hits": int(true_hit.sum()),
        "hit_or_miss": int((hit != true_hit).sum()),
        "vehicle": int((both & ~same).sum()),
        "largest_range_m": float(np.abs(range_m[same] - true_range[same]).max(initial=0.0)),
    }


# --- scores -----------------------------------------------------------------------------------------------------------


def score_ladder(
    folder: StudyFolder, site: Site, every: Candidates, effort: ChartEffort, rungs: Sequence[LadderRung]
) -> tuple[dict[Fidelity, Landscape], Landscape]:
    """Landscapes of all fidelities and phases on all frames, and that of the reference on the frames that judge.

    Rungs with a twin are scored on the first few mountings.
    """
    plain = dict.fromkeys(
        phase for rung in rungs if rung.twin is None for phase in phased(rung.fidelity, effort.phases)
    )
    twins, few = [rung.fidelity for rung in rungs if rung.twin is not None], every.poses[: 1 + effort.few_mountings]
    jobs = [Job(variation(one), every.poses) for one in plain] + [Job(variation(one), few) for one in twins]
    if judging_split(site) == HELD_OUT:
        jobs.append(Job(variation(REFERENCE), every.poses, HELD_OUT))
    found = folder.landscapes(site, jobs, "mountings scored")
    scored = dict(zip((*plain, *twins), found, strict=False))
    return scored, found[-1] if judging_split(site) == HELD_OUT else scored[REFERENCE]


# --- which are near enough: asked in an order that their losses have no say in, so that luck passes none --------------
# Of fifty fidelities, each asked by itself at 95 %, the fastest that passes may well owe its place to luck. So each
# level of detail is a sequence of its own, from the fidelity that casts the most beams to the one that casts the
# fewest, which ends at the first that cannot be shown to be near enough: in a fixed sequence every test may take the
# whole level (Maurer, Hothorn and Lehmacher 1995). Times, which a busy machine may turn round, have no say in it
# either. The levels of detail share the 5 % evenly (Bonferroni). With 95 % or more, then, none of those that pass loses
# more than the tolerance, given what was chosen on the searched frames: the bounds tell of other frames that judge, not
# of others that choose, which the exchange of blocks asks for once.

SAME = 1e-9  # of a score, relative: what differs by less has met the same hits


def mark_within(rows: Sequence[dict], tolerance: float, noise: Noise | None, gain: float) -> None:
    """Mark the rows that are asked, and those near enough to the reference, which is the first row.

    What a fidelity is for is to choose: so what its choices lose on held-out frames must be within the tolerance, by an
    upper bound at `BOUND_LEVEL`. And its error after calibration must be within it too, or within the noise ceiling: no
    closer does the traffic tell the truth itself. What comes to the same as another fidelity shares its answer.
    """
    most = max(tolerance, 0.0 if noise is None else noise.error / gain) if gain > 0.0 else 0.0
    for row in rows:
        row["asked"] = row["within"] = row is rows[0]
    for detail in DETAILS:
        own = [row for row in rows[1:] if row["detail"] == detail and row["twin"] is None]
        for row in sorted(own, key=lambda row: (row["frames"] / row["stride"], row["frames"]), reverse=True):
            bound, error = row["regret_bound"], row["error_share"]
            row["asked"] = True
            row["within"] = bool(None not in (bound, error) and bound <= tolerance and error <= most)
            if not row["within"]:
                break
    within = {row["name"]: row["within"] for row in rows}
    for row in rows:
        if row["twin"] is not None:
            row["within"] = bool(row["same_as_twin"]) and within[row["twin"]]


def rung_rows(
    rungs: Iterable[LadderRung], reference: Reference, scored: Mapping[Fidelity, Landscape], timed: Times, phases: int
) -> list[dict]:
    """A row for each rung, the reference first: its time and its accuracy, as JSON holds it.

    A rung that ought to come to the same as its twin, and does not, has None for its accuracy.
    """
    of_reference = np.median(_seconds(REFERENCE, timed))
    rows = []
    for rung in rungs:
        fidelity, of, same = rung.fidelity, rung.twin or rung.fidelity, None
        if rung.twin is not None:
            few, many = scored[fidelity].objective, scored[rung.twin].objective
            same = bool(np.allclose(few, many[: len(few)], rtol=SAME, atol=SAME))
        first, median, third = 1e3 * np.quantile(_seconds(fidelity, timed), [0.25, 0.5, 0.75])
        found = [scored[phase] for phase in phased(of, phases)]
        known = accuracy(reference, found, looked_at(of, len(reference.searched.vehicles)))
        same_for_all = {key: value for key, value in asdict(fidelity).items() if key != "phase"}
        row = {"name": fidelity.name, "text": fidelity.text, **same_for_all}
        row["frames"] = fidelity.frames or len(reference.searched.vehicles)
        row |= {"twin": rung.twin and rung.twin.name, "same_as_twin": same}
        row["milliseconds"] = {"first_quartile": first, "median": median, "third_quartile": third}
        row["build_milliseconds_per_frame"] = float(1e3 * np.median(timed[whole(fidelity)][1]))
        row["speedup"] = float(of_reference * 1e3 / median)
        rows.append(row | (dict.fromkeys(known) if same is False else known))
    known = [row for row in rows if row["error"] is not None]
    front = pareto_front(*np.array([(row["milliseconds"]["median"], row["error"]) for row in known]).T)
    best = [known[number]["name"] for number in front]
    for row in rows:
        row["pareto"] = row["name"] in best
    return rows


def looked_at(fidelity: Fidelity, searched: int, frames: int | None = None) -> np.ndarray:
    """Rows of the frames that a fidelity looks at: of the searched ones, or as large a share of so many others."""
    frames = searched if frames is None else frames
    kept = frames if fidelity.frames is None else max(round(fidelity.frames * frames / searched), 1)
    return evenly_spread(frames, kept)


def _seconds(fidelity: Fidelity, timed: Times) -> np.ndarray:
    """Seconds that one evaluation by a fidelity took in each round, (rounds,)."""
    each, _ = timed[whole(fidelity)]
    return each[:, looked_at(fidelity, each.shape[1])].sum(axis=1)


def recommended(rows: Sequence[dict]) -> dict:
    """The fastest of those that are near enough, the reference being one, with culling and without the ground."""
    plain = (row for row in rows if row["within"] and row["culled"] and not row["ground"])
    return min(plain, key=lambda row: row["milliseconds"]["median"])


def sentence(reference: Mapping, best: Mapping, tolerance: float, gain: float) -> str:
    """Which fidelity is the cheapest within the tolerance, what it costs, and by how much it is the faster."""
    if not gain > 0.0:
        return "No mounting gains anything over the baseline: there is nothing that a fidelity could lose."
    share = f"{100.0 * tolerance:g} % of the gain"
    took = milliseconds(best["milliseconds"]["median"])
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
