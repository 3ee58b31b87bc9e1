"""Where each sensor wants to hang: an exhaustive grid, DE-PSO beside it, other traffic (bootstrap), other settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from blender_lidar.errors import InputError
from blender_lidar.optimise import run
from blender_lidar.optimise.objective import vehicle_score
from blender_lidar.run.searches import fresh_search
from blender_lidar.run.vehicle_table import vehicle_tables
from blender_lidar.run.verdict import AXES, ScoreMap, judge, map_scores, near_best_threshold
from blender_lidar.scene.deployment import SearchSpace
from blender_lidar.scene.site import Site
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.statistics import FEWEST_BLOCKS, block_sums, resampled_weights
from case_study import (
    PUBLISHED,
    REGION_SHARE,
    SENSORS,
    CaseStudy,
    HeightAndTilt,
    Variant,
    layout_at,
    variants,
)

WIDE = {"height_m": (2.0, 8.0), "tilt_x_deg": (0.0, 40.0)}  # the second search, beyond the paper's bounds
LOSSES = (0.0, 0.5, 2.0, 4.0)  # other values of abs(C)


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """The objective over height and tilt, which blocks have vehicles, and ``per_vehicle`` [bits] and
    ``detectable_share`` of the baseline."""

    map: ScoreMap
    filled: np.ndarray
    baseline: dict[str, float]

    @property
    def gain(self) -> float:
        """Of the best grid point over the baseline, per vehicle [bits]."""
        return self.map.best[2] - self.baseline["per_vehicle"]

    def as_dict(self) -> dict:
        """As JSON holds it."""
        columns = {name: np.asarray(values).tolist() for name, values in asdict(self.map).items()}
        return {"map": columns, "filled": self.filled.tolist(), "baseline": self.baseline}

    @classmethod
    def from_dict(cls, stored: Mapping) -> Landscape:
        """The landscape that `as_dict` came from."""
        columns = {key: one if isinstance(one, str) else np.array(one) for key, one in stored["map"].items()}
        return cls(ScoreMap(**columns), np.array(stored["filled"], dtype=bool), dict(stored["baseline"]))


def landscape(
    site: Site,
    grid: tuple[int, int],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    progress: Callable[[int], None] = lambda points: None,
) -> Landscape:
    """Score a grid of heights and tilts on the searched frames; `bounds` replace those of the scene."""
    scenario = site.scenario
    (place,) = scenario.lidar.deployment.places
    space = SearchSpace((place if bounds is None else replace(place, bounds=bounds),))
    with site_evaluator(site, site.search) as evaluator:
        found = map_scores(evaluator, space, space.lower, site.plan.search_block, progress, grid)
        before = evaluator.totals([(scenario.lidar.baseline,)])
        filled = block_sums(evaluator.vehicles, site.plan.search_block) > 0
    baseline = {
        "per_vehicle": float(before.per_vehicle()[0]),
        "detectable_share": float(before.detectable_share()[0]),
    }
    found = replace(found, height_m=found.height_m.round(9), tilt_deg=found.tilt_deg.round(9))  # 4.3, not 4.30...01
    return Landscape(found, filled, baseline)


def searched_optimum(site: Site, progress: Callable[[int], None] = lambda evaluations: None) -> dict:
    """What DE-PSO at the scene's settings, the paper's, finds: mounting, value per vehicle, evaluations."""
    (space,) = site.scenario.lidar.deployment.spaces
    with site_evaluator(site, site.search) as evaluator:

        def objective(candidates: np.ndarray) -> np.ndarray:
            values = evaluator.totals([space.layout(x) for x in candidates]).per_vehicle()
            progress(len(candidates))
            return values

        found = run(fresh_search(site.scenario, space), objective)
    return {
        **{axis: float(found.x[space.variables.index(axis)]) for axis in AXES},
        "per_vehicle": found.value,
        "evaluations": found.evaluations,
        "seed": site.scenario.search.seed,
    }


def judged(site: Site, mountings: Mapping[str, HeightAndTilt], seed: int) -> dict:
    """Scores of (height, tilt) mountings, of the baseline and of the paper's, on searched and held-out frames."""
    published = PUBLISHED[site.model.name]
    chosen = {**mountings, "paper": (published.height_m, published.tilt_deg)}
    layouts = {name: layout_at(site, at) for name, at in chosen.items()}
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        layouts = {"baseline": (site.scenario.lidar.baseline,), **layouts}
        tables = vehicle_tables(list(layouts.values()), search=evaluator, holdout=evaluator.held_out)
        return judge(site, layouts, dict(zip(layouts, tables, strict=True)), evaluator, seed)[0]


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
    """Best height [m] and tilt [deg] of each landscape in each bootstrap resample of blocks, the same for all.

    Returns
    -------
    list of (ndarray, ndarray), (r,) each
        One pair for each landscape. Resamples that leave one of them without a vehicle are dropped for all. None for
        fewer blocks than an interval needs.
    """
    if min(int(one.filled.sum()) for one in found) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(len(found[0].filled), np.random.default_rng(seed))
    drawn = [weights[:, one.filled] for one in found]
    kept = np.all([some @ one.map.block_vehicles > 0 for some, one in zip(drawn, found, strict=True)], axis=0)
    return [one.map.best_under(some[kept]) for one, some in zip(found, drawn, strict=True)]


