"""The worlds in which detectors are trained and judged: clean, hard enough that they can fail, and at a crossing."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from arguments import SCENES
from blender_lidar.files import write_text
from blender_lidar.names import CLASSES
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import read_recording
from blender_lidar.traffic.frames import instants

Options = dict[tuple[str, str], tuple[object, str]]
TWO_WAY_LANES, LANE_M = 4, 3.66  # of each carriageway; 12 ft
HEDGES_FROM = 3  # of the kinds of medians


def hard_world() -> Options:
    """Clutter, vehicles that differ, a road that is not flat, noise, lost returns, a mounting known only nearly.

    In the place of a scene's settings, as `scene.scenario.load_scenario` takes them.
    """
    settings = {
        ("world", "clutter"): 1.0,
        ("world", "variety"): 1.0,
        ("world", "variety_seed"): 1000,  # no site of the training has it
        ("road", "grade_percent"): 1.0,
        ("road", "cross_fall_percent"): 1.0,
        ("road", "crown_percent"): 2.0,
        ("sensor", "range_noise_m"): "datasheet",
        ("sensor", "dropout"): 0.02,
        ("sensor", "glass_dropout"): 0.5,
        ("sensor", "range_at_10_percent_m"): "datasheet",
        ("model", "pose_error"): {"height_m": 0.05, "tilt_deg": 1.0},
    }
    return {place: (value, place[1]) for place, value in settings.items()}


def crossing_world() -> Options:
    """The hard world at an intersection on its map, where people walk; maps have neither clutter nor slopes."""
    kept = {place: given for place, given in hard_world().items() if place[0] != "road" and place[1] != "clutter"}
    return kept | {("objective", "classes"): (CLASSES, "classes")}


def two_way_world(rng: np.random.Generator, median_m: float) -> Options:
    """A road of two carriageways: in the median rails, concrete, a hedge, hedge and rails or nothing; rails outside.

    The hedge is a row of boxes, none alike and some missing, and clear of the LiDAR's pole.
    """
    right, width = 2.0, TWO_WAY_LANES * LANE_M
    inner, outer = (right + width, right + width + median_m), (right, right + 2.0 * width + median_m)
    middle = 0.5 * sum(inner)
    rails = [("guard_rail", inner[0] + 0.5), ("guard_rail", inner[1] - 0.5)]
    in_median = ([], rails, [("concrete", middle)], [], rails, rails)
    kind, hedge = int(rng.integers(len(in_median))), []
    high, wide = rng.uniform(0.8, 2.4), rng.uniform(0.6, min(2.0, median_m - 1.0))
    for x in np.arange(-200.0, 200.0, 2.5) if kind >= HEDGES_FROM else ():
        length, width, height = np.array([2.3, wide, high]) * rng.uniform(0.85, 1.1, 3)
        if abs(x) > 2.5 and rng.random() > 0.1:
            centre = [x, middle + rng.uniform(-0.1, 0.1), 0.5 * height]
            hedge.append({"centre_m": centre, "size_m": [length, width, height]})
    standing = [*in_median[kind]]
    standing += [("guard_rail", y) for y in (outer[0] - 0.6, outer[1] + 0.6) if rng.random() < 0.5]
    settings = {
        ("road", "carriageways"): 2,
        ("road", "lanes"): TWO_WAY_LANES,
        ("road", "right_edge_m"): width,
        ("road", "median_m"): median_m,
        ("world", "barriers"): [{"kind": kind, "y_m": y} for kind, y in standing],
        ("world", "boxes"): hedge,
    }
    return {place: (value, place[1]) for place, value in settings.items()}


def write_two_way(path: Path, recordings: tuple[str, str], median_m: float) -> None:
    """A table of the traffic of two carriageways: the left lanes of two recordings, the second one turned about."""
    given = {("road", "lanes"): TWO_WAY_LANES, ("road", "right_edge_m"): TWO_WAY_LANES * LANE_M}
    far, rows = 4.0 + 2.0 * TWO_WAY_LANES * LANE_M + median_m, []
    for number, recording in enumerate(recordings):
        options = {place: (value, place[1]) for place, value in (given | {("traffic", "path"): recording}).items()}
        whole = read_recording(load_scenario(SCENES / "i80.toml", options))
        kept = np.isin(whole.frame, instants(whole)) & (whole.lane <= TWO_WAY_LANES)
        part = whole.select(kept)
        turn = np.array([1.0, 1.0, 1.0] if number == 0 else [-1.0, -1.0, 1.0])
        centre = part.centre_m * turn + [0.0, far * number, 0.0]
        heading = np.degrees(part.heading_rad) + 180.0 * number
        names = np.array(CLASSES)[part.class_index]
        ids, first = part.vehicle_id + 1_000_000 * number, part.frame - part.frames[0]
        columns = ids, first, names, *centre.T.round(3), *part.size_m.T.round(3), heading.round(3)
        rows.append(list(zip(*(column.tolist() for column in columns), strict=True)))
    last = min(part[-1][1] for part in rows)
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    sides = ("length_m", "width_m", "height_m")
    table.writerow(("vehicle_id", "frame", "time_s", "class", "x_m", "y_m", "z_m", *sides, "heading_deg"))
    table.writerows((row[0], row[1], 0.1 * row[1], *row[2:]) for part in rows for row in part if row[1] <= last)
    write_text(path, text.getvalue())
