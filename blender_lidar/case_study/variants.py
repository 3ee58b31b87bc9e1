"""What the paper leaves unstated, as settings to vary one at a time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

from ..scenario import Scenario
from ..sensors.beams import beam_lattice
from ..sensors.model import load_model
from ..sensors.spacing import evenly_spaced
from ..study.scoring import CountedFrame
from ..study.site import Region, Site
from .sites import Overrides

SETBACKS_M = (0.5, 5.0, 10.0)
STATIONS_M = (-100.0, 100.0)
GATES_M = (50.0, 80.0, 150.0)  # Table I's, each for every sensor
RATES_HZ = (5.0, 20.0)
PHASES = (1.0 / 3.0, 2.0 / 3.0)  # of a step between columns
REGION_SHARE = 0.5
LOSSES = (0.0, 0.5, 2.0, 4.0)
OTHER_TABLES = {"RS-32": ("RS-LiDAR-32",), "RS-80": ("RS-Ruby-80V",)}  # sensors that the paper's names may mean too
AS_THE_SCENE = "as the scene has it"


@dataclass(frozen=True, slots=True)
class Variant:
    """One setting of one sensor's scene, changed.

    Attributes
    ----------
    what, value : str
        Which setting, and what it is changed to.
    overrides : mapping
        The change, where a scene file can express it.
    change : callable
        The change to the site made ready, where it cannot.
    """

    what: str
    value: str = ""
    overrides: Overrides = field(default_factory=dict)
    change: Callable[[Site], Site] = lambda site: site


def variants(scenario: Scenario) -> list[Variant]:
    """What is varied for one sensor, the scene as it is first."""
    found = [Variant(AS_THE_SCENE), *_places(scenario), *_regions(scenario), *_turns(scenario), *_tables(scenario)]
    for view in ("max", "min", "mean"):
        if view != scenario.objective.view:
            found.append(_set("view of Eq. 11", view, "objective", "view", view))
    for detail, text in (("box", "boxes"), ("body", "bodies")):
        if detail != scenario.model.detail:
            found.append(_set("vehicle shapes", text, "world", "detail", detail))
    other = {"corrected": "paper", "paper": "corrected"}[scenario.objective.reading]
    found.append(_set("reading of Eqs. 8 and 10", other, "objective", "reading", other))
    return found


def _set(what: str, value: str, table: str, key: str, given: object) -> Variant:
    return Variant(what, value, {(table, key): (given, f"case study, {what}")})


def _places(scenario: Scenario) -> list[Variant]:
    """Setback and place along the road: the mount moves, the traffic stays."""
    x_m, y_m = scenario.deployment.nominal_xy
    setback_m = scenario.road.setback_m - y_m
    found = [
        _set("setback", f"{value:g} m", "deployment", "y_m", scenario.road.setback_m - value)
        for value in SETBACKS_M
        if value != setback_m
    ]
    return found + [
        _set("place along the road", f"{shift:+g} m", "deployment", "x_m", x_m + shift) for shift in STATIONS_M
    ]


def _regions(scenario: Scenario) -> list[Variant]:
    """Which vehicles are asked for, and how far beams reach."""
    gate_m, model = scenario.sensor.range_gate_m, load_model(scenario.sensor.name)
    radius_m = REGION_SHARE * gate_m
    found = [Variant("region", f"within {radius_m:g} m", change=partial(_within, radius_m=radius_m))]
    return found + [
        _set("range gate", f"{value:g} m", "sensor", "range_gate_m", value)
        for value in GATES_M
        if model.range_min_m < value <= model.range_max_m  # its own too, so that all three stand beside each other
    ]


def _turns(scenario: Scenario) -> list[Variant]:
    """Step and phase of the azimuths."""
    model = load_model(scenario.sensor.name)
    found = [
        _set("azimuth step", f"{rate:g} Hz", "sensor", "rotation_hz", rate)
        for rate in RATES_HZ
        if rate != scenario.sensor.rotation_hz and rate in model.rotation_hz
    ]
    return found + [
        Variant("azimuth phase", f"{share:.2f} of a step", change=partial(_turned, share=share)) for share in PHASES
    ]


def _tables(scenario: Scenario) -> list[Variant]:
    """Other sensors that the paper's name may mean, and its beams spread evenly."""
    gate_m = scenario.sensor.range_gate_m
    found = []
    for name in OTHER_TABLES.get(scenario.sensor.name, ()):
        overrides: Mapping = {
            ("sensor", "name"): (name, "case study, beam table"),
            ("sensor", "range_gate_m"): (gate_m, "case study, beam table"),
        }
        found.append(Variant("beam table", name, overrides))
    if scenario.sensor.name == "RS-80":
        found.append(Variant("beam table", "evenly spaced", change=with_even_beams))
    return found


def with_even_beams(site: Site) -> Site:
    """The site with its sensor's beams spread evenly."""
    model = evenly_spaced(site.model)
    lattice = beam_lattice(model, site.observation.lattice.rotation_hz)
    return replace(site, model=model, observation=replace(site.observation, lattice=lattice))


def _turned(site: Site, share: float) -> Site:
    """The site with its sensor's columns shifted by a share of their step."""
    old = site.observation.lattice
    lattice = beam_lattice(site.model, old.rotation_hz, phase_rad=share * old.step_rad)
    return replace(site, observation=replace(site.observation, lattice=lattice))


def _within(site: Site, radius_m: float) -> Site:
    """The site with only the vehicles within a radius counted; the others hide them as before."""
    region = Region(site.scenario.deployment.nominal_xy, radius_m)
    search, holdout = (
        tuple(CountedFrame(frame.vehicles, frame.counted & region.holds(frame.vehicles)) for frame in frames)
        for frames in (site.search, site.holdout)
    )
    return replace(site, search=search, holdout=holdout)
