"""The chart in a sentence: the cheapest fidelity that is near enough to the reference."""

from __future__ import annotations

from collections.abc import Mapping


def sentence(reference: Mapping, best: Mapping, tolerance: float, gain: float) -> str:
    """Which fidelity is the cheapest within the tolerance, what it costs, and by how much it is the faster."""
    if not gain > 0.0:
        return "No mounting gains anything over the baseline: there is nothing that a fidelity could lose."
    share = f"{100.0 * tolerance:g} % of the gain"
    took = milliseconds(best["milliseconds"]["median"])
    if best["name"] == reference["name"]:
        only = f"only the reference, {best['text']}: {took} an evaluation"
        return f"No cheaper fidelity can be shown to be within {share}: {only}."
    return (
        f"Cheapest within {share}: {best['text']}: {took} an evaluation, {best['speedup']:.2g} times faster than the "
        f"reference ({reference['text']})."
    )


def milliseconds(value: float) -> str:
    """A time in three digits: ms, or s from a second on."""
    if value >= 1000.0:
        return f"{value / 1000.0:.3g} s"
    return f"{value:.3g} ms" if value < 100.0 else f"{value:.0f} ms"
