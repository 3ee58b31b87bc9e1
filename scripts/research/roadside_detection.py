"""Both detectors, and boxes of our own, on frames of a real roadside LiDAR beside boxes fitted independently.

    python scripts/research/roadside_detection.py --roadside DIR

DIR holds frames_float16.npz and vehicles_fitted.csv of a motorway in Chengdu. Makes tables: recall of boxes of A to C
and false alarms a frame, by range, for `classical`, `pillars`, and `pillars` on clouds levelled by each carriageway's
own plane; false alarms on the carriageways alone; and how near `fit_boxes` comes to those boxes. Nothing was labelled:
boxes of D meet detections without counting, a vehicle without one is a false alarm. Intervals (90 %) resample frames.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from arguments import parser_of, run_script
from blender_lidar.clouds.commissioned import Hung
from blender_lidar.clouds.scan import PointCloud
from blender_lidar.detection.classical import ClassicalDetector
from blender_lidar.detection.fitted_boxes import fit_boxes
from blender_lidar.detection.ground import fit_ground
from blender_lidar.detection.judge import within
from blender_lidar.detection.pillars import PillarsDetector
from blender_lidar.detection.scores import CRITERIA, Matches, intervals, match, measured
from blender_lidar.detection.stored import AS_RECORDED, RecordedClouds
from blender_lidar.scene.region import region_within
from blender_lidar.statistics import statistic_interval_90
from blender_lidar.traffic import read_table
from blender_lidar.traffic.boxes import Boxes

MEASURED = Hung("flu", (0, 0, 3.49, 0.075, 0.385, -89.72), "RS-Ruby-Lite-V2R", [(-16.5, -2.6), (2.6, 16.5)])
BANDS_M = ((0.0, 100.0), (0.0, 20.0), (20.0, 50.0), (50.0, 75.0), (75.0, 100.0))
AT, SEED = "0.3", 1


def labels_of(folder: Path, scratch: Path) -> tuple[list[Path], list[Boxes], dict[str, np.ndarray]]:
    """The frames as files, their boxes of which A to C count, and the rows of the boxes by column."""
    with (folder / "vehicles_fitted.csv").open(encoding="utf-8", newline="") as stream:
        rows = [row for row in csv.DictReader(stream) if row["file"] != "raw"]
    names = {int(row["frame"]): row["file"] for row in rows}
    held, paths = np.load(folder / "frames_float16.npz"), [scratch / f"{frame:06d}.npz" for frame in sorted(names)]
    for path in paths:
        np.savez(path, xyz=held[f"s{names[int(path.stem)]}000"])
    table = {key: np.array([row[key] for row in rows]) for key in rows[0]}
    sure = table["vehicle_id"].astype(int)[np.isin(table["confidence"], ("A", "B", "C"))]
    frames = map(read_table(table).at, sorted(names))
    return paths, [replace(one, counted=np.isin(one.vehicle_id, sure)) for one in frames], table


def detections(clouds: Sequence[PointCloud], read: RecordedClouds) -> dict[str, list]:
    """What each detector finds in each cloud within the rectangle that is looked at."""
    pillars = PillarsDetector(MEASURED.sensor, MEASURED.pose, read.low, read.high)
    classical, of_classical = ClassicalDetector(read.lattice, (0.0, 0.0), AS_RECORDED), []
    images = np.array([classical.range_image(cloud) for cloud in clouds])
    for row, cloud in enumerate(clouds):
        classical.learn(np.delete(images, row, axis=0))
        of_classical.append(classical.detect(cloud)[0])
    ways = {"pillars": clouds, "pillars, levelled": levelled(clouds)}
    found = {name: [pillars.detect(cloud)[0] for cloud in each] for name, each in ways.items()}
    found |= {"classical": of_classical}
    return {name: [within(boxes, read.low, read.high) for boxes in each] for name, each in found.items()}


def levelled(clouds: Sequence[PointCloud]) -> list[PointCloud]:
    """The clouds with heights counted from the plane of the carriageway on whose side each point lies."""
    xyz = np.concatenate([cloud.xyz for cloud in clouds])
    near = np.abs(xyz[:, 0]) < 60.0
    right, left = (fit_ground(xyz[near & (xyz[:, 1] > a) & (xyz[:, 1] < b)]) for a, b in MEASURED.carriageways)
    each = [np.where(one.xyz[:, 1] > 0.0, left.above(one.xyz), right.above(one.xyz)) for one in clouds]
    return [
        replace(one, xyz=np.column_stack([one.xyz[:, :2], height])) for one, height in zip(clouds, each, strict=True)
    ]


def judged(boxes: Sequence, frames: Sequence[Boxes], spans: Sequence, read: RecordedClouds) -> list[Matches]:
    """Matches by each criterion between some y [m]."""
    (low, _), (high, _) = read.low, read.high
    region = region_within([np.array([(low, a), (high, a), (high, b), (low, b)]) for a, b in spans])
    inside = [replace(one, counted=one.counted & region.holds(one)) for one in frames]
    return [match(boxes, inside, region, (0.0, 0.0), criterion) for criterion in CRITERIA]


def alarms(by: Sequence[Matches]) -> str:
    """False alarms a frame at the confidence, and their interval over frames."""
    wrong = ~by[0].hit & (by[0].confidence >= float(AT))
    count = np.bincount(by[0].frame[wrong], minlength=by[0].frames)
    ends = statistic_interval_90(lambda weight: weight @ count / weight.sum(axis=1), np.ones(len(count)), SEED)
    return f"{count.mean():.1f} ({max(ends[0], 0.0):.1f} to {ends[1]:.1f})"


def lines_of(name: str, by: Sequence[Matches]) -> Iterator[str]:
    """A row of a table in Markdown for each band of range."""
    for low, high in BANDS_M:
        part = [one.near(low, high) for one in by]
        values, ends = measured(part), intervals(part, np.arange(by[0].frames), SEED)
        cells = []
        for key in (f"recall_{AT}", "ap_centre_2m", "ap_iou_0.5"):
            cells.append(f"{100 * values[key]:.0f} ({' to '.join(f'{100 * end:.0f}' for end in ends[key] or ())})")
        yield f"| {name} | {low:.0f} to {high:.0f} | {values['vehicles']} | {' | '.join(cells)} | {alarms(part)} |"


def beside(table: Mapping[str, np.ndarray], ours: Mapping[str, np.ndarray], numbers: np.ndarray) -> Iterator[str]:
    """How many of the boxes within 75 m are found, and median differences, ours less theirs; in brackets absolute."""
    x, y, frame, reach = (table[key].astype(float)[:, None] for key in ("x_m", "y_m", "frame", "range_m"))
    away = np.hypot(ours["x_m"] - x, ours["y_m"] - y) + np.where(frame == numbers[ours["frame"]], 0.0, np.inf)
    for grade in ("A", "B", "C"):
        mine = (table["confidence"] == grade) & (reach[:, 0] < 75.0)
        row = np.flatnonzero(mine & (away.min(axis=1) < 2.0))
        at = away[row].argmin(axis=1)
        cells = [grade, f"{len(row)} of {mine.sum()}", f"{np.median(away[row, at]):.2f}"]
        for key, letter in (("length_m", "L"), ("width_m", "W"), ("height_m", "H")):
            known = [np.char.find(one, letter) >= 0 for one in (table["measured"][row], ours["measured"][at])]
            off = (ours[key][at] - table[key][row].astype(float))[known[0] & known[1]]
            cells.append(f"{np.median(off):+.2f} ({np.median(np.abs(off)):.2f}), {len(off)}" if len(off) > 2 else "-")
        yield f"| {' | '.join(cells)} |"


def tables(folder: Path) -> None:
    with TemporaryDirectory() as scratch:
        paths, frames, table = labels_of(folder, Path(scratch))
        read = RecordedClouds.of(paths, MEASURED, None, beams=True)
        clouds = list(map(read, paths))
    found, on_road = detections(clouds, read), []
    print(f"| detector | range [m] | boxes | recall at {AT} [%] | AP, 2 m | AP, IoU 0.5 | false alarms a frame |")
    print("|" + 7 * "---|")
    for name, boxes in found.items():
        print("\n".join(lines_of(name, judged(boxes, frames, [(read.low[1], read.high[1])], read))))
        on_road.append(f"{name} {alarms(judged(boxes, frames, MEASURED.carriageways, read))}")
    print(f"False alarms a frame on the carriageways alone: {'; '.join(on_road)}")
    ours = fit_boxes(clouds, ClassicalDetector(read.lattice, (0.0, 0.0), AS_RECORDED), MEASURED.carriageways)
    print(
        "\n| confidence | found | centre [m] | length [m], both measured | width | height |\n|---|---|---|---|---|---|"
    )
    print("\n".join(beside(table, ours, np.array([int(path.stem) for path in paths]))))


def main(argv: Sequence[str] | None = None) -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--roadside", required=True, type=Path, metavar="DIR")
    return run_script("roadside_detection", partial(tables, parser.parse_args(argv).roadside))


if __name__ == "__main__":
    raise SystemExit(main())
