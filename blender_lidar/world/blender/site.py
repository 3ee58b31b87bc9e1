"""Sites of the user's own: .blend and mesh files, read as scenery."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ...errors import InputError, MissingFileError
from ..scenery import Scenery
from .quiet import first_error, quiet
from .roles import DISPLAY_ONLY, ROAD, VEHICLE, role
from .versions import check_version
from .visible import Keep, visible_triangles

# What reads a mesh file, by its suffix; the first operator that this Blender has is taken.
_IMPORTERS = {
    ".obj": ("wm.obj_import",),
    ".ply": ("wm.ply_import", "import_mesh.ply"),
    ".stl": ("wm.stl_import", "import_mesh.stl"),
    ".glb": ("import_scene.gltf",),
    ".gltf": ("import_scene.gltf",),
    ".fbx": ("wm.fbx_import", "import_scene.fbx"),
    ".usd": ("wm.usd_import",),
    ".usda": ("wm.usd_import",),
    ".usdc": ("wm.usd_import",),
    ".usdz": ("wm.usd_import",),
    ".abc": ("wm.alembic_import",),
    ".dae": ("wm.collada_import",),
}
_NOT_SCENERY = (*DISPLAY_ONLY, ROAD, VEHICLE)  # of our own objects: the ground plane is ours already


def read_site(path: str | Path, keep: Keep | None = None) -> Scenery:
    """The visible scenery of a .blend file or of a mesh file that Blender reads, in the file's own frame [m].

    Of a .blend with several scenes the first by name counts. Where it was built by this package, its road, vehicles,
    LiDAR and point cloud are left out, so that such a file can be given back with scenery added to it. Blender's own
    data are afterwards as they were.

    Parameters
    ----------
    path : path
    keep : callable, optional
        As for `visible_triangles`; what it leaves may be empty.

    Raises
    ------
    MissingFileError, InputError
        If there is no such file, Blender cannot read it, or nothing with faces is visible in it.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed: a .blend or mesh file")
    if not path.exists():
        raise MissingFileError(f"{path}: there is no such file")
    suffix = path.suffix.lower()
    if suffix != ".blend" and suffix not in _IMPORTERS:
        raise InputError(f"{path}: unknown kind of scene {suffix!r}; allowed: .blend, {', '.join(_IMPORTERS)}")
    if suffix == ".blend":
        check_version(path)
    with quiet(), _linked_scene(path) if suffix == ".blend" else _imported_scene(path) as scene:
        found = visible_triangles(scene, lambda item: role(item) in _NOT_SCENERY, keep)
    if len(found) == 0 and keep is None:
        raise InputError(f"{path}: nothing with faces is visible in it")
    if not np.isfinite(found.corners).all():
        raise InputError(f"{path}: has a vertex that is not finite")
    return found


@contextmanager
def _linked_scene(path: Path) -> Iterator[bpy.types.Scene]:
    """The first scene of a .blend file by name, linked while it lasts."""
    before = set(bpy.data.libraries)
    try:
        with bpy.data.libraries.load(str(path.resolve()), link=True) as (there, here):
            here.scenes = sorted(there.scenes)[:1]
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: Blender {bpy.app.version_string} cannot read it; is it a .blend file?") from error
    try:
        if not here.scenes or here.scenes[0] is None:
            raise InputError(f"{path}: has no scene")
        for library in bpy.data.libraries:
            if library not in before and not Path(bpy.path.abspath(library.filepath)).exists():
                raise InputError(f"{path}: takes objects from {library.filepath}, which is not there")
        yield here.scenes[0]
    finally:
        bpy.data.batch_remove([library for library in bpy.data.libraries if library not in before])


@contextmanager
def _imported_scene(path: Path) -> Iterator[bpy.types.Scene]:
    """A scene with what a mesh file holds, while it lasts."""
    operator = next((found for name in _IMPORTERS[path.suffix.lower()] if (found := _operator(name))), None)
    if operator is None:
        raise InputError(f"{path}: this Blender, {bpy.app.version_string}, reads no {path.suffix} files")
    window = bpy.context.window
    shown, before = window.scene, _everything()
    scene = bpy.data.scenes.new("Import")
    window.scene = scene
    try:
        try:
            operator(filepath=str(path.resolve()))
        except RuntimeError as error:  # what an operator reports
            raise InputError(f"{path}: Blender cannot read it: {first_error(error)}") from error
        yield scene
    finally:
        window.scene = shown
        bpy.data.batch_remove(_everything() - before)


def _everything():
    """All data-blocks that there are."""
    kinds = [kind.identifier for kind in bpy.data.bl_rna.properties if kind.type == "COLLECTION"]
    return {block for kind in kinds for block in getattr(bpy.data, kind)}


def _operator(name):
    """An operator by its name; None where this Blender has none of that name."""
    group, verb = name.split(".")
    return getattr(getattr(bpy.ops, group), verb) if verb in dir(getattr(bpy.ops, group)) else None
