"""What both mountings see: a frame's point clouds, and a detector's boxes in them, from above."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..clouds.scan import PointCloud, joined_clouds
from ..detection.judge import JudgedDetector, clouds_at, sensor_at, site_judge
from ..detection.scores import CONFIDENCES, CRITERIA, meetings
from ..run.folder import RunFolder
from ..run.optimise import sensors_text
from ..run.words import mounting_text, sides
from ..scene.mounting import Layout
from ..scene.site import Site
from ..traffic.boxes import Boxes, corners_of
from .figure import (
    FAINT,
    HEIGHT_COLOURS,
    INK,
    OPTIMISED_LOOK,
    WIDTH_MM,
    colours,
    legend_below,
    mark_sensor,
    place,
)
from .plan import Stand, draw_stands, plans, scale_bar, window_of
from .road_plan import draw_road

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.collections import PathCollection

    from ..road.road_map import RoadMap

# --- Point clouds of one frame from above -----------------------------------------------------------------------------

_MARGIN_M = 2.0
_HIGHEST_M = 4.0  # a truck's roof: all panels, and any two charts, share one scale
_KEY_MM = 23.0  # below all panels


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """One frame as a mounting sees it.

    Attributes
    ----------
    name : str
        What the mounting is called.
    text : str
        Where it hangs.
    stands : sequence of Stand
        Its LiDARs.
    xyz, vehicle_id : ndarray, (n, 3) and (n,)
        Points of one revolution of each [m], and the vehicles that they lie on, -1 for anything else.
    detectable : ndarray, (v,) bool
        Which of the frame's vehicles reach the threshold.
    """

    name: str
    text: str
    stands: Sequence[Stand]
    xyz: np.ndarray
    vehicle_id: np.ndarray
    detectable: np.ndarray


def draw_clouds(path: str | Path, site: Site, run: RunFolder) -> None:
    """Draw the searched frame with the most vehicles in view, as both mountings of a run see it."""
    frame = max(site.search, key=lambda candidate: int(candidate.counted.sum()))
    vehicles, sights = frame.select(frame.counted), []
    for table, (name, text, mounts) in zip((run.baseline, run.optimised), sides(run.result), strict=True):
        hung = [lidar.mounting(at) for lidar, at in zip(site.scenario.lidars, mounts.values(), strict=True)]
        cloud = joined_clouds([sensor_at(site.with_lidar(k), one).scan(frame) for k, one in enumerate(hung)])
        of_frame = (table["frame"] == vehicles.frame) & (table["split"] == "search")
        stands = [Stand(name, mounting.xy) for name, mounting in zip(mounts, hung, strict=True)]
        sights.append(Sight(name, text, stands, cloud.xyz, cloud.vehicle_id, table["detectable"][of_frame]))
    title = f"{run.result['sensor']}: one revolution from above, frame {vehicles.frame}"
    plot_clouds(path, vehicles, sights, title, road=site.scenario.road_map)


def plot_clouds(
    path: str | Path,
    vehicles: Boxes,
    sights: Sequence[Sight],
    title: str = "",
    subtitle: str = "",
    *,
    road: RoadMap | None = None,
) -> None:
    """Draw one frame's cloud under the baseline and under the other mounting, to scale.

    The boxes of the `vehicles` and the LiDARs set what part of the road is drawn; the `road` names the axes, and its
    lines are drawn. Errors as `figure.sheet`.
    """
    corners = corners_of(vehicles)
    poles = [stand.xy for sight in sights for stand in sight.stands]
    headings = []
    for sight in sights:
        points = np.count_nonzero(sight.vehicle_id >= 0)
        seen = f"{np.count_nonzero(sight.detectable)} of {len(sight.detectable)} vehicles detectable"
        headings.append(f"{sight.name}: {sight.text}\n{seen}, {points:,} points on vehicles")
    window = window_of([corners, poles], _MARGIN_M)
    with plans(path, window, headings, _KEY_MM, title, subtitle, road=road) as (figure, panels, bottom):
        for sight, axes in zip(sights, panels, strict=True):
            dots, entries = _draw_panel(axes, sight, corners, road)
            _draw_site(axes, road, window)
        bar = place(figure, 0.25 * WIDTH_MM, bottom + 1.5, 0.5 * WIDTH_MM, 2.5)
        label = "Height above the road of points on vehicles [m]"
        figure.colorbar(dots, cax=bar, orientation="horizontal", label=label)
        legend_below(figure, entries, columns=3)


def _draw_site(axes: Axes, road: RoadMap | None, window: np.ndarray) -> None:
    """The road below points and boxes, where it is known, and the scale."""
    if road is not None:
        draw_road(axes, road, window, {"facecolor": "none", "edgecolor": "none"}, arrows=False, over=0.5)
    if axes.get_xlabel():
        scale_bar(axes)


def _draw_panel(
    axes: Axes, sight: Sight, corners: np.ndarray, road: RoadMap | None
) -> tuple[PathCollection, list[Artist]]:
    """The cloud, boxes and LiDAR; returns the points on vehicles, darker the higher, and the legend's entries.

    Boxes are solid if detectable, else dashed and grey inside.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Patch

    on_vehicle = sight.vehicle_id >= 0
    x, y, _ = sight.xyz[~on_vehicle].T
    axes.plot(x, y, ".", color=FAINT, markersize=1.0, markeredgewidth=0.0, zorder=1)
    x, y, z = sight.xyz[on_vehicle].T
    z = z if road is None else z - road.surface.height(sight.xyz[on_vehicle])
    scale = {"cmap": colours(HEIGHT_COLOURS), "vmin": 0.0, "vmax": _HIGHEST_M}
    dots = axes.scatter(x, y, c=z, s=1.5, linewidths=0.0, zorder=3, **scale)
    solid = {"facecolor": "white", "edgecolor": INK, "linewidth": 0.7}
    dashed = {**solid, "facecolor": "#e2e2e2", "linestyle": (0, (2.5, 1.5))}
    for chosen, look in ((sight.detectable, solid), (~sight.detectable, dashed)):
        axes.add_collection(PolyCollection(corners[chosen], zorder=2, **look))
    marker = draw_stands(axes, sight.stands)
    patches = [Patch(label="vehicle, detectable", **solid), Patch(label="vehicle, not detectable", **dashed)]
    return dots, [marker, *patches]


