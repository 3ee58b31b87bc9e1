"""The page's tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from .comparison import compared_names, comparison_sections
from .elements import Markup, element, minus
from .stored_run import StoredRun
from .summary import group_scores, was_searched

_NONE = "\N{EN DASH}"


def comparison_table(result: Mapping) -> Markup:
    """The mountings of a run side by side."""
    names = compared_names(result)
    columns = [element("td"), *(element("th", name, scope="col") for name in names)]
    bodies = []
    for section in comparison_sections(result):
        heading = element("th", section.heading, scope="rowgroup", colspan=1 + len(names))
        rows = [element("tr", element("th", what, scope="row"), *_compared(numbers)) for what, *numbers in section.rows]
        bodies.append(element("tbody", element("tr", heading), *rows))
    head = element("thead", element("tr", *columns))
    return _table(f"{', '.join(names[:-1]).capitalize()} and {names[-1]} mounting", head, *bodies)


def group_table(heading: str, groups: Callable, run: StoredRun) -> Markup:
    """Scores of groups of vehicles, searched and held out, before and after."""
    scores = group_scores(groups, run.result, run.baseline, run.optimised)
    splits = [element("th", split, scope="col", colspan=4) for split in scores.splits]
    measures = [
        element("th", what, scope="col", colspan=2) for _ in scores.splits for what in (scores.measure, "detectable %")
    ]
    names = [element("th", name, scope="col") for _ in range(2 * len(scores.splits)) for name in ("before", "after")]
    head = element(
        "thead",
        element("tr", element("td", rowspan=3), *splits, element("th", "vehicles", scope="col", rowspan=3)),
        element("tr", *measures),
        element("tr", *names),
    )
    rows = [
        element("tr", element("th", name, scope="row"), *map(_number, cells), _number(f"{vehicles:,}"))
        for name, cells, vehicles in scores.rows
    ]
    return _table(heading, head, element("tbody", *rows), class_="groups")


def computing_table(result: Mapping) -> Markup:
    """What a result depends on beside the scene: how it was computed, and by what."""
    search = f"{result['search']}, seed {result['seed']}, {result['evaluations']:,} evaluations"
    if result.get("rungs"):
        search += " at full fidelity, after " + ", ".join(
            f"{rung['candidates']:,} on {rung['frames']} frames in detail {rung['detail']}, 1 of {rung['stride']} beams"
            for rung in result["rungs"][:-1]
        )
    if (result.get("tolerance") or {}).get("evaluations"):
        block = result["tolerance"]
        search += (
            f": {block['evaluations']['sharp']:,} of mountings as planned and {block['evaluations']['robust']:,} over "
            f"the tolerance, with {block['searched_errors']} errors each"
        )
    rows = {
        "Search": search if was_searched(result) else "none: the mounting was given",
        "Metric": f"{result['metric']}, {result['reading']} reading",
        "Rays": f"cast by {result['caster']}, vehicles in detail {result['detail']}",
        "Traffic": result["identity"]["[traffic] path"],
        "Time": f"{result['seconds']:.0f} s",
        **result["versions"],
    }
    lines = [element("tr", element("th", name, scope="row"), element("td", value)) for name, value in rows.items()]
    return _table("Methods and versions", element("tbody", *lines), class_="settings")


def _compared(numbers: list[str]) -> list[Markup]:
    """Cells of a row; what has no counterpart, such as a gain, takes the room of the one before it too."""
    if numbers[0]:
        return [_number(number) for number in numbers]
    return [_number(numbers[1], colspan=2), *(_number(number) for number in numbers[2:])]


def _table(caption: str, *parts: Markup, class_: str | None = None) -> Markup:
    """A table that scrolls by itself where the page is too narrow for it."""
    table = element("table", element("caption", caption), *parts, class_=class_)
    return element("div", table, class_="scroll", role="region", aria_label=caption, tabindex=0)


def _number(text: str, **attributes: object) -> Markup:
    """A cell of a number; a group without vehicles has none."""
    return element("td", _NONE if text == "-" else minus(text), **attributes)
