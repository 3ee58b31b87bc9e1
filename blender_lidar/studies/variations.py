"""What studies change about a scene: traffic, metric, sensor, and what its model has or leaves out; the one table.

A `Variation` is one change, an `Ablation` pairs of them: the scene without something and with it. Traffic is remixed as
a model for asking what would change, not as a forecast: vehicles keep their lanes, their order and their sizes, unless
they are turned into others, and queue up again with the gaps that they are given.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..casting.protocol import StandingScenery
from ..errors import InputError
from ..metrics.catalogue import METRICS, metric_named
from ..metrics.metric import NEEDS_DETECTABLE
from ..optimise import VIEWS
from ..plugins import short_name
from ..run.what_if import mixes, with_traffic
from ..scene.deployment import installers_text
from ..scene.site import Site, lattice_of, standing_scenery
from ..scene.usual import ON_PLANE_M
from ..scoring.fidelity import Fidelity, coarse_observation
from ..sensors.beams import BeamLattice, beam_lattice
from ..traffic.boxes import Boxes
from ..traffic.vehicles import PEDESTRIAN
from ..world.scenery import along_road, barrier, join
from ..world.shapes import DETAILS
from .driver import Variation

TRAFFIC, MOUNTING, METRIC, SENSOR, SEARCH = "traffic", "mounting", "metric", "sensor", "search"
SECTIONS = (TRAFFIC, MOUNTING, METRIC, SENSOR, SEARCH)

# --- traffic: lorries, light traffic, rush hour, a queue --------------------------------------------------------------


def traffic_variations(site: Site, draws: int) -> list[Variation]:
    """Lorries by lane, light traffic, rush hour and a queue, of `what_if.mixes`, what is drawn `draws` times.

    And no pedestrians where some hide vehicles, a level road where the map has heights.
    """
    found = [
        Variation(TRAFFIC, mix.what, mix.value, partial(mix.change, seed=number), number)
        for mix in mixes(site, site.scenario.nominal_xy)
        for number in (range(1, draws + 1) if mix.is_drawn else (0,))
    ]
    if _pedestrians_hide(site):
        found.append(Variation(TRAFFIC, "pedestrians", "left out", without_pedestrians))
    if _has_heights(site):
        found.append(Variation(TRAFFIC, "heights", "level road", levelled))
    return found


# --- metric: the score with other constants, and other scores, of the same returns ------------------------------------

CELLS_M = (0.025, 0.05, 0.1, 0.2)
THRESHOLDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
MISS_COSTS = (0.0, 0.5, 1.0, 2.0, 4.0)  # abs(C), in the metric's unit


def metric_variations(site: Site, rivals: Sequence[str] = ()) -> list[Variation]:
    """Cell size, view, delta and C of the scene's objective, and every other metric in its place, `rivals` too.

    Without a C the objective asks for neither view nor delta, unless its metric does.
    """
    scoring, cell_m = site.scoring, site.observation.cell_m
    settings = []
    if scoring.loss is not None or NEEDS_DETECTABLE in metric_named(scoring.metric).needs:
        settings += [
            ("view of Eq. 11", "view", {view: view for view in VIEWS}),
            ("delta of Eq. 11", "threshold", {f"{value:g}": value for value in THRESHOLDS}),
        ]
    if scoring.loss is not None:
        settings.append(("abs(C) of Eq. 10", "loss", {f"{value:g}": -value for value in MISS_COSTS}))
    changes = [
        ("cell size", f"{100 * side:g} cm", partial(_with_cells, cell_m=side)) for side in CELLS_M if side != cell_m
    ]
    changes += [
        (what, text, partial(_with_scoring, **{key: value}))
        for what, key, values in settings
        for text, value in values.items()
        if value != (-abs(scoring.loss) if key == "loss" else getattr(scoring, key))
    ]
    others = [name for name in (*METRICS, *rivals) if name != scoring.metric]
    changes += [("other metric", short_name(name), partial(_with_metric, name=name)) for name in others]
    return [Variation(METRIC, *change, recast=False) for change in changes]


def _with_cells(site: Site, cell_m: float) -> Site:
    return replace(site, observation=replace(site.observation, cell_m=cell_m))


def _with_scoring(site: Site, **settings) -> Site:
    return replace(site, scoring=replace(site.scoring, **settings))


def _with_metric(site: Site, name: str) -> Site:
    """The site with another metric and, as a scene has it that says nothing else, no loss for a missed vehicle."""
    return _with_scoring(site, metric=name, loss=None)


# --- sensor: other units of it, noise, lost returns, azimuths ---------------------------------------------------------

PHASES = (1.0 / 3.0, 2.0 / 3.0)  # of a step between columns
_DRAWN = (  # what, key of [sensor], values, unit of the values, key of the seed
    ("unit-to-unit spread", "unit_spread_deg", (0.03, 0.1), " deg", "unit"),
    ("range noise", "range_noise_m", (0.02, 0.05), " m", "noise_seed"),
    ("drop-out", "dropout", (0.1, 0.3), "", "noise_seed"),
    ("glass drop-out", "glass_dropout", (0.5,), "", "noise_seed"),
)


def sensor_variations(site: Site, draws: int) -> list[Variation]:
    """Each imperfection alone, what is drawn `draws` times over; phase and step of the azimuths."""
    changes = [
        (what, f"{value:g}{unit}", partial(with_sensor, settings={key: value, seed: number}), number)
        for what, key, values, unit, seed in _DRAWN
        for value in values
        for number in range(1, draws + 1)
    ]
    beams, names = [one.lattice for one in site.observation.lidars], [one.name for one in site.scenario.lidars]
    rates = [rate for rate in beams[0].model.rotation_hz if all(rate in one.model.rotation_hz for one in beams)]
    rates = [rate for rate in rates if any(rate != one.rotation_hz for one in beams)]
    fixed = [("glass drop-out", "1", {"glass_dropout": 1.0})]  # loses them all
    fixed += [("10 % target seen", f"to {reach:g} m", {"range_at_10_percent_m": reach}) for reach in (60.0, 30.0)]
    fixed += [("rotation rate", f"{rate:g} Hz", {"rotation_hz": rate}) for rate in rates]
    changes += [(what, text, partial(with_sensor, settings=settings)) for what, text, settings in fixed]
    changes += [("azimuth phase", f"{share:.2f} of a step", partial(_turned, share=share)) for share in PHASES]
    for out in names[len(names) == 1 :]:
        changes.append(("LiDAR out of order", out, partial(with_only, names=[name for name in names if name != out])))
    return [Variation(SENSOR, *change) for change in changes]


def with_sensor(site: Site, settings: Mapping[str, float | None]) -> Site:
    """The site with other keys of [sensor], for all LiDARs alike."""
    sensors = [replace(lidar.sensor, **settings) for lidar in site.scenario.lidars]
    lidars = [
        replace(lidar, lattice=lattice_of(sensor), imperfections=sensor.imperfections)
        for lidar, sensor in zip(site.observation.lidars, sensors, strict=True)
    ]
    return replace(site, observation=replace(site.observation, lidars=tuple(lidars)))


def with_only(site: Site, names: Sequence[str]) -> Site:
    """The site with some of its LiDARs alone: the others hang, and see nothing."""
    lidars = (one if one.name in names else replace(one, max_range_m=0.0) for one in site.observation.lidars)
    return replace(site, observation=replace(site.observation, lidars=tuple(lidars)))


def _turned(site: Site, share: float) -> Site:
    """The site with its sensor's columns shifted by a share of their step."""

    def turned(old: BeamLattice) -> BeamLattice:
        return beam_lattice(old.model, old.rotation_hz, phase_rad=share * old.step_rad)

    return replace(site, observation=site.observation.with_lattices(turned))


