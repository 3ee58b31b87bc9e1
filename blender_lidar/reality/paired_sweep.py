"""The cars of one sweep, real and simulated in every variant, as columns of numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..metrics.vgop import entropy, occupancy
from ..sensors.detection_range import detection_range_m
from ..sensors.imperfections import Imperfections
from ..world.meshes import GLASS, REFLECTIVITY
from .cars import bearing_deg
from .labelled import LabelledSweep
from .pairing import CarRays, Simulated, hits_of, points_along, simulate
from .rays import NO_POINT
from .variants import Variant

VIEWS = ("top", "side", "front")


@dataclass(frozen=True, slots=True)
class _RowOfBeams:
    """Rays as imperfections know them: a lattice of one ring, so that every ray draws its own numbers."""

    columns: int
    rings: int = 1

    def column(self, ring: np.ndarray, slot: np.ndarray) -> np.ndarray:
        return slot + 0 * ring


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What one variant made of a sweep's rays.

    Attributes
    ----------
    distance_m : ndarray, (k,)
        As measured along each ray [m]; inf where nothing returned.
    hit : ndarray of int64
        Rays that hit their car.
    shown : ndarray of int64
        Those of them that nothing hid in reality.
    both : ndarray of int64
        Those of them that hit it in reality too.
    """

    distance_m: np.ndarray
    hit: np.ndarray
    shown: np.ndarray
    both: np.ndarray


class PairedSweep:
    """One sweep's chosen cars.

    Parameters
    ----------
    sweep : LabelledSweep
    rays : CarRays
        Towards the boxes `rows`.
    rows : ndarray of int64, (c,)
        The chosen cars.
    number : int
        Of the sweep: what is left to chance belongs to it.
    """

    def __init__(self, sweep: LabelledSweep, rays: CarRays, rows: np.ndarray, number: int) -> None:
        self.sweep, self.rays, self.rows, self._number = sweep, rays, rows, number
        self.real = np.flatnonzero(rays.real)

    def outcomes(self, ways: tuple[Variant, ...], caster: str, margin_m: np.ndarray) -> list[Outcome]:
        """What each variant makes of the rays."""
        seen = {}
        for detail in sorted({way.detail for way in ways}):
            seen[detail] = simulate(self.sweep, self.rays, detail, caster, margin_m)
        found = []
        for way in ways:
            distance = self._measured(seen[way.detail], way.imperfections)
            hit = hits_of(self.sweep, self.rays, distance, seen[way.detail].of_car)
            shown = hit[~self.rays.hidden[hit]]
            found.append(Outcome(distance, hit, shown, np.intersect1d(shown, self.real, assume_unique=True)))
        return found

    def _measured(self, seen: Simulated, imperfections: Imperfections) -> np.ndarray:
        """Ranges as an imperfect sensor measures them, inf where nothing returns, as `scan` has it."""
        distance = seen.distance_m
        draws = imperfections.draws(_RowOfBeams(len(self.rays)), self._number)
        if draws is not None:
            distance = draws.measured(np.arange(len(self.rays)), distance, seen.surface == GLASS)
        limit = imperfections.range_at_10_percent_m
        if limit is not None:
            far = seen.distance_m > detection_range_m(limit, REFLECTIVITY[seen.surface], seen.cosine)
            distance = np.where(far, np.inf, distance)
        return distance

    def real_columns(self) -> dict[str, np.ndarray]:
        """What does not depend on the variant, (c,) each."""
        boxes, rows, rays = self.sweep.boxes, self.rows, self.rays
        toward = self._count(np.arange(len(rays)))
        share, bits = self._scores(self.local(rays.rays.range_m, self.real), self.real)
        return {
            "frame": np.full(len(rows), self.sweep.frame),
            "label_line": boxes.label_line[rows],
            "distance_m": boxes.distance_m[rows],
            "bearing_deg": bearing_deg(self.sweep.boxes.select(self.rows)),
            **{f"{side}_m": boxes.size_m[rows, axis] for axis, side in enumerate(("length", "width", "height"))},
            "occlusion": boxes.occlusion[rows].astype(int),
            "rays": toward,
            "hidden_share": self._count(np.flatnonzero(rays.hidden)) / np.maximum(toward, 1),
            "unreturned_share": self._count(np.flatnonzero(rays.rays.point == NO_POINT)) / np.maximum(toward, 1),
            "real_points": self._count(self.real),
            **{f"real_p_{view}": column for view, column in zip(VIEWS, share.T, strict=True)},
            "real_entropy_bits": bits,
        }

    def columns(self, outcome: Outcome) -> dict[str, np.ndarray]:
        """What a variant comes to, (c,) each; residuals are NaN where no ray hit in both."""
        shown, both = outcome.shown, outcome.both
        share, bits = self._scores(self.local(outcome.distance_m, shown), shown)
        off = self.residuals(outcome)
        return {
            "simulated_points": self._count(shown),
            "both_points": self._count(both),
            **{f"simulated_p_{view}": column for view, column in zip(VIEWS, share.T, strict=True)},
            "simulated_entropy_bits": bits,
            "simulated_entropy_hidden_kept_bits": self._scores(
                self.local(outcome.distance_m, outcome.hit), outcome.hit
            )[1],
            "residual_median_m": self._medians(off, both),
            "residual_abs_median_m": self._medians(np.abs(off), both),
        }

    def local(self, distance_m: np.ndarray, rays: np.ndarray) -> np.ndarray:
        """Points at the distances along some rays, in the frames of their cars [m]."""
        return points_along(self.sweep, self.rays, distance_m, rays)

    def residuals(self, outcome: Outcome) -> np.ndarray:
        """Real less simulated range of the rays that hit in both [m]."""
        return self.rays.rays.range_m[outcome.both] - outcome.distance_m[outcome.both]

    def _scores(self, local: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        share = occupancy(local, self.rays.box[rays], self.sweep.boxes.size_m)[self.rows]
        return share, entropy(share).sum(axis=1)

    def _count(self, rays: np.ndarray) -> np.ndarray:
        return np.bincount(self.rays.box[rays], minlength=len(self.sweep.boxes))[self.rows]

    def _medians(self, values: np.ndarray, rays: np.ndarray) -> np.ndarray:
        box = self.rays.box[rays]
        return np.array([np.median(values[box == row]) if (box == row).any() else np.nan for row in self.rows])
