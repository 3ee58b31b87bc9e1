"""blender-lidar optimise: traffic in, best mounting out."""

from __future__ import annotations

import argparse
import json
import sys

from ..errors import InputError, MissingExtraError
from ..optimise import Search
from ..results import RunFolder, run_identity
from ..scenario import Scenario
from ..study.run import Outcome, optimise_site
from ..study.score_map import AXES, POINTS
from ..study.site import Site, prepare
from .options import add_scene, default_folder, scenario_from
from .progress import Progress
from .report import comparison, describe_site, files


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "optimise",
        help="find the best mounting for a scene",
        description="Find the mounting with the highest objective, judge it on held-out traffic and leave a folder of results.",
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
    scenario = scenario_from(args)
    if not scenario.deployment.bounds:
        raise InputError(
            f"{args.scene}: [deployment] fixes every coordinate; give at least one a pair [low, high], or use evaluate"
        )
    folder = _folder(args, scenario)
    with folder.locked():
        site = prepare(scenario)
        say(args, describe_site(site) + "\n")
        if args.resume:
            done = folder.read_result(run_identity(scenario, site.observation.caster))
            if done is not None:
                say(args, f"{folder.path}: this run has ended already.")
                return _print_json(args, done)
        try:
            with _TerminalListener(scenario) as listener:
                outcome = optimise_site(site, folder, listener, resume=args.resume)
        except KeyboardInterrupt:
            print(f"\nstopped; go on with: --out {folder.path} --resume", file=sys.stderr)
            return 1
        return report(args, site, outcome, folder)


def report(args: argparse.Namespace, site: Site, outcome: Outcome, folder: RunFolder) -> int:
    """Draw the charts and print what was found."""
    charts = []
    try:
        from ..study.run_charts import draw_charts

        charts = draw_charts(site, outcome, folder)
    except MissingExtraError as error:
        print(f"no charts: {error}", file=sys.stderr)
    say(args, comparison(site, outcome) + "\n\n" + files(folder, charts))
    return _print_json(args, outcome.result)


def _folder(args, scenario: Scenario) -> RunFolder:
    if args.resume and args.out is None:
        raise InputError("--resume: needs --out DIR, the folder of the run that was stopped")
    folder = RunFolder(args.out if args.out is not None else default_folder(scenario))
    if folder.holds_run() and not args.resume:
        raise InputError(f"--out: {folder.path}: holds a run already; go on with --resume, or give another folder")
    return folder


def say(args: argparse.Namespace, text: str) -> None:
    """Print for people: on stderr where stdout is for JSON."""
    print(text, file=sys.stderr if args.json else sys.stdout, flush=True)


def _print_json(args, result) -> int:
    if args.json:
        print(json.dumps(result, indent=2))
    return 0


class _TerminalListener:
    """Shows how a run comes along: a bar for the search, one for the map."""

    def __init__(self, scenario: Scenario) -> None:
        self._deployment = scenario.deployment
        self._bar: Progress | None = None
        self._search: Search | None = None
        self._mapping = False

    def __enter__(self) -> _TerminalListener:
        return self

    def __exit__(self, *exception) -> None:
        self._close()

    def searching(self, search: Search) -> None:
        if self._search is None:
            self._bar, self._search, self._done = (
                Progress(search.budget, "search", search.evaluations),
                search,
                search.evaluations,
            )
            return
        self._bar.advance(search.evaluations - self._done, self._best(search))
        self._done = search.evaluations

    def mapping(self, points: int) -> None:
        if not self._mapping:
            self._close()
            self._bar, self._mapping = Progress(POINTS[0] * POINTS[1], f"map of {' and '.join(AXES)}"), True
        self._bar.advance(points)

    def _best(self, search):
        mount = ", ".join(
            f"{key} {value:.2f}" for key, value in zip(self._deployment.variables, search.best_x, strict=True)
        )
        return f"best {search.best_value:.1f} bits at {mount}"

    def _close(self):
        if self._bar is not None:
            self._bar.close()
