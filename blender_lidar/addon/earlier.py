"""Migration: names for roles and settings in .blend files of before, also linked ones, when a file is opened."""

import bpy

from ..world.blender.objects import EARLIER_KEY, KEY, lidars
from . import operators, properties, scenarios

_SETTINGS = "lidar"  # custom property then
# Models in the order that their numbers were in.
_MODELS = (
    "HDL-32E HDL-64E-S2 HDL-64E-S3 OS0-128 OS0-32 OS1-128 OS1-32 OS1-64 OS2-128 OS2-32 Pandar128 Pandar40P Pandar64 "
    "QT64 RS-16 RS-32 RS-80 RS-BPearl RS-Helios-5515 RS-LiDAR-32 RS-Ruby-128 RS-Ruby-80V RS-Ruby-Lite-V2R VLP-16 "
    f"VLP-32C VLS-128 XT32 {properties.OWN}"
).split()


@properties.guarded
def migrate() -> None:
    """Give what a file of before holds its present names, what is linked in memory alone; other files stay."""
    data = bpy.data
    for blocks in (data.objects, data.collections, data.materials, data.meshes, data.node_groups, data.worlds):
        for block in blocks:
            if isinstance(role := block.get(EARLIER_KEY), str):
                del block[EARLIER_KEY]
                block[KEY] = role
    for lidar in data.objects:
        if KEY in lidar and hasattr(old := lidar.get(_SETTINGS), "to_dict"):
            with properties.silently():
                _fill(lidar.blender_lidar, old.to_dict())
            del lidar[_SETTINGS]

    for scene in (one for one in data.scenes if one.library is None):
        old = scene.get(EARLIER_KEY)
        old = old.to_dict() if hasattr(old, "to_dict") else {}
        if isinstance(old.get("active"), str):
            scene.blender_lidar.active = scene.objects.get(old["active"])
        scenarios.keep_lidars(scene, lidars(scene))
        if "frame" in old and old.get("loaded"):  # which was the clock
            scene.blender_lidar.known_frame = old["frame"]
            operators.show_loaded(scene)  # its road had no parts that can be hidden


def _fill(group, values) -> None:
    """Set a LiDAR's properties to what was saved of them: enumerations as numbers, in the order of their items."""
    kinds = group.bl_rna.properties
    for key, value in values.items():
        if key not in kinds or key in properties.SEARCHABLE:  # these are read from the transform
            continue
        if kinds[key].type == "ENUM":
            items = _MODELS if key == "name_" else [item.identifier for item in kinds[key].enum_items]
            value = items[value]
        setattr(group, key, value)
