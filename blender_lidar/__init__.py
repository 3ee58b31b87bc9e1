"""Where should a LiDAR hang beside the road, how high and how tilted, so that it perceives the most vehicles?"""

from __future__ import annotations

__version__ = "0.1.0"

_LAZY = {
    "BlenderLidarError": "errors",
    "InputError": "errors",
    "Run": "results",
    "Scan": "results",
    "Score": "results",
    "best_mounting": "api",
    "judge_mounting": "api",
    "load_scene": "api",
    "metric": "metrics.metric",
    "scan_frame": "api",
    "score_cloud": "api",
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


def __dir__() -> list[str]:
    return sorted([*globals(), *_LAZY])
