"""Lanes from where vehicles drive across a road: peaks of a kernel density estimate, or the recording's own lanes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

LANE_WIDTHS_M = (2.4, 5.2)
USUAL_LANE_M = 3.5
FEWEST_ON_A_ROAD = 3  # that make a carriageway
FEW = 0.02  # share of the traffic that makes no lane, and no crossing
ONE_CARRIAGEWAY_M = 2.1 * USUAL_LANE_M  # up to which lanes are neighbours: at most an unused one lies between
_SAME_WIDTH_M = 0.3  # of the lanes of two carriageways


@dataclass(frozen=True, slots=True, eq=False)
class Lanes:
    """The lanes of one carriageway, or of two that are alike.

    Attributes
    ----------
    centres : ndarray, (k,)
        Measured, across the road from the right [m]; a lane that nobody uses has none.
    numbers : tuple of int
        The recording's numbers of these lanes, from the right; empty where its lanes were not used.
    width_m, right_m : float
        Width of one lane, and where the right edge of the road lies [m].
    count : int
        Lanes of a carriageway.
    median_m : float or None
        Between this carriageway and a second one to its left [m]; None where there is no second one.
    """

    centres: np.ndarray
    numbers: tuple[int, ...]
    width_m: float
    right_m: float
    count: int
    median_m: float | None = None

    @property
    def left_m(self) -> float:
        """The left edge of the carriageway [m]."""
        return self.right_m + self.count * self.width_m

    def with_second(self, second: Lanes) -> Lanes | None:
        """Both carriageways, where `second`, to the left, has as many lanes as wide; else None.

        Lanes are narrowed where both would overlap, as where a single lane has no neighbour to take its width from.
        """
        first, other = (0.5 * (one.right_m + one.left_m) for one in (self, second))
        width = round(min(self.width_m, (other - first) / self.count), 2)
        alike = abs(self.width_m - second.width_m) <= _SAME_WIDTH_M and second.count == self.count
        if not alike or width < LANE_WIDTHS_M[0]:
            return None
        median = max(0.0, round(other - first - self.count * width, 2))
        centres, right = np.concatenate([self.centres, second.centres]), first - 0.5 * self.count * width
        return replace(self, centres=centres, width_m=width, right_m=right, median_m=median)


def lanes_across(v: np.ndarray, vehicle: np.ndarray, speed: np.ndarray, lane: np.ndarray) -> Lanes | None:
    """Lanes of the busiest carriageway from where vehicles that drive one way are.

    Parameters
    ----------
    v : ndarray, (n,)
        Places across the road, to the left [m].
    vehicle, speed, lane : ndarray, (n,)
        Whose they are, how fast [m/s], and the recording's lane; 0 where it names none.

    Returns
    -------
    Lanes or None
        None where there are too few vehicles.
    """
    if len(np.unique(vehicle)) < FEWEST_ON_A_ROAD:
        return None
    peaks = density_peaks(v, speed)
    recorded = _recorded_lanes(v, speed, lane)
    centres, numbers = recorded if recorded and len(recorded[0]) >= len(_neighbours(peaks)) else (peaks, ())
    kept = _neighbours(centres)
    numbers = tuple(number for centre, number in sorted(zip(centres, numbers, strict=False)) if centre in kept)
    centres = np.sort(kept)
    if len(centres) == 1:
        width, first = USUAL_LANE_M, centres[0]
        count = 1
    else:  # by least squares, as one width is all that a scene has
        apart = np.diff(centres)
        usual = float(np.median(apart[apart <= 1.5 * apart.min()]))
        usual = usual if usual <= LANE_WIDTHS_M[1] else usual / 2.0  # with an unused lane between
        place = np.concatenate([[0], np.cumsum(np.maximum(np.rint(apart / usual), 1))])
        width, first = np.polyfit(place, centres, 1)
        count = int(place[-1]) + 1
    width = round(float(width), 2)
    return Lanes(centres, numbers, width, float(first) - 0.5 * width, count)


def density_peaks(v: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Peaks of a kernel density estimate with a lane's depth of valley between them, the highest first [m]."""
    step, sigma = 0.05, 0.4
    low = v.min() - 3.0
    counts = np.bincount(((v - low) / step).astype(int), weights=weight, minlength=int((v.max() + 3.0 - low) / step))
    reach = np.arange(-40, 41) * step
    density = np.convolve(counts, np.exp(-0.5 * (reach / sigma) ** 2), "same")
    inner = density[1:-1]
    tops = 1 + np.flatnonzero((inner > density[:-2]) & (inner >= density[2:]) & (inner >= FEW * density.max()))
    kept: list[int] = []
    for top in tops[np.argsort(-density[tops], kind="stable")]:
        between = (density[min(top, other) : max(top, other) + 1].min() for other in kept)
        apart = all(abs(top - other) * step >= LANE_WIDTHS_M[0] for other in kept)
        if apart and all(valley <= 0.8 * density[top] for valley in between):
            kept.append(int(top))
    return low + (np.array(kept) + 0.5) * step


def _recorded_lanes(v: np.ndarray, speed: np.ndarray, lane: np.ndarray) -> tuple[np.ndarray, tuple[int, ...]] | None:
    """Medians of the lanes that the recording names, the busiest first [m], and their numbers; None if they are none.

    Numbers that mean different lanes on different edges, as SUMO's may, spread over more than a lane.
    """
    numbers = np.unique(lane[lane != 0])
    weights = np.array([speed[lane == number].sum() for number in numbers])
    used = weights >= FEW * weights.sum()
    if not used.any():
        return None
    order = np.argsort(-weights[used], kind="stable")
    numbers = numbers[used][order]
    across = [v[lane == number] for number in numbers]
    centres = np.array([np.median(one) for one in across])
    spread = max(float(np.median(np.abs(one - centre))) for one, centre in zip(across, centres, strict=True))
    apart = np.diff(np.sort(centres))
    if spread > 0.25 * LANE_WIDTHS_M[1] or (apart < LANE_WIDTHS_M[0]).any():
        return None
    return centres, tuple(numbers.tolist())


def _neighbours(centres: np.ndarray) -> np.ndarray:
    """The lanes of one carriageway: the first, and those at most an unused lane from the next."""
    kept, rest = [centres[0]], list(centres[1:])
    while near := [one for one in rest if min(abs(one - other) for other in kept) <= ONE_CARRIAGEWAY_M]:
        kept += near
        rest = [one for one in rest if one not in near]
    return np.array(kept)
