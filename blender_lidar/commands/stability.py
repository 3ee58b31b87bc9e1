"""blender-lidar stability: where a scene's answer holds and where it breaks."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace

from ..scenario import COORDINATES
from ..stability.effort import FULL, QUICK
from ..stability.mountings import check_searched
from ..stability.output import FILES, write_results
from ..stability.report import report_text
from ..stability.study import study_identity, study_stability
from ..stop_signals import stops_recognised
from ..study.site import prepare
from ..study.stages import StudyFolder
from .options import add_pose, add_scene, default_folder, mounting_from, scenario_from
from .progress import Progress
from .report import describe_site
from .run_output import add_output, check_resume, say


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "stability",
        help="where a scene's answer holds and where it breaks",
        description="Vary the traffic, the installation, the metric and the sensor one thing at a time, search with "
        "other seeds, attack the casters, and say of each whether the mounting holds: the one that the search finds, "
        "or one that is given.",
    )
    add_scene(parser)
    add_pose(parser)
    add_output(parser)
    parser.add_argument("--quick", action="store_true", help="few frames, coarse grids, short searches")
    parser.add_argument("--resume", action="store_true", help="go on with the study in --out DIR that was stopped")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_resume(args)
    scenario = scenario_from(args)
    check_searched(scenario)
    given = any(getattr(args, f"pose_{key}") is not None for key in COORDINATES)
    mounting = mounting_from(args, scenario) if given else None
    effort = QUICK if args.quick else FULL
    if args.frames is not None or args.frame_ids is not None:  # asked for: none of them is left out
        effort = replace(effort, frames=None)
    site = prepare(scenario, mounting)
    folder = StudyFolder(
        args.out or default_folder(scenario, "stability"), study_identity(site, effort, mounting), FILES
    )
    with folder.locked(resume=args.resume):
        say(args, describe_site(site) + "\n")
        try:
            with stops_recognised():
                result = study_stability(site, effort, folder, Progress, mounting)
        except KeyboardInterrupt:
            print(f"blender-lidar: stopped; go on with: --out {folder.path} --resume", file=sys.stderr)
            return 1
        written = write_results(folder, result)
    say(args, f"{report_text(result)}\n\nResults in {folder.path}: {', '.join(written)}")
    if args.json:
        print(json.dumps(result, indent=2))
    return 0
