"""What a model of the scene may have or leave out, one thing at a time: ground, barriers, wheels, glass, noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..sensors.beams import beam_lattice
from ..study.fidelity import Fidelity
from ..study.scoring import CountedFrame
from ..study.site import Site, lattice_of
from ..study.site_fidelity import with_scenery
from ..study.variation import Scorer, Variation
from ..world.barriers import barrier
from ..world.shapes import DETAILS
from ..world.triangles import vehicle_triangles
from .bare_shapes import bare_shape
from .ladder import BEST_DETAIL, variation
from .motion import MovingScorer, recorded_velocity, velocity_at
from .plain_scorer import PlainScorer, SinglePrecisionScorer, check_perfect

ABLATION = "ablation"
DROPOUT, SPREAD_DEG, GLASS = 0.05, 0.03, (0.3, 1.0)
WEAK_RETURNS_M = 50.0  # to which a target of 10 % is seen, where the sensor's table does not say
FREE_FLOW_M_S = 30.0
_MEDIAN_CLEARANCE = 0.5  # of a setback: where a barrier stands between pole and road


@dataclass(frozen=True, slots=True)
class Ablation:
    """The scene without something, and with it.

    Attributes
    ----------
    what, value : str
        What it is.
    without, having : Variation
    note : str
        What is to be known of it; or, where one of both is None, why there is nothing to compare.
    """

    what: str
    value: str
    without: Variation | None
    having: Variation | None
    note: str = ""


def ablations(site: Site) -> list[Ablation]:
    """All of them for a scene; what it has already is left out of it, and what it has not is added."""
    own = variation(Fidelity(site.scenario.model.detail))
    return [*_surroundings(site, own), *_shapes(), *_sensor(site, own), *_experiments(own)]


def _surroundings(site: Site, own: Variation) -> list[Ablation]:
    right, left = site.scenario.road.carriageway_y
    reach = site.reach_m
    x, y = site.region.centre_xy
    beside = y + _MEDIAN_CLEARANCE * (right - y) if y < right else left + _MEDIAN_CLEARANCE * (y - left)
    middle = right + (left - right) / site.scenario.road.lanes * (site.scenario.road.lanes // 2)
    ends = (x - reach, x + reach)
    standing = (
        ("guard rail", f"between pole and road, y {beside:g} m", ("guard_rail", beside, ends)),
        ("median barrier", f"on the middle lane line, y {middle:g} m", ("concrete", middle, ends)),
    )
    plane = variation(Fidelity(site.scenario.model.detail, ground=True))
    ground = replace(plane, section=ABLATION, what="ground", value="cast too")
    return [
        Ablation("ground", "two large triangles cast too", own, ground),
        *(
            Ablation(what, text, own, Variation(ABLATION, what, "there", partial(_with_barrier, given=given)))
            for what, text, given in standing
        ),
    ]


def _shapes() -> list[Ablation]:
    levels = {detail: variation(Fidelity(detail)) for detail in DETAILS}
    bare = Variation(ABLATION, "wheels and mirrors", "left out", _with_best_detail, scorer=_bare)
    return [
        Ablation("body shape", "body, not box", levels["box"], levels["body"]),
        Ablation("finer shape", "detailed, not body", levels["body"], levels["detailed"]),
        Ablation("wheels and mirrors", "detailed with, not without them", bare, levels["detailed"]),
    ]


def _sensor(site: Site, own: Variation) -> list[Ablation]:
    noise_m, weak_m = site.model.range_noise_m, site.model.range_at_10_percent_m or WEAK_RETURNS_M
    asked = (
        *(("glass drop-out", f"{100 * share:g} % of its returns", "glass_dropout", share) for share in GLASS),
        ("range noise", f"{noise_m:g} m", "range_noise_m", noise_m),
        ("drop-out", f"{100 * DROPOUT:g} % of all returns", "dropout", DROPOUT),
        ("weak returns", f"10 % target seen to {weak_m:g} m", "range_at_10_percent_m", weak_m),
        ("unit spread", f"{SPREAD_DEG:g} deg", "unit_spread_deg", SPREAD_DEG),
    )
    return [_azimuth_offsets(site, own), *(_setting(site, own, *one) for one in asked)]


def _setting(site: Site, own: Variation, what: str, value: str, key: str, number: float) -> Ablation:
    """A key of [sensor] that makes it imperfect: at 0 and as asked, or as the scene has it."""
    has = getattr(site.scenario.sensor, key)
    if has:
        nothing = None if key == "range_at_10_percent_m" else 0.0
        ideal = Variation(ABLATION, what, f"{value} left out", partial(_with_sensor, settings={key: nothing}))
        return Ablation(what, f"{has:g}, as the scene has it", ideal, own)
    return Ablation(what, value, own, Variation(ABLATION, what, value, partial(_with_sensor, settings={key: number})))


def _azimuth_offsets(site: Site, own: Variation) -> Ablation:
    offsets = np.degrees(site.model.azimuth_offset_rad)
    if not offsets.any():
        return Ablation("azimuth offsets", "", None, None, f"the {site.model.name} has none")
    level = Variation(ABLATION, "azimuth offsets", "left out", without_offsets)
    return Ablation("azimuth offsets", f"{offsets.min():g} to {offsets.max():g} deg", level, own)


def _experiments(own: Variation) -> list[Ablation]:
    motion = (
        ("recorded speeds", "each sector of a turn against vehicles as they are at its time", _moving),
        ("recorded speeds, boxes of mid-turn", "the same, scored as if nobody knew of it", _moving_unknown),
        (f"all at {FREE_FLOW_M_S:g} m/s", "free flow", _moving_fast),
    )
    return [
        Ablation("float32", "ranges and points", own, Variation(ABLATION, "float32", "", _perfect, scorer=_single)),
        *(
            Ablation("motion in a turn", value, own, Variation(ABLATION, "motion", value, _perfect, 0, scorer), note)
            for value, note, scorer in motion
        ),
    ]


# --- changed sites ----------------------------------------------------------------------------------------------------


def _with_barrier(site: Site, given: tuple[str, float, tuple[float, float]]) -> Site:
    return with_scenery(site, barrier(*given))


def _perfect(site: Site) -> Site:
    """The site as it is; one with an imperfect sensor is refused."""
    check_perfect(site.observation)
    return site


def _with_best_detail(site: Site) -> Site:
    check_perfect(site.observation)
    return replace(site, observation=replace(site.observation, detail=BEST_DETAIL))


def _with_sensor(site: Site, settings: dict[str, float | None]) -> Site:
    """The site with other keys of [sensor]."""
    sensor = replace(site.scenario.sensor, **settings)
    lattice = lattice_of(sensor)
    observation = replace(site.observation, lattice=lattice, imperfections=sensor.imperfections)
    return replace(site, model=lattice.model, observation=observation)


def without_offsets(site: Site) -> Site:
    """The site with a sensor all of whose rings look where their column does."""
    model = replace(site.model, azimuth_offset_rad=np.zeros(site.model.rings))
    lattice = beam_lattice(model, site.observation.lattice.rotation_hz)
    return replace(site, model=model, observation=replace(site.observation, lattice=lattice))


# --- other ways to see a frame ----------------------------------------------------------------------------------------


def _bare(site: Site, frame: CountedFrame) -> Scorer:
    triangles = vehicle_triangles(frame.vehicles, BEST_DETAIL, bare_shape)
    return PlainScorer(frame, site.observation, triangles)


def _single(site: Site, frame: CountedFrame) -> Scorer:
    return SinglePrecisionScorer(frame, site.observation)


def _moving(site: Site, frame: CountedFrame) -> Scorer:
    return MovingScorer(frame, site.observation, recorded_velocity(site.recording, frame.vehicles))


def _moving_unknown(site: Site, frame: CountedFrame) -> Scorer:
    velocity = recorded_velocity(site.recording, frame.vehicles)
    return MovingScorer(frame, site.observation, velocity, boxes_move=False)


def _moving_fast(site: Site, frame: CountedFrame) -> Scorer:
    return MovingScorer(frame, site.observation, velocity_at(frame.vehicles, FREE_FLOW_M_S))
