"""PointPillars: vehicles found in one point cloud by a neural network that was trained in simulated roadside scenes.

Inference needs NumPy alone. The weights ship with the package; scripts/research/train_detector.py makes them again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..clouds.scan import PointCloud
from ..errors import InputError, printable
from ..files import read_npz, reading
from ..sensors.pose import Pose
from ..toml_table import Setting, TomlTable
from ..traffic.boxes import Boxes, detected_boxes, no_boxes, suppressed
from .ground import Ground, fit_ground
from .pillar_network import COARSEST, HEAT, LEVEL, OFFSET, SIZE, STRIDE, TURN, Weights, forward, shapes

PILLAR_M = 0.4
GROUND_M = 0.15  # what lies lower above the fitted ground is ground
_HIGHEST_M = 6.0  # nothing above is of a vehicle
# Ground with nothing above it is not shown beyond: weak returns left little of it in the training, and where a scene
# has it, gaps in it were taken for vehicles.
_BARE_GROUND_M = 52.0
_LEAST_CONFIDENCE = 0.05
_MOST_IOU = 0.1
_MOST_BOXES = 500  # in one frame
SHIPPED = Path(__file__).with_name("data") / "pillars.npz"


# --- Pillars ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Area:
    """The cells that the network looks at: where the first begins [m, from the LiDAR], and how many there are."""

    first_m: tuple[float, float]
    along: int
    across: int

    @classmethod
    def around(cls, low: np.ndarray, high: np.ndarray) -> Area:
        """The cells that cover a rectangle from `low` to `high`, x and y [m, from the LiDAR]."""
        coarse = COARSEST * PILLAR_M
        first = np.floor(np.asarray(low) / coarse)
        along, across = (COARSEST * np.maximum(np.ceil(np.asarray(high) / coarse) - first, 1)).astype(int).tolist()
        return cls(tuple((coarse * first).tolist()), along, across)

    def holds(self, xy: np.ndarray) -> np.ndarray:
        """Which places (n, 2) [m, from the LiDAR] lie in it, (n,) bool."""
        last = np.array(self.first_m) + PILLAR_M * np.array([self.along, self.across])
        return ((xy >= self.first_m) & (xy < last)).all(axis=1)


class Pillars(NamedTuple):
    """What the network is shown of one frame: arguments of `pillar_network.forward`, all float32."""

    points: np.ndarray
    cell: np.ndarray
    cells: np.ndarray


def pillars_of(
    points: np.ndarray, ground: Ground, lidar_m: float, area: Area, bare_ground_m: float = math.inf
) -> Pillars:
    """Points sorted into pillars, with their features; those on the ground are only counted.

    Parameters
    ----------
    points : ndarray, (n, 3)
        x and y counted from the LiDAR [m].
    ground : Ground
        What heights are counted from.
    lidar_m : float
        Height of the LiDAR [m].
    area : Area
    bare_ground_m : float
        Farther from the LiDAR, points on the ground count only in cells with points above it [m].
    """
    column = np.floor((points[:, :2] - area.first_m) / PILLAR_M).astype(np.int64)
    height = ground.above(points)
    inside = (column >= 0).all(axis=1) & (column < (area.along, area.across)).all(axis=1) & (height < _HIGHEST_M)
    flat = column[:, 0] * area.across + column[:, 1]
    count = area.along * area.across
    raised = inside & (height > GROUND_M)
    on_ground = np.bincount(flat[inside & ~raised], minlength=count)
    rows = np.flatnonzero(raised)
    rows = rows[np.argsort(flat[rows], kind="stable")]
    cell, xyz = flat[rows], np.column_stack([points[rows, :2], height[rows]])
    here = np.bincount(cell, minlength=count)
    mean = np.column_stack([np.bincount(cell, axis, count) for axis in xyz.T]) / np.maximum(here, 1)[:, None]
    middle = np.array(area.first_m) + (column[rows] + 0.5) * PILLAR_M
    reach = np.hypot(xyz[:, 0], xyz[:, 1])
    features = np.column_stack(
        [
            (xyz[:, :2] - middle) / PILLAR_M,
            xyz[:, 2],
            xyz - mean[cell],
            np.log1p(here[cell]) / 3.0,
            reach / 50.0,
            (lidar_m - xyz[:, 2]) / np.maximum(reach, 1.0),
        ]
    )
    return Pillars(features.astype(np.float32), cell, _cell_features(area, on_ground, here, bare_ground_m))


def _cell_features(area: Area, on_ground: np.ndarray, raised: np.ndarray, bare_ground_m: float) -> np.ndarray:
    """Points on the ground and above it, and where the LiDAR is seen from each cell, (1, x, y, 5)."""
    x, y = (
        first + (np.arange(count) + 0.5) * PILLAR_M
        for first, count in zip(area.first_m, (area.along, area.across), strict=True)
    )
    x, y = np.meshgrid(x, y, indexing="ij")
    away = np.hypot(x, y)
    on_ground, raised = on_ground.reshape(x.shape), raised.reshape(x.shape)
    on_ground = np.where((away > bare_ground_m) & (raised == 0), 0, on_ground)
    counts = (np.log1p(one) / 3.0 for one in (on_ground, raised))
    return np.stack([*counts, x / away, y / away, away / 50.0], axis=-1).astype(np.float32)[None]


# --- Boxes ------------------------------------------------------------------------------------------------------------


def boxes_of(output: np.ndarray, area: Area) -> Boxes:
    """Boxes of one frame, the surest of each place: x and y from the LiDAR, z above the ground [m].

    Parameters
    ----------
    output : ndarray, (x, y, OUTPUTS)
        What the network made of the area.
    area : Area
    """
    heat = 0.5 * (1.0 + np.tanh(0.5 * output[..., HEAT]))  # the logistic function, which never overflows
    sure = heat.max(axis=-1)
    padded = np.pad(sure, 1)
    around = np.max([padded[i : i + sure.shape[0], j : j + sure.shape[1]] for i in range(3) for j in range(3)], axis=0)
    x, y = np.nonzero((sure >= _LEAST_CONFIDENCE) & (sure == around))
    strongest = np.argsort(-sure[x, y], kind="stable")[:_MOST_BOXES]
    x, y = x[strongest], y[strongest]
    if not len(x):
        return no_boxes()
    one, side = output[x, y].astype(float), STRIDE * PILLAR_M
    centre = np.array(area.first_m) + side * (np.column_stack([x, y]) + 0.5 + one[:, OFFSET])
    sine, cosine = one[:, TURN].T
    found = detected_boxes(
        np.column_stack([centre, one[:, LEVEL]]),
        np.exp(np.clip(one[:, SIZE], *_LOG_SIZES)),
        0.5 * np.arctan2(sine, cosine),
        heat[x, y].argmax(axis=-1).astype(np.int8),
        sure[x, y].astype(float),
    )
    return suppressed(found, _MOST_IOU)


_LOG_SIZES = math.log(0.3), math.log(30.0)


# --- The detector -----------------------------------------------------------------------------------------------------


class PillarsDetector:
    """PointPillars with the weights that ship, or others.

    Parameters
    ----------
    sensor : str
        Name of the sensor's model.
    pose : Pose
        Where the LiDAR is believed to hang.
    low, high : (float, float)
        Corners of the rectangle in which vehicles are looked for, x and y [m, road frame].
    weights : path
        As scripts/research/train_detector.py writes them.

    Raises
    ------
    MissingFileError, InputError
        If the weights cannot be read, or are of another network.
    """

    name, learns = "pillars", False

    def __init__(
        self,
        sensor: str,
        pose: Pose,
        low: Sequence[float],
        high: Sequence[float],
        weights: str | Path | None = None,
    ) -> None:
        self._weights, self._trained = load_weights(SHIPPED if weights is None else weights)
        self._sensor, self._pose, self._lidar = sensor, pose, pose.position
        self._area = Area.around(np.asarray(low) - self._lidar[:2], np.asarray(high) - self._lidar[:2])
        self._notes: list[str] = []

    def check_headings(self, heading_rad: np.ndarray) -> None:
        """Note where vehicles, by their headings (n,) [rad], do not drive along x as those of the training did."""
        astray = float((np.abs(np.sin(heading_rad)) > math.sin(_ALONG_RAD)).mean()) if len(heading_rad) else 0.0
        if astray > _MOST_ASTRAY:
            off = f"{100.0 * astray:.0f} % of the vehicles stand more than {math.degrees(_ALONG_RAD):.0f} degrees off x"
            self._notes.append(f"{self.name}: {off}; its training had none of these, and it finds them less well")

    def detect(self, cloud: PointCloud) -> tuple[Boxes, tuple[float, float]]:
        """The vehicles of one frame; and for `notes` how uneven its ground is [m], and its `density`.

        Raises
        ------
        InputError
            For points that are not finite.
        """
        if not np.isfinite(cloud.xyz).all():
            row = int(np.flatnonzero(~np.isfinite(cloud.xyz).all(axis=1))[0])
            raise InputError(f"point {row} of the cloud is {cloud.xyz[row].tolist()}; allowed: finite coordinates")
        points = cloud.xyz - [*self._lidar[:2], 0.0]
        points = points[self._area.holds(points[:, :2])]
        ground = fit_ground(points)
        pillars = pillars_of(points, ground, float(self._lidar[2]) - ground.level, self._area, _BARE_GROUND_M)
        seen = ground.residual_m, density(pillars)
        if not len(pillars.cell):
            return no_boxes(), seen
        boxes = boxes_of(forward(self._weights, *pillars)[0], self._area)
        boxes.centre_m[:, 2] += ground.height(boxes.centre_m[:, :2])
        boxes.centre_m[:, :2] += self._lidar[:2]
        return boxes, seen

    def notes(self, seen: Sequence[tuple[float, float]] = ()) -> Sequence[str]:
        """Where the sensor, its mounting or the clouds that were `seen` are unlike the training's, as sentences."""
        trained, words = self._trained, [*self._notes]
        if self._sensor not in trained["sensors"]:
            words.append(f"{self.name} was trained on {', '.join(trained['sensors'])}, not on {self._sensor}")
        lean = math.degrees(math.acos(min(1.0, float(self._pose.rotation[2, 2]))))
        mounting = {"height_m": (self._pose.height_m, "hangs {} m high"), "lean_deg": (lean, "leans by {} degrees")}
        residual, points = np.array(seen).reshape(-1, 2).T
        if len(residual) and np.isnan(residual).mean() > 0.5:
            words.append(f"{self.name}: most clouds have too little ground for a plane; heights are counted from z = 0")
        elif len(residual):
            mounting["residual_m"] = (float(np.nanmedian(residual)), "sees ground that is {} m uneven in the median")
        if len(points):
            mounting["density"] = (float(np.median(points)), "has {} points in a filled cell")
        for key, (value, text) in mounting.items():
            low, high = trained[key]
            if not low - _SLACK * (high - low) <= value <= high + _SLACK * (high - low):
                is_so = text.format(f"{value:.3g}")
                words.append(f"{self.name}: the LiDAR {is_so}, but from {low:.3g} to {high:.3g} in its training")
        return words


