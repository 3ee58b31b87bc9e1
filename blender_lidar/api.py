"""The Python interface: scenes, mountings, clouds and their scores, as `import blender_lidar as bl` gives them.

Coordinates of a mounting are keywords in metres and degrees: ``x_m, y_m, height_m, tilt_x_deg, tilt_y_deg, yaw_deg``;
what is left out is the scene's baseline. Tables are pandas DataFrames where pandas is installed, else dictionaries of
arrays. What cannot be used raises an `InputError`, which is a ValueError, with what was given and what is allowed.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from .clouds.files import read_points, write_cloud
from .clouds.scan import PointCloud, class_names
from .clouds.snapshot import mounted_sensor
from .commands.options import scene_settings
from .commands.parsers import ScoreOptions
from .commands.progress import RunProgress
from .commands.report import outcome_text
from .commands.score import boxes_of, metrics_of, score_table
from .errors import InputError, unknown_name
from .files import write_bytes
from .metrics.catalogue import metric_named
from .optimise import Search
from .optimise.multi_fidelity import MultiFidelitySearch
from .report.summary import answer, key_figures
from .run.folder import HISTORY, Outcome, RunFolder
from .run.optimise import evaluate_site, optimise_site
from .run.verdict import POINTS, vehicle_table
from .scene.scenario import load_scenario, pose_at
from .scene.settings import MOUNTING
from .scene.site import Site, check_mount_is_clear, frame_of, prepare, reach_of
from .scoring.evaluation import Evaluator, site_evaluator
from .toml_table import checked, settings_of
from .traffic.vehicles import Vehicles

Progress = Callable[[int, int, str], None]
"""Called with how much is done, of how much, and the best so far in words."""


def load_scene(path: str | Path, **settings: object) -> Site:
    """A scene file made ready: traffic read, frames chosen and held out, beams made.

    Parameters
    ----------
    path : path
        The TOML file, or ``"i80"``, which ships with the package.
    **settings
        In place of the file's, called as the command line's options with an underscore for each hyphen:
        ``sensor="RS-80", frames=10, frame_ids=[100, 150], metric="points", workers=1, tolerance={"tilt_deg": 1.0}``.

    Raises
    ------
    BlenderLidarError
        When a file or a value cannot be used, or no vehicle is in the region.
    """
    known = scene_settings()
    for name in settings:
        if name not in known:
            raise unknown_name(name, known, "setting", "load_scene")
    given = {name: str(value) if isinstance(value, Path) else value for name, value in settings.items()}
    overrides = {known[name]: (value, f"load_scene: {name}") for name, value in given.items()}
    return prepare(load_scenario(path, overrides))


# --- The best mounting, and what a run came to ------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Run:
    """What a run came to; as text it is the sentence of its report, in a notebook that and its key figures.

    Attributes
    ----------
    outcome : Outcome
        Its folder and its vehicle tables.
    complete : bool
        Whether the search came to its end; where it was stopped its best so far is judged.
    site : Site
        What the mounting was judged on.
    """

    outcome: Outcome
    complete: bool
    site: Site
    _kept: TemporaryDirectory | None = None  # the folder of a run that leaves nothing behind

    @property
    def result(self) -> dict[str, Any]:
        """The content of result.json."""
        return self.outcome.result

    @property
    def mounting(self) -> dict[str, float]:
        """The six coordinates [m, degrees]."""
        return dict(self.result["deployment"])

    @property
    def vehicles(self):
        """What the mounting sees of each vehicle in each frame: a table in the columns of vehicles.csv."""
        return _table(self.outcome.optimised)

    @property
    def baseline_vehicles(self):
        """The same vehicles under the baseline."""
        return _table(self.outcome.baseline)

    @property
    def history(self):
        """Every evaluation of the search, a table in the columns of history.csv; None for a given mounting."""
        if not self.outcome.folder.file(HISTORY).exists():
            return None
        rows, variables = self.outcome.folder.read_history(), self.site.scenario.deployment.variables
        names = ("evaluation", "iteration", "particle", *variables, "objective", "best")
        return _table(dict(zip(names, rows.T, strict=True)))

    @property
    def score_map(self):
        """Objective and detectable share over heights and tilts, a table; None where the run has no map."""
        found = self.outcome.folder.read_score_map()
        if found is None:
            return None
        height, tilt = np.meshgrid(found.height_m, found.tilt_deg, indexing="ij")
        scores = {"objective_per_vehicle": found.per_vehicle, "detectable_share": found.detectable_share}
        columns = {"height_m": height, "tilt_x_deg": tilt, **scores}
        return _table({name: values.ravel() for name, values in columns.items()})

    @property
    def plot(self) -> Plots:
        """Its pictures, each drawn when it is called."""
        return Plots(self)

    def report(self) -> str:
        """All that the command line prints of it."""
        return outcome_text(self.outcome, "")

    def __str__(self) -> str:
        return answer(self.result)

    def _repr_html_(self) -> str:
        figures = "".join(
            f"<tr><th>{html.escape(what)}</th><td>{html.escape(figure)}</td></tr>"
            for what, figure in key_figures(self.result)
        )
        stopped = "" if self.complete else "<p>The search was stopped; this is its best so far.</p>"
        return f"<p>{html.escape(str(self))}</p>{stopped}<table>{figures}</table>"


class Picture(bytes):
    """A picture as PNG, which a notebook shows."""

    def _repr_png_(self) -> bytes:
        return bytes(self)

    def write(self, path: str | Path) -> None:
        """Write it, whole or not at all."""
        write_bytes(path, bytes(self))


@dataclass(frozen=True)
class Plots:
    """The pictures of a run; they need matplotlib (the extra "plots")."""

    run: Run

    def score_map(self) -> Picture:
        """Objective over height and tilt, with the optimum and the baseline."""
        found = self.run.outcome.folder.read_score_map()
        if found is None:
            raise InputError("score_map: the run has none: it was no full search, or it was stopped")
        return self._drawn("plot_score_map", score_map=found)

    def search(self) -> Picture:
        """How the best objective rose with the number of mountings tried."""
        if not self.run.outcome.folder.file(HISTORY).exists():
            raise InputError("search: the run has no history: its mounting was given, or it was stopped")
        return self._drawn("plot_convergence", history=self.run.outcome.folder.read_history())

    def by_distance(self) -> Picture:
        """Scores and detectable shares by distance, before and after."""
        return self._drawn("plot_by_distance")

    def blind_zones(self) -> Picture:
        """Where on the road vehicles are not detectable, before and after."""
        return self._drawn("plot_blind_zones", road=self.run.site.scenario.road)

    def _drawn(self, name: str, **settings) -> Picture:
        from .report import run_figures

        with TemporaryDirectory() as folder:
            path = Path(folder, "picture.png")
            getattr(run_figures, name)(path, run=self.run.outcome, **settings)
            return Picture(path.read_bytes())


class _Heard:
    """Listens to a run: keeps its search, of which the best is wanted if it is stopped, and passes progress on."""

    def __init__(self, site: Site, told: Progress | None) -> None:
        self._metric, self._told, self._points = metric_named(site.scoring.metric), told, 0
        self.search: Search | MultiFidelitySearch | None = None

    def __enter__(self) -> _Heard:
        return self

    def __exit__(self, *exception) -> None:
        pass

    def searching(self, search: Search | MultiFidelitySearch) -> None:
        self.search = search
        if self._told is not None:
            known = np.isfinite(search.best_value)
            self._told(search.evaluations, search.budget, self._metric.amount(search.best_value) if known else "")

    def mapping(self, points: int) -> None:
        self._points += points
        if self._told is not None:
            self._told(self._points, POINTS[0] * POINTS[1], "map of heights and tilts")


class _HeardAndShown(_Heard):
    """The same, and shows a bar."""

    def __init__(self, site: Site) -> None:
        super().__init__(site, None)
        self._shown = RunProgress(site.scenario.deployment.variables, self._metric)

    def __exit__(self, *exception) -> None:
        self._shown.__exit__(*exception)

    def searching(self, search: Search | MultiFidelitySearch) -> None:
        super().searching(search)
        self._shown.searching(search)

    def mapping(self, points: int) -> None:
        self._shown.mapping(points)


def best_mounting(
    site: Site, out: str | Path | None = None, *, progress: bool | Progress = False, resume: bool = False
) -> Run:
    """Search the mounting with the highest objective and judge it on held-out traffic: what `optimise` does.

    Parameters
    ----------
    site : Site
        From `load_scene`.
    out : path, optional
        Folder that keeps the results; without it nothing is left behind.
    progress : bool or callable
        True shows a bar; a function is called with how much is done, of how much, and the best so far in words.
    resume : bool
        Go on with the search in `out` that was stopped.

    Returns
    -------
    Run
        Of a search that Ctrl-C stops its best so far, judged, with `complete` False; `out` can then be resumed.
    """
    if not site.scenario.deployment.bounds:
        raise InputError(f"{site.scenario.source}: [deployment] fixes every coordinate; give one a pair [low, high]")
    if resume and out is None:
        raise InputError("best_mounting: resume needs out, the folder of the run that was stopped")
    listener = _HeardAndShown(site) if progress is True else _Heard(site, progress or None)
    kept = TemporaryDirectory(prefix="blender_lidar-") if out is None else None
    folder = RunFolder(kept.name if kept else out)
    folder.check(resume=resume)
    try:
        with folder.locked(), listener:
            if not (resume and folder.read_result(site.identity)):
                optimise_site(site, folder, listener, resume=resume)
        return Run(folder.read_outcome(), True, site, kept)
    except KeyboardInterrupt:
        if listener.search is None or not np.isfinite(listener.search.best_value):
            raise
        best = site.scenario.deployment.coordinates(listener.search.best_x)
        return replace(judge_mounting(site, **best), complete=False)


def judge_mounting(site: Site, out: str | Path | None = None, **mounting: float) -> Run:
    """Judge one mounting beside the baseline, on searched and held-out frames: what `evaluate` does.

    Parameters
    ----------
    site, out
        As for `best_mounting`.
    **mounting : float
        Its coordinates [m, degrees]; those left out are the baseline's.
    """
    place = _mounting(site, mounting)
    site = _reaching(site, [place])
    kept = TemporaryDirectory(prefix="blender_lidar-") if out is None else None
    folder = RunFolder(kept.name if kept else out)
    folder.check()
    with folder.locked():
        evaluate_site(site, folder, place)
    return Run(folder.read_outcome(), True, site, kept)


# --- Scores of mountings on the searched frames -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Score:
    """What a mounting comes to on a site's frames.

    Attributes
    ----------
    mounting : dict of str to float
        The six coordinates [m, degrees].
    objective, objective_per_vehicle : float
        Eq. 10, in the metric's unit: its sum, and its mean over the vehicles.
    detectable_share : float
        Share of the vehicles at or above the threshold.
    vehicles : DataFrame or dict of ndarray
        What it sees of each vehicle in each frame, in the columns of vehicles.csv.
    """

    mounting: dict[str, float]
    objective: float
    objective_per_vehicle: float
    detectable_share: float
    vehicles: Any


def score_mounting(site: Site, *, held_out: bool = False, **mounting: float) -> Score:
    """Score one mounting, its coordinates as keywords [m, degrees], on the searched frames, or the held-out ones."""
    place = _mounting(site, mounting)
    site = _reaching(site, [place])
    evaluator = Evaluator(_frames(site, held_out), site.observation, site.scoring)
    pose = pose_at(place)
    totals = evaluator.totals([pose])
    scores = float(totals.objective.sum()), float(totals.per_vehicle()[0]), float(totals.detectable_share()[0])
    table = vehicle_table(pose, **{"holdout" if held_out else "search": evaluator})
    return Score(place, *scores, _table(table))


def score_mountings(site: Site, table, *, held_out: bool = False):
    """Score many mountings in several processes, on the searched frames or the held-out ones.

    Parameters
    ----------
    site : Site
        From `load_scene`.
    table : DataFrame, mapping of str to (s,) values, or sequence of mappings
        The mountings, by the names of their coordinates [m, degrees]; what has no column is the baseline's.
    held_out : bool
        Whether the held-out frames are scored instead of the searched ones.

    Returns
    -------
    DataFrame or dict of ndarray, (s,)
        The six coordinates, `objective`, `objective_per_vehicle` and `detectable_share`.
    """
    if isinstance(table, Sequence):
        rows = [_mounting(site, row) for row in table]
    else:
        names, columns = list(table), [np.asarray(table[name]) for name in table]
        if len({column.shape for column in columns}) > 1 or any(column.ndim != 1 for column in columns):
            shapes = ", ".join(f"{name} {column.shape}" for name, column in zip(names, columns, strict=True))
            raise InputError(f"score_mountings: columns have shapes {shapes}; allowed: (s,), all of one length")
        rows = [_mounting(site, dict(zip(names, row, strict=True))) for row in zip(*columns, strict=True)]
    if not rows:
        raise InputError("score_mountings: the table is empty; allowed: one row for each mounting")
    site = _reaching(site, rows)
    with site_evaluator(site, _frames(site, held_out)) as evaluator:
        totals = evaluator.totals([pose_at(row) for row in rows])
    scores = {
        "objective": totals.objective.sum(axis=1),
        "objective_per_vehicle": totals.per_vehicle(),
        "detectable_share": totals.detectable_share(),
    }
    return _table({**{key: np.array([row[key] for row in rows]) for key in MOUNTING}, **scores})


def _mounting(site: Site, given: Mapping[str, Any]) -> dict[str, float]:
    """The six coordinates: those given, checked, and the baseline's."""
    for name in given:
        if name not in MOUNTING:
            raise unknown_name(name, MOUNTING, "coordinate", "mounting")
    numbers = {key: value.item() if isinstance(value, np.generic) else value for key, value in given.items()}
    return {**site.scenario.baseline, **{key: checked(one, MOUNTING[key], key) for key, one in numbers.items()}}


