"""Small arguments for every chart, and ways to read what was drawn."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from blender_lidar.report.cloud_figures import Found, Sight, plot_clouds, plot_detections
from blender_lidar.report.coverage_figures import plot_blind_zones
from blender_lidar.report.plan import Stand
from blender_lidar.report.run_figures import plot_by_approach, plot_by_distance, plot_convergence, plot_score_map
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.verdict import ScoreMap
from blender_lidar.scene.mounting import COORDINATES
from blender_lidar.traffic.boxes import Boxes, detected_boxes
from tests.small_scene import mounting

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADINGS = {"title": "A title", "subtitle": "And a subtitle"}
CAR = (4.5, 1.8, 1.5)
STRAIGHT = RoadSettings(lanes=5)
ROAD = map_of(STRAIGHT)


def table(seed: int, number: int = 200) -> dict[str, np.ndarray]:
    """A vehicle table, of the columns that charts are made of."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-50.0, 50.0, number), rng.uniform(*ROAD.edges_t, number)
    return {
        "x_m": x,
        "y_m": y,
        "length_m": np.full(number, CAR[0]),
        "width_m": np.full(number, CAR[1]),
        "heading_deg": np.zeros(number),
        "distance_m": np.hypot(x, y),
        "detectable": rng.random(number) < 0.6,
        "entropy_bits": rng.uniform(0.0, 1.2, number),
    }


def vehicles(seed: int, number: int = 12) -> Boxes:
    rng = np.random.default_rng(seed)
    whole = np.zeros(number, dtype=int)
    return Boxes(
        frame=7,
        time_s=0.0,
        vehicle_id=np.arange(number),
        class_index=whole,
        centre_m=rng.uniform((-50.0, 2.0, 1.0), (50.0, 20.0, 1.0), (number, 3)),
        size_m=rng.uniform((4.0, 1.6, 1.5), (12.0, 2.5, 1.5), (number, 3)),
        heading_rad=rng.normal(0.0, 0.03, number),
        lane=whole,
    )


def mount(height_m: float, tilt_x_deg: float = 0.0, **others: float) -> dict[str, float]:
    """Six coordinates [m, degrees]."""
    return dict.fromkeys(COORDINATES, 0.0) | {"height_m": height_m, "tilt_x_deg": tilt_x_deg} | others


def scores(value: float, height_m: float, tilt_x_deg: float) -> dict:
    """A mounting as result.json has it."""
    values = dict.fromkeys(("objective_per_vehicle", "objective_per_vehicle_as_searched"), value)
    return {"deployment": mount(height_m, tilt_x_deg), **values}


def score_map() -> ScoreMap:
    """A hill with its top at 4 m and 20 degrees."""
    height, tilt = np.linspace(2.0, 4.5, 6), np.linspace(0.0, 25.0, 6)
    value = 0.8 - 0.05 * (height[:, None] - 4.0) ** 2 - 0.0005 * (tilt - 20.0) ** 2
    return ScoreMap(height, tilt, value, value, value[..., None], np.ones(1, dtype=int))


def run_of(seen: dict | None = None, /, *, metric: str = "pe-vgop", **changes: object) -> RunFolder:
    """A run in memory, as far as charts show it, with a vehicle table for both mountings and changes of its result."""
    result = {
        "sensor": "RS-16",
        "metric": metric,
        "range_gate_m": 60.0,
        "vehicles": 1,
        "frames": 1,
        "search": "de-pso",
        "seed": 1,
        "reading": "corrected",
        "holdout": None,
        **scores(0.8, 4.0, 20.0),
        "baseline": scores(0.2, 2.0, 0.0),
        "lidars": [{"name": "", "installer": False}],
    }
    run = RunFolder("nowhere")
    run.result = result | changes
    tables = (table(1), table(2)) if seen is None else (seen, seen)
    run.baseline, run.optimised = ({"split": np.full(len(one["detectable"]), "search"), **one} for one in tables)
    return run


