"""The verb commission judged on simulated clouds whose sensor, height and leans are known.

    python scripts/research/commission_judgement.py --clouds 200 --seed 1000

Each cloud is one revolution at the shipped motorway with traffic in the way, of a fifth of the clouds only 0 to 9
vehicles on one side: any of six sensors, a unit with errors of its own (0 to 0.03 degrees), which half of the drivers
know and half do not, a mounting drawn from 2.5 to 6 m and 0 to 22 degrees, an error of all ranges (standard deviation
15 mm), noise, drop-out, weak returns, a crown on half of the roads, and clutter beside half of them. The road's slopes
are drawn too: the leans are against the road. It makes figures of docs/evidence/roadside.md.
"""

from __future__ import annotations

import math

import numpy as np

from arguments import counting, parser_of, positive, run_script
from blender_lidar.detection.judge import sensor_at
from blender_lidar.errors import InputError
from blender_lidar.scene.mounting import Mounting, mounting_from
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.sensors.beams import beam_directions
from blender_lidar.sensors.model import load_model
from blender_lidar.studies.commission import commission
from blender_lidar.studies.road_fit import Estimate

SENSORS = "RS-16", "RS-32", "RS-80", "RS-Ruby-Lite-V2R", "OS1-64", "Pandar40P"
_RANGE_ERROR_M = 0.015


def main(argv: list[str] | None = None) -> int:
    return run_script("commission_judgement", lambda: _judge(argv))


def _judge(argv) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--clouds", type=positive, default=200)
    parser.add_argument("--seed", type=int, default=1000)
    args = parser.parse_args(argv)
    rows, named, refused = [], 0, []
    with counting(args.clouds, "clouds") as advance:
        for number in range(args.clouds):
            name = SENSORS[number % len(SENSORS)]
            points, mounting, error = cloud_of(name, args.seed + number)
            try:
                found = commission([points], [name])
            except InputError as error:
                refused.append(f"{number} {error}")
            else:
                named += name in (found.model.name, *found.as_possible)
                rows.append(_row(found.fit, mounting.pose, error))
            advance(1)
    off, holds, width = np.array(rows).transpose(1, 0, 2)
    print(f"{args.clouds} clouds, {len(refused)} refused {refused}; the sensor is among those named in {named}")
    print("                  median error   90 % of errors below   interval holds   width: median, largest")
    for at, what in enumerate(
        ("height [m]", "tilt about x [deg]", "tilt about y [deg]", "yaw [deg]", "range error [m]")
    ):
        error, wide = np.abs(off[:, at]), width[:, at]
        print(
            f"{what:18s} {np.median(error):10.4f} {np.quantile(error, 0.9):20.4f} {100.0 * holds[:, at].mean():17.1f} %"
            f" {np.median(wide):14.3f} {wide.max():8.3f}"
        )


def cloud_of(name: str, seed: int) -> tuple[np.ndarray, Mounting, float]:
    """One revolution in its sensor's frame (n, 3) [m], the mounting that it is seen from, and the error of ranges."""
    rng = np.random.default_rng([7, seed])
    settings = {
        ("sensor", "name"): name,
        ("sensor", "range_noise_m"): rng.uniform(0.005, 0.03),
        ("sensor", "dropout"): rng.uniform(0.0, 0.03),
        ("sensor", "range_at_10_percent_m"): rng.uniform(60.0, 160.0),
        ("sensor", "unit_spread_deg"): rng.choice([0.0, 0.01, 0.02, 0.03]),
        ("sensor", "unit"): seed,
        ("sensor", "noise_seed"): seed,
        ("traffic", "frames"): 6,
        ("traffic", "holdout"): 0.0,
        ("road", "crown_percent"): rng.choice([0.0, rng.uniform(0.0, 2.5)]),
        ("road", "cross_fall_percent"): rng.uniform(-3.0, 3.0),
        ("road", "grade_percent"): rng.uniform(-3.0, 3.0),
        ("world", "clutter"): rng.choice([0.0, 1.0]),
        ("world", "variety"): 1.0,
        ("world", "variety_seed"): seed,
    }
    settings = {key: value.item() if isinstance(value, np.generic) else value for key, value in settings.items()}
    scenario = load_scenario("i80", {key: (value, key[1]) for key, value in settings.items()})
    site = prepare(scenario)
    drawn = {"height_m": (2.5, 6.0), "tilt_x_deg": (0.0, 22.0), "tilt_y_deg": (-3.0, 3.0), "yaw_deg": (-6.0, 6.0)}
    table = {key: float(rng.uniform(*limits)) for key, limits in drawn.items()}
    mounting = mounting_from(table, scenario.road_map, scenario.baselines[0])
    vehicles = site.search[seed % len(site.search)]
    if rng.random() < 0.2:  # of a fifth the traffic keeps to one side
        vehicles = vehicles.select(np.argsort(vehicles.centre_m[:, 1])[: rng.integers(0, 10)])
    cloud, error = sensor_at(site, mounting).scan(vehicles), float(rng.normal(0.0, _RANGE_ERROR_M))
    points = mounting.pose.to_sensor(cloud.xyz)
    away = np.linalg.norm(points, axis=1) + error
    told = site.observation.lattice.model if seed % 2 else load_model(name)
    return away[:, None] * beam_directions(cloud.azimuth_rad, told.elevation_rad[cloud.ring]), mounting, error


def _row(fit, pose, error: float) -> tuple[list[float], list[bool], list[float]]:
    """Errors, whether the intervals hold, and their widths: of height [m], tilts, yaw [degrees] and ranges [m]."""
    degrees, columns = math.degrees(1.0), []
    for one, true, unit in (
        (fit.height_m, pose.height_m, 1.0),
        (fit.tilt_x, pose.tilt_x, degrees),
        (fit.tilt_y, pose.tilt_y, degrees),
        (fit.yaw or Estimate(0.0, math.pi, 0.0), pose.yaw, degrees),
        (fit.range_error_m, error, 1.0),
    ):
        low, high = one.interval_90
        columns.append((unit * (one.value - true), low <= true <= high, unit * (high - low)))
    return tuple(map(list, zip(*columns, strict=True)))


if __name__ == "__main__":
    raise SystemExit(main())
