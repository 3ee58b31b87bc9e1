"""A run as one page of HTML that needs no network, to be sent to a colleague or printed on A4.

The page is made from the run's folder alone, so that it can be made again when something has been added there; the same
folder gives the same bytes.
"""

from __future__ import annotations

from pathlib import Path

from .. import __version__
from ..metrics.catalogue import metric_named
from ..metrics.metric import Metric
from ..results import REPORT, RunFolder
from ..study.circumstances import imperfections_text, scenery_text
from ..study.objective_text import objective_text
from ..study.verdict import distance_bands, lanes
from .answer import answer, key_figures
from .elements import Markup, element, joined, many
from .pictures import (
    BLIND_ZONES,
    BY_DISTANCE,
    CHARTS,
    CLOUDS,
    CONVERGENCE,
    OCCUPANCY,
    SCORE_MAP,
    SCORE_MAP_WITH_BOTH,
    chart_figure,
    render_figures,
)
from .sheet import sheet_markup
from .stored_run import StoredRun, read_run
from .summary import cautions, mounting_name, sharp_of, was_searched
from .tables import comparison_table, computing_table, group_table

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


def write_report(folder: RunFolder) -> Path:
    """Write report.html into a run's folder; returns its path.

    Raises
    ------
    MissingFileError, InputError
        When the folder holds no run that has ended, or one of its files is missing or damaged.
    OutputError
        When the page cannot be written.
    """
    folder.write_text(REPORT, report_html(folder))
    return folder.file(REPORT)


def report_html(folder: RunFolder) -> str:
    """The page of a run that has ended, with the charts and renders that its folder holds.

    Raises
    ------
    MissingFileError, InputError
        When the folder holds no run that has ended, or one of its files is missing or damaged; the text names it.
    """
    run = read_run(folder)
    title = f"{run.name}: {run.result['sensor']} mounting"
    head = joined(
        *(element("meta", **attributes) for attributes in _METAS),
        element("title", title),
        element("style", Markup(_STYLE.read_text(encoding="utf-8"))),
    )
    parts = (
        _heading(run),
        _renders(run),
        _scores(run),
        _notes(run),
        _where(run),
        _optimum(run),
        _vehicles(run),
        _sheet(run),
        _settings(run),
    )
    body = element("main", *(part for part in parts if part is not None))
    return f'<!DOCTYPE html>\n<html lang="en">\n{element("head", head)}\n{element("body", body)}\n</html>\n'


def _heading(run: StoredRun):
    result = run.result
    searched, held = was_searched(result), result["holdout"]
    kind = "Best mounting of a roadside LiDAR" if searched else "A mounting of a roadside LiDAR"
    frames = f"{result['vehicles']:,} vehicles in {result['frames']} {'searched' if searched else 'scored'} frames"
    facts = [
        f"Range gate {result['range_gate_m']:g} m",
        f"traffic {run.traffic_file}",
        f"{frames}, {held['vehicles']:,} in {held['frames']} held-out ones" if held else frames,
    ]
    figures = [element("div", element("dt", what), element("dd", figure)) for what, figure in key_figures(result)]
    return element(
        "header",
        element("p", kind, class_="kind"),
        element("h1", run.name, " ", element("span", result["sensor"])),
        element("p", " · ".join(facts), class_="facts"),
        *(element("p", text, class_="facts") for text in _circumstances(result)),
        element("p", answer(result), class_="answer"),
        element("dl", *figures, class_="figures"),
    )


def _circumstances(result):
    """What the answer holds under; results of earlier versions may not say."""
    if "imperfections" in result and (imperfect := imperfections_text(result["imperfections"])):
        yield f"Simulated with an imperfect sensor: {imperfect}"
    if scenery := scenery_text(result.get("scenery")):
        yield f"Simulated with scenery: {scenery}"


def _renders(run: StoredRun):
    figures = render_figures(run.folder, run.result)
    return _section("The scene", *figures) if figures else None


def _scores(run: StoredRun):
    identity = run.result["identity"]
    words = {
        "objective": f"{objective_text(run.result)}, summed over the vehicles in view, which are the same for every "
        f"mounting.{_metric_text(metric_named(run.result['metric']))}",
        "detectable": f"occupancy ({identity['[objective] view']} of the three views) of at least "
        f"{identity['[objective] threshold']:g}: a threshold on the metric, not a detector.",
    }
    if run.result.get("tolerance") is not None:
        words["gain kept"] = (
            "what an error of installation leaves of the gain over the baseline, each error uniform within what is "
            "stated. The sharp mounting is the best where there is none; the robust one the best over all of them."
            if sharp_of(run.result)
            else "what an error of installation leaves of the gain over the baseline, each error uniform within what "
            "is stated."
        )
    if run.result["holdout"]:
        words |= {
            "held-out frames": "frames later in the recording that show none of the others' vehicles: what chose a "
            "mounting never judges it.",
            "90 % interval": f"from resampling blocks of {run.result['block_s']:g} s, because frames close in time "
            "show the same vehicles.",
        }
    terms = [joined(element("dt", term), element("dd", meaning)) for term, meaning in words.items()]
    return _section("Mounting and scores", comparison_table(run.result), element("dl", *terms, class_="terms"))


def _metric_text(metric: Metric) -> str:
    """A sentence on what a metric means; none where it does not say."""
    if not metric.tells:
        return ""
    direction = "" if metric.higher_is_better else "; lower is better"
    what = "the scene" if metric.of_scene else "each vehicle"
    return f" For {what} the metric, {metric.name}, tells {metric.tells}{direction}."


def _notes(run: StoredRun):
    """What to know before acting on the answer."""
    lists = {"": cautions(run.result), "Frames": run.result["notes"], "Traffic as read": run.repairs.lines()}
    parts = [
        joined(element("h3", heading) if heading else None, element("ul", many("li", items)))
        for heading, items in lists.items()
        if items
    ]
    return _section("What to know before acting on it", *parts)


def _where(run: StoredRun):
    after = mounting_name(run.result)
    told = f"Objective per vehicle and detectable share, before (baseline) and after ({after}); vehicles in all frames."
    tables = [element("p", told), group_table("By distance", distance_bands, run)]
    if run.baseline["lane"].any():
        tables.append(group_table("By lane", lanes, run))
    drawn = any(run.folder.file(chart.file).exists() for chart in CHARTS)
    charts = [chart_figure(run.folder, chart) for chart in (BY_DISTANCE, BLIND_ZONES)]
    return _section("Where vehicles are seen", *tables, *charts, None if drawn else element("p", _NO_CHARTS))


def _optimum(run: StoredRun):
    charts = (SCORE_MAP if sharp_of(run.result) is None else SCORE_MAP_WITH_BOTH, CONVERGENCE)
    figures = [figure for chart in charts if (figure := chart_figure(run.folder, chart))]
    return _section("How sure the optimum is", *figures) if figures else None


def _vehicles(run: StoredRun):
    figures = [figure for chart in (CLOUDS, OCCUPANCY) if (figure := chart_figure(run.folder, chart))]
    return _section("What the beams hit", *figures) if figures else None


def _sheet(run: StoredRun):
    return _section("Installation sheet", *sheet_markup(run.installation), class_="sheet")


def _settings(run: StoredRun):
    return _section(
        "The run",
        element("details", element("summary", "How it was computed"), computing_table(run.result)),
        element("details", element("summary", "The whole scene as used"), element("pre", run.scene)),
    )


def _section(heading: str, *content: object, **attributes: object) -> Markup:
    return element("section", element("h2", heading), *content, **attributes)
