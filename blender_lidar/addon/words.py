"""The panel's words where those of a scene file do not serve: labels, tooltips and what is said of each choice."""

import math

from ..metrics.catalogue import METRICS
from ..names import METRIC_NAMES
from ..sensors.model import load_model, model_names

CALLED = {
    "path": "File",
    "name": "Model",
    "rotation_hz": "Turns / s",
    "grade_percent": "Grade (%)",
    "cross_fall_percent": "Cross Fall (%)",
    "crown_percent": "Crown (%)",
    "range_at_10_percent_m": "Range at 10 %",
    "holdout": "Held-Out Share",
}
PANELS = {  # in which panel the settings of a table are
    "traffic": "Traffic",
    "world": "Traffic",
    "road": "Road and File",
    "region": "Road and File",
    "objective": "Score",
    "baseline": "Score, Baseline",
    "search": "Optimize",
    "model": "Advanced",
    "sensor": "Sensor",
    "deployment": "Sensor",
}
TOOLTIPS = {
    "path": "Recording of traffic (NGSIM, SUMO, tables and others) or a scene file (.toml)",
    "format": "Format of the recording; Auto finds it from the first lines",
    "origin_m": "Where the road begins in the recording's own coordinates: two numbers, such as 565432.1, 4184321.9",
    "heading_deg": "Direction of the road in the recording's own coordinates, counter-clockwise from their x axis",
    "time_step_s": "Time from one frame number to the next in a table without times; 0 leaves it to the file",
    "leave_out": "Vehicles that are neither shown, scanned nor counted: their numbers, such as 12, 56",
    "frames": "Number of instants that are searched, spread evenly over the recording",
    "block_s": "Length of the blocks of time that intervals resample; 0 takes as long as vehicles stay in view",
    "station_m": "Where along the recording the LiDAR's part of the road begins",
    "right_edge_m": "Right edge of the carriageway in the recording's coordinates",
    "setback_m": "Distance of the LiDAR's line, y = 0, from the edge of the road",
    "ground": "Let scans have returns from the road; switch it off where you have ground of your own",
    "threshold": "Least share of a vehicle's sides that must be hit for it to count as detectable",
    "particles": "Mountings that are tried at once",
    "iterations": "How often they move on; more takes longer and finds better",
    "rotation_hz": "Turns per second; 0 takes the model's own",
    "range_gate_m": "How far the LiDAR is to see vehicles; 0 takes the model's range",
    "unit": "Number of the unit: with a Unit Spread each has slightly different beams",
    "seed": "Another number draws other random steps of the search",
}
CHOICES = {
    "auto": "The fastest that is installed: raster, embree or bvh",
    "raster": "Our own rasterizer: the fastest; needs Numba, which is in the fast zip",
    "embree": "Intel Embree: fast with many triangles; needs embreex, which is in the fast zip",
    "bvh": "Blender's own search tree; needs nothing",
    "exact": "Double precision, triangle by triangle: the slowest, to check the others with",
    "box": "Plain boxes",
    "body": "Bodies with hood, cabin and wheels",
    "detailed": "Bodies of a few hundred triangles",
}


def _of_sensor(name: str) -> str:
    model = load_model(name)
    low, high = (math.degrees(model.elevation_rad[end]) for end in (0, -1))
    text = f"{model.rings} rings from {low:.1f}° to {high:.1f}°, range {model.range_max_m:g} m"
    return f"{text}, azimuth step {360.0 / model.columns():.2f}° at {model.default_rotation_hz:g} Hz"


def _metric_item(name: str) -> tuple[str, str, str]:
    label = f"{METRICS[name].label[:1].upper()}{METRICS[name].label[1:]}"
    return name, label, f"{label}: {METRICS[name].tells}"


SENSORS = [(name, name, _of_sensor(name)) for name in model_names()]
METRIC_ITEMS = [_metric_item(name) for name in METRIC_NAMES]
