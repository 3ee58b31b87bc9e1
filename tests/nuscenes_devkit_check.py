"""Count the points in every box of a nuScenes data set with nuScenes' own devkit, which wants an older NumPy.

``python nuscenes_devkit_check.py DIR``, in an environment of its own with nuscenes-devkit: prints one JSON object with
the counts of the devkit and those that the tables say, by annotation, and the scenes of both splits.
"""

from __future__ import annotations

import json
import sys

MARGIN_M = 0.01  # points lie on the sides of boxes


def main(folder: str) -> None:
    from nuscenes.nuscenes import NuScenes
    from nuscenes.utils.data_classes import LidarPointCloud
    from nuscenes.utils.geometry_utils import points_in_box
    from nuscenes.utils.splits import get_scenes_of_split

    tables = NuScenes(version="v1.0-trainval", dataroot=folder, verbose=False)
    found, message = {}, {}
    for sample in tables.sample:
        path, boxes, _ = tables.get_sample_data(sample["data"]["LIDAR_TOP"])
        points = LidarPointCloud.from_file(path).points[:3]
        for box in boxes:
            box.wlh = box.wlh + 2.0 * MARGIN_M
            found[box.token] = int(points_in_box(box, points).sum())
            message[box.token] = tables.get("sample_annotation", box.token)["num_lidar_pts"]
    scenes = {split: get_scenes_of_split(split, tables) for split in ("site_train", "site_val")}
    sys.stdout.write(json.dumps({"found": found, "stated": message, "scenes": scenes}) + "\n")


if __name__ == "__main__":
    main(sys.argv[1])
