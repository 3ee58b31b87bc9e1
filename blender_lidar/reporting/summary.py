"""What a run found, as rows and sentences: the command line prints them, the page sets them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..metrics.catalogue import metric_named
from ..optimise import vehicle_score
from ..study.tolerance_text import tolerance_notes
from ..study.vehicle_table import metric_values

COORDINATE_NAMES = {
    "height_m": ("height", "m"),
    "tilt_x_deg": ("tilt across the road", "deg"),
    "tilt_y_deg": ("tilt along the road", "deg"),
    "yaw_deg": ("yaw", "deg"),
    "x_m": ("x along the road", "m"),
    "y_m": ("y across the road", "m"),
}
_SMALL_SHORTFALL = 0.01  # what a search may miss before more of it is advised
_ON_A_BOUND = 0.01  # of the width between two bounds: a search that reflects there comes close and never upon it
_SPLITS = ("search", "holdout")

Table = Mapping[str, np.ndarray]


@dataclass(frozen=True, slots=True)
class GroupScores:
    """Scores of groups of vehicles, before and after.

    Attributes
    ----------
    measure : str
        What the objective is told in: the metric's unit, or that it is the objective where that has none.
    splits : list of str
        ``"searched"`` or ``"scored"``, and ``"held out"`` where anything was.
    rows : list of (str, list of str, int)
        A group's name; for each split the objective per vehicle before and after, then detectable per cent before and
        after, ``"-"`` where it has no vehicle or the objective is the whole scene's; how many vehicles it has in all
        splits.
    """

    measure: str
    splits: list[str]
    rows: list[tuple[str, list[str], int]]


def was_searched(result: Mapping) -> bool:
    """Whether a search chose the mounting; otherwise it was given."""
    return result["search"] is not None


def mounting_name(result: Mapping) -> str:
    """What the run's mounting is called beside the baseline, and beside the sharp one where it had a tolerance."""
    if not was_searched(result):
        return "given"
    return "optimised" if sharp_of(result) is None else "robust"


def sharp_of(result: Mapping) -> Mapping | None:
    """The best mounting that hangs as planned and its scores, where a search over a tolerance found the run's."""
    return (result.get("tolerance") or {}).get("sharp")  # results of earlier versions have no such block


def mounting_text(mount: Mapping[str, float]) -> str:
    """A mounting in a few words."""
    parts = [f"height {mount['height_m']:.2f} m", f"tilt {mount['tilt_x_deg']:.1f}°"]
    if mount["tilt_y_deg"]:
        parts.append(f"along the road {mount['tilt_y_deg']:.1f}°")
    if mount["yaw_deg"]:
        parts.append(f"yaw {mount['yaw_deg']:.1f}°")
    return ", ".join(parts)


def group_scores(
    groups: Callable[[Table], list[tuple[str, np.ndarray]]], result: Mapping, baseline: Table, found: Table
) -> GroupScores:
    """Objective per vehicle and detectable share of each group, searched and held out, before and after.

    Parameters
    ----------
    groups : function
        Names groups of the rows of a vehicle table: `study.verdict.distance_bands` or `lanes`.
    baseline, found : vehicle tables
        The same vehicles in the same order, under the baseline and under the run's mounting.
    """
    tables = (baseline, found)
    metric, loss = metric_named(result["metric"]), result["identity"]["[objective] loss"]
    scores = [
        vehicle_score(metric.merit(metric_values(table)), table["detectable"], loss, result["reading"])
        for table in tables
    ]
    splits = [split for split in _SPLITS if (found["split"] == split).any()]
    rows = []
    for name, chosen in groups(baseline):
        if not chosen.any():
            continue
        cells = []
        for split in splits:
            mine = [chosen & (table["split"] == split) for table in tables]
            cells += [
                metric.number(score[rows_of].mean()) if rows_of.any() and not metric.of_scene else "-"
                for score, rows_of in zip(scores, mine, strict=True)
            ]
            cells += [
                f"{100 * table['detectable'][rows_of].mean():.1f}" if rows_of.any() else "-"
                for table, rows_of in zip(tables, mine, strict=True)
            ]
        rows.append((name, cells, int(chosen.sum())))
    names = {"search": "searched" if was_searched(result) else "scored", "holdout": "held out"}
    return GroupScores(metric.unit or "objective", [names[split] for split in splits], rows)


