"""blender-lidar table: best tilt and detectable share by setback and height, as manuals of roadside radars have it."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..document import Table
from ..errors import InputError
from ..files import folder_lock, to_csv, write_text
from ..report.html import element
from ..report.page import page_html, table_markup
from ..report.text import filled, table_text
from ..run.as_hung import hung_scores, searching
from ..run.assumptions import assumptions, site_name
from ..run.comparison import Comparison
from ..run.quantities import share
from ..run.vehicle_table import vehicle_tables
from ..run.words import boxes_text
from ..scene.deployment import SearchSpace
from ..scene.mounting import ANGLES, LEANS, Mounting, changed_mounting, mast_at
from ..scene.scenario import Scenario
from ..scene.site import Site, prepare
from ..scoring.evaluation import site_evaluator
from ..studies.candidates import at_one_place
from .options import default_folder, scenario_from
from .progress import Progress
from .report import describe_site, say, say_result

_TILTS = 26  # of a grid over the searched tilts: whole degrees over the paper's range
_AS_GOOD = "~"
_HOW_TO_READ = (
    "Each cell: the detectable share of the boxes that judge, with its 90 % interval, and the best tilt, which the "
    "searched frames have chosen. "
    f"{_AS_GOOD} marks no clear difference from the cell that is best on the searched frames: the 90 % interval of the "
    "difference, which holds for all cells together, holds 0 or lies above; with little traffic it may hide a real one."
)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    setbacks, heights = args.setback, args.heights
    scenario = scenario_from(args)
    if scenario.is_layout:
        raise InputError(f"{scenario.source}: [[lidar]]: are {len(scenario.lidars)}; a table is of one: [deployment]")
    scenario = at_one_place(scenario)
    if not scenario.road_map.endless:
        raise InputError(f"{scenario.source}: [road] is a map; a table of setbacks is of a straight road")
    folder = Path(args.out or default_folder(scenario, "table"))
    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"--out: {folder}: is not empty; allowed: a new folder")
    names = args.sensors.split(",") if args.sensors else [scenario.lidar.sensor.name]
    scenarios = [scenario_from(args, sensor=name.strip()) for name in names]
    mounts = [[mounting_at(one, setback, height) for setback in setbacks for height in heights] for one in scenarios]
    with folder_lock(folder):
        rows, tables, notes = [], [], []
        for one, mountings in zip(scenarios, mounts, strict=True):
            site = prepare(one, mountings)
            say(args, describe_site(site, searched=False) + "\n")
            cells, about = _cells(site, setbacks, heights)
            rows += [{"sensor": site.model.name, **cell} for cell in cells]
            tables.append(_text_table(site, cells, setbacks, heights))
            notes += [f"{site.model.name}: {text}." for text in about]
        title = f"{site_name(scenario)}: detectable vehicles by setback and height"
        lines = [_HOW_TO_READ, *dict.fromkeys(notes)]
        columns = list(rows[0])
        write_text(folder / "table.csv", to_csv(columns, [[_cell(row[key]) for key in columns] for row in rows]))
        body = [element("h1", title), *map(table_markup, tables), *(element("p", line) for line in lines)]
        write_text(folder / "table.html", page_html(title, *body))
    text = "\n\n".join([title, *map(table_text, tables), filled(lines)])
    return say_result(args, f"{text}\n\nResults in {folder}: table.html, table.csv", {"cells": rows})


def mounting_at(scenario: Scenario, setback_m: float, height_m: float) -> Mounting:
    """The baseline at another setback from the road's edge and another height, on the side where the mast stands.

    Raises
    ------
    InputError
        Where the mast of the scene stands over the lanes or between them.
    """
    road, xy = scenario.road_map, scenario.nominal_xy
    side = road.side_of(xy)
    if side not in ("right", "left"):
        raise InputError(f"--setback: the scene's mast stands over or between lanes ({side}); allowed: beside the road")
    right, left = road.edges_t
    across = right - setback_m if side == "right" else left + setback_m
    x_m, y_m = road.at(float(road.locate(np.array([xy])).s_m[0]), across).tolist()
    facing = math.radians(scenario.lidar.deployment.facing.at((x_m, y_m), road))
    return replace(scenario.lidar.baseline, mast=mast_at(road, x_m, y_m, facing), height_m=height_m)


def _cells(site: Site, setbacks: Sequence[float], heights: Sequence[float]) -> tuple[list[dict], list[str]]:
    """Each setback and height with its best tilt, what is detectable there, and whether the best cell is better."""
    scenario, road = site.scenario, site.scenario.road_map
    place = scenario.lidar.deployment.places[0]
    axis = SearchSpace((place,)).axes[1]
    angles = {key: place.fixed[key] for key in (*ANGLES, *LEANS) if key in place.fixed}
    tilts = np.linspace(*place.bounds[axis], _TILTS).round(9) if axis in place.bounds else [place.fixed[axis]]
    places = [(setback, height) for setback in setbacks for height in heights]
    plans, worth, started = [], [], time.perf_counter()
    progress = closing(Progress(len(places), "places"))
    with site_evaluator(site, site.search, site.holdout) as evaluator, progress as shown:
        searched = searching(site, evaluator)
        for setback, height in places:
            plain = mounting_at(scenario, setback, height)
            tried = [(changed_mounting(plain, road, **{**angles, axis: float(tilt)}),) for tilt in tilts]
            objective = searched.totals(tried).objective.sum(axis=1)
            plans.append((tried[int(np.argmax(objective))], float(tilts[int(np.argmax(objective))])))
            worth.append(objective.max())
            shown.advance(1)
        (split, judging), layouts = evaluator.judging, [layout for layout, _ in plans]
        tables = vehicle_tables(layouts, **{split: judging})
        scores = hung_scores(scenario, judging, layouts, singles=False)
    top, seed = int(np.argmax(worth)), scenario.search.seed if split == "holdout" else None
    hung = [one.mean for one in scores]
    order = np.r_[top, np.delete(np.arange(len(plans)), top)]
    every = Comparison.of_split(tables[top], tables[top], split, site, seed)
    reach = every.reach_90("detectable", [hung[row] for row in order])
    reach = None if reach is None else reach[np.argsort(order)]
    cells = []
    for number, ((setback, height), (_, tilt), table) in enumerate(zip(places, plans, tables, strict=True)):
        boxes = Comparison.of_split(tables[top], table, split, site, seed)
        shares = boxes.with_scores(hung[top], hung[number]).shares()
        gain, ends = shares["gain"], None
        if reach is not None:  # holds for all cells together
            ends = [gain - float(reach[number]), gain + float(reach[number])]
        cell = {"setback_m": setback, "height_m": height, axis: tilt, "detectable_share": shares["after"]}
        cell["detectable_share_interval_90"] = shares["after_interval_90"]
        cell |= {key: shares[key] for key in ("boxes", "distinct_vehicles")}
        cell["detectable_share_as_planned"] = float(boxes.after["detectable"].mean())
        cell |= {"difference_to_best": gain, "difference_interval_90": ends}
        cells.append(cell | {"as_good": None if ends is None else bool(ends[1] >= 0.0)})
    on = "held-out" if split == "holdout" else "the searched frames', so without intervals"
    errors = scenario.lidar.deployment.installer.text
    about = [f"{boxes_text(cells[0])}, {on}; {f'as hung within {errors}' if errors else 'exactly as planned'}"]
    best = cells[top]
    about[0] += f"; {len(cells) * len(tilts):,} mountings in {time.perf_counter() - started:.0f} s"
    about.append(f"the best cell on the searched frames is {_where(best)}")
    if lowest := [cell for cell in cells if cell["as_good"]]:
        least = min(lowest, key=lambda cell: (cell["height_m"], cell["setback_m"]))
        about[-1] += "" if least is best else f"; {_where(least)} is the least height that is not shown to be worse"
    return cells, [*about, *assumptions(site, tables[top])]


def _where(cell: Mapping) -> str:
    return f"{cell['height_m']:g} m at a setback of {cell['setback_m']:g} m"


def _text_table(site: Site, cells: Sequence[Mapping], setbacks: Sequence[float], heights: Sequence[float]) -> Table:
    axis, found = site.scenario.lidar.deployment.spaces[0].axes[1], iter(cells)
    rows = []
    for setback in setbacks:
        texts = []
        for cell in (next(found) for _ in heights):
            seen = share("detectable_share", "", cell["detectable_share"], cell["detectable_share_interval_90"])
            texts.append(f"{_AS_GOOD if cell['as_good'] else ''}{seen} at {cell[axis]:.0f}°")
        rows.append((f"{setback:g} m", *texts))
    what = axis.split("_")[0]
    columns = (f"{site.model.name}, setback", *(f"hung at {height:g} m" for height in heights))
    return Table("table", f"{site.model.name}: detectable share, best {what}", columns, tuple(rows))


def _cell(value: object) -> object:
    return " to ".join(f"{end:.4f}" for end in value) if isinstance(value, list) else value
