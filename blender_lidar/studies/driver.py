"""Change one thing about a scene and score its mountings again: one driver for all studies.

A `Variation` changes a site; a `Job` asks what mountings come to on its frames, which is a `Landscape`. `landscapes`
scores jobs frame by frame over several processes, of one machine or many; `Stages` stores each landscape in the
study's folder as soon as it is known, so that a study that was killed goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import InputError
from ..files import check_folder, folder_lock, make_folder, read_text, sweep, write_text
from ..metrics.vgop import occupancy
from ..scene.observation import CountedFrame
from ..scene.provenance import check_identity
from ..scene.site import Site
from ..scoring.evaluation import workplace_of
from ..scoring.frame_scorer import FrameScorer, Seen
from ..scoring.scores import VehicleScores, mountings_of
from ..sensors.pose import Pose
from ..statistics import block_sums
from ..traffic.vehicles import Vehicles

# --- the folder: each stage is stored whole when it ends --------------------------------------------------------------

IDENTITY = "study.json"
STAGES = "stages"
_DIGEST, _VALUE = "sha256", "value"  # of a stored stage


class StudyFolder:
    """A folder in which a study leaves its stages and its results; it is made when `locked`.

    Parameters
    ----------
    path : path
        Where it is, or will be.
    identity : mapping
        What must be the same for two runs to come to the same: settings, content of files, versions. As JSON holds it.
    results : iterable of str
        Names of the files that the study will write, besides its stages.
    """

    def __init__(self, path: str | Path, identity: Mapping[str, object], results: Iterable[str] = ()) -> None:
        self.path = Path(path)
        self._identity = json.loads(json.dumps(identity))
        self._results = tuple(results)

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
            When it holds a study and `resume` is False, one with other settings, or files of the same names that no
            study has written.
        """
        check_folder(self.path, "--out")
        if self.file(IDENTITY).exists():
            self._check_identity(resume)
            return
        present = [name for name in self._results if self.file(name).exists()]
        stages = self.file(STAGES)
        if stages.is_file() or any(stages.glob("*")):  # an empty folder is what `locked` makes
            present.insert(0, STAGES)
        if present:
            raise InputError(f"--out: {self.path}: holds {present[0]}, which no study has written; give another folder")

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
        make_folder(self.file(STAGES), "--out")
        with folder_lock(self.path):
            self.check(resume=resume)  # again: another run may have come between the first check and the lock
            if not self.file(IDENTITY).exists():
                write_text(self.file(IDENTITY), json.dumps(self._identity, indent=2) + "\n")
            for folder in (self.path, self.file(STAGES), *map(self.file, self._results)):
                if folder.is_dir():
                    sweep(folder)
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
        """Store a stage, whole or not at all, with the digest of its text."""
        text = json.dumps(value)
        write_text(self._stage(name), f'{{"{_DIGEST}": "{_digest(text)}", "{_VALUE}": {text}}}\n')

    def stored(self, name: str) -> object:
        """A stage from its file: the same to the last digit whether it was stored just now or by an earlier run.

        Raises
        ------
        InputError
            When the stored file is not as a run has left it.
        """
        path = self._stage(name)
        try:
            stored = json.loads(read_text(path))
            if not isinstance(stored, dict) or set(stored) != {_DIGEST, _VALUE}:
                raise ValueError("it holds no stage")
            if stored[_DIGEST] != _digest(json.dumps(stored[_VALUE])):
                raise ValueError("its content has changed")
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: is damaged: {error}; remove it to have it made again") from error
        return stored[_VALUE]

    def _stage(self, name: str) -> Path:
        return self.file(STAGES) / f"{name}.json"

    def _check_identity(self, resume: bool) -> None:
        path = self.file(IDENTITY)
        try:
            stored = json.loads(read_text(path))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        if not isinstance(stored, dict):
            raise InputError(f"{path}: is no file of a study")
        if not resume:
            raise InputError(
                f"--out: {self.path}: holds a study already; give another folder, or go on with it: --resume"
            )
        check_identity(stored, self._identity, f"{self.path}: the study there")


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


# --- what is changed, and what is scored ------------------------------------------------------------------------------


class Scorer(Protocol):
    """What sees one frame from mountings: `FrameScorer`, or what an experiment puts in its place."""

    vehicles: Vehicles

    def __len__(self) -> int:
        """Vehicles that count."""

    def see(self, poses: Sequence[Pose], *, keep_returns: bool = False) -> Seen:
        """As `FrameScorer.see`."""


