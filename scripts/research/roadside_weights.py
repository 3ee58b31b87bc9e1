"""Detectors on recorded roadside clouds: recall by range and false alarms, beside boxes fitted to the points.

    python scripts/research/roadside_weights.py --roadside DIR --detectors old.npz new.npz

DIR is as for `roadside_clouds.py`. Vehicles of confidence A to C count that are within 100 m and outside the blind
sector; what meets another fitted box is neither a hit nor a false alarm. A hit is a centre within 2 m. Detectors look
between the rails beside both carriageways, so into the median, too. The boxes come from the same points and some
vehicles may have none: only differences between detectors count. The judging frames are those of `compare_roadside.py`;
the others may be looked at. Intervals resample frames.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from arguments import parser_of, run_script
from blender_lidar.detection.pillars import PillarsDetector
from blender_lidar.detection.scores import CRITERIA, meetings
from blender_lidar.scene.region import Region
from blender_lidar.sensors.pose import Pose
from blender_lidar.statistics import interval_90, resampled_weights
from roadside_clouds import CARRIAGEWAYS, FIRST_HALF, HEIGHT_M, SECTOR_RAD, roadside_frames

CONFIDENCE, FARTHEST_M, EDGE_M = 0.3, 100.0, 16.8  # the last: the rails beside both carriageways
BANDS_M = (0.0, 30.0, 50.0, 75.0, FARTHEST_M)
_PAIRS = list(pairwise(BANDS_M))
MEDIAN_M = 2.0  # to either side of the LiDAR
MEAN = Pose(0.0, 0.0, HEIGHT_M, *np.radians(np.mean(list(CARRIAGEWAYS.values()), axis=0)))


class Frame(NamedTuple):
    """A cloud over the mean of both carriageways, all fitted boxes, and those that count."""

    name: str
    points: np.ndarray
    centre_m: np.ndarray
    counted: np.ndarray


def main(argv: list[str] | None = None) -> int:
    return run_script("roadside_weights", lambda: _study(argv))


def _study(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--roadside", required=True, type=Path, metavar="DIR")
    parser.add_argument("--detectors", required=True, nargs="+", metavar="WEIGHTS.npz", help="the first is the rival")
    args = parser.parse_args(argv)
    frames = list(both_carriageways(args.roadside))
    found = {one: [_found(one, frame) for frame in frames] for one in args.detectors}
    judging = np.array([frame.name not in FIRST_HALF for frame in frames])
    for name, which in {"looked at": ~judging, "judging": judging}.items():
        rows = np.flatnonzero(which)
        print(f"{name}: {len(rows)} frames, {sum(frames[row].counted.sum() for row in rows)} vehicles")
        rival = np.array([found[args.detectors[0]][row] for row in rows])
        for one in args.detectors:
            counts = np.array([found[one][row] for row in rows])
            print(f"  {Path(one).stem}: {_told(counts)}")
            if one != args.detectors[0]:
                print(f"    less the first: {_gap(counts, rival)}")


def both_carriageways(folder: Path) -> Iterator[Frame]:
    parts = [(frame, pose, sure) for frame, pose, sure in roadside_frames(folder)]
    for left, right in zip(parts[::2], parts[1::2], strict=True):
        local = [pose.to_sensor(frame.boxes.centre_m) for frame, pose, _ in (left, right)]
        points = left[1].to_sensor(left[0].points)
        azimuth = np.concatenate([np.arctan2(one[:, 1], one[:, 0]) for one in local])
        centre = MEAN.position + MEAN.to_world(np.concatenate(local))
        near = (np.hypot(*centre[:, :2].T) < FARTHEST_M) & (np.abs(azimuth) < SECTOR_RAD)
        counted = near & (np.concatenate([left[2], right[2]]) != "D")
        yield Frame(left[0].name, MEAN.position + MEAN.to_world(points), centre, counted)


def _found(weights: str, frame: Frame) -> list[float]:
    """Of a frame: false alarms, and for each band its vehicles and how many were found."""
    detector = PillarsDetector("RS-Ruby-Lite-V2R", MEAN, (-FARTHEST_M, -EDGE_M), (FARTHEST_M, EDGE_M), weights)
    boxes, _ = detector.detect(SimpleNamespace(xyz=frame.points))
    x, y = boxes.centre_m[:, :2].T
    near = (np.abs(np.arctan2(y, x)) < SECTOR_RAD) & (np.abs(y) < EDGE_M) & (boxes.confidence >= CONFIDENCE)
    boxes = boxes.select(near)
    vehicles = SimpleNamespace(centre_m=frame.centre_m)
    met, ignored = meetings(boxes, vehicles, frame.counted, Region((0.0, 0.0), FARTHEST_M), CRITERIA[0])
    hit, false = np.zeros(len(frame.counted), dtype=bool), (met < 0) & ~ignored
    hit[met[met >= 0]] = True
    away = np.hypot(*frame.centre_m[:, :2].T)
    there, found = (np.histogram(away[rows], BANDS_M)[0] for rows in (frame.counted, frame.counted & hit))
    in_median = np.abs(boxes.centre_m[:, 1]) < MEDIAN_M
    return [float(false.sum()), float((false & in_median).sum()), *there.astype(float), *found.astype(float)]


def _shares(counts: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """False alarms a frame, those in the median, recall of all and of each band, (r, 3 + bands), by weights (r, f)."""
    there, hit = (np.column_stack([one.sum(axis=1), one]) for one in np.split(counts[:, 2:], 2, axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):
        alarms = weights @ counts[:, :2] / weights.sum(axis=1, keepdims=True)
        return np.column_stack([alarms, (weights @ hit) / (weights @ there)])


def _told(counts):
    alarms, median, recall, *bands = _shares(counts, np.ones((1, len(counts))))[0]
    number = counts[:, 2 : 1 + len(BANDS_M)].sum(axis=0)
    by = [
        f"{low:.0f}-{high:.0f} m {share:.2f} of {n:.0f}"
        for (low, high), share, n in zip(_PAIRS, bands, number, strict=True)
    ]
    return f"recall {recall:.3f} ({', '.join(by)}), {alarms:.1f} false alarms a frame, {median:.1f} in the median"


def _gap(counts: np.ndarray, rival: np.ndarray) -> str:
    weights = resampled_weights(len(counts), np.random.default_rng(1), 4000)
    of = [_shares(one, np.vstack([np.ones(len(counts)), weights])) for one in (counts, rival)]
    ends = []
    for column in (of[0] - of[1]).T[:3]:
        low, high = interval_90(column[1:])
        ends.append(f"{column[0]:+.3f} ({low:+.3f} to {high:+.3f})")
    return "false alarms {}, in the median {}, recall {}".format(*ends)


if __name__ == "__main__":
    sys.exit(main())
