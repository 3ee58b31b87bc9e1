"""Vehicles' bodies of the user's own in the window: which collection stands for which kind of vehicle."""

import bpy
from bpy.props import BoolProperty, EnumProperty

from ..traffic.vehicles import FLEET_KINDS
from ..world.blender.bodies import around, body_of
from ..world.blender.objects import role
from .operators import one_line_errors
from .panels import BLENDER_LIDAR_PT_traffic, panel, rows
from .properties import label_of

_KINDS = [(kind, label_of(kind), f"Every {label_of(kind).lower()} of the traffic") for kind in FLEET_KINDS]


class BLENDER_LIDAR_OT_use_as_vehicle(bpy.types.Operator):
    """Put the active object, with its children, or what it instances in place of the body of each vehicle of a class"""

    bl_idname, bl_label, bl_options = "blender_lidar.use_as_vehicle", "Use as Vehicle", {"REGISTER", "UNDO"}
    kind: EnumProperty(name="Class", items=_KINDS, description="Vehicles that it stands for, fitted to the box of each")
    hide: BoolProperty(
        name="Hide Original",
        default=True,
        description="Hide the object where it stands: what is visible hides vehicles from the LiDAR",
    )

    @classmethod
    def poll(cls, context):
        """Whether an object of the user's is active."""
        return context.active_object is not None and role(context.active_object) is None

    @one_line_errors
    def execute(self, context):
        """Take it if it is a body; a dropped asset that is a collection is an object that instances it."""
        item = context.active_object
        made = None if item.instance_collection else around(item)
        try:
            body_of(made or item.instance_collection, item.name)
        except BaseException:
            if made is not None:
                bpy.data.collections.remove(made)
            raise
        setattr(context.scene.blender_lidar.vehicles, self.kind, made or item.instance_collection)
        for one in (item, *item.children_recursive) if self.hide else ():
            if one.name in context.view_layer.objects:
                one.hide_set(True)
        return {"FINISHED"}


@panel("Own Bodies", BLENDER_LIDAR_PT_traffic.__name__, bl_options={"DEFAULT_CLOSED"})
class BLENDER_LIDAR_PT_vehicles(bpy.types.Panel):
    """Collections in place of our bodies."""

    def draw(self, context):
        """A collection for each class, and the active object as one."""
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        rows(layout, context.scene.blender_lidar.vehicles, *FLEET_KINDS)
        _choose(self, context)


def _choose(menu, context) -> None:
    """The operator, with its classes to choose from."""
    name = BLENDER_LIDAR_OT_use_as_vehicle.bl_idname
    menu.layout.operator_menu_enum(name, "kind", text="Use as Vehicle", icon="AUTO", translate=False)


classes = (BLENDER_LIDAR_OT_use_as_vehicle, BLENDER_LIDAR_PT_vehicles)
menus = ((bpy.types.VIEW3D_MT_object, _choose), (bpy.types.VIEW3D_MT_object_context_menu, _choose))