def frame_scorer(site: Site, frame: CountedFrame) -> Scorer:
    """The product's own way to see a frame."""
    return FrameScorer(frame.vehicles, frame.counted, site.observation)


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
    scorer : callable
        What sees a frame of the changed site; it can be pickled.
    cast_anew : bool
        False where the returns stay as the site has them and only what is made of them changes: cells, view,
        threshold, penalty, metric.
    """

    section: str
    what: str
    value: str
    changed: Callable[[Site], Site] = unchanged
    draw: int = 0
    scorer: Callable[[Site, CountedFrame], Scorer] = frame_scorer
    cast_anew: bool = True

    @property
    def stage(self) -> str:
        """A name for a file."""
        words = f"{self.section} {self.what} {self.value} {self.draw or ''}".lower()
        return "_".join("".join(sign if sign.isalnum() or sign in "-." else " " for sign in words).split())


AS_IT_IS = Variation("", "as the scene has it", "", cast_anew=False)
SEARCHED, HELD_OUT = "searched", "held out"


@dataclass(frozen=True, slots=True)
class Job:
    """Mountings to score on one variation's frames, `SEARCHED` or `HELD_OUT`."""

    variation: Variation
    poses: tuple[Pose, ...]
    split: str = SEARCHED

    @property
    def stage(self) -> str:
        """A name for a file."""
        return f"{self.variation.stage}_{self.split.replace(' ', '_')}"


def split_of(site: Site, split: str) -> tuple[tuple[CountedFrame, ...], np.ndarray]:
    """The frames of a split, and the block of time (f,) that each belongs to."""
    return (site.search, site.plan.search_block) if split == SEARCHED else (site.holdout, site.plan.holdout_block)


