"""Plans to scale: a site from above with its lanes, stop lines, LiDARs, north arrow and scale bar, for A4."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..errors import InputError, MissingFileError
from ..road.road_map import RoadMap
from .figure import (
    ALONG_LABEL,
    INK,
    MM_PER_INCH,
    SMALL_PT,
    TRAVEL_LABEL,
    WIDTH_MM,
    header_mm,
    mark_sensor,
    place,
    sheet,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

HIGHEST_MM = 240.0  # of a sheet on A4
_LEFT_MM, _RIGHT_MM, _GAP_MM = 13.0, 5.0, 4.0
ROOM_MM = WIDTH_MM - _LEFT_MM - _RIGHT_MM  # for panels and the gaps between them
_LINE_MM, _CHARACTER_MM = 3.9, 1.62  # of a heading
_FOOT_MM = 11.5  # below a panel with labels: ticks, label, north arrow and scale bar
_TICKS_MM = 4.0  # below one without
_LABEL_ROW_MM = 8.3  # below a panel
_IN_A_ROW = 1.25  # panels stand side by side unless they are larger by so much one below the other
_LOWEST_LABELLED_MM = 34.0  # a panel that has room for more than "y [m]" beside it


# --- The sheet: one scale for all panels, the largest that fits -------------------------------------------------------


def window_of(places: Sequence[np.ndarray], margin_m: float) -> np.ndarray:
    """Lower left and upper right corner of what is shown, (2, 2) [m]: all places (..., 2) with a margin around."""
    all_of_them = np.concatenate([np.reshape(one, (-1, 2)) for one in places])
    return np.stack([all_of_them.min(axis=0) - margin_m, all_of_them.max(axis=0) + margin_m])


def fitted_mm(window: np.ndarray, width_mm: float, height_mm: float) -> tuple[float, float]:
    """Width and height on paper [mm] of a window (2, 2) [m] to scale, the largest within both limits."""
    size = window[1] - window[0]
    return tuple(float(one) for one in size * min(width_mm / size[0], height_mm / size[1]))


@contextmanager
def plans(
    path: str | Path,
    window: np.ndarray,
    headings: Sequence[str],
    key_mm: float,
    title: str = "",
    subtitle: str = "",
    *,
    road: RoadMap | None = None,
) -> Iterator[tuple[Figure, list[Axes], float]]:
    """A sheet with a panel to scale for each heading: side by side, unless clearly larger one below another.

    Parameters
    ----------
    path, title, subtitle
        As `figure.sheet`.
    window : ndarray, (2, 2)
        What each panel shows [m, site frame].
    headings : sequence of str
        Over each panel; wrapped to its width, a newline begins a new line.
    key_mm : float
        Room below all panels [mm].
    road : RoadMap, optional
        Whose shape names the axes.

    Yields
    ------
    Figure, list of Axes, float
        And where the panels end on paper and the key begins [mm].

    Errors as `figure.sheet`.
    """
    number, top = len(headings), header_mm(title, subtitle)
    beside_mm = (ROOM_MM - _GAP_MM * (number - 1)) / number

    def text(width_mm):
        wrapped = [
            "\n".join(textwrap.fill(line, int(width_mm / _CHARACTER_MM)) for line in one.split("\n"))
            for one in headings
        ]
        return wrapped, _LINE_MM * max(one.count("\n") + 1 for one in wrapped) + 1.5

    _, over = text(beside_mm)
    beside = fitted_mm(window, beside_mm, HIGHEST_MM - top - over - _FOOT_MM - key_mm)
    least = _LINE_MM * max(one.count("\n") + 1 for one in headings) + 1.5
    free = HIGHEST_MM - top - number * least - (number - 1) * _TICKS_MM - _FOOT_MM - key_mm
    stacked = fitted_mm(window, ROOM_MM, free / number)
    in_a_row = number > 1 and _IN_A_ROW * beside[0] > stacked[0]
    width, height = beside if in_a_row else stacked
    wrapped, over = text(width if in_a_row else ROOM_MM)
    step = np.array([width + _GAP_MM, 0.0] if in_a_row else [0.0, over + height + _TICKS_MM])
    end = top + over + height + step[1] * (number - 1) + _FOOT_MM
    with sheet(path, end + key_mm, title, subtitle, to_scale=True) as figure:
        corners = np.array([_LEFT_MM, top + over]) + np.arange(number)[:, None] * step
        panels = [place(figure, *corner, width, height) for corner in corners]
        along, across = axis_labels(road, height)
        for index, (axes, heading) in enumerate(zip(panels, wrapped, strict=True)):
            show(axes, window)
            axes.set_title(heading)
            if in_a_row and index:
                axes.tick_params(labelleft=False)
            else:
                axes.set_ylabel(across)
            if in_a_row or index == number - 1:
                axes.set_xlabel(along if width > 0.5 * ROOM_MM else "x [m]", y=0.0)
            else:
                axes.tick_params(labelbottom=False)
        yield figure, panels, end


def show(axes: Axes, window: np.ndarray) -> None:
    """Show a window (2, 2) [m] and nothing else, with equal axes and whole metres at its ticks."""
    axes.set(xlim=window[:, 0], ylim=window[:, 1])
    axes.set_aspect("equal", adjustable="box")
    for axis in (axes.xaxis, axes.yaxis):
        axis.get_major_locator().set_params(integer=True)


def axis_labels(road: RoadMap | None, height_mm: float = math.inf) -> tuple[str, str]:
    """What the x and the y of the site frame are called; a panel that is not high has room for little beside it."""
    if road is None or not road.endless or road.axis is None:
        return "x [m]", "y [m]"
    across = "Across the road, y [m]" if height_mm > _LOWEST_LABELLED_MM else "y [m]"
    return ALONG_LABEL if road.against.any() else TRAVEL_LABEL, across


def mm_per_m(axes: Axes) -> float:
    """Millimetres on paper of a metre."""
    inches = axes.get_position().width * axes.figure.get_size_inches()[0]
    return MM_PER_INCH * inches / np.ptp(axes.get_xlim())


def scale_bar(axes: Axes) -> Line2D:
    """A bar of a round length, to scale, below the lower right corner of a plan."""
    from matplotlib.transforms import ScaledTranslation, blended_transform_factory

    most = min(30.0 / mm_per_m(axes), np.ptp(axes.get_xlim()) / 3.0)
    power = 10.0 ** math.floor(math.log10(most))
    length = power * max(one for one in (1.0, 2.0, 5.0) if one * power <= most)
    end = axes.get_xlim()[1]
    down = ScaledTranslation(0.0, -_LABEL_ROW_MM / MM_PER_INCH, axes.figure.dpi_scale_trans)
    where = blended_transform_factory(axes.transData, axes.transAxes) + down
    look = {"color": INK, "linewidth": 1.4, "marker": "|", "markersize": 5.0, "clip_on": False}
    (bar,) = axes.plot([end - length, end], [0.0, 0.0], transform=where, label="scale bar", **look)
    axes.annotate(
        f"{length:g} m",
        (end - length, 0.0),
        (-4.0, 0.0),
        xycoords=where,
        textcoords="offset points",
        ha="right",
        va="center",
        fontsize=SMALL_PT,
        annotation_clip=False,
    )
    return bar


def north_arrow(axes: Axes, bearing_deg: float, name: str = "N") -> None:
    """An arrow below the lower left corner of a plan, towards bearing 0, with its name.

    Parameters
    ----------
    axes : Axes
    bearing_deg : float
        Of the site frame's +y, clockwise; see `scene.directions.bearing_deg`.
    name : str
        What lies there: north, or the +y of a recording whose axes have no known bearing.
    """
    from matplotlib.patches import FancyArrowPatch

    box, size = axes.get_position(), axes.figure.get_size_inches()
    middle = np.array([box.x0, box.y0]) * size + np.array([1.0, -_LABEL_ROW_MM]) / MM_PER_INCH
    turn = math.radians(90.0 + bearing_deg)
    half = 3.0 / MM_PER_INCH * np.array([math.cos(turn), math.sin(turn)])
    look = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.2, "mutation_scale": 9.0, "clip_on": False}
    ends = middle - half, middle + half
    axes.add_patch(FancyArrowPatch(*ends, transform=axes.figure.dpi_scale_trans, shrinkA=0.0, shrinkB=0.0, **look))
    right = middle + np.array([1.5 + 3.0 * abs(math.cos(turn)), 0.0]) / MM_PER_INCH
    where = axes.figure.dpi_scale_trans
    axes.annotate(name, right, xycoords=where, ha="left", va="center", fontsize=SMALL_PT, annotation_clip=False)


def north_name(road: RoadMap) -> str:
    """What bearing 0 is: north where the road comes from a map, else the +y of the recording."""
    return "N" if road.lanes else "+y of the recording"


# --- LiDARs and poles -------------------------------------------------------------------------------------------------

_FACING_MM, _SMALLEST_MM = 7.0, 3.2


def arrow(axes: Axes, start: np.ndarray, end: np.ndarray, **look: object) -> None:
    """An arrow between two places (2,) [m]; cut off where the plan ends."""
    look = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.2, "mutation_scale": 9.0, "zorder": 4.0} | look
    zorder = look.pop("zorder")
    look |= {"shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", end, start, arrowprops=look, zorder=zorder, annotation_clip=True)


class Stand(NamedTuple):
    """A pole or a LiDAR on a plan: what it is called ("" for nothing), where it stands [m], and which way it faces.

    The direction is counter-clockwise from +x [rad], None where it is not known.
    """

    name: str
    xy: tuple[float, float]
    facing_rad: float | None = None


def draw_stands(axes: Axes, stands: Sequence[Stand]) -> Line2D:
    """Mark poles with their names, beside each other where they stand close, and arrows the way they face.

    Returns the legend's entry.
    """
    from matplotlib.patheffects import withStroke

    metre = mm_per_m(axes)
    places = np.array([stand.xy for stand in stands])
    taken = [(x, y, 1.6, 1.6) for x, y in places * metre]  # middles and half sizes on paper [mm]
    low, high = (np.array(ends) * metre for ends in zip(axes.get_xlim(), axes.get_ylim(), strict=True))
    for stand, at in zip(stands, places, strict=True):
        marker = mark_sensor(axes, at)
        if stand.facing_rad is not None:
            towards = np.array([math.cos(stand.facing_rad), math.sin(stand.facing_rad)])
            arrow(
                axes, at + 1.5 / metre * towards, at + _FACING_MM / metre * towards, linewidth=1.0, mutation_scale=7.0
            )
            tip = at * metre + 0.6 * _FACING_MM * towards
            taken.append((*tip, 1.5, 1.5))
        if not stand.name:
            continue
        half = np.array([0.5 * 1.35 * len(stand.name), 0.5 * _SMALLEST_MM])
        around = (1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, 1), (1, -1), (-1, -1)
        ways = [np.array(way) * (half + gap) for gap in (2.0, 5.0) for way in around]
        clear = [
            way
            for way in ways
            if not any((np.abs(at * metre + way - one[:2]) < half + one[2:]).all() for one in np.array(taken))
            and (at * metre + way - half > low).all()
            and (at * metre + way + half < high).all()
        ]
        offset = (clear or ways)[0]
        taken.append((*(at * metre + offset), *half))
        halo = [withStroke(linewidth=2.0, foreground="white")]
        look = {"ha": "center", "va": "center", "fontsize": SMALL_PT, "zorder": 6.0, "path_effects": halo}
        axes.text(*(at + offset / metre), stand.name, clip_on=True, **look)
    return marker


# --- A picture of the site from the air -------------------------------------------------------------------------------

_BLEACHED = 0.55  # so that lines remain legible


def similarity_of(points: Sequence[Sequence[float]], where: str = "image_points") -> np.ndarray:
    """Similarity transform (turned, scaled, shifted, never mirrored) of a picture's pixels to the site frame.

    Parameters
    ----------
    points : (4,) twice
        px, py [pixels, to the right and downwards from the upper left corner], x, y [m].
    where : str
        What gave them.

    Returns
    -------
    ndarray, (2, 3)
        M in ``(x, y) = M @ (px, py, 1)``.

    Raises
    ------
    InputError
        When there are not two points, or both are one in the picture or on the site.
    """
    given = np.array(points, dtype=float)
    if given.shape != (2, 4) or not np.isfinite(given).all():
        raise InputError(f"{where}: allowed: two points [px, py, x_m, y_m]")
    pixel, site = given[:, 0] - 1j * given[:, 1], given[:, 2] + 1j * given[:, 3]
    for what, (one, two) in {"in the picture": pixel, "on the site": site}.items():
        if one == two:
            raise InputError(f"{where}: both points are one {what}; allowed: two, far from each other")
    turn = (site[1] - site[0]) / (pixel[1] - pixel[0])
    shift = site[0] - turn * pixel[0]
    return np.array([[turn.real, turn.imag, shift.real], [turn.imag, -turn.real, shift.imag]])


def background(axes: Axes, image: str | Path, points: Sequence[Sequence[float]], where: str = "image_points") -> None:
    """Draw a picture of the site, bleached, below all else; what is shown stays.

    Raises
    ------
    MissingFileError, InputError
        When the picture is not there or cannot be read, and as `similarity_of`.
    """
    from matplotlib.image import imread
    from matplotlib.transforms import Affine2D

    matrix = similarity_of(points, where)
    if not Path(image).is_file():
        raise MissingFileError(f"{image}: no such picture")
    try:
        pixels = imread(image)
    except Exception as error:  # each format has errors of its own
        raise InputError(f"{image}: cannot be read as a picture ({type(error).__name__})") from error
    shown = np.array([axes.get_xlim(), axes.get_ylim()]).T
    rows, columns = pixels.shape[:2]
    to_site = Affine2D(np.vstack([matrix, [0.0, 0.0, 1.0]])) + axes.transData
    look = {"cmap": "gray", "alpha": _BLEACHED, "zorder": 0.1, "interpolation": "bilinear"}
    axes.imshow(pixels, extent=(0.0, columns, rows, 0.0), transform=to_site, **look)
    show(axes, shown)
