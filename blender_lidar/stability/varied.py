"""Findings on what was varied: where the optimum would go, and what the mounting leaves to it on other traffic."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..study.landscape import Landscape
from ..study.statistics import linear_interval_90
from .findings import UNDECIDED, Finding, by_loss, lost
from .landscape import losses_to
from .mountings import BASELINE, CANDIDATES, REFERENCE, Mountings


@dataclass(frozen=True, slots=True)
class Intervals:
    """Where resampled traffic puts the optimum: 90 % intervals of height [m] and tilt [deg]."""

    height_m: tuple[float, float]
    tilt_deg: tuple[float, float]

    def hold(self, height_m: float, tilt_deg: float, steps: tuple[float, float] = (0.0, 0.0)) -> bool:
        """Whether an optimum lies in both, which neither rounding nor the grid that it is on decides.

        `steps` of that grid, [m] and [deg]: no more is known of the optimum than that it is within half a step.
        """
        pairs = ((self.height_m, height_m, steps[0]), (self.tilt_deg, tilt_deg, steps[1]))
        return all(low - 0.5 * step - 1e-6 <= value <= high + 0.5 * step + 1e-6 for (low, high), value, step in pairs)


@dataclass(frozen=True, slots=True, eq=False)
class Draw:
    """One draw of a change.

    Attributes
    ----------
    best : int
        The candidate that is best on the searched frames.
    chooses : bool
        Whether the objective prefers any candidate there.
    judged : Landscape
        The mounting in question, the baseline and that candidate on the frames that judge.
    """

    best: int
    chooses: bool
    judged: Landscape


def finding_of(
    change: tuple[str, str, str],
    draws: Sequence[Draw | str],
    mountings: Mountings,
    intervals: Intervals | None,
    block: np.ndarray | None,
) -> Finding:
    """What one change does to the mounting in question; several draws of it are judged by their mean.

    Parameters
    ----------
    change : (str, str, str)
        Section, what and value.
    draws : sequence of Draw or str
        A text tells why the site does not allow the change.
    mountings : Mountings
    intervals : Intervals or None
        Where resampled traffic puts the optimum of the scene as it is.
    block : ndarray of int, (f,), or None
        Block of each frame that judges; None where the same frames chose the best mounting, whose luck no interval has.
    """
    refused = [draw for draw in draws if isinstance(draw, str)]
    if refused:
        return Finding(*change, UNDECIDED, refused[0])
    if not all(draw.chooses for draw in draws):
        return Finding(*change, UNDECIDED, "does not choose: it is the same wherever the LiDAR hangs")
    best = [draw.best for draw in draws]
    places = list(zip(mountings.height_m[best].tolist(), mountings.tilt_deg[best].tolist(), strict=True))
    numbers = {
        "best_height_m": [height for height, _ in places],
        "best_tilt_deg": [tilt for _, tilt in places],
        "inside": None if intervals is None else [intervals.hold(*place, mountings.steps) for place in places],
        "vehicles_per_frame": float(np.mean([draw.judged.vehicles.mean() for draw in draws])),
    }
    losses = [float(losses_to(draw.judged.per_vehicle()[:, None])[0]) for draw in draws]
    if np.isnan(losses).any():
        text = "what is best on the searched frames gains nothing on those that judge"
        return Finding(*change, UNDECIDED, text, numbers)
    loss, interval = float(np.mean(losses)), None if block is None else _interval(draws, block)
    numbers = {"loss": loss, "interval_90": interval, "losses": losses, **numbers}
    return Finding(*change, by_loss(loss, interval), f"{lost(loss, interval)}; {_places(numbers)}", numbers)


def _interval(draws: Sequence[Draw], block: np.ndarray) -> list[float] | None:
    """90 % interval of the mean loss over blocks of time; None for too few of them.

    The loss is a ratio of sums over blocks, what the mounting leaves over what there is to gain.
    """
    vehicles = sum(draw.judged.blocks(block)[1] for draw in draws)
    influence = np.mean([_influence(draw.judged.blocks(block)[0]) for draw in draws], axis=0)[vehicles > 0]
    loss = float(np.mean([losses_to(draw.judged.per_vehicle()[:, None]) for draw in draws]))
    interval = linear_interval_90(loss, influence)
    return None if interval is None else list(interval)


def _influence(objective: np.ndarray) -> np.ndarray:
    """How far each block moves the loss, (b,), from the objective of a draw's three mountings, (3, b)."""
    rival = objective[CANDIDATES]
    left, gain = rival - objective[REFERENCE], rival - objective[BASELINE]
    return (left - left.sum() / gain.sum() * gain) / gain.sum()


def _places(numbers) -> str:
    """Where the optimum would be."""
    heights, tilts = (_range(numbers[key], digits) for key, digits in (("best_height_m", 2), ("best_tilt_deg", 0)))
    text, inside = f"best at {heights} m, {tilts} deg", numbers["inside"]
    if inside is None:
        return text
    if all(inside):
        return f"{text}: inside"
    return f"{text}: outside" if not any(inside) else f"{text}: {sum(inside)} of {len(inside)} inside"


def _range(values: Sequence[float], digits: int) -> str:
    low, high = (f"{end:.{digits}f}" for end in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"
