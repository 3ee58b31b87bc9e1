"""The mounted LiDAR: pole, head, and a fan of its beams."""

from __future__ import annotations

import math

import bpy
import numpy as np
from mathutils import Euler, Matrix

from ...sensors.beams import BeamLattice, beam_directions
from ...sensors.pose import Pose
from .materials import BEAM, HEAD, METAL, plain
from .meshes import new_mesh
from .roles import FAN, SENSOR, add_object, clear, collection, only_for_the_eye

_HEAD_RADIUS_M, _HEAD_HEIGHT_M, _POLE_RADIUS_M = 0.06, 0.09, 0.07
_SIDES = 32
_FAN_REACH_M, _BEAM_RADIUS_M = 25.0, 0.006
_AZIMUTHS_RAD = (-math.pi / 3.0, 0.0, math.pi / 3.0)  # of the fan: across the road and obliquely ahead and back


def build_lidar(scene: bpy.types.Scene, lattice: BeamLattice, pose: Pose) -> bpy.types.Object:
    """Pole, head and beam fan at a mounting, in place of earlier ones.

    Returns
    -------
    Object
        The head, whose axes are those of the sensor frame.
    """
    into = collection(scene, "LiDAR", SENSOR)
    clear(into)
    metal = plain("Pole", METAL, roughness=0.4)
    length = pose.height_m - _HEAD_HEIGHT_M  # up to below the head
    if length > 0.0:
        pole = add_object(into, "Pole", _cylinder("Pole", _POLE_RADIUS_M, 0.0, length, metal))
        pole.location = (pose.x_m, pose.y_m, 0.0)
    half = 0.5 * _HEAD_HEIGHT_M
    head = add_object(into, "LiDAR", _cylinder("LiDAR", _HEAD_RADIUS_M, -half, half, plain("Head", HEAD)))
    head.matrix_world = sensor_matrix(pose)
    fan = add_object(into, "Beam fan", _fan(lattice, pose), FAN)
    fan.parent = head
    only_for_the_eye(fan)
    return head


def sensor_matrix(pose: Pose) -> Matrix:
    """What takes the sensor frame to the road frame: Eqs. 2 to 5 as Blender's Euler angles (-tilt_x, -tilt_y, yaw)."""
    turn = Euler((-pose.tilt_x, -pose.tilt_y, pose.yaw), "XYZ").to_matrix().to_4x4()
    return Matrix.Translation(pose.position.tolist()) @ turn


def _cylinder(name, radius, low, high, material):
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    vertices = np.concatenate(
        [np.insert(ring, 2, level, axis=1) for level in (low, high)] + [[(0, 0, low), (0, 0, high)]]
    )
    here, there = np.arange(_SIDES), np.roll(np.arange(_SIDES), -1)
    bottom, top = np.full(_SIDES, 2 * _SIDES), np.full(_SIDES, 2 * _SIDES + 1)
    faces = [
        (here, there, there + _SIDES),
        (here, there + _SIDES, here + _SIDES),
        (there, here, bottom),
        (here + _SIDES, there + _SIDES, top),
    ]
    return new_mesh(name, vertices, np.concatenate([np.stack(face, axis=1) for face in faces]), [material])


def _fan(lattice: BeamLattice, pose: Pose) -> bpy.types.Curve:
    """A thin line for each ring at a few azimuths, to the ground or as far as the fan reaches."""
    azimuth, elevation = np.meshgrid(np.array(_AZIMUTHS_RAD), lattice.elevation_rad)
    directions = beam_directions(azimuth.ravel(), elevation.ravel())
    down = -pose.to_world(directions)[:, 2]
    with np.errstate(divide="ignore"):
        reach = np.minimum(np.where(down > 0.0, pose.height_m / down, np.inf), _FAN_REACH_M)
    curve = bpy.data.curves.new("Beam fan", "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution = "3D", _BEAM_RADIUS_M, 0
    for direction, length in zip(directions.tolist(), reach.tolist(), strict=True):
        line = curve.splines.new("POLY")
        line.points.add(1)
        line.points[1].co = (*(length * component for component in direction), 1.0)
    curve.materials.append(plain("Beam", BEAM))
    return curve
