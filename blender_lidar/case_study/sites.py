"""The three sensors on the same traffic: the same frames, the same blocks of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ..errors import InputError
from ..metrics.views import PE_VGOP
from ..optimise import DePso
from ..scenario import Scenario, load_scenario
from ..study.score_map import AXES
from ..study.site import Site, prepare
from .published import SENSORS

Overrides = Mapping[tuple[str, str], tuple[object, str]]


@dataclass(frozen=True, slots=True)
class Effort:
    """How much of everything is done.

    Attributes
    ----------
    frames : int or None
        Searched frames; None takes the scene's.
    grid : (int, int)
        Heights and tilts of the grid that has the last word on the optimum.
    wide_grid : (int, int)
        Those of the grid beyond the paper's bounds.
    iterations : int or None
        Of DE-PSO; None takes the scene's.
    sensitivity_frames : int
        Searched frames for each setting that is varied, or all where the scene has fewer.
    sensitivity_grid : (int, int)
        Heights and tilts for each of them.
    """

    frames: int | None
    grid: tuple[int, int]
    wide_grid: tuple[int, int]
    iterations: int | None
    sensitivity_frames: int
    sensitivity_grid: tuple[int, int]


FULL = Effort(None, (26, 26), (13, 21), None, 15, (6, 26))
QUICK = Effort(10, (6, 26), (7, 11), 10, 6, (6, 11))


@dataclass(frozen=True, slots=True)
class CaseStudy:
    """The case study's scene, and what is asked of it.

    Attributes
    ----------
    scene : str
        The scene file.
    overrides : mapping
        Options in place of its settings, as `load_scenario` takes them.
    effort : Effort
    block_s : float
        Length of a block of time, common to the sensors [s].
    """

    scene: str
    overrides: Overrides
    effort: Effort
    block_s: float = field(default=0.0)

    def scenario(self, sensor: str, changes: Overrides | None = None) -> Scenario:
        """The scene with one sensor; `changes` count for more than `overrides`."""
        given: dict = {("sensor", "name"): (sensor, "the case study"), **self.overrides}
        if self.effort.frames is not None:
            given.setdefault(("traffic", "frames"), (self.effort.frames, "the case study"))
        if self.effort.iterations is not None:
            given["search", "iterations"] = (self.effort.iterations, "the case study")
        if self.block_s:
            given["traffic", "block_s"] = (self.block_s, "the case study")
        return load_scenario(self.scene, {**given, **(changes or {})})

    def site(self, sensor: str, changes: Overrides | None = None) -> Site:
        """The scene with one sensor, made ready."""
        return prepare(self.scenario(sensor, changes))

    def identity(self) -> dict[str, object]:
        """What the study's numbers depend on."""
        found: dict[str, object] = {}
        for sensor in SENSORS:
            found |= {f"{sensor} {key}": value for key, value in self.site(sensor).identity.items()}
        effort = {f"effort {name}": getattr(self.effort, name) for name in self.effort.__slots__}
        return found | effort


def open_case(scene: str, overrides: Overrides, effort: Effort) -> CaseStudy:
    """The case study of a scene; blocks are as long as the sensor with the widest region needs them.

    The search is DE-PSO, the paper's, whichever the scene names.

    Raises
    ------
    BlenderLidarError
        When a file cannot be used, or the scene does not have both height and tilt searched and nothing else, or has
        another metric than the paper's.
    """
    overrides = {**overrides, ("search", "method"): (DePso.name, "the case study")}
    case = CaseStudy(scene, overrides, effort)
    metric = case.scenario(SENSORS[0]).objective.metric
    if metric != PE_VGOP.name:
        raise InputError(f"{scene}: [objective] metric is {metric!r}; allowed: {PE_VGOP.name!r}, the paper's")
    sites = [case.site(sensor) for sensor in SENSORS]
    if sites[0].scenario.deployment.variables != AXES:
        raise InputError(f"{scene}: [deployment] {' and '.join(AXES)} must be pairs, and they alone: Table II has two")
    searched = min(len(site.search) for site in sites)
    effort = replace(effort, sensitivity_frames=min(effort.sensitivity_frames, searched))
    return CaseStudy(scene, overrides, effort, max(site.plan.block_s for site in sites))
