"""blender-lidar evaluate: one mounting, scored."""

from __future__ import annotations

import argparse

from ..run import evaluate_site
from ..study.site import prepare
from .options import SEARCH_OPTIONS, add_pose, add_scene, mounting_from, scenario_from
from .report import describe_site
from .run_output import add_output, folder_from, report, say


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "evaluate",
        help="score one mounting",
        description="Score one mounting against the scene's baseline, on the searched and the held-out frames.",
    )
    add_scene(parser, leave_out=SEARCH_OPTIONS)
    add_pose(parser)
    add_output(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    scenario = scenario_from(args)
    mount = mounting_from(args, scenario)
    folder = folder_from(args, scenario)
    site = prepare(scenario, mount)
    with folder.locked():
        folder.check()  # again: another run may have come first
        say(args, describe_site(site, searched=False) + "\n")
        return report(args, site, evaluate_site(site, folder, mount), folder)