# --- the model: how finely it is calculated, and what is in it --------------------------------------------------------

LADDER, ABLATION = "ladder", "ablation"
DROPOUT, SPREAD_DEG, GLASS = 0.05, 0.03, 0.3  # of glass as much as real cars agree with
WEAK_RETURNS_M = 50.0  # to which a target of 10 % is seen, where the sensor's table does not say
_WEAK = "range_at_10_percent_m"  # the one imperfection of [sensor] in which nothing is drawn


def whole(fidelity: Fidelity) -> Fidelity:
    """The same on all frames: what looks at fewer of them takes their columns of what all come to."""
    return replace(fidelity, frames=None)


def of_fidelity(fidelity: Fidelity, section: str = LADDER) -> Variation:
    """A fidelity as a change of the site; the number of frames stays, and fewer beams are scored on larger cells."""
    changed = partial(_at_fidelity, fidelity=whole(fidelity))
    return Variation(section, whole(fidelity).name, f"phase {fidelity.phase}", changed)


def _at_fidelity(site: Site, fidelity: Fidelity) -> Site:
    return replace(site, observation=coarse_observation(site.observation, fidelity))


@dataclass(frozen=True, slots=True)
class Ablation:
    """The scene without something, and with it.

    Attributes
    ----------
    what, value : str
        What it is.
    pairs : tuple of (Variation, Variation)
        Without it and with it: once, or for each of several random draws; none where there is nothing to compare.
    note : str
        Why there is nothing.
    """

    what: str
    value: str
    pairs: tuple[tuple[Variation, Variation], ...]
    note: str = ""


