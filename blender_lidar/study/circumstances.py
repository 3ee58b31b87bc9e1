"""What a score holds under besides the mounting: how imperfect the sensor was, and what stood in its way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..casting.standing import StandingScenery


def imperfections_text(imperfections: Mapping[str, float | None]) -> str:
    """What is imperfect about a sensor, in a few words; empty where nothing is.

    `imperfections` is what `SensorSettings.imperfections_as_table` gives and result.json keeps.
    """
    texts = []
    if imperfections["range_noise_m"]:
        texts.append(f"range noise {imperfections['range_noise_m']:g} m")
    if imperfections["dropout"]:
        texts.append(f"drop-out {100 * imperfections['dropout']:g} %")
    glass = imperfections.get("glass_dropout", 0.0)  # results of earlier versions do not say
    if glass:
        texts.append(f"drop-out on glass {100 * glass:g} %")
    if imperfections["range_noise_m"] or imperfections["dropout"] or 0.0 < glass < 1.0:
        texts.append(f"noise seed {imperfections['noise_seed']}")
    if imperfections.get("range_at_10_percent_m") is not None:
        texts.append(f"a 10 % target seen to {imperfections['range_at_10_percent_m']:g} m")
    if imperfections["unit_spread_deg"]:
        spread = imperfections["unit_spread_deg"]
        texts.append(f"unit {imperfections['unit']} of units that differ by {spread:g} deg")
    return ", ".join(texts)


def scenery_counts(standing: StandingScenery | None) -> dict[str, int] | None:
    """Objects and triangles of the scenery within reach, for result.json; None where the scene has none."""
    if standing is None:
        return None
    return {"objects": len(np.unique(standing.scenery.owner)), "triangles": len(standing.scenery)}


def scenery_text(counts: Mapping[str, int] | None) -> str:
    """How much scenery stood there, in a few words; empty where the scene has none."""
    if counts is None:
        return ""
    objects, triangles = counts["objects"], counts["triangles"]
    plural = ("s" * (objects != 1), "s" * (triangles != 1))
    return f"{objects:,} object{plural[0]}, {triangles:,} triangle{plural[1]} within reach"
