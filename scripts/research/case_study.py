"""The paper's case study (He, Cao, Su and Liu, arXiv 2407.17942, section V): its sensors, its numbers, our settings.

The three sensors see the same frames of the same traffic in the same blocks of time. What the paper leaves unstated is
varied one setting at a time: see `variants`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from blender_lidar.errors import InputError
from blender_lidar.metrics.catalogue import PE_VGOP
from blender_lidar.optimise import DePso
from blender_lidar.run.verdict import AXES
from blender_lidar.scene.mounting import Layout
from blender_lidar.scene.provenance import file_digest
from blender_lidar.scene.region import Region
from blender_lidar.scene.scenario import Scenario, load_scenario
from blender_lidar.scene.site import Site, prepare
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import LidarModel, load_model

HeightAndTilt = tuple[float, float]  # [m], across the road [deg]
Overrides = Mapping[tuple[str, str], tuple[object, str]]


class Published(NamedTuple):
    """A sensor's row of Tables I (range), II (optimum) and III (recall of baseline and optimum, at 0.1 and 0.3)."""

    beams: int
    range_m: float
    height_m: float
    tilt_deg: float
    recall_01: tuple[float, float]
    recall_03: tuple[float, float]


PUBLISHED = {
    "RS-16": Published(16, 50.0, 4.1, 19.0, (0.70, 0.87), (0.57, 0.67)),
    "RS-32": Published(32, 80.0, 4.2, 13.0, (0.63, 0.88), (0.53, 0.68)),
    "RS-80": Published(80, 150.0, 4.4, 9.0, (0.85, 0.95), (0.78, 0.86)),
}
SENSORS = tuple(PUBLISHED)
EVEN = "RS-80 evenly spaced"  # what the paper has RS-80's uneven beams stand against


class Effort(NamedTuple):
    """How much of everything is done.

    `frames` searched and `iterations` of DE-PSO are the scene's where None. Of a grid the numbers of heights and tilts:
    `grid` has the last word on the optimum, `wide_grid` goes beyond the paper's bounds, `sensitivity_grid` is scored on
    `sensitivity_frames` for each setting that is varied.
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
    """The scene, options in its settings' place, the effort, and the length of a block of time common to all [s]."""

    scene: str
    overrides: Overrides
    effort: Effort
    block_s: float = 0.0

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
        """What two runs must share for the second to go on with the first's stages; these files are part of it."""
        of_sites = {f"{name} {key}": value for name in SENSORS for key, value in self.site(name).identity.items()}
        code = {path.name: file_digest(path) for path in sorted(Path(__file__).parent.glob("case_study*.py"))}
        return {**of_sites, **self.effort._asdict(), **code}


def open_case(scene: str, overrides: Overrides, effort: Effort) -> CaseStudy:
    """The case study of a scene; blocks are as long as the sensor with the widest region needs them.

    The search is DE-PSO, the paper's, whichever the scene names.

    Raises
    ------
    InputError
        Where the scene has another metric than the paper's, searches anything but height and tilt, has its baseline at
        another place than the mountings, or holds no frames out to judge by.
    """
    case = CaseStudy(scene, {**overrides, ("search", "method"): (DePso.name, "the case study")}, effort)
    sites = [case.site(sensor) for sensor in SENSORS]
    scenario = sites[0].scenario
    if scenario.objective.metric != PE_VGOP.name:
        raise InputError(f"{scene}: [objective] metric is {scenario.objective.metric!r}; allowed: {PE_VGOP.name!r}")
    if scenario.lidar.deployment.spaces[0].variables != AXES:
        raise InputError(f"{scene}: [deployment] {' and '.join(AXES)} must be pairs, and they alone: Table II has two")
    (beside,) = layout_at(sites[0], baseline_of(sites[0]))
    if beside.as_table() != scenario.lidar.baseline.as_table():
        raise InputError(f"{scene}: [baseline] stands elsewhere; allowed: another height and tilt alone")
    if not all(sum(frame.counted.sum() for frame in site.holdout) for site in sites):
        raise InputError(f"{scene}: [traffic] holdout leaves no vehicle to judge by; allowed: a share that leaves some")
    searched = min(len(site.search) for site in sites)
    effort = effort._replace(sensitivity_frames=min(effort.sensitivity_frames, searched))
    return replace(case, effort=effort, block_s=max(site.plan.block_s for site in sites))


def layout_at(site: Site, at: HeightAndTilt) -> Layout:
    """A LiDAR at a height and a tilt, at the scene's place."""
    return site.scenario.lidar.deployment.spaces[0].layout(at)


def baseline_of(site: Site) -> HeightAndTilt:
    """Height [m] and tilt [deg] of the scene's baseline."""
    table = site.scenario.lidar.baseline.as_table()
    return table["height_m"], table["tilt_x_deg"]


# --- what the paper leaves unstated -----------------------------------------------------------------------------------

