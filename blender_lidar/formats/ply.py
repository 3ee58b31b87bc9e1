"""PLY files, which mesh and cloud viewers open: http://paulbourke.net/dataformats/ply."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from ..scan import PointCloud
from .atomic import write_bytes
from .identifiers import check_ids_fit

# Name, PLY type and NumPy type of each property.
_PROPERTIES = (
    ("x", "float", "<f4"),
    ("y", "float", "<f4"),
    ("z", "float", "<f4"),
    ("intensity", "float", "<f4"),
    ("ring", "ushort", "<u2"),
    ("time", "double", "<f8"),
    ("vehicle_id", "int", "<i4"),
    ("class", "char", "<i1"),
)


def write_ply(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write a binary file in the road frame; class counts into `traffic.vehicles.CLASSES`, -1 is no vehicle.

    Raises
    ------
    OutputError
        If the file cannot be written, or a vehicle's id does not fit into its 32 bits.
    """
    check_ids_fit(path, cloud.vehicle_id, 32)
    record = np.zeros(len(cloud), dtype=[(name, kind) for name, _, kind in _PROPERTIES])
    for axis, name in enumerate("xyz"):
        record[name] = cloud.xyz[:, axis]
    record["intensity"], record["ring"], record["time"] = cloud.intensity, cloud.ring, cloud.time_s
    record["vehicle_id"], record["class"] = cloud.vehicle_id, cloud.class_index
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {json.dumps(header)}",
        f"element vertex {len(cloud)}",
        *(f"property {kind} {name}" for name, kind, _ in _PROPERTIES),
        "end_header",
    ]
    write_bytes(path, ("\n".join(lines) + "\n").encode("ascii") + record.tobytes())
