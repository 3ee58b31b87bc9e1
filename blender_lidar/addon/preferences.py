"""Preferences of the add-on, and presets of sensors with their noise."""

# Not from __future__ import annotations: Blender reads properties from annotations as they are.
from pathlib import Path

import bpy
from bl_operators.presets import AddPresetBase
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ..scene.settings import DECLARED
from . import properties, words

_PACKAGE = __package__.rpartition(".")[0]
_PRESETS = "blender_lidar/sensors"


class BLENDER_LIDAR_AP_preferences(bpy.types.AddonPreferences):
    """What new LiDARs and new runs start with."""

    bl_idname = _PACKAGE
    sensor: EnumProperty(
        name="Sensor of New LiDARs", items=words.SENSORS, default="RS-16", description="Model of a LiDAR that is added"
    )
    caster: properties.made_from("caster", DECLARED["model"]["caster"], "", name="Caster of New Files", update=None)
    point_size: FloatProperty(
        name="Point Size While Live", default=3.0, min=1.0, max=20.0, subtype="PIXEL", description="Size of live points"
    )
    runs: StringProperty(
        name="Folder of Runs",
        subtype="DIR_PATH",
        description="Where optimizations are kept; empty for a folder beside each .blend file",
    )

    def draw(self, context):
        """A row for each."""
        self.layout.use_property_split = True
        for key in ("sensor", "caster", "point_size", "runs"):
            self.layout.prop(self, key, text=self.bl_rna.properties[key].name, translate=False)


def preference(key: str) -> object:
    """What the preferences say, or their default where the package is registered without being an add-on."""
    addon = bpy.context.preferences.addons.get(_PACKAGE)
    return getattr(addon.preferences, key) if addon else BLENDER_LIDAR_AP_preferences.bl_rna.properties[key].default


def runs_folder() -> Path | None:
    """The folder of the open file's runs; None where it is not saved and the preferences name none."""
    own, name = preference("runs"), Path(bpy.data.filepath).stem
    if own:
        return Path(bpy.path.abspath(own)) / f"{name or 'unsaved'}_runs"
    return Path(bpy.data.filepath).with_name(f"{name}_runs") if name else None


class BLENDER_LIDAR_MT_presets(bpy.types.Menu):
    """Sensors with their noise, kept by name"""

    bl_label, preset_subdir, preset_operator = "Sensor Presets", _PRESETS, "script.execute_preset"
    draw = bpy.types.Menu.draw_preset


class BLENDER_LIDAR_OT_add_preset(AddPresetBase, bpy.types.Operator):
    """Keep the active LiDAR's sensor with its noise under a name, or remove the chosen one"""

    bl_idname, bl_label, preset_menu = "blender_lidar.add_preset", "Add Sensor Preset", "BLENDER_LIDAR_MT_presets"
    preset_defines = (
        "import importlib",
        f"lidar = importlib.import_module('{__package__}.scenarios').active_lidar(bpy.context.scene).blender_lidar",
    )
    preset_values = tuple(f"lidar.{key}" for key in ("name_", "table_path", "datasheet", *properties.SENSOR))
    preset_subdir = _PRESETS


classes = (BLENDER_LIDAR_AP_preferences, BLENDER_LIDAR_MT_presets, BLENDER_LIDAR_OT_add_preset)
