"""blender-lidar stability: where a scene's answer holds and where it breaks."""

from __future__ import annotations

import argparse

from ..report.stability import STABILITY_REPORT
from ..scene.mounting import MOUNTING_OR_LEAN
from ..scene.site import prepare
from ..studies.driver import StudyFolder
from ..studies.findings import check_one_place, check_searched
from ..studies.stability import FULL_STABILITY, QUICK_STABILITY, study_identity, study_stability
from .optimise import check_resume
from .options import given_options, mounting_from, scenario_from
from .studies import carry_out, effort_of


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_resume(args)
    scenario = scenario_from(args)
    check_searched(scenario)
    check_one_place(scenario)
    mounting = mounting_from(args, scenario) if given_options(args, MOUNTING_OR_LEAN) else None
    effort, site = effort_of(args, FULL_STABILITY, QUICK_STABILITY), prepare(scenario, mounting)

    def study(folder: StudyFolder) -> dict:
        return study_stability(site, effort, folder, mounting)

    return carry_out(args, "stability", site, study_identity(site, effort, mounting), STABILITY_REPORT, study)
