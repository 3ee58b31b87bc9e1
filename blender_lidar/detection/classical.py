"""A detector without training: background subtraction in the range image, DBSCAN clusters, L-shape fitting.

The sensor does not move, so that what each beam usually meets is the empty scene. Needs scikit-learn for DBSCAN.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..clouds.scan import PointCloud
from ..errors import MissingExtraError
from ..sensors.beams import BeamLattice
from ..sensors.imperfections import PERFECT, Imperfections
from ..traffic.boxes import KINDS, Boxes, boxes_of_rows, no_boxes, suppressed
from .ground import Ground, fit_ground
from .l_shape import LONG_M, USUAL_M, LShape, l_shape_heading

_CAR, _LARGE, _SMALL = (KINDS.index(name) for name in ("car", "truck or bus", "motorcycle"))
_USUAL_OF_KIND_M = {_CAR: USUAL_M["car"], _LARGE: USUAL_M["truck"], _SMALL: USUAL_M["motorcycle"]}
_HIGHER_M = 2.4  # than any car
_NARROW_M = 1.0  # a motorcycle, where both its length and its width are seen
_MOST_IOU = 0.1


# What was tuned, on the shipped traffic at another station (Local_Y 330 m) than the shipped scene's.
_QUANTILE = 0.9  # of the ranges that a beam measures in the frames that teach the background: vehicles come nearer
_LEAST_SHARE = 0.9  # of those frames, in which a beam must return for a background: else it looks into the sky
_NEARER_M, _NEARER_DEVIATIONS = 0.3, 5.0  # a return is no background nearer by these, the second of the range noise
_APART_M, _LEAST_POINTS = 0.9, 2  # DBSCAN's epsilon, seen from above, and the fewest points of a cluster
_SURE_POINTS = 5.0  # of a cluster, that make a confidence of a half
_TURNED_POINTS = 40  # with fewer the heading is the road's


def dbscan_class() -> type:
    """scikit-learn's DBSCAN.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        from sklearn.cluster import DBSCAN
    except ImportError as error:
        text = 'the classical detector needs scikit-learn: pip install "blender_lidar[detect]"'
        raise MissingExtraError(text) from error
    return DBSCAN


