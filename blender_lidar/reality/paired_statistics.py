"""Errors of simulated against real PE-VGOP: medians over cars, with intervals that resample clusters of them.

The cars of one frame share light, weather and road, and those of a drive are partly the same, so whole drives are drawn
anew where they are told, else frames. Variants are compared car by car under the same resamples: what is common to both
does not blur their difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..study.statistics import FEWEST_BLOCKS, RESAMPLES, interval_90, resampled_weights
from .car_sets import ALL, Clusters, clusters
from .cars import of_bearing
from .frame_list import TUNED, VALIDATION, FrameList
from .paired_cars import PairedCars

BANDS_M = ((10.0, 20.0), (20.0, 30.0), (30.0, 40.0), (40.0, 50.0))
SEED = 1


def aggregate(paired: PairedCars, told: FrameList) -> dict:
    """All aggregates, set by set, ready for JSON; `told` is what the data set tells of its frames."""
    return {name: _of_set(paired, told, which) for name, which in sets_of(paired, told.tuned).items()}


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


def median_interval(values: np.ndarray, cluster: np.ndarray) -> dict:
    """Median of values (c,) and its 90 % interval over resampled clusters (c,); None for fewer than three."""
    resampled = _resampled_medians(values[None], cluster)
    return {
        "median": float(np.median(values)),
        "interval_90": None if resampled is None else list(interval_90(resampled[0])),
    }


def _of_set(paired: PairedCars, told: FrameList, which: np.ndarray) -> dict:
    frame = paired.cars["frame"][which]
    drawn = clusters(frame, told.of(frame), 1)
    return {
        "cars": int(which.sum()),
        "frames": len(set(frame.tolist())),
        "resampled": {"unit": drawn.unit, "number": drawn.number, "too_narrow": drawn.too_narrow},
        "real_entropy_bits_median": float(np.median(paired.cars["real_entropy_bits"][which])),
        "hidden_share": _share(paired.cars["hidden_share"], paired.cars["rays"], which),
        "variants": [_of_variant(paired, index, which, drawn) for index in range(len(paired.variants))],
        "differences": _differences(paired, which, drawn),
    }


def _of_variant(paired: PairedCars, index: int, which: np.ndarray, drawn: Clusters) -> dict:
    way, columns, cars = paired.variants[index], paired.of[index], paired.cars
    error, cluster = paired.errors(index)[which], drawn.of_car
    real, simulated, both = (
        int(values[which].sum())
        for values in (cars["real_points"], columns["simulated_points"], columns["both_points"])
    )
    residual = columns["residual_abs_median_m"][which]
    distance = cars["distance_m"][which]
    return {
        "detail": way.detail,
        "losses": way.losses,
        "absolute_error_bits": median_interval(np.abs(error), cluster),
        "bias_bits": median_interval(error, cluster),
        "absolute_error_hidden_kept_bits": median_interval(np.abs(paired.errors(index, True)[which]), cluster),
        "absolute_error_p": {
            view: float(np.median(np.abs(columns[f"simulated_p_{view}"] - cars[f"real_p_{view}"])[which]))
            for view in ("top", "side", "front")
        },
        "by_distance": [
            {"low_m": low, "high_m": high, **_group(error, cluster, (distance >= low) & (distance < high))}
            for low, high in BANDS_M
        ],
        "by_bearing": [
            {"bearing": name, **_group(error, cluster, chosen)}
            for name, chosen in of_bearing(cars["bearing_deg"][which]).items()
        ],
        "hits": {"both": both, "real_only": real - both, "simulated_only": simulated - both},
        "residual_abs_median_m": float(np.nanmedian(residual)) if np.isfinite(residual).any() else None,
    }


def _group(error: np.ndarray, cluster: np.ndarray, chosen: np.ndarray) -> dict:
    if not chosen.any():
        return {"cars": 0, "absolute_error_bits": None, "bias_bits": None}
    return {
        "cars": int(chosen.sum()),
        "absolute_error_bits": median_interval(np.abs(error[chosen]), cluster[chosen]),
        "bias_bits": median_interval(error[chosen], cluster[chosen]),
    }


def _differences(paired: PairedCars, which: np.ndarray, drawn: Clusters) -> list[dict]:
    """Of every two variants: how much the first one's median absolute error exceeds the second one's.

    With fewer than three clusters nothing can be said of the noise: None.
    """
    errors = np.abs([paired.errors(index)[which] for index in range(len(paired.variants))])
    medians = np.median(errors, axis=1)
    resampled = _resampled_medians(errors, drawn.of_car)
    found = []
    for first in range(len(errors)):
        for second in range(len(errors)):
            if first == second:
                continue
            interval = None if resampled is None else interval_90(resampled[first] - resampled[second])
            found.append(
                {
                    "first": _name(paired, first),
                    "second": _name(paired, second),
                    "difference_bits": float(medians[first] - medians[second]),
                    "interval_90": None if interval is None else list(interval),
                    "within_noise": None if interval is None else bool(interval[0] <= 0.0 <= interval[1]),
                }
            )
    return found


def _name(paired: PairedCars, index: int) -> Mapping[str, str]:
    return {"detail": paired.variants[index].detail, "losses": paired.variants[index].losses}


def _resampled_medians(values: np.ndarray, cluster: np.ndarray) -> np.ndarray | None:
    """Medians (v, resamples) of values (v, c) whose clusters (c,) are drawn anew; None for too few of them."""
    labels, row = np.unique(cluster, return_inverse=True)
    if len(labels) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(len(labels), np.random.default_rng(SEED), RESAMPLES)[:, row]
    weights = weights[weights.sum(axis=1) > 0.0]
    medians = np.empty((len(values), len(weights)))
    for index, of_one in enumerate(values):
        order = np.argsort(of_one, kind="stable")
        reached = np.cumsum(weights[:, order], axis=1)
        medians[index] = of_one[order][np.argmax(reached >= 0.5 * reached[:, -1:], axis=1)]
    return medians


def _share(share: np.ndarray, of: np.ndarray, which: np.ndarray) -> float:
    return float((share * of)[which].sum() / max(int(of[which].sum()), 1))


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
    keys = [{key: one[key] for key in ("detail", "losses")} for one in of["variants"]]
    best = keys[int(np.argmin([one["absolute_error_bits"]["median"] for one in of["variants"]]))]
    found = {"best": best, "cheapest": best, "difference_bits": 0.0, "interval_90": None}
    rivals = {
        one["first"]["detail"]: one
        for one in of["differences"]
        if one["second"] == best and one["first"]["losses"] == best["losses"]
    }
    for detail in details[: details.index(best["detail"])]:
        if detail in rivals and rivals[detail]["within_noise"]:
            rival = rivals[detail]
            return (
                found | {"cheapest": rival["first"]} | {key: rival[key] for key in ("difference_bits", "interval_90")}
            )
    return found
