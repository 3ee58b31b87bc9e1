"""KITTI's velodyne files, and SemanticKITTI's labels beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import OutputError
from ..scan import PointCloud
from .atomic import write_bytes

# SemanticKITTI's numbers of our classes, in the order of `traffic.vehicles.CLASSES`: a van is a car there.
SEMANTIC_CLASSES = np.array([10, 10, 18, 13, 15])
ROAD = 40
_LARGEST_INSTANCE = 2**16 - 1


def write_kitti(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write ``x, y, z, intensity`` as float32 rows, and a ``.label`` file beside them.

    The frame is the levelled sensor's: origin at its optical centre, x where the LiDAR's +y looks, y to its left, z up.
    A label is uint32: the lower half SemanticKITTI's class, the upper half the vehicle's id.

    Raises
    ------
    OutputError
        If a file cannot be written, or a vehicle's id does not fit into its 16 bits.
    """
    path = Path(path)
    of_vehicle = cloud.vehicle_id >= 0
    instance = np.where(of_vehicle, cloud.vehicle_id, 0)
    if (instance > _LARGEST_INSTANCE).any():
        raise OutputError(
            f"{path}: vehicle_id {instance.max()} does not fit into the 16 bits of a .label file; .npz keeps it"
        )
    rows = np.empty((len(cloud), 4), dtype="<f4")
    rows[:, :3], rows[:, 3] = levelled(cloud.xyz, header["pose"]), cloud.intensity
    label = np.where(of_vehicle, SEMANTIC_CLASSES[cloud.class_index], ROAD) | instance << 16
    write_bytes(path.with_suffix(".label"), label.astype("<u4").tobytes())
    write_bytes(path, rows.tobytes())


def levelled(xyz: np.ndarray, pose: dict[str, float]) -> np.ndarray:
    """Points in the frame of a sensor that hangs where `pose` says, turned by its yaw and not tilted.

    Parameters
    ----------
    xyz : ndarray, (n, 3)
        Points [m, road frame].
    pose : dict
        ``x_m, y_m, height_m`` [m] and ``yaw_deg``.

    Returns
    -------
    ndarray, (n, 3)
        x along the LiDAR's +y, y along its -x, z up [m].
    """
    east, north, up = (xyz - [pose["x_m"], pose["y_m"], pose["height_m"]]).T
    cos, sin = np.cos(np.radians(pose["yaw_deg"])), np.sin(np.radians(pose["yaw_deg"]))
    across, ahead = cos * east + sin * north, cos * north - sin * east  # the LiDAR's x and y
    return np.column_stack([ahead, -across, up])
