"""Install the extension's zip in a Blender, use every button, remove it, and once more: run by a Blender or its Python.

    python tests/extension_session.py ZIP
    blender --background --factory-startup --python tests/extension_session.py -- ZIP

Prints a line of JSON. BLENDER_USER_RESOURCES should be a folder of its own.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from pathlib import Path

import bpy

ZIP = sys.argv[sys.argv.index("--") + 1 if "--" in sys.argv else 1]
REPOSITORY = "user_default"
EXTENSION = bpy.app.version >= (4, 2, 0)
MODULE = f"bl_ext.{REPOSITORY}.blender_lidar" if EXTENSION else "blender_lidar"


def left_behind() -> dict[str, list[str]]:
    """All that an add-on may leave: classes, handlers, timers, properties, entries of menus."""
    kinds = (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.Menu)
    classes = [cls.__name__ for kind in kinds for cls in kind.__subclasses__() if cls.__name__.startswith("LIDAR_")]
    classes = [name for name in classes if hasattr(bpy.types, name)]
    lists = (getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers))
    handlers = [call.__module__ for one in lists if isinstance(one, list) for call in one if MODULE in call.__module__]
    properties = [name for name in ("blender_lidar",) if hasattr(bpy.types.Scene, name)]
    properties += [name for name in ("lidar",) if hasattr(bpy.types.Object, name)]
    menu = [call.__module__ for call in bpy.types.VIEW3D_MT_add._dyn_ui_initialize() if MODULE in call.__module__]
    return {"classes": classes, "handlers": handlers, "properties": properties, "menu": menu}


def install() -> None:
    """Install and enable; the operators answer FINISHED on failure too, so the preferences are asked."""
    if EXTENSION:
        bpy.ops.extensions.package_install_files(filepath=ZIP, repo=REPOSITORY, enable_on_install=True)
    else:
        bpy.ops.preferences.addon_install(filepath=ZIP, overwrite=True)
        bpy.ops.preferences.addon_enable(module=MODULE)
    assert MODULE in bpy.context.preferences.addons, f"{MODULE} is not enabled"


def remove() -> None:
    """Disable and remove."""
    if EXTENSION:
        bpy.ops.preferences.addon_disable(module=MODULE)
        if bpy.app.version < (4, 5, 0):  # as a module it would crash at its end, as after any add-on with an update
            return
        repositories = bpy.context.preferences.extensions.repos
        at = next(at for at, one in enumerate(repositories) if one.module == REPOSITORY)
        bpy.ops.extensions.package_uninstall(repo_index=at, pkg_id="blender_lidar")
    else:
        bpy.ops.preferences.addon_disable(module=MODULE)
        folder = bpy.utils.user_resource("SCRIPTS", path="addons")
        shutil.rmtree(Path(folder) / MODULE)  # 3.4's operator wants a window to draw
    assert MODULE not in bpy.context.preferences.addons


def scanned() -> dict[str, object]:
    """What the example's LiDAR sees after an installation."""
    lidar_ops, scene = bpy.ops.blender_lidar, bpy.context.scene
    assert not lidar_ops.scan.poll(), "scan needs traffic"
    assert lidar_ops.load_example() == {"FINISHED"}
    lidar = scene.objects["LiDAR"]
    lidar.blender_lidar.height_m, lidar.blender_lidar.tilt_x_deg = 4.0, 0.35
    assert lidar_ops.scan() == {"FINISHED"}
    return {
        "points": lidar.blender_lidar.points,
        "objective": round(lidar.blender_lidar.objective, 3),
        "frame": scene.blender_lidar.frame,
    }


def used() -> dict[str, object]:
    """Every other button once; what came of it."""
    lidar_ops, scene = bpy.ops.blender_lidar, bpy.context.scene
    lidar, found = scene.objects["LiDAR"], {}
    assert lidar_ops.step_frame() == {"FINISHED"}
    assert lidar_ops.set_baseline() == {"FINISHED"}
    assert lidar_ops.load() == {"FINISHED"}
    assert lidar_ops.add() == {"FINISHED"}
    bpy.context.view_layer.objects.active = scene.blender_lidar.active = lidar
    with tempfile.TemporaryDirectory() as folder:
        assert lidar_ops.export_cloud(filepath=str(Path(folder) / "cloud.npz")) == {"FINISHED"}
        assert lidar_ops.export_labelled(directory=str(Path(folder) / "labelled")) == {"FINISHED"}
        scene.blender_lidar.traffic.frames = 2
        assert lidar_ops.export_run(directory=str(Path(folder) / "run")) == {"FINISHED"}
        found["run"] = sorted(path.name for path in (Path(folder) / "run").iterdir())
        bpy.ops.mesh.primitive_cube_add(location=(15.0, 15.0, 1.0))  # what hides vehicles
        search = scene.blender_lidar.search
        search.particles, search.iterations = 4, 2
        assert lidar_ops.optimize() == {"FINISHED"}
        assert lidar_ops.apply() == {"FINISHED"}
        found["gain"] = round(json.loads(lidar.blender_lidar.found)["holdout"]["gain_over_baseline"], 3)
        assert lidar_ops.revert() == {"FINISHED"}
        path = Path(folder) / "saved.blend"
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        bpy.ops.wm.open_mainfile(filepath=str(path))
        assert round(bpy.data.objects["LiDAR"].blender_lidar.height_m, 3) == 4.0
        assert bpy.ops.blender_lidar.scan() == {"FINISHED"}
    return found


def main() -> None:
    """Installed and removed twice in one process."""
    message, seen = {}, []
    for use in (used, dict):
        bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
        install()
        seen.append(scanned())
        message |= use()
        remove()
        left = left_behind()
        assert not any(left.values()), left
    sys.stdout.write(json.dumps({"version": bpy.app.version_string, "scanned": seen, "used": message}) + "\n")


if __name__ == "__main__":
    main()
