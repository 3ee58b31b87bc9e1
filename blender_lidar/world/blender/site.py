"""Import of .blend and mesh files as scenery: what is visible, as triangles with the object that owns each."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TypeVar

import bpy
import numpy as np

from ...errors import InputError, MissingFileError
from ...names import BOX_KINDS
from ..meshes import GLASS, REFLECTIVITY, STRUCTURE, SURFACES, of_kind, surface_of
from ..scenery import NO_LABEL, Scenery, join
from .objects import DISPLAY_ONLY, ROAD_ROLE, SURFACE_KEY, VEHICLE, rendered_collections, role, to_road
from .quiet import first_error, quiet
from .road import hidden_ground

# --- Which Blender wrote a .blend file: older ones may crash on what a newer one has written, instead of saying so -

_GZIP, _ZSTANDARD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
_HEADER = re.compile(rb"BLENDER(?:[-_][vV](\d)(\d\d)|\d\d-\d\dv(\d\d)(\d\d))")  # until 4.5, and from 5.0 on
_HEADER_BYTES = 17


def check_version(path: Path) -> None:
    """Refuse a .blend file that a newer Blender has written than the one that is to read it.

    A file packed with Zstandard is let through where the library `zstandard` is not there to look into it.

    Raises
    ------
    InputError
        Naming both versions.
    """
    header = _HEADER.match(_first_bytes(path))
    written = tuple(int(number) for number in header.groups() if number) if header else (0, 0)
    if written > bpy.app.version[:2]:
        here, there = (".".join(map(str, version)) for version in (bpy.app.version[:2], written))
        raise InputError(f"{path}: was written by Blender {there}, and this is {here}; save it with an older one")


def _first_bytes(path: Path) -> bytes:
    """The first bytes of a file, unpacked; none of a file that cannot be unpacked."""
    # Each unpacker raises its own errors; Blender reports what is damaged.
    with suppress(Exception), path.open("rb") as stream:
        start = stream.read(_HEADER_BYTES)
        stream.seek(0)
        if start.startswith(_GZIP):
            return gzip.open(stream).read(_HEADER_BYTES)
        if start.startswith(_ZSTANDARD):
            import zstandard  # comes with the module bpy

            return zstandard.ZstdDecompressor().stream_reader(stream).read(_HEADER_BYTES)
        return start
    return b""


# --- What is visible, as triangles ------------------------------------------------------------------------------------

Keep = Callable[[np.ndarray], bool]
Taken = TypeVar("Taken")


def visible_triangles(
    scene: bpy.types.Scene,
    skip: Callable[..., bool] = lambda item, by: False,
    keep: Keep = lambda box: True,
    layer: bpy.types.ViewLayer | None = None,
    labels: Labels | None = None,
) -> Scenery:
    """Everything that a LiDAR would meet in a scene, with modifiers applied and instances made real.

    Seen is what both the viewport and renders show and has faces once evaluated: meshes, curves, texts, surfaces. What
    renders hide by way of a collection or of what makes the instances is hidden too. Of our own objects, markings,
    point clouds and the LiDAR itself are left out.

    Parameters
    ----------
    scene : Scene
        In its current frame; its unit scale is applied.
    skip : callable, optional
        Called with each object, and what instances it or itself; those for which it is true are left out too.
    keep : callable, optional
        Called with the eight corners (8, 3) [m] of each object's and instance's bounding box, in that frame;
        where it is false that one is left out. A forest may have far more triangles than stand within reach.
    layer : ViewLayer, optional
        As it shows the scene; the first if left out.
    labels : Labels, optional
        How triangles are labelled; not at all if left out.

    Returns
    -------
    Scenery
        In the scene's road frame, its own where it has none [m]; owners are the visible objects, and each instance is
        an owner of its own.

    Raises
    ------
    InputError
        For a road frame that is tilted or scaled.
    """
    layer = layer or scene.view_layers[0]
    layer.update()
    meshes, parts, kinds = {}, [], Kinds()

    def take(item):
        key = item.data.as_pointer()
        if key not in meshes:
            arrays = arrays_of(item.data)
            meshes[key] = *arrays, labels.of_faces(item.data, item.data.loop_triangles) if labels else None
        return item.name, kinds.of(item), labels.of(item) if labels else NO_LABEL, *meshes[key]

    found = visible_instances(scene, layer.depsgraph, lambda *of: not skip(*of), take)
    for (name, kind, number, vertices, faces, surface, box, by_face), turn, move in zip(*found, strict=True):
        if len(faces) == 0 or not keep(box @ turn + move):
            continue
        if np.linalg.det(turn) < 0.0:  # a mirror turns faces inside out
            faces = faces[:, ::-1]
        label = np.full(len(faces), number, np.int32) if by_face is None else by_face
        owner = np.zeros(len(faces), np.int32)
        parts.append(Scenery((vertices @ turn + move)[faces], owner, of_kind(surface, kind), (name,), label))
    found = join(parts)
    return replace(found, labels=labels.names(found.label)) if labels else found


def open_scenery(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> Scenery:
    """The visible objects of the user's in a scene that is open, as exact triangles: `visible_triangles` less ours.

    Raises
    ------
    InputError
        If a vertex is not finite, or the road frame is tilted or scaled.
    """
    wanted = scanned(scene, layer)
    found = visible_triangles(scene, lambda *of: not wanted(*of), layer=layer, labels=Labels(scene))
    if not np.isfinite(found.corners).all():
        row = int(np.flatnonzero(~np.isfinite(found.corners).all(axis=(1, 2)))[0])
        raise InputError(f"{found.names[found.owner[row]]!r}: has a vertex that is not finite")
    return found


def is_own(item: bpy.types.Object, *_) -> bool:
    """Whether an object is the user's: what we show of a scene, its scenery too, its settings say already."""
    return role(item) is None


