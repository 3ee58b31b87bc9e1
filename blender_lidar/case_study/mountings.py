"""Mountings of the case study: a height and a tilt at the scene's place, and the baseline as the scene has it."""

from __future__ import annotations

from ..study.site import Site

Mounting = tuple[float, float]  # height [m], tilt across the road [deg]
Coordinates = dict[str, float]  # all six, as `scenario.pose_at` takes them


def coordinates(site: Site, mounting: Mounting) -> Coordinates:
    """A mounting where [deployment] has it searched; `open_case` sees to it that height and tilt alone are open."""
    return site.scenario.deployment.coordinates(mounting)


def baseline_coordinates(site: Site) -> Coordinates:
    """The baseline, at its own place."""
    return dict(site.scenario.baseline)


def baseline_of(site: Site) -> Mounting:
    """Height [m] and tilt [deg] of the scene's baseline."""
    return site.scenario.baseline["height_m"], site.scenario.baseline["tilt_x_deg"]
