"""What an optical centre off the axis, and errors of a unit's rings, do to what is detectable.

    python scripts/research/lens_offset.py --caster embree --frames 20

Beams of the RS-Ruby-Lite-V2R at the shipped motorway, 4.5 m up and tilted 7.2 degrees, start on the axis or 36 mm from
it towards where they look, as a roadside recording shows; and a unit's elevations differ from the table by 0.013
degrees, as the road beside that recording shows. Every frame is cast with both, ray by ray.
"""

from __future__ import annotations

import numpy as np

from arguments import counting, parser_of, positive, run_script
from blender_lidar.casting import caster_class, resolve
from blender_lidar.metrics.vgop import occupancy, to_vehicle_frame
from blender_lidar.optimise import detectable
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import unit_of
from blender_lidar.statistics import block_sums, statistic_interval_90
from blender_lidar.world.shapes import shape
from blender_lidar.world.triangles import place, shape_names

SENSOR, LENS_M, SPREAD_DEG, UNIT = "RS-Ruby-Lite-V2R", 0.036, 0.013, 7
GATE_M = 150.0


def main(argv: list[str] | None = None) -> int:
    return run_script("lens_offset", lambda: _measure(argv))


def _measure(argv) -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=positive, default=20)
    parser.add_argument("--caster", default="auto")
    args = parser.parse_args(argv)
    changes = {("sensor", "name"): SENSOR, ("sensor", "range_gate_m"): GATE_M, ("traffic", "frames"): args.frames}
    scenario = load_scenario("i80", {key: (value, key[1]) for key, value in changes.items()})
    site = prepare(scenario)
    pose = scenario.lidar.mounting({"x_m": 0.0, "y_m": 0.0, "height_m": 4.5, "tilt_x_deg": 7.2}).pose
    model = site.observation.lattice.model
    ways = {
        "on the axis": (beam_lattice(model), 0.0),
        f"{1000 * LENS_M:.0f} mm off it": (beam_lattice(model), LENS_M),
        f"rings off by {SPREAD_DEG} degrees": (beam_lattice(unit_of(model, SPREAD_DEG, UNIT)), 0.0),
    }
    seen = {name: [] for name in ways}
    with counting(len(site.search), "frames") as advance:
        for frame in site.search:
            for name, (lattice, lens_m) in ways.items():
                share = _occupancy(frame, lattice, lens_m, pose, resolve(args.caster, "--caster"))
                seen[name].append(
                    detectable(share, scenario.objective.threshold, scenario.objective.view)[frame.counted]
                )
            advance(1)
    block, counts = site.plan.search_block, np.array([len(one) for one in seen["on the axis"]])
    sums = {name: block_sums(np.array([[one.sum() for one in of]]), block)[0] for name, of in seen.items()}
    weight = block_sums(counts, block)
    first = sums["on the axis"]
    for name, of in sums.items():
        low, high = statistic_interval_90(lambda drawn, of=of: drawn @ (of - first) / (drawn @ weight), weight, 1)
        changed = np.mean(np.concatenate(seen[name]) != np.concatenate(seen["on the axis"]))
        share, gain, ends = 100.0 * of.sum() / weight.sum(), 100.0 * (of - first).sum() / weight.sum(), (low, high)
        between = " to ".join(f"{100.0 * end:+.2f}" for end in ends)
        print(f"{name:28s} {share:6.2f} % detectable, {gain:+.2f} points ({between}); {100.0 * changed:.2f} % changed")


def _occupancy(vehicles, lattice, lens_m: float, pose, caster: str) -> np.ndarray:
    """Occupancy of the three views of each vehicle, (v, 3), by rays of their own origins."""
    corners, owner = [], []
    for row, name in enumerate(shape_names(vehicles)):
        unit = shape(name, "body")
        placed = place(unit.vertices, vehicles.centre_m[[row]], vehicles.size_m[[row]], vehicles.heading_rad[[row]])
        corners.append(placed[0][unit.faces])
        owner.append(np.full(len(unit.faces), row))
    local = lattice.components.reshape(3, -1).T
    level = local * [1.0, 1.0, 0.0]
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    direction, origin = pose.to_world(local), pose.position + lens_m * pose.to_world(level)
    hits = caster_class(caster)(np.concatenate(corners), closed=True).cast(origin, direction)
    met = np.flatnonzero((hits.triangle >= 0) & (hits.distance <= GATE_M))
    of = np.concatenate(owner)[hits.triangle[met]]
    points = origin[met] + hits.distance[met, None] * direction[met]
    return occupancy(to_vehicle_frame(points, vehicles.centre_m, vehicles.heading_rad, of), of, vehicles.size_m)


if __name__ == "__main__":
    raise SystemExit(main())
