"""The panels of the sidebar's tab LiDAR."""

import json
import math
import textwrap
from collections.abc import Iterable
from pathlib import Path

import bpy

from ..errors import BlenderLidarError
from ..scene.mounting import COORDINATES
from ..traffic.vehicles import SAME_S
from ..world.blender.objects import CLOUD, pose_of, role
from ..world.blender.road import hidden_ground
from . import operators, properties, scenarios, session

_TAB = {"bl_space_type": "VIEW_3D", "bl_region_type": "UI", "bl_category": "LiDAR"}
_LETTER, _FRAME, _ICON = 6.4, 38.0, 24.0  # widths of a letter, of margins, and of an icon [pixels at scale 1]


def panel(name: str, parent: str | None = None, **more: object):
    """What makes a class a panel of the sidebar's tab."""

    def made(cls):
        for key, value in (_TAB | {"bl_idname": cls.__name__, "bl_label": name} | more).items():
            setattr(cls, key, value)
        if parent is not None:
            cls.bl_parent_id = parent
        return cls

    return made


def say(layout: bpy.types.UILayout, text: str, icon: str = "NONE") -> None:
    """A label that wraps at the width of its region; the icon stands before its first line."""
    region = bpy.context.region
    width = region.width / bpy.context.preferences.system.ui_scale if region is not None else 10_000
    column = layout.column(align=True)
    width -= _FRAME + (_ICON if icon != "NONE" else 0.0)
    for line in textwrap.wrap(text, max(16, int(width / _LETTER))) or [""]:
        column.label(text=line, icon=icon, translate=False)
        icon = "NONE" if icon == "NONE" else "BLANK1"


def field(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup, key: str, **more: object) -> None:
    """A property with its name, which Blender would translate were it not given as a text."""
    layout.prop(group, key, text=group.bl_rna.properties[key].name, translate=False, **more)


def rows(layout: bpy.types.UILayout, group: bpy.types.PropertyGroup, *keys: str) -> None:
    """A row for each property."""
    column = layout.column()
    for key in keys:
        field(column, group, key)


@panel("LiDAR")
class BLENDER_LIDAR_PT_main(bpy.types.Panel):
    """The tab."""

    def draw(self, context):
        """Say what is wrong, and what to do first where nothing is loaded."""
        if context.scene.blender_lidar.problem:
            say(self.layout.box(), context.scene.blender_lidar.problem, icon="ERROR")
        for path in scenarios.untrusted(context.scene):
            say(self.layout, f"This scene names {path}, Python code that has not been run.", icon="FILE_SCRIPT")
            run = self.layout.operator("blender_lidar.run_file", text=f"Run {path.name}", translate=False)
            run.filepath = str(path)
        if scenarios.active_lidar(context.scene) is None:
            self.layout.operator("blender_lidar.add", text="Add LiDAR", icon="ADD", translate=False)
        if not context.scene.blender_lidar.loaded:
            say(self.layout, "Load traffic to score and optimize.", icon="INFO")
            self.layout.operator("blender_lidar.load_example", icon="IMPORT", translate=False)


@panel("Traffic", BLENDER_LIDAR_PT_main.__name__)
class BLENDER_LIDAR_PT_traffic(bpy.types.Panel):
    """Which traffic, which of its frames, on what road."""

    def draw(self, context):
        """File, frame, road and detail."""
        layout, group = self.layout, context.scene.blender_lidar
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(group.traffic, "path", text="File", translate=False)
        row = layout.row(align=True)
        row.operator("blender_lidar.load", text="Load", icon="FILE_REFRESH", translate=False)
        if group.loaded:  # else the tab's first line offers it
            row.operator("blender_lidar.load_example", text="Example", icon="IMPORT", translate=False)
            row = layout.row(align=True)
            row.operator("blender_lidar.step_frame", text="", icon="TRIA_LEFT", translate=False).back = True
            field(row, group, "frame")
            row.operator("blender_lidar.step_frame", text="", icon="TRIA_RIGHT", translate=False)
            say(layout, session.time_text(context.scene))
            field(layout, group, "starts_s")
            name = session.CLIP[1] if group.clip else Path(group.traffic.path).name
            say(layout, f"Vehicles and road come from {name}; they cannot be moved, only left out.", icon="LOCKED")
            field(layout, group.traffic, "leave_out")
            if group.clip:
                say(layout, f"Optimize searches {session.CLIP[0]}, of the same simulation.")
        layout.prop(group.world, "detail", text="Vehicles", translate=False)
        if scenarios.has_road(context.scene):
            field(layout, group.world, "ground")
        hidden = ", ".join(hidden_ground(context.scene, context.view_layer))
        if hidden:
            say(layout, f"Not scanned, as it is hidden or deleted: {hidden}")


