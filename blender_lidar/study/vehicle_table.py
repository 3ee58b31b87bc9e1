"""One row for each counted vehicle and frame: what a mounting sees of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..metrics.vgop import entropy
from ..metrics.views import PE_VGOP
from ..sensors.pose import Pose
from .frame_scorer import FrameScorer, Observation
from .scoring import CountedFrame, Scoring, VehicleScores, mountings_of

COLUMNS = (
    "frame",
    "vehicle_id",
    "class",
    "x_m",
    "y_m",
    "z_m",
    "length_m",
    "width_m",
    "height_m",
    "heading_deg",
    "distance_m",
    "points",
    "p_top",
    "p_side",
    "p_front",
    "entropy_bits",
    "detectable",
    "lane",
    "split",
)
METRIC_VALUE = "metric_value"
"""The column of the chosen metric, in its own unit, where that is another than PE-VGOP: that one is `entropy_bits`."""


def columns_for(metric: str) -> tuple[str, ...]:
    """The columns of the table of a run with a metric."""
    return COLUMNS if metric == PE_VGOP.name else (*COLUMNS, METRIC_VALUE)


def metric_values(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """The chosen metric of each vehicle of a table, in its own unit, (n,)."""
    return table[METRIC_VALUE] if METRIC_VALUE in table else table["entropy_bits"]


def vehicle_table(
    frames: Sequence[CountedFrame], pose: Pose, observation: Observation, scoring: Scoring, split: str
) -> dict[str, np.ndarray]:
    """Score one mounting vehicle by vehicle.

    Returns
    -------
    dict of str to ndarray
        The columns of `columns_for` the metric; `distance_m` is horizontal, from the mount, and `split` repeats the
        argument.
    """
    scores, mountings = VehicleScores(scoring, observation, frames), mountings_of([pose])
    tables = [_frame_table(frame, pose, observation, scores, mountings) for frame in frames]
    joined = {
        name: np.concatenate([table[name] for table in tables]) if tables else np.empty(0)
        for name in columns_for(scoring.metric)
        if name != "split"
    }
    joined["split"] = np.full(len(joined["frame"]), split)
    return joined


def join_tables(*tables: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Tables with the same columns, one under the other; empty ones are left out."""
    filled = [table for table in tables if len(table["frame"])]
    return {name: np.concatenate([table[name] for table in filled]) for name in filled[0]} if filled else tables[0]


def _frame_table(frame, pose, observation, scores, mountings):
    scorer = FrameScorer(frame.vehicles, frame.counted, observation)
    scored = scores.of(frame, scorer, [pose], mountings)
    vehicles, shares = scorer.vehicles, scored.seen.occupancy[0]
    return {
        "frame": np.full(len(vehicles), vehicles.frame),
        "vehicle_id": vehicles.vehicle_id,
        "class": vehicles.class_name,
        **dict(zip(("x_m", "y_m", "z_m"), vehicles.centre_m.T, strict=True)),
        **dict(zip(("length_m", "width_m", "height_m"), vehicles.size_m.T, strict=True)),
        "heading_deg": np.degrees(vehicles.heading_rad),
        "distance_m": np.hypot(vehicles.centre_m[:, 0] - pose.x_m, vehicles.centre_m[:, 1] - pose.y_m),
        "points": scored.seen.points[0],
        **dict(zip(("p_top", "p_side", "p_front"), shares.T, strict=True)),
        "entropy_bits": entropy(shares).sum(axis=1),
        "detectable": scored.detectable[0],
        "lane": vehicles.lane,
        METRIC_VALUE: scored.values[0],
    }
