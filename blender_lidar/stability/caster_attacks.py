"""What casters get wrong under attack, counted against the float64 oracle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..casting import CASTERS, caster_class
from ..casting.exact import ExactCaster
from ..casting.protocol import Caster, Hits, origins_of
from ..errors import unknown_name
from .attack_scenes import Attack, unit
from .attacks import ATTACKS, attacks

JUDGED = CASTERS[:-1]  # by the last one, the oracle
TOLERANCE_M = 1e-5  # of a distance: sheets that lie nearer to each other than that count as one
KNIFE_RAD, KNIFE_M = 1e-9, 1e-9  # how far a ray is turned and moved to see whether it runs along a knife's edge
_KNIFE_GATE = 1e-9  # relative
_NEIGHBOURS = 96  # rays beside a ray that are asked


@dataclass(frozen=True, slots=True)
class AttackCount:
    """What came of one attack.

    A difference is a *knife edge* where the oracle itself meets what the caster met, or nothing where the caster met
    nothing, with a ray turned by at most `KNIFE_RAD` and moved by at most `KNIFE_M`, or where the range equals the
    gate to one in a billion. All other differences are failures.

    Attributes
    ----------
    attack : str
        A name of `attacks.ATTACKS`.
    caster : str
        The caster.
    rays : int
        Rays that were cast.
    hits : int
        Those that meet something as the oracle says.
    silent_misses : int
        Of `hits`, those that the caster reports as meeting nothing.
    false_hits : int
        Those that the caster reports as meeting something where there is nothing.
    wrong_distances : int
        Those that both say meet something, at distances that differ by more than `TOLERANCE_M`.
    knife_edges : int
        Differences that are not counted above.
    largest_error_m : float
        Largest difference of distances, knife edges apart [m].
    """

    attack: str
    caster: str
    rays: int
    hits: int
    silent_misses: int
    false_hits: int
    wrong_distances: int
    knife_edges: int
    largest_error_m: float

    @property
    def failures(self) -> int:
        """Silent misses, false hits and wrong distances."""
        return self.silent_misses + self.false_hits + self.wrong_distances


def attack_counts(caster: str, *, quick: bool = True, seed: int = 1) -> list[AttackCount]:
    """Let a caster be attacked in every way that is known, and count what it gets wrong.

    Parameters
    ----------
    caster : str
        A name of `JUDGED`.
    quick : bool
        Fewer rays, for a few seconds in place of a minute.
    seed : int
        Of the rays that are drawn.

    Raises
    ------
    InputError
        For a name that is none of `JUDGED`.
    """
    if caster not in JUDGED:
        raise unknown_name(caster, JUDGED, "caster to be judged by the float64 one")
    return [count_attack(caster, name, quick=quick, seed=seed) for name in ATTACKS]


def count_attack(caster: str, name: str, *, quick: bool = True, seed: int = 1) -> AttackCount:
    """What the caster gets wrong under the attack `name` of `ATTACKS`; see `attack_counts`."""
    total, largest = np.zeros(6, dtype=np.int64), 0.0
    for attack, oracle, truth in _judged(name, quick, seed):
        found = caster_class(caster)(attack.triangles, attack.closed).cast(
            attack.origins, attack.directions, attack.max_range_m
        )
        counts, error = differences(attack, found, truth, oracle)
        total += counts
        largest = max(largest, error)
    return AttackCount(name, caster, *total.tolist(), largest)


@lru_cache(maxsize=len(ATTACKS))  # the verdicts take longer than what they are passed on
def _judged(name: str, quick: bool, seed: int) -> list[tuple[Attack, ExactCaster, Hits]]:
    """Attacks with the oracle of their triangles and its verdict; what two of them share is made once."""
    judged: list[tuple[Attack, ExactCaster, Hits]] = []
    last = oracle = truth = None
    for attack in attacks(name, quick=quick, seed=seed):
        same = last is not None and attack.triangles is last.triangles
        if not same:
            oracle = ExactCaster(attack.triangles)
        rays = ("origins", "directions", "max_range_m")
        if not same or any(getattr(attack, ray) is not getattr(last, ray) for ray in rays):
            truth = oracle.cast(attack.origins, attack.directions, attack.max_range_m)
        judged.append((attack, oracle, truth))
        last = attack
    return judged


def differences(attack: Attack, found: Hits, truth: Hits, oracle: Caster) -> tuple[np.ndarray, float]:
    """The six counts of `AttackCount` for hits that were found, and the largest error [m]."""
    hit, met = np.isfinite(truth.distance), np.isfinite(found.distance)
    error = np.zeros(len(hit))
    both = hit & met
    error[both] = np.abs(found.distance[both] - truth.distance[both])
    different = (hit != met) | (error > TOLERANCE_M)
    knife = np.zeros(len(hit), dtype=bool)
    rows = np.flatnonzero(different)
    knife[rows] = [_is_knife_edge(attack, row, found, truth, oracle) for row in rows]
    wrong = different & ~knife
    counts = [len(hit), hit.sum(), (wrong & ~met).sum(), (wrong & ~hit).sum(), (wrong & both).sum(), knife.sum()]
    return np.array(counts), float(error[~knife].max(initial=0.0))


def _is_knife_edge(attack, row, found, truth, oracle):
    """Whether the oracle says of a ray beside the one in a row what the caster says of it."""
    distance = found.distance[row]
    nearest = min(distance, truth.distance[row])
    if abs(nearest - attack.max_range_m) <= _KNIFE_GATE * nearest:
        return True
    rng = np.random.default_rng(0)
    reach = 10.0 ** rng.uniform(-4.0, 0.0, (_NEIGHBOURS, 1))  # near ones and far ones
    turned = attack.directions[row] + KNIFE_RAD * reach * unit(rng.normal(size=(_NEIGHBOURS, 3)))
    moved = origins_of(attack.origins, np.array([row])) + KNIFE_M * reach * unit(rng.normal(size=(_NEIGHBOURS, 3)))
    near = oracle.cast(moved, unit(turned), attack.max_range_m)
    if np.isinf(distance):
        return bool(np.isinf(near.distance).any())
    there = near.distance[near.triangle == found.triangle[row]]  # grazing rays meet a triangle over some way
    within = bool(len(there)) and there.min() - TOLERANCE_M <= distance <= there.max() + TOLERANCE_M
    return within or bool((np.abs(near.distance - distance) <= TOLERANCE_M).any())
