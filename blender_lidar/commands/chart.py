"""blender-lidar chart: speed against accuracy, and how much model a scene needs."""

from __future__ import annotations

import argparse
import math
import sys

from ..errors import InputError
from ..report.chart import CHART_REPORT
from ..scene.scenario import Scenario
from ..scene.site import Site, prepare
from ..sensors.model import load_model
from ..studies.chart import chart_identity, chart_study, read_paired
from ..studies.driver import StudyFolder
from ..studies.effects import candidates
from ..studies.ladder import FULL_CHART, QUICK_CHART
from .optimise import check_resume
from .options import add_scene, check_scipy, scenario_from
from .studies import add_study_options, carry_out, effort_of

OTHER_SENSORS = ("RS-80", "RS-32")  # the first that is not the scene's own
NO_SENSOR = "none"
DEFAULT_TOLERANCE = "1%"


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "chart",
        help="speed charted against accuracy, and how much model a scene needs",
        description="Time and judge a ladder of fidelities (vehicle detail, share of the beams and frames, caster, "
        "culling, ground) against the reference of all beams, all frames and the best detail; name the cheapest that "
        "is near enough; and say what of the scene's model makes a difference at all.",
    )
    add_scene(parser, leave_out=("--tolerance", "--search", "--particles", "--iterations"))
    parser.add_argument(
        "--tolerance",
        default=DEFAULT_TOLERANCE,
        metavar="SHARE",
        help="how much of the gain over the baseline a fidelity may lose: 1%% or 0.01 (how far off its plan the "
        "mounting may end up, as other verbs have it, is not asked here)",
    )
    parser.add_argument(
        "--other-sensor",
        metavar="NAME",
        help=f"another than the scene's, with which the recommendation is tried too, or {NO_SENSOR}; by default "
        f"{OTHER_SENSORS[0]}, for a scene of its own {OTHER_SENSORS[1]}",
    )
    parser.add_argument(
        "--paired", metavar="PATH", help="paired.json of compare --paired, or its folder: its errors stand beside"
    )
    add_study_options(parser, "ten frames, fewer mountings and draws")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_resume(args)
    tolerance = parse_share(args.tolerance, "--tolerance")
    check_scipy("chart")
    scenario = scenario_from(args)
    candidates(scenario, 2)  # refuses a scene that searches nothing
    paired = None if args.paired is None else read_paired(args.paired)
    effort, site, other = effort_of(args, FULL_CHART, QUICK_CHART), prepare(scenario), _other_site(args, scenario)

    def study(folder: StudyFolder) -> dict:
        return chart_study(site, effort, tolerance, folder, other, paired)

    return carry_out(args, "chart", site, chart_identity(site, effort, other), CHART_REPORT, study)


def parse_share(text: str, option: str) -> float:
    """A share from "1%" or "0.01"; above 0, at most 1."""
    number = text.strip()
    try:
        share = float(number.removesuffix("%")) / (100.0 if number.endswith("%") else 1.0)
    except ValueError:
        share = math.nan
    if not 0.0 < share <= 1.0:
        raise InputError(f"{option}: is {text!r}; allowed: a share above 0 up to 1, such as 1% or 0.01")
    return share


def _other_site(args: argparse.Namespace, scenario: Scenario) -> Site | None:
    """The scene with another sensor; its range gate and the rest are what the scene says of that one."""
    asked, own = args.other_sensor, load_model(scenario.sensor.name).name
    if asked == NO_SENSOR:
        return None
    name = next(other for other in OTHER_SENSORS if other != own) if asked is None else asked
    try:
        other = scenario_from(argparse.Namespace(**{**vars(args), "sensor": name}))
        if load_model(other.sensor.name).name == own:
            raise InputError(f"--other-sensor: is {name!r}, the scene's own; allowed: another one, or {NO_SENSOR}")
        return prepare(other)
    except InputError as error:
        if asked is not None:
            raise
        print(f"blender-lidar: note: not tried with {name}: {error}", file=sys.stderr)
        return None
