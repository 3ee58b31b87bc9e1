"""SUMO's vehicle types: classes, default sizes, and the files that define others; its XML, streamed."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from ..csv_header import listed, short
from ..csv_tables import Column, Rows
from ..errors import InputError, unknown_name
from ..files import open_bytes
from .vehicles import DIMENSIONS, HEIGHTS_M, VAN_LONGER_THAN_M

_BLOCK_BYTES = 2**18


def start_tags(path: str | Path) -> Iterator[tuple[int, str, dict[str, str]]]:
    """The start tags of an XML file, plain or gzip: line (from 1), name and attributes of each.

    They are streamed: nothing is built, so that memory does not grow with the file.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if the file is not well-formed XML, or declares an encoding that cannot be read.
    """
    tags: list[tuple[int, str, dict[str, str]]] = []
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda name, attributes: tags.append((parser.CurrentLineNumber, name, attributes))
    with open_bytes(path) as stream:
        block = b"more"
        while block:
            block = stream.read(_BLOCK_BYTES)
            try:
                parser.Parse(block, not block)
            except (expat.ExpatError, LookupError, ValueError) as error:  # the latter two of encodings
                line = parser.ErrorLineNumber
                raise InputError(f"{path}:{line}: truncated or damaged XML ({error})") from error
            yield from tags
            tags.clear()


# --- Classes and sizes: a recording names a type, whose size stands in a route or additional file ---------------------


class VehicleType(NamedTuple):
    """What a name in the column ``type`` stands for.

    Attributes
    ----------
    class_name : str or None
        Ours; None for what is no vehicle on a road, nor a pedestrian.
    size_m : (float, float, float)
        Length, width and height [m]; of no account for what is on no road.
    given : tuple of str
        Which of these a file says; the others are usual for its class.
    """

    class_name: str | None
    size_m: tuple[float, float, float]
    given: tuple[str, ...] = ()


_CARS = ("ignoring", "private", "authority", "army", "vip", "passenger", "hov", "taxi", "evehicle")
_ON_RAILS = ("rail_urban", "subway", "rail", "rail_electric", "rail_fast", "cable_car")
_ON_NO_ROAD = ("container", "ship", "aircraft", "drone")
DEFAULT_TYPES = {
    **dict.fromkeys((*_CARS, "custom1", "custom2"), VehicleType("car", (5.0, 1.8, 1.5))),
    **dict.fromkeys(("emergency", "delivery"), VehicleType("van", (6.5, 2.16, 2.86))),
    "bus": VehicleType("bus", (12.0, 2.5, 3.4)),
    "coach": VehicleType("bus", (14.0, 2.6, 4.0)),
    "tram": VehicleType("bus", (22.0, 2.4, 3.2)),
    "truck": VehicleType("truck", (7.1, 2.4, 2.4)),
    "trailer": VehicleType("truck", (16.5, 2.55, 4.0)),
    "motorcycle": VehicleType("motorcycle", (2.2, 0.9, 1.5)),
    "moped": VehicleType("motorcycle", (2.1, 0.78, 1.7)),
    "bicycle": VehicleType("bicycle", (1.6, 0.65, 1.7)),
    "scooter": VehicleType("motorcycle", (1.2, 0.5, 1.7)),
    "pedestrian": VehicleType("pedestrian", (0.215, 0.478, 1.719)),
    "wheelchair": VehicleType("pedestrian", (1.2, 0.72, 1.2)),
    **dict.fromkeys((*_ON_RAILS, *_ON_NO_ROAD), VehicleType(None, (1.0, 1.0, 1.0))),
}
"""By SUMO's vehicle class, of which nothing else is known; 5 m by default say nothing about a van, and a tram stands in
the street as a bus does. Sizes: "Vehicle Type Parameter Defaults" of its documentation, as SUMO 1.28.0 gives them by
TraCI."""
_SHORT_FOR = {"VEH": "passenger", "BIKE": "bicycle", "PED": "pedestrian"}
_BUILT_IN = {
    f"DEFAULT_{name}TYPE": DEFAULT_TYPES[_SHORT_FOR.get(name, name.lower())]
    for name in ("VEH", "TAXI", "BIKE", "PED", "CONTAINER", "RAIL")
}
# What a vehicle is drawn as, where a file says so, says more than its class, which is often left at passenger.
_DRAWN_AS = {
    **dict.fromkeys(("passenger/sedan", "passenger/hatchback", "passenger/wagon", "police"), "car"),
    **dict.fromkeys(("passenger/van", "delivery", "emergency"), "van"),
    **dict.fromkeys(("truck", "truck/semitrailer", "truck/trailer", "firebrigade"), "truck"),
    **dict.fromkeys(("bus", "bus/coach", "bus/flexible", "bus/trolley"), "bus"),
    **dict.fromkeys(("motorcycle", "moped", "scooter"), "motorcycle"),
    "bicycle": "bicycle",
}
# Words in the names that people and tools give to types, beside the classes themselves.
_WORDS = {
    **dict.fromkeys(("car", "cars", "pkw", "veh", "sedan", "suv"), "passenger"),
    **dict.fromkeys(("van", "lcv"), "delivery"),
    **dict.fromkeys(("lorry", "hgv", "hdv", "lkw", "trucks"), "truck"),
    **dict.fromkeys(("semitrailer", "semi"), "trailer"),
    **dict.fromkeys(("moto", "motorbike"), "motorcycle"),
    **dict.fromkeys(("bike", "cyclist", "cycle"), "bicycle"),
    **dict.fromkeys(("ped", "person", "persons"), "pedestrian"),
    **dict.fromkeys(("minibus", "buses"), "bus"),
    "train": "rail",
    "ambulance": "emergency",
}
_PART = re.compile("[A-Z]?[a-z]+|[A-Z]+(?![a-z])")
_SIZE = Column("more than 0, at most 1000 m", low=1e-9, high=1000.0)


def class_in_name(name: str) -> str | None:
    """SUMO's vehicle class in a type's name, as in osmWebWizard's ``truck_truck`` or ``hdvTruck1``; None without one.

    Parts of a name are divided by what is no letter, or by case; of several that are classes the last one counts, and a
    class before a word for one.
    """
    parts = [part.lower() for part in _PART.findall(name)]
    pairs = map("_".join, pairwise(parts))  # rail_urban, cable_car
    classes = [part for part in (*parts, *pairs) if part in DEFAULT_TYPES]
    words = [_WORDS[part] for part in parts if part in _WORDS]
    return (classes or words or [None])[-1]


def read_types(*paths: str | Path) -> dict[str, VehicleType]:
    """The types that route or additional files define, plain or gzip, also inside ``<vTypeDistribution>``.

    What a type does not say has its class's default. A car that is given a length above `VAN_LONGER_THAN_M`, and more
    length or height than its class has by default, is a van; its height, where not given, is that of NGSIM's vans.

    Raises
    ------
    MissingFileError, InputError
        If a file cannot be read as XML, all define no type or one in two ways, or give one an unknown class or a size
        that is none.
    """
    types: dict[str, VehicleType] = {}
    for path in paths:
        if is_config(path):
            files = " ".join(f"--vehicle-types {one}" for one in read_config(path).types)
            raise InputError(f"{path}: is SUMO's configuration; give the files with <vType> that it names: {files}")
        here: dict[str, VehicleType] = {}
        for line, element, attributes in start_tags(path):
            if element == "vType":
                name = attributes.get("id", "")
                found = _read_type(attributes, line, f"{path}:")
                if not name or name in here or types.get(name, found)[:2] != found[:2]:
                    text = f"{short(name)!r} is there twice" if name else "without an id"
                    raise InputError(f"{path}:{line}: vType {text}")
                here[name] = found
        types |= here
    if not types:
        raise InputError(
            f"{', '.join(map(str, paths))}: no <vType>; a route or additional file that defines the vehicles is needed"
        )
    return types


def is_config(path: str | Path) -> bool:
    """Whether a file is called as SUMO's configurations are."""
    return str(path).lower().endswith((".sumocfg", ".sumo.cfg"))


