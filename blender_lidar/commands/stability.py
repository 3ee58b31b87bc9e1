"""blender-lidar stability: where a scene's answer holds and where it breaks."""

from __future__ import annotations

import argparse

from ..report.stability import STABILITY_REPORT
from ..scene.settings import MOUNTING
from ..scene.site import prepare
from ..studies.driver import StudyFolder
from ..studies.findings import check_searched
from ..studies.stability import FULL_STABILITY, QUICK_STABILITY, study_identity, study_stability
from .optimise import check_resume
from .options import add_pose, add_scene, given_options, mounting_from, scenario_from
from .studies import add_study_options, carry_out, effort_of


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "stability",
        help="where a scene's answer holds and where it breaks",
        description="Vary the traffic, the installation, the metric and the sensor one thing at a time, search with "
        "other seeds, and say of each whether the mounting holds: the one that the search finds, "
        "or one that is given.",
    )
    add_scene(parser)
    add_pose(parser)
    add_study_options(parser, "few frames, coarse grids, short searches")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_resume(args)
    scenario = scenario_from(args)
    check_searched(scenario)
    mounting = mounting_from(args, scenario) if given_options(args, MOUNTING) else None
    effort, site = effort_of(args, FULL_STABILITY, QUICK_STABILITY), prepare(scenario, mounting)

    def study(folder: StudyFolder) -> dict:
        return study_stability(site, effort, folder, mounting)

    return carry_out(args, "stability", site, study_identity(site, effort, mounting), STABILITY_REPORT, study)
