"""blender-lidar scan: one frame's whole cloud, ground included."""

from __future__ import annotations

import argparse

import numpy as np

from ..casting import resolve
from ..formats.clouds import WRITERS, check_cloud_name, write_cloud
from ..results import versions
from ..scan import scan
from ..scenario import pose_at
from ..sensors.beams import beam_lattice
from ..sensors.model import load_model
from ..study.keep_clear import check_mount_is_clear
from ..study.site import frame_of, read_recording
from .options import SEARCH_OPTIONS, add_pose, add_scene, mounting_from, scenario_from

_LEFT_OUT = (*SEARCH_OPTIONS, "--frames", "--frame-ids", "--metric", "--reading", "--workers", "--seed")


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "scan",
        help="write the point cloud of one frame",
        description="Cast one revolution over one frame and write the cloud: .npz with everything, .pcd, .ply, .las, "
        ".laz, or KITTI's .bin with its .label.",
    )
    add_scene(parser, leave_out=_LEFT_OUT)
    parser.add_argument(
        "--frame", type=int, required=True, metavar="K", help="frame number, as the recording counts them"
    )
    add_pose(parser)
    parser.add_argument(
        "--out",
        required=True,
        metavar="CLOUD",
        help=f"the file to write; its suffix is the format: {', '.join(WRITERS)}",
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    out = check_cloud_name(args.out, "--out")
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    model = load_model(scenario.sensor.name)
    lattice = beam_lattice(model, scenario.sensor.rotation_hz)
    caster = resolve(scenario.model.caster)
    vehicles = frame_of(read_recording(scenario), args.frame, "--frame")
    check_mount_is_clear(scenario, [vehicles], {"--x, --y": mount})
    cloud = scan(
        vehicles,
        lattice,
        pose_at(mount),
        caster=caster,
        detail=scenario.model.detail,
        min_range_m=model.range_min_m,
        max_range_m=scenario.sensor.range_gate_m,
    )
    header = {
        "sensor": model.name,
        "pose": mount,
        "frame": args.frame,
        "caster": caster,
        "detail": scenario.model.detail,
        "ring_elevation_deg": np.degrees(lattice.elevation_rad).round(6).tolist(),
        "azimuth_step_deg": float(np.degrees(lattice.step_rad)),
        "rotation_hz": lattice.rotation_hz,
        "range_m": [model.range_min_m, scenario.sensor.range_gate_m],
        "versions": versions(caster),
    }
    write_cloud(out, cloud, header)
    of_vehicle = cloud.vehicle_id[cloud.vehicle_id >= 0]
    print(
        f"{out}: {len(cloud)} points, {len(of_vehicle)} of them on {len(np.unique(of_vehicle))} of {len(vehicles)} "
        f"vehicles ({model.name}, {caster})"
    )
    return 0