def scanned(scene: bpy.types.Scene, layer: bpy.types.ViewLayer) -> Callable[..., bool]:
    """Which objects are scanned as they are shown: the user's, and of a ground that is hidden in part what is left."""
    return is_own if not hidden_ground(scene, layer) else lambda item, *_: role(item) in (None, ROAD_ROLE)


def visible_instances(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    wanted: Callable[..., bool],
    take: Callable[[bpy.types.Object], Taken],
) -> tuple[list[Taken], np.ndarray, np.ndarray]:
    """What `visible_triangles` takes of an evaluated scene, by instance.

    Returns what `take` says of the object of each, called with an evaluated one that is gone when the next one comes,
    and what takes its points, as rows, into the road frame: ``points @ turn + move`` [m], (n, 3, 3) and (n, 3). Objects
    and meshes that an instancer repeats are asked about once: a forest has 100,000 instances.
    """
    rendered = {item for shown in rendered_collections(scene.collection) for item in shown.objects}
    unit_m = scene.unit_settings.scale_length
    into = to_road(scene, depsgraph)
    known, taken, numbers = {}, [], []
    for instance in depsgraph.object_instances:
        item = instance.object
        if item.type != "MESH":
            continue
        by = instance.parent if instance.is_instance else None
        key = (item.original, item.data.as_pointer(), by) if by else None
        if key is None or key not in known:
            ours = by if by and role(by) == VEHICLE else item  # a vehicle may be made of own objects
            seen = role(item) not in DISPLAY_ONLY and wanted(ours, by or item) and _is_seen(instance, rendered)
            known[key] = take(item) if seen else None
        if known[key] is not None:
            taken.append(known[key])
            for row in instance.matrix_world:  # NumPy is ten times as slow to read one
                numbers.extend(row)
    matrix = into @ np.array(numbers, dtype=float).reshape(-1, 4, 4)
    return taken, unit_m * matrix[:, :3, :3].swapaxes(1, 2), unit_m * matrix[:, :3, 3]


