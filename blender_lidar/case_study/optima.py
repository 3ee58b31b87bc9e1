"""Where one sensor wants to hang: the exhaustive grid, DE-PSO beside it, and how other traffic would have it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from ..optimise import run
from ..plots.binning import near_best_threshold
from ..run import fresh_search
from ..scenario import Deployment, pose_at
from ..study.score_map import AXES, ScoreMap, map_scores
from ..study.site import Site
from ..study.statistics import FEWEST_BLOCKS, block_sums, resampled_weights
from ..study.verdict import judge
from .mountings import Mounting, coordinates
from .published import PUBLISHED

NEAR_BEST = (0.01, 0.05)  # shares of the gain
WIDE = {"height_m": (2.0, 8.0), "tilt_x_deg": (0.0, 40.0)}  # the second search, beyond the paper's bounds


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """The objective over height and tilt, and that of the baseline.

    Attributes
    ----------
    map : ScoreMap
    filled : ndarray of bool, (b,)
        Which blocks of the plan have vehicles, and so a column in the map.
    baseline : dict
        ``per_vehicle`` [bits] and ``detectable_share`` of the baseline.
    """

    map: ScoreMap
    filled: np.ndarray
    baseline: dict[str, float]

    @property
    def gain(self) -> float:
        """Of the best grid point over the baseline, per vehicle [bits]; 0 or more where the baseline is a point."""
        return self.map.best[2] - self.baseline["per_vehicle"]

    def as_dict(self) -> dict:
        """As JSON holds it."""
        columns = {item.name: getattr(self.map, item.name).tolist() for item in fields(ScoreMap)}
        return {"map": columns, "filled": self.filled.tolist(), "baseline": self.baseline}

    @classmethod
    def from_dict(cls, stored: Mapping) -> Landscape:
        """The landscape that `as_dict` came from."""
        columns = {name: np.array(values) for name, values in stored["map"].items()}
        return cls(ScoreMap(**columns), np.array(stored["filled"], dtype=bool), dict(stored["baseline"]))


def landscape(
    site: Site,
    grid: tuple[int, int],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[int], None] = lambda points: None,
) -> Landscape:
    """Score a grid of heights and tilts on the searched frames; `bounds` replace those of the scene."""
    scenario = site.scenario
    deployment = scenario.deployment if bounds is None else Deployment(scenario.deployment.fixed, bounds)
    others = deployment.coordinates(deployment.lower)
    with site.evaluator(site.search) as evaluator:
        found = map_scores(evaluator, deployment, others, site.plan.search_block, progress, grid)
        before = evaluator.totals([scenario.baseline_pose])
        filled = block_sums(evaluator.vehicles, site.plan.search_block) > 0
    baseline = {
        "per_vehicle": float(before.per_vehicle()[0]),
        "detectable_share": float(before.detectable_share()[0]),
    }
    found = replace(found, height_m=found.height_m.round(9), tilt_deg=found.tilt_deg.round(9))  # 4.3, not 4.30...01
    return Landscape(found, filled, baseline)


def searched_optimum(site: Site, progress: Callable[[int], None] = lambda evaluations: None) -> dict:
    """What the scene's search, DE-PSO at the paper's settings, finds: mounting, value per vehicle, evaluations."""
    deployment = site.scenario.deployment
    with site.evaluator(site.search) as evaluator:

        def objective(candidates: np.ndarray) -> np.ndarray:
            values = evaluator.totals([deployment.pose(x) for x in candidates]).per_vehicle()
            progress(len(candidates))
            return values

        found = run(fresh_search(site.scenario), objective)
    return {
        "height_m": float(found.x[deployment.variables.index(AXES[0])]),
        "tilt_x_deg": float(found.x[deployment.variables.index(AXES[1])]),
        "per_vehicle": found.value,
        "evaluations": found.evaluations,
        "seed": site.scenario.search.seed,
    }


def judged(site: Site, mountings: Mapping[str, Mounting], seed: int) -> dict:
    """Scores of (height, tilt) mountings, of the baseline and of the paper's, on searched and held-out frames."""
    scenario = site.scenario
    published = PUBLISHED[site.model.name]
    chosen = {**mountings, "paper": (published.height_m, published.tilt_deg)}
    poses = {name: pose_at(coordinates(site, at)) for name, at in chosen.items()}
    with site.evaluator(site.search) as evaluator:
        return judge(site, {"baseline": scenario.baseline_pose, **poses}, evaluator, seed)


def near_best(found: Landscape, share: float) -> dict:
    """The mountings that lose at most `share` of the gain: range of heights and of tilts, and share of the grid."""
    threshold = near_best_threshold(found.map.best[2], found.baseline["per_vehicle"], share)
    inside = found.map.per_vehicle >= threshold
    height, tilt = found.map.height_m[inside.any(axis=1)], found.map.tilt_deg[inside.any(axis=0)]
    return {
        "of_the_gain": share,
        "points": int(inside.sum()),
        "share_of_grid": float(inside.mean()),
        "height_m": [float(height[0]), float(height[-1])],
        "tilt_deg": [float(tilt[0]), float(tilt[-1])],
    }


def joint_optima(found: Sequence[Landscape], seed: int) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """Best height [m] and tilt [deg] of each landscape in each resample of blocks, the same resamples for all.

    Returns
    -------
    list of (ndarray, ndarray), (r,) each
        One pair for each landscape. Resamples that leave one of them without a vehicle are dropped for all. None for
        fewer blocks than an interval needs.
    """
    blocks = len(found[0].filled)
    if min(int(one.filled.sum()) for one in found) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(blocks, np.random.default_rng(seed))
    drawn = [weights[:, one.filled] for one in found]
    counts = [some @ one.map.block_vehicles for some, one in zip(drawn, found, strict=True)]
    kept = np.all([count > 0 for count in counts], axis=0)
    return [one.map.best_under(some[kept]) for one, some in zip(found, drawn, strict=True)]


def order_shares(values: Mapping[str, np.ndarray]) -> dict:
    """How often the values fall in the order of the mapping, (r,) each: strictly, with ties, and pair by pair."""
    names = list(values)
    pairs = [(first, second) for at, first in enumerate(names) for second in names[at + 1 :]]
    neighbours = list(pairwise(names))
    return {
        "order": names,
        "resamples": len(values[names[0]]),
        "strict": float(np.all([values[a] > values[b] for a, b in neighbours], axis=0).mean()),
        "with_ties": float(np.all([values[a] >= values[b] for a, b in neighbours], axis=0).mean()),
        "pairs": [
            {
                "first": a,
                "second": b,
                "above": float((values[a] > values[b]).mean()),
                "equal": float((values[a] == values[b]).mean()),
            }
            for a, b in pairs
        ],
    }
