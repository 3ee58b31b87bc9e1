"""The Python interface: scenes, mountings, clouds and their scores, as `import blender_lidar as bl` gives them.

Coordinates of a mounting are keywords in metres and degrees: ``x_m, y_m, height_m, tilt_x_deg, tilt_y_deg, yaw_deg``,
or ``lean_deg, lean_direction_deg, spin_deg`` in place of the angles; what is left out is as the scene
fixes it, else its baseline's. Tables are pandas DataFrames where pandas is installed, else dictionaries of arrays. What
cannot be used raises a `BlenderLidarError`, with what was given and what is allowed.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from .clouds.points import read_points
from .clouds.scan import PointCloud, joined_clouds
from .clouds.snapshot import fused_header, mounted_sensors
from .commands.cloud_options import ScoreOptions
from .commands.optimise import check_searched, write_pages
from .commands.options import in_words, layout_of, scene_settings
from .commands.progress import RunProgress
from .commands.score import boxes_of, metrics_of, score_table
from .errors import InputError, shown, unknown_name
from .metrics.catalogue import metric_named
from .metrics.metric import Metric
from .optimise import Search
from .optimise.multi_fidelity import MultiFidelitySearch
from .plugins import name_in_file
from .results import Run, Scan, Score, table_of
from .run.optimise import ended_search, evaluate_site, optimise_site
from .run.vehicle_table import vehicle_tables
from .run.verdict import POINTS
from .scene.deployment import MOUNTING, MOUNTING_OR_LEAN
from .scene.mount_checks import check_mount_is_clear
from .scene.mounting import LEANS, Layout, Mounting
from .scene.provenance import check_same_inputs
from .scene.scenario import load_scenario, scenario_of
from .scene.settings import DECLARED
from .scene.site import Site, frame_of, prepare, reach_of
from .scoring.evaluation import Evaluator, site_evaluator
from .toml_table import checked, settings_of
from .traffic.boxes import Boxes

Progress = Callable[[int, int, str], None]
"""Called with how much is done, of how much, and the best so far in words."""

_SCORES = ("objective", "objective_per_vehicle", "detectable_share")  # what score_mountings adds to a mounting


def load_scene(path: str | Path | Mapping[str, Mapping], **settings: object) -> Site:
    """A scene file made ready: traffic read, frames chosen and held out, beams made.

    Parameters
    ----------
    path : path or mapping
        The TOML file, or the name of a scene that ships with the package: ``"i80"``; or its tables themselves,
        ``{"traffic": {"path": "i80.csv"}, "sensor": {"name": "RS-80"}}``.
    **settings
        In place of the file's. Called as the command line's options, with an underscore for each hyphen:
        ``sensor="RS-80", frames=10, frame_ids=range(100, 160, 5), installer={"tilt_deg": 1.0}``, or as a table of the
        scene file, for its keys: ``deployment={"height_m": [2.0, 6.0]}, traffic={"holdout": 0.3}``. A metric or a
        search of one's own may be given itself, if a file defines it. None leaves the file's.

    Raises
    ------
    BlenderLidarError
        When a file or a value cannot be used, or no vehicle is in the region.
    """
    known, overrides = scene_settings(), {}
    for name, value in settings.items():
        if name in DECLARED and isinstance(value, Mapping):
            overrides |= {(name, key): (_plain(one), _in_tables(name, key)) for key, one in value.items()}
        elif name not in known:
            raise unknown_name(name, [*known, *DECLARED], "setting", "load_scene")
        elif value is not None:
            (table, key), where = known[name], f"load_scene: {name}"
            value = in_words(name, _plain(value), where)
            overrides[table, key] = (_absolute(value) if DECLARED[table][key].is_path else value, where)
    if isinstance(path, Mapping):
        return prepare(scenario_of(_plain(path), where=_in_tables, source="load_scene", overrides=overrides))
    return prepare(load_scenario(_absolute(path), overrides))


def _in_tables(table: str, key: str) -> str:
    return f"load_scene: {table}: {key}".removesuffix(": ")


def _plain(value: object) -> object:
    """A value as a TOML file would hold it; functions and classes by the name under which workers find them."""
    if isinstance(value, Metric):
        return name_in_file(value.score)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, range | tuple | list):
        return [_plain(one) for one in value]
    if isinstance(value, Path):
        return str(value)
    return name_in_file(value) if callable(value) else value


def _absolute(path: object) -> object:
    """A path that holds in any working folder; a name that is no file is left as it is."""
    return str(Path(path).absolute()) if isinstance(path, str | Path) and Path(path).is_file() else path


# --- The best mounting ------------------------------------------------------------------------------------------------


class _Heard:
    """Progress listener: keeps the best point so far, which is wanted if the run is stopped, and passes progress on.

    `progress` is True for a bar, or a function, as for `best_mounting`.
    """

    def __init__(self, site: Site, progress: bool | Progress) -> None:
        self._metric, self._points = metric_named(site.scoring.metric), 0
        self._call = progress if callable(progress) else lambda done, of, best: None
        self._bar = (
            RunProgress(site.scenario.lidars[0].deployment.spaces[0].variables, self._metric)
            if progress is True
            else None
        )
        self._best = False, -np.inf  # whether of the last stage, and its value
        self.best_x: np.ndarray | None = None

    def __enter__(self) -> _Heard:
        return self

    def __exit__(self, *exception) -> None:
        if self._bar is not None:
            self._bar.__exit__(*exception)

    def searching(self, search: Search | MultiFidelitySearch) -> None:
        self._points, known = 0, np.isfinite(search.best_value)
        if known and (search.is_final, search.best_value) > self._best:
            self.best_x, self._best = search.best_x, (search.is_final, search.best_value)
        elif not np.isfinite(self._best[1]) and search.evaluations:  # at a coarse fidelity
            self.best_x = search.best_x
        self._call(search.evaluations, search.budget, self._metric.total(search.best_value) if known else "")
        if self._bar is not None:
            self._bar.searching(search)

    def mapping(self, points: int) -> None:
        self._points += points
        self._call(self._points, POINTS[0] * POINTS[1], "map of heights and tilts")
        if self._bar is not None:
            self._bar.mapping(points)


def best_mounting(
    site: Site, out: str | Path | None = None, *, progress: bool | Progress = False, resume: bool = False
) -> Run:
    """Search the mounting with the highest objective and judge it on held-out traffic: what `optimise` does.

    Parameters
    ----------
    site : Site
        From `load_scene`.
    out : path, optional
        Folder that keeps the results, as the command line leaves them; without it nothing is left behind.
    progress : bool or callable
        True shows a bar; a function is called with how much is done, of how much, and the best so far in words.
    resume : bool
        Go on with the search in `out` that was stopped.

    Returns
    -------
    Run
        Of a run that Ctrl-C stops its best mounting so far, judged, with `complete` False; `out` can then be resumed.
        With candidate poles or several LiDARs, whose searches speak of one place each, it raises KeyboardInterrupt.
    """
    if site.scenario.is_layout:
        check_searched(site.scenario, "best_mounting: ")
    elif not all(place.bounds for place in site.scenario.lidar.deployment.places):
        raise InputError(
            f"{site.scenario.where(site.scenario.lidar.table, '')} fixes every coordinate; give one a pair [low, high]"
        )
    if resume and out is None:
        raise InputError("best_mounting: resume needs out, the folder of the run that was stopped")
    if not (isinstance(progress, bool) or callable(progress)):
        raise InputError(f"best_mounting: progress: is {shown(progress)}; allowed: True, False or a function")
    listener, run = _Heard(site, progress), Run(site, out)
    try:
        with run.begun(resume=resume), listener:
            if not (resume and ended_search(site, run, warnings.warn)):
                optimise_site(site, run, listener, resume=resume)
            return _kept(run, out)
    except KeyboardInterrupt:
        scenario = site.scenario
        spaces = scenario.lidars[0].deployment.spaces
        if listener.best_x is None or len(spaces) > 1 or scenario.is_layout:  # which speak of one place
            raise
        run = _judged(site, spaces[0].layout(listener.best_x), None)
        run.complete = False
        return run


def judge_mounting(site: Site, *, out: str | Path | None = None, **mounting: float) -> Run:
    """Judge one mounting beside the baseline, on searched and held-out frames: what `evaluate` does.

    Parameters
    ----------
    site, out
        As for `best_mounting`.
    **mounting : float
        Its coordinates [m, degrees]; those left out are as the scene fixes them, else its baseline's.
    """
    return _judged(site, (_mounting(site, mounting),), out)


def judge_layout(site: Site, *, out: str | Path | None = None, **mountings: Mapping[str, object]) -> Run:
    """The same of several LiDARs, by name: ``north={"height_m": 4.1, "pole": "NE"}``; what is left out is as its table
    fixes it, else its baseline's.
    """
    return _judged(site, _layout(site, mountings, "judge_layout"), out)


def _judged(site: Site, layout: Layout, out: str | Path | None) -> Run:
    run = Run(_reaching(site, layout), out)
    with run.begun():
        evaluate_site(run.site, run, layout)
        return _kept(run, out)


def _kept(run: Run, out: str | Path | None) -> Run:
    """A run that has ended, with its page and charts where somebody keeps it."""
    if out is not None:
        write_pages(run.site, run, warnings.warn)
    return run


# --- Scores of mountings on the searched frames -----------------------------------------------------------------------


def score_mounting(site: Site, *, held_out: bool = False, **mounting: float) -> Score:
    """Score one mounting, its coordinates as keywords [m, degrees], on the searched frames, or the held-out ones."""
    place = _mounting(site, mounting)
    (found,) = _scores(_reaching(site, [place]), [(place,)], [place.as_table()], held_out)
    return found


def score_layout(site: Site, *, held_out: bool = False, **mountings: Mapping[str, object]) -> Score:
    """Score a layout of several LiDARs, fused, and each of them alone: `mountings` are as for `judge_layout`."""
    layout = _layout(site, mountings, "score_layout")
    told = {one.name: hung.as_table() for one, hung in zip(site.scenario.lidars, layout, strict=True)}
    alone = [tuple(one if k == number else None for k, one in enumerate(layout)) for number in range(len(layout))]
    fused, *each = _scores(_reaching(site, layout), [layout, *alone], [told, *told.values()], held_out)
    return replace(fused, alone=dict(zip(told, each, strict=True)))


def _scores(site: Site, layouts: Sequence[Layout], told: Sequence[dict], held_out: bool) -> list[Score]:
    evaluator = Evaluator(_frames(site, held_out), site.observation, site.scoring)
    totals = evaluator.totals(layouts)
    scores = totals.objective.sum(axis=1), totals.per_vehicle(), totals.detectable_share()
    tables = map(table_of, vehicle_tables(layouts, **{"holdout" if held_out else "search": evaluator}))
    return [Score(*one) for one in zip(told, *(score.tolist() for score in scores), tables, strict=True)]


def score_mountings(site: Site, table: Mapping | Iterable[Mapping], *, held_out: bool = False):
    """Score many mountings in several processes, on the searched frames or the held-out ones.

    Parameters
    ----------
    site : Site
        From `load_scene`.
    table : DataFrame, mapping of str to (s,) values, or iterable of mappings
        The mountings, by the names of their coordinates [m, degrees]; what has no column is as the scene
        fixes it, else its baseline's. A table that this function returned is scored again.
    held_out : bool
        Whether the held-out frames are scored instead of the searched ones.

    Returns
    -------
    DataFrame or dict of ndarray, (s,)
        The six coordinates, `objective`, `objective_per_vehicle` and `detectable_share`.
    """
    rows = [_mounting(site, row, f"score_mountings: row {number}") for number, row in enumerate(_rows(table), start=1)]
    if not rows:
        raise InputError("score_mountings: the table is empty; allowed: one row for each mounting")
    site = _reaching(site, rows)
    with site_evaluator(site, _frames(site, held_out)) as evaluator:
        totals = evaluator.totals([(row,) for row in rows])
    scores = totals.objective.sum(axis=1), totals.per_vehicle(), totals.detectable_share()
    columns = {key: np.array([row.as_table()[key] for row in rows]) for key in MOUNTING}
    return table_of(columns | dict(zip(_SCORES, scores, strict=True)))


def _rows(table) -> list[Mapping]:
    """The rows of a table in any of its forms, without the scores of another time."""
    if hasattr(table, "keys") and not hasattr(table, "name"):  # a DataFrame or a mapping; a Series has a name
        columns = {name: np.asarray(table[name]) for name in table if name not in _SCORES}
        if len({column.shape for column in columns.values()}) > 1 or any(one.ndim != 1 for one in columns.values()):
            shapes = ", ".join(f"{name} {column.shape}" for name, column in columns.items())
            raise InputError(f"score_mountings: columns have shapes {shapes}; allowed: (s,), all of one length")
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    rows = list(table) if isinstance(table, Iterable) else [table]
    for number, row in enumerate(rows, start=1):
        if not hasattr(row, "keys"):
            raise InputError(
                f"score_mountings: row {number}: is {shown(row)}; allowed: a mapping such as {{'height_m': 4.1}}"
            )
    return [{key: row[key] for key in row.keys() if key not in _SCORES} for row in rows]  # noqa: SIM118 - of a Series


def _mounting(site: Site, given: Mapping[str, float], where: str = "mounting") -> Mounting:
    """The mounting that coordinates give, checked, with the scene's others."""
    if site.scenario.is_layout:
        names = ", ".join(lidar.name for lidar in site.scenario.lidars)
        raise InputError(f"{where}: is of one LiDAR, but the scene has {names}; allowed: score_layout, judge_layout")
    for name in given:
        if name not in MOUNTING_OR_LEAN:
            raise unknown_name(name, MOUNTING_OR_LEAN, "coordinate", where)
    values = {key: _plain(one) for key, one in given.items()}
    # Without a lean there is no direction.
    values = {key: one for key, one in values.items() if one is not None or key not in LEANS}
    numbers = {key: checked(one, MOUNTING_OR_LEAN[key], f"{where}: {key}") for key, one in values.items()}
    return site.scenario.lidar.mounting(numbers, where)


