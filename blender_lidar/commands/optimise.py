"""blender-lidar optimise: traffic in, best mounting out."""

from __future__ import annotations

import argparse
import json
import sys

from ..errors import InputError, MissingExtraError
from ..results import VEHICLES, VEHICLES_BASELINE, RunFolder, run_identity
from ..run import Outcome, optimise_site
from ..scenario import Scenario
from ..study.site import Site, prepare
from .options import add_scene, default_folder, scenario_from
from .progress import RunProgress
from .report import comparison, describe_site, files


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "optimise",
        help="find the best mounting for a scene",
        description="Find the mounting with the highest objective, judge it on held-out traffic and leave a folder of "
        "results.",
    )
    add_scene(parser)
    parser.add_argument("--out", metavar="DIR", help="folder of the results; by default a new one under runs/")
    parser.add_argument("--resume", action="store_true", help="go on with the run in --out DIR that was stopped")
    parser.add_argument(
        "--json", action="store_true", help="print the content of result.json, and nothing else, on stdout"
    )
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    if args.resume and args.out is None:
        raise InputError("--resume: needs --out DIR, the folder of the run that was stopped")
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
        done = folder.read_result(run_identity(scenario, site.observation.caster)) if args.resume else None
        if done is not None:
            return report(args, site, _stored_outcome(folder, done), folder)
        if args.resume and not folder.holds_run():
            say(args, f"{folder.path}: nothing is stored there to go on with; the search starts from its beginning.\n")
        try:
            with RunProgress(scenario.deployment.variables) as listener:
                outcome = optimise_site(site, folder, listener, resume=args.resume)
        except KeyboardInterrupt:
            print(f"blender-lidar: stopped; go on with: --out {folder.path} --resume", file=sys.stderr)
            return 1
        return report(args, site, outcome, folder)


def folder_from(args: argparse.Namespace, scenario: Scenario) -> RunFolder:
    """The folder that the results go to, not yet made; a place that cannot be used is refused early."""
    folder = RunFolder(args.out if args.out is not None else default_folder(scenario))
    folder.check(resume=getattr(args, "resume", False))
    return folder


def report(args: argparse.Namespace, site: Site, outcome: Outcome, folder: RunFolder) -> int:
    """Draw the charts and print what was found."""
    charts = []
    try:
        from ..run_charts import draw_charts

        charts = draw_charts(site, outcome, folder)
    except MissingExtraError as error:
        print(f"blender-lidar: note: no charts: {error}", file=sys.stderr)
    say(args, comparison(site, outcome) + "\n\n" + files(folder, charts))
    if args.json:
        print(json.dumps(outcome.result, indent=2))
    return 0


def say(args: argparse.Namespace, text: str) -> None:
    """Print for people: on stderr where stdout is for JSON."""
    print(text, file=sys.stderr if args.json else sys.stdout, flush=True)


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
