"""What each sensor sees of one moment, before and after: the paper's Fig. 8, as pictures and as clouds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..formats.atomic import make_folder
from ..formats.clouds import write_cloud
from ..moments import mounted_sensor
from ..optimise.objective import detectable
from ..plots.clouds import plot_clouds
from ..reporting.summary import mounting_text
from ..scenario import pose_at
from ..study.frame_scorer import FrameScorer
from ..study.scoring import CountedFrame
from ..study.site import Site
from .distance import judging_frames
from .mountings import Coordinates

SUFFIX = ".pcd"
NAMES = ("baseline", "optimised")


def busiest_frame(site: Site) -> CountedFrame:
    """The judging frame with the most vehicles in view."""
    frames, _, _ = judging_frames(site)
    return max(frames, key=lambda frame: int(frame.counted.sum()))


def write_clouds(site: Site, folder: Path, mountings: Mapping[str, Coordinates]) -> list[str]:
    """Write one PCD for each mounting into `folder`, as `blender-lidar scan` would; returns their names."""
    make_folder(folder, "--out")
    vehicles = busiest_frame(site).vehicles
    written = []
    for name, mount in mountings.items():
        sensor = mounted_sensor(site.scenario, mount)
        path = folder / f"{site.model.name.lower()}_{name}{SUFFIX}"
        write_cloud(path, sensor.scan(vehicles), sensor.cloud_header(vehicles))
        written.append(f"{folder.name}/{path.name}")
    return written


def draw_clouds(site: Site, path: Path, mountings: Mapping[str, Coordinates]) -> None:
    """Draw ``baseline`` and ``optimised`` from above.

    Raises
    ------
    MissingExtraError
        When matplotlib is not installed.
    """
    frame = busiest_frame(site)
    vehicles = frame.vehicles.select(frame.counted)
    scorer = FrameScorer(frame.vehicles, frame.counted, site.observation)
    clouds, noticed = [], []
    for name in NAMES:
        cloud = mounted_sensor(site.scenario, mountings[name]).scan(frame.vehicles)
        clouds.append({"xyz": cloud.xyz, "vehicle_id": cloud.vehicle_id})
        occupancy = scorer.see([pose_at(mountings[name])]).occupancy[0]
        noticed.append(detectable(occupancy, site.scoring.threshold, site.scoring.view))
    plot_clouds(
        path,
        tuple(clouds),
        {
            **dict(zip(("x_m", "y_m"), vehicles.centre_m.T[:2], strict=True)),
            **dict(zip(("length_m", "width_m"), vehicles.size_m.T[:2], strict=True)),
            "heading_deg": np.degrees(vehicles.heading_rad),
        },
        tuple(noticed),
        [[mountings[name][key] for key in ("x_m", "y_m")] for name in NAMES],
        mountings=tuple(mounting_text(mountings[name]) for name in NAMES),
        title=f"{site.model.name}: one revolution from above, frame {vehicles.frame}",
        subtitle="As the paper's Fig. 8",
    )
