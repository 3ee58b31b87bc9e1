"""What a run prints: what was loaded, and the mounting found beside the baseline."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import asdict

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..optimise import DePso
from ..report.summary import cautions, compared_names, comparison_sections, group_scores
from ..run.folder import RunFolder
from ..run.installation import (
    COORDINATE_NAMES,
    aim_text,
    imperfections_text,
    objective_text,
    scenery_counts,
    scenery_text,
    tolerance_text,
)
from ..run.optimise import AUTO, Outcome
from ..run.tolerance import SEARCHED_BASE
from ..run.verdict import distance_bands, lanes
from ..scene.site import Site
from ..scoring.evaluation import workplace_of

_NOTE_WIDTH = 120


def describe_site(site: Site, *, searched: bool = True) -> str:
    """What a run will work on, a line for each room of the house; `searched` is False where a mounting is given."""
    scenario, observation, plan = site.scenario, site.observation, site.plan
    lattice = observation.lattice
    sensor = f"{site.model.name}: {lattice.rings} rings x {lattice.columns} columns at {lattice.rotation_hz:g} Hz"
    lines = [
        ("Sensor", f"{sensor}, range gate {observation.max_range_m:g} m"),
        *_given("", imperfections_text(scenario.sensor.imperfections_as_table())),
        *_given("Scenery", scenery_text(scenery_counts(observation.scenery))),
        (
            "Traffic",
            f"{scenario.traffic.path}: {len(site.recording.frames)} frames, "
            f"{np.median(site.recording.counts):.0f} vehicles in the median one",
        ),
        *(("", line) for line in site.recording.report.lines()),
        (
            "Searched" if searched else "Scored",
            f"{_frames(site.search, plan.search_block)} of {plan.block_s:g} s; a vehicle counts in every frame",
        ),
        ("Held out", _held_out(site)),
        *_given("Tolerance", _tolerance_text(scenario, searched)),
        *(("", note) for note in plan.notes),
        (
            "Casting",
            f"{observation.caster}, detail {observation.detail}, {workplace_of(scenario.model)}",
        ),
    ]
    if searched:
        lines.append(("Searching", _search_text(scenario)))
    return "\n".join(f"{name:<10} {text}" for name, text in lines)


def _given(name, text):
    """A line of the heading, if there is something to say."""
    return [(name, text)] if text else []


def comparison(outcome: Outcome) -> str:
    """The mounting and the baseline side by side: scores, then detectable shares by distance and by lane."""
    result = outcome.result
    rows = [("Mounting", *compared_names(result))]
    for heading, lines in comparison_sections(result):
        if heading != rows[0][0]:
            rows.append((heading,))
        rows += [(f"  {what}", *numbers) for what, *numbers in lines]
    tables = [_table(rows), _table(_group_rows("distance", distance_bands, outcome))]
    if outcome.baseline["lane"].any():
        tables.append(_table(_group_rows("lane", lanes, outcome)))
    notes = cautions(result)
    if result["reading"] == "corrected" or metric_named(result["metric"]) is not PE_VGOP:
        notes.insert(0, f"Objective: {objective_text(result)}.")
    told = "\n".join(textwrap.fill(note, _NOTE_WIDTH) for note in notes)
    return "\n\n".join([*tables, told]).rstrip()


def files(folder: RunFolder, charts: Sequence[str]) -> str:
    """Where the results are."""
    drawn = f" and {len(charts)} charts" if charts else ""
    return f"Results in {folder.path}: report.html, result.json, vehicles.csv, installation.txt{drawn}"


def _group_rows(title, groups, outcome):
    """Scores by distance or by lane under three lines of headings."""
    scores = group_scores(groups, outcome.result, outcome.baseline, outcome.optimised)
    return [
        ("", *(cell for split in scores.splits for cell in (split, "", "", "")), ""),
        ("", *(cell for _ in scores.splits for cell in (scores.measure, "", "detectable %", "")), ""),
        (f"by {title}", *(name for _ in scores.splits for _ in range(2) for name in ("before", "after")), "vehicles"),
        *((f"  {name}", *cells, str(vehicles)) for name, cells, vehicles in scores.rows),
    ]


def _table(rows):
    """Rows in columns: the first flush left, numbers flush right."""
    widths = [max(len(row[column]) for row in rows if len(row) > column) for column in range(max(map(len, rows)))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    )


def _frames(frames, block):
    """How many frames and vehicles, and in how many blocks of time."""
    number, counted = len(np.unique(block)), sum(int(frame.counted.sum()) for frame in frames)
    return f"{len(frames)} frames, {counted} vehicles within the gate, in {number} block{'s' * (number != 1)}"


def _held_out(site):
    """The held-out frames, or that there are none."""
    if not len(site.holdout):
        return "nothing"
    return f"{_frames(site.holdout, site.plan.holdout_block)}; none of them is in a searched frame"


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
    settings, bounds = scenario.search, scenario.deployment.bounds
    ranges = (
        f"{name} {bounds[key][0]:g} to {bounds[key][1]:g} {unit}"
        for key, (name, unit) in COORDINATE_NAMES.items()
        if key in bounds
    )
    budget = (
        f"{settings.particles} particles x {settings.iterations} iterations"
        if settings.method == DePso.name
        else f"{settings.particles * settings.iterations} evaluations"
    )
    if settings.fidelity == AUTO:
        budget = "from few frames and beams to all (fidelity auto)"
    objective = scenario.objective
    metric = "" if objective.metric == PE_VGOP.name else f", metric {objective.metric}"
    return (
        f"{', '.join(ranges)}; {settings.method}, {budget}, seed {settings.seed}, {objective.reading} reading{metric}"
    )
