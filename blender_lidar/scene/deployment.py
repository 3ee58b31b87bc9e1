"""[deployment] and [baseline]: which coordinates of a mounting are fixed and which are searched, and on which poles.

Like the other settings it needs the standard library alone, so that help opens at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING

from ..errors import InputError, shown, unknown_name
from ..names import SIDES
from ..toml_table import Setting, setting, settings_of
from .mounting import ANGLES, LEANS, SQUARE, Layout, Mounting, mounting_from

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from ..road.road_map import RoadMap

TURNS = ("yaw_deg", "lean_direction_deg", "spin_deg")  # of which 360 degrees are a full circle
HEADING = {"low": -360.0, "high": 360.0}


@dataclass(frozen=True, slots=True)
class MountingSettings:
    """[baseline], and a mounting given by options: the height is that of the paper's section V.A.

    Attributes
    ----------
    x_m : float
        Place along the road, positive in the direction of travel.
    y_m : float
        Place across the road, positive to the left.
    height_m : float
        Height above the road.
    tilt_x_deg : float
        Tilt across the road: positive looks down to the side that the mast faces, by default +y.
    tilt_y_deg : float
        Tilt along the road: positive raises the side to the right of where the mast faces, by default that ahead (+x).
    yaw_deg : float
        Rotation of the tilted sensor, counter-clockwise seen from above.
    facing_deg : float or None
        Direction that the mast faces, counter-clockwise from +x; tilts and yaw count from there. By default 90, or what
        [deployment] side says, or towards a road that drives on the left or has two carriageways.
    """

    x_m: float = setting(0.0, low=-1e5, high=1e5, option="--x")
    y_m: float = setting(0.0, low=-1e5, high=1e5, option="--y")
    height_m: float = setting(2.0, low=0.1, high=100.0, option="--height")
    tilt_x_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-x", rivals=LEANS)
    tilt_y_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-y", rivals=LEANS)
    yaw_deg: float = setting(0.0, option="--yaw", rivals=LEANS, **HEADING)
    facing_deg: float | None = setting(None, option="--facing", **HEADING)


@dataclass(frozen=True, slots=True)
class LeanSettings:
    """The same orientation as both tilts and yaw, and in their place: see `sensors.pose.lean_matrix`.

    Attributes
    ----------
    lean_deg : float or None
        Angle between the sensor's axis and the vertical, in place of tilts and yaw.
    lean_direction_deg : float
        Direction in which the sensor leans and looks down, counter-clockwise seen from above; 0 is towards +y.
    spin_deg : float
        Rotation about the sensor's own axis, counter-clockwise; it matters only to a sensor with uneven columns.
    """

    lean_deg: float | None = setting(None, low=0.0, high=90.0, option="--lean", rivals=ANGLES)
    lean_direction_deg: float | None = setting(None, option="--lean-direction", rivals=ANGLES, **HEADING)
    spin_deg: float | None = setting(None, option="--spin", rivals=ANGLES, **HEADING)


MOUNTING = settings_of(MountingSettings)
LEAN = settings_of(LeanSettings)
MOUNTING_OR_LEAN = MOUNTING | LEAN
"""All coordinates by which a mounting can be given."""
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
DEPLOYMENT["facing_deg"] = MOUNTING["facing_deg"]


@dataclass(frozen=True, slots=True)
class MountingErrors:
    """How far off a LiDAR may be from where it is thought to hang: half-widths of independent uniform errors.

    `tilt_deg` is of both tilts: the inclinometer that sets the one sets the other too.
    """

    tilt_deg: float = setting(0.0, low=0.0, high=10.0)
    height_m: float = setting(0.0, low=0.0, high=1.0)
    yaw_deg: float = setting(0.0, low=0.0, high=10.0)

    @property
    def half_widths(self) -> tuple[float, float, float, float]:
        """Of height [m], tilt across, tilt along and yaw [rad]."""
        return self.height_m, *map(math.radians, (self.tilt_deg, self.tilt_deg, self.yaw_deg))

    @property
    def is_exact(self) -> bool:
        """Whether there are none."""
        return not any(self.half_widths)

    @property
    def text(self) -> str:
        """They in words, such as "±0.5° of either tilt, ±0.05 m of height"; empty where there are none."""
        widths = (self.tilt_deg, "° of either tilt"), (self.height_m, " m of height"), (self.yaw_deg, "° of yaw")
        return ", ".join(f"±{width:g}{what}" for width, what in widths if width)


@dataclass(frozen=True, slots=True)
class Installer(MountingErrors):
    """Installation errors: how far off its plan a LiDAR may end up.

    `aim` is what of the objective over them a search maximises: its mean, or low, its 10 % quantile.
    """

    tilt_deg: float = setting(0.5, low=0.0, high=10.0)
    height_m: float = setting(0.05, low=0.0, high=1.0)
    yaw_deg: float = setting(2.0, low=0.0, high=10.0)
    aim: str = setting("mean", allowed=("mean", "low"))

    def as_setting(self) -> dict[str, object] | bool:
        """What a scene file says of it."""
        return False if self.is_exact else asdict(self)


HANGS = Installer(tilt_deg=0.0, height_m=0.0, yaw_deg=0.0)
"""Of a LiDAR that hangs already: `installer = false`."""


def installers_text(installers: Iterable[Installer]) -> str:
    """Half-widths of installation errors in a few words, each once; "" where all hang already."""
    return " or ".join(dict.fromkeys(one.text for one in installers if not one.is_exact))


@dataclass(frozen=True, slots=True)
class StandSettings:
    """[deployment]: the keys of the place that are not coordinates.

    Attributes
    ----------
    poles : str or None
        CSV of candidate places, in place of x_m and y_m.
    side : str or None
        Side of the road where the mast stands, facing the road; by default that of [road] drives_on, unless y_m or
        poles give the place: on roads that drive on the left, or have two carriageways, these face the road from there.
        A gantry hangs over the lanes.
    clearance_m : float
        Least height of a LiDAR over the lanes [m], on a gantry.
    installer : Installer
        Installation errors, half-widths of independent uniform ones: tilt_deg=0.5 (both tilts), height_m=0.05,
        yaw_deg=2; aim=low maximises the 10 % quantile of the objective over them, not its mean; false: it hangs
        already.
    """

    poles: str | None = setting(None, is_path=True)
    side: str | None = setting(None, allowed=SIDES)
    clearance_m: float = setting(5.0, low=0.0, high=20.0)
    installer: Installer = setting(Installer(), off=HANGS, option="--installer")


STAND = settings_of(StandSettings)
BASELINE = MOUNTING_OR_LEAN | {
    "installer": Setting(kind=bool, default=True, help="false: it hangs already, and no installation error shakes it")
}
"""[baseline]: a mounting, and whether installation errors shake it."""


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
    facing_deg : float or None
        Which way it faces, counter-clockwise from +x; as [deployment] says unless said.
    """

    name: str
    x_m: float
    y_m: float
    foot_z_m: float = 0.0
    height_min_m: float | None = None
    height_max_m: float | None = None
    cost: float | None = None
    existing: bool | None = None
    facing_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Facing:
    """Which way masts face: one direction, towards a place, or else square to the road from the side they stand on.

    Attributes
    ----------
    angle_deg : float or None
        The one direction, counter-clockwise from +x.
    towards_m : (float, float) or None
        The place [m, site frame].
    """

    angle_deg: float | None = None
    towards_m: tuple[float, float] | None = None

    def at(self, xy: Sequence[float], road: RoadMap) -> float:
        """Which way a mast faces whose foot stands at a place [m] beside a road, counter-clockwise from +x [degrees].

        A road without sides says nothing: the mast faces its +y axis.
        """
        if self.angle_deg is not None:
            return self.angle_deg
        if self.towards_m is not None:
            return math.degrees(math.atan2(self.towards_m[1] - xy[1], self.towards_m[0] - xy[0]))
        return math.degrees(road.facing_of.get(road.side_of(xy), SQUARE))


