"""Small arguments for every chart, and ways to read what was drawn."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from blender_lidar.plots.agreement import Against, Decline, plot_against, plot_declines
from blender_lidar.plots.blind_zones import plot_blind_zones
from blender_lidar.plots.by_distance import plot_by_distance
from blender_lidar.plots.changes import Bands, Mean, Point, plot_before_after, plot_effects, plot_settings
from blender_lidar.plots.clouds import plot_clouds
from blender_lidar.plots.convergence import plot_convergence
from blender_lidar.plots.near_best import GainMap, plot_gain_maps
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


def decline(name: str, seed: int) -> Decline:
    rng = np.random.default_rng(seed)
    distance_m, mean = rng.uniform(3.0, 60.0, 80), np.linspace(1.0, 0.0, 5)
    values = 1.0 - distance_m / 50.0 + rng.normal(0.0, 0.1, 80)
    return Decline(
        name, distance_m, values, np.arange(5.0, 50.0, 10.0), mean, mean - 0.1, np.append(mean[:-1] + 0.1, np.nan)
    )


def against(name: str, unit: str) -> Against:
    rng = np.random.default_rng(3)
    values = rng.uniform(0.0, 1.5, 60)
    performance = np.clip(0.5 * values + rng.normal(0.0, 0.1, 60), 0.0, 1.0)
    return Against(
        name, unit, values, performance, (np.array([0.0, 0.7, 1.5]), np.array([0.1, 0.4, 0.7])), "0.85 (0.82 to 0.88)"
    )


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


def gain_map(name: str, interval: bool = True) -> GainMap:
    """A round hill whose top is at 4 m and 18 degrees."""
    height, tilt = np.linspace(2.0, 4.5, 6), np.linspace(0.0, 25.0, 6)
    share = 1.0 - 0.1 * (height[:, None] - 4.0) ** 2 - 0.002 * (tilt - 18.0) ** 2
    ends = ((3.9, 4.2), (15.0, 20.0)) if interval else (None, None)
    rivals = {"the paper's Table II": (4.1, 19.0), "DE-PSO": (4.0, 18.5), "baseline": (2.0, 0.0)}
    return GainMap(name, height.tolist(), tilt.tolist(), share.tolist(), (4.0, 20.0), *ends, rivals)


def band_changes(name: str, bands: int) -> Bands:
    names = [f"{20 * band}-{20 * band + 20} m" for band in range(bands)]
    means = [Mean(0.1 * band - 0.1, 0.1 * band - 0.2, 0.1 * band) for band in range(bands)]
    return Bands(name, names, [50.0] * bands, [100.0 - 10.0 * band for band in range(bands)], means)


def settings_points() -> list[Point]:
    return [
        Point("as the scene has it", 20.0, 15.0, 25.0, ""),
        Point("setback 5 m", 25.0, math.nan, math.nan, "4.0 m"),
        Point("C as printed: a miss earns 1", 0.0, math.nan, math.nan, "2.0 m"),
    ]


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
        "declines": (
            plot_declines,
            {
                "metrics": [decline(name, seed) for seed, name in enumerate(("a", "b", "c", "d", "e"))],
                "detectors": [decline("one: confidence x IoU", 8), decline("other: confidence x IoU", 9)],
            },
        ),
        "against": (
            plot_against,
            {
                "metrics": [against("a", ""), against("b", "bits"), against("c", "points/m²"), against("d", "m")],
                "label": "Confidence x IoU",
            },
        ),
        "gain_maps": (plot_gain_maps, {"maps": [gain_map("RS-16"), gain_map("RS-80", interval=False)]}),
        "before_after": (
            plot_before_after,
            {
                "sensors": [band_changes("RS-16", 3), band_changes("RS-80", 8)],
                "other": band_changes("RS-80 evenly spaced", 8),
                "share_label": "Detectable share [%]",
                "change_label": "Change [bits]",
            },
        ),
        "effects": (
            plot_effects,
            {
                "bands": band_changes("", 4).bands,
                "effects": {name: band_changes("", 4).change for name in ("height", "tilt", "uneven spacing")},
                "total": ("all of the change", band_changes("", 4).change),
                "label": "Change [bits]",
            },
        ),
        "settings": (
            plot_settings,
            {
                "sensors": {"RS-16": settings_points(), "RS-80": settings_points()[:1]},
                "published": {"RS-16": 19.0, "RS-80": 9.0},
                "label": "Best tilt [deg]",
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
