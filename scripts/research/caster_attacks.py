"""What casters get wrong under attack, counted against the float64 oracle: a line for each of 17 attacks.

    python scripts/research/caster_attacks.py [--quick] [--seed 1]

Stable: every caster meets what the oracle meets, except for knife edges; fragile: at wrong distances; fails: a caster
misses without a word what the oracle meets, or meets what is not there. Exit code 1 where any fails.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from attack_scenes import ATTACKS, Attack, attacks, unit
from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.casting.exact import ExactCaster
from blender_lidar.casting.protocol import Caster, Hits, origins_of
from blender_lidar.errors import unknown_name

STABLE, FRAGILE, FAILS = "stable", "fragile", "fails"
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
        A name of `ATTACKS`.
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


def count_attack(caster: str, name: str, *, quick: bool = True, seed: int = 1) -> AttackCount:
    """What a caster gets wrong under the attack `name` of `ATTACKS`; quick ones have fewer rays.

    Raises
    ------
    InputError
        For a caster that is none of `JUDGED`.
    """
    if caster not in JUDGED:
        raise unknown_name(caster, JUDGED, "caster to be judged by the float64 one")
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


# --- the table --------------------------------------------------------------------------------------------------------


def verdict(counts: Sequence[AttackCount]) -> str:
    """Whether casters meet under one attack what the oracle meets, from a count of each; knife edges are no failure."""
    if any(count.silent_misses or count.false_hits for count in counts):
        return FAILS
    return FRAGILE if any(count.wrong_distances for count in counts) else STABLE


def line(counts: Sequence[AttackCount]) -> str:
    """What came of one attack in words, from a count of each caster."""
    lines = []
    for count in counts:
        kinds = ("silent_misses", "false_hits", "wrong_distances")
        differ = [f"{getattr(count, kind):,} {kind.replace('_', ' ')}" for kind in kinds if getattr(count, kind)]
        differ += [f"{count.knife_edges:,} on a knife edge"] if count.knife_edges else []
        lines.append(f"{count.caster} {', '.join(differ) or 'the same'}")
    return f"{counts[0].rays:,} rays, {counts[0].hits:,} hit; {'; '.join(lines)}"


def main(argv: list[str] | None = None) -> int:
    """Print a line for each attack; 1 if any caster fails under one."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer rays: seconds in place of minutes")
    parser.add_argument("--seed", type=int, default=1, help="of the rays that are drawn")
    args = parser.parse_args(argv)
    casters = [caster for caster in JUDGED if is_available(caster)]
    if not casters:
        print("caster_attacks: no caster is installed but the oracle itself", file=sys.stderr)
        return 2
    failed = False
    print("Casters, against the float64 oracle")
    for name in ATTACKS:
        counts = [count_attack(caster, name, quick=args.quick, seed=args.seed) for caster in casters]
        failed |= verdict(counts) == FAILS
        print(f"  {verdict(counts):<10}{name:<{max(map(len, ATTACKS)) + 2}}{line(counts)}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
