"""``blender-lidar init`` on a map: the scene of a junction or a stretch, its poles, and what is said of it."""

from __future__ import annotations

import csv
import io
import json
import math
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..files import write_text
from ..report.plan import Stand
from ..report.site_plan import plot_mapped_plan
from ..scene.deployment import Facing
from ..scene.region import region_of
from ..scene.scenario import load_scenario
from ..scene.settings import RegionSettings
from ..traffic.site_layout import APPROACH_M, SiteLayout
from ..traffic.vehicles import counted

POLES = "poles.csv"
_GATE_STEP_M = 5.0
_HEIGHTS_M = (2.0, 6.0)


def write_site(
    site: SiteLayout, folder: Path, scene: str, picture: str, traffic: list[str], path_of: Callable[[object], str]
) -> None:
    """Write the poles, then the scene of a site; `traffic` are the lines of [traffic], and paths are written by
    `path_of`.
    """
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerows([("name", "x_m", "y_m"), *site.poles])
    write_text(folder / POLES, table.getvalue())
    write_text(folder / scene, _text(site, picture, traffic, path_of))


def draw_site(site: SiteLayout, scene: Path, path: Path) -> None:
    """Draw the site's plan, with the region that its scene has."""
    scenario = load_scenario(scene)
    region = region_of(scenario.region, site.road)
    facing = Facing(towards_m=region.centre_xy)
    stands = [Stand(name, (x, y), math.radians(facing.at((x, y), site.road))) for name, x, y in site.poles]
    ways = site.movement if (site.movement != "").any() else None
    plot_mapped_plan(path, site.road, region.outlines, stands, site.recording, ways=ways)


def _region_of(site: SiteLayout) -> tuple[list[str], float]:
    """[region], and how far its farthest corner lies from its farthest pole [m]."""
    x, y = site.middle_xy
    if site.junction is not None:
        lines = [
            "# Where vehicles count: in the junction, and on the last metres of the approaches to it. These are",
            *(f"#   {name}" for name in site.approaches),
            '# approaches = ["...", "..."] takes some of them; polygon_m or centre_m with radius_m any other area.',
            "[region]",
            f"junction = {json.dumps(site.junction.name, ensure_ascii=False)}",
            f"approach_m = {APPROACH_M}",
        ]
        settings = RegionSettings(junction=site.junction.name, approach_m=APPROACH_M)
        region = region_of(settings, site.road)
        corners = np.concatenate(region.outlines)
    else:
        lines = [
            "# Where vehicles count: in a circle. Or in an outline, polygon_m = [[x, y], [x, y], [x, y]].",
            "[region]",
            f"centre_m = [{x}, {y}]",
            f"radius_m = {site.radius_m}",
        ]
        turn = np.linspace(0.0, math.tau, 64)
        corners = np.array([x, y]) + site.radius_m * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    farthest = max(float(np.hypot(*(corners - (pole.x_m, pole.y_m)).T).max()) for pole in site.poles)
    return lines, farthest


def _text(site: SiteLayout, picture: str, traffic: list[str], path_of: Callable[[object], str]) -> str:
    settings = site.settings
    kind = next(key for key in ("net", "opendrive", "driven") if getattr(settings, key))
    value = (
        "true  # no map: the road is where the recorded vehicles drive" if settings.driven else path_of(settings.path)
    )
    x, y = settings.origin_m
    frame = "recording" if settings.driven else "map"
    region, farthest = _region_of(site)
    gate = _GATE_STEP_M * math.ceil((farthest + 1.0) / _GATE_STEP_M)
    return "\n".join(
        [
            f"# Where should a LiDAR hang at {_place(site)}? Proposed from {counted(site.vehicles, 'vehicle')} that",
            f"# drive there. Check it by eye: {picture} shows it. Any number may be changed;",
            "# docs/reference/scene_file.md explains all.",
            *(f"# Note: {note}" for note in site.notes),
            "# Site frame: the axes of the map, metres; its origin is the middle of the site.",
            "",
            "[traffic]",
            *traffic,
            "# frames = 30    # searched, spread over the first part of the recording",
            "# holdout = 0.4  # share of the recording, at its end, that is held out as a check",
            "",
            "[road]",
            f"{kind} = {value}",
            f"origin_m = [{x}, {y}]  # of the site frame, in the {frame}'s own metres",
            "",
            *region,
            "",
            "[sensor]",
            'name = "RS-16"  # `blender-lidar sensors` lists the others',
            f"range_gate_m = {gate}  # so far it should see vehicles; the farthest is {farthest:.0f} m from a pole",
            "",
            "# Corners, islands and medians off the lanes; each mast faces the middle of the region. Strike out those",
            "# that cannot be. A number fixes a coordinate, a pair [low, high] has it searched.",
            "[deployment]",
            f'poles = "{POLES}"',
            f"height_m = [{_HEIGHTS_M[0]}, {_HEIGHTS_M[1]}]  # what your poles allow",
            "tilt_x_deg = [0.0, 25.0]  # down to where the mast faces",
            "# installer = { tilt_deg = 0.5, height_m = 0.05, yaw_deg = 2.0 }  # how nearly as planned it will hang",
            "",
            "# What gains are measured against: the pole nearest to the middle.",
            "[baseline]",
            f"height_m = {_HEIGHTS_M[0]}",
            "",
            "[search]",
            "seed = 1",
            "",
        ]
    )


def _approaches(count: int) -> str:
    return "1 approach" if count == 1 else f"{count} approaches"


def _place(site: SiteLayout) -> str:
    return "this stretch" if site.junction is None and not site.settings.driven else "this intersection"


def site_summary(site: SiteLayout, kind: str, written: list[str]) -> str:
    """What was proposed and written, and what to do next."""
    recording, settings = site.recording, site.settings
    seconds = float(np.ptp(recording.frame_time_s))
    x, y = np.add(settings.origin_m, site.middle_xy)
    frame = "recording" if settings.driven else "map"
    road = "where the recorded vehicles drive; no map" if settings.driven else settings.path
    junction = "about" if site.junction is None else f"junction {site.junction.name}, and the last {APPROACH_M:g} m of"
    region = f"{site.radius_m:g} m about x {x:.1f}, y {y:.1f} m of the {frame}"
    if site.junction is not None:
        region = f"{junction} {_approaches(len(site.approaches))}"
    names = ", ".join(pole.name for pole in site.poles)
    lines = [
        ("Traffic", f"{recording.source}: {kind}, {counted(len(recording.frames), 'frame')} in {seconds:.0f} s"),
        *(("", line) for line in recording.report.lines(losses=True)),
        *(("Assumed", text) for text in recording.report.assumed),
        ("Road", road),
        ("Region", f"{region}; {counted(site.vehicles, 'vehicle')}"),
        ("Middle", f"x {x:.1f}, y {y:.1f} m of the {frame}"),
        ("Poles", f"{len(site.poles)}, off the lanes, facing the middle: {names}"),
        *(("Note", note) for note in site.notes),
        ("Written", ", ".join(written)),
    ]
    scene = shlex.quote(written[0])
    pictures = [one for one in written if one.endswith(".png")]
    check = f"Look at {pictures[0]}, then:" if pictures else "Next:"
    return "\n".join([*(f"{name:<10} {text}" for name, text in lines), "", check, f"  blender-lidar optimise {scene}"])
