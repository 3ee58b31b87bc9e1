"""BBOB, the noiseless functions of Hansen and others (INRIA RR-6829), from the `ioh` package."""

from __future__ import annotations

import numpy as np

from ..errors import MissingExtraError
from .problems import Problem

DIMENSIONS = (2, 3, 5)
FUNCTIONS = tuple(range(1, 25))
GROUPS = {
    "separable": range(1, 6),
    "moderate": range(6, 10),
    "ill-conditioned": range(10, 15),
    "multimodal": range(15, 20),
    "weak structure": range(20, 25),
}


def bbob_problem(function: int, dimension: int, instance: int) -> Problem:
    """An instance of a BBOB function, turned upside down: its best value is ``-f*``.

    Raises
    ------
    MissingExtraError
        If `ioh` is not installed.
    """
    try:
        import ioh
    except ImportError as error:
        raise MissingExtraError('BBOB needs ioh: pip install "blender_lidar[study]"') from error
    found = ioh.get_problem(function, instance=instance, dimension=dimension, problem_class=ioh.ProblemClass.BBOB)
    return Problem(
        f"f{function}",
        np.array(found.bounds.lb),
        np.array(found.bounds.ub),
        lambda x: -np.asarray(found(x.tolist()), dtype=float),
        -float(found.optimum.y),
    )


def group_of(function: int) -> str:
    """The group that BBOB puts a function in."""
    return next(name for name, functions in GROUPS.items() if function in functions)
