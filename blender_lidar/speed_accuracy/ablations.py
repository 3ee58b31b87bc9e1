"""What a model of the scene may have or leave out, one thing at a time: ground, barriers, wheels, glass, noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..study.fidelity import Fidelity
from ..study.site import Site
from ..study.variation import Variation
from ..world.shapes import DETAILS
from . import changes
from .ladder import variation

ABLATION, OFFSETS = "ablation", "azimuth offsets"
DROPOUT, SPREAD_DEG, GLASS = 0.05, 0.03, 0.3  # of glass as much as real cars agree with: see `compare --paired`
WEAK_RETURNS_M = 50.0  # to which a target of 10 % is seen, where the sensor's table does not say
_WEAK = "range_at_10_percent_m"  # the one imperfection of [sensor] in which nothing is drawn
_MEDIAN_CLEARANCE = 0.5  # of a setback: where a barrier stands between pole and road


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
    own = variation(Fidelity(site.scenario.model.detail))
    return [*_surroundings(site, own), *_shapes(), *_sensor(site, own, draws), *_experiments(own)]


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
    found = [Ablation("ground", "two large triangles cast too", ((own, ground),))]
    for what, text, given in standing:
        there = Variation(ABLATION, what, "there", partial(changes.with_barrier, given=given))
        found.append(Ablation(what, text, ((own, there),)))
    return found


def _shapes() -> list[Ablation]:
    levels = {detail: variation(Fidelity(detail)) for detail in DETAILS}
    bare = Variation(ABLATION, "wheels and mirrors", "left out", changes.with_best_detail, scorer=changes.bare)
    return [
        Ablation("body shape", "body, not box", ((levels["box"], levels["body"]),)),
        Ablation("finer shape", "detailed, not body", ((levels["body"], levels["detailed"]),)),
        Ablation("wheels and mirrors", "detailed with, not without them", ((bare, levels["detailed"]),)),
    ]


def _sensor(site: Site, own: Variation, draws: int) -> list[Ablation]:
    noise_m, weak_m = site.model.range_noise_m, site.model.range_at_10_percent_m or WEAK_RETURNS_M
    asked = (
        ("glass drop-out", f"{100 * GLASS:g} % of its returns", "glass_dropout", GLASS),
        ("range noise", f"{noise_m:g} m", "range_noise_m", noise_m),
        ("drop-out", f"{100 * DROPOUT:g} % of all returns", "dropout", DROPOUT),
        ("weak returns", f"10 % target seen to {weak_m:g} m", _WEAK, weak_m),
        ("unit spread", f"{SPREAD_DEG:g} deg", "unit_spread_deg", SPREAD_DEG),
    )
    return [_azimuth_offsets(site, own), *(_setting(site, own, draws, *one) for one in asked)]


def _setting(site: Site, own: Variation, draws: int, what: str, value: str, key: str, number: float) -> Ablation:
    """A key of [sensor] that makes it imperfect: at 0 and as asked, or as the scene has it."""
    sensor = site.scenario.sensor
    has, nothing = getattr(sensor, key), None if key == _WEAK else 0.0
    drawn = range(1, draws + 1) if key != _WEAK else [0]
    at_random = sensor.range_noise_m or sensor.dropout or sensor.glass_dropout or sensor.unit_spread_deg
    pairs = []
    for draw in drawn:
        seeds = {"noise_seed": draw, "unit": draw} if draw else {}
        as_it_is = _with_sensor("as drawn", "", seeds, draw) if draw and at_random else own
        if has:
            pairs.append((_with_sensor(what, f"{value} left out", seeds | {key: nothing}, draw), as_it_is))
        else:
            pairs.append((as_it_is, _with_sensor(what, value, seeds | {key: number}, draw)))
    return Ablation(what, f"{has:g}, as the scene has it" if has else value, tuple(pairs))


def _with_sensor(what: str, value: str, settings: dict[str, float | None], draw: int) -> Variation:
    return Variation(ABLATION, what, value, partial(changes.with_sensor, settings=settings), draw)


def _azimuth_offsets(site: Site, own: Variation) -> Ablation:
    offsets = np.degrees(site.model.azimuth_offset_rad)
    if not offsets.any():
        return Ablation(OFFSETS, "", (), f"the beam table of the {site.model.name} has none")
    level = Variation(ABLATION, OFFSETS, "left out", changes.without_offsets)
    return Ablation(OFFSETS, f"{offsets.min():g} to {offsets.max():g} deg", ((level, own),))


def _experiments(own: Variation) -> list[Ablation]:
    motion = (
        ("recorded speeds", changes.moving),
        ("recorded speeds, boxes of mid-turn", changes.moving_unknown),
        (f"all at {changes.FREE_FLOW_M_S:g} m/s", changes.moving_fast),
    )
    single = Variation(ABLATION, "float32", "", changes.perfect, scorer=changes.single)
    found = [Ablation("float32", "ranges and points", ((own, single),))]
    for value, scorer in motion:
        moving = Variation(ABLATION, "motion", value, changes.perfect, scorer=scorer)
        found.append(Ablation("motion in a turn", value, ((own, moving),)))
    return found
