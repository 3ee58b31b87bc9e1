"""What the paper reports of its case study: He, Cao, Su and Liu, arXiv 2407.17942, section V.

Numbers alone, for comparison. The paper gives no objective, no interval, no number of frames and no values of Fig. 9
but the two that its text quotes.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Published:
    """One sensor's row of Tables I, II and III.

    Attributes
    ----------
    beams : int
        As its name says.
    range_m : float
        Table I.
    height_m, tilt_deg : float
        Table II: the optimised deployment.
    recall_01, recall_03 : tuple of float
        Table III: Recall under the baseline and under the optimised deployment, at confidences of 0.1 and 0.3.
    """

    beams: int
    range_m: float
    height_m: float
    tilt_deg: float
    recall_01: tuple[float, float]
    recall_03: tuple[float, float]


PUBLISHED = MappingProxyType(
    {
        "RS-16": Published(16, 50.0, 4.1, 19.0, (0.70, 0.87), (0.57, 0.67)),
        "RS-32": Published(32, 80.0, 4.2, 13.0, (0.63, 0.88), (0.53, 0.68)),
        "RS-80": Published(80, 150.0, 4.4, 9.0, (0.85, 0.95), (0.78, 0.86)),
    }
)
SENSORS = tuple(PUBLISHED)
EVEN = "RS-80 evenly spaced"  # what the paper has RS-80's uneven beams stand against
BAND_M = 20.0  # the distance bands that the paper's text names: 0 to 20 m, 120 to 140 m