class ClassicalDetector:
    """Background subtraction, DBSCAN (Ester et al. 1996) and L-shape fitting (Zhang et al. 2017, IV 2017).

    Parameters
    ----------
    lattice : BeamLattice
        The sensor's beams.
    lidar_xy : (float, float)
        Where it hangs [m, road frame].
    imperfections : Imperfections
        Its range noise and drop-out, of which the background must make nothing.

    Raises
    ------
    MissingExtraError
        If scikit-learn is not installed.
    """

    name, learns = "classical", True

    def __init__(
        self, lattice: BeamLattice, lidar_xy: tuple[float, float], imperfections: Imperfections = PERFECT
    ) -> None:
        self._lattice, self.lidar_xy = lattice, np.array(lidar_xy)
        self.cluster = dbscan_class()(eps=_APART_M, min_samples=_LEAST_POINTS)
        self._background = np.full(lattice.rings * lattice.columns, np.inf)
        self._nearer_m = _NEARER_M + _NEARER_DEVIATIONS * imperfections.range_noise_m
        self._dropout = imperfections.dropout

    def range_image(self, cloud: PointCloud) -> np.ndarray:
        """Range of each beam, (beams,) float32 [m]; inf where nothing returned."""
        image = np.full(len(self._background), np.inf, dtype=np.float32)
        image[self.beam(cloud)] = cloud.range_m
        return image

    def learn(self, range_images: Sequence[np.ndarray]) -> None:
        """Take from some frames what each beam meets of the scene without vehicles; nothing where few return.

        A beam may return in fewer frames by as many as drop-out takes, with three standard deviations.
        """
        images = np.sort(range_images, axis=0)
        returned = np.isfinite(images).sum(axis=0)
        at = np.ceil(_QUANTILE * (returned - 1)).astype(int)
        background = np.take_along_axis(images, np.maximum(at, 0)[None], axis=0)[0]
        lost = len(images) * self._dropout
        needed = _LEAST_SHARE * len(images) - lost - 3.0 * math.sqrt(lost * (1.0 - self._dropout))
        self._background = np.where(returned >= max(needed, 1.0), background, np.inf)

    def beam(self, cloud: PointCloud) -> np.ndarray:
        """Flat index of each point's beam in the lattice, ``ring * columns + slot``."""
        ring = cloud.ring.astype(np.int64)
        slot = np.rint((cloud.azimuth_rad - self._lattice.slot_azimuth0_rad[ring]) / self._lattice.step_rad)
        return ring * self._lattice.columns + slot.astype(np.int64) % self._lattice.columns

    def notes(self, seen: Sequence[None] = ()) -> Sequence[str]:
        """Nothing: it learns from where it looks."""
        return ()

    def detect(self, cloud: PointCloud) -> tuple[Boxes, None]:
        """The vehicles of one frame, and nothing for `notes`."""
        return early_fusion([self], [self.foreground(cloud)]), None

    def nearer(self, cloud: PointCloud) -> np.ndarray:
        """Which points lie before the background of their beams, (n,) bool."""
        return cloud.range_m < self._background[self.beam(cloud)] - self._nearer_m

    def foreground(self, cloud: PointCloud) -> tuple[np.ndarray, Ground]:
        """The points before the background, (n, 3) with heights from the ground [m], and the ground."""
        nearer = self.nearer(cloud)
        from_lidar = cloud.xyz - [*self.lidar_xy, 0.0]
        ground = fit_ground(from_lidar)
        return np.column_stack([cloud.xyz[nearer, :2], ground.above(from_lidar[nearer])]), ground

    @staticmethod
    def box(points: np.ndarray, lidars: np.ndarray) -> tuple[float, ...]:
        """The box of one cluster (n, 3) [m], a row of `boxes_of_rows`: as large as a vehicle, away from the LiDARs.

        Heights are counted from the ground; `lidars` (m, 2) are those that see it.
        """
        heading = 0.0 if len(points) < _TURNED_POINTS else l_shape_heading(points[:, :2])
        shape, top, kind = LShape.about(points[:, :2], heading), float(points[:, 2].max()), _CAR
        if shape.seen[0] > LONG_M or top > _HIGHER_M:
            kind = _LARGE
        elif shape.seen.max() < _USUAL_OF_KIND_M[_SMALL][0] and shape.seen[1] < _NARROW_M < shape.seen[0]:
            kind = _SMALL
        length, width, height = _USUAL_OF_KIND_M[kind]
        size, height = np.maximum(shape.seen, (length, width)), max(top, height)
        centre, confidence = shape.centre(size, lidars), len(points) / (len(points) + _SURE_POINTS)
        return (*centre.tolist(), 0.5 * height, *size.tolist(), height, heading, kind, confidence)


def early_fusion(detectors: Sequence[ClassicalDetector], foregrounds: Sequence[tuple[np.ndarray, Ground]]) -> Boxes:
    """The vehicles of one frame in the clouds of several LiDARs together: each one's `foreground`, clustered as one."""
    parts, grounds = zip(*foregrounds, strict=True)
    points, owner = np.concatenate(parts), np.repeat(np.arange(len(parts)), list(map(len, parts)))
    lidars = np.array([one.lidar_xy for one in detectors])
    if not len(points):
        return no_boxes()
    label = detectors[0].cluster.fit_predict(points[:, :2])
    order = np.argsort(label, kind="stable")
    ends = np.flatnonzero(np.diff(label[order], append=label.max() + 1)) + 1
    clusters = [rows for rows in np.split(order, ends[:-1]) if label[rows[0]] >= 0]  # -1: DBSCAN's noise
    rows = [ClassicalDetector.box(points[rows], lidars[np.unique(owner[rows])]) for rows in clusters]
    boxes = suppressed(boxes_of_rows(rows), _MOST_IOU)
    away = boxes.centre_m[None, :, :2] - lidars[:, None]
    heights = np.array([ground.height(off) for ground, off in zip(grounds, away, strict=True)])
    nearest = np.hypot(away[..., 0], away[..., 1]).argmin(axis=0)
    boxes.centre_m[:, 2] += heights[nearest, np.arange(len(boxes))]
    return boxes
