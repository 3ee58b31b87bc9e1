"""A mounting of the LiDAR: where it hangs and how it leans, as a scene file gives it, and the places that are searched.

The orientation is given by tilts and yaw (Eq. 2), or in their place by its lean, the lean's direction and its spin.
Like the other settings it needs the standard library alone, so that help opens at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from ..errors import InputError
from ..road import RoadFrame
from ..toml_table import setting, settings_of

if TYPE_CHECKING:
    from ..sensors.pose import Pose

ANGLES = ("tilt_x_deg", "tilt_y_deg", "yaw_deg")
LEANS = ("lean_deg", "lean_direction_deg", "spin_deg")
_TURNS = ("yaw_deg", "lean_direction_deg", "spin_deg")  # of which 360 degrees are a full circle
HEADING = {"low": -360.0, "high": 360.0}
_NO_LEAN_DEG = 1e-6
_SAME_ROTATION = 1e-6


@dataclass(frozen=True, slots=True)
class MountingSettings:
    """[baseline], and a mounting given by options: the height is that of the paper's section V.A.

    Attributes
    ----------
    x_m : float
        Along the road, in the direction of travel.
    y_m : float
        Across the road, to the left.
    height_m : float
        Above the road.
    tilt_x_deg : float
        Across the road, positive looks down towards +y.
    tilt_y_deg : float
        Along the road, positive raises the side ahead.
    yaw_deg : float
        Counter-clockwise seen from above.
    """

    x_m: float = setting(0.0, low=-1e5, high=1e5, option="--x")
    y_m: float = setting(0.0, low=-1e5, high=1e5, option="--y")
    height_m: float = setting(2.0, low=0.1, high=100.0, option="--height")
    tilt_x_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-x", rivals=LEANS)
    tilt_y_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-y", rivals=LEANS)
    yaw_deg: float = setting(0.0, option="--yaw", rivals=LEANS, **HEADING)


@dataclass(frozen=True, slots=True)
class LeanSettings:
    """The same orientation as both tilts and yaw, and in their place: see `sensors.pose.lean_matrix`.

    Attributes
    ----------
    lean_deg : float or None
        How far it leans from upright.
    lean_direction_deg : float
        Which way it leans and looks down, counter-clockwise seen from above, 0 towards +y.
    spin_deg : float
        Turn about its own axis, counter-clockwise; it matters to a sensor whose columns are uneven.
    """

    lean_deg: float | None = setting(None, low=0.0, high=90.0, option="--lean", rivals=ANGLES)
    lean_direction_deg: float | None = setting(None, option="--lean-direction", rivals=ANGLES, **HEADING)
    spin_deg: float | None = setting(None, option="--spin", rivals=ANGLES, **HEADING)


MOUNTING = settings_of(MountingSettings)
LEAN = settings_of(LeanSettings)
MOUNTING_OR_LEAN = MOUNTING | LEAN
"""All coordinates by which a mounting can be given."""
COORDINATES = tuple(MOUNTING)
COORDINATE_LIMITS = {key: (declared.low, declared.high) for key, declared in MOUNTING.items()}
SEARCHED = {"height_m": (2.0, 4.5), "tilt_x_deg": (0.0, 25.0)}
"""What [deployment] searches unless said: the paper's ranges, section V.A."""
DEPLOYMENT = {
    key: replace(declared, kind=float | tuple[float, float], default=SEARCHED.get(key, declared.default))
    for key, declared in MOUNTING_OR_LEAN.items()
}
"""[deployment]: a number fixes a coordinate, a pair [low, high] has it searched."""
for _key in ("x_m", "y_m"):
    DEPLOYMENT[_key] = replace(DEPLOYMENT[_key], form='several places are a table of poles: poles = "poles.csv"')


@dataclass(frozen=True, slots=True)
class Pole:
    """A candidate place: a row of the table of [deployment] poles.

    Attributes
    ----------
    name : str
    x_m, y_m : float
        Where it stands [m, road frame].
    foot_z_m : float
        Its foot above the road plane [m].
    height_min_m, height_max_m : float or None
        Between what heights above its foot a LiDAR can hang [m]; those of [deployment] unless said.
    cost : float or None
    existing : bool or None
        Whether it stands already.
    """

    name: str
    x_m: float
    y_m: float
    foot_z_m: float = 0.0
    height_min_m: float | None = None
    height_max_m: float | None = None
    cost: float | None = None
    existing: bool | None = None


