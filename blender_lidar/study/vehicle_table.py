"""One row for each counted vehicle and frame: what a mounting sees of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..metrics.vgop import entropy
from ..optimise.objective import detectable
from ..sensors.pose import Pose
from .evaluation import CountedFrame, Scoring
from .frame_scorer import FrameScorer, Observation

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


def vehicle_table(
    frames: Sequence[CountedFrame], pose: Pose, observation: Observation, scoring: Scoring, split: str
) -> dict[str, np.ndarray]:
    """Score one mounting vehicle by vehicle.

    Returns
    -------
    dict of str to ndarray
        The columns of `COLUMNS`; `distance_m` is horizontal, from the mount, and `split` repeats the argument.
    """
    tables = [_frame_table(frame, pose, observation, scoring) for frame in frames]
    joined = {
        name: np.concatenate([table[name] for table in tables]) if tables else np.empty(0) for name in COLUMNS[:-1]
    }
    joined["split"] = np.full(len(joined["frame"]), split)
    return joined


def join_tables(*tables: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Tables with the same columns, one under the other; empty ones are left out."""
    filled = [table for table in tables if len(table["frame"])]
    return {name: np.concatenate([table[name] for table in filled]) for name in COLUMNS} if filled else tables[0]


def _frame_table(frame, pose, observation, scoring):
    vehicles = frame.vehicles.select(frame.counted)
    seen = FrameScorer(frame.vehicles, frame.counted, observation).see([pose])
    shares = seen.occupancy[0]
    return {
        "frame": np.full(len(vehicles), vehicles.frame),
        "vehicle_id": vehicles.vehicle_id,
        "class": vehicles.class_name,
        **dict(zip(("x_m", "y_m", "z_m"), vehicles.centre_m.T, strict=True)),
        **dict(zip(("length_m", "width_m", "height_m"), vehicles.size_m.T, strict=True)),
        "heading_deg": np.degrees(vehicles.heading_rad),
        "distance_m": np.hypot(vehicles.centre_m[:, 0] - pose.x_m, vehicles.centre_m[:, 1] - pose.y_m),
        "points": seen.points[0],
        **dict(zip(("p_top", "p_side", "p_front"), shares.T, strict=True)),
        "entropy_bits": entropy(shares).sum(axis=1),
        "detectable": detectable(shares, scoring.threshold, scoring.view),
        "lane": vehicles.lane,
    }
