"""Errors of simulated against real PE-VGOP: medians over cars with bootstrap intervals, and their table.

Whole clusters of cars are drawn anew (`resampling.clusters`). Variants are compared car by car under the same
resamples: what is common to both does not blur their difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...metrics.view_grids import VIEWS
from ...statistics import FEWEST_BLOCKS, RESAMPLES, interval_90, resampled_weights
from .cars import of_bearing
from .detections import FrameList
from .paired import PairedCars
from .resampling import Clusters, clusters

RESULT, TABLE = "paired.json", "paired.csv"
ALL, TUNED, VALIDATION = "all", "tuned", "validation"
BANDS_M = ((10.0, 20.0), (20.0, 30.0), (30.0, 40.0), (40.0, 50.0))
SEED = 1

# --- Aggregates -------------------------------------------------------------------------------------------------------


def sets_of(paired: PairedCars, tuned: frozenset[str] | None) -> dict[str, np.ndarray]:
    """Which cars are in each set, (c,) bool: all, and those of tuned and of other frames where both are there."""
    everything = {ALL: np.ones(len(paired), dtype=bool)}
    if tuned is None:
        return everything
    fitted = np.isin(paired.cars["frame"], sorted(tuned))
    return everything | {name: which for name, which in {TUNED: fitted, VALIDATION: ~fitted}.items() if which.any()}


def judging(names: Sequence[str]) -> str:
    """The set that judges: frames that nothing was fitted to, or all where the data set does not tell them apart."""
    return VALIDATION if VALIDATION in names else ALL


def aggregate(paired: PairedCars, told: FrameList) -> dict:
    """All aggregates, set by set, ready for JSON; `told` is what the data set tells of its frames."""
    found = {}
    for name, which in sets_of(paired, told.tuned).items():
        frame, cars = paired.cars["frame"][which], paired.cars
        drawn = clusters(frame, told.of(frame))
        hidden, toward = (cars["hidden_share"] * cars["rays"])[which], cars["rays"][which]
        found[name] = {
            "cars": int(which.sum()),
            "frames": len(set(frame.tolist())),
            "resampled": {"unit": drawn.unit, "number": drawn.number, "too_narrow": drawn.too_narrow},
            "real_entropy_bits_median": float(np.median(cars["real_entropy_bits"][which])),
            "hidden_share": float(hidden.sum() / max(int(toward.sum()), 1)),
            "variants": [_of_variant(paired, index, which, drawn) for index in range(len(paired.variants))],
            "differences": _differences(paired, which, drawn),
        }
    return found


def _of_variant(paired: PairedCars, index: int, which: np.ndarray, drawn: Clusters) -> dict:
    cars = {name: values[which] for name, values in (paired.cars | paired.of[index]).items()}
    error, cluster = paired.errors(index)[which], drawn.of_car
    real, simulated, both = (int(cars[f"{name}_points"].sum()) for name in ("real", "simulated", "both"))
    residual, distance_m = cars["residual_abs_median_m"], cars["distance_m"]
    in_band = {band: (distance_m >= band[0]) & (distance_m < band[1]) for band in BANDS_M}
    return {
        **_name(paired, index),
        "absolute_error_bits": median_interval(np.abs(error), cluster),
        "bias_bits": median_interval(error, cluster),
        "absolute_error_hidden_kept_bits": median_interval(np.abs(paired.errors(index, True)[which]), cluster),
        "absolute_error_p": {
            view: float(np.median(np.abs(cars[f"simulated_p_{view}"] - cars[f"real_p_{view}"]))) for view in VIEWS
        },
        "by_distance": [
            {"low_m": low, "high_m": high, **_group(error, cluster, mine)} for (low, high), mine in in_band.items()
        ],
        "by_bearing": [
            {"bearing": name, **_group(error, cluster, mine)} for name, mine in of_bearing(cars["bearing_deg"]).items()
        ],
        "hits": {"both": both, "real_only": real - both, "simulated_only": simulated - both},
        "residual_abs_median_m": float(np.nanmedian(residual)) if np.isfinite(residual).any() else None,
    }


def _group(error: np.ndarray, cluster: np.ndarray, mine: np.ndarray) -> dict:
    return {
        "cars": int(mine.sum()),
        "absolute_error_bits": median_interval(np.abs(error[mine]), cluster[mine]) if mine.any() else None,
        "bias_bits": median_interval(error[mine], cluster[mine]) if mine.any() else None,
    }


def _differences(paired: PairedCars, which: np.ndarray, drawn: Clusters) -> list[dict]:
    """Of every two variants: how much the first one's median absolute error exceeds the second one's.

    With fewer than three clusters nothing can be said of the noise: None.
    """
    errors = np.abs([paired.errors(index)[which] for index in range(len(paired.variants))])
    medians, resampled = np.median(errors, axis=1), _resampled_medians(errors, drawn.of_car)
    found = []
    for first, second in np.argwhere(~np.eye(len(errors), dtype=bool)).tolist():
        interval = None if resampled is None else interval_90(resampled[first] - resampled[second])
        found.append(
            {
                "first": _name(paired, first),
                "second": _name(paired, second),
                "difference_bits": float(medians[first] - medians[second]),
                "interval_90": interval and list(interval),
                "within_noise": interval and interval[0] <= 0.0 <= interval[1],
            }
        )
    return found


def _name(paired: PairedCars, index: int) -> dict[str, str]:
    return {"detail": paired.variants[index].detail, "losses": paired.variants[index].losses}


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
        One set of `aggregate`.
    details : sequence of str
        Levels of detail from the cheapest on.
    """
    first = min(of["variants"], key=lambda one: one["absolute_error_bits"]["median"])
    best = {key: first[key] for key in ("detail", "losses")}
    rivals = {
        one["first"]["detail"]: one
        for one in of["differences"]
        if one["second"] == best and one["first"]["losses"] == best["losses"] and one["within_noise"]
    }
    none = {"first": best, "difference_bits": 0.0, "interval_90": None}
    rival = next((rivals[one] for one in details[: details.index(best["detail"])] if one in rivals), none)
    return {
        "best": best,
        "cheapest": rival["first"],
        "difference_bits": rival["difference_bits"],
        "interval_90": rival["interval_90"],
    }


# --- Table ------------------------------------------------------------------------------------------------------------


def paired_table(paired: PairedCars, told: FrameList) -> tuple[dict[str, np.ndarray], dict[str, int]]:
    """One row for each car and variant, variant after variant; the columns, and the digits of those of floats."""
    ways, cars = paired.variants, len(paired)
    name = np.full(cars, ALL, dtype="<U10")
    for key, which in sets_of(paired, told.tuned).items():
        name[which] = key
    table = {key: np.tile(values, len(ways)) for key, values in {"set": name, **paired.cars}.items()}
    table |= {key: np.repeat([getattr(way, key) for way in ways], cars) for key in ("detail", "losses")}
    table |= {key: np.concatenate([of[key] for of in paired.of]) for key in paired.of[0]}
    table["error_bits"] = table["simulated_entropy_bits"] - table["real_entropy_bits"]
    floats = [key for key, values in table.items() if values.dtype.kind == "f"]
    return table, {key: 3 if key.endswith(("_m", "_deg")) else 5 for key in floats}
