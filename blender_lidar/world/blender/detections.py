"""Detections as wire boxes: a mesh for each frame whose edges a wireframe modifier shows as thin bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import bpy
import numpy as np

from ...names import KINDS
from ...traffic.boxes import Boxes
from ..triangles import place
from .objects import (
    DETECTION_ROLE,
    add_attribute,
    add_object,
    clear,
    collection,
    frame_of,
    new_mesh,
    only_for_the_eye,
    plain,
    set_inputs,
)

_NAME = "Detections"
# Linear RGB by kind, like no paint of vehicles and no colour of points on them.
_COLOURS = dict(zip(KINDS, ((0.0, 0.75, 1.0), (1.0, 0.05, 0.65), (1.0, 1.0, 1.0)), strict=True))
_BAR_M = 0.09  # seen from across the road about a pixel
# Of a box of length, width and height 1: its corners below and above, counter-clockwise from the front left, and the
# ends of a line across its roof that says where the front is.
_CORNERS = [(x, y, z) for z in (-0.5, 0.5) for x, y in ((0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5))]
_VERTICES = np.array([*_CORNERS, (0.25, 0.5, 0.5), (0.25, -0.5, 0.5)])
_SIDES = [(row, (row + 1) % 4, 4 + (row + 1) % 4, 4 + row) for row in range(4)]
_FACES = np.array([(3, 2, 1, 0), (8, 5, 6, 9), (4, 8, 9, 7), *_SIDES])


def show_detections(scene: bpy.types.Scene, boxes: Boxes | None) -> None:
    """Wire boxes of a frame's detections, in place of earlier ones; None only takes these away.

    Every vertex has the attributes `kind`, an index into `KINDS`, and `confidence`; of each box the first eight are its
    corners.
    """
    clear(collection(scene, _NAME, DETECTION_ROLE))
    if boxes is not None:
        _new_boxes(scene, _NAME, boxes)


def animate_detections(
    scene: bpy.types.Scene, of_frame: Mapping[int, Boxes], frames: Sequence[int], since_s: Sequence[float]
) -> None:
    """Wire boxes of several frames, in place of earlier ones, each frame's from its moment to the next frame's.

    Parameters
    ----------
    of_frame : mapping of int to Boxes
        By the numbers of their frames; those of other frames are left out.
    frames : sequence of int
        That the scene's vehicles drive through.
    since_s : sequence of float
        When each of them is, since the first, which is at the beginning of the scene's animation [s].
    """
    show_detections(scene, None)
    times = [scene.frame_start + since * scene.render.fps for since in since_s]
    for number, (at, end) in zip(frames, pairwise([*times, None]), strict=True):
        if number not in of_frame:
            continue
        item = _new_boxes(scene, f"{_NAME} {number}", of_frame[number])
        if number != frames[0]:
            _key_visibility(item, shown=False, at=scene.frame_start)
        _key_visibility(item, shown=True, at=at)
        if end is not None:
            _key_visibility(item, shown=False, at=end)
    scene.frame_set(scene.frame_start)


def _key_visibility(item, *, shown, at):
    """From a frame of the animation on let an object be shown, or not."""
    item.hide_render = item.hide_viewport = not shown
    item.keyframe_insert("hide_render", frame=at)
    item.keyframe_insert("hide_viewport", frame=at)


def _new_boxes(scene, name, boxes):
    vertices = place(_VERTICES, boxes.centre_m, boxes.size_m, boxes.heading_rad)
    first = len(_VERTICES) * np.arange(len(vertices))
    mesh = new_mesh(
        name,
        vertices.reshape(-1, 3),
        (first[:, None, None] + _FACES).reshape(-1, 4),
        [_material(kind) for kind in KINDS],
        np.repeat(boxes.kind, len(_FACES)),
    )
    for attribute in ("kind", "confidence"):
        add_attribute(mesh, attribute, np.repeat(getattr(boxes, attribute), len(_VERTICES)))
    item = add_object(collection(scene, _NAME, DETECTION_ROLE), name, mesh, parent=frame_of(scene))
    item.modifiers.new("Wire", "WIREFRAME").thickness = _BAR_M
    only_for_the_eye(item)
    return item


def _material(kind):
    """Shines by itself: seen in any light, also in the shadow of a lorry."""
    colour = _COLOURS[kind]
    material = plain(f"Detected {kind}", colour)
    shine = "Emission Color" if bpy.app.version >= (4, 0) else "Emission"
    inputs = {"Base Color": (0.0, 0.0, 0.0, 1.0), shine: (*colour, 1.0), "Emission Strength": 1.0}
    set_inputs(material, "BSDF_PRINCIPLED", inputs)
    return material
