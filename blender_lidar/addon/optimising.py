"""Optimise: the command line's own search in a process of its own, while the window stays free.

That process is a Blender where Blender's tree casts, and else a Python with all workers. A modal operator looks how far
it is, and the button Cancel kills it; keys are left to Blender. The answer is the command line's for the same settings,
as it is the same code.
"""

import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent
from bpy.props import BoolProperty

from ..casting import BVH, resolve
from ..casting.instances import OwnBodies
from ..commands.background import heard
from ..compiled import within_blender
from ..document import ANSWER, document_from
from ..errors import InputError
from ..report.text import short_lines
from ..run.folder import RESULT
from ..run.searches import most_evaluations
from ..scene.mounting import ANGLES, LEANS, PLACE, mounting_from
from ..scene.scenario import Scenario
from ..scene.settings import DECLARED
from ..world.blender.objects import check_free, hang
from ..world.blender.site import open_scenery
from ..world.scenery import Scenery
from . import live, operators, panels, properties, scenarios, session
from .preferences import runs_folder

_EVERY_S = 0.05  # between two looks at how far it is
_LEAST_S, _RECENT_S = 2.0, 20.0  # of progress before a rate is shown, and that it is taken over
_PACKAGE = Path(__file__).resolve().parents[1]
STOPPED = "stopped"
_ORDER, _PRINTED = "order.pickle", "printed.txt"


def started(code: str, *, in_blender: bool, **how: object) -> subprocess.Popen:
    """Start a process that runs code of `commands.background`, in a Blender or in Blender's Python."""
    name = __package__.rpartition(".")[0]
    paths = f"[{str(_place_of(name))!r}, *sys.path, *{sys.path!r}]"  # its own before ours
    code = f"import os, sys; sys.path[:] = {paths}; from {name}.commands.background import main, warm_up; {code}"
    how |= {"stdin": subprocess.PIPE, "creationflags": getattr(subprocess, "CREATE_NO_WINDOW", 0)}
    if in_blender and within_blender():
        options = ["--background", "--factory-startup", "--python-exit-code", "1", "--python-expr", code]
        return subprocess.Popen([bpy.app.binary_path, *options], **how)
    return subprocess.Popen([sys.executable, "-c", code], **how)


def _place_of(name: str) -> Path:
    """A folder from which the package can be imported by its full name, which what Numba has stored knows it by.

    An extension's is within packages that only Blender has; they are made here.
    """
    *parents, _ = name.split(".")
    if not parents:
        return _PACKAGE.parent
    made = folder = Path(bpy.app.tempdir or tempfile.gettempdir()) / f"blender_lidar_names-{os.getpid()}"
    for parent in parents:
        folder = folder / parent
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "__init__.py").write_text(f"__path__.append({str(_PACKAGE.parent)!r})\n", encoding="utf-8")
    return made


