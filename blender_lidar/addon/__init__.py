"""The add-on: LiDARs as objects of Blender, and a tab in the sidebar to scan, score and place them.

Each module has its `classes`, and where it needs more `register`, `unregister`, `app_handlers` by their names in
`bpy.app.handlers`, and `menus` with what each of them draws besides.
"""

import atexit
import importlib
import inspect

import bpy

_MODULES = ("properties", "preferences", "operators", "panels", "coverage", "optimising", "handlers", "live", "baking")
_MODULES += ("gizmos", "vehicles")
_registered = []


def register() -> None:
    """Register all modules.

    bpy as a module hangs at its end if a class is left registered, so that what is left is taken back there; in a
    Blender nothing can be taken back by then.

    Raises
    ------
    RuntimeError
        In a Blender that is not supported.
    """
    if bpy.app.version < (4, 2, 0) and bpy.app.version[:2] != (3, 4):
        raise RuntimeError(f"LiDAR: needs Blender 4.2 or later; this is {bpy.app.version_string}")
    from ..compiled import within_blender  # which a Blender that is too old could not import

    if not within_blender():
        atexit.register(unregister)
    for name in _MODULES:
        module = importlib.import_module(f".{name}", __package__)
        for made in module.classes:
            _set_translation_context(made)
            bpy.utils.register_class(made)
        _registered.append(module)
        for event, call in getattr(module, "app_handlers", {}).items():
            getattr(bpy.app.handlers, event).append(call)
        for menu, draw in getattr(module, "menus", ()):
            menu.append(draw)
        if hasattr(module, "register"):
            module.register()


def _set_translation_context(made: type) -> None:
    """Give a class and its properties the translation context of the add-on: half of a panel in German helps nobody."""
    from .properties import CONTEXT  # which a Blender that is too old could not import

    made.bl_translation_context = CONTEXT
    if bpy.app.version < (4, 2):  # where properties have none
        return
    for base in made.__mro__:
        if base.__module__.startswith(__package__):
            for deferred in inspect.get_annotations(base).values():
                deferred.keywords["translation_context"] = CONTEXT


def unregister() -> None:
    """Take back all that `register` has done."""
    atexit.unregister(unregister)
    while _registered:
        module = _registered.pop()
        for event, call in getattr(module, "app_handlers", {}).items():
            if call in getattr(bpy.app.handlers, event):
                getattr(bpy.app.handlers, event).remove(call)
        for menu, draw in getattr(module, "menus", ()):
            menu.remove(draw)
        if hasattr(module, "unregister"):
            module.unregister()
        for made in reversed(module.classes):
            bpy.utils.unregister_class(made)
