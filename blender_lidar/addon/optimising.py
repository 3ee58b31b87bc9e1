"""Optimise in the window: the command line's own search in a thread of its own, which touches nothing of Blender.

Casting, scoring and searching know arrays alone, so that the window stays free while they work; a modal operator tells
how far they are, and Escape ends them. The answer is the command line's for the same settings, as it is the same code.
"""

import ctypes
import math
import shutil
import tempfile
import threading
from pathlib import Path

import bpy

from ..commands.optimise import write_pages
from ..errors import BlenderLidarError, InputError
from ..run.folder import RunFolder
from ..run.optimise import optimise_site
from ..run.verdict import POINTS
from ..scene.scenario import Scenario, pose_at
from ..scene.settings import COORDINATES, MOUNTING_OR_LEAN
from ..scene.site import prepare
from ..world.blender.objects import hang
from ..world.blender.site import open_scenery
from ..world.scenery import Scenery
from . import operators, panels, properties, session

_EVERY_S = 0.05  # between two looks at how far it is
_ENDS_WITHIN_S = 2.0


class Optimisation(threading.Thread):
    """One optimisation in a thread.

    Parameters
    ----------
    scenario : Scenario
        What is searched.
    scenery : Scenery
        The user's own objects, which hide vehicles.
    folder : path
        Where the run is written; it is there.

    Attributes
    ----------
    done, total : int
        Mountings scored, and how many there will be.
    best : float or None
        The best objective so far.
    result : dict or None
        The content of result.json, once it has ended well.
    problem : str
        What went wrong, in a line.
    """

    def __init__(self, scenario: Scenario, scenery: Scenery, folder: Path) -> None:
        super().__init__(name="LiDAR optimisation", daemon=True)
        self._scenario, self._scenery, self.folder = scenario, scenery, folder
        use, deployment = scenario.search, scenario.deployment
        self.done, self.best, self.result, self.problem = 0, None, None, ""
        self.total = use.seeds * use.particles * use.iterations
        self.total += math.prod(POINTS) if all(axis in deployment.bounds for axis in deployment.axes) else 0
        self._counted: dict[int, int] = {}

    def run(self) -> None:
        """Search, judge and write; what is wrong is kept to be told."""
        try:
            site = prepare(self._scenario, scenery=self._scenery)
            with RunFolder(self.folder).locked() as folder:
                result = optimise_site(site, folder, self)
                write_pages(site, folder.read_outcome(), lambda note: None)
            self.result = result
        except BlenderLidarError as error:
            self.problem = " ".join(str(error).split())
        except KeyboardInterrupt:
            self.problem = "stopped"

    def searching(self, search) -> None:
        """How far a search is."""
        self._counted[id(search)] = len(search.history)
        self.done, self.best = sum(self._counted.values()), float(search.best_value) if len(search.history) else None

    def mapping(self, points: int) -> None:
        """So many more points of the map are scored."""
        self._counted[0] = self._counted.get(0, 0) + points
        self.done = sum(self._counted.values())

    def stop(self) -> None:
        """End it, whatever it is at, and remove what it has written."""
        if self.is_alive():
            ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(self.ident), ctypes.py_object(KeyboardInterrupt))
        self.join(_ENDS_WITHIN_S)
        shutil.rmtree(self.folder, ignore_errors=True)


_jobs: dict[str, Optimisation] = {}  # by LiDAR


def job_of(lidar: bpy.types.Object) -> Optimisation | None:
    """What is being optimised for a LiDAR."""
    return _jobs.get(session.uid_of(lidar))


def begin(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, lidar: bpy.types.Object) -> Optimisation:
    """Make an optimisation ready, from the panel's fields.

    Raises
    ------
    BlenderLidarError
        For fields that cannot be used, or where no coordinate is searched.
    """
    scenario = session.scenario_from(scene, lidar, searched=True)
    if not scenario.deployment.bounds:
        raise InputError("LiDAR panel: Optimise: every coordinate is fixed; switch at least one on")
    folder = Path(tempfile.mkdtemp(prefix="blender_lidar-", dir=bpy.app.tempdir or None))
    return Optimisation(scenario, open_scenery(scene, layer), folder)