class Optimisation:
    """One optimisation in a process of its own; it ends when this one does.

    Parameters
    ----------
    scenario : Scenario
        What is searched.
    scenery : Scenery
        The user's own objects, which hide vehicles.

    Attributes
    ----------
    folder : path
        Where the run is written.
    done, total : int
        Mountings scored, and how many there will be.
    best : float or None
        The best objective so far.
    result : dict or None
        The content of result.json, once it has ended well.
    problem : str
        What went wrong, in a line.
    """

    def __init__(self, scenario: Scenario, scenery: Scenery, bodies: OwnBodies | None = None) -> None:
        self.done, self.total, self.best, self.result, self.problem = 0, 0, None, None, ""
        self._recent: deque[tuple[float, int]] = deque()  # when how many were done
        for space in () if scenario.is_layout else scenario.lidar.deployment.spaces:  # how long a layout takes shows
            self.total += most_evaluations(scenario, space)
        self._root = Path(tempfile.mkdtemp(prefix="blender_lidar-", dir=bpy.app.tempdir or None))
        self._read = 0  # bytes of what it has printed
        self.folder = self._root / "run"
        names = [*DECLARED, *(f"lidar {number}" for number in range(1, len(scenario.lidars) + 1))]
        keys = [(name, key) for name in names for key in ("", "x_m, y_m", *DECLARED[name.split()[0]])]
        labels = {place: scenario.where(*place) for place in keys}
        order = {"scenario": replace(scenario, where=None), "labels": labels, "scenery": scenery, "bodies": bodies}
        (self._root / _ORDER).write_bytes(pickle.dumps(order))
        in_blender = resolve(scenario.model.caster) == BVH or bool(scenario.world.blend or scenario.world.mesh)
        code = f"os._exit(main({str(self._root / _ORDER)!r}, {str(self.folder)!r}))"
        with (self._root / _PRINTED).open("wb") as printed:
            self._process = started(code, in_blender=in_blender, stdout=printed, stderr=subprocess.STDOUT)

    def is_alive(self) -> bool:
        """Look how far it is, and whether it goes on."""
        if self._process is None:
            return False
        code = self._process.poll()
        with (self._root / _PRINTED).open("rb") as stream:
            stream.seek(self._read)
            new = stream.read()
        whole = new[: new.rfind(b"\n") + 1]  # less a line that is being written
        self._read += len(whole)
        for line in whole.decode("utf-8", errors="replace").splitlines():
            self._hear(heard(line))
        if code is None:
            return True
        if code == 0:
            self.result, self.problem = json.loads((self.folder / RESULT).read_text(encoding="utf-8")), ""
            (self._root / _ORDER).unlink()
        else:
            lines = (self._root / _PRINTED).read_text(encoding="utf-8", errors="replace").splitlines()
            errors = [line for line in lines if "Error" in line]
            self.problem = self.problem or " ".join([f"the search ended abruptly ({code})", *errors[-1:]])
        self._close()
        return False

    def _hear(self, values: dict) -> None:
        self.problem = values.get("problem", self.problem)
        if "done" in values:
            self.done, self.best = values["done"], values["best"]
            self._recent.append((time.monotonic(), self.done))
            while self._recent[-1][0] - self._recent[0][0] > _RECENT_S:
                self._recent.popleft()

    @property
    def outlook(self) -> str:
        """How long the search still takes at its present rate, or what is done before and after it, in words."""
        if not self._recent:
            return "Reading traffic and preparing."
        if self.total and self.done >= self.total:
            return "Judging on held-out traffic and writing the report."
        (since, before), (until, now) = self._recent[0], self._recent[-1]
        if not self.total or until - since < _LEAST_S or now == before:
            return ""
        left = (self.total - self.done) * (time.monotonic() - since) / (now - before)
        return f"About {left:.0f} s left" if left < 90 else f"About {left / 60:.0f} min left"

    def keep(self, name: str) -> dict[str, str]:
        """Move the run to where runs are kept, if it can; returns where it is and what it is called."""
        stem, runs = bpy.path.clean_name(name), runs_folder()
        called = f"{stem}_{self._root.name[-8:]}"  # until the file is saved
        if runs is not None:
            called = next(f"{stem}_{n}" for n in range(1, 10_000) if not (runs / f"{stem}_{n}").exists())
        self.folder = kept_run(self.folder, called)
        return {"folder": str(self.folder), "run": called}

    def wait(self) -> None:
        """Wait until it ends."""
        self._process.wait()
        self.is_alive()

    def stop(self) -> None:
        """Stop the search at any moment and remove what it has written."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._close()
            self.problem = STOPPED
        shutil.rmtree(self._root, ignore_errors=True)

    def _close(self):
        self._process.stdin.close()
        self._process = None


def kept_run(folder: Path, called: str) -> Path:
    """Move a run from the session's folder to where the open file's runs are kept; where it lies then."""
    runs, session_s = runs_folder(), Path(bpy.app.tempdir or tempfile.gettempdir()).resolve()
    if runs is None or session_s not in folder.resolve().parents or not folder.is_dir():
        return folder
    with suppress(OSError):  # such as a folder that is read-only: it stays in the session's
        runs.mkdir(parents=True, exist_ok=True)
        moved = Path(shutil.move(folder, runs / called))
        shutil.rmtree(folder.parent, ignore_errors=True)
        return moved
    return folder


@persistent
@properties.guarded
def on_save(*_) -> None:
    """Move the runs of a file that is saved for the first time beside it."""
    for lidar in bpy.data.objects if bpy.data.filepath else ():
        if lidar.blender_lidar.found:
            found = found_of(lidar)
            kept_run(Path(found["folder"]), found["run"])


def run_of(lidar: bpy.types.Object) -> Path:
    """The folder of a LiDAR's last optimization: beside the file, also where both were moved, or where it was written.

    What a file says of it may be older than the file's first saving, or be of another computer.
    """
    found, runs = found_of(lidar), runs_folder()
    beside = runs / found["run"] if runs is not None else None
    return beside if beside is not None and beside.is_dir() else Path(found["folder"])


app_handlers = {"save_post": on_save}
_jobs: dict[str, Optimisation] = {}  # by LiDAR
_warming: list[subprocess.Popen] = []


def job_of(lidar: bpy.types.Object) -> Optimisation | None:
    """What is being optimised for a LiDAR."""
    return _jobs.get(scenarios.uid_of(lidar))


def begin(scene, layer: bpy.types.ViewLayer, lidar: bpy.types.Object, *, alone: bool = False) -> Optimisation:
    """Start an optimisation of a LiDAR's layout, or of it `alone` beside the others, from the panel's fields.

    Raises
    ------
    BlenderLidarError
        For fields that cannot be used, or where no coordinate is searched.
    """
    hung = scenarios.layout_of(scene, lidar)
    held = [one for one in hung if alone and one != lidar]
    session.check_traffic_is_shown(scene)
    scenario = scenarios.layout_scenario(scene, hung, here=False, held=held)
    searched = [all(space.variables for space in one.deployment.spaces) for one in scenario.lidars]
    if all(one.is_held for one in scenario.lidars) if scenario.is_layout else not all(searched):
        raise InputError("LiDAR panel: Optimize: every coordinate is fixed; switch at least one on")
    return Optimisation(scenario, open_scenery(scene, layer), session.own_bodies(scene, again=True))


def keep_result(hung: Sequence[bpy.types.Object], job: Optimisation) -> None:
    """Keep with each LiDAR of a layout what its optimisation has found."""
    told = document_from(job.result["document"])
    answer = told.of(ANSWER)[0].text
    found = {"holdout": job.result["holdout"], "lines": short_lines(told), "answer": answer, "places": {}}
    found |= job.keep(hung[0].name if len(hung) == 1 else "layout")
    for one, row in zip(hung, job.result["lidars"], strict=True):
        before = properties.mounting_of(one).as_table()
        found["places"][one.name_full] = {"deployment": row["deployment"], "before": before}
    for one in hung:
        one.blender_lidar.found = json.dumps(found)


def found_of(lidar: bpy.types.Object) -> dict[str, Any]:
    """What an optimisation has found, as result.json has it, where the LiDAR hung before, and the run's folder."""
    return json.loads(lidar.blender_lidar.found)


