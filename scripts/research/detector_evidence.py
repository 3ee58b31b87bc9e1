"""The paper's Table III and Fig. 9 with our detectors, and what each part of the harder world does to them.

    python scripts/research/detector_evidence.py --traffic B.csv.gz [--out detector_evidence]

Recall with precision and AP at the baseline and at the mounting that PE-VGOP chose, for each sensor, in the clean and
the hard world; recall by distance as a picture; and an ablation, in which each part of the hard world is on alone, and
then off alone. Differences, to the baseline, between detectors and to the clean or the hard world, have paired 90 %
intervals over blocks of time. The LiDAR hangs off its plan by one draw.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from statistics import median
from timeit import timeit

from arguments import SCENES, counting, parser_of, positive, run_script
from blender_lidar.detection.judge import (
    DETECTORS,
    JudgedDetector,
    detector_at,
    judge_detectors,
    sensor_at,
    site_judge,
)
from blender_lidar.document import Table
from blender_lidar.files import make_folder, write_text
from blender_lidar.report.figure import BASELINE_LOOK, OPTIMISED_LOOK, sheet
from blender_lidar.report.text import table_text
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, prepare
from detector_worlds import Options, hard_world

# What `optimise i80 --sensor S` answers, in whole degrees.
CHOSEN = {"RS-16": (4.5, 23.0), "RS-32": (4.5, 22.0), "RS-80": (4.5, 12.0)}
PAPER = {  # Table III: recall at 0.1 and 0.3, baseline and optimised
    "RS-16": (0.70, 0.87, 0.57, 0.67),
    "RS-32": (0.63, 0.88, 0.53, 0.68),
    "RS-80": (0.85, 0.95, 0.78, 0.86),
}
PARTS = {  # settings of the hard world that belong together
    "clutter": ("clutter",),
    "variety of vehicles": ("variety",),
    "grade, cross-fall, crown": ("grade_percent", "cross_fall_percent", "crown_percent"),
    "range noise": ("range_noise_m",),
    "drop-out, glass": ("dropout", "glass_dropout"),
    "weak returns": ("range_at_10_percent_m",),
    "mounting off by 1 deg, 5 cm": ("pose_error",),
}
MEASURED = ("recall_0.1", "precision_0.1", "recall_0.3", "precision_0.3", "ap_centre_2m", "ap_iou_0.5", "ap_iou_0.7")


def main(argv: list[str] | None = None) -> int:
    return run_script("detector_evidence", lambda: _study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--traffic", required=True, metavar="FILE", help="no detector was trained on it")
    parser.add_argument("--out", type=Path, default=Path("detector_evidence"), metavar="DIR")
    parser.add_argument("--frames", type=positive, default=90, help="searched; two thirds as many judge (default 90)")
    parser.add_argument("--detectors", nargs="+", default=DETECTORS, metavar="NAME", help="names, or weights")
    return parser.parse_args(argv)


def _study(args) -> None:
    make_folder(args.out, "--out")
    rows = list(_table_3(args))
    _tell(args, "table_3", "Recall, precision and AP [%], baseline to mounting", rows)
    print("\n".join(f"the paper, {sensor}: {_of_paper(*recalls)}" for sensor, recalls in PAPER.items()), flush=True)
    for detector in args.detectors:
        own = {row["sensor"]: row["result"] for row in rows if (row["world"], row["detector"]) == ("hard", detector)}
        _draw_distances(args.out / f"distances_{Path(detector).stem}.png", own, Path(detector).stem)
    _speed(args)
    _tell(args, "ablation", "RS-16 at the mounting, by what is in the world [%]", list(_ablation(args)))


def _site(args, sensor: str, world: Options) -> Site:
    given = {("sensor", "name"): sensor, ("traffic", "path"): args.traffic, ("traffic", "frames"): args.frames}
    options = {place: (value, place[1]) for place, value in given.items()}
    return prepare(load_scenario(SCENES / "i80.toml", {**world, **options}))


def _mounts(site: Site, sensor: str) -> dict[str, Mounting]:
    height, tilt = CHOSEN[sensor]
    given = site.scenario.lidar.mounting({"height_m": height, "tilt_x_deg": tilt})
    return {"baseline": site.scenario.lidar.baseline, "given": given}


def _judged(site: Site, mounts: Mapping[str, Mounting], detector: str, advance) -> dict[str, JudgedDetector]:
    judged = {}
    for name, mount in mounts.items():
        judged[name] = judge_detectors(site, (mount,), [detector_at(site, mount, detector)])["given"]
        advance(1, f"{site.model.name} {detector}")
    return judged


def _of_paper(low: float, low_better: float, high: float, high_better: float) -> str:
    return (
        f"recall at 0.1 {100 * low:.0f} to {100 * low_better:.0f}, at 0.3 {100 * high:.0f} to {100 * high_better:.0f}"
    )


def _table_3(args) -> Iterator[dict]:
    """Every sensor, world and detector, at the baseline and at the mounting."""
    with counting(2 * 2 * len(CHOSEN) * len(args.detectors), "mountings") as advance:
        for world, options in (("clean", {}), ("hard", hard_world())):
            for sensor in CHOSEN:
                site = _site(args, sensor, options)
                judge, first = site_judge(site), None
                for detector in args.detectors:
                    judged = _judged(site, _mounts(site, sensor), detector, advance)
                    first = first or judged["given"]
                    row = {"title": f"{world}, {sensor}, {Path(detector).stem}", "world": world, "sensor": sensor}
                    row |= {"detector": detector, "result": judge.result(detector, judged, {})}
                    better = row["result"]["mountings"]["given"]["over_baseline"]
                    rival = judge.over(first, judged["given"]) if judged["given"] is not first else None
                    yield row | {"than baseline": better, f"{args.detectors[0]} than this": rival}


def _ablation(args) -> Iterator[dict]:
    """The clean world, each part alone, the hard world, and it without each part."""
    whole = hard_world()
    worlds: dict[str, Options] = {"clean": {}}
    for name, keys in PARTS.items():
        worlds[f"{name} alone"] = {place: value for place, value in whole.items() if place[1] in keys}
    worlds["hard"] = whole
    for name, keys in PARTS.items():
        worlds[f"hard without {name}"] = {place: value for place, value in whole.items() if place[1] not in keys}
    rival: dict[str, JudgedDetector] = {}
    with counting(len(worlds) * len(args.detectors), "worlds") as advance:
        for name, options in worlds.items():
            site = _site(args, "RS-16", options)
            judge = site_judge(site)
            mount = {"given": _mounts(site, "RS-16")["given"]}
            for detector in args.detectors:
                judged = _judged(site, mount, detector, advance)
                if name in ("clean", "hard"):
                    rival[detector] = judged["given"]
                against = "clean" if name.endswith("alone") or name == "clean" else "hard"
                row = {"title": f"{name}, {Path(detector).stem}", "result": judge.result(detector, judged, {})}
                yield row | {f"than {against}": judge.over(judged["given"], rival[detector])}


def _speed(args) -> None:
    """How long PointPillars takes for a cloud, in the median of ten, by sensor."""
    for sensor in CHOSEN:
        site = _site(args, sensor, hard_world())
        mount = _mounts(site, sensor)["given"]
        detector, cloud = detector_at(site, mount, DETECTORS[0]), sensor_at(site, mount).scan(site.search[0])
        seconds = [timeit(partial(detector.detect, cloud), number=1) for _ in range(10)]
        print(f"{sensor}: {1e3 * median(seconds):.0f} ms for a cloud of {len(cloud):,} points", flush=True)


def _tell(args, stem: str, title: str, rows: list[dict]) -> None:
    """A table on standard output and as text, and all of it as JSON."""
    columns = ("", "vehicles", "with return", *(name.replace("_", " ") for name in MEASURED))
    cells = []
    for row in rows:
        mountings = row["result"]["mountings"].values()

        def both(of, mountings=mountings) -> str:
            return " to ".join("-" if of(one) is None else f"{100 * of(one):.1f}" for one in mountings)

        measures = [both(lambda one, name=name: one[name]) for name in MEASURED]
        vehicles = next(iter(mountings))["vehicles"]
        cells.append((row["title"], f"{vehicles}", both(lambda one: one["with_return"]), *measures))
        for name, gains in row.items():
            if "than" in name and gains:
                cells.append((f"  {name}", "", "", *(_difference(gains[measure]) for measure in MEASURED)))
    text = table_text(Table(stem, title, columns, tuple(cells)))
    print(text, flush=True)
    write_text(args.out / f"{stem}.txt", text + "\n")
    write_text(args.out / f"{stem}.json", json.dumps(rows, indent=1) + "\n")


def _difference(gain: Mapping) -> str:
    """A difference in points and its 90 % interval."""
    if gain["difference"] is None:
        return "-"
    ends = gain["interval_90"]
    return f"{100 * gain['difference']:+.1f}" + (f" ({100 * ends[0]:+.1f} to {100 * ends[1]:+.1f})" if ends else "")


def _draw_distances(path: Path, results: Mapping[str, dict], detector: str) -> None:
    """Fig. 9: recall at 0.3 by distance, a panel for each sensor."""
    subtitle = f"{detector} at confidence 0.3 in the hard world; bands with fewer than 20 vehicles are left out"
    with sheet(path, 70.0, "Recall by distance from the LiDAR", subtitle) as figure:
        panels = figure.subplots(1, len(results), sharey=True, squeeze=False)[0]
        for axes, (sensor, result) in zip(panels, results.items(), strict=True):
            for name, look in (("baseline", BASELINE_LOOK), ("given", OPTIMISED_LOOK)):
                bands = result["mountings"][name]["by_distance"].items()
                lines = [(band, one["recall_0.3"]) for band, one in bands if one["vehicles"] >= 20]
                middle = [0.5 * sum(map(float, band.removesuffix(" m").split("-"))) for band, _ in lines]
                axes.plot(middle, [100.0 * share for _, share in lines], **look)
            height, tilt = CHOSEN[sensor]
            axes.set_title(f"{sensor}: 2 m, 0° and {height:g} m, {tilt:g}°")
            axes.set_xlabel("Distance [m]")
            axes.set_ylim(0.0, 100.0)
            axes.grid(True)
        panels[0].set_ylabel("Recall [%]")
        panels[0].legend(loc="lower left")


if __name__ == "__main__":
    sys.exit(main())