@panel("Road and File", BLENDER_LIDAR_PT_traffic.__name__, bl_options={"DEFAULT_CLOSED"})
class BLENDER_LIDAR_PT_road(bpy.types.Panel):
    """Where the road lies in the file."""

    def draw(self, context):
        """Road, region and format."""
        layout, group = self.layout, context.scene.blender_lidar
        layout.use_property_split, layout.use_property_decorate = True, False
        rows(layout, group.road, *properties.TABLES["road"])
        rows(layout, group.traffic, "format", "period", "origin_m", "heading_deg", "time_step_s")
        field(layout, group.world, "variety")
        lines = scenarios.without_field(context.scene, scenarios.active_lidar(context.scene))
        region = properties.kept_of(group).tables.get("region", {})
        if not (region.get("polygon_m") or region.get("stretches")):
            say(layout, "Vehicles count within")
            rows(layout, group.region, "centre_m", "with_gate", *([] if group.region.with_gate else ["radius_m"]))
        if lines:
            say(layout, f"Kept from {Path(group.source).name}:", icon="FILE_TEXT")
        for line in lines:
            say(layout, line)


class OfLidar(operators.NeedsLidar):
    """A panel about the active LiDAR."""

    def draw(self, context):
        """What the panel has for the active LiDAR."""
        self.layout.use_property_split, self.layout.use_property_decorate = True, False
        self.draw_for(self.layout, context.scene, scenarios.active_lidar(context.scene))


class BLENDER_LIDAR_UL_lidars(bpy.types.UIList):
    """The LiDARs of a scene: name, in layout, live."""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property):
        """A row of one."""
        if item.lidar is not None:
            row, group = layout.row(align=True), item.lidar.blender_lidar
            row.prop(item.lidar, "name", text="", emboss=False, icon="LIGHT_SUN", translate=False)
            row.prop(group, "in_layout", text="", icon="LINKED" if group.in_layout else "UNLINKED", translate=False)
            row.prop(group, "live", text="", icon="PLAY", translate=False)


@panel("Sensor", BLENDER_LIDAR_PT_main.__name__)
class BLENDER_LIDAR_PT_sensor(OfLidar, bpy.types.Panel):
    """The LiDARs of the scene, and how the active one hangs."""

    def draw_for(self, layout, scene, lidar):
        """A list, and pose of the active one."""
        shared = scene.blender_lidar
        layout.template_list("BLENDER_LIDAR_UL_lidars", "", shared, "lidars", shared, "row", rows=2)
        layout.operator("blender_lidar.add", text="Add LiDAR", icon="ADD", translate=False)
        field(layout, lidar.blender_lidar, "name_")
        if lidar.blender_lidar.name_ == properties.OWN:
            field(layout, lidar.blender_lidar, "table_path")
        rows(layout, lidar.blender_lidar, "rotation_hz", "range_gate_m")
        row = layout.row(align=True)
        row.menu("BLENDER_LIDAR_MT_presets", text=bpy.types.BLENDER_LIDAR_MT_presets.bl_label, translate=False)
        row.operator("blender_lidar.add_preset", text="", icon="ADD", translate=False)
        row.operator("blender_lidar.add_preset", text="", icon="REMOVE", translate=False).remove_active = True
        try:
            place = properties.mounting_of(lidar).as_table()
        except BlenderLidarError as error:
            say(layout, str(error), icon="ERROR")
            return
        rows(layout, lidar.blender_lidar, *COORDINATES)
        way = "" if place["lean_direction_deg"] is None else f" towards {place['lean_direction_deg']:.0f}°"
        say(layout, f"Lean {place['lean_deg']:.1f}°{way}")


