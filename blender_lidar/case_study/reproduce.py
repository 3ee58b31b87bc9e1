"""The whole case study, stage by stage, and its results as one dictionary."""

from __future__ import annotations

from collections.abc import Callable
from math import prod
from typing import Protocol

import numpy as np

from ..provenance import versions
from ..study.site import Site
from ..study.stages import StudyFolder
from ..study.statistics import interval_90
from .distance import by_distance, decomposition, judging_frames
from .identity import SCHEMA
from .mountings import baseline_of
from .optima import (
    NEAR_BEST,
    WIDE,
    Landscape,
    joint_optima,
    judged,
    landscape,
    near_best,
    order_shares,
    searched_optimum,
)
from .published import EVEN, PUBLISHED, SENSORS
from .sensitivity import orders, sensitivity_variants, variant_rows
from .sites import CaseStudy
from .variants import Variant, with_even_beams


class Counter(Protocol):
    """Shows how far a stage has come."""

    def advance(self, steps: int) -> None:
        """Count `steps` more."""

    def close(self) -> None:
        """The stage has ended."""


CounterMaker = Callable[[int, str], Counter]
"""Makes a counter up to a total, for what is counted."""


def reproduce(case: CaseStudy, folder: StudyFolder, counter: CounterMaker) -> dict:
    """Carry out every stage that the folder does not hold, and put the results together.

    Parameters
    ----------
    case : CaseStudy
    folder : StudyFolder
        Locked by the caller.
    counter : callable
        Told of progress.

    Returns
    -------
    dict
        As JSON holds it; the same whether a run was interrupted or not.
    """
    sites = {sensor: case.site(sensor) for sensor in SENSORS}
    seed = sites[SENSORS[0]].scenario.search.seed
    found = {
        sensor: _landscape(folder, counter, site, case.effort.grid, None, "grid") for sensor, site in sites.items()
    }
    resampled = joint_optima(list(found.values()), seed)
    wide = {
        sensor: _landscape(folder, counter, site, case.effort.wide_grid, WIDE, "wide grid")
        for sensor, site in sites.items()
    }
    searched = {sensor: _search(folder, counter, site) for sensor, site in sites.items()}
    sensors = {}
    for row, (sensor, site) in enumerate(sites.items()):
        mountings = {"grid": found[sensor].map.best[:2], "de_pso": _mounting(searched[sensor])}
        sensors[sensor] = {
            **_about(site),
            **_optimum(found[sensor], None if resampled is None else resampled[row]),
            "wide": _wide(wide[sensor], site),
            "de_pso": searched[sensor],
            "judged": _judged(folder, site, mountings, seed),
        }
    optima = {sensor: found[sensor].map.best[:2] for sensor in SENSORS}
    first = sites[SENSORS[0]]
    return {
        "schema": SCHEMA,
        "scene": case.scene,
        "traffic": first.scenario.traffic.path,
        "reading": first.scenario.objective.reading,
        "seed": seed,
        "caster": first.observation.caster,
        "frames": len(first.search),
        "block_s": case.block_s,
        "blocks": len(found[SENSORS[0]].filled),
        "judged_on": judging_frames(first)[2],
        "judged_frames": len(judging_frames(first)[0]),
        "judged_blocks": len(np.unique(judging_frames(first)[1])),
        "notes": list(dict.fromkeys(note for site in sites.values() for note in site.plan.notes)),
        "effort": {name: getattr(case.effort, name) for name in case.effort.__slots__},
        "sensors": sensors,
        "order": None if resampled is None else _orders(resampled),
        **folder.stage("fig9", lambda: _fig9(sites, optima, seed)),
        "spacing": folder.stage("spacing", lambda: _spacing(sites["RS-80"], optima["RS-80"], seed)),
        **_sensitivity(case, folder, counter, seed),
        "versions": versions(first.observation.caster),
    }


def _landscape(folder, counter, site: Site, grid, bounds, what) -> Landscape:
    name = f"{what.replace(' ', '_')}_{site.model.name.lower()}"

    def compute():
        with _counting(counter, prod(grid), f"{site.model.name}, {what}") as advance:
            return landscape(site, grid, bounds, advance).as_dict()

    return Landscape.from_dict(folder.stage(name, compute))


def _search(folder, counter, site: Site) -> dict:
    settings = site.scenario.search

    def compute():
        total = settings.particles * settings.iterations
        with _counting(counter, total, f"{site.model.name}, {settings.method}") as advance:
            return searched_optimum(site, advance)

    return folder.stage(f"search_{site.model.name.lower()}", compute)


def _judged(folder, site: Site, mountings, seed: int) -> dict:
    return folder.stage(f"judged_{site.model.name.lower()}", lambda: judged(site, mountings, seed))


