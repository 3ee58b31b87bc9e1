"""The attacks on casters, by name: rays where triangles meet, where they end, and where numbers do."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from .attack_scenes import Attack
from .attacks_by_place import BY_PLACE
from .attacks_on_triangles import ON_TRIANGLES

ATTACKS: dict[str, Callable[[np.random.Generator, bool], Iterator[Attack]]] = {
    attack.__name__.replace("_", " "): attack for attack in (*ON_TRIANGLES, *BY_PLACE)
}


def attacks(name: str, *, quick: bool = True, seed: int = 1) -> Iterator[Attack]:
    """The attacks of a name of `ATTACKS`; the same ones for the same seed. Quick ones are smaller, not other ones."""
    yield from ATTACKS[name](np.random.default_rng([seed, list(ATTACKS).index(name)]), quick)
