"""What the rungs of a search have taken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..optimise.stored import read_array
from .rungs import Rung


class Spending:
    """Candidates, casts of a frame and seconds of each rung.

    Parameters
    ----------
    rungs : sequence of Rung
        From the cheapest to the reference.
    """

    def __init__(self, rungs: Sequence[Rung]) -> None:
        self._rungs = tuple(rungs)
        self._tried, self._casts, self._seconds = ([0] * len(self._rungs) for _ in range(3))

    @property
    def candidates(self) -> int:
        """Scored on any rung."""
        return sum(self._tried)

    def add(self, level: int, *, candidates: int, casts: int, seconds: float) -> None:
        """Count what a rung has taken besides."""
        self._tried[level] += candidates
        self._casts[level] += casts
        self._seconds[level] += seconds

    def rows(self) -> list[dict[str, Any]]:
        """One for each rung, for result.json."""
        return [
            {
                "detail": rung.fidelity.detail,
                "stride": rung.fidelity.stride,
                "frames": len(rung.frames),
                "candidates": tried,
                "frame_casts": casts,
                "seconds": round(seconds, 3),
            }
            for rung, tried, casts, seconds in zip(self._rungs, self._tried, self._casts, self._seconds, strict=True)
        ]

    def state(self) -> dict[str, Any]:
        """All of it, for JSON."""
        return {"tried": self._tried, "casts": self._casts, "seconds": self._seconds}

    def restore(self, state: dict[str, Any]) -> None:
        """Become what `state` described; raises `InputError` naming what is damaged."""
        stored = {key: read_array(state, key, (len(self._rungs),)).tolist() for key in ("tried", "casts", "seconds")}
        self._tried, self._casts = ([int(number) for number in stored[key]] for key in ("tried", "casts"))
        self._seconds = stored["seconds"]
