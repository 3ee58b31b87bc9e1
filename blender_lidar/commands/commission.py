"""blender-lidar commission: the sensor and the mounting of a LiDAR that hangs, from its own clouds."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..clouds.commissioned import COMMISSION, Hung
from ..clouds.points import read_grid, read_points
from ..clouds.rings import beam_phase, on_beams
from ..detection.classical import ClassicalDetector
from ..detection.fitted_boxes import fit_boxes
from ..detection.labels import frame_of
from ..detection.stored import AS_RECORDED
from ..errors import InputError, MissingExtraError
from ..files import check_folder, check_unused, make_folder, write_columns, write_text
from ..report.commission import commission_text, correction_sheet, draw_commission
from ..run.folder import SCENE, RunFolder
from ..scene.scenario import load_scenario
from ..scene.site import prepare
from ..sensors.beams import beam_lattice
from ..sensors.model import load_model, model_names
from ..studies.commission import FEWEST_CLOUDS, Commissioned, against_plan, commission, result_of
from .cloud_options import CommissionOptions
from .options import check_scipy, layout_of_run, new_folder
from .parsers import options_of
from .progress import Progress
from .report import note, say_result

COMMISSION_SCHEMA = 1
RESULT, BEAMS, DEPLOYMENT = COMMISSION, "beams.toml", "deployment.toml"
SHEET, PICTURE, BOXES = "correction.txt", "commission.png", "boxes.csv"
_OURS = RESULT, BEAMS, DEPLOYMENT, SHEET, PICTURE, BOXES
_DIGITS = {f"{name}_m": 3 for name in ("x", "y", "z", "length", "width", "height")} | {"heading_deg": 2}


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_scipy("commission")
    asked = options_of(args, CommissionOptions)
    folder = Path(asked.out or new_folder("commission"))
    check_folder(folder, "--out")
    check_unused(folder, "--out", "commission", lambda path: path.name in _OURS)
    given = None if asked.sensor is None else load_model(asked.sensor)
    site = None
    if asked.of_run is not None:
        scenario = load_scenario(RunFolder(asked.of_run).file(SCENE))
        layout, number = layout_of_run(asked.of_run, scenario), _number(asked.lidar, scenario)
        if not scenario.road_map.endless:
            raise InputError(f"--run: {asked.of_run}: is of a road on a map; allowed: a straight road's")
        site = prepare(scenario, layout)
        given = given or site.models[number]
    elif asked.lidar is not None:
        raise InputError("--lidar: is given without --run; allowed: both")
    seen = Hung(asked.axes, (0.0,) * 6, origin_m=asked.origin or (0.0, 0.0, 0.0)).seen
    clouds = [seen(read_points(path)[0]) for path in asked.clouds]
    grid = read_grid(asked.clouds[0])
    progress = Progress(len(clouds), "clouds")
    try:
        found = commission(
            clouds,
            asked.clouds,
            given,
            None if grid is None else seen(grid.reshape(-1, 3)).reshape(grid.shape),
            layout[number].pose.yaw if site else None,
            lambda: progress.advance(1),
        )
    finally:
        progress.close()
    plan = None
    if site:
        searched = RunFolder(asked.of_run).result["search"] is not None
        plan = against_plan(site, layout, number, found.fit, searched=searched)
    result = {"schema": COMMISSION_SCHEMA, "clouds": len(clouds), "source": list(asked.clouds)}
    result |= result_of(found, asked.axes, asked.origin or (0.0, 0.0, 0.0), plan)
    make_folder(folder, "--out")
    for name in _OURS:  # of an earlier cloud
        (folder / name).unlink(missing_ok=True)
    write_text(folder / RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n")
    write_text(folder / BEAMS, unit_table(found))
    write_text(folder / DEPLOYMENT, deployment(found))
    written = [RESULT, BEAMS, DEPLOYMENT]
    if len(clouds) >= FEWEST_CLOUDS:
        try:
            drives_on = site.scenario.road.drives_on if site else asked.drives_on
            write_columns(folder / BOXES, _boxes(found, clouds, asked.clouds, drives_on), _DIGITS)
            written.append(BOXES)
        except (MissingExtraError, InputError) as error:
            note(f"no boxes: {error}")
    if plan:
        write_text(folder / SHEET, correction_sheet(result))
        written.append(SHEET)
    try:
        draw_commission(folder / PICTURE, found, result)
        written.append(PICTURE)
    except MissingExtraError as error:
        note(f"no picture: {error}")
    return say_result(args, f"{commission_text(result)}\n\nResults in {folder}: {', '.join(written)}", result)


def _number(name: str | None, scenario) -> int:
    """Which LiDAR of the plan it is."""
    names = [lidar.name for lidar in scenario.lidars]
    if len(names) == 1 and name is None:
        return 0
    if name not in names:
        what = "is not given" if name is None else f"is {name!r}"
        raise InputError(f"--lidar: {what}; allowed: {', '.join(names)}")
    return names.index(name)


def _boxes(
    found: Commissioned, clouds: Sequence[np.ndarray], paths: Sequence[str], drives_on: str
) -> Mapping[str, np.ndarray]:
    """Boxes fitted to the vehicles, in the road frame; frames are the numbers in the clouds' names, or 0 on."""
    pose, lattice = found.fit.pose, beam_lattice(found.model)
    phase = beam_phase(clouds, lattice)
    with_beams = [
        on_beams(points, pose.to_world(points) + pose.position, lattice, phase, path)
        for points, path in zip(clouds, paths, strict=True)
    ]
    detector = ClassicalDetector(lattice, (0.0, 0.0), AS_RECORDED)
    table = fit_boxes(with_beams, detector, [one.y_m for one in found.fit.carriageways], drives_on)
    try:
        numbers = np.array([frame_of(Path(path)) for path in paths])
    except InputError:
        numbers = np.arange(len(paths))
    return {**table, "frame": numbers[table["frame"]]}


