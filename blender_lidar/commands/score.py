"""blender-lidar score: PE-VGOP and other metrics of any labelled cloud, no simulation."""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..clouds.fit import accepted, cloud_misfit, in_frame
from ..clouds.points import check_steps, read_points
from ..errors import InputError
from ..files import write_columns
from ..metrics.assignment import NO_BOX, points_in_boxes
from ..metrics.catalogue import METRICS, metric_named
from ..metrics.metric import NEEDS_DISTANCE, Metric, vehicle_returns
from ..metrics.vgop import entropy, to_vehicle_frame
from ..optimise import detectable
from ..run.words import warnings_text
from ..traffic import read_table
from ..traffic.boxes import Boxes
from ..traffic.tracks import NUMBERED
from .cloud_options import ScoreOptions
from .parsers import options_of

_ALL = "all"
# Columns of metrics that the table has anyway:
_ALWAYS = {"pe-vgop": "entropy_bits", "detectable": "detectable"}
_SHARES = ("p_top", "p_side", "p_front")
_HEADING = "vehicle  class       points   p_top  p_side p_front  entropy  detectable"
_ROW = "{vehicle_id:<8} {class:<10} {points:>7} {p_top:7.4f} {p_side:7.4f} {p_front:7.4f} {entropy_bits:8.4f}"


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    asked = options_of(args, ScoreOptions)
    metrics = metrics_of(asked)
    points, vehicle_id = read_points(asked.points)
    table, warned = score_table(asked, metrics, points, vehicle_id, boxes_of(asked, asked.boxes))
    if asked.out:
        write_columns(asked.out, table, dict.fromkeys((*_SHARES, "entropy_bits"), 6))
    (_print_json if asked.json else _print)(table, len(points), metrics, warned)
    return 0


def score_table(
    asked: ScoreOptions,
    metrics: Sequence[Metric],
    points: np.ndarray,
    vehicle_id: np.ndarray | None,
    vehicles: Boxes,
) -> tuple[dict[str, np.ndarray], list[dict[str, str]]]:
    """Scores of the vehicles of a labelled cloud, by column, and what of its frame was accepted.

    `points` are (k, 3) in its own frame [m], `vehicle_id` (k,).
    """
    check_steps(points, asked.cell_m, asked.points)
    points = in_frame(points, asked.axes, asked.pose)
    row = _assigned(asked, points, vehicle_id, vehicles)
    misfit = cloud_misfit(points, vehicles, row if asked.assign == "id" else None)
    warned = accepted(misfit, f"{asked.points}, {asked.boxes}", asked.accept)
    mine = row != NO_BOX
    local = to_vehicle_frame(points[mine], vehicles.centre_m, vehicles.heading_rad, row[mine])
    away = None if asked.lidar_xy is None else np.hypot(*(vehicles.centre_m[:, :2] - asked.lidar_xy).T)
    returns = vehicle_returns(local, row[mine], vehicles.size_m, away, asked.cell_m)
    shares = returns.occupancy
    returns = replace(returns, detectable=detectable(shares, asked.threshold, asked.view))
    table = {
        "frame": np.full(len(vehicles), vehicles.frame),
        "vehicle_id": vehicles.vehicle_id,
        "class": vehicles.class_name,
        "points": returns.count,
        **dict(zip(_SHARES, shares.T, strict=True)),
        "entropy_bits": entropy(shares).sum(axis=1),
        "detectable": returns.detectable,
    }
    for metric in metrics:
        if metric is METRICS.get(metric.name) and metric.name in _ALWAYS:
            continue
        if _column(metric) in table:
            raise InputError(f"--metric: {metric.name!r} is the name of another column; give the function another name")
        table[_column(metric)] = metric.values(returns)
    return table, warned


def metrics_of(asked: ScoreOptions) -> list[Metric]:
    """The metrics that were asked for beside PE-VGOP, each once."""
    found: dict[str, Metric] = {}
    for name in asked.metrics or ():
        if name == _ALL:
            found |= METRICS
            continue
        found[name] = metric_named(name, "--metric")
        if NEEDS_DISTANCE in found[name].needs and asked.lidar_xy is None:
            raise InputError(f"--metric: {name} needs to know where the LiDAR is; give --lidar X Y")
    return list(found.values())


def _column(metric: Metric) -> str:
    """Where a metric's values are in the table."""
    return _ALWAYS.get(metric.name, metric.name.replace("-", "_"))


def boxes_of(asked: ScoreOptions, boxes: str | Mapping) -> Boxes:
    """Of a table of boxes, a file or itself, those of the frame that is asked for."""
    recording = read_table(boxes).vehicles_alone
    if asked.assign == "id" and any(note.startswith(NUMBERED) for note in recording.report.notes):
        raise InputError(f"{asked.boxes}: vehicle_id are texts, and a cloud's are numbers; allowed: --assign box")
    frames = recording.frames
    if asked.frame is None and len(frames) > 1:
        raise InputError(f"{asked.boxes}: holds frames {frames[0]} to {frames[-1]}; name one with --frame")
    return recording.at(int(frames[0]) if asked.frame is None else asked.frame)


def _assigned(asked: ScoreOptions, points, vehicle_id, vehicles) -> np.ndarray:
    """Row of the box of each point."""
    if asked.assign == "box":
        return points_in_boxes(points, vehicles.centre_m, vehicles.size_m, vehicles.heading_rad, asked.clearance_m)
    if vehicle_id is None:
        raise InputError(f"--points: {asked.points}: does not say which vehicle a point belongs to; use --assign box")
    row = vehicles.rows_of(vehicle_id)
    if (row == NO_BOX).all() and (vehicle_id >= 0).any():
        text = f"{asked.points}: none of its vehicles is among the boxes of frame {vehicles.frame} in {asked.boxes}"
        warnings.warn(text, stacklevel=2)
    return row


def _rows(table):
    columns = (column.tolist() for column in table.values())
    return [dict(zip(table, values, strict=True)) for values in zip(*columns, strict=True)]


def _print_json(table, points, metrics, warned):
    scores = {
        **({"warnings": warned} if warned else {}),
        "points": points,
        "entropy_bits_per_vehicle": float(table["entropy_bits"].mean()),
        "detectable_share": float(table["detectable"].mean()),
    }
    if metrics:
        scores["metrics"] = {
            metric.name: {"column": column, "unit": metric.unit, "per_vehicle": float(np.mean(table[column]))}
            for metric, column in zip(metrics, map(_column, metrics), strict=True)
        }
    print(json.dumps(scores | {"vehicles": _rows(table)}, indent=2))


def _print(table, points, metrics, warned):
    print("".join(f"{line}\n" for line in warnings_text({"warnings": warned})), end="")
    added = [metric for metric in metrics if metric.name not in _ALWAYS]
    print("  ".join([_HEADING, *(metric.name for metric in added)]))
    for row in _rows(table):
        text = f"{_ROW.format(**row)}  {'yes' if row['detectable'] else 'no'}"
        values = "".join(f"  {metric.number(row[_column(metric)], 1):>{len(metric.name)}}" for metric in added)
        print(f"{text:<{len(_HEADING)}}{values}".rstrip())
    for metric in metrics:
        print(f"{metric.name}: {metric.amount(float(np.mean(table[_column(metric)])), 1)}{metric.per_vehicle}")
    number = len(table["points"])
    print(
        f"{number} vehicle{'s' * (number != 1)}, {points} points: {100 * table['detectable'].mean():.1f} % detectable, "
        f"mean PE-VGOP {table['entropy_bits'].mean():.4f} bits"
    )
