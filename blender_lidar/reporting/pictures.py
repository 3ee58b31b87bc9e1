"""A run's charts and renders as figures of the page, each with a caption that says how to read it."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from ..input_file import read_file
from ..results import RunFolder
from .elements import Markup, element
from .summary import mounting_name, mounting_text

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FIRST, _LAST = slice(12, 16), slice(-8, -4)  # names of the first chunk, which holds the size, and of the last
_WIDTH, _HEIGHT = slice(16, 20), slice(20, 24)


@dataclass(frozen=True, slots=True)
class Chart:
    """A chart of a run: its file, what it shows, and how to read it."""

    file: str
    shows: str
    caption: str


SCORE_MAP = Chart(
    "score_map.png",
    "Objective over mounting height and tilt",
    "Brighter is better; the star is the mounting found, the square the baseline. Where a wide area is nearly as "
    "bright as the star, exact values matter little.",
)
SCORE_MAP_WITH_BOTH = Chart(
    SCORE_MAP.file,
    "Objective over mounting height and tilt, of mountings that hang as planned",
    "Brighter is better where a mounting hangs as planned; the star is the best of these, the diamond the robust one, "
    "the square the baseline. The robust one stands where the surroundings are bright too.",
)
CONVERGENCE = Chart(
    "convergence.png",
    "Objective of every mounting tried, in order, and the best so far",
    "Each dot is a mounting that was tried, the line the best so far: where it runs flat, more trying brought nothing.",
)
BY_DISTANCE = Chart(
    "by_distance.png",
    "Share of detectable vehicles and mean score by distance from the LiDAR, for both mountings",
    "Each marker stands for 10 m of distance; the bars at the bottom say how many vehicles are behind it.",
)
BLIND_ZONES = Chart(
    "blind_zones.png",
    "Road from above, shaded by the share of vehicles below the threshold, for both mountings",
    "The darker a stretch of a lane, the more of the vehicles there stay below the threshold; the triangle is the "
    "LiDAR.",
)
CLOUDS = Chart(
    "clouds.png",
    "One revolution's points on the road from above, for both mountings",
    "One moment of dense traffic: vehicles in solid outline are detectable, dashed grey ones are missed.",
)
OCCUPANCY = Chart(
    "occupancy.png",
    "Occupied cells of one vehicle in top, side and front view, for both mountings",
    "One vehicle as PE-VGOP sees it: a cell is dark where a beam has hit it, and the share of dark cells counts.",
)
CHARTS = (SCORE_MAP, CONVERGENCE, BY_DISTANCE, BLIND_ZONES, CLOUDS, OCCUPANCY)

# Rendered pictures by where they look from, and what that is called.
RENDER_VIEWS = {"above": "the road from above", "pole": "the view from the pole"}


def render_file(mounting: str, view: str) -> str:
    """Name of the rendered picture of a mounting, ``"baseline"`` or ``"optimised"``, from a view of `RENDER_VIEWS`."""
    return f"render_{mounting}_{view}.png"


def chart_figure(folder: RunFolder, chart: Chart) -> Markup | None:
    """A chart with its caption, None where the folder does not hold it."""
    path = folder.file(chart.file)
    if not path.exists():
        return None
    return element("figure", image(path, f"Chart: {chart.shows}"), element("figcaption", chart.caption))


def render_figures(folder: RunFolder, result: Mapping) -> list[Markup]:
    """Renders of both mountings, those from one view side by side; none where the folder holds none."""
    names = {"baseline": "Baseline", "optimised": mounting_name(result).capitalize()}
    mounts = {"baseline": result["baseline"]["deployment"], "optimised": result["deployment"]}
    figures = []
    for view, called in RENDER_VIEWS.items():
        paths = {mounting: folder.file(render_file(mounting, view)) for mounting in names}
        sides = [
            element(
                "div",
                image(path, f"Render: {called}, {names[mounting].lower()} mounting"),
                element("p", element("strong", names[mounting]), f": {mounting_text(mounts[mounting])}"),
            )
            for mounting, path in paths.items()
            if path.exists()
        ]
        if sides:
            both = f"under the baseline and under the {mounting_name(result)} mounting"
            caption = element("figcaption", f"{called[0].upper()}{called[1:]}, {both}.")
            figures.append(element("figure", element("div", *sides, class_="pair"), caption))
    return figures


def image(path: Path, alt: str) -> Markup:
    """A PNG within the page itself.

    Raises
    ------
    InputError
        When the file cannot be read or is no whole PNG.
    """
    try:
        data = read_file(path)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error
    if not data.startswith(_SIGNATURE) or data[_FIRST] != b"IHDR" or data[_LAST] != b"IEND":
        raise InputError(f"{path}: is no PNG picture, or not a whole one")
    width, height = (int.from_bytes(data[part], "big") for part in (_WIDTH, _HEIGHT))
    source = Markup(f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}")
    return element("img", src=source, width=width, height=height, alt=alt)
