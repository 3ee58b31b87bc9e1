"""An experiment: vehicles at the best level of detail without their wheels and mirrors."""

from __future__ import annotations

from functools import cache

import numpy as np

from ..world.detailed_shapes import detailed_parts
from ..world.meshes import Shape, joined
from ..world.shapes import shape

_ON_THE_GROUND_M = 1e-6
_MIRRORS = 2  # the last parts of every vehicle but the motorcycle, whose own stay


@cache
def bare_shape(name: str, detail: str) -> Shape:
    """`shapes.shape` at the level `detailed` without the parts that stand on the ground, and without mirrors.

    What is left stays where it was: it no longer fills its box to the ground. `detail` is not looked at.
    """
    parts = detailed_parts(name)
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    kept = parts if name == "motorcycle" else parts[:-_MIRRORS]
    bare = joined([part for part in kept if part.vertices[:, 2].min() > low[2] + _ON_THE_GROUND_M])
    made = Shape((bare.vertices - low) / (high - low) - 0.5, bare.faces, bare.surface)
    for array in (made.vertices, made.faces, made.surface):
        array.setflags(write=False)
    return made


def dropped_triangles(name: str) -> int:
    """How many triangles a shape loses."""
    return len(shape(name, "detailed").faces) - len(bare_shape(name, "detailed").faces)
