"""Numbers as the chart's reports write them."""

from __future__ import annotations

from collections.abc import Sequence


def number(value: float | None, digits: int = 4) -> str:
    """So many digits after the point; nothing for None."""
    return "" if value is None else f"{value:.{digits}f}"


def signed(value: float | None) -> str:
    """Four digits and the sign, which 0 has too."""
    return "" if value is None else f"{round(value, 4) + 0.0:+.4f}"


def percent(share: float | None) -> str:
    """A share in per cent."""
    return "" if share is None else f"{_tenths(share)} %"


def with_interval(share: float | None, interval: Sequence[float] | None) -> str:
    """A share in per cent, and its interval where there is one."""
    if share is None or interval is None:
        return percent(share)
    low, high = map(_tenths, interval)
    return f"{percent(share)} ({low} to {high})"


def _tenths(share: float) -> str:
    return f"{round(100.0 * share, 1) + 0.0:.1f}"  # no -0.0
