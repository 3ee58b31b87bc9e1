"""Chart: how the search's best score rose with the number of mountings tried."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..metrics.metric import Metric
from ..metrics.views import PE_VGOP
from .canvas import BASELINE, FAINT, OPTIMISED, legend_below, sheet


def plot_convergence(
    path: str | Path,
    evaluation: ArrayLike,
    value: ArrayLike,
    best: ArrayLike,
    baseline: float | None = None,
    *,
    metric: Metric = PE_VGOP,
    title: str = "",
    subtitle: str = "",
) -> None:
    """Draw every candidate's score and the best so far over the evaluations.

    Parameters
    ----------
    path : str or Path
        The PNG to write.
    evaluation, value, best : array_like, (n,)
        Number of the evaluation, the candidate's objective per vehicle, the best of them so far.
        A candidate without a finite value is left out.
    baseline : float, optional
        Objective per vehicle of the baseline mounting.
    metric : Metric
        What the objective is made of.
    title, subtitle : str
        Headings.

    Raises
    ------
    InputError
        If there is no evaluation or the three differ in length.
    """
    evaluation, value, best = (np.asarray(column, dtype=float) for column in (evaluation, value, best))
    if not evaluation.size or not evaluation.shape == value.shape == best.shape:
        raise InputError(
            "convergence chart: evaluation, value and best must have one length of at least 1, "
            f"got {evaluation.shape}, {value.shape} and {best.shape}"
        )
    with sheet(path, 90.0, title, subtitle) as figure:
        axes = figure.add_subplot()
        known = np.isfinite(value)
        dots = axes.plot(evaluation[known], value[known], ".", color=FAINT, markersize=2.5, label="one candidate")
        label = f"best so far (at the end {metric.amount(best[-1])})"
        line = axes.step(
            evaluation, best, where="post", color=OPTIMISED["color"], linestyle=OPTIMISED["linestyle"], label=label
        )
        handles = [*line, *dots]
        if baseline is not None:
            handles.append(
                axes.axhline(
                    baseline,
                    color=BASELINE["color"],
                    linestyle=BASELINE["linestyle"],
                    label=f"baseline mounting ({metric.amount(baseline)})",
                )
            )
        axes.set_xlabel("Evaluations (mountings tried)")
        axes.set_ylabel(metric.in_unit("Objective per vehicle"))
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.xaxis.get_major_locator().set_params(integer=True)
        axes.set_xlim(0.0, 1.02 * evaluation.max())
        axes.grid(visible=True)
        legend_below(figure, handles, columns=3)
