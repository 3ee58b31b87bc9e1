"""What was found of one change, and how a number becomes a verdict."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

STABLE, FRAGILE, FAILS = "stable", "fragile", "fails"
UNDECIDED = "undecided"  # nothing to judge by: too few blocks, or an objective that gains nothing anywhere
VERDICTS = (STABLE, FRAGILE, FAILS, UNDECIDED)
MOST_STABLE_LOSS, MOST_FRAGILE_LOSS = 0.05, 0.20  # shares of the gain over the baseline
RULE = (
    f"stable: the mounting loses at most {100 * MOST_STABLE_LOSS:g} % of the gain that it could have; fragile: at most "
    f"{100 * MOST_FRAGILE_LOSS:g} %; fails: more, and surely more than {100 * MOST_STABLE_LOSS:g} %; undecided: "
    f"nothing to gain, or too little traffic to tell {100 * MOST_STABLE_LOSS:g} from {100 * MOST_FRAGILE_LOSS:g} %"
)


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report.

    Attributes
    ----------
    section : str
        One of the study's sections.
    what, value : str
        What was changed or asked, and to what; `value` may be empty.
    verdict : str
        One of `VERDICTS`.
    text : str
        What was found, in a sentence's worth of words.
    numbers : dict
        What the verdict rests on, as JSON holds it.
    """

    section: str
    what: str
    value: str
    verdict: str
    text: str
    numbers: dict = field(default_factory=dict)


def by_loss(loss: float | None, interval: Sequence[float] | None = None) -> str:
    """The verdict on a share of the gain that is lost; None where there is no gain to lose.

    Where its 90 % interval is known, a loss that may be none does not fail, and one that may be large is not stable.
    """
    if loss is None:
        return UNDECIDED
    low, high = (loss, loss) if interval is None else interval
    if loss <= MOST_STABLE_LOSS:
        return STABLE if high <= MOST_FRAGILE_LOSS else UNDECIDED
    if loss <= MOST_FRAGILE_LOSS:
        return FRAGILE
    return FAILS if low > MOST_STABLE_LOSS else UNDECIDED


def worst(verdicts: Sequence[str]) -> str:
    """The gravest of several verdicts; what is undecided says nothing unless all are."""
    decided = [verdict for verdict in verdicts if verdict != UNDECIDED]
    return max(decided, key=VERDICTS.index) if decided else UNDECIDED


def percent(share: float) -> str:
    """A share as text; what rounds to nothing has no sign."""
    return f"{round(100.0 * share, 1) + 0.0:.1f} %"


def lost(share: float, interval: Sequence[float] | None = None) -> str:
    """What a mounting loses, or by what it is better, as text; with its 90 % interval where there is one."""
    sign, words = (1.0, "loses") if share > -0.0005 else (-1.0, "is better by")
    text = f"{words} {percent(sign * share)}"
    if interval is None:
        return text
    low, high = sorted(round(100.0 * sign * end, 1) + 0.0 for end in interval)
    return f"{text} ({low:.1f} to {high:.1f})"
