"""Casting rays against triangles: one protocol, several casters, and the culling of beams that can reach nothing."""

from __future__ import annotations

import importlib
import importlib.util

from ..compiled import numba_works
from ..errors import MissingExtraError, unknown_name
from ..names import CASTERS
from ..signals import stops_deferred
from .protocol import Caster, Hits

RASTER = CASTERS[0]  # the one that rasterises whole revolutions
BVH, EXACT = CASTERS[-2:]  # by Blender's tree; the one without any

_MODULES = {
    "raster": ("numba", "fast"),
    "embree": ("embreex", "fast"),
    "bvh": ("bpy", "blender"),
    "exact": (None, None),
}

__all__ = ["BVH", "CASTERS", "EXACT", "RASTER", "Caster", "Hits", "caster_class", "is_available", "resolve"]


def is_available(name: str) -> bool:
    """Whether the library that the caster `name` stands on can be imported here."""
    library, _ = _MODULES[name]
    if library is None or importlib.util.find_spec(library) is None:
        return library is None
    return library != "numba" or numba_works()


def resolve(name: str, where: str = "") -> str:
    """The caster that `name` asks for: itself, or for "auto" the first of `raster`, `embree`, `bvh` that is here.

    Raises
    ------
    InputError
        For an unknown name.
    MissingExtraError
        When the library of the caster is not installed, naming the extra that brings it.
    """
    if name == "auto":
        for candidate in CASTERS[:-1]:
            if is_available(candidate):
                return candidate
        raise MissingExtraError(
            'no caster is installed; install one of: pip install "blender_lidar[fast]" (raster, Embree) or '
            '"blender_lidar[blender]" (Blender)'
        )
    if name not in CASTERS:
        raise unknown_name(name, ("auto", *CASTERS), "caster", where)
    if not is_available(name):
        library, extra = _MODULES[name]
        raise MissingExtraError(f'the caster {name!r} needs {library}: pip install "blender_lidar[{extra}]"')
    return name


def caster_class(name: str) -> type[Caster]:
    """The class behind a caster's name; `name` as from `resolve`."""
    with stops_deferred():  # Blender swallows what interrupts its start, or crashes
        module = importlib.import_module(f".{name}", __package__)
    return getattr(module, f"{name.capitalize()}Caster")
