"""A run as one page of HTML that needs no network, to be sent to a colleague or printed on A4.

The page is made from the run's folder alone, so that it can be made again when something has been added there; the same
folder gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from .. import __version__
from ..errors import BlenderLidarError, InputError, MissingFileError
from ..files import read_text
from ..metrics.catalogue import METRICS, metric_named
from ..metrics.metric import Metric
from ..optimise import READINGS
from ..run.folder import INSTALLATION, REPORT, RESULT, SCENE, SCHEMA, VEHICLES, VEHICLES_BASELINE, RunFolder
from ..run.installation import imperfections_text, objective_text, scenery_text
from ..run.verdict import columns_for, distance_bands, lanes
from ..scene.settings import COORDINATES
from ..toml_table import read_toml
from ..traffic.vehicles import RepairReport
from .html import Markup, element, image, joined, many, sheet_markup, table, terms
from .summary import (
    answer,
    cautions,
    compared_names,
    comparison_sections,
    group_scores,
    key_figures,
    minus,
    mounting_name,
    mounting_text,
    sharp_of,
    sides,
    was_searched,
)

# --- A run that has ended, read from its folder -----------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class StoredRun:
    """What a run has left.

    Attributes
    ----------
    folder : RunFolder
        Where it is.
    result : dict
        The content of result.json.
    optimised, baseline : dict of str to ndarray
        Vehicle tables of both mountings: the same vehicles in the same order.
    traffic_file : str
        Name of the trajectory file.
    scene, installation : str
        The content of scene.toml and installation.txt.
    """

    folder: RunFolder
    result: dict
    optimised: dict[str, np.ndarray]
    baseline: dict[str, np.ndarray]
    traffic_file: str
    scene: str
    installation: str

    @property
    def name(self) -> str:
        """The scene file's name without its ending; the folder's in the results of earlier versions."""
        return Path(self.result.get("scene", "")).stem or self.folder.path.resolve().name

    @property
    def repairs(self) -> RepairReport:
        """What reading the traffic found and repaired; what an earlier version did not count yet is nought."""
        counts = self.result["traffic_report"]
        return RepairReport(
            **{field.name: counts[field.name] for field in fields(RepairReport) if field.name in counts}
        )


def read_run(folder: RunFolder) -> StoredRun:
    """Read a run that has ended.

    Raises
    ------
    MissingFileError, InputError
        When the folder holds no run that has ended, or one of its files is missing or damaged; the text names it.
    """
    result, where = folder.ended_result(), folder.file(RESULT)
    if result.get("schema") != SCHEMA:
        raise InputError(f"{where}: schema is not {SCHEMA}, the one that this version writes")
    with _refused_by_name(where):
        for key, known in (("metric", METRICS), ("reading", READINGS)):
            if result[key] not in known:
                raise InputError(f"{where}: {key}: is {result[key]!r}; allowed: {', '.join(known)}")
        for mount in (result["deployment"], result["baseline"]["deployment"]):
            if not all(np.isfinite(float(mount[key])) for key in COORDINATES):
                raise InputError(f"{where}: deployment: is no mounting")
    with _refused_by_name(folder.file(SCENE)):
        traffic_file = Path(read_toml(folder.file(SCENE))["traffic"]["path"]).name
    optimised, baseline = folder.read_vehicles(VEHICLES), folder.read_vehicles(VEHICLES_BASELINE)
    for name, vehicles in ((VEHICLES, optimised), (VEHICLES_BASELINE, baseline)):
        if missing := set(columns_for(result["metric"])) - set(vehicles):
            raise InputError(f"{folder.file(name)}: is damaged: has no column {min(missing)!r}")
    if any(not np.array_equal(optimised[key], baseline[key]) for key in ("frame", "vehicle_id", "split")):
        raise InputError(f"{folder.file(VEHICLES_BASELINE)}: lists other vehicles than {VEHICLES}")
    texts = (_text(folder.file(name)) for name in (SCENE, INSTALLATION))
    return StoredRun(folder, result, optimised, baseline, traffic_file, *texts)


@contextmanager
def _refused_by_name(path: Path) -> Iterator[None]:
    """While the content of a file is used: a key that is missing or no such thing becomes one line with its name."""
    try:
        yield
    except BlenderLidarError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
        kind = type(error).__name__
        raise InputError(f"{path}: is damaged, or not of this version: {kind}: {error}") from error


def _text(path: Path) -> str:
    """The content of a text file; one that is missing or cannot be read is refused by name."""
    try:
        return read_text(path)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error


# --- The page's tables ------------------------------------------------------------------------------------

_NONE = "\N{EN DASH}"


def comparison_table(result: Mapping) -> Markup:
    """The mountings of a run side by side."""
    names = compared_names(result)
    columns = [element("td"), *(element("th", name, scope="col") for name in names)]
    bodies = []
    for heading, rows in comparison_sections(result):
        over = element("th", heading, scope="rowgroup", colspan=1 + len(names))
        lines = [element("tr", element("th", what, scope="row"), *_compared(numbers)) for what, *numbers in rows]
        bodies.append(element("tbody", element("tr", over), *lines))
    head = element("thead", element("tr", *columns))
    return table(f"{', '.join(names[:-1]).capitalize()} and {names[-1]} mounting", head, *bodies)


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
    return table(heading, head, element("tbody", *rows), class_="groups")


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
    return table("Methods and versions", element("tbody", *lines), class_="settings")


def _compared(numbers: list[str]) -> list[Markup]:
    """Cells of a row; what has no counterpart, such as a gain, takes the room of the one before it too."""
    if numbers[0]:
        return [_number(number) for number in numbers]
    return [_number(numbers[1], colspan=2), *(_number(number) for number in numbers[2:])]


def _number(text: str, **attributes: object) -> Markup:
    """A cell of a number; a group without vehicles has none."""
    return element("td", _NONE if text == "-" else minus(text), **attributes)


# --- A run's charts and renders as figures of the page, each with a caption that says how to read it ------------------

# By file: what the chart shows, and how to read it.
CHARTS = {
    "score_map.png": (
        "Objective over mounting height and tilt",
        "Brighter is better; the star is the mounting found, the square the baseline. Where a wide area is nearly as "
        "bright as the star, exact values matter little.",
    ),
    "convergence.png": (
        "Objective of every mounting tried, in order, and the best so far",
        "Each dot is a mounting that was tried, the line the best so far: where it runs flat, more trying brought "
        "nothing.",
    ),
    "by_distance.png": (
        "Share of detectable vehicles and mean score by distance from the LiDAR, for both mountings",
        "Each marker stands for 10 m of distance; the bars at the bottom say how many vehicles are behind it.",
    ),
    "blind_zones.png": (
        "Road from above, shaded by the share of vehicles below the threshold, for both mountings",
        "The darker a stretch of a lane, the more of the vehicles there stay below the threshold; the triangle is the "
        "LiDAR.",
    ),
    "clouds.png": (
        "One revolution's points on the road from above, for both mountings",
        "One moment of dense traffic: vehicles in solid outline are detectable, dashed grey ones are missed.",
    ),
    "occupancy.png": (
        "Occupied cells of one vehicle in top, side and front view, for both mountings",
        "One vehicle as PE-VGOP sees it: a cell is dark where a beam has hit it, and the share of dark cells counts.",
    ),
}
_SCORE_MAP_OVER_TOLERANCE = (
    "Objective over mounting height and tilt, of mountings that hang as planned",
    "Brighter is better where a mounting hangs as planned; the star is the best of these, the diamond the robust one, "
    "the square the baseline. The robust one stands where the surroundings are bright too.",
)

# Rendered pictures by where they look from, and what that is called.
RENDER_VIEWS = {"above": "the road from above", "pole": "the view from the pole"}


def render_file(mounting: str, view: str) -> str:
    """Name of the rendered picture of a mounting, ``"baseline"`` or ``"optimised"``, from a view of `RENDER_VIEWS`."""
    return f"render_{mounting}_{view}.png"


def chart_figures(run: StoredRun, *files: str) -> list[Markup]:
    """Charts with their captions; those that the folder does not hold are left out."""
    figures = []
    for file in files:
        shows, caption = CHARTS[file]
        if file == "score_map.png" and sharp_of(run.result):
            shows, caption = _SCORE_MAP_OVER_TOLERANCE
        path = run.folder.file(file)
        if path.exists():
            figures.append(element("figure", image(path, f"Chart: {shows}"), element("figcaption", caption)))
    return figures


def render_figures(run: StoredRun) -> list[Markup]:
    """Renders of both mountings, those from one view side by side; none where the folder holds none."""
    figures = []
    for view, called in RENDER_VIEWS.items():
        pictures = [
            element(
                "div",
                image(path, f"Render: {called}, {name.lower()} mounting"),
                element("p", element("strong", name), f": {mounting_text(mount)}"),
            )
            for mounting, (name, mount) in zip(("baseline", "optimised"), sides(run.result), strict=True)
            if (path := run.folder.file(render_file(mounting, view))).exists()
        ]
        if pictures:
            both = f"under the baseline and under the {mounting_name(run.result)} mounting"
            caption = element("figcaption", f"{called[0].upper()}{called[1:]}, {both}.")
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
    sections = (_heading, _renders, _scores, _notes, _where, _optimum, _vehicles, _sheet, _settings)
    with _refused_by_name(folder.file(RESULT)):
        head = joined(
            *(element("meta", **attributes) for attributes in _METAS),
            element("title", f"{run.name}: {run.result['sensor']} mounting"),
            element("style", Markup(_STYLE.read_text(encoding="utf-8"))),
        )
        body = element("main", *(section(run) for section in sections))
    return f'<!DOCTYPE html>\n<html lang="en">\n{element("head", head)}\n{element("body", body)}\n</html>\n'


def _heading(run: StoredRun):
    """What was asked, the answer in a sentence, and the key figures."""
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
    """Rendered pictures of the scene, where there are any."""
    return _section("The scene", *figures) if (figures := render_figures(run)) else None


def _scores(run: StoredRun):
    """The mountings side by side, and what the words in that table mean."""
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
            "stated."
        )
        if sharp_of(run.result):
            words["gain kept"] += (
                " The sharp mounting is the best where there is none; the robust one the best over all of them."
            )
    if run.result["holdout"]:
        words |= {
            "held-out frames": "frames later in the recording that show none of the others' vehicles: what chose a "
            "mounting never judges it.",
            "90 % interval": f"from resampling blocks of {run.result['block_s']:g} s, because frames close in time "
            "show the same vehicles.",
        }
    return _section("Mounting and scores", comparison_table(run.result), terms(words.items()))


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
    """Scores by distance and by lane, before and after, with their charts."""
    after = mounting_name(run.result)
    told = f"Objective per vehicle and detectable share, before (baseline) and after ({after}); vehicles in all frames."
    tables = [element("p", told), group_table("By distance", distance_bands, run)]
    if run.baseline["lane"].any():
        tables.append(group_table("By lane", lanes, run))
    drawn = any(run.folder.file(name).exists() for name in CHARTS)
    charts = chart_figures(run, "by_distance.png", "blind_zones.png")
    return _section("Where vehicles are seen", *tables, *charts, None if drawn else element("p", _NO_CHARTS))


def _optimum(run: StoredRun):
    """Score map and convergence."""
    figures = chart_figures(run, "score_map.png", "convergence.png")
    return _section("How sure the optimum is", *figures) if figures else None


def _vehicles(run: StoredRun):
    """Point clouds and occupancy grids."""
    figures = chart_figures(run, "clouds.png", "occupancy.png")
    return _section("What the beams hit", *figures) if figures else None


def _sheet(run: StoredRun):
    """The installation sheet."""
    return _section("Installation sheet", *sheet_markup(run.installation), class_="sheet")


def _settings(run: StoredRun):
    """How it was computed, and the whole scene, both folded."""
    return _section(
        "The run",
        element("details", element("summary", "How it was computed"), computing_table(run.result)),
        element("details", element("summary", "The whole scene as used"), element("pre", run.scene)),
    )


def _section(heading: str, *content: object, **attributes: object) -> Markup:
    """A section of the page under a heading."""
    return element("section", element("h2", heading), *content, **attributes)
