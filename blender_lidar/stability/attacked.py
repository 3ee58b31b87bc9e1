"""Findings on casters under attack: rays at what leaks, counted against the float64 oracle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from .caster_attacks import AttackCount
from .findings import FAILS, FRAGILE, STABLE, Finding, worst
from .variations import CASTERS


def attack_finding(counts: Sequence[AttackCount]) -> Finding:
    """Whether casters meet under one attack what the oracle meets, from a count of each; knife edges are no failure."""
    first = counts[0]
    told = "; ".join(f"{count.caster} {_text(count)}" for count in counts)
    return Finding(
        CASTERS,
        first.attack,
        "",
        worst([_verdict(count) for count in counts]),
        f"{first.rays:,} rays, {first.hits:,} hit; {told}",
        {count.caster: asdict(count) for count in counts},
    )


def _verdict(count: AttackCount) -> str:
    if count.silent_misses or count.false_hits:
        return FAILS
    return FRAGILE if count.wrong_distances else STABLE


def _text(count: AttackCount) -> str:
    kinds = {
        "silent misses": count.silent_misses,
        "false hits": count.false_hits,
        "wrong distances": count.wrong_distances,
        "on a knife edge": count.knife_edges,
    }
    return ", ".join(f"{number:,} {kind}" for kind, number in kinds.items() if number) or "the same"
