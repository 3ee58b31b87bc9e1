"""What each sensor sees by distance, before and after: the paper's Fig. 9, and what RS-80's uneven beams do to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..optimise.objective import vehicle_score
from ..scenario import pose_at
from ..study.site import Site
from ..study.statistics import block_sums, difference_interval_90, ratio_interval_90
from ..study.vehicle_table import vehicle_table
from ..study.verdict import distance_bands
from .mountings import Coordinates, Mounting, baseline_coordinates, baseline_of, coordinates
from .published import BAND_M

MEASURES = ("detectable", "entropy_bits", "objective_bits")
EFFECTS = (
    "change",
    "change_evenly_spaced",
    "place_evenly_spaced",
    "height_evenly_spaced",
    "tilt_evenly_spaced",
    "spacing",
    "spacing_at_baseline",
    "spacing_at_optimum",
)
SHOWN = {  # effects that add up to the change, and what they are called
    "place_evenly_spaced": "place",
    "height_evenly_spaced": "height",
    "tilt_evenly_spaced": "tilt",
    "spacing": "change of the uneven beams' lead",
}
Measured = dict[str, np.ndarray]


def judging_frames(site: Site) -> tuple[tuple, np.ndarray, str]:
    """The frames that judge, their blocks, and what they are: held-out ones, or for want of them the searched ones."""
    if sum(int(frame.counted.sum()) for frame in site.holdout):
        return site.holdout, site.plan.holdout_block, "held-out"
    return site.search, site.plan.search_block, "searched"


def measure(site: Site, mount: Coordinates) -> Measured:
    """What a mounting sees of each vehicle of the judging frames.

    Returns
    -------
    dict of str to ndarray, (n,)
        The `MEASURES`, and ``distance_m`` from the mount and ``block`` of each vehicle, in the same order for every
        mounting of a site.
    """
    frames, block, _ = judging_frames(site)
    table = vehicle_table(frames, pose_at(mount), site.observation, site.scoring, "judged")
    score = vehicle_score(table["entropy_bits"], table["detectable"], site.scoring.loss, site.scoring.reading)
    number = {frame.vehicles.frame: label for frame, label in zip(frames, block, strict=True)}
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
    interval = ratio_interval_90(sums, counts, seed)
    return {"mean": float(sums.sum() / counts.sum()), "interval_90": None if interval is None else list(interval)}


def bands_of(measured: Measured) -> list[tuple[str, np.ndarray]]:
    """Names of the distance bands that hold vehicles, and which vehicles each holds; all of them last."""
    return [*distance_bands(measured, BAND_M), ("all", np.ones(len(measured["distance_m"]), dtype=bool))]


def by_distance(site: Site, label: str, optimum: Mounting, seed: int) -> dict[str, list[dict]]:
    """Fig. 9: the baseline, the optimised mounting and the change, with its interval.

    Parameters
    ----------
    site : Site
        The sensor on its traffic.
    label : str
        What to call it.
    optimum : (float, float)
        Its height [m] and tilt [deg].
    seed : int
        For the resampling.

    Returns
    -------
    dict
        ``bands``, a row for each band of distance from the baseline and each measure, and ``halves``, a row for each
        measure: the change in the farther half of the bands less that in the nearer half.
    """
    before, after = measure(site, baseline_coordinates(site)), measure(site, coordinates(site, optimum))
    change = {name: after[name] - before[name] for name in MEASURES}
    return {
        "bands": list(_band_rows(label, before, after, change, seed)),
        "halves": [{"sensor": label, "measure": name, **halves(change[name], before, seed)} for name in MEASURES],
    }


def _band_rows(label: str, before: Measured, after: Measured, change: Measured, seed: int) -> Iterator[dict]:
    return (
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
    )


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
    interval = difference_interval_90(*sums, seed)
    means = {"near": float(change[near].mean()), "far": float(change[far].mean())}
    found = {"mean": means["far"] - means["near"], "interval_90": None if interval is None else list(interval)}
    return {**means, "far_less_near": found}


def effects(real: Mapping[str, np.ndarray], even: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Per vehicle, what place, height, tilt and the spacing of the beams make of the step from baseline to optimum.

    Parameters
    ----------
    real, even : mapping of str to ndarray, (n,)
        A measure under the sensor's own table and under the evenly spaced one, for the ``baseline`` and at the
        optimum's place with four pairs of height and tilt: ``00`` (the baseline's), ``10`` (the optimum's height),
        ``01`` (its tilt) and ``11`` (the optimum).

    Returns
    -------
    dict of str to ndarray, (n,)
        The `EFFECTS`. ``change = change_evenly_spaced + spacing`` and ``change_evenly_spaced = place_evenly_spaced +
        height_evenly_spaced + tilt_evenly_spaced``, height and tilt each averaged over the two orders in which they can
        be changed. ``spacing`` is what of the change the uneven spacing makes, the interaction of the 2 x 2 of mounting
        and table: ``spacing_at_optimum`` less ``spacing_at_baseline``, which are the real table less the even one.
        Below 0 it may be a lead lost, and need not be a table worse than the even one.
    """
    change, level = real["11"] - real["baseline"], even["11"] - even["baseline"]
    return {
        "change": change,
        "change_evenly_spaced": level,
        "place_evenly_spaced": even["00"] - even["baseline"],
        "height_evenly_spaced": 0.5 * (even["10"] - even["00"] + even["11"] - even["01"]),
        "tilt_evenly_spaced": 0.5 * (even["01"] - even["00"] + even["11"] - even["10"]),
        "spacing": change - level,
        "spacing_at_baseline": real["baseline"] - even["baseline"],
        "spacing_at_optimum": real["11"] - even["11"],
    }


def decomposition(real: Site, even: Site, optimum: Mounting, seed: int) -> list[dict]:
    """`effects` by distance band and measure, as means per vehicle with intervals."""
    heights, tilts = zip(baseline_of(real), optimum, strict=True)
    corners = {f"{h}{t}": coordinates(real, (heights[h], tilts[t])) for h in (0, 1) for t in (0, 1)}
    corners["baseline"] = baseline_coordinates(real)
    seen = [{corner: measure(site, at) for corner, at in corners.items()} for site in (real, even)]
    first = seen[0]["baseline"]
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


def effects_shown(rows: Sequence[Mapping]) -> dict[str, str]:
    """Names of the effects that add up to the change; the place is left out where the baseline hangs at the same."""
    moved = any(row["place_evenly_spaced"]["mean"] for row in rows)
    return {effect: name for effect, name in SHOWN.items() if moved or effect != "place_evenly_spaced"}


def _means(found: Mapping[str, np.ndarray], inside: np.ndarray, block: np.ndarray, seed: int) -> dict:
    return {effect: banded(found[effect][inside], block[inside], seed) for effect in EFFECTS}


def of_band(rows: Sequence[Mapping], band: str, measure: str) -> Mapping | None:
    """The row of a band and a measure; None where the band holds no vehicle."""
    return next((row for row in rows if row["band"] == band and row["measure"] == measure), None)