@dataclass(frozen=True, slots=True)
class Deployment:
    """[deployment]: which coordinates of the mounting are fixed, and between what bounds the others are searched.

    Attributes
    ----------
    fixed : mapping of str to float
        Coordinates that stay; those of the orientation are tilts and yaw, or lean, direction and spin.
    bounds : mapping of str to (float, float)
        The others, in the order of `MOUNTING_OR_LEAN`; metres and degrees.
    poles : tuple of Pole
        Candidate places, each searched by itself; none where x and y say the place.
    poles_file : str or None
        The table that they come from.
    road : RoadFrame
        Whose slopes `pose` knows.
    """

    fixed: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    poles: tuple[Pole, ...] = ()
    poles_file: str | None = None
    road: RoadFrame = field(default=RoadFrame(), repr=False)

    def at(self, pole: Pole) -> Deployment:
        """The same search on one pole: its place, and its heights where it has its own, above the road plane."""
        height = self.bounds.get("height_m") or (self.fixed["height_m"],) * 2
        own = pole.height_min_m, pole.height_max_m
        low, high = (usual if end is None else pole.foot_z_m + end for usual, end in zip(height, own, strict=True))
        fixed = {**self.fixed, "x_m": pole.x_m, "y_m": pole.y_m, "height_m": low}
        bounds = {**self.bounds, "height_m": (low, high)}
        (bounds if low == high else fixed).pop("height_m")
        return Deployment(fixed, {key: bounds[key] for key in MOUNTING_OR_LEAN if key in bounds}, road=self.road)

    @property
    def places(self) -> tuple[Deployment, ...]:
        """What is searched, place by place: on each pole, or itself."""
        return tuple(map(self.at, self.poles)) or (self,)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the searched coordinates."""
        return tuple(self.bounds)

    @property
    def lower(self) -> tuple[float, ...]:
        return tuple(low for low, _ in self.bounds.values())

    @property
    def upper(self) -> tuple[float, ...]:
        return tuple(high for _, high in self.bounds.values())

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Which searched coordinates are full circles, on which neither bound is an end."""
        return tuple(key in _TURNS and high - low == 360.0 for key, (low, high) in self.bounds.items())

    @property
    def axes(self) -> tuple[str, str]:
        """The height, and what the sensor looks down by: its lean, or the tilt across the road."""
        leans = "lean_deg" in self.fixed or "lean_deg" in self.bounds
        return "height_m", "lean_deg" if leans else "tilt_x_deg"

    @property
    def nominal_xy(self) -> tuple[float, float]:
        """The mount's place [m], or the middle of where it may be."""
        if self.poles:
            places = [[pole.x_m for pole in self.poles], [pole.y_m for pole in self.poles]]
            return tuple(0.5 * (min(one) + max(one)) for one in places)
        return tuple(0.5 * sum(self.bounds[key]) if key in self.bounds else self.fixed[key] for key in ("x_m", "y_m"))

    def coordinates(self, x) -> dict[str, float]:
        """All six coordinates (metres, degrees) at the point `x` (d,) of the search space."""
        return six_coordinates(self.given(x))

    def given(self, x) -> dict[str, float]:
        """The same by the coordinates that are fixed or searched: a lean of 0 keeps its direction."""
        return {**self.fixed, **dict(zip(self.variables, map(float, x), strict=True))}

    def pose(self, x) -> Pose:
        """The mounting at the point `x` (d,) of the search space."""
        return pose_at(self.coordinates(x), self.road)


@dataclass(frozen=True, slots=True)
class Tolerance:
    """[objective] tolerance: how far off its plan a mounting may end up, as half-widths.

    Each error is uniform between minus and plus its half-width and independent of the others. Beyond the limits it is
    another mounting and not an error. `tilt_deg` is of both tilts: the inclinometer that sets the one sets the other
    too. `aim` says what is maximised of the objective over these errors: its mean, or what it reaches in nine cases of
    ten.
    """

    height_m: float = setting(0.0, low=0.0, high=1.0)
    tilt_deg: float = setting(0.0, low=0.0, high=10.0)
    yaw_deg: float = setting(0.0, low=0.0, high=10.0)
    aim: str = setting("mean", allowed=("mean", "low"))

    @property
    def half_widths(self) -> dict[str, float]:
        """Of each of `COORDINATES` that is not exact, in their order [m, degrees]."""
        widths = (0.0, 0.0, self.height_m, self.tilt_deg, self.tilt_deg, self.yaw_deg)
        return {key: width for key, width in zip(COORDINATES, widths, strict=True) if width > 0.0}


def has_lean(given: Mapping[str, object], where: str) -> bool:
    """Whether an orientation is given by its lean; not by tilts or yaw too, nor without saying how far it leans."""
    leans, angles = ([key for key in keys if key in given] for keys in (LEANS, ANGLES))
    if leans and angles:
        raise InputError(f"{where}: has {leans[0]} and {angles[0]}; allowed: a lean, or tilts and yaw")
    if leans and "lean_deg" not in leans:
        raise InputError(f"{where}: has {leans[0]} without lean_deg, which says how far it leans")
    return bool(leans)


