"""Which rivals can be timed here, and why the others cannot."""

from __future__ import annotations

import importlib
import importlib.util

from .case import FrameCase
from .rival import Rival

# Library, our module about it, what makes its rivals, and what they are for who has it not.
_RIVALS = (
    ("embreex", "rivals_embree", "embree_rivals", "raw Embree"),
    ("open3d", "rivals_open3d", "open3d_rivals", "Open3D RaycastingScene"),
    ("bpy", "rivals_blender", "blender_rivals", "Blender's BVHTree and Scene.ray_cast"),
)


def rivals_of(case: FrameCase) -> list[Rival]:
    """Every rival whose library is here."""
    return [
        rival
        for library, module, maker, _ in _RIVALS
        if _is_here(library)
        for rival in getattr(_module(module), maker)(case)
    ]


def yardsticks_of(case: FrameCase) -> list[Rival]:
    """Those alone that targets are set by: raw Embree and the naive loop."""
    found = []
    if _is_here("embreex"):
        found += _module("rivals_embree").embree_rivals(case)
    if _is_here("bpy"):
        found.append(_module("rivals_blender").naive_loop(case))
    return found


def rivals_missing() -> dict[str, str]:
    """Rivals that cannot be timed, and why."""
    return {what: f"{library} is not installed" for library, *_, what in _RIVALS if not _is_here(library)}


def _is_here(library: str) -> bool:
    return importlib.util.find_spec(library) is not None


def _module(name: str):
    return importlib.import_module(f".{name}", __package__)