def _layout(site: Site, given: Mapping[str, Mapping], where: str) -> Layout:
    """The mountings of all LiDARs, from those that are given by name."""
    for name, one in given.items():
        if not hasattr(one, "keys"):
            raise InputError(f"{where}: {name}: is {shown(one)}; allowed: a mapping such as {{'height_m': 4.1}}")
    return layout_of(site.scenario, _plain({name: dict(one) for name, one in given.items()}), where)


def _reaching(site: Site, mounts: Sequence[Mounting]) -> Site:
    """The site with all vehicles that matter to the mountings, none of which may stand in traffic."""
    scenario = site.scenario
    hung = scenario.lidars if scenario.is_layout else scenario.lidars * len(mounts)
    names = [f"mounting of {one.name}" if scenario.is_layout else "mounting" for one in hung]
    for lidar, name, mount in zip(hung, names, mounts, strict=True):
        check_mount_is_clear(scenario, lidar, [], {name: mount})
    if reach_of(site.scenario, mounts) > site.reach_m:
        check_same_inputs(site.scenario, site.identity)
        site = prepare(site.scenario, mounts)
    frames, scenery = [*site.search, *site.holdout], site.observation.scenery
    for lidar, name, mount in zip(hung, names, mounts, strict=True):
        check_mount_is_clear(scenario, lidar, frames, {name: mount}, scenery and scenery.scenery)
    return site