def keep_result(lidar: bpy.types.Object, job: Optimisation) -> None:
    """Keep with a LiDAR what its optimisation has found."""
    group, result = lidar.lidar, job.result
    held = result["holdout"] or {}
    group.found_at = [result["deployment"][key] for key in COORDINATES]
    group.found_before = list(properties.coordinates_of(lidar).values())
    group.found_gain = held.get("gain_over_baseline", 0.0)
    group.found_interval = held.get("interval_90") or (0.0, 0.0)
    group.found_judged, group.found_unit = result["holdout"] is not None, result["metric_unit"]
    group.found_folder, group.found = str(job.folder), True


class LIDAR_OT_optimise(operators.NeedsTraffic, bpy.types.Operator):
    """Search the mounting that sees the vehicles best; Escape stops it"""

    bl_idname, bl_label, bl_options = "lidar.optimise", "Optimise", {"REGISTER"}

    @operators.told
    def execute(self, context):
        """Search in one go, as scripts do."""
        lidar = session.needed_lidar(context.scene)
        job = begin(context.scene, context.view_layer, lidar)
        job.run()
        return self._ended(lidar, job)

    def invoke(self, context, event):
        """Search while the window stays free; in one go in Blender 3.4, which crashed beside the thread."""
        if bpy.app.version < (4, 2, 0):
            return self.execute(context)
        return self._begun(context)

    @operators.told
    def _begun(self, context):
        lidar = session.needed_lidar(context.scene)
        if job_of(lidar) is not None:
            raise InputError(f"{lidar.name}: is being optimised already; Escape stops it")
        self._scene, self._lidar = session.uid_of(context.scene), session.uid_of(lidar)
        self._job = _jobs[self._lidar] = begin(context.scene, context.view_layer, lidar)
        self._timer = context.window_manager.event_timer_add(_EVERY_S, window=context.window)
        context.window_manager.progress_begin(0, 100)
        context.window_manager.modal_handler_add(self)
        self._job.start()
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look how far it is."""
        if event.type == "ESC":
            self._leave(context)
            self._job.stop()
            self.report({"INFO"}, "Optimisation stopped")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        _redraw(context)
        context.window_manager.progress_update(100 * self._job.done // max(self._job.total, 1))
        if self._job.is_alive():
            return {"PASS_THROUGH"}
        self._leave(context)
        lidar = next((item for item in bpy.data.objects if session.uid_of(item) == self._lidar), None)
        if lidar is None:
            self._job.stop()
            self.report({"WARNING"}, "The LiDAR that was optimised is gone")
            return {"CANCELLED"}
        return self._ended(lidar, self._job)

    def cancel(self, context):
        """Blender closes its window or its file."""
        self._leave(context)
        self._job.stop()

    def _leave(self, context):
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        _jobs.pop(self._lidar, None)
        _redraw(context)

    def _ended(self, lidar, job):
        if job.result is None:
            shutil.rmtree(job.folder, ignore_errors=True)
            self.report({"ERROR"}, job.problem)
            return {"CANCELLED"}
        keep_result(lidar, job)
        bpy.ops.ed.undo_push(message="Optimise LiDAR")
        self.report({"INFO"}, found_text(lidar.lidar))
        return {"FINISHED"}


def _redraw(context):
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()


def found_text(group: bpy.types.PropertyGroup) -> str:
    """What an optimisation has found, in a few words."""
    place = dict(zip(COORDINATES, group.found_at, strict=True))
    return f"{place['height_m']:.2f} m, tilt {place['tilt_x_deg']:.1f}°"


def gain_text(group: bpy.types.PropertyGroup) -> str:
    """What it gains on held-out traffic over the baseline."""
    if not group.found_judged:
        return "nothing was held out to judge it by"
    low, high = group.found_interval
    within = f" (90 %: {low:+.3f} to {high:+.3f})" if (low, high) != (0.0, 0.0) else ""
    return f"{group.found_gain:+.3f} {group.found_unit} a vehicle on held-out traffic{within}".replace("  ", " ")


class _NeedsFound:
    @classmethod
    def poll(cls, context):
        """Whether something was found."""
        lidar = session.active_lidar(context.scene)
        if lidar is None or not lidar.lidar.found:
            cls.poll_message_set("Optimise first")
            return False
        return True


class LIDAR_OT_apply(_NeedsFound, bpy.types.Operator):
    """Hang the LiDAR where the optimisation found it best, and scan from there"""

    bl_idname, bl_label, bl_options = "lidar.apply", "Apply", {"REGISTER", "UNDO"}

    def execute(self, context):
        """Move it there."""
        return _moved(self, context, "found_at")


class LIDAR_OT_revert(_NeedsFound, bpy.types.Operator):
    """Hang the LiDAR where it was before it was optimised, and scan from there"""

    bl_idname, bl_label, bl_options = "lidar.revert", "Revert", {"REGISTER", "UNDO"}

    def execute(self, context):
        """Move it back."""
        return _moved(self, context, "found_before")


def _moved(operator, context, to):
    lidar = session.needed_lidar(context.scene)
    place = dict(zip(COORDINATES, (round(value, 4) for value in getattr(lidar.lidar, to)), strict=True))
    hang(lidar, pose_at(place))
    context.view_layer.update()
    return operators.LIDAR_OT_scan.execute(operator, context)


class LIDAR_OT_open_report(_NeedsFound, bpy.types.Operator):
    """Open the page of the last optimisation in the browser"""

    bl_idname, bl_label = "lidar.open_report", "Open Report"

    def execute(self, context):
        """Open it."""
        page = Path(session.needed_lidar(context.scene).lidar.found_folder) / "report.html"
        if not page.is_file():
            self.report({"ERROR"}, f"{page}: is gone; optimise again")
            return {"CANCELLED"}
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


# --- What is to be expected, and the panel ----------------------------------------------------------------------------


def expected_s(scene: bpy.types.Scene, group: bpy.types.PropertyGroup) -> float:
    """How long an optimisation may take [s], from the time of the last scan's cast; 0 where there was none."""
    search = scene.blender_lidar.search
    mountings = search.particles * search.iterations + math.prod(POINTS)
    return group.look_s * mountings * scene.blender_lidar.traffic.frames


