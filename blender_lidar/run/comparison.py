"""Paired comparison: mounting B against mounting A on the same boxes, with intervals over resampled blocks of time.

Frames close in time show the same vehicles, so intervals resample blocks (`statistics`). A box is a counted vehicle in
one frame. What has chosen a mounting gives it no interval.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..metrics.catalogue import metric_named
from ..optimise import vehicle_score
from ..scene.observation import Scoring
from ..scene.site import Site
from ..statistics import (
    FEW_VEHICLES,
    block_sums,
    drawn_blocks,
    many_to_one_reach_90,
    of_blocks,
    share_gain_interval_90,
    share_interval_90,
    statistic_interval_90,
)
from .vehicle_table import groups_of, metric_values, vehicle_weight

OBJECTIVE, DETECTABLE = "objective", "detectable"


class Comparison:
    """Detectable share and objective of boxes before (the baseline, or plan) and after, and their differences.

    Parameters
    ----------
    before, after : mapping of str to ndarray, (n,)
        Vehicle tables of both mountings, row by row of the same boxes.
    block, recording : ndarray of int, (n,)
        Block of time and recording of each row.
    scoring : Scoring
        What a box adds to the objective.
    seed : int or None
        For the resampling of blocks; None where these boxes have chosen the mounting, and no interval is given.
    """

    def __init__(
        self,
        before: Mapping[str, np.ndarray],
        after: Mapping[str, np.ndarray],
        block: np.ndarray,
        recording: np.ndarray,
        scoring: Scoring,
        seed: int | None,
    ) -> None:
        self.before = _with_objective(before, scoring)
        self.after = self.before if after is before else _with_objective(after, scoring)
        self.weight = vehicle_weight(before)
        self.block, self.recording, self.scoring, self._seed = block, recording, scoring, seed

    @classmethod
    def of_split(cls, before: Mapping, after: Mapping, split: str, site: Site, seed: int | None) -> Comparison:
        """That of the frames of a split of a site, ``"search"`` or ``"holdout"``."""
        both = _of_rows(before, after, before["split"] == split)
        frame, block, recording = (getattr(site.plan, f"{split}{what}") for what in ("", "_block", "_recording"))
        row = np.searchsorted(frame, both[0]["frame"])
        return cls(*both, block[row], recording[row], site.scoring, seed)

    def of(self, rows: np.ndarray) -> Comparison:
        """The same of some rows, (n,) bool."""
        both = _of_rows(self.before, self.after, rows)
        return Comparison(*both, self.block[rows], self.recording[rows], self.scoring, self._seed)

    def with_scores(self, before: Mapping[str, np.ndarray], after: Mapping[str, np.ndarray]) -> Comparison:
        """The same boxes with other ``objective``, weighted, and ``detectable``, (n,), as means over installations."""
        tables = {**self.before, **before}, {**self.after, **after}
        return Comparison(*tables, self.block, self.recording, self.scoring, self._seed)

    @property
    def blocks(self) -> int:
        """Blocks of time that have boxes which count."""
        return int((block_sums(self.weight, self.block) > 0.0).sum())

    @property
    def sizes(self) -> dict[str, int]:
        """How many boxes judge, and how many different vehicles these are."""
        return {"boxes": len(self.block), "distinct_vehicles": len(np.unique(self.before["vehicle_id"]))}

    # --- The detectable share -----------------------------------------------------------------------------------------

    def shares(self) -> dict[str, object]:
        """Detectable shares before and after and their difference, with 90 % intervals, as JSON holds them."""
        before, after = self.before[DETECTABLE], self.after[DETECTABLE]
        ends = [None] * 3
        if self._seed is not None:
            how = self.before["vehicle_id"], self.block, self._seed, self.recording
            ends = [share_interval_90(before, *how), share_interval_90(after, *how)]
            ends.append(share_gain_interval_90(before, after, *how))
        before_90, after_90, gain_90 = (pair and list(pair) for pair in ends)
        return {
            **self.sizes,
            "before": float(before.mean()),
            "before_interval_90": before_90,
            "after": float(after.mean()),
            "after_interval_90": after_90,
            "gain": float(after.mean() - before.mean()),
            "gain_interval_90": gain_90,
        }

    def share_interval_90(self, flags: np.ndarray) -> list[float] | None:
        """90 % interval of the share of boxes with a flag, (n,) bool."""
        if self._seed is None:
            return None
        ends = share_interval_90(flags, self.before["vehicle_id"], self.block, self._seed, self.recording)
        return ends and list(ends)

    def low_share(self, detectable: np.ndarray, share: float) -> float | None:
        """Quantile of the detectable share over a resampled set of blocks and one of equally likely installations.

        `detectable` (m, n) is that of m installations, `share` which quantile; None where there is no interval.
        """
        drawn = drawn_blocks(self._boxes_of_block, self._seed, self._recording_of_block) if self._may_tell else None
        if drawn is None:
            return None
        weights, hits = drawn[1], block_sums(detectable, self.block)
        shares = np.einsum("rb,mb->rm", weights, hits) / (weights @ self._boxes_of_block)[:, None]
        return float(np.quantile(shares, share))

    # --- The objective ------------------------------------------------------------------------------------------------

    def objective(self) -> dict[str, object]:
        """Objective per vehicle, in the metric's unit, before and after, its difference and that one's interval."""
        sums = [block_sums(table[OBJECTIVE], self.block) for table in (self.before, self.after)]
        weight = block_sums(self.weight, self.block)
        before, after = self.means()
        if before is None:  # a group that does not count
            return {"before": None, "after": None, "gain": None, "gain_interval_90": None}
        ends = None
        if self._seed is not None:
            gained = sums[1] - sums[0]
            ends = statistic_interval_90(
                lambda drawn: (drawn @ gained) / (drawn @ weight), weight, self._seed, self._recording_of_block
            )
        return {"before": before, "after": after, "gain": after - before, "gain_interval_90": ends and list(ends)}

    def means(self) -> tuple[float | None, float | None]:
        """Objective per vehicle before and after; None where nothing counts."""
        weight = self.weight.sum()
        return tuple(float(table[OBJECTIVE].sum() / weight) if weight else None for table in (self.before, self.after))

    # --- Both ---------------------------------------------------------------------------------------------------------

    def scores(self) -> dict[str, object]:
        """The mounting after beside the one before, by the names of result.json.

        Returns
        -------
        dict
            ``objective_per_vehicle`` in the metric's unit, ``detectable_share``, `sizes`, and of each what it gains
            over the mounting before, ``gain_over_baseline`` and ``detectable_share_gain``, with 90 % intervals:
            ``interval_90`` is that of the objective's gain. Intervals are None with few vehicles or blocks.
        """
        shares, objective = self.shares(), self.objective()
        gained = shares["gain_interval_90"]
        if self.before is self.after and shares["after_interval_90"]:  # it gains nothing over itself
            gained = [0.0, 0.0]
        return {
            "objective_per_vehicle": objective["after"],
            "detectable_share": shares["after"],
            "gain_over_baseline": objective["gain"],
            "interval_90": objective["gain_interval_90"],
            **self.sizes,
            "detectable_share_gain": shares["gain"],
            "detectable_share_gain_interval_90": gained,
            "detectable_share_interval_90": shares["after_interval_90"],
        }

    def groups(self, site: Site) -> list[dict[str, object]]:
        """`shares` of each group: ``by``, ``name``, and the objective per vehicle, by distance, lane, class ..."""
        rows = []
        for by, name, chosen in groups_of(self.before, self.after, site):
            group = self.of(chosen)
            means = dict(zip(("objective_before", "objective_after"), group.means(), strict=True))
            rows.append({"by": by, "name": name, **group.shares(), **means})
        return rows

    def reach_90(self, key: str, scores: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray | None:
        """Half the simultaneous 90 % intervals of means of k mountings less that of the first, (k,).

        `scores` are those of the boxes under each mounting, as for `with_scores`; `key` is ``"detectable"`` or
        ``"objective"``. See `many_to_one_reach_90`; None where there is no interval.
        """
        if self._seed is None or (key == DETECTABLE and not self._may_tell):
            return None
        weight = self._boxes_of_block if key == DETECTABLE else block_sums(self.weight, self.block)
        sums = block_sums(np.array([one[key] for one in scores]), self.block)
        return many_to_one_reach_90(sums, weight, self._seed, self._recording_of_block)

    @property
    def _may_tell(self) -> bool:
        """Whether a share may have an interval."""
        return self._seed is not None and self.sizes["distinct_vehicles"] >= FEW_VEHICLES

    @property
    def _boxes_of_block(self) -> np.ndarray:
        return block_sums(np.ones(len(self.block)), self.block)

    @property
    def _recording_of_block(self) -> np.ndarray:
        return of_blocks(self.recording, self.block)


def _of_rows(before: Mapping, after: Mapping, rows: np.ndarray) -> tuple[Mapping, Mapping]:
    """Rows of two tables, one table where both are."""
    chosen = {key: values[rows] for key, values in before.items()}
    return chosen, chosen if after is before else {key: values[rows] for key, values in after.items()}


def _with_objective(table: Mapping[str, np.ndarray], scoring: Scoring) -> Mapping[str, np.ndarray]:
    """A vehicle table with what each box adds to the objective (Eq. 10), weighted, (n,)."""
    if OBJECTIVE in table:
        return table
    metric = metric_named(scoring.metric)
    score = vehicle_score(metric.merit(metric_values(table)), table[DETECTABLE], scoring.loss, scoring.reading)
    return {**table, OBJECTIVE: score * vehicle_weight(table)}