@dataclass(frozen=True, slots=True)
class Place:
    """Where one LiDAR may hang: which of its coordinates stay, and between what bounds the others are searched.

    Attributes
    ----------
    fixed : mapping of str to float
        Coordinates that stay [m, degrees]; those of the orientation are tilts and yaw, or lean, direction and spin.
    bounds : mapping of str to (float, float)
        The others, in the order of `MOUNTING_OR_LEAN`.
    facing : Facing
        Which way its mast faces, wherever it stands.
    road : RoadMap
        What its mast stands on.
    pole : Pole or None
        The candidate pole that it is, if it is one.
    """

    fixed: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    facing: Facing
    road: RoadMap = field(repr=False, compare=False)
    pole: Pole | None = None

    def span(self, key: str) -> tuple[float, float]:
        """From where to where a coordinate may be; twice the same where it is fixed."""
        return self.bounds.get(key) or (self.fixed[key],) * 2

    @property
    def xy(self) -> tuple[float, float] | None:
        """Where its mast stands [m]; None where that is searched."""
        return None if {"x_m", "y_m"} & self.bounds.keys() else (self.fixed["x_m"], self.fixed["y_m"])

    @property
    def label(self) -> str:
        """What it is called among other candidate places; nothing where there is one place."""
        return "" if self.pole is None else f"pole {self.pole.name}"

    @property
    def leans(self) -> bool:
        """Whether its orientation is given by a lean, and not by tilts and yaw."""
        return not self.bounds.keys().isdisjoint(LEANS) or not self.fixed.keys().isdisjoint(LEANS)

    def mounting(self, x: Sequence[float]) -> Mounting:
        """The mounting where the searched coordinates have the values `x`."""
        table = {**self.fixed, **dict(zip(self.bounds, (float(one) for one in x), strict=True))}
        table["facing_deg"] = self.facing.at((table["x_m"], table["y_m"]), self.road)
        return mounting_from(table, self.road)