SETBACKS_M = (0.5, 5.0, 10.0)
STATIONS_M = (-100.0, 100.0)
GATES_M = (50.0, 80.0, 150.0)  # Table I's, each for every sensor
RATES_HZ = (5.0, 20.0)
PHASES = (1.0 / 3.0, 2.0 / 3.0)  # of a step between columns
REGION_SHARE = 0.5
OTHER_TABLES = {"RS-32": "RS-LiDAR-32", "RS-80": "RS-Ruby-80V"}  # sensors that the paper's names may mean too
AS_THE_SCENE = "as the scene has it"


@dataclass(frozen=True, slots=True)
class Variant:
    """One setting changed: which, to what, as a scene file says it or, where none can, as a change to the site."""

    what: str
    value: str = ""
    overrides: Overrides = field(default_factory=dict)
    change: Callable[[Site], Site] = lambda site: site


def variants(scenario: Scenario) -> list[Variant]:
    """What is varied for one sensor, the scene as it is first."""
    x_m, y_m = scenario.lidar.deployment.nominal_xy
    sensor, objective, setback_m = scenario.lidar.sensor, scenario.objective, scenario.road.setback_m
    model, radius_m = load_model(sensor.name), REGION_SHARE * sensor.range_gate_m
    found = [Variant(AS_THE_SCENE)]

    def vary(what: str, value: str, table: str, key: str, given: object) -> None:
        found.append(Variant(what, value, {(table, key): (given, f"case study, {what}")}))

    def move(what: str, value: str, place: tuple[float, float]) -> None:
        """To another place, and the region with it."""
        given = {("deployment", "x_m"): place[0], ("deployment", "y_m"): place[1], ("region", "centre_m"): place}
        found.append(Variant(what, value, {key: (one, f"case study, {what}") for key, one in given.items()}))

    for value in SETBACKS_M:  # the mount moves, the traffic stays
        if value != setback_m - y_m:
            move("setback", f"{value:g} m", (x_m, setback_m - value))
    for shift in STATIONS_M:
        move("place along the road", f"{shift:+g} m", (x_m + shift, y_m))
    found.append(Variant("region", f"within {radius_m:g} m", change=lambda site: _within(site, radius_m)))
    for value in GATES_M:
        if model.range_min_m < value <= model.range_max_m:  # its own too, so that all three stand beside each other
            vary("range gate", f"{value:g} m", "sensor", "range_gate_m", value)
    for rate in RATES_HZ:
        if rate != sensor.rotation_hz and rate in model.rotation_hz:
            vary("azimuth step", f"{rate:g} Hz", "sensor", "rotation_hz", rate)
    for share in PHASES:
        found.append(
            Variant("azimuth phase", f"{share:.2f} of a step", change=lambda site, by=share: _turned(site, by))
        )
    if sensor.name in OTHER_TABLES:
        name, words = OTHER_TABLES[sensor.name], "case study, beam table"
        given = {("sensor", "name"): (name, words), ("sensor", "range_gate_m"): (sensor.range_gate_m, words)}
        found.append(Variant("beam table", name, given))
    if sensor.name == "RS-80":
        found.append(Variant("beam table", "evenly spaced", change=with_even_beams))
    for view in ("max", "min", "mean"):
        if view != objective.view:
            vary("view of Eq. 11", view, "objective", "view", view)
    for detail, text in (("box", "boxes"), ("body", "bodies")):
        if detail != scenario.world.detail:
            vary("vehicle shapes", text, "world", "detail", detail)
    other = {"corrected": "paper", "paper": "corrected"}[objective.reading]
    vary("reading of Eqs. 8 and 10", other, "objective", "reading", other)
    return found


def with_even_beams(site: Site) -> Site:
    """The site with its sensor's beams spread evenly."""
    model = evenly_spaced(site.model)
    lattice = beam_lattice(model, site.observation.lattice.rotation_hz)
    return replace(site, observation=site.observation.with_lidar(lattice=lattice))


def evenly_spaced(model: LidarModel) -> LidarModel:
    """The same sensor with its elevations spread evenly between its lowest and its highest beam; nobody builds it.

    Number of rings, field of view, azimuths, firing times and ranges stay.
    """
    return replace(
        model,
        name=f"{model.name} evenly spaced",
        description=f"{model.name} with its {model.rings} beams spread evenly over its field of view",
        source=f"made from the table of {model.name}",
        confidence="none: there is no such sensor",
        aliases=(),
        elevation_rad=np.linspace(model.elevation_rad[0], model.elevation_rad[-1], model.rings),
    )


def _turned(site: Site, share: float) -> Site:
    """The site with its sensor's columns shifted by a share of their step."""
    old = site.observation.lattice
    lattice = beam_lattice(site.model, old.rotation_hz, phase_rad=share * old.step_rad)
    return replace(site, observation=site.observation.with_lidar(lattice=lattice))


def _within(site: Site, radius_m: float) -> Site:
    """The site with only the vehicles within a radius counted; the others hide them as before."""
    region = Region(site.region.centre_xy, radius_m)
    search, holdout = (
        tuple(replace(frame, counted=frame.counted & region.holds(frame)) for frame in frames)
        for frames in (site.search, site.holdout)
    )
    return replace(site, search=search, holdout=holdout)
