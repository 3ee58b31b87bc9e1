"""blender-lidar score: PE-VGOP and other metrics of any labelled cloud, no simulation."""

from __future__ import annotations

import argparse
import json
import sys
import warnings

import numpy as np

from ..clouds.files import read_points
from ..errors import InputError
from ..files import write_columns
from ..metrics.assignment import NO_BOX, points_in_boxes
from ..metrics.catalogue import METRICS, metric_named
from ..metrics.metric import NEEDS_DISTANCE, NEEDS_POINTS, Metric, vehicle_returns
from ..metrics.vgop import DEFAULT_CELL_M, entropy, to_vehicle_frame
from ..optimise import VIEWS, detectable
from ..traffic import read_table
from ..traffic.vehicles import Vehicles
from .options import checked_number

_ALL = "all"
_ALWAYS = {"pe-vgop": "entropy_bits", "points": "points"}  # columns of metrics that the table has anyway
_HEADING = "vehicle  class       points   p_top  p_side p_front  entropy  detectable"


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "score",
        help="score the vehicles of a labelled cloud",
        description="Score a point cloud by boxes that are known: PE-VGOP of each vehicle, and other metrics if asked.",
    )
    parser.add_argument("--points", required=True, metavar="CLOUD", help="the cloud: .npz with xyz, or .pcd")
    parser.add_argument(
        "--boxes",
        required=True,
        metavar="BOXES.csv",
        help="the boxes, in the columns of vehicles.csv and the frame of the cloud",
    )
    parser.add_argument("--frame", type=int, metavar="K", help="frame of the boxes, where they come from several")
    parser.add_argument(
        "--assign",
        choices=("id", "box"),
        default="id",
        help="a point belongs to the vehicle that its vehicle_id names, or to the box it lies in",
    )
    parser.add_argument(
        "--ground-clearance",
        type=float,
        default=0.1,
        metavar="M",
        help="with --assign box, points this little above a box's floor are ground (default 0.1)",
    )
    parser.add_argument("--cell", type=float, default=DEFAULT_CELL_M, metavar="M", help="side of a cell (default 0.05)")
    parser.add_argument(
        "--threshold", type=float, default=0.005, help="least occupancy that counts as detectable (default 0.005)"
    )
    parser.add_argument(
        "--view", choices=VIEWS, default="mean", help="which of the three occupancies the threshold asks for"
    )
    parser.add_argument(
        "--metric",
        action="append",
        default=[],
        metavar="NAME",
        help=f"another metric beside PE-VGOP, again for more, or all: {', '.join(_of_vehicles())}",
    )
    parser.add_argument(
        "--lidar",
        nargs=2,
        type=float,
        metavar=("X", "Y"),
        help="where the LiDAR is, in the frame of the cloud [m]: for the metric distance",
    )
    parser.add_argument("--out", metavar="CSV", help="write one row for each vehicle")
    parser.add_argument("--json", action="store_true", help="print the scores as JSON, and nothing else, on stdout")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    clearance = checked_number(args.ground_clearance, "--ground-clearance", low=0.0)
    cell_m = checked_number(args.cell, "--cell", low=0.001)
    threshold = checked_number(args.threshold, "--threshold", low=0.0)
    metrics = _metrics(args)
    points, vehicle_id = read_points(args.points)
    vehicles = _boxes(args)
    row = _assigned(args, points, vehicle_id, vehicles, clearance)
    mine = row != NO_BOX
    local = to_vehicle_frame(points[mine], vehicles.centre_m, vehicles.heading_rad, row[mine])
    returns = vehicle_returns(local, row[mine], vehicles.size_m, _distance(args, vehicles), cell_m)
    shares = returns.occupancy
    table = {
        "frame": np.full(len(vehicles), vehicles.frame),
        "vehicle_id": vehicles.vehicle_id,
        "class": vehicles.class_name,
        "points": returns.count,
        **dict(zip(("p_top", "p_side", "p_front"), shares.T, strict=True)),
        "entropy_bits": entropy(shares).sum(axis=1),
        "detectable": detectable(shares, threshold, args.view),
        **{_column(metric): metric.values(returns) for metric in metrics if metric.name not in _ALWAYS},
    }
    if args.out:
        write_columns(args.out, table, dict.fromkeys(("p_top", "p_side", "p_front", "entropy_bits"), 6))
    _print(args, table, len(points), metrics)
    return 0


def _of_vehicles() -> dict[str, Metric]:
    """The metrics that need no scene to learn from."""
    return {name: metric for name, metric in METRICS.items() if metric.learn is None}


