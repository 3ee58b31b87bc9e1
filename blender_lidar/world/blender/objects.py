"""Blender objects of a scene: roles, the road frame, mesh data-blocks, materials, scenery, and the mounted LiDAR."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import bpy
import numpy as np
from mathutils import Euler, Matrix

from ...errors import InputError
from ...sensors.beams import BeamLattice, beam_directions
from ...sensors.pose import Pose, tilts_of
from ..meshes import BUILDING, CYCLIST, GLASS, PAINT, PERSON, STRUCTURE, SURFACE_CLASS, SURFACES, VEGETATION, tube
from ..scenery import Scenery

# --- What an object of ours stands for, kept in a custom property, so that a scene can be read back and shown again -

KEY = "blender_lidar_role"  # custom property of our objects and collections
VEHICLE, ROAD_ROLE, MARKING, STANDING = "vehicle", "road", "marking", "scenery"
SENSOR, PART, FAN, CLOUD, STAGE = "lidar", "lidar part", "beam fan", "cloud", "stage"
DETECTION_ROLE = "detections"
FRAME = "road frame"
# What a LiDAR would not meet: paint, its own pole, what it has measured and what was found in that.
DISPLAY_ONLY = (MARKING, SENSOR, PART, FAN, CLOUD, DETECTION_ROLE)
_WORN = (PART, FAN, CLOUD)
SETTINGS = "blender_lidar_sensor"  # custom property of a LiDAR that was built without the add-on: its settings as JSON


def role(thing: bpy.types.ID) -> str | None:
    """What a thing of ours stands for; None for what is not ours."""
    found = thing.get(KEY)
    return found if isinstance(found, str) else None


def made_once(blocks: Iterable[bpy.types.ID], key: str, make: Callable[[], bpy.types.ID]) -> bpy.types.ID:
    """The data-block that we made and marked with `key` before, also when renamed, or else a new one.

    A file of the user's may hold blocks of the same names.
    """
    block = next((block for block in blocks if block.library is None and role(block) == key), None)
    if block is None:
        block = make()
        block[KEY] = key
    return block


def collection(scene: bpy.types.Scene, name: str, of: str) -> bpy.types.Collection:
    """The scene's collection for objects of a role, wherever it is nested; made when it is not there."""

    def make():
        made = bpy.data.collections.new(name)
        scene.collection.children.link(made)
        return made

    return made_once(scene.collection.children_recursive, of, make)


def add_object(
    into: bpy.types.Collection,
    name: str,
    data: bpy.types.ID | None,
    of: str | None = None,
    parent: bpy.types.Object | None = None,
) -> bpy.types.Object:
    """A new object in a collection, of that collection's role unless another is said."""
    made = bpy.data.objects.new(name, data)
    made[KEY], made.parent = of or role(into), parent
    into.objects.link(made)
    return made


def rendered_collections(collection: bpy.types.Collection) -> Iterator[bpy.types.Collection]:
    """A collection and those below it, except for those that renders hide."""
    if not collection.hide_render:
        yield collection
        for child in collection.children:
            yield from rendered_collections(child)


def is_shown(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, item: bpy.types.Object) -> bool:
    """Whether both a view layer and renders show an object."""
    if item.hide_render or not item.visible_get(view_layer=layer):
        return False
    return any(item.name in one.objects for one in rendered_collections(scene.collection))


def only_for_the_eye(item: bpy.types.Object) -> None:
    """Let an object neither throw a shadow nor shine on others: what is drawn into the scene is not part of it."""
    item.visible_shadow = item.visible_diffuse = item.visible_glossy = False


def clear(from_collection: bpy.types.Collection) -> None:
    """Remove our objects from a collection, but for the road frame."""
    _remove([item for item in from_collection.objects if role(item) not in (None, FRAME)])


