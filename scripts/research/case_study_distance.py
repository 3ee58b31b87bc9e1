"""What each sensor sees by distance, before and after (the paper's Fig. 9), and what RS-80's uneven beams do to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from blender_lidar.optimise.objective import vehicle_score
from blender_lidar.run.vehicle_table import distance_bands, vehicle_table
from blender_lidar.scene.mounting import Layout
from blender_lidar.scene.site import Site
from blender_lidar.scoring.evaluation import Evaluator
from blender_lidar.statistics import FEWEST_BLOCKS, block_sums, ratio_interval_90, resampled_weights, student_t_95
from case_study import HeightAndTilt, baseline_of, layout_at

BAND_M = 20.0  # the distance bands that the paper's text names: 0 to 20 m, 120 to 140 m
MEASURES = ("detectable", "entropy_bits", "objective_bits")
Measured = dict[str, np.ndarray]


def measure(site: Site, layout: Layout) -> Measured:
    """What a mounting sees of each vehicle of the held-out frames.

    Returns
    -------
    dict of str to ndarray, (n,)
        The `MEASURES`, and ``distance_m`` from the LiDAR and ``block`` of each vehicle, in the same order for every
        mounting of a site.
    """
    table = vehicle_table(layout, judged=Evaluator(site.holdout, site.observation, site.scoring))
    score = vehicle_score(table["entropy_bits"], table["detectable"], site.scoring.loss, site.scoring.reading)
    number = {frame.frame: of for frame, of in zip(site.holdout, site.plan.holdout_block, strict=True)}
    return {
        "detectable": table["detectable"].astype(float),
        "entropy_bits": table["entropy_bits"],
        "objective_bits": score,
        "distance_m": table["distance_m"],
        "block": np.array([number[frame] for frame in table["frame"].tolist()]),
    }


def banded(values: np.ndarray, block: np.ndarray, seed: int) -> dict:
    """Mean of values (n,) over vehicles, and its 90 % interval from resampled blocks (n,); None for too few blocks."""
    sums, counts = block_sums(values, block), block_sums(np.ones(len(values)), block)
    return _with_ends(float(sums.sum() / counts.sum()), ratio_interval_90(sums, counts, seed))


def bands_of(measured: Measured) -> list[tuple[str, np.ndarray]]:
    """Names of the distance bands that hold vehicles, and which vehicles each holds; all of them last."""
    return [*distance_bands(measured, BAND_M), ("all", np.ones(len(measured["distance_m"]), dtype=bool))]


def by_distance(site: Site, label: str, optimum: HeightAndTilt, seed: int) -> dict[str, list[dict]]:
    """Fig. 9: baseline, optimised mounting and change, with its interval.

    Returns
    -------
    dict
        ``fig9``, a row for each band of distance from the baseline and each measure, and ``fig9_halves``, a row for
        each measure: the change in the farther half of the bands less that in the nearer half.
    """
    before, after = (measure(site, layout_at(site, at)) for at in (baseline_of(site), optimum))
    change = {name: after[name] - before[name] for name in MEASURES}
    bands = [
        {
            "sensor": label,
            "band": band,
            "vehicles": int(inside.sum()),
            "blocks": len(np.unique(before["block"][inside])),
            "measure": name,
            "baseline": float(before[name][inside].mean()),
            "optimised": float(after[name][inside].mean()),
            "change": banded(change[name][inside], before["block"][inside], seed),
        }
        for band, inside in bands_of(before)
        for name in MEASURES
    ]
    of_halves = [{"sensor": label, "measure": name, **halves(change[name], before, seed)} for name in MEASURES]
    return {"fig9": bands, "fig9_halves": of_halves}


def halves(change: np.ndarray, measured: Measured, seed: int) -> dict:
    """Mean change (n,) in the nearer and in the farther half of the bands, and the difference with its interval.

    Of an odd number of bands the middle one is a farther one. Without two bands there is no difference.
    """
    inside = [rows for _, rows in distance_bands(measured, BAND_M)]
    half = len(inside) // 2
    if not half:
        return {"near": None, "far": None, "far_less_near": {"mean": None, "interval_90": None}}
    near, far = np.any(inside[:half], axis=0), np.any(inside[half:], axis=0)
    sums = [
        tuple(block_sums(values, measured["block"]) for values in (np.where(rows, change, 0.0), rows))
        for rows in (far, near)
    ]
    means = {"near": float(change[near].mean()), "far": float(change[far].mean())}
    return {**means, "far_less_near": _with_ends(means["far"] - means["near"], difference_interval_90(*sums, seed))}


def difference_interval_90(
    first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], seed: int
) -> tuple[float, float] | None:
    """90 % interval of one ratio less another, each of block sums (numerator, denominator), (b,), of the same blocks.

    As `ratio_interval_90`, both ratios under the same resamples; those in which one of them has no vehicle are left
    out. None where one of the two has fewer than `FEWEST_BLOCKS` blocks with vehicles.
    """
    if min(int((denominator > 0).sum()) for _, denominator in (first, second)) < FEWEST_BLOCKS:
        return None
    filled = (first[1] > 0) | (second[1] > 0)
    weights = resampled_weights(int(filled.sum()), np.random.default_rng(seed))
    drawn = [(weights @ numerator[filled], weights @ denominator[filled]) for numerator, denominator in (first, second)]
    kept = (drawn[0][1] > 0) & (drawn[1][1] > 0)
    ratios = [numerator[kept] / denominator[kept] for numerator, denominator in drawn]
    spread = float(np.std(ratios[0] - ratios[1]))
    middle = float(first[0].sum() / first[1].sum() - second[0].sum() / second[1].sum())
    reach = student_t_95(int(filled.sum()) - 1) * spread
    return middle - reach, middle + reach


def effects(real: Mapping[str, np.ndarray], even: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Per vehicle, what height, tilt and the spacing of the beams make of the step from baseline to optimum.

    Parameters
    ----------
    real, even : mapping of str to ndarray, (n,)
        A measure under the sensor's own table and under the evenly spaced one, with ``00``, the baseline's height and
        tilt, ``10``, the optimum's height, ``01``, its tilt, and ``11``, the optimum.

    Returns
    -------
    dict of str to ndarray, (n,)
        ``change = change_evenly_spaced + spacing`` and ``change_evenly_spaced = height_evenly_spaced +
        tilt_evenly_spaced``, each averaged over the two orders in which they can be changed. ``spacing`` is what of the
        change the uneven spacing makes, the interaction of the 2 x 2 of mounting and table: ``spacing_at_optimum`` less
        ``spacing_at_baseline``, which are the real table less the even one. Below 0 it may be a lead lost, and need not
        be a table worse than the even one.
    """
    change, level = real["11"] - real["00"], even["11"] - even["00"]
    return {
        "change": change,
        "change_evenly_spaced": level,
        "height_evenly_spaced": 0.5 * (even["10"] - even["00"] + even["11"] - even["01"]),
        "tilt_evenly_spaced": 0.5 * (even["01"] - even["00"] + even["11"] - even["10"]),
        "spacing": change - level,
        "spacing_at_baseline": real["00"] - even["00"],
        "spacing_at_optimum": real["11"] - even["11"],
    }


def decomposition(real: Site, even: Site, optimum: HeightAndTilt, seed: int) -> list[dict]:
    """`effects` by distance band and measure, as means per vehicle with intervals."""
    heights, tilts = zip(baseline_of(real), optimum, strict=True)
    corners = {f"{h}{t}": layout_at(real, (heights[h], tilts[t])) for h in (0, 1) for t in (0, 1)}
    seen = [{corner: measure(site, at) for corner, at in corners.items()} for site in (real, even)]
    first = seen[0]["00"]
    rows = []
    for name in MEASURES:
        found = effects(*({corner: one[name] for corner, one in of.items()} for of in seen))
        for band, inside in bands_of(first):
            means = {effect: banded(of[inside], first["block"][inside], seed) for effect, of in found.items()}
            rows.append({"band": band, "vehicles": int(inside.sum()), "measure": name, **means})
    return rows


def of_band(rows: Sequence[Mapping], band: str, measure: str) -> Mapping | None:
    """The row of a band and a measure; None where the band holds no vehicle."""
    return next((row for row in rows if row["band"] == band and row["measure"] == measure), None)


def _with_ends(mean: float, interval: tuple[float, float] | None) -> dict:
    return {"mean": mean, "interval_90": None if interval is None else list(interval)}
