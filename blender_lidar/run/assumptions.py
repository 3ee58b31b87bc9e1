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
from ..traffic.vehicles import counted
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
    deployment, sensor = site.scenario.deployment, site.model.assumptions
    found = list(site.recording.report.assumed)
    found += [f"The sensor's file leaves open, and is taken to mean: {'; '.join(sensor.values())}"] if sensor else []
    if deployment.side == "gantry":
        found.append(f"Over the lanes {deployment.clearance_m:g} m are kept clear under the LiDAR")
    beyond = np.max([table[view] for view in ("p_top", "p_side", "p_front")], axis=0) > _PEAK
    if beyond.mean() >= _TOLD and site.scoring.metric == PE_VGOP.name:
        boxes = f"{counted(int(beyond.sum()), 'box')} of {len(beyond):,} ({100 * beyond.mean():.0f} %)"
        found.append(f"In {boxes} a view is fuller than 1/e: there PE-VGOP scores still more points lower")
    return found
