"""The ways in which a sweep is simulated: levels of detail of the shapes, and what the sensor loses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

from ..sensors.imperfections import PERFECT, Imperfections

LOSSES = {
    "none": "no loss",
    "glass": "glass",
    "any": "drop-out",
    "both": "glass, drop-out",
    "weak": "weak returns",
    "all": "all of these",
}
DRAWN = "weak"
WITHOUT_GLASS = ("box",)  # levels of detail

MEASURED = Imperfections(0.02, 0.05, glass_dropout=0.3, range_at_10_percent_m=50.0)
"""What an HDL-64E loses of cars: noise and the range to which a 10 % target is seen are the model's own; the shares are
what is lost besides, by the tuned frames of KITTI. On those 35 to 50 m do about as well."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way to simulate.

    Attributes
    ----------
    detail : str
        Level of detail of `world.shapes.DETAILS`.
    losses : str
        A key of `LOSSES`: nothing; returns from glass by chance; any returns by chance, and noisy ranges; both; returns
        that are too weak; all of these.
    imperfections : Imperfections
    """

    detail: str
    losses: str
    imperfections: Imperfections


def variants(details: Sequence[str], lossy: Imperfections = MEASURED) -> tuple[Variant, ...]:
    """Every level of detail, without and with each of the losses of `lossy`; a box has no glass to lose by."""
    limit, seed = lossy.range_at_10_percent_m, lossy.seed
    ways = {
        "none": PERFECT,
        "glass": Imperfections(glass_dropout=lossy.glass_dropout, seed=seed),
        "any": Imperfections(lossy.range_noise_m, lossy.dropout, seed=seed),
        "both": Imperfections(lossy.range_noise_m, lossy.dropout, glass_dropout=lossy.glass_dropout, seed=seed),
        "weak": Imperfections(range_at_10_percent_m=limit, seed=seed),
        "all": lossy,
    }
    return tuple(
        Variant(detail, losses, ways[losses])
        for detail, losses in product(details, ways)
        if detail not in WITHOUT_GLASS or losses not in ("glass", "both")
    )
