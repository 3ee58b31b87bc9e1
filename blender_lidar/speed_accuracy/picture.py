"""The picture of the chart."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..plots.speed_accuracy import Mark, plot_speed_accuracy


def draw_chart(path: Path, result: Mapping) -> None:
    """Error over time, every fidelity named."""
    marks = [
        Mark(
            name=_name(row),
            milliseconds=tuple(row["milliseconds"][key] for key in ("first_quartile", "median", "third_quartile")),
            error=row["error"],
            detail=row["detail"],
            twin=row["twin"] is not None,
            front=row["pareto"],
            recommended=row["name"] == result["recommended"],
        )
        for row in result["rungs"]
        if row["error"] is not None
    ]
    gain, noise = result["gain_per_vehicle"], result["noise"]
    plot_speed_accuracy(
        path,
        marks,
        noise=None if noise is None else (noise["error_90"][0], noise["error"], noise["error_90"][1]),
        tolerance=result["tolerance"] * gain if gain > 0.0 else None,
        unit=result["metric_unit"],
        title="Speed against accuracy",
        subtitle=f"{result['sensor']}, {result['scene']}: {result['mountings']} mountings, {result['frames']} frames; "
        f"reference: {result['reference']}. 1/4: every 4th column; 8f: 8 frames; det.: detailed",
    )


def _name(row: Mapping) -> str:
    """Short enough to stand beside its point."""
    return row["name"].replace("detailed", "det.")
