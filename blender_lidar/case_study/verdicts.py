"""A claim of the paper's with our finding, and how intervals and probabilities become a verdict on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

LIKELY, UNLIKELY = 0.9, 0.1  # probabilities from and up to which an order is taken as shown or as refuted
REPRODUCED, IN_PART, REFUTED = "reproduced", "reproduced in part", "not reproduced"
UNDECIDED, TIED, NO_LOSS = "undecided", "not shown: ties", "no loss here"


class Claim(NamedTuple):
    """One claim of the paper's.

    Attributes
    ----------
    text : str
        What the paper says, and where.
    ours : str
        What we find.
    verdict : str
    """

    text: str
    ours: str
    verdict: str


def sign(interval: Sequence[float] | None) -> int | None:
    """1 or -1 where an interval lies above or below 0, 0 where it holds 0; None without an interval."""
    if interval is None:
        return None
    return int(interval[0] > 0.0) - int(interval[1] < 0.0)


def with_interval(found: Mapping, digits: int = 3, scale: float = 1.0) -> str:
    """A mean and its interval as text."""
    mean = f"{scale * found['mean']:+.{digits}f}"
    if found["interval_90"] is None:
        return f"{mean} (too few blocks for an interval)"
    low, high = (scale * end for end in found["interval_90"])
    return f"{mean} ({low:+.{digits}f} to {high:+.{digits}f})"


def low_to_high(pair: Sequence[float] | None, digits: int) -> str:
    """A range as text; one number where both ends look the same."""
    if pair is None:
        return "too few blocks"
    low, high = (f"{end:.{digits}f}" for end in pair)
    return low if low == high else f"{low} to {high}"


def by_probability(strict: float, with_ties: float) -> str:
    """Of an order, from how often it holds strictly and with ties."""
    if strict >= LIKELY:
        return REPRODUCED
    if with_ties <= UNLIKELY:
        return REFUTED
    return TIED if with_ties - strict >= LIKELY else UNDECIDED


def by_signs(signs: Sequence[int | None]) -> str:
    """All above 0, some, none; undecided where intervals are missing or all hold 0."""
    if None in signs:
        return UNDECIDED
    if min(signs) > 0:
        return REPRODUCED
    if min(signs) == 0:
        return IN_PART if max(signs) > 0 else UNDECIDED
    return REFUTED