# --- What a detector finds in one frame, from above -------------------------------------------------------------------

_SURE = CONFIDENCES[-1]
_RAISED_M = 0.3  # points above the road
_LEGEND_MM = 17.0  # below all panels
_HIT = {"edgecolor": OPTIMISED_LOOK["color"], "facecolor": "none", "linewidth": 1.1}
_FALSE = {"edgecolor": "#c0261c", "facecolor": "none", "linewidth": 1.4, "linestyle": (0, (2.2, 1.1))}
_ASIDE = {"edgecolor": "#8a8a8a", "facecolor": "none", "linewidth": 0.9, "linestyle": (0, (0.9, 0.9))}
_FOUND = {"facecolor": "#cfe0f2", "edgecolor": "none"}
_MISSED = {"facecolor": "#ffd9a6", "edgecolor": "#a35c00", "linewidth": 0.7, "hatch": "//////"}
_UNCOUNTED = {"facecolor": "#ececec", "edgecolor": "none"}


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What a detector made of one frame at a mounting.

    Attributes
    ----------
    name : str
        What the mounting is called.
    layout : Layout
    cloud : PointCloud
        What the detector was given.
    boxes : Boxes
        Its d detections.
    vehicle : ndarray of int, (d,)
        The vehicle that each is a hit on, -1 for none.
    ignored : ndarray of bool, (d,)
        Those that are neither hits nor false alarms.
    """

    name: str
    layout: Layout
    cloud: PointCloud
    boxes: Boxes
    vehicle: np.ndarray
    ignored: np.ndarray


def draw_detections(
    path: str | Path,
    site: Site,
    detector: str,
    judged: Mapping[str, JudgedDetector],
    layouts: Mapping[str, Layout],
) -> None:
    """Draw what a detector finds in the judging frame with the median number of vehicles, at the baseline and given."""
    judge = site_judge(site)
    frames = judge.frames
    number = int(np.argsort([frame.counted.sum() for frame in frames], kind="stable")[len(frames) // 2])
    frame, sure = frames[number], []
    for name in filter(judged.get, ("baseline", "given")):  # what parts of a layout find is in the table
        boxes = judged[name].boxes[number].select(judged[name].boxes[number].confidence >= _SURE)
        each = enumerate(layouts[name])
        cloud = joined_clouds([clouds_at(site.with_lidar(number), one)(frame) for number, one in each])
        met = meetings(boxes, frame, judge.region, CRITERIA[0])
        called = "Late fusion" if name == "given" and site.scenario.is_layout else name.capitalize()
        sure.append(Found(called, layouts[name], cloud, boxes, *met))
    title = f"{sensors_text(site)}: what the detector {Path(detector).stem} finds in frame {frame.frame}"
    of_frames = f"{len(frames)} {'held-out' if judge.held_out else 'searched'} frames"
    rule = f"confidence {_SURE:g} or more, hits within {CRITERIA[0].most_m:g} m"
    subtitle = f"{frame.counted.sum()} vehicles, the median of {of_frames}; {rule}"
    leaning, road = site.scenario.lidars[0].deployment.places[0].leans, site.scenario.road_map
    plot_detections(path, frame, sure, title, subtitle, leaning=leaning, road=road)


def plot_detections(
    path: str | Path,
    frame: Boxes,
    found: Sequence[Found],
    title: str = "",
    subtitle: str = "",
    *,
    leaning: bool = False,
    road: RoadMap | None = None,
) -> None:
    """Draw detections over the footprints of a frame's vehicles and the points, at each of some mountings, to scale.

    The vehicles and detections that count and the LiDARs set what part of the road is drawn; `leaning`, `road` and
    errors as for `plot_clouds`.
    """
    poles = np.array([mounting.xy for one in found for mounting in one.layout])
    counted = [
        corners_of(frame.select(frame.counted)),
        *(corners_of(one.boxes)[~one.ignored] for one in found),
    ]
    window = window_of([poles, *counted], _MARGIN_M)
    headings = []
    for one in found:
        hits, vehicles = np.count_nonzero(one.vehicle >= 0), np.count_nonzero(frame.counted)
        alarms = len(one.boxes) - int(hits) - int(np.count_nonzero(one.ignored))
        text = f"{hits} of {vehicles} vehicles found, {alarms} false alarm{'s' * (alarms != 1)}"
        several = f"{len(one.layout)} LiDARs"
        where = several if one.layout[1:] else mounting_text(one.layout[0].as_table(), leans=leaning)
        headings.append(f"{one.name}: {where}\n{text}")
    with plans(path, window, headings, _LEGEND_MM, title, subtitle, road=road) as (figure, panels, _):
        for one, axes in zip(found, panels, strict=True):
            entries = _draw_found(axes, frame, one)
            _draw_site(axes, road, window)
        legend_below(figure, entries, columns=4)


def _draw_found(axes: Axes, frame: Boxes, one: Found) -> list[Artist]:
    """Footprints below the points, detections above them, each with a tick to its front; returns the legend's."""
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.patches import Patch

    hit, footprint, box = one.vehicle >= 0, corners_of(frame), corners_of(one.boxes)
    found = np.isin(np.arange(len(frame.counted)), one.vehicle)
    vehicles = {
        "vehicle, found": (found, _FOUND),
        "vehicle, missed": (frame.counted & ~found, _MISSED),
        "vehicle that does not count": (~frame.counted, _UNCOUNTED),
    }
    detections = {
        "detection: hit": (hit, _HIT),
        "detection: false alarm": (~hit & ~one.ignored, _FALSE),
        "detection that does not count": (one.ignored, _ASIDE),
    }
    for chosen, look in vehicles.values():
        axes.add_collection(PolyCollection(footprint[chosen], zorder=1, **look))
    raised = one.cloud.xyz[:, 2] > _RAISED_M
    for chosen, colour, size in ((~raised, FAINT, 1.0), (raised, INK, 1.4)):
        axes.plot(*one.cloud.xyz[chosen, :2].T, ".", color=colour, markersize=size, markeredgewidth=0.0, zorder=2)
    front = box[:, [0, 3]].mean(axis=1)
    ticks = np.stack([one.boxes.centre_m[:, :2], front], axis=1)
    for chosen, look in detections.values():
        axes.add_collection(PolyCollection(box[chosen], zorder=3, **look))
        axes.add_collection(LineCollection(ticks[chosen], color=look["edgecolor"], linewidth=0.8, zorder=3))
    patches = [Patch(label=name, **look) for name, (_, look) in {**detections, **vehicles}.items()]
    return [*patches, mark_sensor(axes, np.transpose([mounting.xy for mounting in one.layout]))]
