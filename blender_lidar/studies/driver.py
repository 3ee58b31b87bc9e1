"""Change one thing about a scene and score its mountings again: one driver for all studies.

A `Variation` changes a site; a `Job` asks what mountings come to on its frames, which is a `Landscape`. `landscapes`
scores jobs frame by frame over several processes, of one machine or many; a `StudyFolder` stores each landscape as soon
as it is known, so that a study that was killed goes on where it stopped.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, astuple, dataclass, replace
from itertools import groupby
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import check_folder, check_unused, folder_lock, make_folder, read_text, sweep, write_text
from ..metrics.catalogue import metric_named
from ..metrics.vgop import occupancy
from ..run.optimise import sensors_text
from ..scene.deployment import Installer
from ..scene.installation import installed_layout, latin_errors
from ..scene.mounting import Layout, poses_of
from ..scene.observation import Observation
from ..scene.provenance import check_identity, versions
from ..scene.site import Site
from ..scoring.evaluation import workplace_of
from ..scoring.frame_scorer import FrameScorer, Seen
from ..scoring.scores import VehicleScores
from ..statistics import block_sums
from ..traffic.boxes import Boxes

# --- what all results say ---------------------------------------------------------------------------------------------


def percent(share: float | None, interval: Sequence[float] | None = None) -> str:
    """A share in per cent, and its interval where there is one; nothing for None, and no sign for what rounds to 0."""
    texts = [f"{round(100.0 * one, 1) + 0.0:.1f}" for one in (share, *(interval or ())) if one is not None]
    return "" if share is None else f"{texts[0]} %" + (f" ({' to '.join(texts[1:])})" if interval else "")


def study_head(site: Site, schema: int, effort) -> dict[str, object]:
    """What the results of all studies say of a site, as JSON holds it; `effort` says how much of everything is done."""
    metric = metric_named(site.scoring.metric)
    return {
        "schema": schema,
        "scene": Path(site.scenario.source).name,
        "sensor": sensors_text(site),
        "caster": site.observation.caster,
        "detail": site.observation.detail,
        "metric": site.scoring.metric,
        "metric_unit": metric.unit,
        "seed": site.scenario.search.seed,
        "frames": len(site.search),
        "effort": asdict(effort),
        "warnings": site.recording.report.warnings_as_dicts(),
        "notes": list(site.plan.notes),
        "versions": versions(site.observation.caster),
    }


# --- the folder: each stage is stored whole when it ends --------------------------------------------------------------

IDENTITY = "study.json"
STAGES = "stages"


class StudyFolder:
    """A folder in which a study leaves its stages and its results; it is made when `locked`.

    Parameters
    ----------
    path : path
        Where it is, or will be.
    identity : mapping
        What must be the same for two runs to come to the same: settings, content of files, versions. As JSON holds it.
    counter : callable, optional
        Makes what shows progress from a total and what is counted: it has `advance` and `close`.
    """

    def __init__(self, path: str | Path, identity: Mapping, counter=None) -> None:
        self.path, self._counter = Path(path), counter
        self._identity = json.loads(json.dumps(identity))

    def file(self, name: str) -> Path:
        """Path of a file of the study."""
        return self.path / name

    def check(self, *, resume: bool = False) -> None:
        """Refuse a place that this study must not write to.

        Raises
        ------
        OutputError
            When there can be no folder.
        InputError
            When it holds a study and `resume` is False, one with other settings, or files but no study.
        """
        check_folder(self.path, "--out")
        if not self.file(IDENTITY).exists():
            check_unused(self.path, "--out", "study")
            return
        stored = _read_json(self.file(IDENTITY))
        if not resume:
            where = f"--out: {self.path}"
            raise InputError(f"{where}: holds a study already; give another folder, or go on with it: --resume")
        check_identity(stored, self._identity, f"{self.path}: the study there")

    @contextmanager
    def locked(self, *, resume: bool = False) -> Iterator[StudyFolder]:
        """Make the folder and keep other processes out of it while the block lasts.

        Raises
        ------
        OutputError
            When another run is at work there, or the folder cannot be made or written.
        InputError
            As `check`.
        """
        self.check(resume=resume)
        with folder_lock(self.path):
            self.check(resume=resume)  # again: another run may have come between the first check and the lock
            if not self.file(IDENTITY).exists():
                write_text(self.file(IDENTITY), json.dumps(self._identity, indent=2) + "\n")
            make_folder(self.file(STAGES), "--out")
            sweep(self.file(STAGES))
            yield self

    def holds(self, name: str) -> bool:
        """Whether an earlier run has stored that stage."""
        return self._stage(name).exists()

    def stage(self, name: str, compute: Callable[[], object]) -> object:
        """What `compute` returns, from the folder if an earlier run has stored it there; as `stored` reads it."""
        if not self.holds(name):
            self.store(name, compute())
        return self.stored(name)

    def store(self, name: str, value: object) -> None:
        """Store a stage, whole or not at all."""
        write_text(self._stage(name), json.dumps(value) + "\n")

    def stored(self, name: str) -> object:
        """A stage from its file: the same to the last digit whether it was stored just now or by an earlier run.

        Raises
        ------
        InputError
            When the stored file is not as a run has left it.
        """
        return _read_json(self._stage(name), "; remove it to have it made again")

    def counting(self, total: int, what: str):
        """A context in which steps are counted up to a total, by `advance`."""
        return closing(self._counter(total, what))

    def landscapes(self, site: Site, jobs: Sequence[Job], what: str) -> list[Landscape | str]:
        """`landscapes` of jobs, each stored as soon as it is known."""
        missing = [job for job in jobs if not self.holds(job.stage)]
        if missing:
            frames = sum(len(split_of(site, job.split)[0]) for job in missing)
            with (
                self.counting(frames, what) as shown,
                closing(landscapes(site, missing, shown.advance)) as found,  # a stop ends its processes
            ):
                for job, one in zip(missing, found, strict=True):
                    kept = one if isinstance(one, str) else [each.tolist() for each in astuple(one)]
                    self.store(job.stage, kept)
        every = (self.stored(job.stage) for job in jobs)
        return [one if isinstance(one, str) else Landscape(*map(np.array, one)) for one in every]

    def _stage(self, name: str) -> Path:
        return self.file(STAGES) / f"{name}.json"


def _read_json(path: Path, advice: str = "") -> object:
    """The content of a file; one that is damaged is refused with some advice."""
    try:
        return json.loads(read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: is damaged: {error}{advice}") from error


# --- what is changed, and what is scored ------------------------------------------------------------------------------


def unchanged(site: Site) -> Site:
    """The site as it is."""
    return site


@dataclass(frozen=True, slots=True)
class Variation:
    """One thing changed about a site.

    Attributes
    ----------
    section : str
        What sort of thing it is.
    what, value : str
        What is changed, and to what.
    changed : callable
        Makes the changed site of a site; it can be pickled, and the number of frames stays.
    draw : int
        Which of several random draws of the same change it is, from 1; 0 where nothing is drawn.
    recast : bool
        False where the returns stay as the site has them and only what is made of them changes: cells, view,
        threshold, penalty, metric.
    installers : sequence of Installer
        Of each LiDAR, where each frame is scored under installation errors of its own; none unless said.
    """

    section: str
    what: str
    value: str
    changed: Callable[[Site], Site] = unchanged
    draw: int = 0
    recast: bool = True
    installers: tuple[Installer, ...] = ()

    @property
    def stage(self) -> str:
        """A name for a file."""
        words = f"{self.section} {self.what} {self.value} {self.draw or ''}".lower()
        return "_".join("".join(sign if sign.isalnum() or sign in "-." else " " for sign in words).split())


AS_IT_IS = Variation("", "as the scene has it", "", recast=False)
SEARCHED, HELD_OUT = "searched", "held out"


@dataclass(frozen=True, slots=True)
class Job:
    """Mountings to score on one variation's frames, `SEARCHED` or `HELD_OUT`."""

    variation: Variation
    layouts: tuple[Layout, ...]
    split: str = SEARCHED

    @property
    def stage(self) -> str:
        """A name for a file."""
        return f"{self.variation.stage}_{self.split.replace(' ', '_')}"


