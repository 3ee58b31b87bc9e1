"""A mounting of a LiDAR: the mast, the height on it, and which way the sensor looks.

Inside the package an orientation is tilts and yaw (Eq. 2) in radians. Tables at the border have degrees, and may give a
lean with its direction and spin instead. Needs the standard library alone until a pose is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..errors import InputError

if TYPE_CHECKING:
    from ..rigid import Rigid
    from ..road.road_map import RoadMap
    from ..sensors.pose import Pose

PLACE = ("x_m", "y_m", "height_m")
ANGLES = ("tilt_x_deg", "tilt_y_deg", "yaw_deg")
LEANS = ("lean_deg", "lean_direction_deg", "spin_deg")
COORDINATES = (*PLACE, *ANGLES)
"""The coordinates of a mounting in tables: metres and degrees."""
MOUNTED = (*COORDINATES, "facing_deg")
"""The same, and which way the mast faces: all that a mounting is made of."""
COORDINATE_NAMES = {
    "height_m": ("height", "m"),
    "tilt_x_deg": ("tilt across the road", "deg"),
    "tilt_y_deg": ("tilt along the road", "deg"),
    "yaw_deg": ("yaw", "deg"),
    "lean_deg": ("lean", "deg"),
    "lean_direction_deg": ("direction of the lean", "deg"),
    "spin_deg": ("spin", "deg"),
    "x_m": ("x along the road", "m"),
    "y_m": ("y across the road", "m"),
}
"""What each is called, and its unit."""
_NO_LEAN_DEG = 1e-6
_SAME_ROTATION = 1e-6
SQUARE = 0.5 * math.pi  # the way that a mast faces whose axes are those of the site frame
_PLUMB = (0.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Mast:
    """A mast, and its frame: z plumb, y the way it faces, x to the right of y seen from above.

    Attributes
    ----------
    foot_m : (float, float, float)
        Where it meets the road's surface [m, site frame].
    facing_rad : float
        Which way it faces, counter-clockwise from +x of the site frame.
    up : (float, float, float)
        The vertical, in the site frame.
    """

    foot_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    facing_rad: float = SQUARE
    up: tuple[float, float, float] = _PLUMB

    @property
    def is_plumb(self) -> bool:
        """Whether the site frame's z is the vertical."""
        return self.up == _PLUMB

    @property
    def T_site_mast(self) -> Rigid:
        """From the mast frame, whose origin is the foot, to the site frame."""
        import numpy as np

        from ..rigid import Rigid

        right = np.array([math.sin(self.facing_rad), -math.cos(self.facing_rad), 0.0])
        up = np.array(self.up)
        x = right - (right @ up) * up
        x /= np.linalg.norm(x)
        return Rigid(np.stack([x, np.cross(up, x), up]), np.zeros(3), np.array(self.foot_m))


@dataclass(frozen=True, slots=True)
class Mounting:
    """A LiDAR on a mast.

    Attributes
    ----------
    mast : Mast
        What it hangs on.
    height_m : float
        Above the road, along the mast [m].
    tilt_x, tilt_y, yaw : float
        Orientation in the mast frame [rad], as in `sensors.pose.rotation_matrix`.
    """

    mast: Mast = Mast()
    height_m: float = 2.0
    tilt_x: float = 0.0
    tilt_y: float = 0.0
    yaw: float = 0.0

    @property
    def xy(self) -> tuple[float, float]:
        """The foot of its mast [m, site frame]."""
        return self.mast.foot_m[:2]

    @property
    def pose(self) -> Pose:
        """Where the sensor is and how it is turned, in the site frame."""
        from ..sensors.pose import Pose, rotation_matrix, tilts_of

        mast = self.mast
        place = (foot + self.height_m * up for foot, up in zip(mast.foot_m, mast.up, strict=True))
        if mast.is_plumb:
            return Pose(*place, self.tilt_x, self.tilt_y, self.yaw + (mast.facing_rad - SQUARE))
        rotation = rotation_matrix(self.tilt_x, self.tilt_y, self.yaw)
        return Pose(*place, *tilts_of(mast.T_site_mast.directions(rotation)))

    def as_table(self) -> dict[str, float | None]:
        """Its coordinates and which way its mast faces [m, degrees], and its orientation as lean, direction and spin.

        What leans by less than a millionth of a degree has no direction: None.
        """
        from ..sensors.pose import degrees_of, lean_of, rotation_matrix

        x_m, y_m = self.xy
        angles = map(degrees_of, (self.tilt_x, self.tilt_y, self.yaw))
        table = dict(zip(COORDINATES, (x_m, y_m, self.height_m, *angles), strict=True))
        lean, *turns = map(degrees_of, lean_of(rotation_matrix(self.tilt_x, self.tilt_y, self.yaw)))
        if lean < _NO_LEAN_DEG:
            lean, turns = 0.0, [None, table["yaw_deg"]]
        table["facing_deg"] = degrees_of(self.mast.facing_rad)
        return {**table, **dict(zip(LEANS, (lean, *turns), strict=True))}


