"""What a run prints: what was loaded, and the mounting found beside the baseline."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Sequence
from dataclasses import asdict
from itertools import zip_longest

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..optimise import DePso
from ..plugins import short_name
from ..report.summary import (
    COORDINATE_NAMES,
    aim_text,
    answer,
    as_sentence,
    cautions,
    counted,
    definitions,
    imperfections_text,
    region_text,
    scenery_text,
    warnings_text,
)
from ..report.tables import TextTable, comparison_table, group_tables, poles_table, recordings_table
from ..run.folder import Outcome, RunFolder
from ..run.optimise import AUTO, scenery_counts
from ..run.tolerance import SEARCHED_BASE, tolerance_text
from ..scene.site import Site
from ..scoring.evaluation import workplace_of

_NOTE_WIDTH = 120


def describe_site(site: Site, *, searched: bool = True, verbose: bool = False) -> str:
    """What a run will work on, in a few lines; in the solver's words, with all that was read, where `verbose`.

    `searched` is False where a mounting is given.
    """
    lines = _all_lines(site, searched) if verbose else _few_lines(site, searched)
    accepted = warnings_text({"warnings": site.recording.report.warnings_as_dicts()})
    return "\n".join([*accepted, *(f"{name:<10} {text}" for name, text in lines if text)])


def _few_lines(site: Site, searched: bool) -> list[tuple[str, str]]:
    scenario, boxes = site.scenario, sum(int(frame.counted.sum()) for frame in site.search)
    searched_traffic = f"{counted(len(site.search), 'frame')} with {counted(boxes, 'box')} of "
    searched_traffic += counted(len(site.plan.searched_ids), "vehicle")
    columns = f" with {site.model.columns()} columns a turn" if site.model.columns_a_turn else ""
    held_out = "; no frame is held out"
    if site.holdout:
        held_out = f"; {counted(len(site.holdout), 'held-out frame')} for the check"
    return [
        ("Sensor", f"{site.model.name}{columns}, range gate {site.observation.lidar.max_range_m:g} m"),
        ("", _assumed_text(site)),
        ("", imperfections_text(scenario.sensor.imperfections_as_table())),
        ("Scenery", scenery_text(scenery_counts(site))),
        ("Traffic", f"{_traffic_text(site)}: {searched_traffic}{held_out}"),
        *(("", line) for line in site.recording.report.lines(losses=True)),
        ("Region", f"vehicles count {region_text(asdict(scenario.region))}"),
        ("Tolerance", _tolerance_text(scenario, searched)),
        ("Searched", _ranges(scenario) if searched else ""),
        ("Casting", f"{site.observation.caster}, detail {site.observation.detail}, {workplace_of(scenario.model)}"),
    ]


def _all_lines(site: Site, searched: bool) -> list[tuple[str, str]]:
    scenario, observation, plan = site.scenario, site.observation, site.plan
    lattice = observation.lattice
    sensor = f"{site.model.name}: {lattice.rings} rings x {lattice.columns} columns at {lattice.rotation_hz:g} Hz"
    return [
        ("Sensor", f"{sensor}, range gate {observation.lidar.max_range_m:g} m"),
        ("", _assumed_text(site)),
        ("", imperfections_text(scenario.sensor.imperfections_as_table())),
        ("Scenery", scenery_text(scenery_counts(site))),
        (
            "Traffic",
            f"{_traffic_text(site)}: {counted(len(site.recording.frames), 'frame')}, "
            f"{counted(round(np.median(site.recording.counts)), 'vehicle')} in the median one",
        ),
        *(("", line) for line in site.recording.report.lines()),
        ("Region", f"vehicles count {region_text(asdict(scenario.region))}"),
        (
            "Searched" if searched else "Scored",
            f"{_frames(site.search, plan.search_block)} of {plan.block_s:g} s; a vehicle counts in every frame",
        ),
        (
            "Held out",
            f"{_frames(site.holdout, plan.holdout_block)}; none of them is in a searched frame"
            if len(site.holdout)
            else "nothing",
        ),
        ("Tolerance", _tolerance_text(scenario, searched)),
        *(("", note) for note in plan.notes),
        ("Casting", f"{observation.caster}, detail {observation.detail}, {workplace_of(scenario.model)}"),
        ("Searching", _search_text(scenario) if searched else ""),
    ]


def _traffic_text(site: Site) -> str:
    """Which recording a run is about, or all of several with their weights."""
    recordings = site.scenario.recordings
    if len(recordings) == 1:
        return recordings[0].path
    return " and ".join(f"{one.name} ({one.path}, weight {one.weight:g})" for one in recordings)


def _assumed_text(site: Site) -> str:
    """What the beam table of a user's own leaves open and is assumed; empty where it says all."""
    assumed = site.model.assumptions.values()
    return f"Assumed, as its file does not say: {'; '.join(assumed)}" if assumed else ""


