"""The two readings of the paper's equations: the corrected one, and the literal one for comparison."""

from __future__ import annotations

from ..errors import unknown_name

READINGS = ("corrected", "paper")


def check_reading(reading: str) -> None:
    """Raise `InputError` unless `reading` is one of `READINGS`."""
    if reading not in READINGS:
        raise unknown_name(reading, READINGS, "reading")
