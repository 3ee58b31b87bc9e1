"""What each sensor sees of one moment, before and after: the paper's Fig. 8, as pictures and as clouds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import OutputError
from ..formats.clouds import write_cloud
from ..optimise.objective import detectable
from ..plots.clouds import plot_clouds
from ..provenance import versions
from ..scan import PointCloud, scan
from ..scenario import pose_at
from ..study.evaluation import CountedFrame
from ..study.frame_scorer import FrameScorer
from ..study.score_map import AXES
from ..study.site import Site
from .distance import Mounting, judging_frames

SUFFIX = ".pcd"


def busiest_frame(site: Site) -> CountedFrame:
    """The judging frame with the most vehicles in view."""
    frames, _, _ = judging_frames(site)
    return max(frames, key=lambda frame: int(frame.counted.sum()))


def scan_mounting(site: Site, frame: CountedFrame, mounting: Mounting) -> PointCloud:
    """One revolution over the frame, ground included."""
    seen = site.observation
    return scan(
        frame.vehicles,
        seen.lattice,
        pose_at(_coordinates(site, mounting)),
        caster=seen.caster,
        detail=seen.detail,
        min_range_m=seen.min_range_m,
        max_range_m=seen.max_range_m,
    )


def write_clouds(site: Site, folder: Path, mountings: Mapping[str, Mounting]) -> list[str]:
    """Write one PCD for each mounting into `folder`; returns their names."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: the folder cannot be made: {error.strerror}") from error
    frame, seen = busiest_frame(site), site.observation
    written = []
    for name, mounting in mountings.items():
        header = {
            "sensor": site.model.name,
            "pose": _coordinates(site, mounting),
            "frame": frame.vehicles.frame,
            "caster": seen.caster,
            "detail": seen.detail,
            "ring_elevation_deg": np.degrees(seen.lattice.elevation_rad).round(6).tolist(),
            "azimuth_step_deg": float(np.degrees(seen.lattice.step_rad)),
            "rotation_hz": seen.lattice.rotation_hz,
            "range_m": [seen.min_range_m, seen.max_range_m],
            "versions": versions(seen.caster),
        }
        path = folder / f"{site.model.name.lower()}_{name}{SUFFIX}"
        write_cloud(path, scan_mounting(site, frame, mounting), header)
        written.append(f"{folder.name}/{path.name}")
    return written


def draw_clouds(site: Site, path: Path, mountings: Mapping[str, Mounting]) -> None:
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
    for name in ("baseline", "optimised"):
        cloud = scan_mounting(site, frame, mountings[name])
        clouds.append({"xyz": cloud.xyz, "vehicle_id": cloud.vehicle_id})
        occupancy = scorer.see([pose_at(_coordinates(site, mountings[name]))]).occupancy[0]
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
        [site.scenario.baseline[key] for key in ("x_m", "y_m")],
        mountings=tuple(
            f"height {height:.1f} m, tilt {tilt:.0f}°"
            for height, tilt in (mountings[name] for name in ("baseline", "optimised"))
        ),
        title=f"{site.model.name}: one revolution from above, frame {vehicles.frame}",
        subtitle="As the paper's Fig. 8",
    )


def _coordinates(site: Site, mounting: Mounting) -> dict[str, float]:
    return {**site.scenario.baseline, **dict(zip(AXES, mounting, strict=True))}