def deployment(found: Commissioned) -> str:
    """The mounting as tables of a scene: of a road along x, with the LiDAR's mast at its side and facing +y."""
    table = found.fit.pose.as_table()
    keys = ["height_m", "tilt_x_deg", "tilt_y_deg", *(["yaw_deg"] if found.fit.yaw else [])]
    lines = "".join(f"{key} = {table[key]:.4f}\n" for key in keys)
    hangs = "installer = false  # it hangs already\n"
    name, beside = json.dumps(found.model.name), ""
    if found.model.name not in model_names():  # a file's name may be any, and nothing would find it
        name, beside = json.dumps(BEAMS), "  # beside this file"
    return f"[sensor]\nname = {name}{beside}\n\n[deployment]\n{lines}{hangs}"


def unit_table(found: Commissioned) -> str:
    """A sensor file of this unit: the model's, with the elevations that the road taught."""
    model, elevation = found.model, np.degrees(found.unit_rad)
    order = np.argsort(elevation, kind="stable")
    columns = elevation, np.degrees(model.azimuth_offset_rad), 1e6 * model.fire_time_s
    rows = "".join(
        f"    [{ring}, {e:.4f}, {a:.4f}, {t:.4f}],\n" for ring, (e, a, t) in enumerate(np.column_stack(columns)[order])
    )
    keys = {
        "name": json.dumps(f"{model.name}, this unit"),
        "source": json.dumps(f"{model.name}, elevations corrected by commission where the road showed them"),
        "rotation_hz": list(model.rotation_hz),
        "default_rotation_hz": model.default_rotation_hz,
        "block_time_us": model.block_time_us,
        "columns_a_turn": list(model.columns_a_turn) or None,
        "default_columns": model.default_columns,
        "range_min_m": model.range_min_m,
        "range_max_m": model.range_max_m,
        "range_noise_m": model.range_noise_m,
        "range_at_10_percent_m": model.range_at_10_percent_m,
        "azimuth_deg": model.azimuth_deg and list(model.azimuth_deg),
    }
    head = "".join(f"{key} = {value}\n" for key, value in keys.items() if value is not None)
    return f"{head}\n# ring, elevation [deg], azimuth offset [deg], fire offset [us]\nbeams = [\n{rows}]\n"
