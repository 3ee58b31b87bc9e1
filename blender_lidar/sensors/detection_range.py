"""How far a surface is seen: Lambert's law and the inverse square of the range, against the weakest return that counts.

The light that comes back from a surface wider than the beam is as reflectivity x cos(incidence) / range^2, so a sensor
that needs a certain strength sees a surface as far as the square root of reflectivity x cos(incidence) reaches. Makers
state that strength as the range at which a target of 10 % reflectivity that faces the sensor is still seen.
"""

from __future__ import annotations

import numpy as np

STATED_REFLECTIVITY = 0.1
STATED_RANGE_LIMITS_M = (0.01, 1e5)  # that sensor tables and scenes may state


def detection_range_m(
    range_at_10_percent_m: float, reflectivity: np.ndarray | float, cosine: np.ndarray | float
) -> np.ndarray | float:
    """Farthest range at which surfaces are seen [m], that range included; reflectivity and cosine broadcast.

    Parameters
    ----------
    range_at_10_percent_m : float
        Farthest range at which the sensor sees a target of 10 % reflectivity that faces it [m].
    reflectivity : array_like
        Diffuse reflectivity of each surface, 0 to 1.
    cosine : array_like
        Cosine of each beam's incidence, 0 (grazing) to 1 (head-on).
    """
    return range_at_10_percent_m * np.sqrt(reflectivity * cosine / STATED_REFLECTIVITY)