def _is_seen(instance: bpy.types.DepsgraphObjectInstance, rendered: set[bpy.types.Object]) -> bool:
    """Whether renders show what the viewport shows; `rendered` are the objects in collections that they show."""
    item = instance.object
    if not instance.show_self or item.hide_render:
        return False
    if instance.is_instance:
        return not instance.parent.hide_render and instance.parent.original in rendered
    return item.original in rendered and (not item.is_instancer or item.show_instancer_for_render)


def arrays_of(mesh: bpy.types.Mesh, *, triangles: bool = True) -> tuple[np.ndarray, ...]:
    """An evaluated mesh: vertices (n, 3), triangles (m, 3), their surface (m,), corners (8, 3) of the bounding box.

    Without `triangles` there are none, and the surfaces are those of its polygons.
    """
    vertices, faces = np.empty(3 * len(mesh.vertices), np.float32), np.empty(0, np.int32)
    mesh.vertices.foreach_get("co", vertices)
    parts = mesh.polygons
    if triangles:
        mesh.calc_loop_triangles()
        parts = mesh.loop_triangles
        faces = np.empty(3 * len(parts), np.int32)
        parts.foreach_get("vertices", faces)
    made_of = _by_slot(parts, [_surface_of(material) for material in mesh.materials] or [STRUCTURE]).astype(np.uint16)
    vertices = vertices.reshape(-1, 3).astype(float)
    low, high = vertices.min(axis=0, initial=np.inf), vertices.max(axis=0, initial=-np.inf)
    box = np.array(list(product(*zip(low, high, strict=True))))
    return vertices, faces.reshape(-1, 3), made_of, box


def _by_slot(parts, values: list[int]) -> np.ndarray:
    """For each face the value of its material slot."""
    slot = np.empty(len(parts), np.int32)
    parts.foreach_get("material_index", slot)
    return np.array(values, dtype=np.int32)[np.clip(slot, 0, len(values) - 1)]


_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # Rec. 709, of linear RGB
_TRANSMISSION = ("Transmission Weight", "Transmission")  # from Blender 4.0 on, and before
_SEEN_THROUGH = 0.5


