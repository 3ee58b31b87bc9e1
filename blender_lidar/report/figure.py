"""The sheet every chart is drawn on: one style, one size, and a PNG that is written whole or not at all."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import MissingExtraError
from ..files import write_bytes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

_OLDEST_MATPLOTLIB = (3, 7)
WIDTH_MM = 170.0  # the text width of an A4 report
DPI = 200
SMALL_PT = 7.0
_PAD_MM = 2.0
MM_PER_INCH = 25.4

# They differ in lightness where print is grey, and in dash and marker without any colour.
BASELINE_LOOK = {
    "color": "#cf7f1b",
    "linestyle": "--",
    "marker": "s",
    "markersize": 6.5,  # shows around the other series' marker where both agree
    "markerfacecolor": "white",
    "label": "baseline",
}
OPTIMISED_LOOK = {"color": "#173f70", "linestyle": "-", "marker": "o", "markersize": 4.0, "label": "optimised"}
FAINT = "#b8b8b8"
INK = "#202020"

ALONG_LABEL = "Along the road, x [m]"
TRAVEL_LABEL = "Along the road, x [m], direction of travel \N{LONG RIGHTWARDS ARROW}"

# Name and part of a colour map that only rises or only falls in lightness, so that a grey print keeps the order of the
# values. The parts leave out what black lines would drown in and what would vanish on white paper.
SCORE_COLOURS = ("viridis", 0.35, 1.0)
BLIND_COLOURS = ("YlOrBr", 0.0, 0.85)
HEIGHT_COLOURS = ("viridis", 0.85, 0.0)

_STYLE = {
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "legend.fontsize": 7.5,
    "figure.titlesize": 10.0,
    "figure.titleweight": "bold",
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.titlelocation": "left",
    "axes.axisbelow": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.6,
    "hatch.linewidth": 0.5,
    "legend.frameon": False,
    "figure.constrained_layout.h_pad": 0.07,
    "text.parse_math": False,  # a "$" in a title is a dollar sign
}


@contextmanager
def sheet(
    path: str | Path, height_mm: float, title: str = "", subtitle: str = "", *, to_scale: bool = False
) -> Iterator[Figure]:
    """An empty figure to draw on; saved to `path` when the block ends without an error.

    Parameters
    ----------
    path : str or Path
        The PNG to write; an existing file is replaced.
    height_mm : float
        Height on paper [mm]; the width is `WIDTH_MM`.
    title, subtitle : str
        Headings above the chart; left out when empty.
    to_scale : bool
        The axes will be put in place by `place`, below `header_mm`; otherwise the layout is found automatically.

    Yields
    ------
    Figure
        On an Agg canvas of its own: pyplot, the chosen backend and the user's own settings play no part, and
        ``rcParams`` are afterwards what they were.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed, or too old.
    OutputError
        If the file cannot be written.
    """
    try:
        import matplotlib
        from matplotlib import style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError('charts need matplotlib: pip install "blender_lidar[plots]"') from error
    if matplotlib.__version_info__ < _OLDEST_MATPLOTLIB:  # Debian's has no legends outside
        oldest = ".".join(map(str, _OLDEST_MATPLOTLIB))
        raise MissingExtraError(f"charts need matplotlib {oldest} or later, and {matplotlib.__version__} is installed")
    with style.context(["default", _STYLE]):
        size = (WIDTH_MM / MM_PER_INCH, height_mm / MM_PER_INCH)
        figure = Figure(figsize=size, dpi=DPI, layout="none" if to_scale else "constrained")
        FigureCanvasAgg(figure)
        # An automatic layout keeps room for the heading only if it may choose the height itself.
        _headline(figure, title, subtitle, **({"y": 1.0 - _PAD_MM / height_mm} if to_scale else {}))
        yield figure
        save(figure, path)


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Raises
    ------
    OutputError
        If the file cannot be written; an older file of that name is then untouched and nothing else is left.
    """
    drawing = io.BytesIO()
    figure.savefig(drawing, format="png", metadata={"Software": None})
    write_bytes(path, drawing.getvalue())


def header_mm(title: str, subtitle: str) -> float:
    """Height that the headings of a sheet drawn to scale take up [mm]."""
    return _PAD_MM + 5.0 * bool(title or subtitle) + 4.5 * bool(subtitle)


def place(figure: Figure, left_mm: float, top_mm: float, width_mm: float, height_mm: float) -> Axes:
    """An axes of a given size at a given distance from the sheet's upper left corner, all in millimetres on paper."""
    sheet_width, sheet_height = MM_PER_INCH * figure.get_size_inches()
    bottom = 1.0 - (top_mm + height_mm) / sheet_height
    return figure.add_axes((left_mm / sheet_width, bottom, width_mm / sheet_width, height_mm / sheet_height))


def legend_below(figure: Figure, handles: Sequence[Any], columns: int) -> None:
    """One legend for the whole figure, under the axes and so never on the data."""
    figure.legend(handles=handles, loc="outside lower center", ncols=columns, handlelength=2.6)


def colours(part: tuple[str, float, float]) -> ListedColormap:
    """Part of a colour map, from the first share of its range to the second."""
    import matplotlib
    from matplotlib.colors import ListedColormap

    name, first, last = part
    return ListedColormap(matplotlib.colormaps[name](np.linspace(first, last, 256)))


def mark_sensor(axes: Axes, xy: Sequence[float]) -> Line2D:
    """A marker where the LiDAR stands, seen from above, (2,); it is also the legend's entry."""
    look = {"markersize": 8.0, "markerfacecolor": "white", "markeredgecolor": "black", "markeredgewidth": 1.2}
    (line,) = axes.plot(*xy, "^", linestyle="none", zorder=5, label="LiDAR", **look)
    return line


def _headline(figure: Figure, title: str, subtitle: str, **position: float) -> None:
    """The title in bold and, on the line that a trailing newline keeps free for it, the subtitle."""
    if not (title or subtitle):
        return
    from matplotlib.text import Annotation

    heading = figure.suptitle(f"{title}\n " if subtitle else title, x=_PAD_MM / WIDTH_MM, ha="left", **position)
    if subtitle:
        note = Annotation(subtitle, xy=(0.0, 0.0), xycoords=heading, ha="left", va="bottom", fontsize=8.0, color=INK)
        figure.add_artist(note)
