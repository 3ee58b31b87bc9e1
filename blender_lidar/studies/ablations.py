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
from .driver import HELD_OUT, Job, Landscape, StudyFolder, Variation, judging_split
from .effects import BASELINE_ROW, FIRST, AblationDraw, Candidates, Effect, Reference, choices, effects
from .experiments import FREE_FLOW_M_S, bare, grounded, moving, single
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
    own = variation(Fidelity(site.scenario.world.detail))
    box, body, detailed = (variation(Fidelity(level)) for level in DETAILS)

    def added(what: str, value: str, side: str, **change) -> Ablation:
        return Ablation(what, value, ((own, Variation(ABLATION, what, side, **change)),))

    right, left = site.scenario.road.carriageway_y
    x, y = site.region.centre_xy
    beside = y + _MEDIAN_CLEARANCE * (right - y) if y < right else left + _MEDIAN_CLEARANCE * (y - left)
    middle = right + (left - right) / site.scenario.road.lanes * (site.scenario.road.lanes // 2)
    rail, concrete = (
        partial(_with_barrier, given=(kind, at, (x - site.reach_m, x + site.reach_m)))
        for kind, at in (("guard_rail", beside), ("concrete", middle))
    )
    at_once, speed = "recorded speeds, boxes of mid-turn", f"all at {FREE_FLOW_M_S:g} m/s"
    wheelless = Variation(ABLATION, "wheels and mirrors", "left out", scorer=bare)
    return [
        added("ground", "two large triangles cast too", "cast too", scorer=grounded),
        added("guard rail", f"between pole and road, y {beside:g} m", "there", changed=rail),
        added("median barrier", f"on the middle lane line, y {middle:g} m", "there", changed=concrete),
        Ablation("body shape", "body, not box", ((box, body),)),
        Ablation("finer shape", "detailed, not body", ((body, detailed),)),
        Ablation("wheels and mirrors", "detailed with, not without them", ((wheelless, detailed),)),
        _azimuth_offsets(site, own),
        *_imperfections(site, own, draws),
        added("float32", "ranges and points", "", scorer=single),
        added("motion in a turn", "recorded speeds", "recorded speeds", scorer=moving),
        added("motion in a turn", at_once, at_once, scorer=partial(moving, boxes_move=False)),
        added("motion in a turn", speed, speed, scorer=partial(moving, fast=True)),
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

    def side(name: str, value: str, draw: int, **settings) -> Variation:
        seeds = {"noise_seed": draw, "unit": draw} if draw else {}
        return Variation(ABLATION, name, value, partial(with_sensor, settings=seeds | settings), draw)

    for what, value, key, number in asked:
        has, pairs = getattr(sensor, key), []
        for draw in range(1, draws + 1) if key != _WEAK else (0,):
            as_it_is = side("as drawn", "", draw) if draw and at_random else own
            if has:
                nothing = side(what, f"{value} left out", draw, **{key: None if key == _WEAK else 0.0})
                pairs.append((nothing, as_it_is))
            else:
                pairs.append((as_it_is, side(what, value, draw, **{key: number})))
        found.append(Ablation(what, f"{has:g}, as the scene has it" if has else value, tuple(pairs)))
    return found


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
    standing = observation.scenery or StandingScenery(join([]), observation.caster)
    return replace(site, observation=replace(observation, scenery=standing.beside(more)))


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
    """

    site: Site
    every: Candidates
    reference: Reference


def ablation_rows(
    folder: StudyFolder, on: Compared, changes: Sequence[Ablation], known: Mapping[str, Landscape], what: str = ""
) -> list[dict]:
    """A row for every ablation; what either side would choose is judged where the scene has the thing.

    Parameters
    ----------
    folder : StudyFolder
    on : Compared
    changes : sequence of Ablation
    known : mapping of str to Landscape
        By a variation's stage, what has been scored already.
    what : str
        Tells the stages of another site from the scene's own.
    """

    def job(one: Variation, poses=on.every.poses, **split) -> Job:
        return Job(replace(one, section=f"{what} {one.section}".strip()), poses, **split)

    told, halves = f"{what and ', '}{what}", on.reference.halves
    missing = {one.stage: one for change in changes for pair in change.pairs for one in pair if one.stage not in known}
    found = folder.landscapes(on.site, [job(one) for one in missing.values()], f"ablations scored{told}")
    scored = {**known, **dict(zip(missing, found, strict=True))}
    refused, draws = {}, []
    for change in changes:
        sides = [[scored[one.stage] for one in pair] for pair in change.pairs]
        refused[change] = next((side for pair in sides for side in pair if isinstance(side, str)), None)
        if refused[change] is None:
            draws += [(change, pair, draw_of(*both, on)) for pair, both in zip(change.pairs, sides, strict=True)]
    if judging_split(on.site) == HELD_OUT:
        kept = [_ever_chosen(draw, halves) for _, _, draw in draws]
        jobs = [
            job(
                replace(there, section="judged", what=of.what, value=of.value, draw=without.draw or there.draw),
                tuple(on.every.poses[row] for row in rows),
                split=HELD_OUT,
            )
            for (of, (without, there), _), rows in zip(draws, kept, strict=True)
        ]
        judges = zip(folder.landscapes(on.site, jobs, f"ablations judged{told}"), kept, strict=True)
    else:
        judges = ((scored[there.stage], slice(None)) for _, (_, there), _ in draws)
    judged = [(of, with_judges(draw, *by, on)) for (of, _, draw), by in zip(draws, judges, strict=True)]
    return [ablation_row(one, refused[one], [draw for of, draw in judged if of is one], on) for one in changes]


def draw_of(without: Landscape, having: Landscape, on: Compared) -> AblationDraw:
    """One draw of a thing from what the baseline and the candidates come to without it and with it; not yet judged."""
    (less, _), (more, vehicles) = (one.blocks(on.reference.searched_block) for one in (without, having))
    filled = vehicles > 0
    return AblationDraw(less[FIRST:, filled], more[FIRST:, filled], vehicles[filled], np.empty((len(less), 0)))


def _ever_chosen(draw: AblationDraw, halves: np.ndarray) -> list[int]:
    """Rows of the baseline and of the candidates that either side would ever choose: all that need be judged."""
    return [BASELINE_ROW, *(FIRST + np.unique(choices(draw, halves))).tolist()]


def with_judges(draw: AblationDraw, judged: Landscape, rows: Sequence[int] | slice, on: Compared) -> AblationDraw:
    """The draw with what some rows come to where the scene has the thing, on the frames that judge; NaN for others."""
    objective, vehicles = judged.blocks(on.reference.judged_block)
    every = np.full((len(on.every.poses), len(vehicles)), np.nan)
    every[rows] = objective
    return replace(draw, judged=every[:, vehicles > 0])


# --- the row of an ablation -------------------------------------------------------------------------------------------

ABOVE, BELOW, UNTOLD = "above", "below", "cannot be told"
JUDGED = {"score": "score", "ranking": "tau", "optimum": "apart"}  # what has a verdict, and which effect it is on
_EFFECTS = ("bias", "score", "error", "tau", "regret", "apart")


def ablation_row(change: Ablation, refused: str | None, draws: Sequence[AblationDraw], on: Compared) -> dict:
    """One ablation as JSON holds it: all but its name is None where there is nothing to compare."""
    columns = [name + ending for name in _EFFECTS for ending in ("", "_interval_90")]
    row = {"what": change.what, "value": change.value, "note": refused or change.note, "draws": len(change.pairs)}
    row |= dict.fromkeys((*columns, "error_share", "shift", "floors", "verdicts"))
    if not draws:
        return row
    gain, floor = on.reference.gain, on.reference.noise
    found = effects(draws, on.reference.halves)
    for name in _EFFECTS:
        row[name], row[f"{name}_interval_90"] = found[name] or (None, None)
    row["error_share"] = row["error"] / gain if gain > 0.0 else None
    shift = np.mean([_shift(draw, on) for draw in draws], axis=0)
    row["shift"] = dict(zip(on.every.variables, shift.tolist(), strict=True))
    if floor is not None:
        row["floors"] = {"score": floor.bias, "ranking": floor.tau, "optimum": floor.apart}
        row["verdicts"] = {
            name: beside_floor(found[effect], row["floors"][name], less=effect == "tau")
            for name, effect in JUDGED.items()
        }
    return row


def beside_floor(effect: Effect | None, floor: float | None, *, less: bool = False) -> str:
    """Whether an effect lies beyond the floor by its whole interval, or within it, or neither can be told.

    `less` : the less, the greater the effect is: a tau.
    """
    if effect is None or floor is None or effect.interval_90 is None:
        return UNTOLD
    low, high = effect.interval_90
    if less:
        low, high, floor = -high, -low, -floor
    return ABOVE if low > floor else BELOW if high <= floor else UNTOLD


def _shift(draw: AblationDraw, on: Compared) -> np.ndarray:
    """Where the mounting that is chosen moves to when the thing comes in, (d,): mean over the halves."""
    without, having = (on.every.points[one[0]] for one in choices(draw, on.reference.halves))
    return (having - without).mean(axis=(0, 1))
