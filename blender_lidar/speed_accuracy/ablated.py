"""What becomes of each ablation: its effect on score, ranking and optimum, each judged against the noise floor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..study.landscape import Landscape
from ..study.statistics import block_sums
from .ablations import Ablation
from .accuracy import Reference
from .candidates import BASELINE, FIRST, Candidates
from .effects import BIAS, COST, ERROR, OPTIMUM, RANKING, SCORE, Draw, Effect, choices, effects
from .halves import FEWEST_BLOCKS, halvings
from .noise import Noise

ABOVE, BELOW, UNTOLD = "above", "below", "cannot be told"
JUDGED = (SCORE, RANKING, OPTIMUM)
_NUMBERS = (BIAS, SCORE, ERROR, RANKING, COST, OPTIMUM)
_NAMES = {RANKING: "tau", COST: "regret", OPTIMUM: "apart"}


class Sides(NamedTuple):
    """Landscapes of one draw without the thing and with it, on the frames that choose; a text tells why there is none.

    Both have the baseline and the candidates.
    """

    without: Landscape | str
    having: Landscape | str

    @property
    def refused(self) -> str | None:
        """Why there is nothing to compare."""
        return next((one for one in self if isinstance(one, str)), None)


def kept_candidates(sides: Sides, reference: Reference) -> np.ndarray:
    """Candidates that either side would ever choose: all that need be judged, (j,) int."""
    draw, halves = _draw(sides, None, reference), _halves(reference)
    return np.unique(np.concatenate([one.ravel() for one in choices(draw, halves)]))


def ablation_row(
    change: Ablation,
    sides: Sequence[Sides],
    judged: Sequence[Landscape],
    every: Candidates,
    reference: Reference,
    floor: Noise | None,
) -> dict:
    """One ablation as JSON holds it: all but its name is None where there is nothing to compare.

    Parameters
    ----------
    change : Ablation
    sides : sequence of Sides
        Of each draw.
    judged : sequence of Landscape
        Of each draw what has the thing: the baseline and the candidates on the frames that judge, NaN for those that
        need not be judged.
    every : Candidates
    reference : Reference
        Of as many candidates: its blocks are used.
    floor : Noise or None
        Of the same candidates; there are no verdicts without one.
    """
    refused = next((one.refused for one in sides if one.refused), None)
    row = {"what": change.what, "value": change.value, "note": refused or change.note, "draws": len(sides)}
    if refused or not sides:
        return row | dict.fromkeys((*_columns(), "error_share", "shift", "floors", "verdicts"))
    draws = [_draw(*both, reference) for both in zip(sides, judged, strict=True)]
    found = effects(draws, _halves(reference))
    numbers = {}
    for name in _NUMBERS:
        effect = found[name]
        interval = None if effect is None else effect.interval_90
        numbers[_NAMES.get(name, name)] = None if effect is None else effect.value
        numbers[f"{_NAMES.get(name, name)}_interval_90"] = None if interval is None else list(interval)
    numbers["error_share"] = numbers["error"] / reference.gain if reference.gain > 0.0 else None
    shift = np.mean([_shift(draw, every, reference) for draw in draws], axis=0)
    numbers["shift"] = dict(zip(every.variables, shift.tolist(), strict=True))
    floors = None if floor is None else {SCORE: floor.bias, RANKING: floor.tau, OPTIMUM: floor.apart}
    return row | numbers | {"floors": floors, "verdicts": None if floors is None else _verdicts(found, floors)}


def _verdicts(found: Mapping[str, Effect | None], floors: Mapping[str, float | None]) -> dict[str, str]:
    return {name: verdict(found[name], floors[name], less=name == RANKING) for name in JUDGED}


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


def _columns() -> list[str]:
    return [name + ending for name in (_NAMES.get(one, one) for one in _NUMBERS) for ending in ("", "_interval_90")]


def _halves(reference: Reference) -> np.ndarray:
    blocks = int((block_sums(reference.searched.vehicles, reference.searched_block) > 0).sum())
    if blocks < FEWEST_BLOCKS:
        return np.ones((1, 2, blocks), dtype=bool)  # all of them choose
    return halvings(blocks, reference.seed)


def _draw(sides: Sides, judged: Landscape | None, reference: Reference) -> Draw:
    without, having = (one.blocks(reference.searched_block) for one in sides)
    filled = having[1] > 0
    of_judges = None
    if judged is not None:
        objective, vehicles = judged.blocks(reference.judged_block)
        of_judges = objective[:, vehicles > 0]
    return Draw(without[0][FIRST:, filled], having[0][FIRST:, filled], having[1][filled], of_judges)


def _shift(draw: Draw, every: Candidates, reference: Reference) -> np.ndarray:
    """Where the mounting that is chosen moves to when the thing comes in, (d,): mean over the halves."""
    without, having = (
        every.points[one[0]].reshape(-1, every.points.shape[1]) for one in choices(draw, _halves(reference))
    )
    return (having - without).mean(axis=0)


def filled_up(judged: Landscape, kept: Sequence[int], mountings: int) -> Landscape:
    """A landscape of the baseline and the kept candidates as one of all of them, NaN for the others."""
    objective = np.full((mountings, judged.objective.shape[1]), np.nan)
    objective[[BASELINE, *(FIRST + number for number in kept)]] = judged.objective
    return Landscape(objective, judged.vehicles)
