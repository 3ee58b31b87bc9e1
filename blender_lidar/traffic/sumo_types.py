"""Classes and sizes of SUMO's vehicles: its recordings name a type, whose size stands in a route or additional file."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError, unknown_name
from .sizes import HEIGHTS_M, VAN_LONGER_THAN_M
from .xml_tags import Tag, start_tags

DEFAULT_SIZES_M = {
    "ignoring": (5.0, 1.8, 1.5),
    "private": (5.0, 1.8, 1.5),
    "emergency": (6.5, 2.16, 2.86),
    "authority": (5.0, 1.8, 1.5),
    "army": (5.0, 1.8, 1.5),
    "vip": (5.0, 1.8, 1.5),
    "passenger": (5.0, 1.8, 1.5),
    "hov": (5.0, 1.8, 1.5),
    "taxi": (5.0, 1.8, 1.5),
    "bus": (12.0, 2.5, 3.4),
    "coach": (14.0, 2.6, 4.0),
    "delivery": (6.5, 2.16, 2.86),
    "truck": (7.1, 2.4, 2.4),
    "trailer": (16.5, 2.55, 4.0),
    "tram": (22.0, 2.4, 3.2),
    "rail_urban": (109.5, 3.0, 3.6),
    "rail": (135.0, 2.84, 3.75),
    "rail_electric": (200.0, 2.95, 3.89),
    "rail_fast": (200.0, 2.95, 3.89),
    "motorcycle": (2.2, 0.9, 1.5),
    "moped": (2.1, 0.78, 1.7),
    "bicycle": (1.6, 0.65, 1.7),
    "pedestrian": (0.215, 0.478, 1.719),
    "evehicle": (5.0, 1.8, 1.5),
    "ship": (17.0, 4.0, 4.0),
    "container": (6.096, 2.438, 2.591),
    "cable_car": (5.0, 1.8, 1.5),
    "subway": (109.5, 3.0, 3.6),
    "aircraft": (72.7, 79.8, 1.5),
    "wheelchair": (1.2, 0.72, 1.2),
    "scooter": (1.2, 0.5, 1.7),
    "drone": (0.5, 0.5, 1.5),
    "custom1": (5.0, 1.8, 1.5),
    "custom2": (5.0, 1.8, 1.5),
}
"""Length, width and height [m] by SUMO's vehicle class: "Vehicle Type Parameter Defaults" of its documentation, as SUMO
1.28.0 itself tells them by TraCI."""
_BUILT_IN = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_TAXITYPE": "taxi",
    "DEFAULT_BIKETYPE": "bicycle",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_CONTAINERTYPE": "container",
    "DEFAULT_RAILTYPE": "rail",
}
_CLASS = {
    **dict.fromkeys(("emergency", "delivery"), "van"),
    **dict.fromkeys(("truck", "trailer"), "truck"),
    **dict.fromkeys(("bus", "coach", "tram"), "bus"),  # a tram stands in the street as a bus does
    **dict.fromkeys(("motorcycle", "moped", "bicycle", "scooter"), "motorcycle"),
}
"""Our class by SUMO's; those that are neither here nor in `_NOT_ON_ROAD` are cars, or vans by their size."""
_ON_RAILS_OR_ELSEWHERE = ("rail_urban", "rail", "rail_electric", "rail_fast", "subway", "cable_car", "ship", "aircraft")
_NOT_ON_ROAD = frozenset((*_ON_RAILS_OR_ELSEWHERE, "drone", "pedestrian", "wheelchair", "container"))
# What a vehicle is drawn as, where a file says so, tells more than its class, which is often left at passenger.
_DRAWN_AS = {
    **dict.fromkeys(("passenger/sedan", "passenger/hatchback", "passenger/wagon", "police"), "car"),
    **dict.fromkeys(("passenger/van", "delivery", "emergency"), "van"),
    **dict.fromkeys(("truck", "truck/semitrailer", "truck/trailer", "firebrigade"), "truck"),
    **dict.fromkeys(("bus", "bus/coach", "bus/flexible", "bus/trolley"), "bus"),
    **dict.fromkeys(("motorcycle", "moped", "bicycle", "scooter"), "motorcycle"),
}
_LARGEST_M = 1000.0
_SHORT = reprlib.Repr()
_SHORT.maxstring = 60


