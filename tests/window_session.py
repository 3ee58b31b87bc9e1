"""Use the add-on in Blender's real window with real keys and mouse: run by Debian's Blender under xvfb.

    xvfb-run -s "-screen 0 1400x1000x24" env LIBGL_ALWAYS_SOFTWARE=1 \
        blender --factory-startup --window-geometry 0 0 1400 1000 --python tests/window_session.py -- ZIP OUT_FOLDER

Steps are a generator that yields how long Blender may breathe; events come from xdotool, a process of its own. Writes a
picture after each step, and prints a line of JSON when all steps are done.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import traceback
from pathlib import Path

import bpy

ZIP, OUT = sys.argv[sys.argv.index("--") + 1], Path(sys.argv[sys.argv.index("--") + 2]).absolute()
SIZE = (1400, 1000)
# In a window of that size: the sidebar's third tab, and buttons in it.
TAB, LOAD_EXAMPLE, SCAN = (1143, 199), (1030, 200), (995, 631)  # Scan: after the wheel has turned ten times
TOLD: dict[str, object] = {}


def window():
    return bpy.context.window_manager.windows[0]


def regions():
    area = next(area for area in window().screen.areas if area.type == "VIEW_3D")
    return area, *(next(one for one in area.regions if one.type == kind) for kind in ("WINDOW", "UI"))


def photograph(name):
    with bpy.context.temp_override(window=window(), screen=window().screen):
        bpy.ops.screen.screenshot(filepath=str(OUT / f"{name}.png"))


def events(*words):
    subprocess.Popen(["xdotool", *map(str, words)])


def clicked(x, y):
    events("mousemove", x, y)
    yield 0.4
    events("click", 1)
    yield 0.4


def scrolled(steps):
    """The wheel turned over the tab, downwards."""
    events("mousemove", 1050, 700, "click", "--repeat", steps, "--delay", 20, 5)


def pressed(*keys):
    events("key", *keys)
    return 0.4


def called(which, *how, **given):
    """An operator in the 3D view, as its button calls it."""
    area, region, _ = regions()
    with bpy.context.temp_override(window=window(), area=area, region=region):
        group, operator = which.split(".")
        return getattr(getattr(bpy.ops, group), operator)(*how, **given)


def middle():
    """The middle of the view, as xdotool counts."""
    _, region, _ = regions()
    return region.x + region.width // 3, SIZE[1] - (region.y + region.height // 2)


def until(there, seconds=100.0):
    """Wait for something."""
    started = time.monotonic()
    while not there():
        if time.monotonic() - started > seconds:
            raise AssertionError("it has not come")
        yield 0.02


def look_at_the_road():
    from mathutils import Euler

    area, _, _ = regions()
    view = area.spaces[0].region_3d
    view.view_perspective, view.view_location, view.view_distance = "PERSP", (0.0, 12.0, 0.0), 75.0
    view.view_rotation = Euler((0.95, 0.0, -0.35)).to_quaternion()
    area.spaces[0].clip_end = 2000.0
    area.spaces[0].overlay.show_floor = area.spaces[0].overlay.show_axis_x = area.spaces[0].overlay.show_axis_y = False


def lidar():
    return bpy.data.objects["LiDAR"]


def lidars():
    return [item for item in bpy.data.objects if item.get("blender_lidar_role") == "lidar"]


def cloud():
    return next(child for child in lidar().children if child.name.startswith("Point cloud"))


def points():
    return len(cloud().data.vertices)


def steps():
    bpy.ops.preferences.addon_install(filepath=ZIP, overwrite=True)
    bpy.ops.preferences.addon_enable(module="blender_lidar")
    bpy.data.batch_remove(list(bpy.data.objects))
    area, _, _ = regions()
    area.spaces[0].show_region_ui = True
    yield 1.0
    yield from clicked(*TAB)
    yield 1.0
    photograph("1_before")

    yield from clicked(*LOAD_EXAMPLE)
    yield from until(lambda: "LiDAR" in bpy.data.objects)
    look_at_the_road()
    yield 1.0
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert len([one for one in depsgraph.object_instances if one.is_instance]) > 50
    photograph("2_loaded")

    scrolled(10)
    yield 1.0
    yield from clicked(*SCAN)
    yield from until(lambda: lidar().blender_lidar.scanned_frame >= 0)
    yield 1.0
    TOLD["points"], before = points(), lidar().location.copy()
    photograph("3_scanned")

    # Drag it with the mouse while it is live: the cloud follows; undo brings both back.
    area, region, _ = regions()
    with bpy.context.temp_override(window=window(), area=area, region=region):
        bpy.context.scene.blender_lidar.row = 0
    lidar().select_set(True)
    lidar().blender_lidar.live = True
    yield 1.0
    x, y = middle()
    events("mousemove", x, y)
    yield 0.3
    yield pressed("g")
    yield pressed("x")
    objective = lidar().blender_lidar.objective
    for along in range(0, 160, 20):
        events("mousemove", x + along, y)
        yield 0.15
    photograph("4_dragged")
    events("click", 1)
    yield from until(lambda: lidar().blender_lidar.objective != objective)
    yield 1.0
    TOLD["moved_m"] = round((lidar().location - before).length, 2)
    assert TOLD["moved_m"] > 1.0, TOLD
    yield pressed("ctrl+z")
    yield from until(lambda: (lidar().location - before).length < 1e-5)
    yield from until(lambda: abs(lidar().blender_lidar.objective - objective) < 1e-4)
    lidar().blender_lidar.live = False
    yield from until(lambda: points() == TOLD["points"])

    # Optimise: Escape leaves it alone, Cancel stops it at once and leaves nothing behind; then to its end.
    group = bpy.context.scene.blender_lidar
    group.search.particles, group.search.iterations, group.traffic.frames = 5, 200, 20
    running = list(Path(bpy.app.tempdir).glob("blender_lidar-*"))
    assert called("blender_lidar.optimize", "INVOKE_DEFAULT") == {"RUNNING_MODAL"}
    scrolled(24)
    yield 4.0
    photograph("5_optimising")
    jobs = sys.modules["blender_lidar.addon.optimising"]._jobs
    (job,) = jobs.values()
    assert job.is_alive(), job.problem
    child = job._process
    yield pressed("Escape")
    yield 1.0
    assert jobs, "Escape has stopped it"
    started = time.monotonic()
    assert called("blender_lidar.cancel", "INVOKE_DEFAULT") == {"FINISHED"}
    yield from until(lambda: not jobs)
    TOLD["cancel_s"] = round(time.monotonic() - started, 2)
    assert child.poll() is not None
    assert list(Path(bpy.app.tempdir).glob("blender_lidar-*")) == running
    group.search.iterations, group.traffic.frames = 4, 3
    assert called("blender_lidar.optimize", "INVOKE_DEFAULT") == {"RUNNING_MODAL"}
    yield from until(lambda: not jobs)
    assert lidar().blender_lidar.found
    assert called("blender_lidar.apply", "INVOKE_DEFAULT", True) == {"FINISHED"}
    yield 1.0
    place = tuple(round(value, 3) for value in lidar().location)
    TOLD["found"] = json.loads(lidar().blender_lidar.found)["places"][lidar().name]["deployment"]
    photograph("6_optimised")

    # A second one, saved and opened again.
    lidar().select_set(True)
    called("object.duplicate", "EXEC_DEFAULT", True)
    yield from until(lambda: len(lidars()) == 2 and all(len(item.children) >= 3 for item in lidars()), 10.0)
    path = OUT / "saved.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    yield 2.0
    assert tuple(round(value, 3) for value in lidar().location) == place
    assert called("blender_lidar.scan", "INVOKE_DEFAULT", True) == {"FINISHED"}
    yield 0.5
    photograph("7_opened_again")
    live, handlers = (sys.modules[f"blender_lidar.addon.{name}"] for name in ("live", "handlers"))
    lidar().blender_lidar.live = True
    yield from until(lambda: live._state.drawing is not None)
    bpy.ops.preferences.addon_disable(module="blender_lidar")
    assert live._state.drawing is None
    assert not any(map(bpy.app.timers.is_registered, (live.update, handlers.adopt_all)))
    assert not any(
        hasattr(kind, name) for kind, name in ((bpy.types.Scene, "blender_lidar"), (bpy.types.Object, "blender_lidar"))
    )
    yield 0.5


def tick(running=[]):  # noqa: B006 - the one generator
    if not running:
        running.append(steps())
    try:
        return next(running[0])
    except StopIteration:
        sys.stdout.write(json.dumps(TOLD) + "\n")
        sys.stdout.flush()
        os._exit(0)
    except BaseException:
        traceback.print_exc()
        photograph("failed")
        os._exit(1)


OUT.mkdir(parents=True, exist_ok=True)
bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(tick, first_interval=2.0, persistent=True)
