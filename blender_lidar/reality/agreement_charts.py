"""The pictures of a comparison with detectors, drawn from its findings: the paper's Figs. 5 and 6 for our cars."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..plots.agreement import Against, Decline, plot_against, plot_declines
from ..study.statistics import interval_90
from .agreement import resampling_of
from .association import group_means
from .detections import Detector
from .detector_study import Findings
from .isotonic import isotonic_fit
from .resampled_cars import FEWEST_IN_BAND, Draws

_BAND_M = 10.0
BY_DISTANCE = "by_distance.png"


def draw_charts(findings: Findings, draws: Draws, file: Callable[[str], Path]) -> list[str]:
    """Draw every chart of the main set; returns the names of the files.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    mine = findings.main.member
    about = f"{findings.main.name}: {int(mine.sum())} cars"
    means = f"means over {_BAND_M:g} m with at least {FEWEST_IN_BAND} cars, 90 % intervals"
    detectors = [
        _decline(findings, draws, f"{one.name}: confidence x IoU", one.performance, mine & one.in_range)
        for one in findings.judged.detectors[:2]
    ]
    metrics = [
        _decline(findings, draws, one.name, one.merit(findings.judged.cars.scores[one.name]), mine)
        for one in findings.metrics
    ]
    names = []
    drawn = [one for one in metrics if one is not None]
    if drawn:
        names.append(BY_DISTANCE)
        plot_declines(
            file(BY_DISTANCE),
            drawn,
            [one for one in detectors if one is not None],
            title="Fig. 5: metrics and detectors over distance",
            subtitle=f"{about}, {means}; metrics that are good when low are turned over",
        )
    for detector in findings.judged.detectors:
        panels = _against(findings, detector)
        if panels:
            names.append(_file_name(detector.name, names))
            plot_against(
                file(names[-1]),
                panels,
                label="Confidence x IoU",
                title=f"Fig. 6: metrics against {detector.name}, car by car",
                subtitle=f"{about}, those in its range; missed cars at 0; Spearman's correlation with 90 % interval",
            )
    return names


def _decline(findings: Findings, draws: Draws, name: str, values: np.ndarray, mine: np.ndarray) -> Decline | None:
    """One quantity of the cars that a mask picks, scaled by its band means; None with less than two bands."""
    distance_m, values = findings.judged.cars.boxes.distance_m[mine], values[mine]
    band = np.floor(distance_m / _BAND_M).astype(np.int64)
    count = np.bincount(band) if len(band) else np.zeros(0, dtype=np.int64)
    used = np.flatnonzero(count >= FEWEST_IN_BAND)
    if len(used) < 2:
        return None
    resampling = resampling_of(findings.judged, mine, draws)
    weights = np.ones((1, len(values))) if resampling is None else resampling.weights
    means = group_means(values, band, len(count), weights)[:, used]
    lowest, highest = means[0].min(), means[0].max()
    scale = highest - lowest if highest > lowest else 1.0
    means, values = (means - lowest) / scale, (values - lowest) / scale
    ends = np.array([_interval(column[1:]) for column in means.T])
    return Decline(name, distance_m, values, (used + 0.5) * _BAND_M, means[0], ends[:, 0], ends[:, 1])


def _interval(resampled: np.ndarray) -> tuple[float, float]:
    known = resampled[np.isfinite(resampled)]
    return interval_90(known) if len(known) > 1 else (np.nan, np.nan)


def _against(findings: Findings, detector: Detector) -> list[Against]:
    mine = findings.main.member & detector.in_range
    found = {
        one.metric: one.statistics["spearman"]
        for one in findings.agreements
        if one.detector == detector.name and one.of_set == findings.main.name
    }
    panels = []
    for metric in findings.metrics:
        if metric.name not in found:
            continue
        values, performance = findings.judged.cars.scores[metric.name][mine], detector.performance[mine]
        knots, fitted = isotonic_fit(metric.merit(values), performance)
        curve = (metric.merit(knots), fitted)  # turned back
        panels.append(Against(metric.name, metric.unit, values, performance, curve, found[metric.name].text()))
    return panels


def _file_name(detector: str, taken: list[str]) -> str:
    """A file's name with the detector's, as far as file systems allow, that is not taken."""
    stem = "against_" + re.sub(r"[^A-Za-z0-9._-]+", "_", detector)
    stems = (stem if number == 1 else f"{stem}_{number}" for number in range(1, len(taken) + 2))
    return next(f"{one}.png" for one in stems if f"{one}.png" not in taken)