def _remove(objects: Sequence[bpy.types.Object]) -> None:
    """Remove objects, and the meshes, curves, cameras and lights that nothing else uses then."""
    data = {item.data for item in objects if item.data is not None}
    bpy.data.batch_remove(objects)
    bpy.data.batch_remove([item for item in data if item.users == 0])


# --- The road frame: an empty that carries what we show of a site, wherever it lies in the user's world ---------------

_FRAME_KEY = "blender_lidar_frame"  # custom property of a scene: its road frame, so that no copy is taken for it
_FRAME_AXES_M = 3.0
_SAME_AXES = 1e-5
_SQUARE = 1e-4  # cosine between axes that are square to each other, in single precision


def frame_of(scene: bpy.types.Scene | None) -> bpy.types.Object | None:
    """A scene's road frame; None where it has none."""
    frame = None if scene is None else scene.get(_FRAME_KEY)
    return frame if frame is not None and holds(scene, frame) else None  # a deleted one is kept


def road_frame(scene: bpy.types.Scene) -> bpy.types.Object:
    """A scene's road frame, made where there is none; what is ours and had none yet, or lost its own, is put on it."""
    frame = frame_of(scene)
    made = frame is None
    if made:
        frame = scene[_FRAME_KEY] = add_object(collection(scene, "Road", ROAD_ROLE), "Road", None, FRAME)
        frame.empty_display_type, frame.empty_display_size = "ARROWS", _FRAME_AXES_M
        frame.lock_scale, frame.lock_rotation = (True, True, True), (True, True, False)
    for item in scene.objects:
        alone = _is_lost(item.parent) if item.parent else made
        if alone and item.library is None and role(item) not in (None, FRAME, *_WORN):
            item.parent = frame
    return frame


def _is_lost(parent: bpy.types.Object) -> bool:
    """Whether an object is a road frame that was deleted, or that came along with what was appended."""
    return role(parent) == FRAME and scene_of(parent) is None


def to_road(scene: bpy.types.Scene | None, depsgraph: bpy.types.Depsgraph | None = None) -> np.ndarray:
    """What takes places of a scene's world to its road frame, (4, 4) for columns.

    Raises
    ------
    InputError
        For a road frame that is tilted, scaled or mirrored.
    """
    frame = frame_of(scene)
    if frame is None:
        return np.eye(4)
    matrix = np.array(_world_of(frame if depsgraph is None else frame.evaluated_get(depsgraph)))
    angle = math.atan2(matrix[1, 0], matrix[0, 0])
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    if not np.abs(matrix[:3, :3] - turn).max() < _SAME_AXES:
        raise InputError(f"{frame.name}: is tilted, scaled or mirrored; allowed: moved, and turned about z")
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn.T, -matrix[:3, 3] @ turn
    return found


def _world_of(item: bpy.types.Object) -> Matrix:
    """An object's transform, where it is free as it is now, not as Blender evaluated it last."""
    return item.matrix_world if item.parent or item.constraints else item.matrix_basis


# --- Mesh data-blocks from arrays, in a few calls for any size -------------------------------------


def new_mesh(
    name: str,
    vertices: np.ndarray,
    faces: np.ndarray | Sequence[np.ndarray],
    materials: Sequence[bpy.types.Material] = (),
    material_index: np.ndarray | None = None,
) -> bpy.types.Mesh:
    """A mesh of polygons.

    Parameters
    ----------
    name : str
    vertices : ndarray, (n, 3)
        Positions [m, object frame]; stored as float32.
    faces : ndarray of int, (m, corners), or sequence of ndarray
        Vertices of each polygon, counter-clockwise seen from outside; (0, 3) for a cloud of points.
    materials : sequence of Material
        Its material slots.
    material_index : ndarray of int, (m,), optional
        Slot of each polygon; the first for all if left out.
    """
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, dtype=np.float32).ravel())
    if len(faces):
        corners = np.array([len(face) for face in faces], dtype=np.int32)
        loops = faces.ravel() if isinstance(faces, np.ndarray) else np.concatenate(faces)
        mesh.loops.add(len(loops))
        mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(loops, dtype=np.int32))
        mesh.polygons.add(len(faces))
        mesh.polygons.foreach_set("loop_start", (np.cumsum(corners) - corners).astype(np.int32))
        mesh.polygons.foreach_set("loop_total", corners)
        mesh.polygons.foreach_set("use_smooth", np.zeros(len(faces), dtype=bool))  # Blender 4.1 on shades smoothly
    for material in materials:
        mesh.materials.append(material)
    if material_index is not None:
        mesh.polygons.foreach_set("material_index", np.ascontiguousarray(material_index, dtype=np.int32))
    mesh.update(calc_edges=True)
    return mesh