@panel("Noise", BLENDER_LIDAR_PT_sensor.__name__, bl_options={"DEFAULT_CLOSED"})
class BLENDER_LIDAR_PT_noise(OfLidar, bpy.types.Panel):
    """How imperfect the sensor is."""

    def draw_for(self, layout, scene, lidar):
        """Its imperfections."""
        field(layout, lidar.blender_lidar, "datasheet")
        own = ("range_noise_m", "range_at_10_percent_m") if lidar.blender_lidar.datasheet else ()
        rows(layout, lidar.blender_lidar, *(key for key in properties.IMPERFECTIONS if key not in own))


@panel("Scan", BLENDER_LIDAR_PT_main.__name__)
class BLENDER_LIDAR_PT_scan(OfLidar, bpy.types.Panel):
    """One revolution, and how its points look."""

    def draw_for(self, layout, scene, lidar):
        """Scan, live, style, colors and labels."""
        group = lidar.blender_lidar
        row = layout.row(align=True)
        row.operator("blender_lidar.scan", icon="LIGHT_SUN", translate=False)
        field(row, group, "live", toggle=True)
        field(layout, group, "style")
        field(layout, group, "colour_by")
        field(layout, scene.blender_lidar, "label_by")
        say(layout, f"Own objects: {'preview' if group.live else 'exact, as they were when scanned'}", icon="MESH_CUBE")
        if group.scanned_frame < 0:
            built = any(role(child) == CLOUD for child in lidar.children)
            say(layout, "The cloud is the file's; Scan scores it." if built else "Not scanned yet.")
        else:
            say(layout, f"{group.points:,} points at {group.scanned_s:.2f} s")
            if is_stale(scene, lidar) and not group.live:
                say(layout, "Changed since: scan again.", icon="ERROR")


def is_stale(scene: bpy.types.Scene, lidar: bpy.types.Object) -> bool:
    """Whether the LiDAR, the time or the settings are other than when it was scanned; own objects are not looked at."""
    group = lidar.blender_lidar
    moved = abs(group.scanned_s - session.since_of(scene)) > SAME_S
    return moved or is_other(lidar, group.scanned_at, group.scanned_with)


def is_other(lidar: bpy.types.Object, pose: Iterable[float], settings: str) -> bool:
    """Whether a LiDAR hangs elsewhere than at a `pose` [m, degrees], or what it is scanned with has another digest."""
    try:
        now = pose_of(lidar).as_table().values()
    except BlenderLidarError:  # mirrored, which the tab says
        return True
    moved = any(abs(one - other) > 1e-3 for one, other in zip(now, pose, strict=True))
    return moved or settings != session.settings_digest(lidar)


def worth_lines(now: tuple[float, float], base: tuple[float, float], vehicles: int) -> list[str]:
    """An objective with its detectable share in short lines, and the difference to those of the baseline."""
    lines = [f"Objective {now[0]:.2f}", f"Detectable {100 * now[1]:.0f} % of {vehicles}"]
    return [*lines, f"Over baseline {now[0] - base[0]:+.2f}, {100 * (now[1] - base[1]):+.0f} pp"]


def fused_lines(scene: bpy.types.Scene, lidar: bpy.types.Object) -> list[str]:
    """What the layout of a LiDAR is worth together, in short lines; none where it hangs alone."""
    hung, told = scenarios.layout_of(scene, lidar), json.loads(scene.blender_lidar.fused or "{}")
    if told.get("lidars") != [one.name_full for one in hung]:
        return []
    alone = ", ".join(f"{one.name} {100 * one.blender_lidar.detectable_share:.0f} %" for one in hung)
    now, base = (tuple(told[name].values()) for name in ("now", "baseline"))
    lines = [f"Layout of {len(hung)}:", *worth_lines(now, base, told["vehicles"]), f"Detectable alone: {alone}"]
    return [*lines, *(["Changed since: scan again."] if any(is_stale(scene, one) for one in hung) else [])]