class SumoConfig(NamedTuple):
    """What a SUMO configuration names: its net and its floating car data, None where it names none; files of types."""

    net: Path | None
    data: Path | None
    types: list[Path]


def read_config(path: str | Path) -> SumoConfig:
    """The files that SUMO's configuration names, and of its routes and additional files those that define types."""
    folder, values = Path(path).parent, {}
    for _, element, attributes in start_tags(path):
        values[element] = attributes.get("value", attributes.get("v", ""))
    named = ",".join(values.get(key, "") for key in ("route-files", "r", "additional-files", "a"))
    files = [folder / name for name in re.split(r"[,\s]+", named) if name and (folder / name).exists()]
    types = [file for file in files if any(element == "vType" for _, element, _ in start_tags(file))]
    net = values.get("net-file", values.get("n", ""))
    data, prefix = values.get("fcd-output", ""), values.get("output-prefix", "")
    if data:
        data = folder / (Path(data) if Path(data).is_absolute() else Path(data).with_name(prefix + Path(data).name))
    return SumoConfig(folder / net if net else None, data or None, types)


def _read_type(attributes: Mapping[str, str], line: int, place: str) -> VehicleType:
    vehicle_class = attributes.get("vClass", "passenger")
    if vehicle_class not in DEFAULT_TYPES:
        raise unknown_name(vehicle_class, DEFAULT_TYPES, "vClass", f"{place}{line}")
    name, usual, _ = DEFAULT_TYPES[vehicle_class]
    size = dict(zip(DIMENSIONS, usual, strict=True))
    texts = {key: np.array([attributes[key]], dtype=object) for key in size if key in attributes}
    given = {key: float(Rows(texts, [line], place).numbers(key, _SIZE)[0]) for key in texts}
    drawn_as = _DRAWN_AS.get(attributes.get("guiShape", ""))
    if name and drawn_as:
        name = drawn_as
    # The 5 m that most classes have by default are longer than many a van: alone they say nothing, written out or not.
    is_larger = any(given.get(key, 0.0) > size[key] for key in ("length", "height"))
    if name == "car" and not drawn_as and given.get("length", 0.0) > VAN_LONGER_THAN_M and is_larger:
        name, size["height"] = "van", HEIGHTS_M["van"]
    return VehicleType(name, tuple((size | given).values()), tuple(given))


