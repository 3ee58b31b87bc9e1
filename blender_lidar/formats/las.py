"""LAS and LAZ files of surveyors, by laspy."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np

from ..errors import MissingExtraError
from ..scan import PointCloud
from .atomic import write_bytes
from .identifiers import check_ids_fit

_RESOLUTION_M = 0.0001
_CLASSIFICATION_ROAD, _CLASSIFICATION_VEHICLE = 11, 64  # ASPRS: road surface; the first number that users may define
_USER_RECORD = 1


def write_las(path: str | Path, cloud: PointCloud, header: dict) -> None:
    """Write LAS 1.4, or LAZ by the suffix, in the road frame; ring, vehicle and class as extra dimensions.

    The GPS time is the time since the start of the revolution [s]; the intensity fills 16 bits.

    Raises
    ------
    MissingExtraError
        If laspy is not installed, or for LAZ its compression is not.
    OutputError
        If the file cannot be written, or a vehicle's id does not fit into its 32 bits.
    """
    try:
        import laspy
    except ImportError:
        raise MissingExtraError(f'{path}: needs laspy: pip install "blender_lidar[formats]"') from None
    check_ids_fit(path, cloud.vehicle_id, 32)
    las = laspy.create(point_format=6, file_version="1.4")
    las.header.scales = np.full(3, _RESOLUTION_M)
    las.header.generating_software = "blender_lidar"
    las.vlrs.append(
        laspy.VLR("blender_lidar", _USER_RECORD, "JSON header", record_data=json.dumps(header).encode("utf-8"))
    )
    for name, kind in (("ring", "u2"), ("vehicle_id", "i4"), ("class_index", "i1")):
        las.add_extra_dim(laspy.ExtraBytesParams(name, kind))
    las.x, las.y, las.z = cloud.xyz.T
    las.intensity = np.round(cloud.intensity * 65535).astype(np.uint16)
    las.gps_time = cloud.time_s
    las.return_number = las.number_of_returns = np.ones(len(cloud), dtype=np.uint8)
    las.classification = np.where(cloud.vehicle_id >= 0, _CLASSIFICATION_VEHICLE, _CLASSIFICATION_ROAD).astype(np.uint8)
    las.ring, las.vehicle_id, las.class_index = cloud.ring, cloud.vehicle_id, cloud.class_index
    packed = io.BytesIO()
    try:
        las.write(packed, do_compress=Path(path).suffix.lower() == ".laz")
    except laspy.errors.LaspyException as error:
        raise MissingExtraError(f'{path}: {error}: pip install "blender_lidar[formats]"') from None
    write_bytes(path, packed.getvalue())