def _surface_of(material: bpy.types.Material | None) -> int:
    """Reflectivity and glass from Principled BSDF: the surface that a material stands for, bare structure for none.

    Its base colour's luminance is the diffuse reflectivity. Where that is linked, as to a texture, or there is no such
    shader, the colour that the viewport shows is taken.
    """
    if material is None or material.get(SURFACE_KEY) in range(len(REFLECTIVITY)):
        return STRUCTURE if material is None else material[SURFACE_KEY]
    colour, tree = material.diffuse_color, material.node_tree if getattr(material, "use_nodes", True) else None
    shader = next((node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"), None) if tree else None
    if shader is not None:
        through = next(shader.inputs[name] for name in _TRANSMISSION if name in shader.inputs)
        if through.default_value > _SEEN_THROUGH:
            return GLASS
        if not shader.inputs["Base Color"].is_linked:
            colour = shader.inputs["Base Color"].default_value
    return surface_of(_LUMINANCE @ np.array(colour[:3]))


# --- Kinds of the user's objects, as of [[world.boxes]] ---------------------------------------------------------------

KIND_KEY = "kind"  # custom property


class Kinds:
    """Surface classes of the user's own objects: structure, building or vegetation, as `kind` of [[world.boxes]].

    A custom property `kind` of an object, or else of a collection that holds it, says it, or their names, such as
    "Building.003" and "Buildings". The innermost collection counts.
    """

    def __init__(self) -> None:
        said = [(one, kind) for one in bpy.data.collections if (kind := _kind_said(one)) is not None]
        said.sort(key=lambda one: (-len(one[0].all_objects), -len(one[0].children_recursive)))
        self._kind = {item.as_pointer(): kind for one, kind in said for item in one.all_objects}

    def of(self, item: bpy.types.Object) -> int:
        """The kind of an evaluated object or instance, an index into `meshes.SURFACES`; structure if none is said."""
        kind = _kind_said(item.original)
        return self._kind.get(item.original.as_pointer(), STRUCTURE) if kind is None else kind


def _kind_said(block: bpy.types.Object | bpy.types.Collection) -> int | None:
    """The kind that a data-block says of itself."""
    for said in (block.get(KIND_KEY), block.name.partition(".")[0].strip().removesuffix("s")):
        if isinstance(said, str) and said.lower() in BOX_KINDS:
            return SURFACES.index(said.lower())
    return None


# --- Labels of the user's objects -------------------------------------------------------------------------------------

LABELS_BY = {"object": "objects", "collection": "collections", "pass_index": "objects", "material": "materials"}
"""What labels may come of, and the data-blocks of a file that have its names."""


class Labels:
    """Labels (semantic classes) of the user's own objects: numbers with names, by one of `LABELS_BY`, as a scene says.

    Names are numbered in alphabetical order over all that the file has, so that a number stays when others are hidden;
    the pass index is its own number. Objects in several collections have the first, those in none but the scene's none.
    """

    def __init__(self, scene: bpy.types.Scene) -> None:
        self._by = getattr(getattr(scene, "blender_lidar", None), "label_by", "object")
        blocks = [block for block in getattr(bpy.data, LABELS_BY[self._by]) if role(block) is None]
        self._names = sorted({block.name for block in blocks})
        self._number, self._within = {name: number for number, name in enumerate(self._names)}, {}
        for block in blocks if self._by == "collection" else ():
            self._within = {item.as_pointer(): block.name for item in block.objects} | self._within

    def of(self, item: bpy.types.Object) -> int:
        """The number of an evaluated object or instance; -1 where it has none, or its faces may have several."""
        if self._by == "pass_index" and is_own(item):
            return item.pass_index
        name = {"object": item.name, "collection": self._within.get(item.original.as_pointer())}.get(self._by)
        return self._number.get(name, NO_LABEL)

    def of_faces(self, mesh: bpy.types.Mesh, parts: bpy.types.bpy_prop_collection) -> np.ndarray | None:
        """The numbers (m,) of an evaluated mesh's polygons or triangles; None where the object's is that of all."""
        if self._by != "material":
            return None
        return _by_slot(parts, [self._number.get(one and one.name, NO_LABEL) for one in mesh.materials] or [NO_LABEL])

    def names(self, label: np.ndarray) -> dict[int, str]:
        """The names of the numbers among some."""
        names = str if self._by == "pass_index" else self._names.__getitem__
        return {number: names(number) for number in np.unique(label).tolist() if number != NO_LABEL}


# --- Sites of the user's own: .blend and mesh files, read as scenery --------------------------------------

# What reads a mesh file, by its suffix; the first operator that this Blender has is taken.
_IMPORTERS = {
    ".obj": ("wm.obj_import",),
    ".ply": ("wm.ply_import", "import_mesh.ply"),
    ".stl": ("wm.stl_import", "import_mesh.stl"),
    ".glb": ("import_scene.gltf",),
    ".gltf": ("import_scene.gltf",),
    ".fbx": ("wm.fbx_import", "import_scene.fbx"),
    ".usd": ("wm.usd_import",),
    ".usda": ("wm.usd_import",),
    ".usdc": ("wm.usd_import",),
    ".usdz": ("wm.usd_import",),
    ".abc": ("wm.alembic_import",),
    ".dae": ("wm.collada_import",),
}
_NOT_SCENERY = (*DISPLAY_ONLY, ROAD_ROLE, VEHICLE)  # of our own objects: the ground plane is ours already


def read_site(path: str | Path, keep: Keep | None = None) -> Scenery:
    """The visible scenery of a .blend file or of a mesh file that Blender reads, in the file's own frame [m].

    Of a .blend with several scenes the first by name counts. Where it was built by this package, it is read in its road
    frame, and its road, vehicles, LiDAR and point cloud are left out, so that such a file can be given back with
    scenery added to it. Blender's own data are afterwards as they were.

    Parameters
    ----------
    path : path
    keep : callable, optional
        As for `visible_triangles`; what it leaves may be empty.

    Raises
    ------
    MissingFileError, InputError
        If there is no such file, Blender cannot read it, or nothing with faces is visible in it.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; allowed: a .blend or mesh file")
    if not path.exists():
        raise MissingFileError(f"{path}: there is no such file")
    suffix = path.suffix.lower()
    if suffix != ".blend" and suffix not in _IMPORTERS:
        raise InputError(f"{path}: unknown kind of scene {suffix!r}; allowed: .blend, {', '.join(_IMPORTERS)}")
    if suffix == ".blend":
        check_version(path)
    with quiet(), _linked_scene(path) if suffix == ".blend" else _imported_scene(path) as scene:
        found = visible_triangles(scene, lambda item, _: role(item) in _NOT_SCENERY, keep or (lambda box: True))
    if len(found) == 0 and keep is None:
        raise InputError(f"{path}: nothing with faces is visible in it")
    if not np.isfinite(found.corners).all():
        raise InputError(f"{path}: has a vertex that is not finite")
    return found


@contextmanager
def _linked_scene(path: Path) -> Iterator[bpy.types.Scene]:
    """The first scene of a .blend file by name, linked while it lasts."""

    def choose(there, here):
        here.scenes = sorted(there.scenes)[:1]

    with linked(path, choose) as here:
        if not here.scenes or here.scenes[0] is None:
            raise InputError(f"{path}: has no scene")
        yield here.scenes[0]


@contextmanager
def linked(path: Path, choose: Callable, *, link: bool = True) -> Iterator[bpy.types.BlendData]:
    """What `choose` asks for of a .blend file's names: linked while it lasts, or else copied into this one.

    Raises
    ------
    InputError
        When Blender cannot read it, or it takes objects from a file that is not there.
    """
    before = set(bpy.data.libraries)
    try:
        with bpy.data.libraries.load(str(path.resolve()), link=link) as (there, here):
            choose(there, here)
    except (OSError, RuntimeError) as error:
        raise InputError(f"{path}: Blender {bpy.app.version_string} cannot read it; is it a .blend file?") from error
    try:
        for library in bpy.data.libraries:
            if library not in before and not Path(bpy.path.abspath(library.filepath)).exists():
                raise InputError(f"{path}: takes objects from {library.filepath}, which is not there")
        yield here
    finally:
        bpy.data.batch_remove([library for library in bpy.data.libraries if library not in before])


@contextmanager
def _imported_scene(path: Path) -> Iterator[bpy.types.Scene]:
    """A scene with what a mesh file holds, while it lasts."""
    operator = next((found for name in _IMPORTERS[path.suffix.lower()] if (found := _operator(name))), None)
    if operator is None:
        raise InputError(f"{path}: this Blender, {bpy.app.version_string}, reads no {path.suffix} files")
    window = bpy.context.window
    shown, before = window.scene, _everything()
    scene = bpy.data.scenes.new("Import")
    window.scene = scene
    try:
        try:
            operator(filepath=str(path.resolve()))
        except RuntimeError as error:  # what an operator reports
            raise InputError(f"{path}: Blender cannot read it: {first_error(error)}") from error
        yield scene
    finally:
        window.scene = shown
        bpy.data.batch_remove(_everything() - before)


def _everything():
    """All data-blocks that there are."""
    kinds = [kind.identifier for kind in bpy.data.bl_rna.properties if kind.type == "COLLECTION"]
    return {block for kind in kinds for block in getattr(bpy.data, kind)}


def _operator(name):
    """An operator by its name; None where this Blender has none of that name."""
    group, verb = name.split(".")
    return getattr(getattr(bpy.ops, group), verb) if verb in dir(getattr(bpy.ops, group)) else None
