"""Mountings that a study compares: Sobol's sequence over what is searched, or a grid through the mounting in question.

All that studies know of coordinates stands here.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..optimise.search import generator
from ..scene.mounting import Layout, Mounting, changed_mounting
from ..scene.scenario import Scenario

SOBOL_BITS = 30
BASELINE, FIRST = 0, 1  # rows of a landscape: the baseline, and where the candidates begin


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Mountings to compare.

    Attributes
    ----------
    variables : tuple of str
        Names of the coordinates in which they differ.
    points : ndarray, (k, d)
        The candidates [m, degrees].
    layouts : tuple of Layout, (1 + k)
        The baseline and the candidates.
    """

    variables: tuple[str, ...]
    points: np.ndarray
    layouts: tuple[Layout, ...]

    @property
    def leans(self) -> bool:
        """Whether a grid of heights has leans beside them, and not tilts across the mast's frame."""
        return "lean_deg" in self.variables

    def select(self, numbers: Sequence[int]) -> Candidates:
        """The baseline and some of the candidates, by their rows in `points`."""
        layouts = (self.layouts[BASELINE], *(self.layouts[FIRST + number] for number in numbers))
        return Candidates(self.variables, self.points[list(numbers)], layouts)


def sobol_candidates(scenario: Scenario, count: int) -> Candidates:
    """So many points of Sobol's sequence over [deployment], shifted at random by the scene's seed.

    Raises
    ------
    InputError
        When nothing is searched.
    """
    space = scenario.deployment.spaces[0]
    if not space.bounds:
        raise InputError(
            f"{scenario.source}: [deployment] fixes every coordinate; allowed: at least one a pair [low, high]"
        )
    lower, upper = np.array(space.lower, dtype=float), np.array(space.upper, dtype=float)
    points = sobol(scenario.search.seed, count, lower, upper)
    return Candidates(space.variables, points, ((scenario.baseline,), *map(space.layout, points)))


def sobol(seed: int, count: int, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The first points of Sobol's sequence in a box, all shifted alike (digit by digit) by a random amount, (count, d).

    Any 2^m of them that follow a multiple of 2^m fill the box evenly.
    """
    from scipy.stats import qmc

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that any other count than a power of 2 is less even
        points = qmc.Sobol(lower.size, scramble=False, bits=SOBOL_BITS).random(count)
    shift = generator(seed).integers(1 << SOBOL_BITS, size=lower.size)
    digits = (points * (1 << SOBOL_BITS)).astype(np.int64) ^ shift
    return np.clip(lower + (digits + 0.5) / (1 << SOBOL_BITS) * (upper - lower), lower, upper)


def grid_candidates(scenario: Scenario, mounting: Mounting, heights: int, tilts: int) -> Candidates:
    """The mounting in question, and a grid over the searched ones of height and tilt through it.

    The tilt is the lean where the scene is given by it; the other coordinates stay as they are in `mounting`.
    """
    (space,), place = scenario.deployment.spaces, mounting.as_table()
    names, bounds = space.axes, space.places[0].bounds
    axes = [
        np.linspace(*bounds[name], count).round(9) if name in bounds else [place[name]]  # 4.3, not 4.30...01
        for name, count in zip(names, (heights, tilts), strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    points = np.concatenate([[[place[name] for name in names]], grid])
    road = scenario.road_map
    placed = (changed_mounting(mounting, road, **dict(zip(names, point, strict=True))) for point in grid.tolist())
    return Candidates(names, points, tuple((one,) for one in (scenario.baseline, mounting, *placed)))


def check_searched(scenario: Scenario) -> None:
    """Refuse a scene that fixes both height and tilt: there is no optimum whose place could be uncertain."""
    axes = scenario.deployment.spaces[0].axes
    if not any(axis in scenario.deployment.bounds for axis in axes):
        raise InputError(
            f"{scenario.source}: [deployment] fixes {' and '.join(axes)}; allowed: at least one a pair [low, high]"
        )


def at_one_place(scenario: Scenario, pole: str | None = None) -> Scenario:
    """The scene with one of its candidate poles as its place, by name.

    Raises
    ------
    InputError
        When it has candidate poles and none is named, another is, or several recordings: a study is about one place and
        one recording.
    """
    if scenario.further_traffic:
        raise InputError(
            f"{scenario.source}: [[traffic]]: {len(scenario.recordings)} recordings are for optimise and evaluate; a "
            "study is about one: [traffic]"
        )
    deployment = scenario.deployment
    if pole is not None:
        return replace(scenario, deployment=deployment.on_pole(deployment.pole_named(pole)))
    if deployment.poles:
        raise InputError(
            f"{scenario.source}: [deployment] poles: are for optimise; a study is about one place, --pole NAME: "
            f"{', '.join(one.name for one in deployment.poles)}"
        )
    return scenario
