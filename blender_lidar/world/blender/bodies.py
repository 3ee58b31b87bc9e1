"""Vehicles' bodies of the user's own: an object or a collection, fitted into the box of each vehicle of a class."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import bpy
import numpy as np

from ...errors import InputError, MissingFileError, unknown_name
from ..meshes import PAINT, STRUCTURE, Shape
from .objects import made_once
from .quiet import quiet
from .site import check_version, linked, visible_triangles


class OwnBody(NamedTuple):
    """A collection, what is visible of it as one mesh in the unit box, and the fit, (4, 4), that takes it there."""

    collection: bpy.types.Collection
    shape: Shape
    fit: np.ndarray


def fit_of(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """What takes a body between two corners, (3,) each, into the unit box, which it fills then: (4, 4) for columns.

    The longer of its horizontal sides is its length. One that is longer along y faces -y, as in Blender's front view,
    else it faces +x; in the box it faces +x.
    """
    fit = np.eye(4)
    if high[1] - low[1] > high[0] - low[0]:
        fit[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    ends = np.stack([low, high]) @ fit[:3, :3].T
    size = abs(ends[1] - ends[0])
    fit[:3] /= size[:, None]
    fit[:3, 3] = -ends.mean(axis=0) / size
    return fit


def body_of(collection: bpy.types.Collection, where: str) -> OwnBody:
    """What is visible of a collection, fitted into the unit box.

    Parameters
    ----------
    collection : Collection
        Of any file, in a scene or not; modifiers are applied, instances made real.
    where : str
        What an error calls it.

    Raises
    ------
    InputError
        When nothing with faces is visible in it, a vertex is not finite, or it is flat.
    """
    scene = bpy.data.scenes.new("Body")
    try:
        scene.collection.children.link(collection)
        found = visible_triangles(scene)
    finally:
        bpy.data.scenes.remove(scene)
    if not len(found):
        raise InputError(f"{where}: {collection.name}: nothing with faces is visible in it")
    low, high = found.corners.min(axis=(0, 1)), found.corners.max(axis=(0, 1))
    if not (np.isfinite(found.corners).all() and (high > low).all()):
        size = ", ".join(f"{side:g}" for side in high - low)
        raise InputError(f"{where}: {collection.name}: its size is {size}; allowed: finite, and none of them 0")
    fit = fit_of(low, high)
    vertices = found.corners.reshape(-1, 3) @ fit[:3, :3].T + fit[:3, 3]
    faces = np.arange(len(vertices)).reshape(-1, 3)
    surface = np.where(found.surface == STRUCTURE, PAINT, found.surface)  # what has no material
    return OwnBody(collection, Shape(np.clip(vertices, -0.5, 0.5), faces, surface), fit)


def read_body(file: str, name: str, where: str) -> Shape:
    """An object of a .blend file, with its children, or a collection, as `body_of` makes a mesh of it.

    Raises
    ------
    MissingFileError, InputError
        Naming `where`, when there is no such file, nothing of that name in it, or no body in that.
    """
    with quiet(), _named(file, name, where, link=True) as found:
        return body_of(found, where).shape


def kept_body(file: str, name: str, where: str) -> bpy.types.Collection:
    """The same as a collection, in no scene, that is copied into this file unless it was before; errors likewise."""

    def make():
        with quiet(), _named(file, name, where, link=False) as found:
            return found

    return made_once(bpy.data.collections, f"{Path(file).resolve()}/{name}", make)


@contextmanager
def _named(file: str, name: str, where: str, *, link: bool) -> Iterator[bpy.types.Collection]:
    """A collection of a .blend file, or one about an object of it; what is linked is gone afterwards."""
    path, there = Path(file), []
    if not path.is_file():
        raise MissingFileError(f"{where}: {path}: there is no such file")
    check_version(path)

    def choose(names, chosen):
        there.extend((*names.collections, *names.objects))
        if name in names.collections:
            chosen.collections = [name]
        elif name in names.objects:
            chosen.objects = list(names.objects)  # its children among them, which do not come along

    with linked(path, choose, link=link) as here:
        if name not in there:
            raise unknown_name(name, there, "object or collection", f"{where}: {path}")
        if here.collections:
            yield here.collections[0]
            return
        made = around(here.objects[there.index(name) - len(there)])  # a copy may be called otherwise
        try:
            yield made
        finally:
            if link:
                bpy.data.collections.remove(made)


def around(item: bpy.types.Object) -> bpy.types.Collection:
    """A new collection, in no scene, of an object and its children."""
    made = bpy.data.collections.new(item.name)
    for one in (item, *item.children_recursive):
        made.objects.link(one)
    return made
