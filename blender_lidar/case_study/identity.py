"""What two runs of the case study must share for the second to go on with the first's stages."""

from __future__ import annotations

from .optima import NEAR_BEST, WIDE
from .published import BAND_M, PUBLISHED
from .sensitivity import sensitivity_variants
from .sites import CaseStudy
from .variants import LOSSES

SCHEMA = 2  # of the stages and of the result; 1 had no place, no spacing at the optimum and no halves of the bands


def study_identity(case: CaseStudy) -> dict[str, object]:
    """What the stages depend on: the case, what the study asks of it, and how they are stored."""
    asked: dict[str, object] = {
        "study schema": SCHEMA,
        "study bands": BAND_M,
        "study shares of the gain": NEAR_BEST,
        "study losses": LOSSES,
        **{f"study {name} beyond the bounds": pair for name, pair in WIDE.items()},
        **{f"study {sensor} of the paper": (of.height_m, of.tilt_deg) for sensor, of in PUBLISHED.items()},
    }
    for sensor, variant in sensitivity_variants(case):
        changes = [f"[{table}] {key} = {value}" for (table, key), (value, _) in variant.overrides.items()]
        asked[f"study {sensor} {variant.what} {variant.value}".strip()] = changes
    return {**case.identity(), **asked}
