"""A run as one page of HTML that needs no network, to be sent to a colleague or printed on A4.

The page is made from the run's folder alone, so that it can be made again when something has been added there; the same
folder gives the same bytes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import fields
from itertools import groupby
from pathlib import Path

from .. import __version__
from ..document import ANSWER, ASSUMED, CAUTION, DOUBT, MEANING, NOTE, Table, as_sentence
from ..files import write_text
from ..run.folder import DETECTION, INSTALLATION, REPORT, RESULT, SCENE, RunFolder, of_lidar, refused_by_name
from ..run.words import boxes_text, each_lidar, frames_word, gate_text, mounting_name, sides, was_searched
from ..toml_table import read_toml
from ..traffic.vehicles import RepairReport, counted
from .detection import detection_table, detection_text
from .html import Markup, element, image, joined, sheet_markup, table, terms
from .text import columns_of

# --- The page's tables ------------------------------------------------------------------------------------------------

_NONE = "\N{EN DASH}"


def table_markup(content: Table, class_: str | None = None) -> Markup:
    """A table of quantities; a row of a name alone is a heading."""
    heads, cells = columns_of(content)
    groups = [(group, len(list(columns))) for group, columns in groupby(group for group, _ in heads)]
    lines = [[_heading_cell(text, 1) for _, text in heads]]
    if any(group for group, _ in groups):
        lines.insert(0, [_heading_cell(*group) for group in groups])
    body = []
    for row, line in zip(content.rows, cells, strict=True):
        if len(row) == 1 and len(heads) > 1:
            body.append(element("tr", element("th", line[0], scope="rowgroup", colspan=len(heads))))
        else:
            body.append(element("tr", element("th", line[0], scope="row"), *map(_number, line[1:])))
    head = element("thead", *(element("tr", *line) for line in lines))
    return table(content.title, head, element("tbody", *body), class_=class_)


def _heading_cell(text: str, columns: int) -> Markup:
    """A cell of a table's head, which is empty over a corner."""
    across = columns if columns > 1 else None
    return element("th", text, scope="col", colspan=across) if text else element("td", colspan=across)


def _number(text: str) -> Markup:
    """A cell of a number, with a minus as wide as a plus; "-" stands for none."""
    return element("td", _NONE if text == "-" else minus(text))


def minus(text: str) -> str:
    """A text whose numbers have a minus that is as wide as a plus."""
    return re.sub(r"(?<![\w.])-(?=\d)", "\N{MINUS SIGN}", text)


def settings_table(settings: Mapping[str, str]) -> Markup:
    """What a result depends on beside the scene: how it was computed, and by what."""
    lines = [element("tr", element("th", name, scope="row"), element("td", text)) for name, text in settings.items()]
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
            _notes(run),
            _scores(run),
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
    kind, several = "Best" if was_searched(result) else "A", len(result["lidars"])
    kind += " mounting of a roadside LiDAR" if several == 1 else f" layout of {several} roadside LiDARs"
    told = run.document
    return element(
        "header",
        element("p", kind, class_="kind"),
        element("h1", result["site"], " ", element("span", result["sensor"])),
        element("p", f"{gate_text(result).capitalize()} · traffic {traffic} · {frames}", class_="facts"),
        *(element("p", minus(one.text), class_="warning") for one in told.of(DOUBT)),
        terms(((one.label, minus(one.text)) for one in told.of(ANSWER)), "answer"),
    )


def _scores(run: RunFolder):
    """The mountings side by side, and what the words in that table mean."""
    words = ((one.label, one.text) for one in run.document.of(MEANING))
    tables = (table_markup(one) for one in run.document.tables if not one.key.startswith("by "))
    return _section("Mounting and scores", *tables, terms(words))


def _notes(run: RunFolder):
    """What to know before acting on it, what was assumed, and what reading the traffic came to."""
    read, told = run.result["traffic_report"], run.document
    read = RepairReport(**{field.name: read[field.name] for field in fields(RepairReport) if field.name in read})
    lists = {
        "": [minus(one.text) for one in (*told.of(CAUTION), *told.of(NOTE))],
        "Assumed": [one.text for one in told.of(ASSUMED)],
        "Traffic as read": read.lines(),
    }
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
    text += "Read the intervals before the numbers."
    tables = [table_markup(one, class_="groups") for one in run.document.tables if one.key.startswith("by ")]
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
        element("details", element("summary", "How it was computed"), settings_table(run.document.settings)),
        element("details", element("summary", "The whole scene as used"), element("pre", run.read_text(SCENE))),
    )


def _pictures(heading: str, figures: list[Markup]) -> Markup | None:
    """A section of pictures, where there are any."""
    return _section(heading, *figures) if figures else None


def _section(heading: str, *content: object, **attributes: object) -> Markup:
    """A section of the page under a heading."""
    return element("section", element("h2", heading), *content, **attributes)
