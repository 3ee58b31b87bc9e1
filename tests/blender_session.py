"""What tests of Blender share."""

from __future__ import annotations

import bpy
import numpy as np

from blender_lidar.casting import caster_class
from blender_lidar.clouds.snapshot import vertices_of
from blender_lidar.road.settings import RoadSettings, map_of
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.traffic import traffic_object
from blender_lidar.world.scenery import barrier, box, join
from blender_lidar.world.triangles import shape_names
from tests.sample_traffic import dense_traffic, scan

LATTICE = beam_lattice(load_model("RS-16"), stride=8)
POSE = Pose(0.5, -0.5, 4.2, 0.35, -0.05, 0.3)
ROAD = map_of(RoadSettings(setback_m=1.0, lanes=3, lane_width_m=3.6))
TRAFFIC = dense_traffic(vehicles=40, length_m=90.0)
SCENERY = join([barrier("concrete", 14.0, (-40.0, 40.0)), box("cabinet", (5.0, -1.0, 0.8), (1.0, 0.6, 1.6), 0.5)])
REACH_M = 60.0


def moment(vehicles=TRAFFIC, detail="body", pose=POSE, cloud=True, scenery=SCENERY, detections=None):
    """A moment, with random bits in place of a score."""
    from blender_lidar.world.blender.scene import Moment

    points = None
    if cloud:
        seen = scan(vehicles, LATTICE, pose, caster="bvh", detail=detail, max_range_m=REACH_M)
        points = vertices_of(seen, vehicles, np.random.default_rng(1).random(len(vehicles)))
    return Moment(ROAD, vehicles, detail, LATTICE, pose, REACH_M, points, scenery, None, detections or {})


def shown_vehicles(scene):
    """Boxes that the scene's vehicles fill as Blender shows them, with their shapes' names, by their places."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = [
        (np.array(instance.matrix_world, dtype=float), instance.object.name)
        for instance in depsgraph.object_instances
        if instance.is_instance and instance.parent.original == traffic_object(scene)
    ]
    matrix = np.array([one for one, _ in found]).reshape(-1, 4, 4)
    names = np.array([name.split()[1] for _, name in found], dtype=object)
    turn = np.arctan2(matrix[:, 1, 0], matrix[:, 0, 0])
    return matrix[:, :3, 3], np.linalg.norm(matrix[:, :3, :3], axis=1), turn, names


def assert_shows(scene, vehicles, *, atol=1e-4):
    """The scene shows these vehicles and no others, each in its shape, in the road frame."""
    centre, size, heading, names = shown_vehicles(scene)
    assert len(centre) == len(vehicles)
    if not len(vehicles):
        return
    row = np.abs(centre[:, None] - vehicles.centre_m[None]).sum(axis=2).argmin(axis=1)
    assert len(set(row.tolist())) == len(row)
    np.testing.assert_allclose(centre, vehicles.centre_m[row], atol=atol)
    np.testing.assert_allclose(size, vehicles.size_m[row], rtol=1e-5)
    np.testing.assert_allclose(np.cos(heading - vehicles.heading_rad[row]), 1.0, atol=1e-6)
    assert names.tolist() == shape_names(vehicles)[row].tolist()


def hits(corners, owner, pose=POSE, reach=REACH_M):
    """Distance and owner of what every beam meets first; -1 for nothing."""
    directions = pose.to_world(LATTICE.directions.reshape(-1, 3))
    found = caster_class("exact")(corners).cast(pose.position, directions, reach)
    return found.distance, np.where(found.triangle >= 0, owner[found.triangle], -1)


def colours_shown(cloud):
    """Linear RGBA (n, 4) of the points that Blender shows of a cloud; the oldest shows each by twelve corners."""
    import bpy

    cloud.update_tag()
    bpy.context.view_layer.update()
    for one in bpy.context.evaluated_depsgraph_get().object_instances:
        if one.object.name == cloud.name and "colour" in one.object.data.attributes:
            stored = one.object.data.attributes["colour"].data
            colours = np.empty(4 * len(stored), np.float32)
            stored.foreach_get("color", colours)
            return colours.reshape(-1, 4)[:: 12 if bpy.app.version < (4, 0) else 1]
    return np.empty((0, 4), np.float32)
