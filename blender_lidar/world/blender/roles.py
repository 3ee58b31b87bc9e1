"""What an object of ours stands for, kept in a custom property, so that a scene can be read back and shown again."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

KEY = "blender_lidar"  # custom property of our objects and collections
VEHICLE_ID, SHAPE = "vehicle_id", "shape"  # further ones of vehicles
VEHICLE, ROAD, MARKING, STANDING = "vehicle", "road", "marking", "scenery"
SENSOR, FAN, CLOUD, STAGE = "lidar", "beam fan", "cloud", "stage"
# What a LiDAR would not meet: paint, its own pole, what it has measured.
DISPLAY_ONLY = (MARKING, SENSOR, FAN, CLOUD)


def role(thing: bpy.types.ID) -> str | None:
    """What a thing of ours stands for; None for what is not ours."""
    return thing.get(KEY)


def of_ours(blocks: Iterable[bpy.types.ID], key: str) -> bpy.types.ID | None:
    """The data-block that was marked with `key` when it was made, whatever it is called; None where there is none.

    A file of the user's may hold blocks of the same names.
    """
    return next((block for block in blocks if block.library is None and role(block) == key), None)


def collection(scene: bpy.types.Scene, name: str, of: str) -> bpy.types.Collection:
    """The scene's collection for objects of a role; made when it is not there."""
    for child in scene.collection.children:
        if role(child) == of:
            return child
    made = bpy.data.collections.new(name)
    made[KEY] = of
    scene.collection.children.link(made)
    return made


def add_object(
    into: bpy.types.Collection, name: str, data: bpy.types.ID | None, of: str | None = None
) -> bpy.types.Object:
    """A new object in a collection, of that collection's role unless another is said."""
    made = bpy.data.objects.new(name, data)
    made[KEY] = of or role(into)
    into.objects.link(made)
    return made


def only_for_the_eye(item: bpy.types.Object) -> None:
    """Let an object neither throw a shadow nor shine on others: what is drawn into the scene is not part of it."""
    item.visible_shadow = item.visible_diffuse = item.visible_glossy = False


def clear(from_collection: bpy.types.Collection) -> None:
    """Remove our objects from a collection, and the meshes, curves, cameras and lights that nothing else uses then."""
    objects = [item for item in from_collection.objects if role(item) is not None]
    data = {item.data for item in objects if item.data is not None}
    bpy.data.batch_remove(objects)
    bpy.data.batch_remove([item for item in data if item.users == 0])
