"""blender-lidar chart and stability: what a model costs and changes, and where an answer holds and where it breaks."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace

from ..metrics.catalogue import metric_named
from ..plugins import located
from ..report.chart import CHART_REPORT
from ..report.stability import STABILITY_REPORT
from ..report.study import StudyReport
from ..scene.deployment import MOUNTING_OR_LEAN
from ..scene.site import Site, prepare
from ..signals import stops_recognised
from ..studies.candidates import at_one_place, check_height_or_tilt_searched, sobol_candidates
from ..studies.chart import FULL_CHART, QUICK_CHART, chart_identity, chart_study
from ..studies.driver import StudyFolder
from ..studies.stability import FULL_STABILITY, QUICK_STABILITY, study_identity, study_stability
from .optimise import check_resume
from .options import check_scipy, default_folder, layout_from, layout_of_run, scenario_from
from .parsers import given_options
from .progress import Progress
from .report import describe_site, say, say_result, say_stopped


def run_chart(args: argparse.Namespace) -> int:
    """Carry out `chart`; returns the exit code."""
    check_resume(args)
    check_scipy("chart")
    whole = scenario_from(args)
    scenario = at_one_place(whole, args.pole, layout_of_run(args.of_run, whole) if args.of_run else None)
    sobol_candidates(scenario, 2)  # refuses a scene that searches nothing
    effort, site = _effort_of(args, FULL_CHART, QUICK_CHART), prepare(scenario)

    def study(folder: StudyFolder) -> dict:
        return chart_study(site, effort, args.max_regret, folder)

    return _carry_out(args, "chart", site, chart_identity(site, effort), CHART_REPORT, study)


def run_stability(args: argparse.Namespace) -> int:
    """Carry out `stability`; returns the exit code."""
    check_resume(args)
    whole = scenario_from(args)
    given = given_options(args, MOUNTING_OR_LEAN) or args.lidar or args.of_run
    layout = layout_from(args, whole) if given else None
    scenario = at_one_place(whole, args.pole, layout)
    check_height_or_tilt_searched(scenario)
    rivals = [located(name) for name in args.rivals or ()]
    for name in rivals:
        metric_named(name, "--rival")
    effort, site = _effort_of(args, FULL_STABILITY, QUICK_STABILITY), prepare(scenario, layout or ())

    def study(folder: StudyFolder) -> dict:
        return study_stability(site, effort, folder, layout, rivals)

    identity = study_identity(site, effort, layout, rivals)
    return _carry_out(args, "stability", site, identity, STABILITY_REPORT, study)


def _effort_of(args: argparse.Namespace, full, quick):
    """How much is done; where frames are asked for, none of them is left out."""
    effort = quick if args.quick else full
    asked = args.frames is not None or args.frame_ids is not None
    return replace(effort, frames=None) if asked else effort


def _carry_out(
    args: argparse.Namespace,
    verb: str,
    site: Site,
    identity: Mapping[str, object],
    report: StudyReport,
    study: Callable[[StudyFolder], dict],
) -> int:
    """Make a study in its folder, write what it leaves and print its report; returns the exit code.

    Without --out the folder is named after the scene and the verb.
    """
    folder = StudyFolder(args.out or default_folder(site.scenario, verb), identity, Progress)
    with folder.locked(resume=args.resume):
        say(args, describe_site(site) + "\n")
        try:
            with stops_recognised():
                result = study(folder)
        except KeyboardInterrupt:
            return say_stopped(folder.path)
        written = report.write(folder, result)
    return say_result(args, f"{report.text(result)}\n\nResults in {folder.path}: {', '.join(written)}", result)
