"""What a run assumes beside its scene file, and what the site is called: told once, where the answer is read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..metrics.catalogue import PE_VGOP
from ..scene.scenario import Scenario
from ..scene.site import Site
from ..traffic.vehicles import FLEET_KINDS, Recording, counted, fleet_kind
from .folder import RESULT

_PEAK = 1.0 / math.e  # of -P log2 P
_TOLD = 0.01  # of the boxes
_USUAL_NAME = "scene"  # of the files that init writes: the folder says more


def site_name(scenario: Scenario) -> str:
    """What the site is called: as its scene file, or as the folder of one that is called scene.toml.

    The scene.toml of a run's folder has the name that the run had.
    """
    path = Path(scenario.source).resolve()
    if path.stem != _USUAL_NAME or not path.parent.name:
        return path.stem
    with suppress(OSError, ValueError, KeyError):
        return json.loads((path.parent / RESULT).read_text(encoding="utf-8"))["site"]
    return path.parent.name


def assumptions(site: Site, table: Mapping[str, np.ndarray]) -> list[str]:
    """What was assumed of traffic, sensor and mast, and how many boxes the metric sees beyond its peak, as sentences.

    `table` is the vehicle table of the run's mounting.
    """
    grade, found = site.scenario.road.grade_percent, [*_heights(site.recording), *site.recording.report.assumed]
    found += installation_assumed(site.scenario)
    for model in {one.name: one for one in site.models}.values():
        sensor = model.assumptions
        file = f"The file of {model.name}" if site.scenario.is_layout else "The sensor's file"
        found += [f"{file} leaves open, and is taken to mean: {'; '.join(sensor.values())}"] if sensor else []
        found += [f"Of {file[0].lower()}{file[1:]}: {'; '.join(model.notes)}"] if model.notes else []
    if grade:
        way = "rises" if grade > 0.0 else "falls"
        found.append(
            f"The road is one plane that {way} by {abs(grade):g} % along x, its surface without a bend or crest"
        )
    gantries = {lidar.deployment.clearance_m for lidar in site.scenario.lidars if lidar.deployment.is_gantry}
    found += [f"Over the lanes {clearance_m:g} m are kept clear under the LiDAR" for clearance_m in sorted(gantries)]
    if site.scenario.is_layout:
        found.append(
            "The LiDARs turn and measure at one moment, calibrated without error and undisturbed by one another: fused "
            "scores are an upper bound (a tenth of a second is 1.4 m at 14 m/s)"
        )
    beyond = np.max([table[view] for view in ("p_top", "p_side", "p_front")], axis=0) > _PEAK
    if beyond.mean() >= _TOLD and site.scoring.metric == PE_VGOP.name:
        boxes = f"{counted(int(beyond.sum()), 'box')} of {len(beyond):,} ({100 * beyond.mean():.0f} %)"
        found.append(f"In {boxes} the occupancy of a view is above 1/e: beyond that, more points lower the PE-VGOP")
    return found


def installation_assumed(scenario: Scenario) -> list[str]:
    """Within what half-widths each LiDAR hangs of its plan, and where these come from.

    A digital level is exact to 0.1 degrees (Craftsman 320.48295, manual), the better inclinometers of phones to about a
    degree (Buck, Martindale and Braden, cited by goniometer.io); in between lies what a bracket can be set to. No
    standard for roadside LiDARs is known to us.
    """
    shaken = {lidar.name: lidar.deployment.installer for lidar in scenario.lidars}
    shaken = {name: one.text for name, one in shaken.items() if not one.is_exact}
    if not shaken:
        return []
    named = [f"LiDAR {name} hangs within {text}" for name, text in shaken.items()]
    if len(shaken) == len(scenario.lidars) and len(set(shaken.values())) == 1:
        who = "Each" if len(shaken) > 1 else "The"
        named = [f"{who} LiDAR hangs within {next(iter(shaken.values()))}"]
    return [
        f"{', '.join(named)} of its plan, errors uniform and independent: tilts between a digital "
        "level (0.1°) and a phone's inclinometer (1°), heights by tape, yaw by eye; `installer` in the scene changes it"
    ]


def _heights(recording: Recording) -> list[str]:
    """Which heights the vehicles of NGSIM, which has none, were given, and how many have them."""
    if recording.report.format != "ngsim":
        return []
    first = np.unique(recording.vehicle_id, return_index=True)[1]
    kind, height_m = fleet_kind(recording.class_index, recording.size_m[:, 0])[first], recording.size_m[first, 2]
    counts = []
    for one in np.unique(kind):
        ends = (f"{end:.3g}" for end in (height_m[kind == one].min(), height_m[kind == one].max()))
        vehicles = counted(int((kind == one).sum()), "vehicle")
        counts.append(f"{FLEET_KINDS[one].replace('_', ' ')} {' to '.join(dict.fromkeys(ends))} m ({vehicles})")
    return [f"Heights, which NGSIM does not have: {', '.join(counts)}"]