def add_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Give every vertex a number, (n,), or a vector, (n, 3): whole ones become INT; it may have that one already."""
    whole, key = values.dtype.kind in "iu", "value" if values.ndim == 1 else "vector"
    kind = "INT" if whole else "FLOAT" if values.ndim == 1 else "FLOAT_VECTOR"
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(key, np.ascontiguousarray(values, dtype=np.int32 if whole else np.float32).ravel())


# --- Materials, plain ones by name ---------------------------------------------------------------------------

# Linear RGB. Classes differ in lightness too.
CLASS_COLOURS = {
    "car": (0.10, 0.23, 0.48),
    "van": (0.16, 0.42, 0.40),
    "truck": (0.72, 0.36, 0.08),
    "bus": (0.70, 0.58, 0.10),
    "motorcycle": (0.50, 0.06, 0.10),
    "bicycle": (0.58, 0.16, 0.42),
    "pedestrian": (0.30, 0.62, 0.16),
}
GLASS_COLOUR = (0.012, 0.016, 0.02)
CONCRETE, METAL, HEAD, BEAM = (0.34, 0.33, 0.31), (0.30, 0.31, 0.33), (0.02, 0.02, 0.025), (0.9, 0.12, 0.08)

SURFACE_KEY = "blender_lidar_surface"  # custom property: index into `meshes.REFLECTIVITY`


def nodes_of(block: bpy.types.Material | bpy.types.World) -> bpy.types.NodeTree:
    """The nodes of a material or a world."""
    if bpy.app.version < (5, 0):  # from then on they always have some
        block.use_nodes = True
    return block.node_tree


def set_inputs(block: bpy.types.Material | bpy.types.World, kind: str, inputs: Mapping[str, object]) -> None:
    """Set inputs of the one node of a kind that a new material or world has."""
    shader = next(node for node in nodes_of(block).nodes if node.type == kind)
    for name, value in inputs.items():
        shader.inputs[name].default_value = value


def plain(name: str, colour: tuple[float, float, float], surface: int = STRUCTURE, roughness: float = 0.7):
    """A material of one colour, (r, g, b) linear; the one that we made of that name before is used again."""

    def make():
        material = bpy.data.materials.new(name)
        material[SURFACE_KEY] = surface
        material.diffuse_color = (*colour, 1.0)
        material.roughness = roughness
        set_inputs(material, "BSDF_PRINCIPLED", {"Base Color": (*colour, 1.0), "Roughness": roughness})
        return material

    return made_once(bpy.data.materials, name, make)


def paint_of(vehicle_class: str) -> bpy.types.Material:
    """The paint of a class of vehicles: instances by nodes have no colour of their own that renders would show."""
    return plain(f"Paint {vehicle_class}", CLASS_COLOURS[vehicle_class], PAINT, 0.35)


def wear_own_paint(item: bpy.types.Object) -> None:
    """Let the colour of an object be that of its first material, where it has any."""
    if item.material_slots and (material := item.material_slots[0].material) is not None:
        item.color = material.diffuse_color


def glass() -> bpy.types.Material:
    """Windows: dark and glossy."""
    return plain("Glass", GLASS_COLOUR, GLASS, 0.05)


# --- What stands beside the road ------------------------------------------------------------------------------------


_STANDS = {STRUCTURE: CONCRETE, BUILDING: (0.42, 0.36, 0.3), VEGETATION: (0.1, 0.22, 0.06)}
_STANDS |= dict.fromkeys((PERSON, CYCLIST), (0.3, 0.2, 0.2))


def build_scenery(scene: bpy.types.Scene, scenery: Scenery | None) -> None:
    """Barriers, buildings and other standing things, an object each; they take the place of earlier ones."""
    into = collection(scene, "Scenery", STANDING)
    clear(into)
    if scenery is None or not len(scenery := scenery.beside_road):
        return
    worn = {number: plain(SURFACES[number].capitalize(), colour, number) for number, colour in _STANDS.items()}
    worn[GLASS] = glass()
    order = np.argsort(scenery.owner, kind="stable")
    owners, starts = np.unique(scenery.owner[order], return_index=True)
    for row, own in zip(owners.tolist(), np.split(order, starts[1:]), strict=True):
        name = scenery.names[row]
        corners = scenery.corners[own]
        middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))  # float32 is finest about an object
        vertices, faces = np.unique((corners - middle).reshape(-1, 3), axis=0, return_inverse=True)
        made_of = SURFACE_CLASS[scenery.surface[own]]
        made_of = np.where(np.isin(made_of, list(worn)), made_of, STRUCTURE)
        numbers, slot = np.unique(made_of, return_inverse=True)
        mesh = new_mesh(name, vertices, faces.reshape(-1, 3), [worn[number] for number in numbers], slot)
        add_object(into, name, mesh, parent=frame_of(scene)).location = middle


# --- The mounted LiDAR: an empty whose axes are those of the sensor frame; pole, head and fan are its children -------

_HEAD_RADIUS_M, _HEAD_HEIGHT_M, _POLE_RADIUS_M = 0.06, 0.09, 0.07
_SIDES = 32
_AXES_M = 0.4
_FAN_REACH_M, _BEAM_RADIUS_M = 25.0, 0.006
_AZIMUTHS_RAD = (-math.pi / 3.0, 0.0, math.pi / 3.0)  # of the fan: across the road and obliquely ahead and back


def build_lidar(scene: bpy.types.Scene, lattice: BeamLattice, pose: Pose, name: str = "LiDAR") -> bpy.types.Object:
    """A LiDAR at a mounting: an empty whose axes are those of the sensor frame."""
    road_frame(scene)
    lidar = new_lidar(scene, pose, name)
    dress(lidar, lattice)
    return lidar


def new_lidar(scene: bpy.types.Scene, pose: Pose, name: str = "LiDAR") -> bpy.types.Object:
    """A LiDAR's empty at a mounting, still without pole, head and fan; on the road frame where there is one."""
    lidar = add_object(collection(scene, "LiDAR", SENSOR), name, None, parent=frame_of(scene))
    lidar.empty_display_type, lidar.empty_display_size = "ARROWS", _AXES_M
    lidar.lock_scale = (True, True, True)
    hang(lidar, pose)
    return lidar


