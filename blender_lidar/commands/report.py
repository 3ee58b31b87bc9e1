"""What a run prints: what was loaded, and the mounting found beside the baseline."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..results import RunFolder
from ..study.run import Outcome
from ..study.run_charts import mounting_text
from ..study.site import Site
from ..study.verdict import distance_bands, lanes

_WIDEST_NOTE = 110


def describe_site(site: Site) -> str:
    """What a run will work on, a line for each room of the house."""
    scenario, lattice, plan = site.scenario, site.observation.lattice, site.plan
    counted = sum(int(frame.counted.sum()) for frame in site.search)
    lines = [
        (
            "Sensor",
            f"{site.model.name}: {lattice.rings} rings x {lattice.columns} columns at {lattice.rotation_hz:g} Hz, range gate "
            f"{site.observation.max_range_m:g} m",
        ),
        (
            "Traffic",
            f"{scenario.traffic.path}: {len(site.recording.frames)} frames, "
            f"{np.median(site.recording.counts):.0f} vehicles in the median one",
        ),
        *(("", line) for line in site.recording.report.lines()),
        (
            "Searched",
            f"{len(site.search)} frames, {counted} vehicles within the gate, in {_blocks(plan.search_block)} of {plan.block_s:g} s",
        ),
        ("Held out", _held_out(site)),
        *(("", note) for note in plan.notes),
        (
            "Casting",
            f"{site.observation.caster}, detail {site.observation.detail}, {site.workers} worker{'s' * (site.workers != 1)}",
        ),
        ("Searching", _search_text(scenario)),
    ]
    return "\n".join(f"{name:<10} {text}" for name, text in lines)


def comparison(site: Site, outcome: Outcome) -> str:
    """The mounting and the baseline side by side: scores, then detectable shares by distance and by lane."""
    result, base = outcome.result, outcome.result["baseline"]
    rows = [
        ("Mounting", "baseline", "optimised" if result["search"] else "given"),
        *(
            (name, f"{base['deployment'][key]:.2f}", f"{result['deployment'][key]:.2f}")
            for name, key in _coordinates(result)
        ),
        ("Searched frames", "", ""),
        ("  objective [bits]", f"{base['objective']:.1f}", f"{result['objective']:.1f}"),
        *_score_rows(base, result),
    ]
    if result["holdout"]:
        rows += [("Held-out frames", "", ""), *_score_rows(base["holdout"], result["holdout"])]
        rows.append(("  gain per vehicle [bits]", "", f"{result['holdout']['gain_over_baseline']:+.4f}"))
        if result["holdout"]["interval_90"]:
            low, high = result["holdout"]["interval_90"]
            rows.append((f"  90 % interval, {result['holdout']['blocks']} blocks", "", f"{low:+.4f} to {high:+.4f}"))
    text = _table(rows)
    for title, groups in (("Distance", distance_bands), ("Lane", lanes)):
        text += "\n\n" + _table(_group_rows(title, groups, outcome))
    return text + "".join(f"\n{line}" for line in _map_lines(result))


def files(folder: RunFolder, charts: Sequence[str]) -> str:
    """Where the results are."""
    return (
        f"Results in {folder.path}: result.json, vehicles.csv, installation.txt and {len(charts)} charts"
        if charts
        else (f"Results in {folder.path}: result.json, vehicles.csv, installation.txt")
    )


def _coordinates(result):
    names = {
        "height_m": "  height [m]",
        "tilt_x_deg": "  tilt across the road [deg]",
        "tilt_y_deg": "  tilt along the road [deg]",
        "yaw_deg": "  yaw [deg]",
        "x_m": "  x along the road [m]",
        "y_m": "  y across the road [m]",
    }
    both = (result["deployment"], result["baseline"]["deployment"])
    always = ("height_m", "tilt_x_deg")
    return [(name, key) for key, name in names.items() if key in always or any(mount[key] for mount in both)]


def _score_rows(base, found):
    return [
        (
            "  objective per vehicle [bits]",
            f"{base['objective_per_vehicle']:.4f}",
            f"{found['objective_per_vehicle']:.4f}",
        ),
        ("  detectable share [%]", f"{100 * base['detectable_share']:.1f}", f"{100 * found['detectable_share']:.1f}"),
    ]


def _group_rows(title, groups, outcome):
    """Detectable share of each group, on the searched and the held-out frames, before and after."""
    splits = [split for split in ("search", "holdout") if (outcome.optimised["split"] == split).any()]
    names = {"search": "searched", "holdout": "held out"}
    rows = [
        (
            f"{title}: detectable [%]",
            *(f"{names[split]} {which}" for split in splits for which in ("before", "after")),
            "vehicles",
        )
    ]
    for name, chosen in groups(outcome.baseline):
        shares = []
        for split in splits:
            for table in (outcome.baseline, outcome.optimised):
                mine = chosen & (table["split"] == split)
                shares.append(f"{100 * table['detectable'][mine].mean():.1f}" if mine.any() else "-")
        if chosen.any():
            rows.append((f"  {name}", *shares, str(int(chosen.sum()))))
    return rows


def _map_lines(result):
    if not result["map"]:
        return []
    lines = [""]
    regret = result["map"]["search_regret"]
    if regret is not None:
        lines.append(
            f"Against the {result['map']['points'][0]} x {result['map']['points'][1]} grid the search falls short by {100 * regret:.2f} % of the gain."
        )
    lines.append(
        f"{100 * result['map']['share_within_1_percent']:.1f} % of the heights and tilts lie within 1 % of the gain."
    )
    intervals = result["map"]["optimum_interval_90"]
    if intervals:
        lines.append(
            "Other traffic of this kind would put the optimum at {height_m[0]:.1f} to {height_m[1]:.1f} m and {tilt_x_deg[0]:.0f} to "
            "{tilt_x_deg[1]:.0f} deg (90 % of resampled blocks).".format(**intervals)
        )
    return lines


def _table(rows):
    widths = [max(len(row[column]) for row in rows if len(row) > column) for column in range(max(map(len, rows)))]
    return "\n".join(
        "  ".join(
            cell.ljust(width) if column == 0 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=False))
        ).rstrip()
        for row in rows
    )


def _blocks(block):
    number = len(np.unique(block))
    return f"{number} block{'s' * (number != 1)}"


def _held_out(site):
    if not len(site.holdout):
        return "nothing"
    counted = sum(int(frame.counted.sum()) for frame in site.holdout)
    return f"{len(site.holdout)} frames, {counted} vehicles that no searched frame shows, in {_blocks(site.plan.holdout_block)}"


def _search_text(scenario):
    settings = scenario.search
    bounds = ", ".join(f"{key} {low:g} to {high:g}" for key, (low, high) in scenario.deployment.bounds.items())
    budget = (
        f"{settings.particles} particles x {settings.iterations} iterations"
        if settings.method == "de-pso"
        else (f"{settings.particles * settings.iterations} evaluations")
    )
    return f"{bounds or 'nothing'}; {settings.method}, {budget}, seed {settings.seed}, {scenario.objective.reading} reading"
