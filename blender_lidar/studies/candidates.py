"""Layouts that a study compares: Sobol's sequence over what is searched, or grids through the one in question.

All that studies know of coordinates stands here.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import InputError
from ..optimise.search import generator
from ..run.what_if import tilts_beside
from ..scene.deployment import SearchSpace, variable_of
from ..scene.mounting import Layout, Mounting, changed_mounting, mast_at
from ..scene.scenario import Scenario

SOBOL_BITS = 30
BASELINE, FIRST = 0, 1  # rows of a landscape: the baseline, and where the candidates begin


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Layouts to compare; of one LiDAR they are mountings.

    Attributes
    ----------
    variables : tuple of str
        Names of the coordinates in which they differ: of a grid height and tilt of each LiDAR, in their order.
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
        return any(variable.endswith("lean_deg") for variable in self.variables)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the LiDARs whose coordinates these are; that of a single one is nothing."""
        return tuple(dict.fromkeys(variable.rpartition(".")[0] for variable in self.variables))

    def select(self, numbers: Sequence[int]) -> Candidates:
        """The baseline and some of the candidates, by their rows in `points`."""
        layouts = (self.layouts[BASELINE], *(self.layouts[FIRST + number] for number in numbers))
        return Candidates(self.variables, self.points[list(numbers)], layouts)


def joint_space(scenario: Scenario) -> SearchSpace:
    """The search space of all LiDARs together, each on its one place."""
    lidars = scenario.lidars
    return SearchSpace(tuple(one.deployment.places[0] for one in lidars), tuple(one.name for one in lidars))


def sobol_candidates(scenario: Scenario, count: int) -> Candidates:
    """So many points of Sobol's sequence over all searched coordinates, shifted at random by the scene's seed.

    Raises
    ------
    InputError
        When nothing is searched.
    """
    space = joint_space(scenario)
    if not space.bounds:
        table = "every [[lidar]]" if scenario.is_layout else "[deployment]"
        raise InputError(f"{scenario.source}: {table} fixes every coordinate; allowed: at least one a pair [low, high]")
    lower, upper = np.array(space.lower, dtype=float), np.array(space.upper, dtype=float)
    points = sobol(scenario.search.seed, count, lower, upper)
    return Candidates(space.variables, points, (scenario.baselines, *map(space.layout, points)))


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


def grid_candidates(scenario: Scenario, layout: Layout, heights: int, tilts: int) -> Candidates:
    """The layout in question, and for each LiDAR a grid over its searched heights and tilts while the others are held.

    The tilt is the lean where the scene is given by it; the other coordinates stay as they are in `layout`. For several
    LiDARs there are as many points of Sobol's sequence over all heights and tilts as one grid has.
    """
    places = joint_space(scenario).places
    axes = [SearchSpace((place,)).axes for place in places]
    own = np.array([mounting.as_table()[key] for mounting, keys in zip(layout, axes, strict=True) for key in keys])
    spans = [place.bounds.get(key) for place, keys in zip(places, axes, strict=True) for key in keys]
    spans = [span or (at, at) for span, at in zip(spans, own.tolist(), strict=True)]
    points = [own[None]]
    for first in range(0, len(own), 2):
        counted = zip(spans[first : first + 2], (heights, tilts), strict=True)
        both = [np.linspace(*span, count).round(9) if span[0] < span[1] else span[:1] for span, count in counted]
        grid = np.stack(np.meshgrid(*both, indexing="ij"), axis=-1).reshape(-1, 2)  # 4.3, not 4.30...01
        points.append(np.tile(own, (len(grid), 1)))
        points[-1][:, first : first + 2] = grid
    if len(places) > 1:
        points.append(sobol(scenario.search.seed, heights * tilts, *np.array(spans).T))
    points = np.concatenate(points)

    layouts = [
        tuple(
            hung if at == at_first else changed_mounting(hung, scenario.road_map, **dict(zip(keys, at, strict=True)))
            for hung, keys, at, at_first in zip(
                layout, axes, point.reshape(-1, 2).tolist(), own.reshape(-1, 2).tolist(), strict=True
            )
        )
        for point in points
    ]
    named = zip(scenario.names, axes, strict=True)
    variables = tuple(variable_of(name, key) for name, keys in named for key in keys)
    return Candidates(variables, points, (scenario.baselines, *layouts))


