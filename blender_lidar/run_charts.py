"""The charts of a run, drawn from what it came to."""

from __future__ import annotations

import numpy as np

from .metrics.catalogue import metric_named
from .metrics.vgop import occupancy_views
from .metrics.views import PE_VGOP
from .plots.blind_zones import plot_blind_zones
from .plots.by_distance import plot_by_distance
from .plots.clouds import plot_clouds
from .plots.convergence import plot_convergence
from .plots.occupancy import OccupancyViews, plot_occupancy
from .plots.score_map import plot_score_map
from .reporting.summary import mounting_name, mounting_text, sharp_of
from .results import RunFolder
from .run import Outcome
from .scan import scan
from .scenario import pose_at
from .study.frame_scorer import FrameScorer
from .study.site import Site
from .study.vehicle_table import METRIC_VALUE


def draw_charts(site: Site, outcome: Outcome, folder: RunFolder) -> list[str]:
    """Draw every chart that the run has data for; returns the names of the files.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    result, metric = outcome.result, metric_named(outcome.result["metric"])
    mountings = tuple(mounting_text(mount) for mount in (result["baseline"]["deployment"], result["deployment"]))
    sensor_xy = [
        [mount[key] for key in ("x_m", "y_m")] for mount in (result["baseline"]["deployment"], result["deployment"])
    ]
    metric_text = "" if metric is PE_VGOP else f", metric {metric.name}"
    about = (
        f"{result['sensor']}, range gate {result['range_gate_m']:g} m, "
        f"{result['vehicles']} vehicles in {result['frames']} frames{metric_text}"
    )
    tables = (outcome.baseline, outcome.optimised)
    drawn = []
    if outcome.history is not None:
        _draw_convergence(folder, drawn, outcome, about)
    if outcome.score_map is not None:
        _draw_map(folder, drawn, outcome, about)
    by_entropy = metric is PE_VGOP or metric.of_scene  # the value of a scene is no vehicle's
    plot_by_distance(
        _file(folder, drawn, "by_distance.png"),
        *tables,
        metric=PE_VGOP if by_entropy else metric,
        column="entropy_bits" if by_entropy else METRIC_VALUE,
        names=_names(outcome),
        title="What is seen, by distance",
        subtitle=f"{about}, and held-out frames",
    )
    plot_blind_zones(
        _file(folder, drawn, "blind_zones.png"),
        *tables,
        sensor_xy,
        site.scenario.road.carriageway_y,
        (5.0, site.scenario.road.lane_width_m),
        names=_names(outcome),
        mountings=mountings,
        title="Where vehicles stay below the threshold",
        subtitle=f"{about}, and held-out frames",
    )
    _draw_clouds(site, folder, drawn, outcome, sensor_xy, mountings)
    _draw_occupancy(site, folder, drawn, outcome, mountings)
    return drawn


def _names(outcome):
    return "Baseline", mounting_name(outcome.result).capitalize()


def _file(folder, drawn, name):
    drawn.append(name)
    return folder.file(name)


def _draw_convergence(folder, drawn, outcome, about):
    """The search that found the mounting: over a tolerance, its values and the baseline's are those over it."""
    result, history = outcome.result, outcome.history
    vehicles, over = result["vehicles"], "" if sharp_of(result) is None else " over the tolerance"
    baseline = result["tolerance"]["robust"]["baseline"] if over else result["baseline"]
    plot_convergence(
        _file(folder, drawn, "convergence.png"),
        history[:, 0],
        history[:, -2] / vehicles,
        history[:, -1] / vehicles,
        baseline["objective_per_vehicle"],
        metric=metric_named(result["metric"]),
        title=f"Search{over}: {result['search']}, seed {result['seed']}, {result['reading']} reading",
        subtitle=about,
    )