def _reaching(site: Site, mounts: Sequence[Mapping[str, float]]) -> Site:
    """The site with all vehicles that matter to the mountings, none of which may stand in traffic."""
    farthest = max(mounts, key=lambda mount: reach_of(site.scenario, mount))
    for mount in mounts:
        check_mount_is_clear(site.scenario, [], {"mounting": mount})
    if reach_of(site.scenario, farthest) > site.reach_m:
        site = prepare(site.scenario, farthest)
    frames = [frame.vehicles for frame in (*site.search, *site.holdout)]
    for mount in mounts:
        check_mount_is_clear(site.scenario, frames, {"mounting": mount})
    return site


def _frames(site: Site, held_out: bool):
    if held_out and not site.holdout:
        raise InputError(f"{site.scenario.source}: [traffic] holdout: nothing is held out")
    return site.holdout if held_out else site.search


# --- Clouds -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution over a frame.

    Attributes
    ----------
    cloud : PointCloud
        The returns, ground included [m, road frame].
    vehicles : Vehicles
        The boxes of the frame.
    header : dict
        Sensor, pose and settings, as files of clouds keep them.
    """

    cloud: PointCloud
    vehicles: Vehicles
    header: dict[str, object]

    @property
    def points(self):
        """A row for each return: x, y, z and range [m], ring, time [s], vehicle, class and intensity."""
        cloud = self.cloud
        columns = dict(zip(("x_m", "y_m", "z_m"), cloud.xyz.T, strict=True))
        columns |= {"range_m": cloud.range_m, "ring": cloud.ring, "time_s": cloud.time_s}
        columns |= {"vehicle_id": cloud.vehicle_id, "class": class_names(cloud.class_index)}
        return _table({**columns, "intensity": cloud.intensity})

    def write(self, path: str | Path) -> None:
        """Write it as the suffix says: .npz, .pcd, .ply, .bin, .las or .laz."""
        write_cloud(path, self.cloud, self.header)


def scan_frame(site: Site, frame: int, **mounting: float) -> Scan:
    """Cast one revolution over a frame of the recording, ground included, from a mounting [m, degrees]."""
    place, vehicles = _mounting(site, mounting), frame_of(site.recording, frame, "frame")
    check_mount_is_clear(site.scenario, [vehicles], {"mounting": place})
    sensor = mounted_sensor(site.scenario, place)
    return Scan(sensor.scan(vehicles), vehicles, sensor.cloud_header(vehicles))


def score_cloud(
    points: str | Path | np.ndarray, boxes: str | Path | Vehicles, vehicle_id: np.ndarray | None = None, **settings
):
    """PE-VGOP and other metrics of the vehicles of a labelled cloud, no simulation: what `score` does.

    Parameters
    ----------
    points : path or array_like, (n, 3)
        The cloud [m]: an .npz or .pcd file, or coordinates.
    boxes : path or Vehicles
        The boxes in the frame of the cloud: a CSV in the columns of vehicles.csv, or those of a frame.
    vehicle_id : array_like of int, (n,), optional
        The vehicle that each point belongs to, where `points` are coordinates.
    **settings
        ``frame, assign, clearance_m, cell_m, threshold, view, metrics, lidar_xy``, as the attributes of
        `commands.parsers.ScoreOptions`.

    Returns
    -------
    DataFrame or dict of ndarray
        A row for each vehicle.
    """
    elsewhere = ("points", "boxes", "out", "json")
    declared = {key: one for key, one in settings_of(ScoreOptions).items() if key not in elsewhere}
    for name in settings:
        if name not in declared:
            raise unknown_name(name, declared, "setting", "score_cloud")
    given = {key: checked(value, declared[key], key) for key, value in settings.items() if value is not None}
    of_file = isinstance(points, str | Path)
    asked = ScoreOptions(points=str(points) if of_file else "points", boxes=str(boxes), **given)
    metrics = metrics_of(asked)
    if of_file:
        points, vehicle_id = read_points(points)
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        raise InputError(f"points: shape {points.shape}; allowed: (n, 3), finite coordinates in metres")
    if vehicle_id is not None and np.shape(vehicle_id) != points.shape[:1]:
        raise InputError(f"vehicle_id: shape {np.shape(vehicle_id)}; allowed: {points.shape[:1]}, one for each point")
    vehicles = boxes if isinstance(boxes, Vehicles) else boxes_of(asked)
    labels = None if vehicle_id is None else np.asarray(vehicle_id)
    return _table(score_table(asked, metrics, points, labels, vehicles))


def _table(columns: Mapping[str, np.ndarray]):
    """A DataFrame where pandas is installed, else the dictionary."""
    try:
        from pandas import DataFrame
    except ImportError:
        return dict(columns)
    return DataFrame(dict(columns))
