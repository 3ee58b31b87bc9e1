"""Errors of simulated against real PE-VGOP: medians over cars, with intervals that resample frames.

The cars of one frame share light, weather and road, so frames are what is drawn anew. Variants are compared car by car
under the same resamples: what is common to both does not blur their difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..study.statistics import FEWEST_BLOCKS, RESAMPLES, interval_90, resampled_weights
from .frame_list import TUNED, UNTOUCHED
from .paired_cars import BEARINGS, PairedCars

BANDS_M = ((10.0, 20.0), (20.0, 30.0), (30.0, 40.0), (40.0, 50.0))
SEED = 1


def aggregate(paired: PairedCars, tuned: frozenset[str] | None) -> dict:
    """All aggregates, ready for JSON.

    Parameters
    ----------
    paired : PairedCars
    tuned : frozenset of str or None
        Frames that shapes and figures were tuned on; None where the data set does not say.
    """
    return {
        name: {
            "cars": int(which.sum()),
            "frames": len(set(paired.cars["frame"][which].tolist())),
            "real_entropy_bits_median": float(np.median(paired.cars["real_entropy_bits"][which])),
            "hidden_share": _share(paired.cars["hidden_share"], paired.cars["rays"], which),
            "variants": [_of_variant(paired, index, which) for index in range(len(paired.variants))],
            "differences": _differences(paired, which),
        }
        for name, which in sets_of(paired, tuned).items()
    }


def sets_of(paired: PairedCars, tuned: frozenset[str] | None) -> dict[str, np.ndarray]:
    """Which cars are in each set, (c,) bool: all, and those of tuned and of untouched frames where both are there."""
    everything = {"all": np.ones(len(paired), dtype=bool)}
    if tuned is None:
        return everything
    told = np.isin(paired.cars["frame"], sorted(tuned))
    return everything | {name: which for name, which in {TUNED: told, UNTOUCHED: ~told}.items() if which.any()}


def judging(names: Sequence[str]) -> str:
    """The set that judges: of untouched frames, or all where the data set does not tell them apart."""
    return UNTOUCHED if UNTOUCHED in names else "all"


def median_interval(values: np.ndarray, frame: np.ndarray) -> dict:
    """Median of values (c,) and its 90 % interval over resampled frames; None for fewer than three frames."""
    resampled = _resampled_medians(values[None], frame)
    return {
        "median": float(np.median(values)),
        "interval_90": None if resampled is None else list(interval_90(resampled[0])),
    }


def _of_variant(paired: PairedCars, index: int, which: np.ndarray) -> dict:
    way, columns, cars = paired.variants[index], paired.of[index], paired.cars
    error, frame = paired.errors(index)[which], cars["frame"][which]
    real, simulated, both = (
        int(values[which].sum())
        for values in (cars["real_points"], columns["simulated_points"], columns["both_points"])
    )
    residual = columns["residual_abs_median_m"][which]
    distance, bearing = cars["distance_m"][which], cars["bearing_deg"][which]
    return {
        "detail": way.detail,
        "losses": way.losses,
        "absolute_error_bits": median_interval(np.abs(error), frame),
        "bias_bits": median_interval(error, frame),
        "absolute_error_hidden_kept_bits": median_interval(np.abs(paired.errors(index, True)[which]), frame),
        "absolute_error_p": {
            view: float(np.median(np.abs(columns[f"simulated_p_{view}"] - cars[f"real_p_{view}"])[which]))
            for view in ("top", "side", "front")
        },
        "by_distance": [
            {"low_m": low, "high_m": high, **_group(error, frame, (distance >= low) & (distance < high))}
            for low, high in BANDS_M
        ],
        "by_bearing": [
            {"bearing": name, **_group(error, frame, (bearing >= low) & (bearing < high))}
            for name, (low, high) in BEARINGS.items()
        ],
        "hits": {"both": both, "real_only": real - both, "simulated_only": simulated - both},
        "residual_abs_median_m": float(np.nanmedian(residual)) if np.isfinite(residual).any() else None,
    }


def _group(error: np.ndarray, frame: np.ndarray, chosen: np.ndarray) -> dict:
    if not chosen.any():
        return {"cars": 0, "absolute_error_bits": None, "bias_bits": None}
    return {
        "cars": int(chosen.sum()),
        "absolute_error_bits": median_interval(np.abs(error[chosen]), frame[chosen]),
        "bias_bits": median_interval(error[chosen], frame[chosen]),
    }


def _differences(paired: PairedCars, which: np.ndarray) -> list[dict]:
    """Of every two variants: how much the first one's median absolute error exceeds the second one's.

    With fewer than three frames nothing can be said of the noise: None.
    """
    errors = np.abs([paired.errors(index)[which] for index in range(len(paired.variants))])
    medians = np.median(errors, axis=1)
    resampled = _resampled_medians(errors, paired.cars["frame"][which])
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


def _resampled_medians(values: np.ndarray, frame: np.ndarray) -> np.ndarray | None:
    """Medians (v, resamples) of values (v, c) whose frames (c,) are drawn anew; None for too few frames."""
    labels, row = np.unique(frame, return_inverse=True)
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
    """The variant with the smallest median error, and of those within its noise the one of the cheapest level.

    Parameters
    ----------
    of : mapping
        One set of `aggregate`.
    details : sequence of str
        Levels of detail from the cheapest on.
    """
    medians = [one["absolute_error_bits"]["median"] for one in of["variants"]]
    keys = [{key: one[key] for key in ("detail", "losses")} for one in of["variants"]]
    best = keys[int(np.argmin(medians))]
    rivals = {
        (one["first"]["detail"], one["first"]["losses"]): one for one in of["differences"] if one["second"] == best
    }
    for detail in details:
        within = [
            (median, key)
            for median, key in zip(medians, keys, strict=True)
            if key["detail"] == detail and (key == best or rivals[detail, key["losses"]]["within_noise"])
        ]
        if within:
            cheapest = min(within, key=lambda one: one[0])[1]
            break
    found = {"best": best, "cheapest": cheapest, "difference_bits": 0.0, "interval_90": None}
    if cheapest != best:
        rival = rivals[cheapest["detail"], cheapest["losses"]]
        found |= {key: rival[key] for key in ("difference_bits", "interval_90")}
    return found
