"""A whole scene: road, vehicles, LiDAR and what it saw, in Blender, and as a .blend file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ...errors import OutputError
from ...formats.atomic import whole_file
from ...scan import PointCloud
from ...sensors.beams import BeamLattice
from ...sensors.pose import Pose
from ...traffic.road import RoadFrame
from ...traffic.vehicles import Vehicles
from ..scenery import Scenery
from .lidar import build_lidar
from .points import build_cloud
from .quiet import first_error, quiet
from .render import SIZE
from .road import build_road, build_scenery
from .stage import build_stage, show_in_viewports
from .traffic import animate, show_vehicles

_LEAST_REACH_M = 120.0
_SEEN_SHARE, _SEEN_AT_MOST_M = 1.4, 120.0  # of the range gate: how much road the camera above takes in


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What is built: one frame of traffic under one mounting.

    Attributes
    ----------
    road : RoadFrame
        The carriageway.
    vehicles : Vehicles
        The frame.
    detail : str
        Level of detail of the vehicles' shapes.
    lattice : BeamLattice
        The sensor's beams.
    pose : Pose
        The mounting.
    range_gate_m : float
        How far the sensor is asked to see [m].
    cloud : PointCloud or None
        What it saw.
    entropy_bits : ndarray, (n,) or None
        PE-VGOP of the vehicle that each point of the cloud lies on [bits].
    scenery : Scenery or None
        What stands still.
    """

    road: RoadFrame
    vehicles: Vehicles
    detail: str
    lattice: BeamLattice
    pose: Pose
    range_gate_m: float
    cloud: PointCloud | None = None
    entropy_bits: np.ndarray | None = None
    scenery: Scenery | None = None


def empty_scene() -> bpy.types.Scene:
    """The one scene of a new file, with nothing in it; what Blender held before is gone."""
    with quiet():
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.name = "Road"
    scene.world = None
    scene.unit_settings.system = "METRIC"
    scene.view_settings.view_transform = "Standard"  # the points' colours as their ramps say
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    return scene


def build_scene(scene: bpy.types.Scene, moment: Moment) -> None:
    """Build a moment in a scene, in place of one that was built there earlier; objects of others stay."""
    reach = max(_LEAST_REACH_M, moment.range_gate_m) + float(abs(moment.pose.x_m))
    build_road(scene, moment.road, reach)
    build_scenery(scene, moment.scenery)
    show_vehicles(scene, moment.vehicles, moment.detail)
    build_lidar(scene, moment.lattice, moment.pose)
    build_cloud(scene, moment.cloud, moment.entropy_bits)
    build_stage(scene, moment.road, moment.pose, min(_SEEN_AT_MOST_M, _SEEN_SHARE * moment.range_gate_m))
    scene.view_layers[0].update()


def save_blend(path: str | Path, moment: Moment, frames: Sequence[Vehicles] = (), time_step_s: float = 0.1) -> None:
    """Write a moment as a .blend file that shows at once what is in it; what Blender held before is gone.

    Parameters
    ----------
    frames : sequence of Vehicles
        Frames that the vehicles drive through, as an animation that begins with the first; none lets them stand.
    time_step_s : float
        Time between consecutive frame numbers [s].

    Raises
    ------
    OutputError
        When the file cannot be written.
    """
    scene = empty_scene()
    build_scene(scene, moment)
    if frames:
        animate(scene, frames, moment.detail, time_step_s=time_step_s)
    show_in_viewports(scene)
    with whole_file(path) as temporary, quiet(), _without_backup():
        try:  # not packed: an older Blender must be able to tell that the file is too new for it
            bpy.ops.wm.save_as_mainfile(filepath=str(temporary.resolve()), copy=True, compress=False)
        except RuntimeError as error:
            raise OutputError(f"{path}: cannot be written: {first_error(error)}") from error


@contextmanager
def _without_backup() -> Iterator[None]:
    """While it lasts, Blender keeps no copy, under another name, of what was in a file's place."""
    files = bpy.context.preferences.filepaths
    before, files.save_version = files.save_version, 0
    try:
        yield
    finally:
        files.save_version = before