@panel("Score", BLENDER_LIDAR_PT_main.__name__)
class BLENDER_LIDAR_PT_score(OfLidar, bpy.types.Panel):
    """What the mounting is worth on this frame, beside the baseline."""

    of_traffic = True

    def draw_for(self, layout, scene, lidar):
        """Objective, detectable share and the difference to the baseline."""
        group, shared = lidar.blender_lidar, scene.blender_lidar
        field(layout, shared, "metric")
        for line in fused_lines(scene, lidar):
            say(layout, line)
        if group.scanned_frame >= 0:
            box = layout.box().column(align=True)
            if group.in_layout:
                say(box, f"{lidar.name} alone:")
            now, base = (group.objective, group.detectable_share), (group.baseline_objective, group.baseline_share)
            for line in worth_lines(now, base, group.vehicles):
                say(box, line)
            if is_stale(scene, lidar) and not group.live:
                say(box, "Changed since: scan again.", icon="ERROR")
        base = shared.baseline
        own = {"height_m": base.height_m, "tilt_x_deg": math.degrees(base.tilt_x_deg)}
        own |= json.loads(group.baseline or "{}")
        say(layout, f"Baseline: {own['height_m']:.2f} m, tilt {own['tilt_x_deg']:.1f}°")
        layout.operator("blender_lidar.set_baseline", icon="PINNED", translate=False)


@panel("Export", BLENDER_LIDAR_PT_main.__name__, bl_options={"DEFAULT_CLOSED"}, bl_order=9)
class BLENDER_LIDAR_PT_export(OfLidar, bpy.types.Panel):
    """What goes out."""

    def draw_for(self, layout, scene, lidar):
        """Clouds, labeled sets, a run folder, a .blend file."""
        column = layout.column(align=True)
        column.operator("blender_lidar.export_cloud", text="Cloud", icon="EXPORT", translate=False)
        column.operator("blender_lidar.export_labelled", text="Labeled Set", translate=False)
        column.operator("blender_lidar.export_run", text="Run Folder", translate=False)
        column.operator("wm.save_as_mainfile", text="Copy as .blend", translate=False).copy = True


@panel("Advanced", BLENDER_LIDAR_PT_main.__name__, bl_options={"DEFAULT_CLOSED"}, bl_order=10)
class BLENDER_LIDAR_PT_advanced(OfLidar, bpy.types.Panel):
    """What casts the rays, and when a vehicle counts as detectable."""

    def draw_for(self, layout, scene, lidar):
        """Caster, threshold and cell."""
        field(layout, scene.blender_lidar.model, "caster")
        rows(layout, scene.blender_lidar.objective, "threshold", "cell_m")


def export_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """File > Export > LiDAR Cloud."""
    menu.layout.operator("blender_lidar.export_cloud", text="LiDAR Cloud (.ply, .pcd, .npz)", translate=False)


def add_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """Add > LiDAR."""
    menu.layout.operator("blender_lidar.add", icon="LIGHT_SUN", translate=False)


classes = (
    BLENDER_LIDAR_UL_lidars,
    BLENDER_LIDAR_PT_main,
    BLENDER_LIDAR_PT_traffic,
    BLENDER_LIDAR_PT_road,
    BLENDER_LIDAR_PT_sensor,
    BLENDER_LIDAR_PT_noise,
    BLENDER_LIDAR_PT_scan,
    BLENDER_LIDAR_PT_score,
    BLENDER_LIDAR_PT_export,
    BLENDER_LIDAR_PT_advanced,
)


menus = ((bpy.types.VIEW3D_MT_add, add_menu), (bpy.types.TOPBAR_MT_file_export, export_menu))
