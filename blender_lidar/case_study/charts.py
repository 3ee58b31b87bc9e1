"""The case study's pictures, drawn from its results."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import nan
from pathlib import Path

import numpy as np

from ..plots.changes import Bands, Mean, Point, plot_before_after, plot_effects, plot_settings
from ..plots.near_best import GainMap, plot_gain_maps
from .distance import effects_shown
from .published import SENSORS
from .sensitivity import setting_of


def draw_charts(result: Mapping, file: Callable[[str], Path], evenly_spaced: str) -> list[str]:
    """Draw every chart; returns the names of the files.

    Parameters
    ----------
    result : mapping
        What `reproduce` returns.
    file : callable
        Path of a file by its name.
    evenly_spaced : str
        What the evenly spaced sensor is called in Fig. 9's rows.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    about = f"{result['reading']} reading, {result['frames']} frames, intervals from {result['blocks']} blocks of time"
    judged = f"{result['judged_frames']} {result['judged_on']} frames in {result['judged_blocks']} blocks of time"
    plot_gain_maps(
        file("table2.png"),
        [_gain_map(sensor, of) for sensor, of in result["sensors"].items()],
        title="Table II: where each sensor wants to hang",
        subtitle=about,
    )
    plot_before_after(
        file("fig9.png"),
        [_bands(result, sensor) for sensor in SENSORS],
        _bands(result, evenly_spaced),
        share_label="Detectable share [%]",
        change_label="Change of the entropy\n[bits per vehicle]",
        title="Fig. 9: what is seen, by distance",
        subtitle=f"{judged}, 90 % intervals by Student's t; evenly spaced beams at RS-80's optimum",
    )
    rows = [row for row in result["spacing"] if row["measure"] == "entropy_bits" and row["band"] != "all"]
    plot_effects(
        file("spacing.png"),
        [row["band"] for row in rows],
        {name: [_mean(row[effect]) for row in rows] for effect, name in effects_shown(rows).items()},
        ("all of the change", [_mean(row["change"]) for row in rows]),
        label="Change of the entropy\n[bits per vehicle]",
        title="RS-80: what height, tilt and uneven beams make of the change",
        subtitle=f"{judged}, 90 % intervals by Student's t; against evenly spaced beams",
    )
    plot_settings(
        file("sensitivity.png"),
        {sensor: _points(result, sensor) for sensor in SENSORS},
        {sensor: of["published"]["tilt_deg"] for sensor, of in result["sensors"].items()},
        label="Best tilt across the road [deg]",
        title="What the paper leaves unstated, one setting at a time",
        subtitle=f"{result['effort']['sensitivity_frames']} frames; the best height is noted where it is not the "
        "highest one",
    )
    return ["table2.png", "fig9.png", "spacing.png", "sensitivity.png"]


def _gain_map(sensor: str, of: Mapping) -> GainMap:
    values = np.array(of["map"]["per_vehicle"])
    gain = of["gain"] if of["gain"] > 0.0 else nan
    published, search = of["published"], of["de_pso"]
    return GainMap(
        name=sensor,
        height_m=of["map"]["height_m"],
        tilt_deg=of["map"]["tilt_deg"],
        share=np.nan_to_num((values - of["baseline_per_vehicle"]) / gain),
        optimum=(of["height_m"], of["tilt_deg"]),
        height_interval=of["height_interval_90"],
        tilt_interval=of["tilt_interval_90"],
        rivals={
            "the paper's Table II": (published["height_m"], published["tilt_deg"]),
            "DE-PSO": (search["height_m"], search["tilt_x_deg"]),
            "baseline": tuple(of["baseline_mounting"]),
        },
    )


def _bands(result: Mapping, sensor: str) -> Bands:
    rows = [row for row in result["fig9"] if row["sensor"] == sensor and row["band"] != "all"]
    shares = [row for row in rows if row["measure"] == "detectable"]
    return Bands(
        name=sensor,
        bands=[row["band"] for row in shares],
        before=[100.0 * row["baseline"] for row in shares],
        after=[100.0 * row["optimised"] for row in shares],
        change=[_mean(row["change"]) for row in rows if row["measure"] == "entropy_bits"],
    )


def _mean(found: Mapping) -> Mean:
    return Mean(found["mean"], *(found["interval_90"] or (nan, nan)))


def _points(result: Mapping, sensor: str) -> list[Point]:
    bound = max(result["sensors"][sensor]["map"]["height_m"])
    return [
        Point(
            setting=" ".join(setting_of(row)).strip(),
            value=row["tilt_deg"],
            low=nan if row["tilt_low_deg"] is None else row["tilt_low_deg"],
            high=nan if row["tilt_high_deg"] is None else row["tilt_high_deg"],
            note="" if row["height_m"] == bound else f"{row['height_m']:.1f} m",
        )
        for row in result["sensitivity"]
        if row["sensor"] == sensor and not row["note"]
    ]
