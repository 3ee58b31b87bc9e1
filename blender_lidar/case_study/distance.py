"""What each sensor sees by distance, before and after: the paper's Fig. 9, and what makes RS-80 lose near by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..optimise.objective import vehicle_score
from ..scenario import pose_at
from ..study.score_map import AXES
from ..study.site import Site
from ..study.statistics import block_sums, ratio_interval_90
from ..study.vehicle_table import vehicle_table
from .published import BAND_M

MEASURES = ("detectable", "entropy_bits", "objective_bits")
EFFECTS = (
    "change",
    "change_evenly_spaced",
    "height_evenly_spaced",
    "tilt_evenly_spaced",
    "spacing",
    "spacing_at_baseline",
)
Mounting = tuple[float, float]  # height [m], tilt across the road [deg]
Measured = dict[str, np.ndarray]


def judging_frames(site: Site) -> tuple[tuple, np.ndarray, str]:
    """The frames that judge, their blocks, and what they are: held-out ones, or for want of them the searched ones."""
    if sum(int(frame.counted.sum()) for frame in site.holdout):
        return site.holdout, site.plan.holdout_block, "held-out"
    return site.search, site.plan.search_block, "searched"


def measure(site: Site, mounting: Mounting) -> Measured:
    """What a mounting sees of each vehicle of the judging frames.

    Returns
    -------
    dict of str to ndarray, (n,)
        The `MEASURES`, and ``band`` and ``block`` of each vehicle, in the same order for every mounting of a site.
    """
    frames, block, _ = judging_frames(site)
    table = vehicle_table(frames, _pose(site, mounting), site.observation, site.scoring, "judged")
    score = vehicle_score(table["entropy_bits"], table["detectable"], site.scoring.loss, site.scoring.reading)
    number = {frame.vehicles.frame: label for frame, label in zip(frames, block, strict=True)}
    return {
        "detectable": table["detectable"].astype(float),
        "entropy_bits": table["entropy_bits"],
        "objective_bits": score,
        "band": (table["distance_m"] // BAND_M).astype(int),
        "block": np.array([number[frame] for frame in table["frame"].tolist()]),
    }


def banded(values: np.ndarray, block: np.ndarray, seed: int) -> dict:
    """Mean of values (n,) over vehicles, and its 90 % interval from resampled blocks (n,); None for too few blocks."""
    sums, counts = block_sums(values, block), block_sums(np.ones(len(values)), block)
    interval = ratio_interval_90(sums, counts, seed)
    return {"mean": float(sums.sum() / counts.sum()), "interval_90": None if interval is None else list(interval)}


def bands_of(measured: Measured) -> list[tuple[str, np.ndarray]]:
    """Names of the distance bands that hold vehicles, and which vehicles each holds; all of them last."""
    band = measured["band"]
    found = [(f"{number * BAND_M:g}-{(number + 1) * BAND_M:g} m", band == number) for number in np.unique(band)]
    return [*found, ("all", np.ones(len(band), dtype=bool))]


def by_distance(site: Site, label: str, mountings: Mapping[str, Mounting], seed: int) -> list[dict]:
    """Fig. 9: for each band and measure the baseline, the optimised mounting and the change, with its interval.

    Parameters
    ----------
    site : Site
        The sensor on its traffic.
    label : str
        What to call it.
    mountings : mapping
        ``baseline`` and ``optimised``.
    seed : int
        For the resampling.
    """
    before, after = (measure(site, mountings[name]) for name in ("baseline", "optimised"))
    return [
        {
            "sensor": label,
            "band": band,
            "vehicles": int(inside.sum()),
            "blocks": len(np.unique(before["block"][inside])),
            "measure": name,
            "baseline": float(before[name][inside].mean()),
            "optimised": float(after[name][inside].mean()),
            "change": banded((after[name] - before[name])[inside], before["block"][inside], seed),
        }
        for band, inside in bands_of(before)
        for name in MEASURES
    ]


def effects(real: Mapping[str, np.ndarray], even: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Per vehicle, what height, tilt and the spacing of the beams make of the step from baseline to optimum.

    Parameters
    ----------
    real, even : mapping of str to ndarray, (n,)
        A measure under the sensor's own table and under the evenly spaced one, at the four corners ``00`` (baseline),
        ``10`` (the optimum's height alone), ``01`` (its tilt alone) and ``11`` (optimum).

    Returns
    -------
    dict of str to ndarray, (n,)
        The `EFFECTS`. ``change = change_evenly_spaced + spacing`` and ``change_evenly_spaced = height_evenly_spaced +
        tilt_evenly_spaced``, height and tilt each averaged over the two orders in which they can be changed.
        ``spacing`` is what of the change the uneven spacing makes: the interaction of the 2 x 2 of mounting and table.
        ``spacing_at_baseline`` is the real table less the even one before anything is moved.
    """
    change, level = real["11"] - real["00"], even["11"] - even["00"]
    return {
        "change": change,
        "change_evenly_spaced": level,
        "height_evenly_spaced": 0.5 * (even["10"] - even["00"] + even["11"] - even["01"]),
        "tilt_evenly_spaced": 0.5 * (even["01"] - even["00"] + even["11"] - even["10"]),
        "spacing": change - level,
        "spacing_at_baseline": real["00"] - even["00"],
    }


def decomposition(real: Site, even: Site, baseline: Mounting, optimum: Mounting, seed: int) -> list[dict]:
    """`effects` by distance band and measure, as means per vehicle with intervals."""
    corners = {
        "00": baseline,
        "10": (optimum[0], baseline[1]),
        "01": (baseline[0], optimum[1]),
        "11": optimum,
    }
    seen = [{corner: measure(site, at) for corner, at in corners.items()} for site in (real, even)]
    first = seen[0]["00"]
    rows = []
    for name in MEASURES:
        found = effects(*({corner: one[name] for corner, one in of.items()} for of in seen))
        rows += [
            {
                "band": band,
                "vehicles": int(inside.sum()),
                "measure": name,
                **_means(found, inside, first["block"], seed),
            }
            for band, inside in bands_of(first)
        ]
    return rows


def _means(found: Mapping[str, np.ndarray], inside: np.ndarray, block: np.ndarray, seed: int) -> dict:
    return {effect: banded(found[effect][inside], block[inside], seed) for effect in EFFECTS}


def _pose(site: Site, mounting: Mounting):
    fixed = site.scenario.baseline
    return pose_at({**fixed, **dict(zip(AXES, mounting, strict=True))})


def of_band(rows: Sequence[Mapping], band: str, measure: str) -> Mapping | None:
    """The row of a band and a measure; None where the band holds no vehicle."""
    return next((row for row in rows if row["band"] == band and row["measure"] == measure), None)
