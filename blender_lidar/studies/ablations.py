"""Ablations: what a model of the scene may have or leave out, one thing at a time, and what each changes.

Ground, barriers, shapes, wheels, glass, noise, float32, motion: the scene without it and with it, on the same
mountings. Effects on score, ranking and optimum are each judged against the noise floor of the traffic itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from ..casting.protocol import StandingScenery
from ..scene.site import Site
from ..scoring.fidelity import Fidelity
from ..sensors.beams import beam_lattice
from ..world.scenery import barrier, join
from ..world.shapes import DETAILS
from .driver import HELD_OUT, Job, Landscape, Stages, Variation, judging_split
from .effects import (
    BASELINE,
    BIAS,
    COST,
    ERROR,
    FEWEST_HALVED,
    FIRST,
    OPTIMUM,
    RANKING,
    SCORE,
    Candidates,
    Draw,
    Effect,
    Noise,
    Reference,
    choices,
    effects,
    halvings,
    noise_ceiling,
)
from .experiments import FREE_FLOW_M_S, bare, check_perfect, moving, single
from .ladder import variation
from .variations import with_sensor

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
    detail = site.scenario.world.detail
    own, levels = variation(Fidelity(detail)), {level: variation(Fidelity(level)) for level in DETAILS}
    ground = replace(variation(Fidelity(detail, ground=True), ABLATION), what="ground", value="cast too")
    wheelless = Variation(ABLATION, "wheels and mirrors", "left out", _with_best_detail, scorer=bare)
    found = [
        Ablation("ground", "two large triangles cast too", ((own, ground),)),
        *_barriers(site, own),
        Ablation("body shape", "body, not box", ((levels["box"], levels["body"]),)),
        Ablation("finer shape", "detailed, not body", ((levels["body"], levels["detailed"]),)),
        Ablation("wheels and mirrors", "detailed with, not without them", ((wheelless, levels["detailed"]),)),
        _azimuth_offsets(site, own),
        *_imperfections(site, own, draws),
        Ablation("float32", "ranges and points", ((own, Variation(ABLATION, "float32", "", _perfect, scorer=single)),)),
    ]
    motion = (
        ("recorded speeds", moving),
        ("recorded speeds, boxes of mid-turn", partial(moving, boxes_move=False)),
        (f"all at {FREE_FLOW_M_S:g} m/s", partial(moving, fast=True)),
    )
    for value, scorer in motion:
        moved = Variation(ABLATION, "motion", value, _perfect, scorer=scorer)
        found.append(Ablation("motion in a turn", value, ((own, moved),)))
    return found


def _barriers(site: Site, own: Variation) -> list[Ablation]:
    right, left = site.scenario.road.carriageway_y
    x, y = site.region.centre_xy
    beside = y + _MEDIAN_CLEARANCE * (right - y) if y < right else left + _MEDIAN_CLEARANCE * (y - left)
    middle = right + (left - right) / site.scenario.road.lanes * (site.scenario.road.lanes // 2)
    standing = (
        ("guard rail", f"between pole and road, y {beside:g} m", "guard_rail", beside),
        ("median barrier", f"on the middle lane line, y {middle:g} m", "concrete", middle),
    )
    ends = (x - site.reach_m, x + site.reach_m)
    return [
        Ablation(
            what, text, ((own, Variation(ABLATION, what, "there", partial(_with_barrier, given=(kind, y, ends)))),)
        )
        for what, text, kind, y in standing
    ]


def _imperfections(site: Site, own: Variation, draws: int) -> list[Ablation]:
    """Keys of [sensor] that make it imperfect: at 0 and as asked, or as the scene has it."""
    noise_m, weak_m = site.model.range_noise_m, site.model.range_at_10_percent_m or WEAK_RETURNS_M
    asked = (
        ("glass drop-out", f"{100 * GLASS:g} % of its returns", "glass_dropout", GLASS),
        ("range noise", f"{noise_m:g} m", "range_noise_m", noise_m),
        ("drop-out", f"{100 * DROPOUT:g} % of all returns", "dropout", DROPOUT),
        ("weak returns", f"10 % target seen to {weak_m:g} m", _WEAK, weak_m),
        ("unit spread", f"{SPREAD_DEG:g} deg", "unit_spread_deg", SPREAD_DEG),
    )
    sensor, found = site.scenario.sensor, []
    at_random = sensor.range_noise_m or sensor.dropout or sensor.glass_dropout or sensor.unit_spread_deg
    for what, value, key, number in asked:
        has, nothing, pairs = getattr(sensor, key), None if key == _WEAK else 0.0, []
        for draw in range(1, draws + 1) if key != _WEAK else [0]:
            seeds = {"noise_seed": draw, "unit": draw} if draw else {}
            as_it_is = _sensor("as drawn", "", seeds, draw) if draw and at_random else own
            if has:
                pairs.append((_sensor(what, f"{value} left out", seeds | {key: nothing}, draw), as_it_is))
            else:
                pairs.append((as_it_is, _sensor(what, value, seeds | {key: number}, draw)))
        found.append(Ablation(what, f"{has:g}, as the scene has it" if has else value, tuple(pairs)))
    return found


def _sensor(what: str, value: str, settings: dict[str, float | None], draw: int) -> Variation:
    return Variation(ABLATION, what, value, partial(with_sensor, settings=settings), draw)


def _azimuth_offsets(site: Site, own: Variation) -> Ablation:
    offsets = np.degrees(site.model.azimuth_offset_rad)
    if not offsets.any():
        return Ablation(OFFSETS, "", (), f"the beam table of the {site.model.name} has none")
    level = Variation(ABLATION, OFFSETS, "left out", without_offsets)
    return Ablation(OFFSETS, f"{offsets.min():g} to {offsets.max():g} deg", ((level, own),))


# --- changed sites; all can be sent to another process ----------------------------------------------------------------


def _with_barrier(site: Site, given: tuple[str, float, tuple[float, float]]) -> Site:
    """The site with a barrier besides what stands there: its kind, its y and between which x [m]."""
    observation, more = site.observation, barrier(*given)
    standing = () if observation.scenery is None else (observation.scenery.scenery,)
    scenery = StandingScenery(join([*standing, more]), observation.caster)
    return replace(site, observation=replace(observation, scenery=scenery))


def _perfect(site: Site) -> Site:
    """The site as it is; one with an imperfect sensor is refused."""
    check_perfect(site.observation)
    return site


def _with_best_detail(site: Site) -> Site:
    """The site with vehicles at the best level of detail; one with an imperfect sensor is refused."""
    return replace(site, observation=replace(_perfect(site).observation, detail=DETAILS[-1]))


def without_offsets(site: Site) -> Site:
    """The site with a sensor all of whose rings look where their column does."""
    model = replace(site.model, azimuth_offset_rad=np.zeros(site.model.rings))
    lattice = beam_lattice(model, site.observation.lattice.rotation_hz)
    return replace(site, model=model, observation=replace(site.observation, lattice=lattice))


# --- every ablation scored and judged, stage by stage -----------------------------------------------------------------


class Compared(NamedTuple):
    """What ablations of a site are compared on.

    Attributes
    ----------
    site : Site
    every : Candidates
    reference : Reference
        Of these candidates.
    floor : Noise or None
        Of the same; there are no verdicts without one.
    halves : ndarray of bool, (s, 2, b)
        Halves of the blocks that choose; with too few blocks all of them choose.
    """

    site: Site
    every: Candidates
    reference: Reference
    floor: Noise | None
    halves: np.ndarray


def compared(site: Site, every: Candidates, reference: Reference) -> Compared:
    """With its floor and halves."""
    blocks = int((reference.searched.blocks(reference.searched_block)[1] > 0).sum())
    halves = halvings(blocks, reference.seed) if blocks >= FEWEST_HALVED else np.ones((1, 2, blocks), dtype=bool)
    return Compared(site, every, reference, noise_ceiling(reference), halves)


def ablation_rows(
    stages: Stages, on: Compared, changes: Sequence[Ablation], known: Mapping[str, Landscape], what: str = ""
) -> list[dict]:
    """A row for every ablation; what either side would choose is judged where the scene has the thing.

    Parameters
    ----------
    stages : Stages
    on : Compared
    changes : sequence of Ablation
    known : mapping of str to Landscape
        By a variation's stage, what has been scored already.
    what : str
        Tells the stages of another site from the scene's own.
    """

    def job(one: Variation, poses=on.every.poses, **split) -> Job:
        return Job(replace(one, section=f"{what} {one.section}".strip()), poses, **split)

    told = f"{what and ', '}{what}"
    needed = {one.stage: one for change in changes for pair in change.pairs for one in pair}
    missing = [one for stage, one in needed.items() if stage not in known]
    found = stages.landscapes(on.site, list(map(job, missing)), f"ablations scored{told}")
    scored = {**known, **dict(zip((one.stage for one in missing), found, strict=True))}
    sides = [[[scored[one.stage] for one in pair] for pair in change.pairs] for change in changes]
    refused = [next((one for pair in of for one in pair if isinstance(one, str)), None) for of in sides]
    draws = [[] if why else [draw_of(*pair, on) for pair in of] for why, of in zip(refused, sides, strict=True)]
    if judging_split(on.site) == HELD_OUT:
        kept = [[_kept(draw, on.halves) for draw in of] for of in draws]
        jobs = [
            job(
                replace(pair[1], section="judged", what=one.what, value=one.value, draw=pair[0].draw or pair[1].draw),
                tuple(on.every.poses[row] for row in rows),
                split=HELD_OUT,
            )
            for one, of in zip(changes, kept, strict=True)
            for pair, rows in zip(one.pairs, of, strict=bool(of))
        ]
        judged = iter(stages.landscapes(on.site, jobs, f"ablations judged{told}"))
        judges = [[(next(judged), rows) for rows in of] for of in kept]
    else:
        judges = [[(pair[1], slice(None)) for pair in of] for of in sides]
    return [
        ablation_row(change, why, [_with_judges(*one, on) for one in zip(of, seen, strict=bool(of))], on)
        for change, why, of, seen in zip(changes, refused, draws, judges, strict=True)
    ]


def draw_of(without: Landscape, having: Landscape, on: Compared) -> Draw:
    """One draw of a thing from what the baseline and the candidates come to without it and with it; not yet judged."""
    (less, _), (more, vehicles) = (one.blocks(on.reference.searched_block) for one in (without, having))
    filled = vehicles > 0
    return Draw(less[FIRST:, filled], more[FIRST:, filled], vehicles[filled], None)


def _kept(draw: Draw, halves: np.ndarray) -> list[int]:
    """Rows of the baseline and of the candidates that either side would ever choose: all that need be judged."""
    chosen = np.unique(np.concatenate([one.ravel() for one in choices(draw, halves)]))
    return [BASELINE, *(FIRST + chosen).tolist()]


def _with_judges(draw: Draw, judged: tuple[Landscape, Sequence[int] | slice], on: Compared) -> Draw:
    """The draw with what some rows come to where the scene has the thing, on the frames that judge; NaN for others."""
    landscape, rows = judged
    objective, vehicles = landscape.blocks(on.reference.judged_block)
    every = np.full((len(on.every.poses), len(vehicles)), np.nan)
    every[rows] = objective
    return replace(draw, judged=every[:, vehicles > 0])


# --- the row of an ablation -------------------------------------------------------------------------------------------

ABOVE, BELOW, UNTOLD = "above", "below", "cannot be told"
JUDGED = (SCORE, RANKING, OPTIMUM)
_COLUMNS = {BIAS: "bias", SCORE: "score", ERROR: "error", RANKING: "tau", COST: "regret", OPTIMUM: "apart"}


def ablation_row(change: Ablation, refused: str | None, draws: Sequence[Draw], on: Compared) -> dict:
    """One ablation as JSON holds it: all but its name is None where there is nothing to compare."""
    row = {"what": change.what, "value": change.value, "note": refused or change.note, "draws": len(change.pairs)}
    if not draws:
        columns = [name + ending for name in _COLUMNS.values() for ending in ("", "_interval_90")]
        return row | dict.fromkeys((*columns, "error_share", "shift", "floors", "verdicts"))
    found, numbers = effects(draws, on.halves), {}
    for name, column in _COLUMNS.items():
        value, interval = found[name] or (None, None)
        numbers[column] = value
        numbers[f"{column}_interval_90"] = None if interval is None else list(interval)
    gain, floor = on.reference.gain, on.floor
    numbers["error_share"] = numbers["error"] / gain if gain > 0.0 else None
    shift = np.mean([_shift(draw, on) for draw in draws], axis=0)
    numbers["shift"] = dict(zip(on.every.variables, shift.tolist(), strict=True))
    floors = None if floor is None else {SCORE: floor.bias, RANKING: floor.tau, OPTIMUM: floor.apart}
    verdicts = floors and {name: verdict(found[name], floors[name], less=name == RANKING) for name in JUDGED}
    return row | numbers | {"floors": floors, "verdicts": verdicts}


def verdict(effect: Effect | None, floor: float | None, *, less: bool = False) -> str:
    """Whether an effect lies beyond the floor by its whole interval, or within it, or neither can be told.

    `less` : the less, the greater the effect is: a tau.
    """
    if effect is None or floor is None or effect.interval_90 is None:
        return UNTOLD
    low, high = effect.interval_90
    if less:
        low, high, floor = -high, -low, -floor
    return ABOVE if low > floor else BELOW if high <= floor else UNTOLD


def _shift(draw: Draw, on: Compared) -> np.ndarray:
    """Where the mounting that is chosen moves to when the thing comes in, (d,): mean over the halves."""
    without, having = (on.every.points[one[0]].reshape(-1, len(on.every.variables)) for one in choices(draw, on.halves))
    return (having - without).mean(axis=0)