def _frames(site: Site, held_out: bool):
    if held_out and not site.holdout:
        raise InputError(f"{site.scenario.where('traffic', 'holdout')}: nothing is held out")
    return site.holdout if held_out else site.search


# --- Clouds -----------------------------------------------------------------------------------------------------------


def scan_frame(site: Site, frame: int, **mounting: float | Mapping[str, float]) -> Scan:
    """Cast one revolution over a frame of the recording, ground included, from a mounting [m, degrees].

    Of several LiDARs each has its mounting by its name, ``north={"height_m": 4.1}``, and the clouds are joined.
    """
    try:
        number = operator.index(frame)
    except TypeError:
        raise InputError(f"frame: is {shown(frame)}; allowed: a whole number, as the recording counts them") from None
    vehicles = frame_of(site.recording, number, "frame")
    layout = _layout(site, mounting, "scan_frame") if site.scenario.is_layout else (_mounting(site, mounting),)
    sensors = mounted_sensors(site.scenario, layout)
    for sensor in sensors:
        check_mount_is_clear(site.scenario, sensor.spec, [vehicles], {"mounting": sensor.mounting}, sensor.stands)
    return Scan(joined_clouds([of.scan(vehicles) for of in sensors]), vehicles, fused_header(sensors, vehicles))


def score_cloud(
    points: str | Path | np.ndarray | PointCloud | Scan,
    boxes: str | Path | Boxes | Mapping | None = None,
    vehicle_id: np.ndarray | None = None,
    **settings: object,
):
    """PE-VGOP and other metrics of the vehicles of a labelled cloud, no simulation: what `score` does.

    Parameters
    ----------
    points : path, array_like (n, 3), PointCloud or Scan
        The cloud [m]: a file of any format that `score` reads, coordinates, or what `scan_frame` returned.
    boxes : path, Boxes, DataFrame or mapping of str to (m,) values
        The boxes in the frame of the cloud: in the columns of vehicles.csv, or those of a frame. A `Scan` has its own.
    vehicle_id : array_like of int, (n,), optional
        The vehicle that each point belongs to, -1 for none, where `points` are coordinates.
    **settings
        ``frame, axes, pose, accept, assign, clearance_m, cell_m, threshold, view, metrics, lidar_xy``, as the
        attributes of `commands.parsers.ScoreOptions`; a metric may be given itself.

    Returns
    -------
    DataFrame or dict of ndarray
        A row for each vehicle.
    """
    declared = {key: one for key, one in settings_of(ScoreOptions).items() if key not in _ELSEWHERE}
    for name in settings:
        if name not in declared:
            raise unknown_name(name, declared, "setting", "score_cloud")
    if isinstance(points, Scan):
        points, boxes = points.cloud, points.vehicles if boxes is None else boxes
    if isinstance(points, PointCloud):
        points, vehicle_id = points.xyz, points.vehicle_id if vehicle_id is None else vehicle_id
    elif isinstance(points, str | Path) and vehicle_id is not None:
        raise InputError("score_cloud: vehicle_id: is given beside a file, which has its own; allowed: one of both")
    given = {
        key: checked(_plain(value), declared[key], f"score_cloud: {key}")
        for key, value in settings.items()
        if value is not None
    }
    asked = ScoreOptions(points=_named(points, "points"), boxes=_named(boxes, "boxes"), **given)
    metrics = metrics_of(asked)
    vehicles = boxes if isinstance(boxes, Boxes) else boxes_of(asked, boxes if hasattr(boxes, "keys") else asked.boxes)
    if not len(vehicles) or asked.frame not in (None, vehicles.frame):
        held = f"frame {vehicles.frame}, {len(vehicles)} vehicles"
        raise InputError(
            f"score_cloud: boxes: hold {held}; allowed: one vehicle or more, of the frame that is asked for"
        )
    xyz, labels = read_points(asked.points) if isinstance(points, str | Path) else _arrays(points, vehicle_id)
    return table_of(score_table(asked, metrics, xyz, labels, vehicles)[0])


_ELSEWHERE = ("points", "boxes", "out", "json")  # options of `score` that have an argument of their own, or none


def _named(given: object, what: str) -> str:
    return str(given) if isinstance(given, str | Path) else what


def _arrays(points: object, vehicle_id: object) -> tuple[np.ndarray, np.ndarray | None]:
    """Coordinates (n, 3) and their vehicles (n,), checked."""
    try:
        xyz = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"points: is {shown(points)}; allowed: (n, 3), finite coordinates in metres") from None
    if xyz.ndim != 2 or xyz.shape[1] != 3 or not np.isfinite(xyz).all():
        raise InputError(f"points: shape {xyz.shape}; allowed: (n, 3), finite coordinates in metres")
    if vehicle_id is None:
        return xyz, None
    labels = np.asarray(vehicle_id)
    whole = labels.dtype.kind in "iu" or (labels.dtype.kind == "f" and (labels == np.round(labels)).all())
    if labels.shape != xyz.shape[:1] or not whole:
        allowed = f"{xyz.shape[:1]} whole numbers, one for each point"
        raise InputError(f"vehicle_id: {labels.dtype} of shape {labels.shape}; allowed: {allowed}")
    return xyz, labels.astype(np.int64)