def person_type(name: str, defined: Mapping[str, VehicleType] | None) -> VehicleType:
    """The type of what has no lane, which may be defined elsewhere: SUMO's pedestrian unless more is known.

    The type of a vehicle there, as of one that SUMO wrote without its lane, is that of none on a road.
    """
    known = {**_BUILT_IN, **(DEFAULT_TYPES if defined is None else defined)}
    kind = known.get(name, DEFAULT_TYPES["pedestrian"])
    return kind if kind.class_name in (None, "pedestrian") else kind._replace(class_name=None)


def types_of(
    names: Sequence[str], defined: Mapping[str, VehicleType] | None, where: str
) -> tuple[list[VehicleType], list[str], np.ndarray]:
    """The type behind each name: of those `defined`, or else assumed; a note on that, and which names tell no class.

    ``lorry@7``, the name of a type that vehicle 7 got for itself by TraCI, stands for ``lorry``. An error says `where`
    the types are defined.
    """
    known = {**_BUILT_IN, **(DEFAULT_TYPES if defined is None else defined)}
    found = [known.get(name) or known.get(name.split("@", 1)[0]) for name in names]
    if defined is None:
        in_name = [class_in_name(name.split("@", 1)[0]) for name in names]
        found = [kind or DEFAULT_TYPES.get(one) for kind, one in zip(found, in_name, strict=True)]
    is_unknown = np.array([kind is None for kind in found], dtype=bool)
    unknown = [name for name, kind in zip(names, found, strict=True) if kind is None]
    if defined is None:
        cars = f", a passenger car's for {listed([name or 'no type' for name in unknown])}" if unknown else ""
        note = f"Sizes: without vehicle_types SUMO's defaults for the vehicle class in the type's name{cars}"
        return [kind or DEFAULT_TYPES["passenger"] for kind in found], [note], is_unknown
    if "" in unknown:
        raise InputError(
            f"{where}: vehicles have no type, so it cannot give their sizes; SUMO writes types unless "
            "--fcd-output.attributes leaves them out: name type there, or do without vehicle_types"
        )
    if unknown:
        raise unknown_name(unknown[0], defined, "type", where)
    lacking = [name for name, kind in zip(names, found, strict=True) if assumed_sides([kind])]
    sides = " and ".join(assumed_sides(found))
    note = f"Sizes: {sides} by SUMO's default for the class where vehicle_types does not say it ({listed(lacking)})"
    return found, [note] if lacking else [], is_unknown


def assumed_sides(types: Sequence[VehicleType]) -> tuple[str, ...]:
    """Which of length, width and height some of the types on a road do not say."""
    return tuple(side for side in DIMENSIONS if any(kind.class_name and side not in kind.given for kind in types))
