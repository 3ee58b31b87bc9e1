"""The door to `world.blender`, which says in one line what to install where Blender is missing."""

from __future__ import annotations

import importlib
from types import ModuleType

from ..errors import MissingExtraError
from ..signals import stops_deferred


def blender_room(name: str, needed_by: str) -> ModuleType:
    """The module `name` of `world.blender`.

    Raises
    ------
    MissingExtraError
        When Blender is not installed; `needed_by` says what needs it.
    """
    try:
        with stops_deferred():  # Blender swallows what interrupts its start, or crashes
            return importlib.import_module(f".blender.{name}", __package__)
    except ImportError as error:
        if error.name != "bpy":
            raise
        raise MissingExtraError(f'{needed_by}: needs Blender: pip install "blender_lidar[blender]"') from error
