"""What a run prints: what was loaded, and the mounting found beside the baseline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..optimise import DePso, vehicle_score
from ..results import RunFolder
from ..run import Outcome
from ..study.site import Site
from ..study.verdict import distance_bands, lanes

_COORDINATES = {
    "height_m": ("height", "m"),
    "tilt_x_deg": ("tilt across the road", "deg"),
    "tilt_y_deg": ("tilt along the road", "deg"),
    "yaw_deg": ("yaw", "deg"),
    "x_m": ("x along the road", "m"),
    "y_m": ("y across the road", "m"),
}
_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised
_ON_A_BOUND = 0.001  # of the width between two bounds
_ALWAYS_SHOWN = ("height_m", "tilt_x_deg")
_SPLITS = ("search", "holdout")


def describe_site(site: Site, *, searched: bool = True) -> str:
    """What a run will work on, a line for each room of the house; `searched` is False where a mounting is given."""
    scenario, observation, plan = site.scenario, site.observation, site.plan
    lattice = observation.lattice
    sensor = f"{site.model.name}: {lattice.rings} rings x {lattice.columns} columns at {lattice.rotation_hz:g} Hz"
    lines = [
        ("Sensor", f"{sensor}, range gate {observation.max_range_m:g} m"),
        *(("", text) for text in _imperfections(scenario.sensor)),
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
        *(("", note) for note in plan.notes),
        (
            "Casting",
            f"{observation.caster}, detail {observation.detail}, {site.workers} worker{'s' * (site.workers != 1)}",
        ),
    ]
    if searched:
        lines.append(("Searching", _search_text(scenario)))
    return "\n".join(f"{name:<10} {text}" for name, text in lines)


def _imperfections(sensor):
    """What is imperfect about the sensor, in a line; none where nothing is."""
    texts = []
    if sensor.range_noise_m:
        texts.append(f"range noise {sensor.range_noise_m:g} m")
    if sensor.dropout:
        texts.append(f"drop-out {100 * sensor.dropout:g} %")
    if texts:
        texts.append(f"noise seed {sensor.noise_seed}")
    if sensor.unit_spread_deg:
        texts.append(f"unit {sensor.unit} of units that differ by {sensor.unit_spread_deg:g} deg")
    return [", ".join(texts)] if texts else []


def comparison(site: Site, outcome: Outcome) -> str:
    """The mounting and the baseline side by side: scores, then detectable shares by distance and by lane."""
    result, base = outcome.result, outcome.result["baseline"]
    searched = result["search"] is not None
    rows = [
        ("Mounting", "baseline", "optimised" if searched else "given"),
        *(
            (f"  {name} [{unit}]", f"{base['deployment'][key]:.2f}", f"{result['deployment'][key]:.2f}")
            for key, (name, unit) in _COORDINATES.items()
            if key in _ALWAYS_SHOWN or result["deployment"][key] or base["deployment"][key]
        ),
        ("Searched frames" if searched else "Scored frames", "", ""),
        ("  objective [bits]", f"{base['objective']:.1f}", f"{result['objective']:.1f}"),
        *_score_rows(base, result),
    ]
    if result["holdout"]:
        rows += [("Held-out frames", "", ""), *_score_rows(base["holdout"], result["holdout"])]
        rows.append(("  gain per vehicle [bits]", "", f"{result['holdout']['gain_over_baseline']:+.4f}"))
        if result["holdout"]["interval_90"]:
            low, high = result["holdout"]["interval_90"]
            rows.append((f"  90 % interval, {result['holdout']['blocks']} blocks", "", f"{low:+.4f} to {high:+.4f}"))
    tables = [_table(rows), _table(_group_rows("distance", distance_bands, site, outcome))]
    if outcome.baseline["lane"].any():
        tables.append(_table(_group_rows("lane", lanes, site, outcome)))
    return "\n\n".join([*tables, "\n".join(_notes(site, result))]).rstrip()


def files(folder: RunFolder, charts: Sequence[str]) -> str:
    """Where the results are."""
    drawn = f" and {len(charts)} charts" if charts else ""
    return f"Results in {folder.path}: result.json, vehicles.csv, installation.txt{drawn}"


def _score_rows(base, found):
    return [
        (
            "  objective per vehicle [bits]",
            f"{base['objective_per_vehicle']:.4f}",
            f"{found['objective_per_vehicle']:.4f}",
        ),
        ("  detectable share [%]", f"{100 * base['detectable_share']:.1f}", f"{100 * found['detectable_share']:.1f}"),
    ]


def _group_rows(title, groups, site, outcome):
    """Objective per vehicle and detectable share of each group, searched and held out, before and after."""
    searched = outcome.result["search"] is not None
    tables = {"baseline": outcome.baseline, "optimised" if searched else "given": outcome.optimised}
    names = {"search": "searched" if searched else "scored", "holdout": "held out"}
    splits = [split for split in _SPLITS if (outcome.optimised["split"] == split).any()]
    rows = [
        ("", *(cell for split in splits for cell in (names[split], "", "", "")), ""),
        ("", *(cell for _ in splits for cell in ("bits", "", "detectable %", "")), ""),
        (f"by {title}", *(name for _ in splits for _ in range(2) for name in ("before", "after")), "vehicles"),
    ]
    scores = {name: _scores(table, site.scoring) for name, table in tables.items()}
    for group, chosen in groups(outcome.baseline):
        if not chosen.any():
            continue
        cells = []
        for split in splits:
            mine = {name: chosen & (table["split"] == split) for name, table in tables.items()}
            cells += [f"{scores[name][rows_of].mean():.3f}" if rows_of.any() else "-" for name, rows_of in mine.items()]
            found = {name: tables[name]["detectable"][rows_of] for name, rows_of in mine.items()}
            cells += [f"{100 * flags.mean():.1f}" if len(flags) else "-" for flags in found.values()]
        rows.append((f"  {group}", *cells, str(int(chosen.sum()))))
    return rows


def _scores(table, scoring):
    return vehicle_score(table["entropy_bits"], table["detectable"], scoring.loss, scoring.reading)


def _notes(site, result):
    """What the numbers mean, and what the search and the map say about how far to trust the optimum."""
    objective = site.scenario.objective
    notes = []
    if objective.reading == "corrected":
        loss = f"{abs(objective.loss):g} bit{'s' * (abs(objective.loss) != 1)}"
        notes.append(f"Objective: the entropy of every detectable vehicle, less {loss} for every other one.")
    if result["search"] is None:
        return notes
    if result["objective"] <= result["baseline"]["objective"]:
        notes.append("No mounting that was tried is better than the baseline.")
    for key, (low, high) in site.scenario.deployment.bounds.items():
        slack = _ON_A_BOUND * (high - low)
        if not low + slack < result["deployment"][key] < high - slack:
            notes.append(f"The best {_COORDINATES[key][0]} lies on a bound of [deployment]; beyond may be better.")
    if result["map"]:
        notes += _map_notes(result["map"])
    return notes


def _map_notes(score_map):
    grid = f"a grid of {score_map['points'][0]} x {score_map['points'][1]} heights and tilts"
    shortfall, best = score_map["search_shortfall"], score_map["best"]
    notes = []
    if shortfall == 0:
        notes.append(f"No point of {grid} is better than the mounting found.")
    elif shortfall is not None and shortfall < _SMALL_SHORTFALL:
        notes.append(f"The search found all but {100 * shortfall:.2f} % of the gain that {grid} offers.")
    elif shortfall is not None:
        notes += [
            f"The search missed {100 * shortfall:.1f} % of the gain that {grid} offers, at",
            f"{best['height_m']:.2f} m and {best['tilt_x_deg']:.1f} deg: give it more --particles or --iterations.",
        ]
    regret = score_map.get("holdout_regret")  # not in the results of earlier versions
    if regret is not None and regret > _SMALL_SHORTFALL:
        lacks = f"lacks {100 * regret:.1f} % of the gain that the best point of that grid has there"
        notes.append(f"On the held-out frames the mounting found {lacks}.")
    if score_map["share_within_1_percent"] is not None:
        share = 100 * score_map["share_within_1_percent"]
        how_many = (
            f"{share:.1f} % of those heights and tilts come" if share else "None of those heights and tilts comes"
        )
        notes.append(f"{how_many} within 1 % of the gain of the best one.")
    intervals = score_map["optimum_interval_90"]
    if intervals:
        height, tilt = intervals["height_m"], intervals["tilt_x_deg"]
        notes += [
            f"Other traffic of this kind would put the best height between {height[0]:.1f} and {height[1]:.1f} m and",
            f"the best tilt between {tilt[0]:.0f} and {tilt[1]:.0f} deg (90 % of resampled blocks of time).",
        ]
    return notes


def _table(rows):
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
    if not len(site.holdout):
        return "nothing"
    return f"{_frames(site.holdout, site.plan.holdout_block)}; none of them is in a searched frame"


def _search_text(scenario):
    settings, bounds = scenario.search, scenario.deployment.bounds
    ranges = (
        f"{name} {bounds[key][0]:g} to {bounds[key][1]:g} {unit}"
        for key, (name, unit) in _COORDINATES.items()
        if key in bounds
    )
    budget = (
        f"{settings.particles} particles x {settings.iterations} iterations"
        if settings.method == DePso.name
        else f"{settings.particles * settings.iterations} evaluations"
    )
    return (
        f"{', '.join(ranges)}; {settings.method}, {budget}, seed {settings.seed}, {scenario.objective.reading} reading"
    )