_ALONG_RAD, _MOST_ASTRAY = math.radians(15.0), 0.05  # share of the vehicles
_SLACK = 0.02  # of a range: what is no farther beyond it lies within


def density(pillars: Pillars) -> float:
    """Points above the ground in each cell that has any, in the mean; 0 without any."""
    return len(pillars.cell) / max(len(np.unique(pillars.cell)), 1)


@cache
def load_weights(path: str | Path) -> tuple[Weights, Mapping[str, object]]:
    """Weights in float32, and what they were trained on as the model card beside them says.

    Raises
    ------
    MissingFileError, InputError
        If they cannot be read, are of another network, or their card does not say what they were trained on.
    """
    with reading(path, "weights of PointPillars, .npz"):
        try:
            found = read_npz(path)
            card = json.loads(str(found.pop("card", "null")))
        except ValueError as error:
            raise InputError(f"{path}: is no file of weights, .npz: {printable(str(error))}") from error
    needed = shapes()
    wrong = next((name for name in {**needed, **found} if np.shape(found.get(name)) != needed.get(name)), None)
    if wrong is not None:
        raise InputError(f"{path}: holds weights of another network; needed: {wrong} {needed.get(wrong, 'not at all')}")
    if not all(array.dtype.kind == "f" and np.isfinite(array).all() for array in found.values()):
        raise InputError(f"{path}: holds weights that are not finite numbers")
    table = TomlTable(card, f"{path}: its card").table("trained_on")
    trained = table.read(_TRAINED_ON)
    return {name: array.astype(np.float32) for name, array in found.items()}, trained


_RANGE = Setting(kind=tuple[float, float])
_TRAINED_ON = {
    "sensors": Setting(kind=tuple[str, ...]),
    **dict.fromkeys(("height_m", "lean_deg", "residual_m", "density"), _RANGE),
}