def dress(lidar: bpy.types.Object, lattice: BeamLattice) -> None:
    """Give a LiDAR its head, a fan of its sensor's beams and, on a road, a pole that stays upright and reaches it.

    They are its children, in its collections, and take the place of earlier ones.

    Raises
    ------
    InputError
        For a linked LiDAR.
    """
    check_local(lidar)
    _remove([child for child in lidar.children if role(child) in (PART, FAN)])
    into, half = lidar.users_collection[0], 0.5 * _HEAD_HEIGHT_M
    head = add_object(into, "Head", _cylinder("Head", _HEAD_RADIUS_M, -half, half, plain("Head", HEAD)), PART)
    fan, frame = add_object(into, "Beam fan", _fan(lattice), FAN), frame_of(scene_of(lidar))
    for child in (head, fan, *([] if frame is None else [_pole(into, lidar, frame)])):
        child.parent = lidar
        child.lock_location = child.lock_rotation = child.lock_scale = (True, True, True)
    only_for_the_eye(fan)


def _pole(into: bpy.types.Collection, lidar: bpy.types.Object, frame: bpy.types.Object) -> bpy.types.Object:
    """A pole below a LiDAR's head."""
    metal = plain("Pole", METAL, roughness=0.4)
    pole = add_object(into, "Pole", _cylinder("Pole", _POLE_RADIUS_M, -1.0, 0.0, metal), PART)
    upright = pole.constraints.new("LIMIT_ROTATION")
    upright.use_limit_x = upright.use_limit_y = True
    length = pole.driver_add("scale", 2).driver  # from below the head down to z = 0 of the road
    of = {"height": (lidar, "LOC_Z"), "scale": (lidar, "SCALE_Z"), "road": (frame, "LOC_Z")}
    for name, (item, transform) in of.items():
        variable = length.variables.new()
        variable.name, variable.type = name, "TRANSFORMS"
        variable.targets[0].id, variable.targets[0].transform_type = item, transform
    length.expression = "max(height - road, 0.001) / max(scale, 0.001)"
    return pole


