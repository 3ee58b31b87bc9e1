"""A run as one page of HTML that needs no network, to be sent to a colleague or printed on A4.

The page is made from the run's folder alone, so that it can be made again when something has been added there; the same
folder gives the same bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from .. import __version__
from ..files import write_text
from ..run.folder import DETECTION, INSTALLATION, REPORT, RESULT, SCENE, RunFolder, of_lidar, refused_by_name
from ..toml_table import read_toml
from ..traffic.vehicles import RepairReport, counted
from .cautions import cautions, other_traffic_texts
from .detection import detection_table, detection_text
from .html import Markup, element, image, joined, sheet_markup, table, terms
from .summary import (
    answer,
    as_sentence,
    assumed_texts,
    boxes_text,
    conditions,
    definitions,
    each_lidar,
    errors_text,
    frames_word,
    gate_text,
    key_figures,
    minus,
    mounting_name,
    region_text,
    sides,
    warnings_text,
    was_searched,
    where_text,
)
from .tables import TextTable, group_tables, score_tables

# --- The page's tables ------------------------------------------------------------------------------------------------

_NONE = "\N{EN DASH}"


def table_markup(content: TextTable, class_: str | None = None) -> Markup:
    """A table of numbers."""
    head = [element("tr", *(_heading_cell(text, columns) for text, columns in line)) for line in content.head]
    bodies = []
    for heading, rows in content.sections:
        width = sum(columns for _, columns in content.head[-1])
        over = element("tr", element("th", heading, scope="rowgroup", colspan=width)) if heading else None
        lines = [element("tr", element("th", what, scope="row"), *map(_number, cells)) for what, *cells in rows]
        bodies.append(element("tbody", over, *lines))
    return table(content.title, element("thead", *head), *bodies, class_=class_)


def _heading_cell(text: str, columns: int) -> Markup:
    """A cell of a table's head, which is empty over a corner."""
    across = columns if columns > 1 else None
    return element("th", text, scope="col", colspan=across) if text else element("td", colspan=across)


def _number(text: str) -> Markup:
    """A cell of a number; a group without vehicles has none."""
    return element("td", _NONE if text == "-" else minus(text))


def computing_table(result: Mapping) -> Markup:
    """What a result depends on beside the scene: how it was computed, and by what."""
    search = f"{result['search']}, seed {result['seed']}, {result['evaluations']:,} evaluations at full fidelity"
    rows = {
        "Search": search if was_searched(result) else "none: the mounting was given",
        "Metric": f"{result['metric']}, {result['reading']} reading",
        "Rays": f"cast by {result['caster']}, vehicles in detail {result['detail']}",
        "Traffic": result["identity"]["[traffic] path"],
        "Time": f"{result['seconds']:.0f} s",
        **result["versions"],
    }
    lines = [element("tr", element("th", name, scope="row"), element("td", value)) for name, value in rows.items()]
    return table("Methods and versions", element("tbody", *lines), class_="settings")


# --- A run's charts and renders as figures of the page, each with a caption that says how to read it ------------------

# By file: what the chart shows, and how to read it.
CHARTS = {
    "score_map.png": (
        "Objective over mounting height and tilt",
        "Brighter is better; the star is the answer, the square the baseline where it hangs on the same pole. "
        "Where a wide area is nearly as bright as the star, exact values matter little.",
    ),
    "convergence.png": (
        "Objective of every mounting tried, in order, and the best so far",
        "Each dot is a mounting that was tried, the line the best so far: where it is flat, further tries found "
        "nothing better. With installation errors each frame has its own here; the answer is the best of the last few "
        "under further errors, so its value in the score map may be lower than the end of the line.",
    ),
    "layout.png": (
        "Detectable share, and price, from one LiDAR to all",
        "Each dot is the layout of so many LiDARs on the way to all, with its 90 % interval: where it is flat, another "
        "LiDAR adds little.",
    ),
    "by_distance.png": (
        "Share of detectable vehicles and mean score by distance from the LiDAR, for both mountings",
        "Each marker stands for 10 m of distance; the bars at the bottom say how many vehicles are behind it.",
    ),
    "by_approach.png": (
        "Detectable share by approach and movement, for both mountings, with 90 % intervals",
        "Bold rows are approaches, those below them their movements. A mounting is better for a row where its interval "
        "lies to the right of the other's; rows without an interval have too little traffic for one.",
    ),
    "blind_zones.png": (
        "Site from above, shaded by the share of vehicles below the threshold, for both mountings",
        "To scale. Look for dark cells: there most vehicles stay below the threshold; on the blue contour half of them "
        "are detectable. A cell counts the boxes whose footprints overlap it; hatched ones have too few to say. "
        "Triangles are LiDARs, dotted circles distances from them.",
    ),
    "other_traffic.png": (
        "Detectable share under other traffic: lorries by lane or approach, light traffic, a queue",
        "Look for rows whose interval lies left of the dashed line, and for what is named there: that traffic "
        "hides vehicles that the recorded traffic does not.",
    ),
    "clouds.png": (
        "One revolution's points on the road from above, for both mountings",
        "One moment of dense traffic: vehicles in solid outline are detectable, dashed grey ones are missed.",
    ),
    "detections.png": (
        "Detections in one frame from above, over vehicles and points",
        "The frame that has the median number of vehicles: outlines are detections, ticks point to their fronts; false "
        "alarms are dashed, missed vehicles hatched.",
    ),
}

