"""Chart: how fast searches reach their targets, as runtime ECDFs side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from .canvas import FAINT, INK, OPTIMISED, sheet

# Ours is the heavy one; the others are told apart by colour, lightness and dash.
_OTHERS = (
    ("#cf7f1b", "--"),
    ("#e3b778", (0, (1.2, 1.2))),
    ("#777777", "-."),
    (FAINT, "-"),
    ("#2a8f6f", "-"),
    ("#8fc3b1", (0, (5, 1.5))),
    ("#a03060", (0, (4, 1, 1, 1))),
)


class Panel(NamedTuple):
    """One set of axes: what it shows, evaluations (c,), and the share of targets reached (c,) by each search."""

    title: str
    evaluations: np.ndarray
    reached: Mapping[str, np.ndarray]


def plot_search_ecdf(
    path: str | Path, panels: Sequence[Panel], targets: str, *, title: str = "", subtitle: str = ""
) -> None:
    """Draw the panels side by side, one line for each search, the first of them ours.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    panels : sequence of Panel
        All with the same searches, at most eight.
    targets : str
        What the shares are of, for the vertical axis.
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If there is no panel, or they hold different searches or too many.
    """
    names = list(panels[0].reached) if panels else []
    if not 1 <= len(names) <= 1 + len(_OTHERS) or any(list(panel.reached) != names for panel in panels):
        raise InputError(f"ECDF chart: {len(panels)} panels of {names}; allowed: the same 1 to 8 searches in each")
    looks = [{"color": OPTIMISED["color"], "linestyle": "-", "linewidth": 2.4, "zorder": 5}]
    looks += [{"color": colour, "linestyle": dash, "linewidth": 1.3} for colour, dash in _OTHERS]
    with sheet(path, 88.0, title, subtitle) as figure:
        figure.get_layout_engine().set(w_pad=0.06)
        every = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, panel in zip(every, panels, strict=True):
            lines = [
                axes.step(panel.evaluations, panel.reached[name], where="post", label=name, **look)[0]
                for name, look in zip(names, looks, strict=False)
            ]
            axes.set_title(panel.title, color=INK)
            axes.set_xscale("log")
            axes.set_xlim(max(1.0, panel.evaluations[-1] / 200.0), panel.evaluations[-1])
            axes.set_ylim(0.0, 1.0)
            axes.xaxis.set_major_formatter("{x:,.0f}")
            axes.set_xlabel("Evaluations")
            axes.grid(visible=True)
        every[0].set_ylabel(targets)
        figure.legend(handles=lines, loc="outside lower center", ncols=4, handlelength=3.2)
