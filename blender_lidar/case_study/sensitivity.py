"""How far each optimum moves with what the paper leaves unstated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..optimise.objective import vehicle_score
from .optima import Landscape, landscape
from .published import SENSORS
from .sites import CaseStudy
from .variants import LOSSES, REGION_SHARE, Variant, variants

COLUMNS = (
    "what",
    "value",
    "sensor",
    "height_m",
    "tilt_deg",
    "gain_bits",
    "baseline_bits",
    "best_bits",
    "detectable_baseline",
    "detectable_best",
    "height_low_m",
    "height_high_m",
    "tilt_low_deg",
    "tilt_high_deg",
    "vehicles",
    "note",
)


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
        return [_row(variant.what, variant.value, sensor) | {"note": str(error)}]
    found = landscape(site, case.effort.sensitivity_grid)
    rows = [_found_row(variant.what, variant.value, sensor, found, seed)]
    if not variant.value:
        settings = site.scenario.objective
        scored = _missed_value(settings.loss, settings.reading)
        given = [("abs(C)", f"{loss:g}", -loss) for loss in LOSSES if -loss != scored]
        given.append(("C as printed:", "a miss earns 1", 1.0))
        rows += [
            _found_row(what, value, sensor, _with_missed(found, missed - scored), None)
            for what, value, missed in given
            if missed != scored
        ]
    return rows


def sensitivity_variants(case: CaseStudy) -> list[tuple[str, Variant]]:
    """Every sensor's variants, variant by variant."""
    each = [(sensor, variant) for sensor in SENSORS for variant in variants(case.scenario(sensor))]
    names = list(dict.fromkeys((variant.what, variant.value) for _, variant in each))
    groups = list(dict.fromkeys(what for what, _ in names))
    return sorted(each, key=lambda item: (groups.index(item[1].what), SENSORS.index(item[0])))


def orders(rows: Sequence[dict]) -> list[dict]:
    """For each setting that all sensors were scored under: the optima, and whether tilts fall as in the paper."""
    found = []
    for what, value in dict.fromkeys(map(setting_of, rows)):
        of = {row["sensor"]: row for row in rows if setting_of(row) == (what, value) and not row["note"]}
        if set(of) == set(SENSORS):
            tilts, heights = ([of[sensor][key] for sensor in SENSORS] for key in ("tilt_deg", "height_m"))
            found.append(
                {
                    "what": what,
                    "value": value,
                    "tilts_deg": tilts,
                    "tilts_fall": bool(np.all(np.diff(tilts) < 0)),
                    "heights_m": heights,
                }
            )
    return found


def setting_of(row: Mapping) -> tuple[str, str]:
    """What a row varies, and to what; a region's radius differs by sensor, and is one setting all the same."""
    return row["what"], f"{REGION_SHARE:g} of the gate" if row["what"] == "region" else row["value"]


def _missed_value(loss: float, reading: str) -> float:
    """What a vehicle below the threshold adds to the objective [bits]."""
    return float(vehicle_score(np.zeros(1), np.zeros(1, dtype=bool), loss, reading)[0])


def _with_missed(found: Landscape, change: float) -> Landscape:
    """The landscape if a vehicle below the threshold added `change` more: the others' entropies stay (Eq. 10)."""
    score_map = found.map
    shares = found.baseline["detectable_share"]
    baseline = found.baseline | {"per_vehicle": found.baseline["per_vehicle"] + change * (1.0 - shares)}
    values = score_map.per_vehicle + change * (1.0 - score_map.detectable_share)
    return replace(found, map=replace(score_map, per_vehicle=values), baseline=baseline)


def _found_row(what: str, value: str, sensor: str, found: Landscape, seed: int | None) -> dict:
    height, tilt, best = found.map.best
    at = np.unravel_index(np.argmax(found.map.per_vehicle), found.map.per_vehicle.shape)
    intervals = None if seed is None else found.map.optimum_intervals_90(seed)
    low_high = dict.fromkeys(COLUMNS[10:14])
    if intervals is not None:
        low_high = dict(zip(COLUMNS[10:14], (*intervals["height_m"], *intervals["tilt_x_deg"]), strict=True))
    return _row(what, value, sensor) | {
        "height_m": height,
        "tilt_deg": tilt,
        "gain_bits": found.gain,
        "baseline_bits": found.baseline["per_vehicle"],
        "best_bits": best,
        "detectable_baseline": found.baseline["detectable_share"],
        "detectable_best": float(found.map.detectable_share[at]),
        **low_high,
        "vehicles": int(found.map.block_vehicles.sum()),
    }


def _row(what: str, value: str, sensor: str) -> dict:
    return dict.fromkeys(COLUMNS) | {"what": what, "value": value, "sensor": sensor, "note": ""}