def outcome_text(run: Outcome, where: str) -> str:
    """What a run came to, the answer first: it, what its words mean, tables, `where` the results are, warnings last.

    Warnings are what the run says of how far to trust it: of the search, of its frames, and of the recording.
    """
    result, metric = run.result, metric_named(run.result["metric"])
    unit = f", in {metric.unit}" if metric.unit else ""
    words = definitions(result)
    meant = [f"Objective{unit}: {words['objective']}", f"Detectable: {words['detectable']}"]
    every = (poles_table(result), comparison_table(result), recordings_table(result), *group_tables(run))
    tables = [table_text(table) for table in every if table is not None]
    warnings = [*cautions(result), *map(as_sentence, (*result["notes"], *result["traffic_report"]["notes"]))]
    parts = [_filled([*warnings_text(result), answer(result)]), _filled(meant), *tables, where, _filled(warnings)]
    return "\n\n".join(part for part in parts if part)


def _filled(sentences: Sequence[str]) -> str:
    """Sentences, each on lines of its own that fit the terminal."""
    width = min(shutil.get_terminal_size((_NOTE_WIDTH, 24)).columns, _NOTE_WIDTH)
    return "\n".join(textwrap.fill(sentence, width, break_on_hyphens=False) for sentence in dict.fromkeys(sentences))


def table_text(table: TextTable) -> str:
    """A table in columns: the first flush left, numbers flush right."""
    rows = [[cell for text, columns in line for cell in (text, *[""] * (columns - 1))] for line in table.head]
    for heading, lines in table.sections:
        rows += [[heading]] * bool(heading) + [[f"  {what}", *cells] for what, *cells in lines]
    widths = [max(map(len, column)) for column in zip_longest(*rows, fillvalue="")]
    padded = ([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])] for row in rows)
    return "\n".join("  ".join(cells).rstrip() for cells in padded)


def files(folder: RunFolder, charts: Sequence[str]) -> str:
    """Where the results are."""
    drawn = f" and {len(charts)} charts" if charts else ""
    return f"Results in {folder.path}: report.html, result.json, vehicles.csv, installation.txt{drawn}"


def _frames(frames, block):
    """How many frames and vehicles, and in how many blocks of time."""
    number, boxes = len(np.unique(block)), sum(int(frame.counted.sum()) for frame in frames)
    return f"{counted(len(frames), 'frame')}, {counted(boxes, 'box')} within the gate, in {counted(number, 'block')}"


def _tolerance_text(scenario, searched):
    """The tolerance of installation, and how it is searched; empty where there is none."""
    tolerance = scenario.objective.tolerance
    if tolerance is None:
        return ""
    settings = asdict(tolerance)
    errors = SEARCHED_BASE[tolerance.aim] ** 2
    then = f"; searched after the sharp mounting, over {errors} errors of each" if searched else ""
    return f"{tolerance_text(settings)}: {aim_text(settings)}{then}"


def _search_text(scenario):
    """What is searched, between which bounds, how, and with what budget."""
    settings = scenario.search
    budget = (
        f"{settings.particles} particles x {settings.iterations} iterations"
        if settings.method == DePso.name
        else f"{settings.particles * settings.iterations} evaluations"
    )
    if settings.fidelity == AUTO:
        budget = "from few frames and beams to all (fidelity auto)"
    objective = scenario.objective
    metric = "" if objective.metric == PE_VGOP.name else f", metric {short_name(objective.metric)}"
    method = f"{short_name(settings.method)}, {budget}, seed {settings.seed}"
    return f"{_ranges(scenario)}; {method}, {objective.reading} reading{metric}"


def _ranges(scenario):
    """The searched coordinates, each with its bounds; over all poles, which may have heights of their own."""
    deployment, poles, ranges = scenario.deployment, len(scenario.deployment.poles), []
    for key, (name, unit) in COORDINATE_NAMES.items():
        bounds = {place.bounds[key] for place in deployment.places if key in place.bounds}
        if bounds:
            own = ", as each pole allows" if len(bounds) > 1 else ""
            ranges.append(f"{name} {min(bounds)[0]:g} to {max(high for _, high in bounds):g} {unit}{own}")
    return (f"{counted(poles, 'pole')}; on each: " if poles else "") + ", ".join(ranges)