# What is to be added to captions of charts of several LiDARs.
_OF_SEVERAL = {
    "score_map.png": " All other LiDARs hang where the search had put them.",
    "convergence.png": " A vertical line stands where another LiDAR was added.",
}

RENDER_COMPARISON = "render_comparison.png"  # of both mountings
# Rendered pictures by where they look from, and what that is called.
RENDER_VIEWS = {"above": "the road from above", "pole": "the view from the pole", "points": "the points alone"}


def render_file(mounting: str, view: str) -> str:
    """Name of the rendered picture of a mounting, ``"baseline"`` or ``"optimised"``, from a view of `RENDER_VIEWS`."""
    return f"render_{mounting}_{view}.png"


def chart_figures(run: RunFolder, *files: str) -> list[Markup]:
    """Charts with their captions; those that the folder does not hold are left out."""
    names, figures = dict.fromkeys(("", *each_lidar(run.result))), []
    for file in files:
        shows, caption = CHARTS[file]
        caption += _OF_SEVERAL.get(file, "") if len(names) > 1 else ""
        for name in names:
            if (path := run.file(of_lidar(file, name))).exists():
                text = f"Chart: {shows}{f', LiDAR {name}' * bool(name)}"
                figures.append(element("figure", image(path, text), element("figcaption", caption)))
    return figures


def render_figures(run: RunFolder) -> list[Markup]:
    """Renders of both mountings, those from one view side by side; none where the folder holds none."""
    figures = []
    for view, called in RENDER_VIEWS.items():
        pictures = [
            element(
                "div",
                image(path, f"Render: {called}, {name.lower()} mounting"),
                element("p", element("strong", name), f": {text}"),
            )
            for mounting, (name, text, _) in zip(("baseline", "optimised"), sides(run.result), strict=True)
            if (path := run.file(render_file(mounting, view))).exists()
        ]
        if pictures:
            both = f"under the baseline and under the {mounting_name(run.result)} mounting"
            caption = element("figcaption", as_sentence(f"{called}, {both}"))
            figures.append(element("figure", element("div", *pictures, class_="pair"), caption))
    return figures


# --- The page, section after section ----------------------------------------------------------------------------------

_STYLE = Path(__file__).parent / "report.css"
# Should user text ever get past the escaping, the browser still loads nothing and runs nothing.
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_NO_CHARTS = (
    "There are no charts: they are drawn at the end of a run where matplotlib is installed "
    '(pip install "blender_lidar[plots]").'
)

_METAS = (
    {"charset": "utf-8"},
    {"http_equiv": "Content-Security-Policy", "content": _POLICY},
    {"name": "viewport", "content": "width=device-width, initial-scale=1"},
    {"name": "color-scheme", "content": "light dark"},
    {"name": "generator", "content": f"blender_lidar {__version__}"},
)


def write_report(run: RunFolder) -> Path:
    """Write report.html into a run's folder; returns its path.

    Raises
    ------
    MissingFileError, InputError
        As `report_html`.
    OutputError
        When the page cannot be written.
    """
    write_text(run.file(REPORT), report_html(run))
    return run.file(REPORT)


def report_html(run: RunFolder) -> str:
    """The page of a run that has ended, with the charts and renders that its folder holds.

    Raises
    ------
    MissingFileError, InputError
        When a file of the folder is missing or damaged; the text names it.
    """
    with refused_by_name(run.file(RESULT)):
        title = f"{run.result['site']}: {run.result['sensor']} mounting"
        content = (
            _heading(run),
            _pictures("The scene", render_figures(run)),
            _scores(run),
            _notes(run),
            _where(run),
            _detection(run),
            _pictures("How sure the optimum is", chart_figures(run, "layout.png", "score_map.png", "convergence.png")),
            _pictures("What the beams hit", chart_figures(run, "clouds.png")),
            *(
                _section(
                    f"Installation sheet{f' of {name}' * bool(name)}",
                    *sheet_markup(run.read_text(of_lidar(INSTALLATION, name))),
                    class_="sheet",
                )
                for name in each_lidar(run.result)
            ),
            _settings(run),
        )
    return page_html(title, *content)


def page_html(title: str, *content: object) -> str:
    """A whole page that needs no network."""
    metas = (element("meta", **attributes) for attributes in _METAS)
    style = Markup(_STYLE.read_text(encoding="utf-8"))
    head = element("head", *metas, element("title", title), element("style", style))
    body = element("body", element("main", *content))
    return f'<!DOCTYPE html>\n<html lang="en">\n{head}\n{body}\n</html>\n'