@panels.panel("Optimise", panels.LIDAR_PT_main.__name__, bl_order=5)
class LIDAR_PT_optimise(panels.OfTraffic, bpy.types.Panel):
    """What is searched, how far it is, and what was found."""

    def draw_for(self, layout, scene, lidar):
        """A row for each coordinate, the budget, progress and answer."""
        group, shared, job = lidar.lidar, scene.blender_lidar, job_of(lidar)
        column = layout.column(align=True)
        column.enabled = job is None
        for key in MOUNTING_OR_LEAN:
            row = column.row(align=True)
            row.use_property_split = False
            row.prop(group, f"{key}_on", toggle=True)
            if getattr(group, f"{key}_on"):
                row.prop(group, f"{key}_low", text="")
                row.prop(group, f"{key}_high", text="")
        settings = layout.column()
        settings.enabled = job is None
        panels.rows(settings, shared.traffic, "frames", "holdout")
        panels.rows(settings, shared.search, *properties.TABLES["search"])
        if job is not None:
            best = "" if job.best is None else f", best {job.best:.2f}"
            text = f"{job.done} of {job.total} mountings{best}"
            if hasattr(layout, "progress"):  # from 4.0 on
                layout.progress(factor=job.done / max(job.total, 1), text=text)
            else:
                layout.label(text=text)
            layout.label(text="Escape stops it.")
            return
        expected = expected_s(scene, group)
        if expected:
            layout.label(text=f"About {expected:.0f} s" if expected < 120 else f"About {expected / 60:.0f} min")
        layout.operator("lidar.optimise", icon="VIEWZOOM")
        if group.found:
            box = layout.box().column(align=True)
            box.label(text=f"Found: {found_text(group)}")
            box.label(text=gain_text(group))
            row = layout.row(align=True)
            row.operator("lidar.apply", icon="CHECKMARK")
            row.operator("lidar.revert", icon="LOOP_BACK")
            layout.operator("lidar.open_report", icon="URL")


classes = (LIDAR_OT_optimise, LIDAR_OT_apply, LIDAR_OT_revert, LIDAR_OT_open_report, LIDAR_PT_optimise)


def unregister() -> None:
    """Stop what is at work."""
    for job in list(_jobs.values()):
        job.stop()
    _jobs.clear()
