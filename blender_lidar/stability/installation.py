"""Findings on an installer's errors: what the mounting loses, and whether another one would forgive more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

import numpy as np

from ..settings import COORDINATES, Tolerance
from ..study.evaluation import Evaluator
from ..study.tolerance import installed, losses_over_tolerance, objective_over
from ..study.tolerance_text import tolerance_text
from .findings import UNDECIDED, Finding, by_loss, lost, percent
from .mountings import CANDIDATES, Mountings
from .variations import MOUNTING

USUAL = Tolerance(height_m=0.05, tilt_deg=1.0, yaw_deg=2.0, aim="mean")
_NAMES = {
    "height_m": ("height", "m", "height_m"),
    "tilt_x_deg": ("tilt across the road", "deg", "tilt_deg"),
    "tilt_y_deg": ("tilt along the road", "deg", "tilt_deg"),
    "yaw_deg": ("yaw", "deg", "yaw_deg"),
}
PROFILES = {  # how far off each coordinate is drawn, and in how many steps to each side
    "height_m": (0.5, 10),
    "tilt_x_deg": (5.0, 10),
    "tilt_y_deg": (5.0, 10),
    "yaw_deg": (10.0, 10),
}


def profiles(evaluator: Evaluator, mountings: Mountings) -> dict[str, dict[str, list[float]]]:
    """Share of the gain that is kept with one coordinate off at a time: offsets [m or degrees] and shares of each.

    Empty where the mounting gains nothing over the baseline.
    """
    planned, baseline = evaluator.totals(list(mountings.poses[:CANDIDATES])).per_vehicle()
    if not planned > baseline:
        return {}
    found = {}
    for key, (reach, steps) in PROFILES.items():
        offsets = np.linspace(-reach, reach, 2 * steps + 1)
        errors = np.zeros((len(offsets), len(COORDINATES)))
        errors[:, COORDINATES.index(key)] = offsets
        values = evaluator.totals(installed(mountings.reference, errors)).per_vehicle()
        found[key] = {"offset": offsets.tolist(), "kept": ((values - baseline) / (planned - baseline)).tolist()}
    return found


def off_plan(evaluator: Evaluator, mountings: Mountings, tolerance: Tolerance, block: np.ndarray) -> dict:
    """What the mounting loses where one coordinate is off by its tolerance, and what it keeps where all may be."""
    losses = losses_over_tolerance(evaluator, mountings.reference, tolerance, block)
    baseline = float(evaluator.totals([mountings.baseline]).per_vehicle()[0])
    return {
        "gain": losses.planned_per_vehicle - baseline,
        "kept": losses.kept(baseline),
        "limits": {key: list(lost) for key, lost in losses.limit_losses.items()},
    }


def robust_candidate(evaluator: Evaluator, mountings: Mountings, tolerance: Tolerance) -> dict[str, float]:
    """The candidate that is best where it hangs only nearly as planned."""
    return mountings.grid[int(np.argmax(objective_over(evaluator, mountings.grid, tolerance)))]


def beside_robust(
    evaluator: Evaluator, mountings: Mountings, robust: Mapping[str, float], tolerance: Tolerance
) -> dict:
    """The mounting and the robust candidate, both over the tolerance: gains over the baseline, which hangs exactly."""
    baseline = float(evaluator.totals([mountings.baseline]).per_vehicle()[0])
    values = objective_over(evaluator, [mountings.reference, robust], tolerance) / evaluator.vehicles.sum()
    gains = (values - baseline).tolist()
    return {"mounting": dict(robust), "sharp_gain": gains[0], "robust_gain": gains[1]}


def installation_findings(found: Mapping, robust: Mapping, tolerance: Tolerance) -> list[Finding]:
    """A line for each coordinate that is off, one for all, and one for the robust optimum beside this mounting."""
    if not found["gain"] > 0.0:
        return [Finding(MOUNTING, "installation", "", UNDECIDED, "the mounting gains nothing over the baseline")]
    lines = []
    for key, limits in found["limits"].items():
        name, unit, width = _NAMES[key]
        minus, plus = (loss / found["gain"] for loss in limits)
        text = f"{lost(minus)} where it is less, {lost(plus)} where it is more"
        value = f"+/-{getattr(tolerance, width):g} {unit}"
        lines.append(Finding(MOUNTING, name, value, by_loss(max(minus, plus)), text, {"limits": [minus, plus]}))
    loss = 1.0 - found["kept"]
    aim = "on average" if tolerance.aim == "mean" else "in nine of ten installations"
    text = f"keeps {percent(found['kept'])} of its gain {aim} within {tolerance_text(asdict(tolerance))}"
    return [
        *lines,
        Finding(MOUNTING, "all of these together", "", by_loss(loss), text, {"loss": loss}),
        _robust(robust),
    ]


def _robust(found: Mapping) -> Finding:
    """What the mounting in question leaves to the robust optimum where both hang only nearly as planned."""
    what, place = "robust optimum", found["mounting"]
    at = f"{place['height_m']:.2f} m, {place['tilt_x_deg']:.1f} deg"
    if not found["robust_gain"] > 0.0:
        return Finding(MOUNTING, what, "", UNDECIDED, f"{at}, which gains nothing over the baseline", dict(found))
    loss = 1.0 - found["sharp_gain"] / found["robust_gain"]
    text = f"{at}, best on the searched frames where all of these may be off; there the mounting {lost(loss)}"
    return Finding(MOUNTING, what, "", by_loss(loss), text, {"loss": loss, **found})