def split_of(site: Site, split: str) -> tuple[tuple[Boxes, ...], np.ndarray]:
    """The frames of a split, and the block of time (f,) that each belongs to."""
    return (site.search, site.plan.search_block) if split == SEARCHED else (site.holdout, site.plan.holdout_block)


def judging_split(site: Site) -> str:
    """The held-out frames, or the searched ones where nothing is held out."""
    return HELD_OUT if any(frame.counted_weight.any() for frame in site.holdout) else SEARCHED


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """Objective of mountings, frame by frame.

    Attributes
    ----------
    objective : ndarray, (m, f)
        Sum over the counted vehicles of each frame, in the metric's unit.
    vehicles : ndarray of int64, (f,)
        Vehicles that count.
    weight : ndarray, (f,)
        Sum of their weights; unless given they weigh one.
    detectable : ndarray, (m, f)
        How many of them are detectable from each mounting.
    """

    objective: np.ndarray
    vehicles: np.ndarray
    weight: np.ndarray | None = None
    detectable: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.weight is None:
            object.__setattr__(self, "weight", self.vehicles)
        if self.detectable is None:
            object.__setattr__(self, "detectable", np.full(self.objective.shape, np.nan))

    def per_vehicle(self, frames: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Objective per counted vehicle of each mounting, a weighted mean, (m,); on the rows `frames` alone."""
        return self.objective[:, frames].sum(axis=1) / (self.weight[frames].sum() or 1)

    def detectable_share(self) -> np.ndarray:
        """Share of the vehicles that are detectable from each mounting, (m,); every vehicle counts the same."""
        return self.detectable.sum(axis=1) / self.vehicles.sum()

    def select(self, rows: Sequence[int]) -> Landscape:
        """Some of its mountings."""
        rows = list(rows)
        return replace(self, objective=self.objective[rows], detectable=self.detectable[rows])

    def blocks(self, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Objective (m, b) and weight of the vehicles (b,) of each block of time; `block` (f,) labels the frames."""
        return block_sums(self.objective, block), block_sums(self.weight, block)


# --- scoring ----------------------------------------------------------------------------------------------------------

_ERRORS, _STREAM = 4, 3  # installation errors of each frame, and what they are drawn from besides the seed
_MOUNTINGS_AT_A_TIME = 32  # so that all points of a frame that a metric looks at fit into memory


def landscapes(
    site: Site, jobs: Sequence[Job], progress: Callable[[int], None] = lambda frames: None
) -> Iterator[Landscape | str]:
    """What the mountings of each job come to, in the order of the jobs; a text where the site cannot be changed so.

    Jobs of the same mountings that follow each other and need no cast of their own share one, and are known together.

    Parameters
    ----------
    site : Site
    jobs : sequence of Job
    progress : callable
        Called with the number of frames of jobs that have been scored since the last call.
    """
    alike = groupby(
        enumerate(jobs), lambda one: (one[1].split, one[1].layouts, one[0] if one[1].variation.recast else -1)
    )
    casts = [tuple(job for _, job in some) for _, some in alike]
    frames = [len(split_of(site, cast[0].split)[0]) for cast in casts]
    tasks = [(number, frame) for number, count in enumerate(frames) for frame in range(count)]
    workers = workplace_of(site.scenario.model).employ(_FrameOfCast(site, casts).score, len(tasks))
    try:
        found = workers.each(*zip(*tasks, strict=True)) if tasks else iter(())
        for cast, count in zip(casts, frames, strict=True):
            scored = []
            for _ in range(count):
                scored.append(next(found))
                progress(len(cast))
            for columns in zip(*scored, strict=True):
                yield _joined(columns)
    finally:
        workers.close()


def _joined(columns: Sequence[tuple[np.ndarray, np.ndarray, int, float] | str]) -> Landscape | str:
    if isinstance(columns[0], str):
        return columns[0]
    objective, detectable, vehicles, weight = zip(*columns, strict=True)
    counts = np.array(vehicles, dtype=np.int64), np.array(weight), np.stack(detectable, axis=1)
    landscape = Landscape(np.stack(objective, axis=1), *counts)
    return landscape if landscape.weight.sum() else "no vehicle is left in the region"


class _FrameOfCast:
    """Scores one frame for jobs that share a cast; changed sites are kept until other jobs are asked for."""

    def __init__(self, site: Site, casts: Sequence[tuple[Job, ...]]) -> None:
        self._site, self._casts = site, casts
        self._number, self._changed, self._errors = -1, [], None

    def score(self, number: int, frame: int) -> list[tuple[np.ndarray, np.ndarray, int, float] | str]:
        """Of each job the objective and the detectable vehicles of its mountings, (m,), the counted vehicles and their
        weight; or why there is no such site.

        What is cast is the site as it is where several jobs share that, else the only job's site.
        """
        jobs = self._casts[number]
        if number != self._number:
            self._number, self._changed = number, [self._change(job) for job in jobs]
            self._errors = self._errors_of(jobs[0])
        known = [one for one in self._changed if not isinstance(one, str)]
        if not known:
            return self._changed
        shared, layouts = len(jobs) > 1, jobs[0].layouts
        site = self._site if shared else known[0][0]
        chosen = split_of(site, jobs[0].split)[0][frame]
        if self._errors is not None:
            layouts = [installed_layout(one, error) for one in layouts for error in self._errors[frame]]
        scorer, parts = FrameScorer(chosen, site.observation), []
        for first in range(0, len(layouts), _MOUNTINGS_AT_A_TIME):
            poses = list(map(poses_of, layouts[first : first + _MOUNTINGS_AT_A_TIME]))
            cast = scorer.see(poses, keep_returns=shared or known[0][1].needs_returns)
            for own, scores in known:
                seen = _on_cells_of(own.observation, cast, site.observation, scorer.vehicles.size_m)
                scored = scores.of_seen(chosen, scorer, seen, poses)
                parts.append([scored.objective.sum(axis=1), scored.detectable.sum(axis=1)])
        sums = [np.concatenate(parts[row :: len(known)], axis=1) for row in range(len(known))]
        sums = iter(one.reshape(2, len(jobs[0].layouts), -1).mean(axis=2) for one in sums)
        size = len(scorer), chosen.counted_weight.sum().item()
        return [one if isinstance(one, str) else (*next(sums), *size) for one in self._changed]

    def _errors_of(self, job: Job) -> np.ndarray | None:
        """Installation errors of each frame, (f, e, l, 4); None where mountings hang as planned."""
        installers, seed = job.variation.installers, self._site.scenario.search.seed
        frames = len(split_of(self._site, job.split)[0])
        # What judges has errors of its own, or those that chose would judge.
        return latin_errors(installers, frames, _ERRORS, [seed, _STREAM, job.split == HELD_OUT]) if installers else None

    def _change(self, job: Job) -> tuple[Site, VehicleScores] | str:
        try:
            site = job.variation.changed(self._site)
        except InputError as error:
            return str(error)
        return site, VehicleScores(site.scoring, site.observation, split_of(site, job.split)[0])


def _on_cells_of(own: Observation, seen: Seen, cast: Observation, size_m: np.ndarray) -> Seen:
    """What has been seen by an observation, `cast`, with its returns; its occupancies on the cells of another."""
    cells = own.cell_m, own.reading
    if cells == (cast.cell_m, cast.reading):
        return seen
    shares = occupancy(*seen.returns, np.tile(size_m, (len(seen.points), 1)), *cells)
    return seen._replace(occupancy=shares.reshape(seen.occupancy.shape))