def _heading(run: RunFolder):
    """What was asked, the answer in a sentence, and the key figures."""
    result, scene = run.result, run.file(SCENE)
    with refused_by_name(scene):
        traffic = read_toml(scene)["traffic"]
        traffic = " and ".join(Path(one["path"]).name for one in (traffic if isinstance(traffic, list) else [traffic]))
    held = result["holdout"]
    frames = f"{boxes_text(result)} in {counted(result['frames'], f'{frames_word(result)} frame')}"
    if held:
        frames += f", {boxes_text(held)} in {counted(held['frames'], 'held-out one')}"
    figures = [element("div", element("dt", what), element("dd", figure)) for what, figure in key_figures(result)]
    kind, several = "Best" if was_searched(result) else "A", len(result["lidars"])
    kind += " mounting of a roadside LiDAR" if several == 1 else f" layout of {several} roadside LiDARs"
    return element(
        "header",
        element("p", kind, class_="kind"),
        element("h1", result["site"], " ", element("span", result["sensor"])),
        element("p", f"{gate_text(result).capitalize()} · traffic {traffic} · {frames}", class_="facts"),
        element("p", f"Vehicles count {region_text(result['region'])}", class_="facts"),
        *(element("p", f"{text[0].upper()}{text[1:]}", class_="facts") for text in conditions(result)),
        *(element("p", text, class_="warning") for text in warnings_text(result)),
        element("p", answer(result), class_="answer"),
        element("dl", *figures, class_="figures"),
        *(element("p", text, class_="facts") for text in other_traffic_texts(result)),
        element("p", where_text(result), class_="facts"),
        *(element("p", f"Assumed: {text}", class_="facts") for text in assumed_texts(result)),
    )


def _scores(run: RunFolder):
    """The mountings side by side, and what the words in that table mean."""
    result = run.result
    words = definitions(result)
    if errors_text(result):
        words["as hung"] = (
            f"expected over installation errors of {errors_text(result)}, each uniform and independent of the others; "
            "the interval is over blocks of time. Nine of ten installations, of traffic of this kind, reach the share "
            "that is given. Poles, the map, other traffic and a metre more are told as hung too; all other tables and "
            "charts show the mounting exactly as planned."
        )
    if result["holdout"]:
        words |= {
            "held-out frames": "later frames with other vehicles than the searched ones: the search did not use "
            "them, so they are an independent check.",
            "90 % interval": f"from resampled blocks of {result['block_s']:g} s, because frames close in time show the "
            "same vehicles; where nearly all blocks have 0 or 100 %, it also holds Clopper and Pearson's exact "
            "interval, for which each different vehicle is one trial.",
        }
    return _section("Mounting and scores", *map(table_markup, score_tables(result)), terms(words.items()))


def _notes(run: RunFolder):
    """What to know before acting on the answer."""
    read = run.result["traffic_report"]
    read = RepairReport(**{field.name: read[field.name] for field in fields(RepairReport) if field.name in read})
    lists = {"": cautions(run.result), "Frames": run.result["notes"], "Traffic as read": read.lines()}
    parts = [
        joined(element("h3", heading) if heading else None, element("ul", *(element("li", item) for item in items)))
        for heading, items in lists.items()
        if items
    ]
    return _section("What to know before acting on it", *parts)


def _where(run: RunFolder):
    """Scores by groups of boxes, before and after, with their charts."""
    after = mounting_name(run.result)
    text = f"Detectable share and objective per vehicle, before (baseline) and after ({after}). "
    text += "A box is a vehicle in one frame; a vehicle counts once in every frame that shows it. "
    text += "Read the intervals before the numbers."
    tables = [table_markup(table, class_="groups") for table in group_tables(run.result)]
    drawn = any(run.file(name).exists() for name in CHARTS)
    charts = (
        chart_figures(run, "by_approach.png", "by_distance.png", "blind_zones.png", "other_traffic.png")
        if drawn
        else [element("p", _NO_CHARTS)]
    )
    return _section("Where vehicles are seen", element("p", text), *tables, *charts)


def _detection(run: RunFolder):
    """What a detector made of the mounting, where one was asked."""
    path = run.file(DETECTION)
    if not path.exists():
        return None
    with refused_by_name(path):
        result = json.loads(run.read_text(DETECTION))
        return _section(
            "What a detector finds",
            element("p", detection_text(result)),
            *chart_figures(run, "detections.png"),
            table_markup(detection_table(result)),
        )


def _settings(run: RunFolder):
    """How it was computed, and the whole scene, both folded."""
    return _section(
        "The run",
        element("details", element("summary", "How it was computed"), computing_table(run.result)),
        element("details", element("summary", "The whole scene as used"), element("pre", run.read_text(SCENE))),
    )


def _pictures(heading: str, figures: list[Markup]) -> Markup | None:
    """A section of pictures, where there are any."""
    return _section(heading, *figures) if figures else None


def _section(heading: str, *content: object, **attributes: object) -> Markup:
    """A section of the page under a heading."""
    return element("section", element("h2", heading), *content, **attributes)
