"""What the LiDARs of a layout are worth: together, each alone, without each, one added after the other, and at a price.

All are judged on the same frames, held out where there are any, and all differences are paired.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..scene.mounting import Layout
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from .comparison import Comparison
from .vehicle_table import vehicle_tables


def judge_layout(
    site: Site, evaluator: Evaluator, layout: Layout, steps: Sequence[Layout], *, searched: bool
) -> dict[str, object]:
    """What each LiDAR of a layout adds, on the frames that judge it, as JSON holds it.

    Parameters
    ----------
    layout : Layout
        All its LiDARs hang.
    steps : sequence of Layout
        The layout with each number of its LiDARs, as a search has put them up; without a search the best single one of
        the layout stands for them.
    searched : bool
        Whether a search chose the layout on the searched frames, which then say no interval.

    Returns
    -------
    dict
        ``parts``, of each LiDAR ``alone`` and ``without``: objective per vehicle and detectable share, by how much the
        whole layout is better, and 90 % intervals of that. ``covered_by``: the share of boxes that at least so many
        LiDARs detect each by itself, with interval. ``steps``: of each number of LiDARs the ``added`` names, the
        ``price`` so far, scores, and the ``gain`` of the step. ``over_single``: the same of the whole layout over the
        first step. ``price``: of sensors and poles, None where one has none.
    """
    split, judging = evaluator.judging
    seed = site.scenario.search.seed if split == "holdout" or not searched else None
    names = [lidar.name for lidar in site.scenario.lidars]
    alone = [tuple(one if k == number else None for k, one in enumerate(layout)) for number in range(len(layout))]
    without = [tuple(None if k == number else one for k, one in enumerate(layout)) for number in range(len(layout))]
    found = _Judged(site, judging, split, seed, dict.fromkeys((layout, *alone, *without, *steps)))
    if not steps:
        chosen = evaluator.totals(alone).objective.sum(axis=1)  # on frames that do not judge
        steps = [alone[int(np.argmax(chosen))], layout]
    parts = [
        {"name": name, "alone": found.beside(layout, only), "without": found.beside(layout, rest)}
        for name, only, rest in zip(names, alone, without, strict=True)
    ]
    rows, before = [], (None,) * len(layout)
    for step in steps:
        added = [name for name, one, there in zip(names, step, before, strict=True) if one and not there]
        row = {"added": added, "lidars": sum(one is not None for one in step), "price": price_of(site, step)}
        rows.append({**row, **found.scores(step), "gain": found.gain(step, before) if any(before) else None})
        before = step
    return {
        "judged_on": split,
        "parts": parts,
        "covered_by": found.covered_by(alone),
        "steps": rows,
        "over_single": None if steps[0] == layout else {"lidars": rows[0]["lidars"], **found.gain(layout, steps[0])},
        "price": price_of(site, layout),
    }


class _Judged:
    """Layouts scored on the frames that judge them."""

    def __init__(
        self, site: Site, judging: Evaluator, split: str, seed: int | None, layouts: Mapping[Layout, None]
    ) -> None:
        self._site, self._split, self._seed = site, split, seed
        self._tables = dict(zip(layouts, vehicle_tables(list(layouts), **{split: judging}), strict=True))

    def compared(self, before: Layout, after: Layout) -> Comparison:
        """Two layouts, box by box."""
        return Comparison.of_split(self._tables[before], self._tables[after], self._split, self._site, self._seed)

    def scores(self, layout: Layout) -> dict[str, object]:
        """Objective per vehicle and detectable share with its interval."""
        scores = self.compared(layout, layout).scores()
        return {
            key: scores[key] for key in ("objective_per_vehicle", "detectable_share", "detectable_share_interval_90")
        }

    def gain(self, layout: Layout, before: Layout) -> dict[str, object]:
        """By how much a layout is better than another, with intervals."""
        scores = self.compared(before, layout).scores()
        return {
            "objective_gain": scores["gain_over_baseline"],
            "interval_90": scores["interval_90"],
            "share_gain": scores["detectable_share_gain"],
            "share_gain_interval_90": scores["detectable_share_gain_interval_90"],
        }

    def beside(self, layout: Layout, part: Layout) -> dict[str, object] | None:
        """Scores of a part of a layout, and by how much the whole is better; None of no LiDAR."""
        if not any(part):
            return None
        return {**self.scores(part), **self.gain(layout, part)}

    def covered_by(self, alone: Sequence[Layout]) -> list[dict[str, object]]:
        """The share of boxes that at least one, two ... all LiDARs detect, each by itself."""
        times = np.sum([self._tables[one]["detectable"] for one in alone], axis=0)
        boxes, rows = self.compared(alone[0], alone[0]), []
        for least in range(1, len(alone) + 1):
            share = {"share": float((times >= least).mean()), "interval_90": boxes.share_interval_90(times >= least)}
            rows.append({"lidars": least, **share})
        return rows


def price_of(site: Site, layout: Layout) -> float | None:
    """Prices of the sensors of a layout and of the poles that they hang on; None where a sensor has none."""
    total = 0.0
    for lidar, mounting in zip(site.scenario.lidars, layout, strict=True):
        if mounting is None:
            continue
        if lidar.sensor.price is None:
            return None
        pole = lidar.deployment.pole_at(mounting.xy)
        total += lidar.sensor.price + (pole.cost or 0.0 if pole else 0.0)
    return total
