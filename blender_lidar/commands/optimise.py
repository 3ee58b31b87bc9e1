"""blender-lidar optimise: traffic in, best mounting out."""

from __future__ import annotations

import argparse
import sys

from ..errors import InputError
from ..metrics.catalogue import metric_named
from ..results import VEHICLES, VEHICLES_BASELINE, RunFolder
from ..run import Outcome, optimise_site
from ..stop_signals import stops_recognised
from ..study.site import prepare
from .options import add_scene, scenario_from
from .progress import RunProgress
from .report import describe_site
from .run_output import add_output, check_resume, folder_from, report, say


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "optimise",
        help="find the best mounting for a scene",
        description="Find the mounting with the highest objective, judge it on held-out traffic and leave a folder of "
        "results.",
    )
    add_scene(parser)
    add_output(parser)
    parser.add_argument("--resume", action="store_true", help="go on with the run in --out DIR that was stopped")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_resume(args)
    scenario = scenario_from(args)
    if not scenario.deployment.bounds:
        raise InputError(
            f"{args.scene}: [deployment] fixes every coordinate; give at least one a pair [low, high], or use evaluate"
        )
    folder = folder_from(args, scenario)
    site = prepare(scenario)
    with folder.locked():
        folder.check(resume=args.resume)  # again: another run may have come first
        say(args, describe_site(site) + "\n")
        done = folder.read_result(site.identity) if args.resume else None
        if done is not None:
            return report(args, site, _stored_outcome(folder, done), folder)
        if args.resume and not folder.holds_run():
            say(args, f"{folder.path}: nothing is stored there to go on with; the search starts from its beginning.\n")
        try:
            variables, metric = scenario.deployment.variables, metric_named(scenario.objective.metric)
            with stops_recognised(), RunProgress(variables, metric) as listener:
                outcome = optimise_site(site, folder, listener, resume=args.resume)
            return report(args, site, outcome, folder)
        except KeyboardInterrupt:
            print(f"blender-lidar: stopped; go on with: --out {folder.path} --resume", file=sys.stderr)
            return 1


def _stored_outcome(folder: RunFolder, result: dict) -> Outcome:
    """What a run that has ended came to, from its folder."""
    if result.get("search") is None:
        raise InputError(f"--resume: {folder.path}: holds one mounting's evaluation, not a search; give another --out")
    return Outcome(
        result=result,
        optimised=folder.read_vehicles(VEHICLES),
        baseline=folder.read_vehicles(VEHICLES_BASELINE),
        score_map=folder.read_score_map(),
        history=folder.read_history(),
    )
