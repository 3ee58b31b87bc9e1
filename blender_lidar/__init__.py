"""Where should a LiDAR hang beside the road, how high and how tilted, so that it perceives the most vehicles?"""

from __future__ import annotations

import sys

__version__ = "0.1.0"
# As an add-on of Blender 3.4, which reads this without running it; extensions have blender_manifest.toml.
bl_info = {
    "name": "LiDAR Placement",
    "author": "The authors of blender_lidar",
    "version": (0, 1, 0),
    "blender": (3, 4, 0),
    "location": "3D View > Sidebar > LiDAR; Add > LiDAR",
    "description": "Finds where a LiDAR should hang beside a road, how high and how tilted",
    "doc_url": "https://arxiv.org/abs/2407.17942",
    "category": "3D View",
}

_LAZY = {
    "BlenderLidarError": "errors",
    "InputError": "errors",
    "Run": "results",
    "Scan": "results",
    "Score": "results",
    "best_mounting": "api",
    "judge_layout": "api",
    "judge_mounting": "api",
    "load_scene": "api",
    "mapped_by": "scoring.evaluation",
    "metric": "metrics.metric",
    "scan_frame": "api",
    "score_cloud": "api",
    "score_layout": "api",
    "score_mounting": "api",
    "score_mountings": "api",
}
__all__ = ["__version__", *_LAZY]


def __getattr__(name: str):
    """The Python interface, imported when it is first asked for."""
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f".{_LAZY[name]}", __name__), name)


def register() -> None:
    """As an add-on of Blender: show the panel.

    Raises
    ------
    RuntimeError
        In a Blender that is not supported, in one line.
    """
    if sys.version_info < (3, 11):  # noqa: UP036 - official Blenders 3.4 to 4.0 have 3.10
        text = f"LiDAR: needs Blender 4.2 or later; this one has Python {sys.version.split()[0]}, 3.11 is needed"
        raise RuntimeError(text)
    from . import addon

    addon.register()


def unregister() -> None:
    """As an add-on of Blender: take the panel away."""
    from . import addon

    addon.unregister()


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
