"""Fig. 8 of the paper: what each sensor sees of one moment, before and after, as clouds and as pictures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from blender_lidar.clouds.files import write_cloud
from blender_lidar.clouds.snapshot import mounted_sensor
from blender_lidar.optimise.objective import detectable
from blender_lidar.report.cloud_figures import Sight, plot_clouds
from blender_lidar.scene.mounting import pose_at
from blender_lidar.scene.observation import CountedFrame
from blender_lidar.scene.site import Site
from blender_lidar.scoring.frame_scorer import FrameScorer
from case_study import Coordinates


def busiest_frame(site: Site) -> CountedFrame:
    """The held-out frame with the most vehicles in view."""
    return max(site.holdout, key=lambda frame: int(frame.counted.sum()))


def write_clouds(site: Site, folder: Path, mountings: Mapping[str, Coordinates]) -> list[str]:
    """Write one PCD for each mounting into `folder`, as `blender-lidar scan` would; returns their names."""
    vehicles = busiest_frame(site).vehicles
    written = []
    for name, mount in mountings.items():
        sensor = mounted_sensor(site.scenario, mount)
        path = folder / f"{site.model.name.lower()}_{name}.pcd"
        write_cloud(path, sensor.scan(vehicles), sensor.cloud_header(vehicles))
        written.append(f"{folder.name}/{path.name}")
    return written


def draw_clouds(site: Site, path: Path, mountings: Mapping[str, Coordinates]) -> None:
    """Draw what two mountings see of one moment from above; MissingExtraError where matplotlib is not installed."""
    frame = busiest_frame(site)
    vehicles = frame.vehicles.select(frame.counted)
    scorer = FrameScorer(frame.vehicles, frame.counted, site.observation)
    seen = scorer.see([pose_at(mount) for mount in mountings.values()]).occupancy
    sights = [
        Sight(
            name,
            mount,
            mounted_sensor(site.scenario, mount).scan(frame.vehicles),
            detectable(occupancy, site.scoring.threshold, site.scoring.view),
        )
        for name, mount, occupancy in zip(("Baseline", "Optimised"), mountings.values(), seen, strict=True)
    ]
    title = f"{site.model.name}: one revolution from above, frame {vehicles.frame}"
    plot_clouds(path, vehicles, sights, title, "As the paper's Fig. 8")
