"""Errors of simulated against real PE-VGOP: medians over cars with bootstrap intervals, and their table.

Whole clusters of cars are drawn anew (`resampling.clusters`). Variants are compared car by car under the same
resamples: what is common to both does not blur their difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import permutations

import numpy as np

from ...metrics.view_grids import VIEW_NAMES
from ...statistics import FEWEST_BLOCKS, RESAMPLES, interval_90, resampled_weights
from .cars import of_bearing
from .detections import told_of, tuned_frames
from .paired import PairedCars
from .resampling import clusters

RESULT, TABLE = "paired.json", "paired.csv"
ALL, TUNED, VALIDATION = "all", "tuned", "validation"
DISTANCE_BANDS_M = ((10.0, 20.0), (20.0, 30.0), (30.0, 40.0), (40.0, 50.0))
SEED = 1

# --- Aggregates -------------------------------------------------------------------------------------------------------


def sets_of(paired: PairedCars, told: Mapping[str, Mapping[str, str]]) -> dict[str, np.ndarray]:
    """Which cars are in each set, (c,) bool: all, and those of tuned and of other frames where both are there."""
    sets, tuned = {ALL: np.ones(len(paired), dtype=bool)}, tuned_frames(told)
    if tuned is not None:
        fitted = np.isin(paired["frame"][0], tuned)
        sets |= {name: which for name, which in {TUNED: fitted, VALIDATION: ~fitted}.items() if which.any()}
    return sets


def judging(names: Sequence[str]) -> str:
    """The set that judges: frames that nothing was fitted to, or all where the data set does not tell them apart."""
    return VALIDATION if VALIDATION in names else ALL


def aggregate(paired: PairedCars, told: Mapping[str, Mapping[str, str]]) -> dict:
    """All aggregates, set by set, ready for JSON; `told` is what `read_frames` gives, or nothing."""
    found = {}
    for name, which in sets_of(paired, told).items():
        cars = {key: paired[key][:, which] for key in paired.table}  # (v, c) each
        frame, toward = cars["frame"][0], cars["rays"][0]
        drawn = clusters({"frame": frame, **told_of(frame, told)})
        names = [{"detail": way.detail, "losses": way.losses} for way in paired.variants]
        found[name] = {
            "cars": int(which.sum()),
            "frames": len(set(frame.tolist())),
            "resampled": {"unit": drawn.unit, "number": drawn.number, "too_narrow": drawn.too_narrow},
            "real_entropy_bits_median": float(np.median(cars["real_entropy_bits"][0])),
            "hidden_share": float((cars["hidden_share"][0] * toward).sum() / max(int(toward.sum()), 1)),
            "variants": [
                one | _of_variant({key: of[row] for key, of in cars.items()}, drawn.of_car)
                for row, one in enumerate(names)
            ],
            "differences": _differences(names, np.abs(cars["error_bits"]), drawn.of_car),
        }
    return found


def _of_variant(cars: Mapping[str, np.ndarray], cluster: np.ndarray) -> dict:
    """Aggregates of the cars of one variant, (c,) a column."""
    error, distance_m = cars["error_bits"], cars["distance_m"]
    kept = cars["simulated_entropy_hidden_kept_bits"] - cars["real_entropy_bits"]
    real, simulated, both = (int(cars[f"{name}_points"].sum()) for name in ("real", "simulated", "both"))
    residual = cars["residual_abs_median_m"]

    def group(mine: np.ndarray) -> dict:
        of, drawn = error[mine], cluster[mine]
        values = {"absolute_error_bits": np.abs(of), "bias_bits": of}
        medians = {name: median_interval(one, drawn) if len(one) else None for name, one in values.items()}
        return {"cars": len(of), **medians}

    return {
        "absolute_error_bits": median_interval(np.abs(error), cluster),
        "bias_bits": median_interval(error, cluster),
        "absolute_error_hidden_kept_bits": median_interval(np.abs(kept), cluster),
        "absolute_error_p": {
            view: float(np.median(np.abs(cars[f"simulated_p_{view}"] - cars[f"real_p_{view}"]))) for view in VIEW_NAMES
        },
        "by_distance": [
            {"low_m": low, "high_m": high, **group((distance_m >= low) & (distance_m < high))}
            for low, high in DISTANCE_BANDS_M
        ],
        "by_bearing": [{"bearing": name, **group(mine)} for name, mine in of_bearing(cars["bearing_deg"]).items()],
        "hits": {"both": both, "real_only": real - both, "simulated_only": simulated - both},
        "residual_abs_median_m": float(np.nanmedian(residual)) if np.isfinite(residual).any() else None,
    }


def _differences(names: Sequence[Mapping], errors: np.ndarray, cluster: np.ndarray) -> list[dict]:
    """Of every two variants: how much the first one's median absolute error, of (v, c), exceeds the second one's.

    With fewer than three clusters nothing can be said of the noise: None.
    """
    medians, resampled = np.median(errors, axis=1), _resampled_medians(errors, cluster)
    found = []
    for first, second in permutations(range(len(names)), 2):
        interval = None if resampled is None else list(interval_90(resampled[first] - resampled[second]))
        found.append(
            {
                "first": names[first],
                "second": names[second],
                "difference_bits": float(medians[first] - medians[second]),
                "interval_90": interval,
                "within_noise": interval and interval[0] <= 0.0 <= interval[1],
            }
        )
    return found


def median_interval(values: np.ndarray, cluster: np.ndarray) -> dict:
    """Median of values (c,) and its 90 % interval over resampled clusters (c,); None for fewer than three."""
    resampled = _resampled_medians(values[None], cluster)
    interval = None if resampled is None else list(interval_90(resampled[0]))
    return {"median": float(np.median(values)), "interval_90": interval}


def _resampled_medians(values: np.ndarray, cluster: np.ndarray) -> np.ndarray | None:
    """Weighted medians (v, resamples) of values (v, c) whose clusters (c,) are drawn anew; None for too few of them."""
    labels, row = np.unique(cluster, return_inverse=True)
    if len(labels) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(len(labels), np.random.default_rng(SEED), RESAMPLES)[:, row]
    medians = []
    for of_one in values:
        order = np.argsort(of_one, kind="stable")
        reached = np.cumsum(weights[:, order], axis=1)
        medians.append(of_one[order][np.argmax(reached >= 0.5 * reached[:, -1:], axis=1)])
    return np.array(medians)


def cheapest_within_noise(of: Mapping, details: Sequence[str]) -> dict:
    """The variant with the smallest median error, and the cheapest level of detail within its noise.

    Levels are compared under the losses of the best variant, so that nothing but the level differs.

    Parameters
    ----------
    of : mapping
        One set of `aggregate`, whose variants go from the cheapest level of detail on.
    details : sequence of str
        Levels of detail from the cheapest on.
    """
    first = min(of["variants"], key=lambda one: one["absolute_error_bits"]["median"])
    best = {key: first[key] for key in ("detail", "losses")}
    cheaper = [{**best, "detail": detail} for detail in details[: details.index(best["detail"])]]
    itself = {"first": best, "difference_bits": 0.0, "interval_90": None}
    rivals = (one for one in of["differences"] if one["second"] == best and one["first"] in cheaper)
    rival = next((one for one in rivals if one["within_noise"]), itself)
    told = {key: rival[key] for key in ("difference_bits", "interval_90")}
    return {"best": best, "cheapest": rival["first"], **told}


# --- Table ------------------------------------------------------------------------------------------------------------


def paired_table(
    paired: PairedCars, told: Mapping[str, Mapping[str, str]]
) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """One row for each car and variant, variant after variant; the columns, and the digits of those of floats."""
    name = np.full(len(paired), ALL, dtype="<U10")
    for key, which in sets_of(paired, told).items():
        name[which] = key
    floats = [key for key, values in paired.table.items() if values.dtype.kind == "f"]
    digits = {key: 3 if key.endswith(("_m", "_deg")) else 5 for key in floats}
    return {"set": np.tile(name, len(paired.variants)), **paired.table}, digits
