"""What an imperfect sensor changes about the score of one mounting, over several seeds of its noise or units of it.

    python scripts/research/imperfection_effects.py [SCENE.toml] [--sensor RS-16] [--height 4.5] [--tilt-x 20]

Each imperfection is on alone; the searched frames and the mounting, the scene's baseline unless one is given, stay. The
table has what each adds to the score of the perfect sensor, which is its first row: mean over the draws, and standard
deviation between them, 0 where nothing is drawn. Occupancy is the mean of the three views'.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from arguments import SCENES, overrides_of, parser_of, positive, run_script
from blender_lidar.commands.options import add_pose, mounting_from
from blender_lidar.metrics.catalogue import metric_named
from blender_lidar.optimise import vehicle_score
from blender_lidar.run.verdict import metric_values, vehicle_table
from blender_lidar.scene.mounting import pose_at
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, lattice_of, prepare, standing_scenery
from blender_lidar.scoring.evaluation import Evaluator

PERFECT = dict.fromkeys(("range_noise_m", "dropout", "glass_dropout", "unit_spread_deg"), 0.0)
PERFECT["range_at_10_percent_m"] = None
EFFECTS = (
    # name, what is on, what differs from draw to draw (None: nothing)
    ("range noise 0.02 m", {"range_noise_m": 0.02}, "noise_seed"),
    ("range noise 0.05 m", {"range_noise_m": 0.05}, "noise_seed"),
    ("drop-out 0.1", {"dropout": 0.1}, "noise_seed"),
    ("glass drop-out 0.5", {"glass_dropout": 0.5}, "noise_seed"),
    ("glass drop-out 1", {"glass_dropout": 1.0}, None),
    ("10 % seen to 60 m", {"range_at_10_percent_m": 60.0}, None),
    ("10 % seen to 30 m", {"range_at_10_percent_m": 30.0}, None),
    ("unit spread 0.03 deg", {"unit_spread_deg": 0.03}, "unit"),
    ("unit spread 0.1 deg", {"unit_spread_deg": 0.1}, "unit"),
)
OTHER_SCORES = ("detectable [%]", "occupancy [%]", "points")


def main(argv: list[str] | None = None) -> int:
    return run_script("imperfection_effects", lambda: _study(argv))


def _study(argv):
    args = _arguments(argv)
    scenario = load_scenario(args.scene, overrides_of(args))
    mount = mounting_from(args, scenario)
    print_effects(prepare(scenario, mount), mount, args.draws)


def print_effects(site: Site, mount: dict[str, float], draws: int) -> None:
    """Print the table, a row as soon as it is known."""
    perfect = scores(site, mount, PERFECT)
    print(
        f"{site.model.name} at {mount['height_m']:.2f} m, {mount['tilt_x_deg']:.1f} deg; {len(site.search)} frames, "
        f"{draws} draws; per vehicle"
    )
    names = (metric_named(site.scoring.metric).in_unit("objective"), *OTHER_SCORES)
    print(f"{'':<22}" + "".join(f"{name:>24}" for name in names))
    print(f"{'perfect':<22}" + "".join(f"{value:>24.4f}" for value in perfect))
    for name, on, drawn in EFFECTS:
        each = [{drawn: draw} for draw in range(1, draws + 1)] if drawn else [{}]
        added = [scores(site, mount, {**PERFECT, **on, **draw}) - perfect for draw in each]
        spread = np.std(added, axis=0, ddof=1) if len(each) > 1 else np.full(len(names), np.nan if drawn else 0.0)
        cells = (f"{mean:+.4f} (sd {sd:.4f})" for mean, sd in zip(np.mean(added, axis=0), spread, strict=True))
        print(f"{name:<22}" + "".join(f"{cell:>24}" for cell in cells), flush=True)


def scores(site: Site, mount: dict[str, float], sensor_settings: dict[str, float | None]) -> np.ndarray:
    """The objective and `OTHER_SCORES` of a mounting on the searched frames under other settings of [sensor]."""
    sensor = replace(site.scenario.sensor, **sensor_settings)
    scenario, observation, scoring = replace(site.scenario, sensor=sensor), site.observation, site.scoring
    observation = replace(
        observation,
        lattice=lattice_of(sensor),
        imperfections=sensor.imperfections,
        scenery=standing_scenery(scenario, observation.caster, mount),
    )
    table = vehicle_table(pose_at(mount), search=Evaluator(site.search, observation, scoring))
    merit = metric_named(scoring.metric).merit(metric_values(table))
    objective = vehicle_score(merit, table["detectable"], scoring.loss, scoring.reading)
    occupancy = np.mean([table[f"p_{view}"] for view in ("top", "side", "front")], axis=0)
    return np.array(
        [objective.mean(), 100 * table["detectable"].mean(), 100 * occupancy.mean(), table["points"].mean()]
    )


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--sensor")
    parser.add_argument("--frames", type=positive)
    parser.add_argument("--draws", type=positive, default=8)
    add_pose(parser)
    return parser.parse_args(argv)


if __name__ == "__main__":
    sys.exit(main())