def fixed_beside(fixed: Mapping[str, float], given: Collection[str]) -> dict[str, float]:
    """Of the coordinates that a place fixes those that do not contradict the ones that are given, by their names."""
    rivals = {rival for key in given if key in MOUNTING_OR_LEAN for rival in MOUNTING_OR_LEAN[key].rivals}
    if LEANS[0] not in {*fixed, *given}:  # a direction says nothing without a lean
        rivals |= set(LEANS)
    return {key: value for key, value in fixed.items() if key in MOUNTING_OR_LEAN and key not in rivals}


@dataclass(frozen=True, slots=True)
class SearchSpace:
    """Search space: the free coordinates of all LiDARs of a layout that are searched, one after the other.

    Which of several candidate poles a LiDAR hangs on is an outer choice and no coordinate: each has a space of its own.

    Attributes
    ----------
    slots : tuple of Place, Mounting or None
        For each LiDAR where it is searched, the mounting in which it is held, or None where it is left out.
    names : tuple of str
        Names of the LiDARs, which stand before their coordinates where more than one is searched.
    """

    slots: tuple[Place | Mounting | None, ...]
    names: tuple[str, ...] = ()

    @property
    def places(self) -> tuple[Place, ...]:
        """Of the LiDARs that are searched."""
        return tuple(slot for slot in self.slots if isinstance(slot, Place))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the searched coordinates."""
        if len(self.places) == 1:
            return tuple(self.places[0].bounds)
        named = zip(self.names or [""] * len(self.slots), self.slots, strict=True)
        return tuple(variable_of(name, key) for name, slot in named if isinstance(slot, Place) for key in slot.bounds)

    @property
    def bounds(self) -> tuple[tuple[float, float], ...]:
        """Lower and upper bound of each searched coordinate [m, degrees]."""
        return tuple(bounds for place in self.places for bounds in place.bounds.values())

    @property
    def lower(self) -> tuple[float, ...]:
        return tuple(low for low, _ in self.bounds)

    @property
    def upper(self) -> tuple[float, ...]:
        return tuple(high for _, high in self.bounds)

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Which searched coordinates are full circles, on which neither bound is an end."""
        keys = (key for place in self.places for key in place.bounds)
        return tuple(key in TURNS and high - low == 360.0 for key, (low, high) in zip(keys, self.bounds, strict=True))

    @property
    def axes(self) -> tuple[str, str]:
        """The height, and what the sensor looks down by: its lean, or the tilt across the mast's frame."""
        return "height_m", "lean_deg" if self.places[0].leans else "tilt_x_deg"

    def layout(self, x: Sequence[float]) -> Layout:
        """The mountings at a point `x` (d,) of the space [m, degrees]."""
        values, mountings = list(x), []
        for slot in self.slots:
            if isinstance(slot, Place):
                mountings.append(slot.mounting(values[: len(slot.bounds)]))
                values = values[len(slot.bounds) :]
            else:
                mountings.append(slot)
        return tuple(mountings)