class BLENDER_LIDAR_OT_optimize(operators.NeedsLidar, bpy.types.Operator):
    """Search the mounting that sees the vehicles best"""

    bl_idname, bl_label, bl_options = "blender_lidar.optimize", "Optimize", {"REGISTER"}
    of_traffic = True
    alone: BoolProperty(description="Search this LiDAR, the others of the layout held as they hang")

    @operators.one_line_errors
    def execute(self, context):
        """Search and wait for the end, as scripts do."""
        lidar = scenarios.active_lidar(context.scene)
        job = begin(context.scene, context.view_layer, lidar, alone=self.alone)
        try:
            job.wait()
        except KeyboardInterrupt:
            job.stop()
        return self._ended(scenarios.layout_of(context.scene, lidar), job)

    def invoke(self, context, event):
        """Search while the window stays free."""
        return self._begun(context)

    @operators.one_line_errors
    def _begun(self, context):
        lidar = scenarios.active_lidar(context.scene)
        hung = scenarios.layout_of(context.scene, lidar)
        if busy := next((one for one in hung if job_of(one) is not None), None):
            raise InputError(f"{busy.name}: is being optimized already; Cancel stops it")
        self._job = begin(context.scene, context.view_layer, lidar, alone=self.alone)
        self._hung = [scenarios.uid_of(one) for one in hung]
        _jobs.update(dict.fromkeys(self._hung, self._job))
        self._timer = context.window_manager.event_timer_add(_EVERY_S, window=context.window)
        context.window_manager.progress_begin(0, 100)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look how far it is."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        before, alive = self._job.done, self._job.is_alive()
        if alive and self._job.done != before:
            live.redraw()
            context.window_manager.progress_update(100 * self._job.done // max(self._job.total, self._job.done))
        if alive:
            return {"PASS_THROUGH"}
        self._leave(context)
        if self._job.problem == STOPPED:
            self.report({"INFO"}, "Optimization canceled")
            return {"CANCELLED"}
        there = {scenarios.uid_of(item): item for item in bpy.data.objects}
        if not there.keys() >= set(self._hung):
            self._job.stop()
            self.report({"WARNING"}, "The LiDAR that was optimized is gone")
            return {"CANCELLED"}
        return self._ended([there[uid] for uid in self._hung], self._job)

    def cancel(self, context):
        """Blender closes its window or its file."""
        self._leave(context)
        self._job.stop()

    def _leave(self, context):
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        for uid in self._hung:
            _jobs.pop(uid, None)
        live.redraw()

    def _ended(self, hung, job):
        if job.result is None:
            job.stop()
            self.report({"ERROR"}, job.problem)
            return {"CANCELLED"}
        keep_result(hung, job)
        bpy.ops.ed.undo_push(message="Optimize LiDAR")
        kept = "beside this file once it is saved" if runs_folder() is None else f"in {job.folder}"
        self.report({"INFO"}, f"{found_of(hung[0])['answer']}; its report is kept {kept}")
        return {"FINISHED"}


class BLENDER_LIDAR_OT_cancel(bpy.types.Operator):
    """Stop the search and leave nothing of it behind"""

    bl_idname, bl_label = "blender_lidar.cancel", "Cancel"

    @classmethod
    def poll(cls, context):
        """Whether the active LiDAR is being optimized."""
        lidar = scenarios.active_lidar(context.scene)
        return lidar is not None and job_of(lidar) is not None

    def execute(self, context):
        """Stop it; who looks how far it is finds it so."""
        job_of(scenarios.active_lidar(context.scene)).stop()
        return {"FINISHED"}


def found_lines(lidar: bpy.types.Object) -> list[str]:
    """What an optimisation has found, in short lines."""
    return found_of(lidar)["lines"]


class _NeedsFound:
    @classmethod
    def poll(cls, context):
        """Whether something was found."""
        lidar = scenarios.active_lidar(context.scene)
        if lidar is None or not lidar.blender_lidar.found:
            cls.poll_message_set("Optimize first")
            return False
        return True


class _Hangs(_NeedsFound):
    @operators.one_line_errors
    def execute(self, context):
        """Hang it, and those that were optimised with it, and scan."""
        lidar, there = scenarios.active_lidar(context.scene), scenarios.lidars_of(context.scene)
        there = {one.name_full: one for one in there}
        places = found_of(lidar).get("places") or {lidar.name: found_of(lidar)}
        hung = [lidar] if len(places) == 1 else [there.get(name) for name in places]
        if None in hung:
            raise InputError(f"LiDAR {[*places][hung.index(None)]} of the layout is gone or renamed; optimize again")
        for one in hung:
            check_free(one)
        for one, of in zip(hung, places.values(), strict=True):
            hang(one, mounting_from(of[self.place_key], properties.road_of(context.scene)).pose)
        context.view_layer.update()
        return operators.BLENDER_LIDAR_OT_scan.execute(self, context)


class BLENDER_LIDAR_OT_apply(_Hangs, bpy.types.Operator):
    """Hang the LiDAR where the optimization found it best, and scan from there"""

    bl_idname, bl_label, bl_options = "blender_lidar.apply", "Apply", {"REGISTER", "UNDO"}
    place_key = "deployment"


class BLENDER_LIDAR_OT_revert(_Hangs, bpy.types.Operator):
    """Hang the LiDAR where it was before it was optimized, and scan from there"""

    bl_idname, bl_label, bl_options = "blender_lidar.revert", "Revert", {"REGISTER", "UNDO"}
    place_key = "before"


class BLENDER_LIDAR_OT_open_report(_NeedsFound, bpy.types.Operator):
    """Open the page of the last optimization in the browser"""

    bl_idname, bl_label = "blender_lidar.open_report", "Open Report"

    def execute(self, context):
        """Open it."""
        page = run_of(scenarios.active_lidar(context.scene)) / "report.html"
        if not page.is_file():
            self.report({"ERROR"}, f"{page}: is gone; optimize again")
            return {"CANCELLED"}
        bpy.ops.wm.url_open(url=page.as_uri())
        return {"FINISHED"}


# --- The panel --------------------------------------------------------------------------------------------------------


def _draw_bounds(layout, lidar, keys):
    """A row for each coordinate that may be searched; those of the other way to say a rotation are grey, with why."""
    group, column = lidar.blender_lidar, layout.column(align=True)
    rivals = [key for pair in (ANGLES, LEANS) if not set(pair) & set(keys) for key in pair]
    rival = next((key for key in rivals if getattr(group, f"{key}_on")), None)
    column.enabled = job_of(lidar) is None
    for key in keys:
        row = column.row(align=True)
        row.enabled = rival is None or key in PLACE or getattr(group, f"{key}_on")
        row.use_property_split = False
        panels.field(row, group, f"{key}_on", toggle=True)
        if getattr(group, f"{key}_on"):
            row.prop(group, f"{key}_low", text="", translate=False)
            row.prop(group, f"{key}_high", text="", translate=False)
    if rival:
        panels.say(layout, f"Either tilt and yaw or lean and spin: {properties.label_of(rival)} is on.", icon="INFO")


@panels.panel("Optimize", panels.BLENDER_LIDAR_PT_main.__name__, bl_order=5)
class BLENDER_LIDAR_PT_optimize(panels.OfLidar, bpy.types.Panel):
    """What is searched, how far it is, and what was found."""

    of_traffic = True

    def draw_for(self, layout, scene, lidar):
        """A row for each coordinate, the budget, progress and answer."""
        group, job = lidar.blender_lidar, job_of(lidar)
        _draw_bounds(layout, lidar, properties.SIX)
        if job is not None:
            total = max(job.done, job.total, 1)  # a last climb may come on top
            text = f"{job.done} of {total} mountings" if job.total else f"{job.done} layouts"
            if job.total and hasattr(layout, "progress"):  # from 4.0 on
                layout.progress(factor=job.done / total, text=text, translate=False)
            else:
                panels.say(layout, text)
            panels.say(layout, job.outlook if job.best is None else f"Best so far {job.best:.2f}. {job.outlook}")
            layout.operator("blender_lidar.cancel", icon="X", translate=False)
            return
        together = len(scenarios.layout_of(scene, lidar)) > 1
        for alone in (False, True) if together else (False,):
            text = f"Optimize {lidar.name if alone else 'Layout'}" if together else "Optimize"
            layout.operator("blender_lidar.optimize", text=text, icon="VIEWZOOM", translate=False).alone = alone
        if group.found:
            box = layout.box().column(align=True)
            panels.say(box, "Found:")
            for line in found_lines(lidar):
                panels.say(box, line)
            row = layout.row(align=True)
            row.operator("blender_lidar.apply", icon="CHECKMARK", translate=False)
            row.operator("blender_lidar.revert", icon="LOOP_BACK", translate=False)
            layout.operator("blender_lidar.open_report", icon="URL", translate=False)


@panels.panel("Lean and Spin", BLENDER_LIDAR_PT_optimize.__name__, bl_options={"DEFAULT_CLOSED"})
class BLENDER_LIDAR_PT_lean(panels.OfLidar, bpy.types.Panel):
    """The other way to say and to search a rotation."""

    of_traffic = True

    def draw_for(self, layout, scene, lidar):
        """A row for each."""
        _draw_bounds(layout, lidar, LEANS)


@panels.panel("Search Budget", BLENDER_LIDAR_PT_optimize.__name__, bl_options={"DEFAULT_CLOSED"})
class BLENDER_LIDAR_PT_budget(panels.OfLidar, bpy.types.Panel):
    """How much is searched, and on what poles."""

    of_traffic = True

    def draw_for(self, layout, scene, lidar):
        """Instants, particles, iterations, seed and poles."""
        layout.enabled = job_of(lidar) is None
        panels.field(layout, lidar.blender_lidar, "poles")
        if scene.blender_lidar.clip:
            panels.say(layout, f"Searched: {session.CLIP[0]}")
        panels.rows(layout, scene.blender_lidar.traffic, "frames", "holdout")
        panels.rows(layout, scene.blender_lidar.search, *properties.TABLES["search"])


classes = (
    BLENDER_LIDAR_OT_optimize,
    BLENDER_LIDAR_OT_cancel,
    BLENDER_LIDAR_OT_apply,
    BLENDER_LIDAR_OT_revert,
    BLENDER_LIDAR_OT_open_report,
    BLENDER_LIDAR_PT_optimize,
    BLENDER_LIDAR_PT_lean,
    BLENDER_LIDAR_PT_budget,
)


def register() -> None:
    """Have Numba compile in a process of its own, where it is installed, so that no first scan waits for it."""
    if not bpy.app.background and find_spec("numba"):
        _warming.append(started("warm_up()", in_blender=False, stderr=subprocess.DEVNULL))


def unregister() -> None:
    """Stop what is at work."""
    for job in list(_jobs.values()):
        job.stop()
    _jobs.clear()
    while _warming:
        with _warming.pop() as process:
            process.kill()