def ablations(site: Site, draws: int) -> list[Ablation]:
    """All of them for a scene; what it has already is left out of it, and what it has not is added.

    `draws` : units, or draws of noise, of a sensor that is imperfect at random.
    """
    own = of_fidelity(Fidelity(site.scenario.world.detail))
    box, body, detailed = (of_fidelity(Fidelity(level)) for level in DETAILS)

    return [
        *_median_barrier(site, own),
        *_pedestrians(site, own),
        *_heights(site, own),
        _installation(site, own),
        Ablation("body shape", "body, not box", ((box, body),)),
        Ablation("finer shape", "detailed, not body", ((body, detailed),)),
        _azimuth_offsets(site, own),
        *_imperfections(site, own, draws),
    ]


def _median_barrier(site: Site, own: Variation) -> list[Ablation]:
    """A barrier along a straight road; none on a map, on which no barrier can stand."""
    if not site.scenario.road_map.endless:
        return []
    road, (right, left) = site.scenario.road_map, site.scenario.road_map.edges_t
    middle = right + (left - right) / len(road) * (len(road) // 2)
    where = "in the middle of the median" if site.scenario.road.median_m else "on the middle lane line"
    barrier_at = f"{where}, y {middle:g} m"
    with_barrier = Variation(ABLATION, "median barrier", barrier_at, partial(_with_barrier, y_m=middle))
    return [Ablation("median barrier", barrier_at, ((own, with_barrier),))]


def _pedestrians_hide(site: Site) -> bool:
    """Whether there are pedestrians who are not scored, and so only hide vehicles."""
    there = any((frame.class_index == PEDESTRIAN).any() for frame in site.search)
    return there and "pedestrian" not in site.scenario.objective.scored_classes


def without_pedestrians(site: Site) -> Site:
    """The site without pedestrians."""
    return with_traffic(site, lambda vehicles: vehicles.select(vehicles.class_index != PEDESTRIAN))


def _pedestrians(site: Site, own: Variation) -> list[Ablation]:
    """Pedestrians who only hide vehicles, if there are any."""
    if not _pedestrians_hide(site):
        return []
    none = Variation(ABLATION, "pedestrians", "left out", without_pedestrians)
    return [Ablation("pedestrians", "who hide vehicles", ((none, own),))]


def _installation(site: Site, own: Variation) -> Ablation:
    """Installation errors, of each frame its own: those of the scene, or the usual ones of what hangs already."""
    installers = site.scenario.studied_installers
    within = installers_text(installers)
    shaken = Variation(ABLATION, "installation errors", within, installers=installers)
    return Ablation("installation errors", within, ((own, shaken),))


def _has_heights(site: Site) -> bool:
    """Whether the site's map is not level."""
    return site.scenario.road_map.surface.is_ground


def _heights(site: Site, own: Variation) -> list[Ablation]:
    """The heights of a map, if it has any."""
    if not _has_heights(site):
        return []
    return [Ablation("heights", "of the map", ((Variation(ABLATION, "heights", "level road", levelled), own),))]


def levelled(site: Site) -> Site:
    """The site with a road as high everywhere as at the mast, which then hides nothing."""
    scenario, surface = site.scenario, site.scenario.road_map.surface
    feet_m = surface.height(np.array([one.deployment.nominal_xy for one in scenario.lidars]))
    if np.ptp(feet_m) > ON_PLANE_M:
        raise InputError(f"the masts' feet differ by {np.ptp(feet_m):.2f} m: no level road is under them all")
    foot_m = float(feet_m[0])

    def lowered(vehicles: Boxes) -> Boxes:
        off = (surface.height(vehicles.centre_m) - foot_m)[:, None] * [0.0, 0.0, 1.0]
        return replace(vehicles, centre_m=vehicles.centre_m - off)

    bare = replace(scenario, world=replace(scenario.world, ground=False))
    scenery = standing_scenery(bare, site.observation.caster)
    return replace(with_traffic(site, lowered), observation=replace(site.observation, scenery=scenery))


def _with_barrier(site: Site, y_m: float) -> Site:
    """The site with a concrete barrier along its whole region besides what stands there."""
    observation, road = site.observation, site.scenario.road_map
    stations = road.stations(road.stretch(site.region.centre_xy, site.reach_m))
    more = along_road(road, barrier("concrete", y_m, stations))
    standing = observation.scenery or StandingScenery(join([]), observation.caster)
    return replace(site, observation=replace(observation, scenery=standing.beside(more)))


def _azimuth_offsets(site: Site, own: Variation) -> Ablation:
    models = [lidar.lattice.model for lidar in site.observation.lidars]
    what, offsets = "azimuth offsets", np.degrees(np.concatenate([model.azimuth_offset_rad for model in models]))
    if not offsets.any():
        return Ablation(
            what, "", (), f"the beam table of the {' and '.join(dict.fromkeys(one.name for one in models))} has none"
        )
    level = Variation(ABLATION, what, "left out", without_offsets)
    return Ablation(what, f"{offsets.min():g} to {offsets.max():g} deg", ((level, own),))


def without_offsets(site: Site) -> Site:
    """The site with a sensor all of whose rings look where their column does."""

    def level(old: BeamLattice) -> BeamLattice:
        return beam_lattice(replace(old.model, azimuth_offset_rad=np.zeros(old.model.rings)), old.rotation_hz)

    return replace(site, observation=site.observation.with_lattices(level))


def _imperfections(site: Site, own: Variation, draws: int) -> list[Ablation]:
    """Keys of [sensor] that make it imperfect: at 0 and as asked, or as the scene has it."""
    models = [lidar.lattice.model for lidar in site.observation.lidars]
    noise_m = max(one.range_noise_m for one in models)
    weak_m = min(one.range_at_10_percent_m or WEAK_RETURNS_M for one in models)
    asked = (
        ("glass drop-out", f"{100 * GLASS:g} % of its returns", "glass_dropout", GLASS),
        ("range noise", f"{noise_m:g} m", "range_noise_m", noise_m),
        ("drop-out", f"{100 * DROPOUT:g} % of all returns", "dropout", DROPOUT),
        ("weak returns", f"10 % target seen to {weak_m:g} m", _WEAK, weak_m),
        ("unit spread", f"{SPREAD_DEG:g} deg", "unit_spread_deg", SPREAD_DEG),
    )
    sensors, found = [lidar.sensor for lidar in site.scenario.lidars], []
    drawn = ("range_noise_m", "dropout", "glass_dropout", "unit_spread_deg")
    at_random = any(getattr(sensor, key) for sensor in sensors for key in drawn)

    def side(name: str, value: str, draw: int, **settings) -> Variation:
        seeds = {"noise_seed": draw, "unit": draw} if draw else {}
        return Variation(ABLATION, name, value, partial(with_sensor, settings=seeds | settings), draw)

    for what, value, key, number in asked:
        has = " and ".join(dict.fromkeys(f"{one:g}" for sensor in sensors if (one := getattr(sensor, key))))
        pairs = []
        for draw in range(1, draws + 1) if key != _WEAK else (0,):
            as_it_is = side("as drawn", "", draw) if draw and at_random else own
            if has:
                nothing = side(what, f"{value} left out", draw, **{key: None if key == _WEAK else 0.0})
                pairs.append((nothing, as_it_is))
            else:
                pairs.append((as_it_is, side(what, value, draw, **{key: number})))
        found.append(Ablation(what, f"{has}, as the scene has it" if has else value, tuple(pairs)))
    return found