@dataclass(frozen=True, slots=True)
class VehicleType:
    """What a name in the column ``type`` stands for.

    Attributes
    ----------
    vehicle_class : str
        SUMO's.
    class_name : str or None
        Ours; None for what is no vehicle on a road.
    size_m : (float, float, float)
        Length, width and height [m].
    """

    vehicle_class: str
    class_name: str | None
    size_m: tuple[float, float, float]


def quoted(name: str) -> str:
    """A name from a file as an error shows it, cut where it is long."""
    return _SHORT.repr(name)


def default_type(vehicle_class: str) -> VehicleType:
    """A type of which nothing but SUMO's vehicle class is known; 5 m by default say nothing about a van."""
    name = None if vehicle_class in _NOT_ON_ROAD else _CLASS.get(vehicle_class, "car")
    return VehicleType(vehicle_class, name, DEFAULT_SIZES_M[vehicle_class])


def read_types(path: str | Path) -> dict[str, VehicleType]:
    """The types that a route or additional file defines, plain or gzip, also inside ``<vTypeDistribution>``.

    What a type does not say has its class's default. A car that is given a length above `VAN_LONGER_THAN_M`, and more
    length or height than its class has by default, is a van; its height, where not given, is that of NGSIM's vans.

    Raises
    ------
    MissingFileError, InputError
        If the file cannot be read as XML, defines no type or one twice, or gives one an unknown class or a size that is
        none.
    """
    types: dict[str, VehicleType] = {}
    for tags in start_tags(path):
        for tag in tags:
            if tag.name != "vType":
                continue
            where = f"{path}:{tag.line}"
            name = tag.attributes.get("id", "")
            if not name or name in types:
                raise InputError(
                    f"{where}: {f'vType {quoted(name)} is there twice' if name else 'a vType without an id'}"
                )
            types[name] = _read_type(tag, where)
    if not types:
        raise InputError(f"{path}: no <vType>; a route or additional file that defines the vehicles is needed")
    return types


def type_named(name: str, types: Mapping[str, VehicleType]) -> VehicleType | None:
    """The type of that name among those of a file, or one of SUMO's own; None if there is none."""
    for known in (name, _base(name)):
        if known in types:
            return types[known]
        if known in _BUILT_IN:
            return default_type(_BUILT_IN[known])
    return None


def assumed_type(name: str) -> tuple[VehicleType, bool]:
    """The type of that name without a file of types, and whether the name says what it is: else a passenger car."""
    base = _base(name)
    vehicle_class = _BUILT_IN.get(base, base if base in DEFAULT_SIZES_M else None)
    return default_type(vehicle_class or "passenger"), vehicle_class is not None


def _base(name: str) -> str:
    """``"lorry"`` for ``"lorry@7"``, the name of a type that vehicle 7 got for itself, by TraCI."""
    return name.split("@", 1)[0]


def _read_type(tag: Tag, where: str) -> VehicleType:
    vehicle_class = tag.attributes.get("vClass", "passenger")
    if vehicle_class not in DEFAULT_SIZES_M:
        raise unknown_name(vehicle_class[:40], DEFAULT_SIZES_M, "vClass", where)
    given = [_size(tag, key, where) for key in ("length", "width", "height")]
    default = DEFAULT_SIZES_M[vehicle_class]
    length, width, height = (usual if value is None else value for value, usual in zip(given, default, strict=True))
    usual = default_type(vehicle_class).class_name
    name = usual and _DRAWN_AS.get(tag.attributes.get("guiShape", ""), usual)
    is_any_car = name == "car" and tag.attributes.get("guiShape") not in _DRAWN_AS
    if is_any_car and _is_van(given, default):
        name, height = "van", HEIGHTS_M["van"] if given[2] is None else height
    return VehicleType(vehicle_class, name, (length, width, height))


def _is_van(given: list[float | None], default: tuple[float, float, float]) -> bool:
    """Whether a car's size says that it is a van: a long one that is longer or higher than its class by default.

    The 5 m that most classes have by default are longer than many a van, so that they alone say nothing, written out or
    not.
    """
    length, _, height = given
    is_larger = (length or 0.0) > default[0] or (height or 0.0) > default[2]
    return length is not None and length > VAN_LONGER_THAN_M and is_larger


def _size(tag: Tag, key: str, where: str) -> float | None:
    text = tag.attributes.get(key)
    if text is None:
        return None
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not 0 < value <= _LARGEST_M:
        raise InputError(
            f"{where}: {key} of vType {quoted(tag.attributes['id'])} is {text[:40]!r}; allowed: more than 0, "
            f"at most {_LARGEST_M:g} m"
        )
    return value