def variable_of(name: str, key: str) -> str:
    """What a coordinate of a named LiDAR is called: ``north.height_m``; without a name the coordinate itself."""
    return f"{name}.{key}" if name else key


@dataclass(frozen=True, slots=True)
class Deployment:
    """Where a LiDAR may hang: its candidate places, each searched by itself, and how well it will be hung there.

    Attributes
    ----------
    places : tuple of Place
        One, or one for each candidate pole.
    facing : Facing
        Which way masts face that say nothing themselves.
    installer : Installer
        How far off its plan the LiDAR may end up.
    side : str or None
        The side of the road, where the scene names it.
    clearance_m : float
        Least height over the lanes, on a gantry [m].
    poles_file : str or None
        The table that the poles come from.
    shared : mapping
        With it the coordinates and bounds that all poles share, heights above each pole's foot.
    """

    places: tuple[Place, ...]
    facing: Facing
    installer: Installer = Installer()
    side: str | None = None
    clearance_m: float = 5.0
    poles_file: str | None = None
    shared: Mapping[str, object] = field(default_factory=dict)

    @property
    def is_gantry(self) -> bool:
        """Whether it hangs over the lanes."""
        return self.side == SIDES[3]

    @property
    def is_held(self) -> bool:
        """Whether it hangs already: it has one place and nothing to be searched."""
        return len(self.places) == 1 and not self.places[0].bounds

    @property
    def poles(self) -> tuple[Pole, ...]:
        """The candidate poles; none where x and y say the place."""
        return tuple(place.pole for place in self.places if place.pole is not None)

    def on_pole(self, name: str, where: str = "--pole") -> Place:
        """The place on the candidate pole of that name.

        Raises
        ------
        InputError
            When there is none; `where` the name was given.
        """
        places = {place.pole.name: place for place in self.places if place.pole is not None}
        if not places:
            raise InputError(f"{where}: is {shown(name)}, but the scene has no [deployment] poles")
        if name not in places:
            raise unknown_name(name, places, "pole", where)
        return places[name]

    def pole_at(self, xy: Sequence[float]) -> Pole | None:
        """The candidate pole that stands at a place [m]; None where none does."""
        return next((pole for pole in self.poles if (pole.x_m, pole.y_m) == tuple(xy)), None)

    def at(self, place: Place) -> Deployment:
        """The same with one of its places as the only one, which is no candidate any more."""
        return replace(self, places=(replace(place, pole=None),), poles_file=None, shared={})

    def as_table(self) -> dict[str, object]:
        """The keys of [deployment], or of a [[lidar]], that it is read from, spelt out."""
        table, facing = {**self.places[0].fixed, **self.places[0].bounds}, self.places[0].facing
        if self.poles_file is not None:
            table, facing = {**self.shared, "poles": self.poles_file}, self.facing
        if facing.angle_deg is not None:
            table["facing_deg"] = facing.angle_deg
        if self.side is not None:
            table |= {key: getattr(self, key) for key in ("side", "clearance_m")}
        return {**table, "installer": self.installer.as_setting()}

    @property
    def spaces(self) -> tuple[SearchSpace, ...]:
        """The search space of each candidate place."""
        return tuple(SearchSpace((place,)) for place in self.places)

    @property
    def nominal_xy(self) -> tuple[float, float]:
        """The mount's place [m], or the middle of where it may be."""
        ends = [[end for place in self.places for end in place.span(key)] for key in ("x_m", "y_m")]
        return tuple(0.5 * (min(one) + max(one)) for one in ends)
