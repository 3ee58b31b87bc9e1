"""Bake: frames of the timeline scanned into files beside the .blend, and shown as an animated point cloud.

Each file says in its header what it was made of, so that a bake goes on where it was cancelled. A handler writes the
file of the current frame into the LiDAR's cloud, also for renders.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..clouds.files import record_of, write_cloud
from ..clouds.snapshot import MountedSensor, entropy_of_vehicles, vertices_of
from ..errors import BlenderLidarError, InputError, one_line
from ..files import make_folder, source_digest
from ..scene.site import lattice_of
from ..sensors.pose import Pose
from ..world.blender.points import cloud_of, show_cloud
from ..world.scenery import NO_LABEL
from . import live, operators, panels, properties, scenarios, session

_EVERY_S = 0.01  # between two clouds, in which Blender redraws
_OF_CLOUDS = ("sensor", "world", "road", "model", "objective")  # tables of a scene that its clouds depend on
_MADE_OF, _SETTINGS, _POINTS, _BITS = "made_of", "settings", "points", "entropy_bits"  # in headers

_work: dict[str, int] = {}  # of the bake at work: clouds `done` and in `total`; empty when there is none
_shown: dict[str, dict] = {}  # by LiDAR: the header of the file that its cloud shows


def folder_of(lidar: bpy.types.Object) -> Path:
    """The folder of a LiDAR's bake: by its name, beside the file that is open."""
    beside = f"//{Path(bpy.data.filepath).stem}_bake"
    return Path(bpy.path.abspath(f"{beside}/{bpy.path.clean_name(lidar.name_full)}"))


def files_of(lidar: bpy.types.Object) -> dict[int, Path]:
    """The files of a LiDAR's bake, by frame."""
    paths = folder_of(lidar).glob("frame_*.p*") if bpy.data.filepath else ()
    return {int(path.stem[6:]): path for path in paths if path.stem[6:].lstrip("-").isdigit()}


