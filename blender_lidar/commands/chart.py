"""blender-lidar chart: speed against accuracy, and how much model a scene needs."""

from __future__ import annotations

import argparse
import math
import sys

from ..errors import InputError, MissingFileError
from ..report.chart import CHART_REPORT
from ..scene.scenario import Scenario
from ..scene.site import Site, prepare
from ..sensors.model import load_model
from ..studies.chart import chart_identity, chart_study, read_paired
from ..studies.driver import StudyFolder
from ..studies.effects import candidates
from ..studies.findings import check_one_place
from ..studies.ladder import FULL_CHART, QUICK_CHART
from .optimise import check_resume
from .options import check_scipy, scenario_from
from .parsers import NO_SENSOR, OTHER_SENSORS
from .studies import carry_out, effort_of


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    check_resume(args)
    tolerance = parse_share(args.max_regret, "--max-regret")
    check_scipy("chart")
    scenario = scenario_from(args)
    check_one_place(scenario)
    candidates(scenario, 2)  # refuses a scene that searches nothing
    paired = None if args.paired_errors is None else read_paired(args.paired_errors)
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
        load_model(name)
    except (InputError, MissingFileError) as error:
        raise type(error)(f"--other-sensor: {error}") from error
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
