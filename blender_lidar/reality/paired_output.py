"""What the paired comparison leaves in its folder, and what it prints."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import MissingExtraError
from ..formats.atomic import write_text
from ..formats.tables import write_columns
from ..plots.paired_cars import plot_paired_cars, plot_paired_scores
from ..plots.paired_errors import Series, plot_paired_errors
from ..plots.paired_residuals import plot_paired_residuals
from ..study.statistics import FEWEST_BLOCKS
from .frame_list import TUNED, VALIDATION, FrameList
from .paired_cars import PairedCars
from .paired_statistics import judging, sets_of
from .variants import DRAWN, LOSSES

RESULT, TABLE = "paired.json", "paired.csv"
_FIVE, _THREE = 5, 3  # digits


def write_results(folder: Path, paired: PairedCars, result: Mapping, told: FrameList) -> list[str]:
    """Write the table, the pictures and, last, all aggregates; returns the names of the files.

    Without matplotlib there are no pictures, and the last name says so.
    """
    write_columns(folder / TABLE, _rows(paired, told), _decimals(paired))
    pictures, note = [], []
    try:
        pictures = _draw(folder, paired, result)
    except MissingExtraError as error:
        note = [f"no pictures: {error}"]
    write_text(folder / RESULT, json.dumps(result, indent=2) + "\n")
    return [TABLE, RESULT, *pictures, *note]


def summary(result: Mapping) -> str:
    """The findings as tables for a terminal, of the set that judges."""
    sets = result["sets"]
    name = judging(sets)
    of = sets[name]
    lines = [
        f"Sweeps     {result['sweeps']} in {result['folder']}, {result['layout']} layout",
        f"Sensor     {_rings(result['sensor'])}",
        f"Cars       {sets['all']['cars']} whole ones at 10 to 50 m; {_left_out(result['left_out'])}",
        f"Casting    {result['caster']}; losses: {_losses(result['losses'])}",
    ]
    if name == VALIDATION:
        lines.append(f"Judged on  {of['cars']} cars in {of['frames']} frames that nothing was fitted to")
    elif TUNED in sets:
        lines.append("Judged on  the frames that shapes and losses were fitted to, so that errors are too small")
    lines += ["", "PE-VGOP of each car, simulated less real [bits], and its rays", _HEAD]
    lines += [_row(one) for one in of["variants"]]
    lines += ["", "median error at              10-20 m  20-30 m  30-40 m  40-50 m   end-on  oblique  side-on"]
    lines += [_band_row(one) for one in of["variants"]]
    counts = of["variants"][0]
    lines.append(f"{'cars':<26}" + "".join(f"{group['cars']:>9}" for key in _GROUPS for group in counts[key]))
    lines += ["", *_LEGEND, "", *_verdict(result["cheapest_within_noise"], of["resampled"]["number"])]
    if TUNED in sets and VALIDATION in sets:
        best = result["cheapest_within_noise"]["best"]
        error = {key: _find(sets[key], best)["absolute_error_bits"]["median"] for key in (TUNED, VALIDATION)}
        lines.append(
            f"It errs by {error[TUNED]:.3f} on the frames of the fit and by {error[VALIDATION]:.3f} on the others."
        )
    lines += _cautions(of["resampled"])
    return "\n".join(lines)


_GROUPS = ("by_distance", "by_bearing")
_LEGEND = (
    "both, real only, sim. only: rays to the cars that return from them in reality, against our shapes, or in both",
    "with hidden: the median error with the rays that something unlabelled stopped before the car",
    "|range|: real less simulated range of the rays that return in both; median of the cars' medians",
)
_HEAD = (
    f"{'detail, losses':<26}  median error  90 % interval     bias  with hidden     both  real only  sim. only  |range|"
)


def _row(one: Mapping) -> str:
    error, hits = one["absolute_error_bits"], one["hits"]
    low, high = error["interval_90"] or (np.nan, np.nan)
    residual = one["residual_abs_median_m"]
    return (
        f"{_name(one):<26}  {error['median']:12.3f}  {low:.3f} to {high:.3f}  {one['bias_bits']['median']:+7.3f}"
        f"  {one['absolute_error_hidden_kept_bits']['median']:11.3f}  {hits['both']:>7,}  {hits['real_only']:>9,}"
        f"  {hits['simulated_only']:>9,}  {np.nan if residual is None else residual:5.3f} m"
    )


def _band_row(one: Mapping) -> str:
    medians = [group["absolute_error_bits"] for key in _GROUPS for group in one[key]]
    texts = ["-" if each is None else f"{each['median']:.3f}" for each in medians]
    return f"{_name(one):<26}" + "".join(f"{text:>9}" for text in texts)


def _verdict(found: Mapping, number: int) -> list[str]:
    best, cheapest = found["best"], found["cheapest"]
    if number < FEWEST_BLOCKS:
        return [f"Smallest error: {_name(best)}; with fewer than {FEWEST_BLOCKS} frames there are no intervals."]
    if best == cheapest:
        return [f"Best: {_name(best)}. No cheaper level of detail is within the noise of it."]
    low, high = found["interval_90"]
    return [
        f"Best: {_name(best)}. The cheapest level of detail within its noise: {cheapest['detail']},",
        f"whose median error is {found['difference_bits']:+.3f} bits off it (90 % interval {low:+.3f} to {high:+.3f}).",
    ]


def _cautions(resampled: Mapping) -> list[str]:
    number, unit = resampled["number"], resampled["unit"]
    lines = [f"Intervals are of {number} resampled {unit}{'s' * (number != 1)}."] if number >= FEWEST_BLOCKS else []
    if lines and resampled["too_narrow"]:
        lines.append(
            "They are too narrow: frames of one drive show the same cars again, and a column drive of frames.csv tells "
            "no drives, or fewer than three."
        )
    return lines


def _find(of: Mapping, wanted: Mapping) -> Mapping:
    return next(one for one in of["variants"] if all(one[key] == wanted[key] for key in ("detail", "losses")))


def _name(one: Mapping) -> str:
    return f"{one['detail']}, {LOSSES[one['losses']]}"


def _rings(sensor: Mapping) -> str:
    counts = " or ".join(map(str, sensor["rings"]))
    text = f"{counts} rings, a firing every {sensor['azimuth_step_deg']:.4f} deg"
    if "height_m" in sensor:
        height, lateral = np.array(sensor["height_m"]), np.array(sensor["lateral_m"])
        elevation = sensor["elevation_deg"]
        text += (
            f", {elevation[0]:.2f} to {elevation[-1]:.2f} deg, lasers {height.min():.3f} to {height.max():.3f} m above "
            f"and up to {np.abs(lateral).max():.3f} m beside the axis"
        )
    return text


def _left_out(reasons: Mapping) -> str:
    return "left out: " + ", ".join(f"{count} {reason}" for reason, count in reasons.items())


def _losses(losses: Mapping) -> str:
    return (
        f"{100 * losses['glass_dropout']:g} % of the returns from glass, {100 * losses['dropout']:g} % of any, noise "
        f"{losses['range_noise_m']:g} m; weak: 10 % seen to {losses['range_at_10_percent_m']:g} m"
    )


def _rows(paired: PairedCars, told: FrameList) -> dict[str, np.ndarray]:
    """One row for each car and variant, variant after variant."""
    ways, cars = paired.variants, len(paired)
    sets = sets_of(paired, told.tuned)
    name = np.full(cars, "all", dtype="<U10")
    for key in (TUNED, VALIDATION):
        if key in sets:
            name[sets[key]] = key
    table = {key: np.tile(values, len(ways)) for key, values in {"set": name, **paired.cars}.items()}
    table["detail"] = np.repeat([way.detail for way in ways], cars)
    table["losses"] = np.repeat([way.losses for way in ways], cars)
    table |= {key: np.concatenate([of[key] for of in paired.of]) for key in paired.of[0]}
    table["error_bits"] = table["simulated_entropy_bits"] - table["real_entropy_bits"]
    return table


def _decimals(paired: PairedCars) -> dict[str, int]:
    columns = {**paired.cars, **paired.of[0], "error_bits": np.zeros(1)}
    return {
        key: _THREE if key.endswith(("_m", "_deg")) else _FIVE
        for key, values in columns.items()
        if np.asarray(values).dtype.kind == "f"
    }


def _draw(folder: Path, paired: PairedCars, result: Mapping) -> list[str]:
    sets = result["sets"]
    judges = judging(sets)
    of = sets[judges]
    resampled = f"resampled {of['resampled']['unit']}s"
    drawn = [index for index, way in enumerate(paired.variants) if way.losses == DRAWN]
    plain = [index for index, way in enumerate(paired.variants) if way.losses == "none"]
    names = {
        "error.png": lambda path: plot_paired_errors(
            path,
            [_series(one) for one in of["variants"]],
            title="Error of simulated PE-VGOP against a real LiDAR's",
            subtitle=f"{of['cars']} cars in {of['frames']} real sweeps, ray by ray; bars: 90 % of {resampled}",
        ),
        "scores.png": lambda path: plot_paired_scores(
            path,
            paired.cars["real_entropy_bits"],
            {paired.variants[index].detail: paired.of[index]["simulated_entropy_bits"] for index in drawn},
            paired.cars["distance_m"],
            title="PE-VGOP of each car, simulated against real",
            subtitle=f"all {len(paired)} cars; {LOSSES[DRAWN]} lost",
        ),
        "cars.png": lambda path: plot_paired_cars(
            path,
            [
                (f"Frame {one.frame}, label {one.label_line}", one.size_m, one.real, one.simulated)
                for one in paired.pictured
            ],
            title="The same rays in reality and against shapes",
            subtitle=f"{LOSSES[DRAWN]} lost; from the side and from above, with the label's box",
        ),
        "residuals.png": lambda path: plot_paired_residuals(
            path,
            {paired.variants[index].detail: paired.residuals[paired.variants[index].detail] for index in plain},
            title="Real less simulated range over the car",
            subtitle="median of the rays that hit in both, all cars laid over one another; nothing lost",
        ),
    }
    for name, draw in names.items():
        draw(folder / name)
    return list(names)


def _series(one: Mapping) -> Series:
    bands = one["by_distance"]
    return Series(
        detail=one["detail"],
        losses=LOSSES[one["losses"]],
        median=one["absolute_error_bits"]["median"],
        interval=one["absolute_error_bits"]["interval_90"],
        bands=[(band["low_m"], band["high_m"]) for band in bands],
        band_median=[band["absolute_error_bits"] and band["absolute_error_bits"]["median"] for band in bands],
        band_interval=[band["absolute_error_bits"] and band["absolute_error_bits"]["interval_90"] for band in bands],
        band_cars=[band["cars"] for band in bands],
        by_distance=one["losses"] == DRAWN,
    )
