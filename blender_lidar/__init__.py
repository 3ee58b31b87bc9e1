"""Where should a LiDAR hang beside the road, how high and how tilted, so that it perceives the most vehicles?"""

from __future__ import annotations

__version__ = "0.1.0"

_OF_API = (
    "best_mounting",
    "judge_mounting",
    "load_scene",
    "scan_frame",
    "score_cloud",
    "score_mounting",
    "score_mountings",
)


def __getattr__(name: str):
    """The Python interface, imported when it is first asked for."""
    if name not in _OF_API:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from . import api

    return getattr(api, name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_OF_API])