_HIGHEST_M, _STEP_M = 12.0, 0.5
_MORE_DEG = (0.0, 5.0, 10.0)  # than planned, as a higher LiDAR needs


def higher_mountings(scenario: Scenario, mounting: Mounting) -> tuple[list[Mounting], float]:
    """A mounting raised step by step, up to 12 m or the highest that is allowed, each with its tilt and a few more.

    Returns
    -------
    list of Mounting
        The lowest first.
    float
        Up to which height its bounds allow it [m].
    """
    place, axis = scenario.lidar.deployment.places[0], joint_space(scenario).axes[1]
    _, allowed_m = place.bounds.get("height_m", (mounting.height_m,) * 2)
    up_to_m = max(_HIGHEST_M, allowed_m, mounting.height_m + _STEP_M)
    heights = np.arange(mounting.height_m + _STEP_M, up_to_m + 1e-9, _STEP_M).tolist()
    tilts = tilts_beside(mounting, axis, place.bounds, _MORE_DEG)
    road = scenario.road_map
    return [
        changed_mounting(mounting, road, height_m=height, **{axis: tilt}) for height in heights for tilt in tilts
    ], allowed_m


def on_other_side(scenario: Scenario, mounting: Mounting) -> Mounting | None:
    """The mirror image of a mounting across a straight road, as far from it; None where the mast stands over or between
    lanes, or on a map.

    The rotor turns the same way in both: only the order in time of its returns is another.
    """
    road = scenario.road_map
    if road.side_of(mounting.xy) not in ("left", "right"):
        return None
    place = road.locate(np.array([mounting.xy]))
    x, y = road.at(place.s_m[0], sum(road.edges_t) - place.t_m[0])
    if road.clearance((x, y))[0] <= 0.0:
        return None
    facing = math.remainder(2.0 * place.heading_rad[0] - mounting.mast.facing_rad, 2.0 * math.pi)
    mast = mast_at(road, float(x), float(y), facing)
    return replace(mounting, mast=mast, tilt_y=-mounting.tilt_y, yaw=-mounting.yaw)


def check_height_or_tilt_searched(scenario: Scenario) -> None:
    """Refuse a scene that fixes both height and tilt: there is no optimum whose place could be uncertain."""
    every = [(lidar.deployment.places[0], lidar.deployment.spaces[0].axes) for lidar in scenario.lidars]
    if not any(axis in place.bounds for place, axes in every for axis in axes):
        table, fixed = "every [[lidar]]" if scenario.is_layout else "[deployment]", " and ".join(every[0][1])
        raise InputError(f"{scenario.source}: {table} fixes {fixed}; allowed: at least one a pair [low, high]")


def at_one_place(scenario: Scenario, pole: str | None = None, layout: Layout | None = None) -> Scenario:
    """The scene with one of its candidate poles as its place, by name, or those on which a layout hangs.

    Raises
    ------
    InputError
        When it has candidate poles and none is named, another is, or several recordings: a study is about one place and
        one recording.
    """
    if len(scenario.recordings) > 1:
        raise InputError(
            f"{scenario.source}: [[traffic]]: {len(scenario.recordings)} recordings are for optimise and evaluate; a "
            "study is about one: [traffic]"
        )
    if pole is not None and scenario.is_layout:
        raise InputError(f"--pole: is of one LiDAR, but the scene has {len(scenario.lidars)}; allowed: --run DIR")
    placed = []
    for lidar, mounting in zip(scenario.lidars, layout or (None,) * len(scenario.lidars), strict=True):
        deployment, found = lidar.deployment, None
        if pole is not None:
            found = deployment.on_pole(pole)
        elif mounting and (there := deployment.pole_at(mounting.xy)):
            found = deployment.on_pole(there.name)
        elif len(deployment.places) == 1:
            (found,) = deployment.places
        if found is None:
            asked = "one place of each LiDAR, --run DIR or for stability --lidar NAME,pole=NAME"
            asked = asked if scenario.is_layout else "one place, --pole NAME"
            where, names = scenario.where(lidar.table, "poles"), ", ".join(pole.name for pole in deployment.poles)
            raise InputError(f"{where}: are for optimise; a study is about {asked}: {names}")
        placed.append(replace(lidar, deployment=deployment.at(found)))
    return scenario.with_lidars(*placed)
