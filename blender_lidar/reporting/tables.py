"""The page's tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from .elements import Markup, element, minus
from .stored_run import StoredRun
from .summary import comparison_sections, group_scores, mounting_name, was_searched

_NONE = "\N{EN DASH}"


def comparison_table(result: Mapping) -> Markup:
    """The mounting and the baseline side by side."""
    columns = [element("th", name, scope="col") for name in ("", "baseline", mounting_name(result))]
    columns[0] = element("td")
    bodies = []
    for section in comparison_sections(result):
        heading = element("th", section.heading, scope="rowgroup", colspan=3)
        rows = [
            element("tr", element("th", what, scope="row"), *_compared(before, after))
            for what, before, after in section.rows
        ]
        bodies.append(element("tbody", element("tr", heading), *rows))
    head = element("thead", element("tr", *columns))
    return _table(f"Baseline and {mounting_name(result)} mounting", head, *bodies)


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


def _compared(before: str, after: str) -> list[Markup]:
    """Cells of a row; what has no counterpart, such as a gain, takes the room of both."""
    return [_number(before), _number(after)] if before else [_number(after, colspan=2)]


def _table(caption: str, *parts: Markup, class_: str | None = None) -> Markup:
    """A table that scrolls by itself where the page is too narrow for it."""
    table = element("table", element("caption", caption), *parts, class_=class_)
    return element("div", table, class_="scroll", role="region", aria_label=caption, tabindex=0)


def _number(text: str, **attributes: object) -> Markup:
    """A cell of a number; a group without vehicles has none."""
    return element("td", _NONE if text == "-" else minus(text), **attributes)
