"""Draws recorded roadside clouds beside our shapes: scores of vehicles, how far asphalt returns, errors of rings.

    python scripts/research/draw_roadside.py --roadside DIR --draw DIR

The roadside DIR is as for `roadside_clouds.py`. Vehicles, of confidence A to C, and asphalt are of all revolutions,
errors of rings of those in float16. Prints the numbers of the first two panels as Markdown tables.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from arguments import parser_of, run_script
from blender_lidar.clouds.rings import table_rings
from blender_lidar.metrics.vgop import to_vehicle_frame
from blender_lidar.report.figure import FAINT, INK, SMALL_PT, legend_below, sheet
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import Imperfections, detection_range_m
from blender_lidar.sensors.model import load_model
from blender_lidar.studies.commission import Commissioned, commission
from blender_lidar.studies.compare import median_interval
from blender_lidar.studies.recorded import NO_POINT, Firings
from blender_lidar.world.meshes import REFLECTIVITY, ROAD
from compare_roadside import DETAIL, OLD, V2R_M, Case, _in, errors, roadside_cases
from roadside_clouds import SECTOR_RAD, roadside_frames

BANDS_M = (0.0, 10.0, 20.0, 30.0, 50.0, 75.0, 110.0, 150.0)
ROAD_M = np.arange(5.0, 85.0, 5.0)  # edges of bands of range
CARRIAGEWAY_M, BESIDE_RAD = (5.0, 15.8), np.radians(1.2)  # across, where no hedge hides it; and off a vehicle
LOOKS = {
    "real": {"color": INK, "marker": "D"},
    "simulated, all return": {"color": "#cf7f1b", "marker": "s"},
    f"simulated, 10 % seen to {V2R_M:.0f} m": {"color": "#173f70", "marker": "o"},
}
LINE = {"markersize": 3.5, "linewidth": 1.0}
SHOWN = (("car", 5.0, 20.0), ("truck", 10.0, 75.0), ("car", 30.0, 50.0), ("car", 50.0, 75.0))  # class, from and to [m]


def main(argv: list[str] | None = None) -> int:
    return run_script("draw_roadside", lambda: _draw(argv))


def _draw(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--roadside", required=True, type=Path, metavar="DIR")
    text = "writes roadside.png, curves alone, and points.png, real points of four vehicles beside simulated ones"
    parser.add_argument("--draw", required=True, type=Path, metavar="DIR", help=text)
    args = parser.parse_args(argv)
    cases = list(roadside_cases(args.roadside, ("car", "van", "truck"), BANDS_M[-1]))
    halves = np.load(args.roadside / "frames_float16.npz")
    clouds = [halves[name].astype(float)[:, [1, 0, 2]] * [-1.0, 1.0, 1.0] for name in halves.files]
    scores, road = list(score_bands(cases)), road_returns(args.roadside)
    print("\n".join(_tables(scores, *road)))
    args.draw.mkdir(parents=True, exist_ok=True)
    _curves(args.draw / "roadside.png", scores, *road, commission(clouds, halves.files))
    _points(args.draw / "points.png", args.roadside, cases)


def score_bands(cases: Sequence[Case]) -> Iterator[tuple[str, str, list[dict]]]:
    """By band of range, with how many cars and vans: PE-VGOP of the median one, for each of `LOOKS`, over frames."""
    every, weak = errors(cases, OLD._replace(range_m=np.inf)), errors(cases, OLD)
    columns = (every["real_entropy_bits"], every["simulated_entropy_bits"], weak["simulated_entropy_bits"])
    for band in pairwise(BANDS_M):
        mine = _in(every, band) & np.isin(every["class"], ["car", "van"])
        medians = [median_interval(one[mine], every["frame"][mine]) for one in columns]
        yield f"{band[0]:.0f}-{band[1]:.0f}", f"{mine.sum()}", medians


def road_returns(folder: Path) -> np.ndarray:
    """Beams at the carriageways by range, as no vehicle is near: how many, returned, predicted to return; (3, b)."""
    lattice, counts = beam_lattice(load_model("RS-Ruby-Lite-V2R")), np.zeros((3, len(ROAD_M) - 1))
    for frame, pose, _ in roadside_frames(folder):
        boxes, firings = frame.boxes, Firings(frame.points, table_rings(pose.to_sensor(frame.points), lattice)[0], pose)
        middle = np.sign(boxes.centre_m[0, 1]) * np.mean(CARRIAGEWAY_M)
        strip = np.array([0.0, middle, -0.005]), np.array([200.0, np.ptp(CARRIAGEWAY_M), 0.01])
        rays, entry = firings.towards(*strip, 0.0)
        x, y, _ = pose.rotation.T @ rays.direction.T
        told = np.abs(np.arctan2(y, x)) < SECTOR_RAD
        for (x, y, _), size in zip(boxes.centre_m, boxes.size_m, strict=True):
            away, half = np.hypot(x, y), 0.5 * np.hypot(*size[:2])
            aside = np.abs(np.angle((rays.direction[:, 0] + 1j * rays.direction[:, 1]) / (x + 1j * y)))
            told &= (aside > np.arctan2(half, away) + BESIDE_RAD) | (entry < away - half)
        back = np.abs(rays.range_m - entry) < 0.15 * entry
        told &= back | (rays.point == NO_POINT)  # what something else stopped says nothing of the road
        seen = entry <= detection_range_m(V2R_M, REFLECTIVITY[ROAD], np.abs(rays.direction[:, 2]))
        counts += [np.histogram(entry[told & which], ROAD_M)[0] for which in (True, back, seen)]
    return counts


def _tables(scores, beams, back, seen) -> Iterator[str]:
    yield f"| range [m] | vehicles | {' | '.join(LOOKS)} |\n|---|---|---|---|---|"
    for band, number, medians in scores:
        cells = ["{:.3f} ({:.3f} to {:.3f})".format(one["median"], *one["interval_90"]) for one in medians]
        yield f"| {' | '.join([band, number, *cells])} |"
    yield "\n| range on asphalt [m] | beams | return [%] | predicted [%] |\n|---|---|---|---|"
    for (low, high), number, *shares in zip(pairwise(ROAD_M), beams, back / beams, seen / beams, strict=True):
        yield f"| {low:.0f}-{high:.0f} | {number:,.0f} | {100.0 * shares[0]:.1f} | {100.0 * shares[1]:.1f} |"


def _curves(path: Path, scores: Sequence, beams, back, seen, found: Commissioned) -> None:
    subtitle = "RS-Ruby-Lite-V2R in a motorway's median, 3.5 m up, 11 revolutions; bars: 90 % intervals"
    with sheet(path, 85.0, "A roadside LiDAR beside its simulation", subtitle) as figure:
        bands, road, rings = figure.subplots(1, 3, width_ratios=(2, 1, 1))
        for number, (name, look) in enumerate(LOOKS.items()):
            x, mine = np.arange(len(scores)) + 0.15 * (number - 1), [medians[number] for *_, medians in scores]
            bands.vlines(x, *np.array([one["interval_90"] for one in mine]).T, color=look["color"], linewidth=1.2)
            bands.plot(x, [one["median"] for one in mine], label=name, **look, **LINE)
        bands.set_xticks(range(len(scores)), [f"{band}\n{number}" for band, number, _ in scores], fontsize=5.5)
        bands.set(xlabel="Range [m], and vehicles", ylabel="PE-VGOP, median [bits]", title="Cars and vans")
        middle, (real, _, weak) = 0.5 * (ROAD_M[1:] + ROAD_M[:-1]), LOOKS.values()
        for share, look in ((back / beams, real), (seen / beams, weak)):
            road.plot(middle, 100.0 * share, **look, **LINE)
        road.set(xlabel="Range [m]", ylabel="Beams that return [%]", title="Asphalt")
        known = np.isfinite(found.fit.ring_sd_rad)
        error, sd = (np.degrees(one[known]) for one in (-found.fit.ring_error_rad, found.fit.ring_sd_rad))
        look = {"fmt": "o", "color": "#173f70", "ecolor": "#a9c3e0", "markersize": 2.0, "elinewidth": 0.8}
        rings.errorbar(np.degrees(found.model.elevation_rad[known]), error, yerr=1.645 * sd, **look)
        rings.axhline(0.0, color=INK, linewidth=0.8)
        rings.set(xlabel="Elevation [deg]", ylabel="Correction [deg]", title="Rings on the road")
        for axes in (bands, road, rings):
            axes.grid(visible=True, axis="y")
        for axes in (bands, road):
            axes.set_ylim(bottom=0.0)
        legend_below(figure, bands.lines, 3)


def _points(path: Path, folder: Path, cases: Sequence[Case]) -> None:
    clouds = [frame for frame, *_ in roadside_frames(folder)]
    rows = [(case, row) for case in cases if case.real["frame"][0] == "raw" for row in range(len(case.real["sure"]))]
    with sheet(path, 150.0, "Vehicles seen from the side", "Left: real; right: simulated, weak returns lost") as figure:
        for panels, (name, near, far) in zip(figure.subplots(4, 2), SHOWN, strict=True):
            of = lambda key, pair: pair[0].real[key][pair[1]]  # noqa: E731
            fits = [one for one in rows if of("class", one) == name and near <= of("distance_m", one) < far]
            best = min(fits, key=lambda one: (of("sure", one), -of("real_points", one)))
            paired, boxes = best[0].paired, clouds[best[0].number].boxes
            box = int(np.flatnonzero(boxes.vehicle_id == int(of("vehicle_id", best)))[0])
            distance, hit = paired.returned(best[0].seen[DETAIL], Imperfections(range_at_10_percent_m=V2R_M))
            for axes, away, which in zip(panels, (paired.rays.range_m, distance), (paired.real, hit), strict=True):
                mine = which & ~paired.hidden & (paired.box == box)
                points = paired.rays.origin[mine] + away[mine, None] * paired.rays.direction[mine]
                x, _, z = to_vehicle_frame(points, boxes.centre_m[box], float(boxes.heading_rad[box])).T
                length, _, height = 0.5 * boxes.size_m[box]
                outline = [-length, length, length, -length, -length], [-height, -height, height, height, -height]
                axes.plot(*outline, color=FAINT, linewidth=0.8)
                axes.scatter(x, z, s=1.5, color="#173f70", linewidths=0.0)
                title = f"{name}, {of('distance_m', best):.0f} m: {mine.sum():,} points; x and z [m]"
                axes.set_title(title, fontsize=SMALL_PT)
                axes.set(aspect="equal")


if __name__ == "__main__":
    sys.exit(main())