def steps(scene: bpy.types.Scene) -> Iterator[str]:
    """Bake the LiDARs of a scene over the frames that it plays, by its frame step; yields a line for each cloud.

    A first line says how many there are. LiDARs that renders hide are left out.

    At the end, however it comes, the scene is at the frame that it was at.

    Raises
    ------
    BlenderLidarError
        For a file that was never saved, no LiDAR, no frame, and where Scan refuses, with the frame.
    """
    before, uid = scene.frame_current_final, scenarios.uid_of(scene)
    hung = [one for one in scenarios.lidars_of(scene) if not one.hide_render]
    preview = "preview_" if scene.use_preview_range else ""
    first, last = (getattr(scene, f"frame_{preview}{end}") for end in ("start", "end"))
    frames, folders = range(first, last + 1, scene.frame_step), {str(folder_of(one)).casefold() for one in hung}
    if _work or not bpy.data.filepath:
        raise InputError("a bake is at work" if _work else "the bake lies beside the .blend file; save it first")
    if len(folders) < max(len(hung), 1):
        names = ", ".join(one.name for one in hung)
        raise InputError(f"Bake: LiDARs {names}; allowed: some, of names that make folders")
    if scene.library is None:
        scene.render.use_lock_interface = True  # a window that draws while a render changes meshes may crash
    keys, at = [(frame, scenarios.uid_of(one)) for frame in frames for one in hung], None
    _work.update(done=0, total=len(keys))
    try:
        yield f"{len(keys)} clouds"
        for frame, key in keys:
            scene = _known(uid)
            found = (
                [one for one in scenarios.lidars_of(scene) if scenarios.uid_of(one) == key] if scene is not None else []
            )
            again = bool(found) and (frame != at or frame != scene.frame_current_final)  # a window may play meanwhile
            if again:
                scene.frame_set(at := frame)
            try:
                made = [_bake(scene, one, again) for one in found]  # none where it was deleted meanwhile
            except BlenderLidarError as error:
                raise InputError(f"{found[0].name}, frame {frame}: {one_line(str(error))}") from error
            _work["done"] += 1
            yield f"frame {frame}" if any(made) else f"frame {frame} as it was"
    finally:
        _work.clear()
        if scene := _known(uid):  # undo may have made it anew
            scene.frame_set(int(before // 1), subframe=before % 1)


def _known(uid: str) -> bpy.types.Scene | None:
    """The scene of a `session_uid`; None where it was deleted."""
    return next((one for one in bpy.data.scenes if scenarios.uid_of(one) == uid), None)


def _bake(scene, lidar, again) -> bool:
    """Scan the frame that a scene is at, as Scan does, into its file; False where that was made of the same already.

    Own bodies are read `again` for the first LiDAR of a frame.
    """
    scenario, mounting, vehicles = operators.checked_mount(scene, lidar)
    objects, tables = session.exact_objects(scene, scenarios.view_layer_of(scene), scenario), scenario.as_tables()
    layout = scenarios.layout_of(scene, lidar) if scenario.world.clutter else [lidar]  # which is kept clear of all
    settings = session.settings_digest(lidar)
    of = [source_digest(), settings, *map(tables.get, _OF_CLOUDS), scenario.lidar.name]
    of += map(properties.mounting_of, layout)
    of += map(session.stamp, scenario.files.values())
    for one in (objects[0].scenery,) if objects else ():
        of += [one.digest, one.labels, hashlib.sha256(np.ascontiguousarray(one.label)).digest()]
    if bodies := session.own_bodies(scene, again=again):
        of += [bodies.digests]
    of += [np.asarray(getattr(vehicles, one.name)).tolist() for one in fields(vehicles)]
    digest = hashlib.sha256(repr(of).encode()).hexdigest()
    path = folder_of(lidar) / f"frame_{scene.frame_current:04d}{scene.blender_lidar.bake_format}"
    if _read(path)[1].get(_MADE_OF) == digest:
        return False
    frame = session.live_frame(scene, lidar, exact=True, bodies=bodies)
    cloud, caster = frame.look(mounting.pose, objects).cloud, frame.observation.caster
    bits = entropy_of_vehicles(cloud, vehicles, scenario.objective)
    sensor = MountedSensor(scenario, mounting, lattice_of(scenario.lidar.sensor), caster, next(iter(objects), None))
    made_of = {_MADE_OF: digest, _SETTINGS: settings, _POINTS: len(cloud)}
    seen = np.intersect1d(cloud.vehicle_id, vehicles.vehicle_id, return_indices=True)
    header = sensor.cloud_header(vehicles) | made_of
    header[_BITS] = [-1, *seen[0].tolist()], [0.0, *bits[seen[2]].round(4).tolist()]
    make_folder(path.parent, "bake")
    write_cloud(path, cloud, header)
    for other in {".ply", ".pcd"} - {path.suffix}:
        path.with_suffix(other).unlink(missing_ok=True)
    show_cloud(lidar, vertices_of(cloud, vehicles, bits), lidar.blender_lidar.colour_by, lidar.blender_lidar.style)
    return True


def _read(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """Points of a file of a bake, as `vertices_of` has them, and its header; none of another's, or of one cut off."""
    record, header = np.zeros(0, record_of({})), {}
    with suppress(OSError, ValueError, KeyError):
        head, _, body = path.read_bytes().partition(b"\nend_header\n" if path.suffix == ".ply" else b"\nDATA binary\n")
        told = json.loads(head[head.index(b"{") :].splitlines()[0])
        if len(body) == told[_POINTS] * record_of(told).itemsize:
            record, header = np.frombuffer(body, record_of(told)), told
    points = {"lidar": np.zeros(len(record), np.int32), "label": np.full(len(record), NO_LABEL, np.int32)}
    points |= {name: record[name] for name in record.dtype.names if name not in ("x", "y", "z", "class", "surface")}
    points |= {"xyz": np.stack([record[axis] for axis in "xyz"], axis=1), "vehicle": points.pop("vehicle_id")}
    points["entropy"] = np.interp(points["vehicle"], *header.get(_BITS, ([-1], [0.0])))
    away = points["xyz"] - np.float32(Pose.from_table(header["pose"]).position if header else 0.0)
    return points | {"range": np.sqrt(np.einsum("ij,ij->i", away, away))}, header


@persistent
@properties.guarded
def on_frame(scene, depsgraph=None, *_) -> None:
    """Let each LiDAR that was baked and is not live show the file of the frame that the scene has gone to, if any."""
    rendering = depsgraph is not None and depsgraph.mode == "RENDER"  # when no object may be made
    for lidar in [] if _work or not bpy.data.filepath else scenarios.lidars_of(scene):
        folder = folder_of(lidar)
        if lidar.blender_lidar.live or not folder.is_dir() or (rendering and cloud_of(lidar) is None):
            continue
        name = f"frame_{scene.frame_current:04d}"
        points, _shown[scenarios.uid_of(lidar)] = _read(next(folder.glob(f"{name}.p*"), folder / name))
        show_cloud(lidar, points, lidar.blender_lidar.colour_by, lidar.blender_lidar.style, depsgraph)


def is_changed(lidar: bpy.types.Object) -> bool:
    """Whether a LiDAR hangs elsewhere than in the bake of the frame that is shown, or was baked with other settings."""
    header = _shown.get(scenarios.uid_of(lidar))
    return bool(header) and panels.is_other(lidar, header["pose"].values(), header.get(_SETTINGS))


class BLENDER_LIDAR_OT_bake(operators.NeedsLidar, bpy.types.Operator):
    """Scan every LiDAR on each frame of a range, into files beside the .blend that play and render; again: cancel"""

    bl_idname, bl_label, bl_options = "blender_lidar.bake", "Bake", {"REGISTER"}

    @operators.one_line_errors
    def execute(self, context):
        """Bake all at once, as scripts do."""
        self.report({"INFO"}, f"{sum(1 for _ in steps(context.scene)) - 1} clouds are baked")
        return {"FINISHED"}

    def invoke(self, context, event):
        """Bake while the window stays free, or cancel that."""
        return self._begun(context)

    @operators.one_line_errors
    def _begun(self, context):
        if _work:
            _work["stopped"] = True
            return {"FINISHED"}
        self._steps = steps(context.scene)
        next(self._steps)
        self._timer = context.window_manager.event_timer_add(_EVERY_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Make the next cloud."""
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        live.redraw()
        try:
            if "stopped" not in _work and next(self._steps, None) is not None:
                return {"PASS_THROUGH"}
        except Exception as error:  # the timer would go on
            self.report({"ERROR"}, one_line(str(error)))
        self.cancel(context)
        bpy.ops.ed.undo_push(message="Bake LiDARs")
        return {"FINISHED"}

    def cancel(self, context):
        """End it; Blender calls it where it closes the window or the file."""
        context.window_manager.event_timer_remove(self._timer)
        self._steps.close()


class BLENDER_LIDAR_OT_free_bake(bpy.types.Operator):
    """Delete the baked files of every LiDAR of the scene"""

    bl_idname, bl_label, bl_options = "blender_lidar.free_bake", "Delete Bake", {"REGISTER"}

    def invoke(self, context, event):
        """Ask first."""
        return context.window_manager.invoke_confirm(self, event)

    def execute(self, context):
        """Delete what Bake has written, and folders that hold nothing else."""
        for lidar in scenarios.lidars_of(context.scene):
            for path in files_of(lidar).values():
                if _MADE_OF in _read(path)[1]:
                    path.unlink()
            for place in (folder_of(lidar), folder_of(lidar).parent):
                with suppress(OSError):
                    place.rmdir()
            _shown.pop(scenarios.uid_of(lidar), None)
        return {"FINISHED"}


@panels.panel("Bake", panels.BLENDER_LIDAR_PT_main.__name__, bl_options={"DEFAULT_CLOSED"}, bl_order=8)
class BLENDER_LIDAR_PT_bake(panels.OfLidar, bpy.types.Panel):
    """Which frames are baked, how far that is, and what there is."""

    def draw_for(self, layout, scene, lidar):
        """Range, format, buttons, and what is baked."""
        if _work:
            panels.say(layout, f"{_work['done']} of {_work['total']} clouds")
            layout.operator("blender_lidar.bake", text="Cancel", icon="X", translate=False)
            return
        frames = files_of(lidar)
        panels.rows(layout, scene.blender_lidar, "bake_format")
        layout.operator("blender_lidar.bake", icon="RENDER_ANIMATION", translate=False)
        if frames:
            panels.say(layout, f"Baked frames {min(frames)} to {max(frames)}", icon="FILE_TICK")
            layout.operator("blender_lidar.free_bake", icon="TRASH", translate=False)
            if is_changed(lidar):
                panels.say(layout, "Changed since: bake again.", icon="ERROR")


classes = (BLENDER_LIDAR_OT_bake, BLENDER_LIDAR_OT_free_bake, BLENDER_LIDAR_PT_bake)
app_handlers = {"frame_change_post": on_frame, "load_post": persistent(lambda *_: [*map(on_frame, bpy.data.scenes)])}