def cautions(result: Mapping) -> list[str]:
    """What the search and the map say about how far to trust the optimum, as sentences."""
    found = []
    if result.get("tolerance") is not None:
        found += tolerance_notes(result)
    if not was_searched(result):
        return found
    if not better_than_baseline(result):
        found.append("No mounting that was tried is better than the baseline.")
    for key, (low, high) in search_bounds(result).items():
        slack = _ON_A_BOUND * (high - low)
        if not low + slack < result["deployment"][key] < high - slack:
            name = COORDINATE_NAMES[key][0]
            found.append(f"The best {name} lies on a bound of [deployment]; beyond may be better.")
    if result.get("rungs"):
        found.append(_rungs_note(result))
    if result["map"]:
        found += _map_notes(result["map"], "mounting found" if sharp_of(result) is None else "sharp mounting")
    return found


def better_than_baseline(result: Mapping) -> bool:
    """Whether the mounting beats the baseline on the frames that were searched."""
    return result["objective"] > result["baseline"]["objective"]


def search_bounds(result: Mapping) -> dict[str, tuple[float, float]]:
    """The coordinates that the scene leaves open, and between what bounds [m, deg]."""
    bounds = {key: result["identity"][f"[deployment] {key}"] for key in COORDINATE_NAMES}
    return {key: tuple(pair) for key, pair in bounds.items() if isinstance(pair, list)}


def _rungs_note(result):
    """What a search from cheap to dear has scored, and what it therefore cannot tell."""
    tried = sum(rung["candidates"] for rung in result["rungs"])
    return (
        f"Of {tried:,} mountings {result['evaluations']:,} were scored with all frames and beams, the others with "
        "fewer (fidelity auto); no grid was, so that what the search has missed is not known: --fidelity full draws it."
    )


def _map_notes(score_map, mounting):
    grid = f"a grid of {score_map['points'][0]} x {score_map['points'][1]} heights and tilts"
    shortfall, best = score_map["search_shortfall"], score_map["best"]
    found = []
    if shortfall == 0:
        found.append(f"No point of {grid} is better than the {mounting}.")
    elif shortfall is not None and shortfall < _SMALL_SHORTFALL:
        found.append(f"The search found all but {100 * shortfall:.2f} % of the gain that {grid} offers.")
    elif shortfall is not None:
        where = f"{best['height_m']:.2f} m and {best['tilt_x_deg']:.1f} deg"
        found.append(
            f"The search missed {100 * shortfall:.1f} % of the gain that {grid} offers, at {where}: "
            "give it more --particles or --iterations."
        )
    regret = score_map.get("holdout_regret")  # not in the results of earlier versions
    if regret is not None and regret > _SMALL_SHORTFALL:
        lacks = f"lacks {100 * regret:.1f} % of the gain that the best point of that grid has there"
        found.append(f"On the held-out frames the {mounting} {lacks}.")
    if score_map["share_within_1_percent"] is not None:
        share = 100 * score_map["share_within_1_percent"]
        how_many = (
            f"{share:.1f} % of those heights and tilts come" if share else "None of those heights and tilts comes"
        )
        found.append(f"{how_many} within 1 % of the gain of the best one.")
    intervals = score_map["optimum_interval_90"]
    if intervals:
        height, tilt = intervals["height_m"], intervals["tilt_x_deg"]
        found.append(
            f"Other traffic of this kind would put the best height between {height[0]:.1f} and {height[1]:.1f} m and "
            f"the best tilt between {tilt[0]:.0f} and {tilt[1]:.0f} deg (90 % of resampled blocks of time)."
        )
    return found
