"""Where a run's results go, and how they are told: what the verbs that leave a folder share."""

from __future__ import annotations

import argparse
import json
import sys

from ..errors import InputError, MissingExtraError
from ..reporting.page import write_report
from ..results import RunFolder
from ..run import Outcome
from ..scenario import Scenario
from ..study.site import Site
from .options import default_folder
from .report import comparison, files


def add_output(parser: argparse.ArgumentParser) -> None:
    """The options that say where results go."""
    parser.add_argument("--out", metavar="DIR", help="folder of the results; by default a new one under runs/")
    parser.add_argument(
        "--json", action="store_true", help="print the content of result.json, and nothing else, on stdout"
    )


def check_resume(args: argparse.Namespace) -> None:
    """Refuse ``--resume`` without the folder that it is about."""
    if args.resume and args.out is None:
        raise InputError("--resume: needs --out DIR, the folder of the run that was stopped")


def folder_from(args: argparse.Namespace, scenario: Scenario) -> RunFolder:
    """The folder that the results go to, not yet made; a place that cannot be used is refused early."""
    folder = RunFolder(args.out if args.out is not None else default_folder(scenario))
    folder.check(resume=getattr(args, "resume", False))
    return folder


def report(args: argparse.Namespace, site: Site, outcome: Outcome, folder: RunFolder) -> int:
    """Draw the charts, gather all in one page and print what was found."""
    charts = []
    try:
        from ..run_charts import draw_charts

        charts = draw_charts(site, outcome, folder)
    except MissingExtraError as error:
        print(f"blender-lidar: note: no charts: {error}", file=sys.stderr)
    write_report(folder)
    say(args, comparison(outcome) + "\n\n" + files(folder, charts))
    if args.json:
        print(json.dumps(outcome.result, indent=2))
    return 0


def say(args: argparse.Namespace, text: str) -> None:
    """Print for people: on stderr where stdout is for JSON."""
    print(text, file=sys.stderr if args.json else sys.stdout, flush=True)