def pose_of(lidar: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Pose:
    """The mounting that a LiDAR's transform says, in single precision; see `matrix_of`.

    Raises
    ------
    InputError
        For a LiDAR that is mirrored or sheared, or a road frame that is tilted or scaled.
    """
    matrix = matrix_of(lidar, depsgraph)
    place, turn, _ = matrix.decompose()
    if matrix.determinant() < 0.0:
        raise InputError(f"{lidar.name}: is mirrored; allowed: a LiDAR with positive scale")
    axes = np.array(matrix.to_3x3().normalized())
    if not np.abs(axes.T @ axes - np.eye(3)).max() < _SQUARE:
        parent = f" by its parent {lidar.parent.name}" if lidar.parent else ""
        raise InputError(f"{lidar.name}: is sheared{parent}; allowed: axes square to each other, so apply its scale")
    return Pose(*place, *tilts_of(np.array(turn.to_matrix()).T))  # for rows


def matrix_of(lidar: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> Matrix:
    """A LiDAR's transform in the road frame, as it is now unless other objects have a say in it.

    With a `depsgraph` it is as that has evaluated it: while a renderer goes through frames, nothing else knows.

    Raises
    ------
    InputError
        For a road frame that is tilted or scaled.
    """
    scene = scene_of(lidar)
    into, frame = to_road(scene, depsgraph), frame_of(scene)
    if depsgraph is not None:
        return Matrix(into @ np.array(lidar.evaluated_get(depsgraph).matrix_world))
    if frame is not None and lidar.parent == frame and not lidar.constraints:  # its world has fewer digits
        return lidar.matrix_parent_inverse @ lidar.matrix_basis
    return Matrix(into @ np.array(_world_of(lidar)))


def scene_of(item: bpy.types.Object) -> bpy.types.Scene | None:
    """The first scene that an object is in."""
    return next((scene for scene in bpy.data.scenes if holds(scene, item)), None)


def holds(scene: bpy.types.Scene, item: bpy.types.Object) -> bool:
    """Whether an object is in a scene: `Object.users_scene` looks at all objects, in Python."""
    found = scene.objects.get(item.name)
    return found == item or (found is not None and item in scene.objects[:])  # a linked one may have the same name


def remove_orphans(scene: bpy.types.Scene) -> None:
    """Remove heads, poles, fans and clouds whose LiDAR was deleted; a cloud that was made selectable stays."""
    worn = [item for item in scene.objects if role(item) in _WORN and item.library is None]
    alone = [item for item in worn if item.parent is None or scene_of(item.parent) is None]
    _remove([item for item in alone if item.hide_select or role(item) != CLOUD])


def check_local(lidar: bpy.types.Object) -> None:
    """Refuse a LiDAR that is linked from another file.

    Raises
    ------
    InputError
        By its name and the file's.
    """
    if lidar.library is not None:
        raise InputError(f"{lidar.name}: is linked from {lidar.library.filepath}; allowed: a LiDAR of this file")


def check_free(lidar: bpy.types.Object) -> None:
    """Refuse a LiDAR whose pose something else holds.

    Raises
    ------
    InputError
        Naming a constraint, an animation or a driver, or the file that the LiDAR is linked from.
    """
    check_local(lidar)
    held = [f"its constraint {one.name}" for one in lidar.constraints if not one.mute and one.influence > 0.0]
    if (moved := lidar.animation_data) is not None:
        curves = curves_of(moved.action) if moved.action else []
        held += [f"its animation {moved.action.name}" for one in curves if _is_pose(one)]
        held += ["a driver" for one in moved.drivers if _is_pose(one)]
        held += [f"its animation {track.name}" for track in moved.nla_tracks if track.strips and not track.mute]
    if held:
        raise InputError(f"{lidar.name}: its pose is held by {held[0]}; allowed: a LiDAR that nothing else moves")


def _is_pose(curve):
    return curve.data_path.startswith(("location", "rotation", "scale", "delta_"))


def curves_of(action: bpy.types.Action) -> list[bpy.types.FCurve]:
    """The curves of an animation."""
    holders = [action]
    if not hasattr(action, "fcurves"):  # from Blender 5 on
        holders = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    return [curve for holder in holders for curve in holder.fcurves]


def hang(lidar: bpy.types.Object, pose: Pose) -> None:
    """Move a LiDAR to a mounting.

    Raises
    ------
    InputError
        Where something else holds its pose.
    """
    check_free(lidar)
    scene = scene_of(lidar)
    if lidar.parent != frame_of(scene):
        lidar.matrix_world = Matrix(np.linalg.inv(to_road(scene))) @ sensor_matrix(pose)
        return
    lidar.matrix_parent_inverse.identity()
    lidar.rotation_mode = "XYZ"
    lidar.location, lidar.rotation_euler = pose.position, (-pose.tilt_x, -pose.tilt_y, pose.yaw)


def is_lidar(item: bpy.types.Object | None) -> bool:
    """Whether an object is a LiDAR of ours."""
    return item is not None and role(item) == SENSOR and item.type == "EMPTY"


def lidars(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The LiDARs of a scene, by name."""
    return sorted(filter(is_lidar, scene.objects), key=lambda item: item.name)


def sensor_matrix(pose: Pose) -> Matrix:
    """What takes the sensor frame to the road frame: Eqs. 2 to 5 as Blender's Euler angles (-tilt_x, -tilt_y, yaw)."""
    turn = Euler((-pose.tilt_x, -pose.tilt_y, pose.yaw), "XYZ").to_matrix().to_4x4()
    return Matrix.Translation(pose.position.tolist()) @ turn


def _cylinder(name, radius, low, high, material):
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    ends = [np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(_SIDES, z)], axis=1) for z in (low, high)]
    made = tube(ends)
    return new_mesh(name, made.vertices, made.faces, [material])


def _fan(lattice: BeamLattice) -> bpy.types.Curve:
    """A thin line for each ring at a few azimuths, as far as the fan reaches: the road hides what lies below it."""
    azimuth, elevation = np.meshgrid(np.array(_AZIMUTHS_RAD), lattice.elevation_rad)
    directions = beam_directions(azimuth.ravel(), elevation.ravel())
    curve = bpy.data.curves.new("Beam fan", "CURVE")
    curve.dimensions, curve.bevel_depth, curve.bevel_resolution = "3D", _BEAM_RADIUS_M, 0
    for direction in (_FAN_REACH_M * directions).tolist():
        line = curve.splines.new("POLY")
        line.points.add(1)
        line.points[1].co = (*direction, 1.0)
    curve.materials.append(plain("Beam", BEAM))
    return curve
