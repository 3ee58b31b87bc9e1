"""blender-lidar compare: our scans and scores beside real, labelled sweeps."""

from __future__ import annotations

import argparse

from ..errors import InputError
from . import compare_detections, compare_paired


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "compare",
        help="hold shapes, beams and metrics against reality",
        description="Compare with real, labelled sweeps: the same rays cast against our shapes (--paired), or metrics "
        "beside what real detectors made of each car (--detections).",
    )
    parser.add_argument(
        "--kitti", required=True, metavar="DIR", help="labelled sweeps in the layout of KITTI or SUSTechPOINTS"
    )
    parser.add_argument(
        "--class",
        dest="classes",
        action="append",
        metavar="NAME",
        help="what the labels call a car; may be repeated (default Car, in small or capital letters)",
    )
    parser.add_argument("--out", metavar="DIR", help="folder of the results; by default a new one under runs/")
    parser.add_argument("--json", action="store_true", help="print the results as JSON, and nothing else, on stdout")
    compare_paired.add_options(parser)
    compare_detections.add_options(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    if args.paired == (args.detections is not None):
        raise InputError("compare: give either --paired or --detections CARS.csv")
    return compare_paired.run(args) if args.paired else compare_detections.run(args)