Layout = tuple[Mounting | None, ...]
"""One mounting for each LiDAR of a scene, in its order; None where that LiDAR is left out."""


def poses_of(layout: Layout) -> tuple[Pose | None, ...]:
    """Where the sensors of a layout are; None where one is left out."""
    return tuple(None if mounting is None else mounting.pose for mounting in layout)


def mast_at(road: RoadMap, x_m: float, y_m: float, facing_rad: float = SQUARE) -> Mast:
    """The mast whose foot stands at a place of a site [m]."""
    import numpy as np

    return Mast((x_m, y_m, float(road.surface.height(np.array([x_m, y_m])))), facing_rad, road.up)


def hung_at(pose: Pose, road: RoadMap, facing_rad: float = SQUARE) -> Mounting:
    """The mounting that has a pose in the site frame."""
    from ..sensors.pose import tilts_of

    foot_z = 0.0
    for _ in range(9):  # the foot's height depends on its place, which a slope moves with it
        height = (pose.height_m - foot_z) / road.up[2]
        x_m, y_m = pose.x_m - height * road.up[0], pose.y_m - height * road.up[1]
        mast = mast_at(road, x_m, y_m, facing_rad)
        foot_z = mast.foot_m[2]
    height = (pose.height_m - foot_z) / road.up[2]
    if mast.is_plumb:
        return Mounting(mast, height, pose.tilt_x, pose.tilt_y, pose.yaw - (facing_rad - SQUARE))
    return Mounting(mast, height, *tilts_of(mast.T_site_mast.inverse.directions(pose.rotation)))


def has_lean(given: Mapping[str, object], where: str) -> bool:
    """Whether an orientation is given by its lean; not by tilts or yaw too, nor without saying how far it leans."""
    leans, angles = ([key for key in keys if key in given] for keys in (LEANS, ANGLES))
    if leans and angles:
        raise InputError(f"{where}: has {leans[0]} and {angles[0]}; allowed: a lean, or tilts and yaw")
    if leans and "lean_deg" not in leans:
        raise InputError(f"{where}: has {leans[0]} without lean_deg, which says how far it leans")
    return bool(leans)


def mounting_from(
    table: Mapping[str, float | None],
    road: RoadMap,
    others: Mounting | None = None,
    where: str = "mounting",
) -> Mounting:
    """The mounting that a table of coordinates gives [m, degrees], beside a road.

    Parameters
    ----------
    table : mapping of str to float
        Some of `COORDINATES`, `LEANS` and ``facing_deg``; lean direction and spin are 0 where they are left out. It may
        have both forms of one orientation, as result.json does.
    road : RoadMap
        What the mast stands on.
    others : Mounting, optional
        Has the coordinates that are left out.
    where : str
        Where it was given, for errors.

    Raises
    ------
    InputError
        When it has tilts or yaw and another lean, or a direction or spin without a lean.
    """
    table, others = {key: value for key, value in table.items() if value is not None}, others or Mounting()
    x_m, y_m = (table.get(key, own) for key, own in zip(("x_m", "y_m"), others.xy, strict=True))
    facing = math.radians(table["facing_deg"]) if "facing_deg" in table else others.mast.facing_rad
    hung = Mounting(mast_at(road, x_m, y_m, facing), table.get("height_m", others.height_m))
    angles = (others.tilt_x, others.tilt_y, others.yaw)
    angles = (math.radians(table[key]) if key in table else own for key, own in zip(ANGLES, angles, strict=True))
    tilted = replace(hung, **dict(zip(("tilt_x", "tilt_y", "yaw"), angles, strict=True)))
    both = "lean_deg" in table and all(key in table for key in ANGLES)
    if both or not has_lean(table, where):
        if both and abs(_leaning(hung, table).pose.rotation - tilted.pose.rotation).max() > _SAME_ROTATION:
            raise InputError(f"{where}: its lean is not that of its tilts and yaw; allowed: one of both")
        return tilted
    return _leaning(hung, table)


def changed_mounting(mounting: Mounting, road: RoadMap, **coordinates: float) -> Mounting:
    """A mounting with some coordinates changed [m, degrees]; another lean keeps direction and spin."""
    kept = {}
    if coordinates.keys() & set(LEANS):
        table = mounting.as_table()
        kept = {key: table[key] for key in LEANS if table[key] is not None}
    return mounting_from({**kept, **coordinates}, road, mounting)


def _leaning(hung: Mounting, table: Mapping[str, float]) -> Mounting:
    from ..sensors.pose import lean_matrix, tilts_of

    tilts = tilts_of(lean_matrix(*(math.radians(table.get(key, 0.0)) for key in LEANS)))
    return replace(hung, **dict(zip(("tilt_x", "tilt_y", "yaw"), tilts, strict=True)))
