"""Pictures of a scene, by Cycles on the processor: the same picture from the same scene, on any machine."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy

from ...errors import InputError, OutputError
from ...formats.atomic import write_bytes
from ...stop_signals import stops_end_at_once
from .quiet import first_error, quiet
from .roles import FAN, role
from .stage import ABOVE, FROM_POLE

CAMERAS = {"above": ABOVE, "pole": FROM_POLE}  # by the names of the pictures' files
SIZE = (1280, 720)
SAMPLES = 24
_SEED = 1
_BOUNCES = 3  # light that has been reflected more often shows in no picture of a road


def render_picture(
    path: str | Path, scene: bpy.types.Scene, camera: str, *, size: tuple[int, int] = SIZE, samples: int = SAMPLES
) -> None:
    """Render a scene through one of its cameras to a PNG file.

    Parameters
    ----------
    path : path
    scene : Scene
    camera : str
        Name of the camera.
    size : (int, int)
        Width and height [pixels].
    samples : int
        Light paths per pixel.

    Raises
    ------
    InputError
        For a camera that the scene does not have, or a Blender without Cycles.
    OutputError
        When the file cannot be written.
    """
    cameras = {item.name: item for item in scene.objects if item.type == "CAMERA"}
    if camera not in cameras:
        raise InputError(f"unknown camera {camera!r}; allowed: {', '.join(cameras) or 'none, the scene has no camera'}")
    scene.camera = cameras[camera]
    for item in scene.objects:
        if role(item) == FAN:  # seen from its own apex it would hide the road
            item.hide_render = camera == FROM_POLE
    _settings(scene, size, samples)
    with tempfile.TemporaryDirectory(prefix="blender_lidar-") as folder:  # in a path of ours nothing is a template
        picture = Path(folder) / "picture.png"
        scene.render.filepath = str(picture)
        try:
            with quiet(), stops_end_at_once():  # Cycles would swallow them and go on
                bpy.ops.render.render(write_still=True, scene=scene.name)
        except RuntimeError as error:
            raise OutputError(f"{path}: cannot be rendered: {first_error(error)}") from error
        write_bytes(path, picture.read_bytes())


def _settings(scene, size, samples):
    render = scene.render
    try:
        render.engine = "CYCLES"
    except TypeError as error:
        raise InputError(f"this Blender, {bpy.app.version_string}, has no Cycles to render with") from error
    scene.cycles.device, scene.cycles.samples, scene.cycles.seed = "CPU", samples, _SEED
    scene.cycles.use_adaptive_sampling, scene.cycles.adaptive_threshold = True, 0.03
    scene.cycles.use_denoising = "OPENIMAGEDENOISE" in _denoisers(scene)
    scene.cycles.max_bounces = _BOUNCES
    render.resolution_x, render.resolution_y = size
    render.resolution_percentage = 100
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    render.image_settings.compression = 90  # pictures are mailed within report.html
    render.use_file_extension = True


def _denoisers(scene):
    """Names of the denoisers that this Blender was built with."""
    return [item.identifier for item in scene.cycles.bl_rna.properties["denoiser"].enum_items]
