"""Which fidelities are near enough: asked in an order that their losses have no say in, so that luck passes none.

Of fifty fidelities, each asked by itself at 95 %, the fastest that passes may well owe its place to luck. So each level
of detail is a sequence of its own, from the fidelity that casts the most beams to the one that casts the fewest, which
ends at the first that cannot be shown to be near enough: in a fixed sequence every test may take the whole level
(Maurer, Hothorn and Lehmacher 1995). Times, which a busy machine may turn round, have no say in it either. The levels
of detail share the 5 % evenly (Bonferroni). With 95 % or more, then, none of those that pass loses more than the
tolerance, given what was chosen on the searched frames: the bounds tell of other frames that judge, not of others that
choose, which the exchange of blocks asks for once.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..world.shapes import DETAILS
from .noise import Noise

SURE = 0.95  # of all tests together
BOUND_LEVEL = 1.0 - (1.0 - SURE) / len(DETAILS)  # of each test's bound, one-sided


def mark_within(rows: Sequence[dict], tolerance: float, noise: Noise | None, gain: float) -> None:
    """Mark the rows that are asked, and those near enough to the reference, which is the first row.

    What a fidelity is for is to choose: so what its choices lose on held-out frames must be within the tolerance, by an
    upper bound at `BOUND_LEVEL`. And its error after calibration must be within it too, or within the noise ceiling: no
    closer does the traffic tell the truth itself. What comes to the same as another fidelity shares its answer.
    """
    most = max(tolerance, 0.0 if noise is None else noise.error / gain) if gain > 0.0 else 0.0
    for row in rows:
        row["asked"] = row["within"] = row is rows[0]
    for detail in DETAILS:
        own = [row for row in rows[1:] if row["detail"] == detail and row["twin"] is None]
        for row in sorted(own, key=_beams, reverse=True):
            row["asked"], row["within"] = True, _near(row, tolerance, most)
            if not row["within"]:
                break
    named = {row["name"]: row for row in rows}
    for row in rows:
        if row["twin"] is not None:
            row["within"] = bool(row["same_as_twin"]) and named[row["twin"]]["within"]


def _beams(row: dict) -> tuple[float, int]:
    """What is cast, but for a factor; where that is equal, more frames come first."""
    return row["frames"] / row["stride"], row["frames"]


def _near(row: dict, tolerance: float, most: float) -> bool:
    bound, error = row["regret_bound"], row["error_share"]
    return bound is not None and bound <= tolerance and error is not None and error <= most