def approach_groups() -> list[dict[str, object]]:
    """Groups as result.json has them: two approaches, one with movements, the last without an interval."""
    names = {"north": "approach", "north, left": "movement", "north, straight": "movement", "west": "approach"}
    return [
        {
            **{"by": by, "name": name, "boxes": 40 + at, "before": 0.3 + 0.1 * at, "after": 0.6 + 0.1 * at},
            "before_interval_90": [0.2 + 0.1 * at, 0.4 + 0.1 * at],
            "after_interval_90": [0.5 + 0.1 * at, 0.7 + 0.1 * at] if by == "movement" else None,
        }
        for at, (name, by) in enumerate(names.items())
    ]


def history() -> dict[str, np.ndarray]:
    """What a search tried: numbers, objectives and the best so far."""
    best = np.maximum.accumulate(np.random.default_rng(5).random(50))
    return {"evaluation": np.arange(1.0, 51.0), "objective": best - 0.1, "best": best}


def cloud(seed: int, number: int = 500) -> SimpleNamespace:
    rng = np.random.default_rng(seed)
    xyz = rng.uniform((-50, 2, 0), (50, 20, 3), (number, 3))
    return SimpleNamespace(xyz=xyz, vehicle_id=rng.integers(-1, 5, number))


def cloud_arrays(seed: int, number: int) -> tuple[np.ndarray, np.ndarray]:
    found = cloud(seed, number)
    return found.xyz, found.vehicle_id


def sights(seen: np.ndarray, *, number: int = 500) -> tuple[Sight, Sight]:
    return (
        Sight("Baseline", "height 2.00 m, tilt 0.0°", [Stand("", (0.0, 0.0))], *cloud_arrays(6, number), seen),
        Sight("Optimised", "height 4.10 m, tilt 0.0°", [Stand("", (0.0, 0.0))], *cloud_arrays(7, number), ~seen),
    )


def detections(number: int = 300) -> dict[str, object]:
    """Arguments of the chart of detections: of ten vehicles that count and two others each second one is found."""
    frame = replace(vehicles(4), counted=np.arange(12) < 10)
    shown = frame.select(np.arange(12) % 2 == 0)
    boxes = detected_boxes(
        np.concatenate([shown.centre_m, [(20.0, 25.0, 1.0)]]),
        np.concatenate([shown.size_m, [(4.0, 1.8, 1.5)]]),
        np.append(shown.heading_rad, 0.3),
        np.zeros(7, np.int8),
        np.full(7, 0.8),
    )
    vehicle, ignored = np.array([0, 2, 4, 6, 8, -1, -1]), np.arange(7) == 5
    of_mountings = {
        "Baseline": ((mounting(mount(2.0)),), cloud(6, number)),
        "Given": ((mounting(mount(4.0)),), cloud(7, number)),
    }
    found = [Found(name, *seen, boxes, vehicle, ignored) for name, seen in of_mountings.items()]
    return {"frame": frame, "found": found, **HEADINGS}


def chart_arguments() -> dict[str, tuple[object, dict[str, object]]]:
    """Every chart with small arguments of its own."""
    run = {"run": run_of()}
    return {
        "convergence": (plot_convergence, {**run, "history": history()}),
        "score_map": (plot_score_map, {**run, "score_map": score_map()}),
        "by_distance": (plot_by_distance, run),
        "blind_zones": (plot_blind_zones, {**run, "road": ROAD}),
        "by_approach": (plot_by_approach, {"result": run_of(groups=approach_groups()).result}),
        "clouds": (plot_clouds, {"vehicles": vehicles(4), "sights": sights(np.arange(12) % 3 > 0), **HEADINGS}),
        "detections": (plot_detections, detections()),
    }


CHARTS = sorted(chart_arguments())


def grey_pixels(path: Path) -> np.ndarray:
    """A PNG as (rows, columns) of lightness, 0 to 1, its signature checked."""
    from matplotlib.image import imread

    assert path.read_bytes().startswith(PNG_SIGNATURE)
    return imread(path)[..., :3] @ (0.299, 0.587, 0.114)


def lightness(colour) -> np.ndarray:
    """Lightness of each colour, 0 to 1, as a grey print gives it."""
    from matplotlib.colors import to_rgba_array

    return to_rgba_array(colour)[:, :3] @ (0.299, 0.587, 0.114)


def words(figure) -> str:
    """Everything that is written on a figure."""
    from matplotlib.text import Text

    return "\n".join(text.get_text() for text in figure.findobj(Text))