class _counting:
    """A counter that is closed when the block ends."""

    def __init__(self, counter: CounterMaker, total: int, what: str) -> None:
        self._counter = counter(total, what)

    def __enter__(self) -> Callable[[int], None]:
        return self._counter.advance

    def __exit__(self, *exception) -> None:
        self._counter.close()


def _mounting(found: dict) -> tuple[float, float]:
    return found["height_m"], found["tilt_x_deg"]


def _about(site: Site) -> dict:
    published = PUBLISHED[site.model.name]
    return {
        "rings": site.model.rings,
        "range_gate_m": site.scenario.sensor.range_gate_m,
        "vehicles": sum(int(frame.counted.sum()) for frame in site.search),
        "judged_vehicles": sum(int(frame.counted.sum()) for frame in judging_frames(site)[0]),
        "baseline_mounting": list(baseline_of(site)),
        "published": {name: getattr(published, name) for name in published.__slots__},
    }


def _optimum(found: Landscape, resampled) -> dict:
    height, tilt, value = found.map.best
    return {
        "height_m": height,
        "tilt_deg": tilt,
        "height_interval_90": None if resampled is None else list(interval_90(resampled[0])),
        "tilt_interval_90": None if resampled is None else list(interval_90(resampled[1])),
        "objective_per_vehicle": value,
        "baseline_per_vehicle": found.baseline["per_vehicle"],
        "gain": found.gain,
        "height_on_bound": bool(height == found.map.height_m[-1]),
        "tilt_on_bound": bool(tilt == found.map.tilt_deg[-1]),
        "near_best": [near_best(found, share) for share in NEAR_BEST],
        "map": {name: getattr(found.map, name).tolist() for name in ("height_m", "tilt_deg", "per_vehicle")},
    }


def _wide(found: Landscape, site: Site) -> dict:
    """The optimum beyond the paper's bounds, and the best at each height, whatever its tilt."""
    height, tilt, value = found.map.best
    least, most = site.scenario.deployment.bounds["tilt_x_deg"]
    as_tilted = (found.map.tilt_deg >= least) & (found.map.tilt_deg <= most)
    inside = found.map.per_vehicle[:, as_tilted]
    return {
        "height_m": height,
        "tilt_deg": tilt,
        "objective_per_vehicle": value,
        "gain": found.gain,
        "height_on_bound": bool(height == found.map.height_m[-1]),
        "tilt_on_bound": bool(tilt == found.map.tilt_deg[-1]),
        "height_m_in_papers_tilts": float(found.map.height_m[inside.max(axis=1).argmax()]),
        "bounds": {name: list(pair) for name, pair in WIDE.items()},
        "by_height": [
            {"height_m": float(h), "tilt_deg": float(found.map.tilt_deg[row.argmax()]), "per_vehicle": float(row.max())}
            for h, row in zip(found.map.height_m, found.map.per_vehicle, strict=True)
        ],
    }


def _orders(resampled) -> dict:
    """The paper's orders: tilts fall and heights rise with the number of beams."""
    heights, tilts = zip(*resampled, strict=True)
    return {
        "tilt": order_shares(dict(zip(SENSORS, tilts, strict=True))),
        "height": order_shares(dict(zip(reversed(SENSORS), reversed(heights), strict=True))),
    }


def _fig9(sites, optima, seed: int) -> dict[str, list[dict]]:
    """Fig. 9 for the three sensors, and for RS-80's optimum with evenly spaced beams."""
    found = [by_distance(site, sensor, optima[sensor], seed) for sensor, site in sites.items()]
    found.append(by_distance(with_even_beams(sites["RS-80"]), EVEN, optima["RS-80"], seed))
    return {
        "fig9": [row for of in found for row in of["bands"]],
        "fig9_halves": [row for of in found for row in of["halves"]],
    }


def _spacing(site: Site, optimum, seed: int) -> list[dict]:
    return decomposition(site, with_even_beams(site), optimum, seed)


def _sensitivity(case: CaseStudy, folder: StudyFolder, counter: CounterMaker, seed: int) -> dict:
    each = sensitivity_variants(case)
    rows = []
    with _counting(counter, len(each), "what the paper leaves unstated") as advance:
        for sensor, variant in each:
            rows += _varied(case, folder, sensor, variant, seed)
            advance(1)
    return {"sensitivity": rows, "sensitivity_orders": orders(rows)}


def _varied(case: CaseStudy, folder: StudyFolder, sensor: str, variant: Variant, seed: int) -> list[dict]:
    words = f"sensitivity {variant.what} {variant.value} {sensor}".lower().split()
    return folder.stage("_".join(words), lambda: variant_rows(case, sensor, variant, seed))
