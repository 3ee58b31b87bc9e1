"""blender-lidar optimise and evaluate: traffic in, the best mounting or a given one judged, a folder of results out."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from ..errors import InputError, MissingExtraError
from ..files import write_text
from ..metrics.catalogue import metric_named
from ..report.installation import installation_text
from ..report.page import write_report
from ..report.text import document_text
from ..run.folder import INSTALLATION, RunFolder, of_lidar
from ..run.optimise import ended_search, evaluate_site, optimise_site
from ..run.words import each_lidar
from ..scene.scenario import Scenario
from ..scene.site import Site, prepare
from ..signals import stops_recognised
from .options import default_folder, layout_from, scenario_from
from .progress import RunProgress
from .report import describe_site, files, note, say, say_result, say_stopped

# --- Where a run's results go, and how they are printed: what the verbs that leave a folder share ------------


def check_resume(args: argparse.Namespace) -> None:
    """Refuse ``--resume`` without the folder that it is about."""
    if args.resume and args.out is None:
        raise InputError("--resume: needs --out DIR, the folder of the run that was stopped")


def folder_from(args: argparse.Namespace, scenario: Scenario) -> RunFolder:
    """The folder that the results go to, not yet made; a place that cannot be used is refused early."""
    folder = RunFolder(args.out if args.out is not None else default_folder(scenario))
    folder.check(resume=getattr(args, "resume", False))
    return folder


def write_pages(site: Site, run: RunFolder, tell: Callable[[str], object]) -> None:
    """Write the installation sheet, charts and page of a run that has ended; `tell` is called with what is left out."""
    try:
        from ..report.run_figures import draw_charts

        draw_charts(site, run)
    except MissingExtraError as error:
        tell(f"no charts: {error}")
    there = [path.name for path in run.path.glob("*.png")]
    for number, (name, result) in enumerate(each_lidar(run.result).items()):
        text = installation_text(site.with_lidar(number), result, there)
        write_text(run.file(of_lidar(INSTALLATION, name)), text)
    write_report(run)


def report(args: argparse.Namespace, site: Site, run: RunFolder) -> int:
    """Of a run that has ended write all that it leaves, and print what was found."""
    found = ""
    if args.detector is not None:
        from .detect import detection_summary, judge_at

        rows = zip(site.scenario.lidars, run.result["lidars"], strict=True)
        layout = tuple(one.mounting(row["deployment"]) for one, row in rows)
        found = "\n\n" + detection_summary(judge_at(site, layout, args.detector, run.path))
    write_pages(site, run, note)
    return say_result(args, document_text(run.document, files(run)) + found, run.result)


def _check_detector(args: argparse.Namespace, scenario: Scenario) -> None:
    if args.detector is not None:
        from .detect import check_detector, check_fits_detectors

        check_detector(args.detector)
        check_fits_detectors(scenario)


def check_searched(scenario: Scenario, where: str, instead: str = "") -> None:
    """Refuse a search where nothing is searched."""
    if scenario.is_layout and not all(lidar.is_held for lidar in scenario.lidars):
        return
    if scenario.is_layout or not all(place.bounds for place in scenario.lidar.deployment.places):
        table = "every [[lidar]]" if scenario.is_layout else "[deployment]"
        raise InputError(f"{where}{table} fixes every coordinate; give at least one a pair [low, high]{instead}")


# --- The verbs --------------------------------------------------------------------------------------------


def run_optimise(args: argparse.Namespace) -> int:
    """Search for the best mounting; returns the exit code."""
    check_resume(args)
    scenario = scenario_from(args)
    _check_detector(args, scenario)
    check_searched(scenario, f"{args.scene}: ", ", or use evaluate")
    folder = folder_from(args, scenario)
    site = prepare(scenario)
    with folder.begun(resume=args.resume):
        say(args, describe_site(site) + "\n")
        done = ended_search(site, folder, lambda text: say(args, f"{text}.\n")) if args.resume else None
        try:
            if done is None:
                variables = scenario.lidars[0].deployment.spaces[0].variables
                metric = metric_named(scenario.objective.metric)
                lines = 1 if scenario.is_layout else 10  # a layout has many searches
                with stops_recognised(), RunProgress(variables, metric, lines) as listener:
                    optimise_site(site, folder, listener, resume=args.resume)
            return report(args, site, folder)
        except KeyboardInterrupt:
            return say_stopped(folder.path)


def run_evaluate(args: argparse.Namespace) -> int:
    """Score one mounting; returns the exit code."""
    scenario = scenario_from(args)
    _check_detector(args, scenario)
    layout = layout_from(args, scenario)
    folder = folder_from(args, scenario)
    site = prepare(scenario, layout)
    with folder.begun():
        say(args, describe_site(site, searched=False) + "\n")
        poles = {pole.name: pole for pole in scenario.lidars[0].deployment.poles}
        evaluate_site(site, folder, layout, poles.get(args.pole))
        return report(args, site, folder)
