"""The road as triangles: two large ones, as no caster leaks but at edges within a surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .scenery import Scenery, structure
from .shapes import ROAD


def ground_plane(centre_xy: tuple[float, float], reach_m: float) -> Scenery:
    """A square of the plane z = 0 about a place, `reach_m` to each side [m, road frame]; it faces up."""
    x, y = centre_xy
    corner = np.array([(x + a * reach_m, y + b * reach_m, 0.0) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    plane = structure("ground", corner[[[0, 1, 2], [0, 2, 3]]])
    return replace(plane, surface=np.full(2, ROAD, np.uint8))