def _metrics(args) -> list[Metric]:
    """The metrics that were asked for beside PE-VGOP, each once."""
    found = {}
    for name in args.metric:
        if name != _ALL:
            found[name] = metric_named(name, "--metric").learnt(None)
            if NEEDS_DISTANCE in found[name].needs and args.lidar is None:
                raise InputError(f"--metric: {name} needs to know where the LiDAR is; give --lidar X Y")
            continue
        known = {NEEDS_POINTS} if args.lidar is None else {NEEDS_POINTS, NEEDS_DISTANCE}
        of_cloud = {key: metric for key, metric in _of_vehicles().items() if metric.needs <= known}
        found |= of_cloud
        if left_out := METRICS.keys() - of_cloud.keys():
            print(f"blender-lidar: note: left out: {', '.join(sorted(left_out))}", file=sys.stderr)
    return list(found.values())


def _column(metric: Metric) -> str:
    """Where a metric's values are in the table."""
    return _ALWAYS.get(metric.name, metric.name.replace("-", "_"))


def _distance(args, vehicles):
    """Horizontal distance of each vehicle from the LiDAR [m]; None where its place is not given."""
    if args.lidar is None:
        return None
    if not np.isfinite(args.lidar).all():
        raise InputError(f"--lidar: is {args.lidar[0]} {args.lidar[1]}; allowed: two numbers of metres")
    return np.hypot(*(vehicles.centre_m[:, :2] - args.lidar).T)


def _boxes(args) -> Vehicles:
    recording = read_table(args.boxes)
    if args.frame is not None:
        return recording.vehicles(args.frame)
    if len(recording.frames) > 1:
        raise InputError(
            f"{args.boxes}: holds {len(recording.frames)} frames, {recording.frames[0]} to {recording.frames[-1]}; "
            "name one with --frame"
        )
    return recording.vehicles(int(recording.frames[0]))


def _assigned(args, points, vehicle_id, vehicles, clearance):
    """Row of the box of each point."""
    if args.assign == "box":
        return points_in_boxes(points, vehicles.centre_m, vehicles.size_m, vehicles.heading_rad, clearance)
    if vehicle_id is None:
        raise InputError(f"--points: {args.points}: does not say which vehicle a point belongs to; use --assign box")
    order = np.argsort(vehicles.vehicle_id)
    at = np.clip(np.searchsorted(vehicles.vehicle_id, vehicle_id, sorter=order), 0, len(order) - 1)
    row = np.where(vehicles.vehicle_id[order[at]] == vehicle_id, order[at], NO_BOX)
    if (row == NO_BOX).all() and (vehicle_id >= 0).any():
        text = f"{args.points}: none of its vehicles is among the boxes of frame {vehicles.frame} in {args.boxes}"
        warnings.warn(text, stacklevel=2)
    return row


def _print(args, table, points, metrics):
    mean = float(table["entropy_bits"].mean())
    share = float(table["detectable"].mean())
    columns = (column.tolist() for column in table.values())
    rows = [dict(zip(table, values, strict=True)) for values in zip(*columns, strict=True)]
    means = {metric: float(np.mean(table[_column(metric)])) for metric in metrics}
    if args.json:
        scores = {"points": points, "entropy_bits_per_vehicle": mean, "detectable_share": share}
        if metrics:
            scores["metrics"] = {
                metric.name: {"column": _column(metric), "unit": metric.unit, "per_vehicle": value}
                for metric, value in means.items()
            }
        print(json.dumps(scores | {"vehicles": rows}, indent=2))
        return
    added = [metric for metric in metrics if metric.name not in _ALWAYS]
    print("  ".join([_HEADING, *(metric.name for metric in added)]))
    for row in rows:
        text = (
            "{vehicle_id:<8} {class:<10} {points:>7} {p_top:7.4f} {p_side:7.4f} {p_front:7.4f} "
            "{entropy_bits:8.4f}  {noticed}"
        ).format(**row, noticed="yes" if row["detectable"] else "no")
        values = "".join(f"  {metric.number(row[_column(metric)], 1):>{len(metric.name)}}" for metric in added)
        print(f"{text:<{len(_HEADING)}}{values}".rstrip())
    for metric, value in means.items():
        print(f"{metric.name}: {metric.amount(value, 1)} per vehicle")
    number = len(rows)
    print(
        f"{number} vehicle{'s' * (number != 1)}, {points} points: {mean:.4f} bits per vehicle, "
        f"{100 * share:.1f} % detectable"
    )