def six_coordinates(
    given: Mapping[str, float], others: Mapping[str, float] | None = None, where: str = "mounting"
) -> dict[str, float]:
    """The coordinates of `COORDINATES` of a mounting that is given by them, or by its lean [m, degrees].

    Parameters
    ----------
    given : mapping of str to float
        Some of `MOUNTING_OR_LEAN`; lean direction and spin are 0 where they are left out. Both forms of one
        orientation, as result.json has them, are one.
    others : mapping of str to float, optional
        The six coordinates in place of those that are left out.
    where : str
        Where it was given, for errors.

    Raises
    ------
    InputError
        When it has tilts or yaw and a lean, or a direction or spin without a lean.
    """
    if "lean_deg" in given and all(key in given for key in ANGLES):
        by_lean = six_coordinates({key: value for key, value in given.items() if key not in ANGLES}, others, where)
        given = {key: value for key, value in given.items() if key in MOUNTING}
        if abs(pose_at(by_lean).rotation - pose_at({**by_lean, **given}).rotation).max() > _SAME_ROTATION:
            raise InputError(f"{where}: its lean is not that of its tilts and yaw; allowed: one of both")
    leans = has_lean(given, where)
    six = {key: given[key] if key in given else (others or {})[key] for key in COORDINATES if key in given or others}
    if not leans:
        return six
    from ..sensors.pose import lean_matrix, tilts_of

    tilts = tilts_of(lean_matrix(*(math.radians(given.get(key, 0.0)) for key in LEANS)))
    six |= dict(zip(ANGLES, map(math.degrees, tilts), strict=True))
    return {key: six[key] for key in COORDINATES}


def with_lean(coordinates: Mapping[str, float]) -> dict[str, float | None]:
    """The six coordinates, and the same orientation as lean, its direction and spin [m, degrees].

    What leans by less than a millionth of a degree has no direction: None.
    """
    from ..sensors.pose import lean_of

    lean, *turns = (round(math.degrees(angle), 12) + 0.0 for angle in lean_of(pose_at(coordinates).rotation))
    if lean < _NO_LEAN_DEG:
        lean, turns = 0.0, [None, coordinates["yaw_deg"]]
    return {**coordinates, **dict(zip(LEANS, (lean, *turns), strict=True))}


def leaning(coordinates: Mapping[str, float], **changes: float) -> dict[str, float]:
    """The six coordinates of a mounting with some of `MOUNTING_OR_LEAN` changed; a lean keeps direction and spin.

    `coordinates` are the six, or those that `Deployment.given` has.
    """
    if "lean_deg" in coordinates:
        return six_coordinates({**coordinates, **changes})
    if not changes.keys() & set(LEANS):
        return {**coordinates, **changes}
    kept = {key: value for key, value in with_lean(coordinates).items() if key in LEANS and value is not None}
    return six_coordinates({**kept, **changes}, coordinates)


def pose_at(coordinates: Mapping[str, float], road: RoadFrame | None = None) -> Pose:
    """The mounting at the six coordinates of `COORDINATES`, in the frame of a road; of a level one unless said.

    Coordinates are what an installer sets: x and y of the mast's foot, on the road's plane; the height above it along
    the mast, which is plumb; tilts against the vertical, and yaw about it from the level direction of the road's x.
    """
    from ..sensors.pose import Pose

    x_m, y_m, height_m, *angles = (coordinates[key] for key in COORDINATES)
    pose = Pose(x_m, y_m, height_m, *map(math.radians, angles))
    if road is None or road.is_level:
        return pose
    from ..sensors.pose import tilts_of, turned

    axes = _axes(road)
    x, y, z = (pose.height_m * axes[:, 2]).tolist()  # along the mast
    return Pose(x_m + x, y_m + y, z, *tilts_of(turned(pose.rotation, axes.T)))


def plumb(pose: Pose, road: RoadFrame) -> dict[str, float]:
    """The six coordinates [m, degrees] by which `pose_at` gives a pose in the frame of a road."""
    from ..sensors.pose import tilts_of, turned

    place, angles = (pose.x_m, pose.y_m, pose.height_m), (pose.tilt_x, pose.tilt_y, pose.yaw)
    if not road.is_level:
        axes = _axes(road)
        x, y, z = axes[:, 2].tolist()
        height = pose.height_m / z
        place, angles = (pose.x_m - height * x, pose.y_m - height * y, height), tilts_of(turned(pose.rotation, axes))
    return dict(zip(COORDINATES, (*place, *map(math.degrees, angles)), strict=True))


def _axes(road: RoadFrame):
    from ..sensors.pose import road_axes

    return road_axes(0.01 * road.grade_percent, 0.01 * road.cross_fall_percent)
