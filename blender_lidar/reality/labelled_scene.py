"""A labelled sweep's scene out of our shapes: one closed mesh in each labelled box."""

from __future__ import annotations

import numpy as np

from ..traffic.sizes import VAN_LONGER_THAN_M
from ..world.shapes import shape, shape_of
from ..world.triangles import Triangles, place
from .labelled import LabelledBoxes

CAR = "Car"
# Labels of KITTI (and of SUSTechPOINTS, which names things alike) and the class whose shape stands for each; what has
# no shape of its own only hides others and is a plain box. People fill about half of theirs.
CLASS_OF = {CAR: "car", "Van": "van", "Truck": "truck", "Tram": "bus", "Bus": "bus", "Cyclist": "motorcycle"}
CLASS_OF |= {"Motorcycle": "motorcycle"}
LABEL_MARGIN_M = (0.15, 0.06, 0.01)
"""By how much KITTI's labels are longer, wider and higher than the cars in them [m], fitted to the tuned frames."""
_NARROW = {"Pedestrian": (0.6, 0.6, 1.0), "Person_sitting": (0.6, 0.6, 1.0), "Person": (0.6, 0.6, 1.0)}


def shape_names(boxes: LabelledBoxes) -> list[str | None]:
    """Name of the shape of each box; None for a plain box. A car longer than 4.9 m is a van, as in traffic."""
    names = []
    for label, length in zip(boxes.label.tolist(), boxes.size_m[:, 0].tolist(), strict=True):
        name = CLASS_OF.get(label)
        if name == "car" and length > VAN_LONGER_THAN_M:
            name = "van"
        names.append(None if name is None else shape_of(name, length))
    return names


def scene_triangles(boxes: LabelledBoxes, detail: str, margin_m: np.ndarray) -> Triangles:
    """Every labelled thing as triangles in the sensor's frame; `owner` is its row.

    Parameters
    ----------
    boxes : LabelledBoxes
    detail : str
        Level of detail of `world.shapes.DETAILS`.
    margin_m : ndarray, (3,)
        By how much a label's box is longer, wider and higher than the vehicle in it [m]. The shape stands on the floor.
    """
    corners, owner, surface = [np.empty((0, 3, 3))], [np.empty(0, np.int32)], [np.empty(0, np.uint8)]
    for row, name in enumerate(shape_names(boxes)):
        unit = shape("car", "box") if name is None else shape(name, detail)
        size, centre = boxes.size_m[row].copy(), boxes.centre_m[row].copy()
        if name is None:
            size *= _NARROW.get(str(boxes.label[row]), (1.0, 1.0, 1.0))
        else:
            taken = np.minimum(margin_m, 0.5 * size)
            size, centre = size - taken, centre - [0.0, 0.0, 0.5 * taken[2]]
        placed = place(unit.vertices, centre[None], size[None], boxes.heading_rad[row : row + 1])[0]
        corners.append(placed[unit.faces])
        owner.append(np.full(len(unit.faces), row, dtype=np.int32))
        surface.append(unit.surface)
    return Triangles(np.concatenate(corners), np.concatenate(owner), np.concatenate(surface))
