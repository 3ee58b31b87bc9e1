"""Small arguments for every chart, and ways to read what was drawn."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from blender_lidar.plots.blind_zones import plot_blind_zones
from blender_lidar.plots.by_distance import plot_by_distance
from blender_lidar.plots.clouds import plot_clouds
from blender_lidar.plots.convergence import plot_convergence
from blender_lidar.plots.occupancy import OccupancyViews, plot_occupancy
from blender_lidar.plots.score_map import plot_score_map

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
CAR = (4.5, 1.8, 1.5)
ROAD = (2.0, 20.3)


def vehicles(seed: int, number: int = 200) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-50.0, 50.0, number), rng.uniform(*ROAD, number)
    return {
        "x_m": x,
        "y_m": y,
        "length_m": rng.uniform(4.0, 12.0, number),
        "width_m": rng.uniform(1.6, 2.5, number),
        "heading_deg": rng.normal(0.0, 2.0, number),
        "distance_m": np.hypot(x, y),
        "detectable": rng.random(number) < 0.6,
        "entropy_bits": rng.uniform(0.0, 1.2, number),
    }


def cloud(seed: int, number: int = 500) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {"xyz": rng.uniform((-50, 2, 0), (50, 20, 3), (number, 3)), "vehicle_id": rng.integers(-1, 5, number)}


def views(share: float, size: tuple[float, float, float] = CAR) -> OccupancyViews:
    rng = np.random.default_rng(3)
    length, width, height = (math.ceil(side / 0.05) for side in size)
    shapes = {"top": (length, width), "side": (length, height), "front": (width, height)}
    return OccupancyViews({view: rng.random(shape) < share for view, shape in shapes.items()}, size)


def score_map_arguments() -> dict[str, object]:
    height, tilt = np.linspace(2.0, 4.5, 6), np.linspace(0.0, 25.0, 6)
    value = 0.8 - 0.05 * (height[:, None] - 4.0) ** 2 - 0.0005 * (tilt - 18.0) ** 2
    return {
        "height_m": height,
        "tilt_deg": tilt,
        "value": value,
        "optimum": (4.0, 18.0),
        "baseline": (2.0, 0.0),
        "baseline_value": float(value[0, 0]),
    }


def chart_arguments() -> dict[str, tuple[object, dict[str, object]]]:
    """Every chart with small arguments of its own."""
    table, other = vehicles(1), vehicles(2)
    both = {"baseline_table": table, "optimised_table": other}
    boxes = vehicles(4, 12)
    seen = np.arange(12) % 3 > 0
    best = np.maximum.accumulate(np.random.default_rng(5).random(50))
    return {
        "convergence": (
            plot_convergence,
            {"evaluation": np.arange(1, 51), "value": best - 0.1, "best": best, "baseline": 0.2},
        ),
        "score_map": (plot_score_map, score_map_arguments()),
        "by_distance": (plot_by_distance, both),
        "blind_zones": (plot_blind_zones, {**both, "sensor_xy": (0.0, 0.0), "carriageway": ROAD}),
        "clouds": (
            plot_clouds,
            {
                "clouds": (cloud(6), cloud(7)),
                "boxes": boxes,
                "detectable": (seen, ~seen),
                "sensor_xy": (0.0, 0.0),
            },
        ),
        "occupancy": (plot_occupancy, {"before": views(0.02), "after": views(0.1)}),
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