def order_shares(values: Mapping[str, np.ndarray]) -> dict:
    """How often the values fall in the order of the mapping, (r,) each: strictly, with ties, and pair by pair."""
    return {
        "order": list(values),
        "resamples": len(next(iter(values.values()))),
        "strict": float(np.all([a > b for a, b in pairwise(values.values())], axis=0).mean()),
        "with_ties": float(np.all([a >= b for a, b in pairwise(values.values())], axis=0).mean()),
        "pairs": [
            {"first": a, "second": b, "above": float((x > y).mean()), "equal": float((x == y).mean())}
            for (a, x), (b, y) in combinations(values.items(), 2)
        ],
    }


# --- other settings ---------------------------------------------------------------------------------------------------


def sensitivity_variants(case: CaseStudy) -> list[tuple[str, Variant]]:
    """Every sensor's variants, setting by setting."""
    each = [(sensor, variant) for sensor in SENSORS for variant in variants(case.scenario(sensor))]
    settings = list(dict.fromkeys(variant.what for _, variant in each))
    return sorted(each, key=lambda item: (settings.index(item[1].what), SENSORS.index(item[0])))


def variant_rows(case: CaseStudy, sensor: str, variant: Variant, seed: int) -> list[dict]:
    """The optimum of one sensor under one variant; under the first of them, for other losses C too.

    A variant that the traffic does not allow comes back as a row without numbers and with the reason.
    """
    frames = {("traffic", "frames"): (case.effort.sensitivity_frames, "the case study")}
    try:
        site = variant.change(case.site(sensor, {**frames, **variant.overrides}))
        if not sum(int(frame.counted.sum()) for frame in site.search):
            raise InputError("no vehicle in the region")
    except InputError as error:
        return [_row(variant.what, variant.value, sensor, note=str(error))]
    found = landscape(site, case.effort.sensitivity_grid)
    rows = [_found_row(variant.what, variant.value, sensor, found, seed)]
    if not variant.value:
        settings = site.scenario.objective
        scored = float(vehicle_score(np.zeros(1), np.zeros(1, dtype=bool), settings.loss, settings.reading)[0])
        given = [("abs(C)", f"{loss:g}", -loss) for loss in LOSSES]
        rows += [
            _found_row(what, value, sensor, with_missed(found, missed - scored), None)
            for what, value, missed in [*given, ("C as printed:", "a miss earns 1", 1.0)]
            if missed != scored
        ]
    return rows


def orders(rows: Sequence[dict]) -> list[dict]:
    """For each setting that all sensors were scored under: the optima, and whether tilts fall as in the paper."""
    found = []
    for setting in dict.fromkeys(map(setting_of, rows)):
        of = {row["sensor"]: row for row in rows if setting_of(row) == setting and not row["note"]}
        if set(of) == set(SENSORS):
            tilts, heights = ([of[sensor][key] for sensor in SENSORS] for key in ("tilt_deg", "height_m"))
            falling = {"tilts_deg": tilts, "tilts_fall": bool(np.all(np.diff(tilts) < 0)), "heights_m": heights}
            found.append({"what": setting[0], "value": setting[1], **falling})
    return found


def setting_of(row: Mapping) -> tuple[str, str]:
    """What a row varies, and to what; a region's radius differs by sensor, and is one setting all the same."""
    return row["what"], f"{REGION_SHARE:g} of the gate" if row["what"] == "region" else row["value"]


def with_missed(found: Landscape, change: float) -> Landscape:
    """The landscape if a vehicle below the threshold added `change` more: the others' entropies stay (Eq. 10)."""
    baseline = dict(found.baseline)
    baseline["per_vehicle"] += change * (1.0 - baseline["detectable_share"])
    values = found.map.per_vehicle + change * (1.0 - found.map.detectable_share)
    return replace(found, map=replace(found.map, per_vehicle=values), baseline=baseline)


def _found_row(what: str, value: str, sensor: str, found: Landscape, seed: int | None) -> dict:
    height, tilt, best = found.map.best
    intervals = None if seed is None else found.map.optimum_intervals_90(seed)
    ends = (None,) * 4 if intervals is None else (*intervals["height_m"], *intervals["tilt_x_deg"])
    at = found.map.per_vehicle.argmax()
    numbers = (height, tilt, found.gain, found.baseline["per_vehicle"], best, found.baseline["detectable_share"])
    shares = (float(found.map.detectable_share.ravel()[at]), *ends, int(found.map.block_vehicles.sum()))
    return _row(what, value, sensor, (*numbers, *shares))


_NUMBERS = (
    *("height_m", "tilt_deg", "gain_bits", "baseline_bits", "best_bits", "detectable_baseline", "detectable_best"),
    *("height_low_m", "height_high_m", "tilt_low_deg", "tilt_high_deg", "vehicles"),
)


def _row(what: str, value: str, sensor: str, numbers: Sequence = (None,) * len(_NUMBERS), note: str = "") -> dict:
    named = dict(zip(_NUMBERS, numbers, strict=True))
    return {"what": what, "value": value, "sensor": sensor, **named, "note": note}