def _draw_map(folder, drawn, outcome, about):
    """The landscape of mountings that hang as planned: its optimum is the sharp one where the run's is robust."""
    result, score_map = outcome.result, outcome.score_map
    sharp = sharp_of(result)
    optimum = result if sharp is None else sharp
    plot_score_map(
        _file(folder, drawn, "score_map.png"),
        score_map.height_m,
        score_map.tilt_deg,
        score_map.per_vehicle,
        _height_and_tilt(optimum),
        _height_and_tilt(result["baseline"]),
        baseline_value=result["baseline"]["objective_per_vehicle"],
        optimum_value=optimum["objective_per_vehicle"],
        robust=None if sharp is None else (_height_and_tilt(result), result["objective_per_vehicle"]),
        metric=metric_named(result["metric"]),
        title="Objective over height and tilt",
        subtitle=about,
    )


def _height_and_tilt(scores):
    return scores["deployment"]["height_m"], scores["deployment"]["tilt_x_deg"]


def _draw_clouds(site, folder, drawn, outcome, sensor_xy, mountings):
    """The searched frame with the most vehicles in view, as both mountings see it."""
    frame = max(site.search, key=lambda candidate: int(candidate.counted.sum()))
    vehicles = frame.vehicles.select(frame.counted)
    clouds, noticed = [], []
    for table, mount in (
        (outcome.baseline, outcome.result["baseline"]["deployment"]),
        (outcome.optimised, outcome.result["deployment"]),
    ):
        cloud = scan(
            frame.vehicles,
            site.observation.lattice,
            pose_at(mount),
            caster=site.observation.caster,
            detail=site.observation.detail,
            min_range_m=site.observation.min_range_m,
            max_range_m=site.observation.max_range_m,
            ground=site.scenario.world.ground,
            scenery=site.observation.scenery,
            imperfections=site.observation.imperfections,
        )
        clouds.append({"xyz": cloud.xyz, "vehicle_id": cloud.vehicle_id})
        of_frame = (table["frame"] == vehicles.frame) & (table["split"] == "search")
        noticed.append(table["detectable"][of_frame])
    boxes = {
        **dict(zip(("x_m", "y_m"), vehicles.centre_m.T[:2], strict=True)),
        **dict(zip(("length_m", "width_m"), vehicles.size_m.T[:2], strict=True)),
        "heading_deg": np.degrees(vehicles.heading_rad),
    }
    plot_clouds(
        _file(folder, drawn, "clouds.png"),
        tuple(clouds),
        boxes,
        tuple(noticed),
        sensor_xy,
        names=_names(outcome),
        mountings=mountings,
        title=f"{outcome.result['sensor']}: one revolution from above, frame {vehicles.frame}",
    )


def _draw_occupancy(site, folder, drawn, outcome, mountings):
    """The occupancy grids of a vehicle that gains a typical amount: the paper's Fig. 4, before and after."""
    searched = outcome.optimised["split"] == "search"
    before, after = (table["entropy_bits"][searched] for table in (outcome.baseline, outcome.optimised))
    visible = np.flatnonzero((after > 0) & (before > 0))
    if len(visible) == 0:
        visible = np.arange(len(after))
    gain = (after - before)[visible]
    row = visible[np.argsort(gain, kind="stable")[int(0.75 * (len(gain) - 1))]]
    number, vehicle_id = (int(outcome.optimised[key][searched][row]) for key in ("frame", "vehicle_id"))
    frame = next(candidate for candidate in site.search if candidate.vehicles.frame == number)
    counted = frame.vehicles.select(frame.counted)
    index = int(np.flatnonzero(counted.vehicle_id == vehicle_id)[0])
    scorer = FrameScorer(frame.vehicles, frame.counted, site.observation)
    views = []
    for mount in (outcome.result["baseline"]["deployment"], outcome.result["deployment"]):
        local, owner = scorer.vehicle_points(pose_at(mount))
        grids = occupancy_views(local[owner == index], counted.size_m[index], site.observation.cell_m)
        views.append(OccupancyViews(grids, tuple(counted.size_m[index].tolist()), site.observation.cell_m))
    plot_occupancy(
        _file(folder, drawn, "occupancy.png"),
        *views,
        names=_names(outcome),
        mountings=mountings,
        title=f"Occupied cells of one {counted.class_name[index]}, vehicle {vehicle_id} in frame {number}",
        subtitle=(
            f"{outcome.result['sensor']}, {outcome.optimised['distance_m'][searched][row]:.0f} m away; "
            "three quarters of the vehicles that both mountings see gain less PE-VGOP"
        ),
    )
