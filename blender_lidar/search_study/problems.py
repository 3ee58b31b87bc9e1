"""A problem to judge searches on: something to maximise over a box, and the best value there is where it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..optimise import Objective


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """One instance of a problem.

    Attributes
    ----------
    name : str
    lower, upper : ndarray, (d,)
        The box.
    objective : callable
        To maximise: candidates (s, d) in, values (s,) out.
    best : float or None
        The best value there is, None where nobody knows.
    """

    name: str
    lower: np.ndarray
    upper: np.ndarray
    objective: Objective
    best: float | None