def judging_split(site: Site) -> str:
    """The held-out frames, or the searched ones where nothing is held out."""
    return HELD_OUT if any(frame.counted.any() for frame in site.holdout) else SEARCHED


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """Objective of mountings, frame by frame.

    Attributes
    ----------
    objective : ndarray, (m, f)
        Sum over the counted vehicles of each frame, in the metric's unit.
    vehicles : ndarray of int64, (f,)
        Vehicles that count.
    """

    objective: np.ndarray
    vehicles: np.ndarray

    def per_vehicle(self) -> np.ndarray:
        """Objective per counted vehicle of each mounting, (m,)."""
        return self.objective.sum(axis=1) / self.vehicles.sum()

    def select(self, rows: Sequence[int]) -> Landscape:
        """Some of its mountings."""
        return Landscape(self.objective[list(rows)], self.vehicles)

    def blocks(self, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Objective (m, b) and vehicles (b,) of each block of time; `block` (f,) labels the frames."""
        return block_sums(self.objective, block), block_sums(self.vehicles, block)


# --- scoring ----------------------------------------------------------------------------------------------------------

_MOUNTINGS_AT_A_TIME = 32  # so that all points of a frame that a metric looks at fit into memory


def landscapes(
    site: Site, jobs: Sequence[Job], progress: Callable[[int], None] = lambda frames: None
) -> Iterator[Landscape | str]:
    """What the mountings of each job come to, in the order of the jobs; a text where the site cannot be changed so.

    Jobs that follow each other and need no cast of their own share one, and are known together.

    Parameters
    ----------
    site : Site
    jobs : sequence of Job
    progress : callable
        Told how many frames of jobs have been scored since it was last called.
    """
    alike = groupby(enumerate(jobs), lambda one: (one[1].split, one[0] if one[1].variation.cast_anew else -1))
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


def _joined(columns: Sequence[tuple[np.ndarray, int] | str]) -> Landscape | str:
    if isinstance(columns[0], str):
        return columns[0]
    objective, vehicles = zip(*columns, strict=True)
    landscape = Landscape(np.stack(objective, axis=1), np.array(vehicles, dtype=np.int64))
    return landscape if landscape.vehicles.sum() else "no vehicle is left in the region"


class _FrameOfCast:
    """Scores one frame for jobs that share a cast; changed sites are kept until other jobs are asked for."""

    def __init__(self, site: Site, casts: Sequence[tuple[Job, ...]]) -> None:
        self._site, self._casts = site, casts
        self._number, self._changed = -1, []

    def score(self, number: int, frame: int) -> list[tuple[np.ndarray, int] | str]:
        """Of each job the objective of its mountings, (m,), and the counted vehicles; or why there is no such site."""
        jobs = self._casts[number]
        if number != self._number:
            self._number, self._changed = number, [self._change(job) for job in jobs]
        if len(jobs) > 1:
            return self._together(jobs, frame)
        ((job,), (changed,)) = jobs, self._changed
        if isinstance(changed, str):
            return [changed]
        site, scores = changed
        chosen = split_of(site, job.split)[0][frame]
        scorer = job.variation.scorer(site, chosen)
        return [(_objective(scores, chosen, scorer, job.poses), int(chosen.counted.sum()))]

    def _together(self, jobs: tuple[Job, ...], frame: int) -> list[tuple[np.ndarray, int] | str]:
        """The same of jobs whose returns are those of the site as it is: cast once, scored for each of them."""
        chosen = split_of(self._site, jobs[0].split)[0][frame]
        scorer, own = frame_scorer(self._site, chosen), self._site.observation
        every = list(dict.fromkeys(pose for job in jobs for pose in job.poses))
        wanted, objective = [set(job.poses) for job in jobs], [dict[Pose, float]() for _ in jobs]
        for poses in _batches(every):
            seen = {(own.cell_m, own.reading): scorer.see(poses, keep_returns=True)}
            for own_poses, of, changed in zip(wanted, objective, self._changed, strict=True):
                asked = [row for row, pose in enumerate(poses) if pose in own_poses]
                if isinstance(changed, str) or not asked:
                    continue
                site, scores = changed
                cells = site.observation.cell_m, site.observation.reading
                if cells not in seen:
                    seen[cells] = _on_cells(seen[own.cell_m, own.reading], scorer.vehicles, *cells)
                again, some = _SeenAgain(scorer.vehicles, seen[cells], asked), [poses[row] for row in asked]
                of.update(zip(some, _objective(scores, chosen, again, some), strict=True))
        return [
            changed
            if isinstance(changed, str)
            else (np.array([of[pose] for pose in job.poses]), int(chosen.counted.sum()))
            for job, changed, of in zip(jobs, self._changed, objective, strict=True)
        ]

    def _change(self, job: Job) -> tuple[Site, VehicleScores] | str:
        try:
            site = job.variation.changed(self._site)
        except InputError as error:
            return str(error)
        return site, VehicleScores(site.scoring, site.observation, split_of(site, job.split)[0])


def _batches(poses: Sequence[Pose]) -> Iterator[Sequence[Pose]]:
    return (poses[first : first + _MOUNTINGS_AT_A_TIME] for first in range(0, len(poses), _MOUNTINGS_AT_A_TIME))


def _objective(scores: VehicleScores, frame: CountedFrame, scorer: Scorer, poses: Sequence[Pose]) -> np.ndarray:
    """Objective of each mounting on a frame, (m,)."""
    parts = [scores.of(frame, scorer, some, mountings_of(some)).objective.sum(axis=1) for some in _batches(poses)]
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True)
class _SeenAgain:
    """A scorer of what has been seen already from some mountings, by their rows."""

    vehicles: Vehicles
    seen: Seen
    rows: Sequence[int]

    def __len__(self) -> int:
        return len(self.vehicles)

    def see(self, poses: Sequence[Pose], *, keep_returns: bool = False) -> Seen:
        """As `FrameScorer.see`, of all these rows, whatever the mountings."""
        points, shares, returns = self.seen
        if keep_returns and len(self.rows) < len(points):
            local, owner = returns
            mount, vehicle = np.divmod(owner, len(self))
            kept = np.isin(mount, self.rows)
            returns = local[kept], np.searchsorted(self.rows, mount[kept]) * len(self) + vehicle[kept]
        return Seen(points[self.rows], shares[self.rows], returns if keep_returns else None)


def _on_cells(seen: Seen, vehicles: Vehicles, cell_m: float, reading: str) -> Seen:
    """The same returns on cells of another side."""
    sizes = np.tile(vehicles.size_m, (len(seen.points), 1))
    return seen._replace(occupancy=occupancy(*seen.returns, sizes, cell_m, reading).reshape(seen.occupancy.shape))


# --- landscapes as stages of a study ----------------------------------------------------------------------------------


class Counter(Protocol):
    """Shows how far a part of the study has come."""

    def advance(self, steps: int) -> None:
        """Count `steps` more."""

    def close(self) -> None:
        """The part has ended."""


CounterMaker = Callable[[int, str], Counter]
"""Makes a counter up to a total, for what is counted."""


class Stages:
    """A study's folder, locked by the caller, and how its progress is told."""

    def __init__(self, folder: StudyFolder, counter: CounterMaker) -> None:
        self.folder, self._counter = folder, counter
        self.stage = folder.stage

    def landscapes(self, site: Site, jobs: Sequence[Job], what: str) -> list[Landscape | str]:
        """What the mountings of each job come to, stored as soon as it is known."""
        missing = [job for job in jobs if not self.folder.holds(job.stage)]
        if missing:
            frames = sum(len(split_of(site, job.split)[0]) for job in missing)
            with (
                self.counting(frames, what) as advance,
                closing(landscapes(site, missing, advance)) as found,  # a stop ends its processes
            ):
                for job, one in zip(missing, found, strict=True):
                    told = one if isinstance(one, str) else [one.objective.tolist(), one.vehicles.tolist()]
                    self.folder.store(job.stage, told)
        every = (self.folder.stored(job.stage) for job in jobs)
        return [one if isinstance(one, str) else Landscape(np.array(one[0]), np.array(one[1])) for one in every]

    @contextmanager
    def counting(self, total: int, what: str) -> Iterator[Callable[[int], None]]:
        """A counter that is closed when the block ends."""
        shown = self._counter(total, what)
        try:
            yield shown.advance
        finally:
            shown.close()
