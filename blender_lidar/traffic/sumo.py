"""Reading SUMO's floating car data (FCD: XML, CSV or Parquet) and vehicle types, to boxes in the road frame.

Facts of the format: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html; that x and y are the middle of the front
bumper, say SUMO's developers (sumo-user list, msg01529).
"""

from __future__ import annotations

import difflib
import re
import reprlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import numpy as np

from ..errors import InputError, MissingExtraError, printable, unknown_name
from .source import (
    MAX_ROWS,
    column_places,
    csv_columns,
    fields_of,
    first_line,
    number,
    numbers,
    open_bytes,
    quoted,
    table_lines,
)
from .tracks import drop_repeats
from .vehicles import CLASSES, HEIGHTS_M, VAN_LONGER_THAN_M, Placing, Recording, RepairReport, with_overlaps_reported

_WHOLE = re.compile("0|[1-9][0-9]{0,14}", re.ASCII)  # below 2**53
_LARGEST_LANE = 2**15 - 2
_FLAT_WITHIN_M = 0.1
_NAMES_SHOWN = 3
_LONGEST_SHOWN = 40


def read_sumo(
    path: str | Path,
    *,
    vehicle_types: str | Path | None = None,
    origin_m: tuple[float, float] | None = None,
    heading_deg: float | None = None,
) -> Recording:
    """Read floating car data, ``sumo --fcd-output``: XML or CSV, plain or gzip, or Parquet.

    Frame numbers count time steps, as `frames_of` finds them. Vehicles whose ids are all whole numbers keep them; else
    they are numbered from 0 by first appearance. Lanes count from 1, the rightmost: SUMO's index plus one. Headings are
    SUMO's own, neither smoothed nor limited.

    Parameters
    ----------
    path : path
    vehicle_types : path, optional
        A route or additional file with the ``<vType>`` that the recording names. Without it a type that is called as
        one of SUMO's vehicle classes gets that one's default size, any other a passenger car's; the report says so.
    origin_m : (float, float), optional
        The road frame's origin in the net's coordinates [m].
    heading_deg : float, optional
        Direction of the road's x axis in the net [degrees], counter-clockwise from +x.

    Raises
    ------
    MissingFileError, InputError
        If a file or one of its values cannot be used; the text names the line.
    MissingExtraError
        For Parquet without pyarrow.
    """
    defined = None if vehicle_types is None else read_types(vehicle_types)
    chunks = {"parquet": _parquet_chunks, "xml": _xml_chunks}.get(kind_of_fcd(path), _csv_chunks)
    rows, names, report = _collected(chunks(path), path)
    _refuse_degrees(rows, path)
    types, assumed = _types(names["type"], defined, path, vehicle_types)
    frame, step_s, uneven = frames_of(rows["time"])
    told_apart = np.column_stack([rows[name] for name in ("x", "y", "angle", "type", "lane")])
    kept, duplicates, repeated = drop_repeats(rows["id"], frame, told_apart)
    on_road = np.array([found.class_name is not None for found in types])[rows["type"][kept]]
    strangers = Counter(types[code].vehicle_class for code in rows["type"][kept[~on_road]])
    if not on_road.any():
        raise InputError(f"{path}: no vehicle on a road; all are {', '.join(sorted(strangers))}")
    whole = all(_WHOLE.fullmatch(text) for text in names["id"])
    notes = [*uneven]
    if origin_m is None and heading_deg is None:
        notes.insert(0, "neither origin_m nor heading_deg: the road's origin and x axis are the net's own")
    if strangers:
        counts = ", ".join(f"{count:,} of {name}" for name, count in sorted(strangers.items()))
        notes.append(f"rows of vehicles on no road: {counts}")
    if not whole:
        notes.append(f"vehicles are numbered from 0 by first appearance: {_listed(names['id'])}")
    z = rows["z"][~np.isnan(rows["z"])]
    if len(z) and z.max() - z.min() > _FLAT_WITHIN_M:
        notes.append(f"z from {z.min():.1f} to {z.max():.1f} m is left aside: all vehicles stand on a flat road")
    kept = kept[on_road]
    report = replace(
        report,
        rows_used=len(kept),
        duplicates=duplicates,
        repeated=repeated,
        left_out=report.left_out + sum(strangers.values()),
        notes=(*notes, *assumed),
    )
    type_code = rows["type"][kept]
    size = np.array([found.size_m for found in types])[type_code]
    class_index = np.array([CLASSES.index(found.class_name) if found.class_name else -1 for found in types])
    heading = np.radians(90.0 - rows["angle"][kept])
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    placing = Placing(origin_m or (0.0, 0.0), heading_deg or 0.0)
    # SUMO records the front centre.
    centre = placing.points(np.column_stack([rows["x"], rows["y"]])[kept] - size[:, :1] / 2 * forward)
    recording = Recording.from_rows(
        frame=frame[kept],
        time_s=rows["time"][kept] / 1000,
        vehicle_id=(np.array(names["id"], dtype=np.int64) if whole else np.arange(len(names["id"])))[rows["id"][kept]],
        class_index=class_index[type_code],
        centre_m=np.column_stack([centre, size[:, 2] / 2]),
        size_m=size,
        heading_rad=placing.headings(heading),
        lane=np.array([_lane_number(lane) for lane in names["lane"]])[rows["lane"][kept]],
        time_step_s=step_s,
        source=str(path),
        report=report,
    )
    return with_overlaps_reported(recording)


def kind_of_fcd(path: str | Path) -> str | None:
    """What a file looks like: ``"parquet"``, any ``"xml"``, or ``"csv"`` with SUMO's column names; None if neither.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be opened, is empty or neither text nor Parquet.
    """
    with open_bytes(path, unpack=False) as stream:
        if stream.read(4) == b"PAR1":
            return "parquet"
    line = next(table_lines(path), (0, ""))[1]
    if line.lstrip().startswith("<"):
        return "xml"
    names = {name.strip().lower() for name in _header_of(line)[1]}
    return "csv" if "timestep_time" in names or names >= {"time", "id", "x", "y"} else None


def _lane_number(lane: str) -> int:
    """The number of a lane by its id: ``"edge_0"`` is 1; 0 where it tells no index."""
    index = lane.rpartition("_")[2]
    whole = index.isdecimal() and index.isascii() and len(index) < 6 and int(index) <= _LARGEST_LANE
    return int(index) + 1 if whole else 0


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _NAMES_SHOWN:,} more" if len(names) > _NAMES_SHOWN else ""
    return ", ".join(printable(name, _LONGEST_SHOWN) for name in names[:_NAMES_SHOWN]) + more


# --- Rows of floating car data as arrays, whichever kind of file they come from ---------------------------

NEEDED = ("time", "id", "x", "y", "angle")
OPTIONAL = ("type", "lane", "z", "speed")
_TEXTS = ("id", "type", "lane")
_NO_POSITION = -(2.0**30)  # SUMO's INVALID_DOUBLE: the vehicle is nowhere, as while it teleports
_LARGEST = 1e10  # metres, degrees, metres a second: squares and sums stay finite

Values = Sequence[str | float | None]
"""Of one attribute, a value a row, as the file gives them; empty or None where missing."""


class Chunk(NamedTuple):
    """Neighbouring rows of a file.

    Attributes
    ----------
    columns : mapping of str to Values
        By attribute: all of `NEEDED`, and those of `OPTIONAL` that the file has.
    where : callable
        The place of a row of this chunk, counted from 0, as an error names it: ``file:line``.
    left_out : int
        Persons and containers between the rows.
    """

    columns: Mapping[str, Values]
    where: Callable[[int], str]
    left_out: int


def _collected(
    chunks: Iterable[Chunk], path: str | Path
) -> tuple[dict[str, np.ndarray], dict[str, list[str]], RepairReport]:
    """All rows that are vehicles somewhere, checked: columns (n,), the texts behind codes, and counts.

    ``time`` is in ms, as SUMO's clock counts, and ascends; ``angle`` is clockwise from the net's +y [degrees]; ``z``
    and ``speed`` are NaN where the file has none; ``id``, ``type`` and ``lane`` are places in the lists of texts, which
    are in order of first appearance, a missing type or lane being the empty text.
    """
    known: dict[str, dict[str, int]] = {name: {} for name in _TEXTS}
    parts: list[dict[str, np.ndarray]] = []
    rows_read = left_out = 0
    latest_ms = -np.inf
    for chunk in chunks:
        count = len(chunk.columns["id"])
        rows_read += count + chunk.left_out
        left_out += chunk.left_out
        if rows_read > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
        if not count:
            continue
        part = {name: _codes(chunk, name, index) for name, index in known.items()}
        part |= {name: _numbers(chunk, name) for name in ("x", "y", "angle", "z", "speed", "time")}
        time_ms = part["time"] = np.rint(1000.0 * part["time"]).astype(np.int64)
        before = np.concatenate([[latest_ms], time_ms[:-1]])
        if (time_ms < before).any():
            row = int((time_ms < before).argmax())
            late, early = before[row] / 1000, time_ms[row] / 1000
            raise InputError(f"{chunk.where(row)}: time {early} s comes after {late} s; times must ascend")
        latest_ms = time_ms[-1]
        parts.append(part)
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]} if parts else {"x": np.zeros(0)}
    somewhere = rows["x"] != _NO_POSITION
    if not somewhere.any():
        raise InputError(f"{path}: no vehicle in {rows_read:,} rows; at least one is needed")
    report = RepairReport(rows_read=rows_read, left_out=left_out, off_map=int((~somewhere).sum()))
    names = {name: list(index) for name, index in known.items()}
    return {name: column[somewhere] for name, column in rows.items()}, names, report


def _codes(chunk: Chunk, name: str, index: dict[str, int]) -> np.ndarray:
    """Places of texts in `index`, which grows, (n,) int64."""
    texts = chunk.columns.get(name)
    if texts is None:
        return np.full(len(chunk.columns["id"]), index.setdefault("", len(index)))
    texts = ["" if text is None else str(text) for text in texts]
    if name == "id" and "" in texts:
        raise InputError(f"{chunk.where(texts.index(''))}: id is missing")
    return np.array([index.setdefault(text, len(index)) for text in texts], dtype=np.int64)


def _numbers(chunk: Chunk, name: str) -> np.ndarray:
    """Finite numbers, (n,); NaN where an attribute that may be missing is."""
    values = chunk.columns.get(name)
    if values is None:
        return np.full(len(chunk.columns["id"]), np.nan)
    found = values if isinstance(values, np.ndarray) else numbers(values)
    for row in np.flatnonzero(~(np.abs(found) <= _LARGEST)):
        value = values[row]
        if name in OPTIONAL and (value in (None, "") or str(value).strip(" +-").lower() == "nan"):
            continue
        if value in (None, ""):
            hint = "; SUMO leaves it out if --fcd-output.attributes does" if name in ("x", "y", "angle") else ""
            raise InputError(f"{chunk.where(row)}: {name} is missing{hint}")
        allowed = f"{-_LARGEST:g} to {_LARGEST:g}" if np.isfinite(number(value)) else "a finite number"
        hint = " (leave out SUMO's --human-readable-time)" if name == "time" and ":" in str(value) else ""
        raise InputError(f"{chunk.where(row)}: {name} is {quoted(value)}; allowed: {allowed}{hint}")
    return found


# --- XML: the start tags, streamed: nothing is built, so that memory does not grow with the file ----------

_BLOCK_BYTES = 2**18
_ROOT = "fcd-export"
_ATTRIBUTES = tuple(name for name in (*NEEDED, *OPTIONAL) if name != "time")


def _start_tags(path: str | Path) -> Iterator[list[tuple[int, int, str, dict[str, str]]]]:
    """The start tags of a file, plain or gzip, a block of the file at a time.

    Each is its line (from 1), its depth (1 for the root element), its name and its attributes.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if the file is not well-formed XML, or declares an encoding that cannot be read.
    """
    tags: list[tuple[int, int, str, dict[str, str]]] = []
    depth = 0
    parser = expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        tags.append((parser.CurrentLineNumber, depth, name, attributes))

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    with open_bytes(path) as stream:
        block = b"more"
        while block:
            block = stream.read(_BLOCK_BYTES)
            try:
                parser.Parse(block, not block)
            except expat.ExpatError as error:
                reason = expat.ErrorString(error.code)
                raise InputError(f"{path}:{error.lineno}: truncated or damaged XML ({reason})") from error
            except (LookupError, ValueError) as error:  # unknown, or such as only a few encodings are
                raise InputError(
                    f"{path}: XML in an encoding that cannot be read ({error}); SUMO writes UTF-8"
                ) from error
            yield tags
            tags = []


def _xml_chunks(path: str | Path) -> Iterator[Chunk]:
    """The vehicles of a file as ``sumo --fcd-output run.fcd.xml`` writes it; persons and containers are counted."""
    time: str | None = None
    for tags in _start_tags(path):
        rows: list[tuple] = []
        lines: list[int] = []
        left_out = 0
        for line, depth, name, attributes in tags:
            if depth == 3 and time is not None and name in _KINDS:
                if name == "vehicle":
                    rows.append((time, *map(attributes.get, _ATTRIBUTES)))
                    lines.append(line)
                else:
                    left_out += 1
            elif depth == 1 and name != _ROOT:
                raise InputError(
                    f"{path}:{line}: the root element is <{printable(name, 40)}>; a recording of SUMO's has <{_ROOT}> "
                    "(--fcd-output)"
                )
            elif name == "vehicle":
                raise InputError(f"{path}:{line}: <vehicle> outside a <timestep>; SUMO writes it inside one")
            elif depth == 2:
                time = attributes.get("time", "") if name == "timestep" else None
        if rows or left_out:
            columns = zip(*rows, strict=True) if rows else [()] * (1 + len(_ATTRIBUTES))
            columns = dict(zip(("time", *_ATTRIBUTES), columns, strict=True))
            yield Chunk(columns, lambda row, lines=lines: f"{path}:{lines[row]}", left_out)


# --- CSV and Parquet, which call an attribute by several names --------------------------------------------
# SUMO's own files (since 1.22) name all columns after the first element of the recording, ``vehicle_x`` or
# ``person_x``, and put vehicles, persons and containers into the same ones: only vehicles have a lane.
# ``--output.column-header`` makes them ``x`` or ``timestep_vehicle_x``. SUMO's tool ``xml2csv.py`` gives each kind of
# element columns of its own.

_DELIMITERS = (";", ",", "\t")
_KINDS = ("vehicle", "person", "container")
_MARKS = ("tag", "person_id", "container_id")  # further columns that tell what a row is
_PARQUET_ROWS = 50_000


def _header_of(line: str) -> tuple[str, list[str]]:
    """The delimiter of a header, and its fields."""
    delimiter = max(_DELIMITERS, key=line.count)
    return delimiter, fields_of(line, delimiter)


def _csv_chunks(path: str | Path) -> Iterator[Chunk]:
    """The vehicles of a file that ``sumo --fcd-output run.fcd.csv`` or the tool ``xml2csv.py`` wrote."""
    line, text = first_line(path, "a recording of SUMO's")
    delimiter, header = _header_of(text)
    places = _places_of_columns(header, f"{path}:{line}")
    for lines, columns in csv_columns(path, line, len(header), delimiter):
        found = {name: columns[place] for name, place in places.items()}
        yield _chunk_of_vehicles(found, lambda row, lines=lines: f"{path}:{lines[row]}")


def _parquet_chunks(path: str | Path) -> Iterator[Chunk]:
    """The vehicles of a file that ``sumo --fcd-output run.fcd.parquet`` wrote, by pyarrow."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        reason = "" if isinstance(error, ModuleNotFoundError) else f" ({error})"
        raise MissingExtraError(
            f'{path}: Parquet files need pyarrow: pip install "blender_lidar[parquet]"{reason}'
        ) from error
    try:
        with pyarrow.parquet.ParquetFile(path) as file:
            schema = file.schema_arrow
            places = _places_of_columns(schema.names, str(path))
            names = {attribute: schema.names[place] for attribute, place in places.items()}
            for name in names.values():
                kind = schema.field(name).type
                kind = kind.value_type if pyarrow.types.is_dictionary(kind) else kind
                if not re.fullmatch("(large_)?string|null|double|(half)?float|u?int[0-9]+", str(kind)):
                    shown, held = printable(name, _LONGEST_SHOWN), printable(str(kind), _LONGEST_SHOWN)
                    raise InputError(f"{path}: column {shown} holds {held}; allowed: numbers or texts")
            first = 1
            for batch in file.iter_batches(batch_size=_PARQUET_ROWS, columns=[*names.values()]):
                columns = {attribute: _parquet_values(batch.column(name)) for attribute, name in names.items()}
                yield _chunk_of_vehicles(columns, lambda row, first=first: f"{path}: row {first + row}")
                first += batch.num_rows
    except InputError:  # a ValueError too
        raise
    except (pyarrow.ArrowException, OSError, ValueError, LookupError) as error:  # some of them of places beyond the end
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: truncated or damaged Parquet file ({reason})") from error


def _parquet_values(column) -> Values:
    if str(column.type) in ("double", "float"):
        return column.to_numpy(zero_copy_only=False).astype(np.float64)
    return column.to_pylist()


def _places_of_columns(header: Sequence[str], where: str) -> dict[str, int]:
    """Which column of a `header` holds which attribute; `where` is the header's place, as an error names it."""
    names = [name.strip().lower().removeprefix("timestep_") for name in header]
    kind = next((kind for kind in _KINDS if f"{kind}_id" in names), "vehicle")
    attributes = [name.removeprefix(f"{kind}_") for name in names]
    needed = {name: "timestep_time" if name == "time" else f"vehicle_{name}" for name in NEEDED}
    return column_places(attributes, needed, (*OPTIONAL, *_MARKS), where)


def _chunk_of_vehicles(columns: dict[str, Values], where: Callable[[int], str]) -> Chunk:
    """Rows without those that are persons, containers or empty timesteps."""

    def given(name: str) -> np.ndarray:
        return np.array([value is not None and value != "" and value == value for value in columns[name]], dtype=bool)

    there = given("id") | given("x")
    vehicle = there & given("lane") if "lane" in columns else there
    if "tag" in columns:
        vehicle &= ~np.isin(columns["tag"], _KINDS[1:])
    others = [~there & given(name) for name in _MARKS[1:] if name in columns]
    left_out = (there & ~vehicle).sum() + np.logical_or.reduce(others).sum()
    kept = np.flatnonzero(vehicle)
    vehicles = {name: columns[name] for name in (*NEEDED, *OPTIONAL) if name in columns}
    if len(kept) < len(there):
        vehicles = {
            name: values[kept] if isinstance(values, np.ndarray) else [values[row] for row in kept]
            for name, values in vehicles.items()
        }
    return Chunk(vehicles, lambda row: where(kept[row]), int(left_out))


# --- Classes and sizes of vehicles: a recording names a type, whose size stands in a route or additional file


class VehicleType(NamedTuple):
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


DEFAULT_TYPES = {
    name: VehicleType(name, class_name, size_m)
    for name, class_name, size_m in (
        ("ignoring", "car", (5.0, 1.8, 1.5)),
        ("private", "car", (5.0, 1.8, 1.5)),
        ("emergency", "van", (6.5, 2.16, 2.86)),
        ("authority", "car", (5.0, 1.8, 1.5)),
        ("army", "car", (5.0, 1.8, 1.5)),
        ("vip", "car", (5.0, 1.8, 1.5)),
        ("passenger", "car", (5.0, 1.8, 1.5)),
        ("hov", "car", (5.0, 1.8, 1.5)),
        ("taxi", "car", (5.0, 1.8, 1.5)),
        ("bus", "bus", (12.0, 2.5, 3.4)),
        ("coach", "bus", (14.0, 2.6, 4.0)),
        ("delivery", "van", (6.5, 2.16, 2.86)),
        ("truck", "truck", (7.1, 2.4, 2.4)),
        ("trailer", "truck", (16.5, 2.55, 4.0)),
        ("tram", "bus", (22.0, 2.4, 3.2)),
        ("rail_urban", None, (109.5, 3.0, 3.6)),
        ("rail", None, (135.0, 2.84, 3.75)),
        ("rail_electric", None, (200.0, 2.95, 3.89)),
        ("rail_fast", None, (200.0, 2.95, 3.89)),
        ("motorcycle", "motorcycle", (2.2, 0.9, 1.5)),
        ("moped", "motorcycle", (2.1, 0.78, 1.7)),
        ("bicycle", "motorcycle", (1.6, 0.65, 1.7)),
        ("pedestrian", None, (0.215, 0.478, 1.719)),
        ("evehicle", "car", (5.0, 1.8, 1.5)),
        ("ship", None, (17.0, 4.0, 4.0)),
        ("container", None, (6.096, 2.438, 2.591)),
        ("cable_car", None, (5.0, 1.8, 1.5)),
        ("subway", None, (109.5, 3.0, 3.6)),
        ("aircraft", None, (72.7, 79.8, 1.5)),
        ("wheelchair", None, (1.2, 0.72, 1.2)),
        ("scooter", "motorcycle", (1.2, 0.5, 1.7)),
        ("drone", None, (0.5, 0.5, 1.5)),
        ("custom1", "car", (5.0, 1.8, 1.5)),
        ("custom2", "car", (5.0, 1.8, 1.5)),
    )
}
"""By SUMO's vehicle class, of which nothing else is known; 5 m by default say nothing about a van, and a tram stands in
the street as a bus does. Sizes: "Vehicle Type Parameter Defaults" of its documentation, as SUMO 1.28.0 tells them by
TraCI."""
_BUILT_IN = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_TAXITYPE": "taxi",
    "DEFAULT_BIKETYPE": "bicycle",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_CONTAINERTYPE": "container",
    "DEFAULT_RAILTYPE": "rail",
}
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
    for tags in _start_tags(path):
        for line, _, element, attributes in tags:
            if element != "vType":
                continue
            name = attributes.get("id", "")
            if not name:
                raise InputError(f"{path}:{line}: a vType without an id")
            if name in types:
                raise InputError(f"{path}:{line}: vType {_SHORT.repr(name)} is there twice")
            types[name] = _read_type(attributes, f"{path}:{line}")
    if not types:
        raise InputError(f"{path}: no <vType>; a route or additional file that defines the vehicles is needed")
    return types


def _read_type(attributes: dict[str, str], where: str) -> VehicleType:
    vehicle_class = attributes.get("vClass", "passenger")
    if vehicle_class not in DEFAULT_TYPES:
        raise unknown_name(vehicle_class[:40], DEFAULT_TYPES, "vClass", where)
    _, name, usual = DEFAULT_TYPES[vehicle_class]
    size = dict(zip(("length", "width", "height"), usual, strict=True))
    given = {key: number(attributes[key]) for key in size if key in attributes}
    for key, value in given.items():
        if not 0 < value <= _LARGEST_M:
            raise InputError(
                f"{where}: {key} of vType {_SHORT.repr(attributes['id'])} is {attributes[key][:40]!r}; "
                f"allowed: more than 0, at most {_LARGEST_M:g} m"
            )
    drawn_as = _DRAWN_AS.get(attributes.get("guiShape", ""))
    if name and drawn_as:
        name = drawn_as
    # The 5 m that most classes have by default are longer than many a van: alone they say nothing, written out or not.
    is_larger = any(given.get(key, 0.0) > size[key] for key in ("length", "height"))
    if name == "car" and not drawn_as and given.get("length", 0.0) > VAN_LONGER_THAN_M and is_larger:
        name, size["height"] = "van", HEIGHTS_M["van"]
    return VehicleType(vehicle_class, name, tuple((size | given).values()))


def _types(
    names: list[str], defined: dict[str, VehicleType] | None, source: str | Path, file: str | Path | None
) -> tuple[list[VehicleType], list[str]]:
    """The type behind each name: of those that `file` defines, or else assumed; and a note on what is assumed.

    ``lorry@7``, the name of a type that vehicle 7 got for itself by TraCI, stands for ``lorry``.
    """
    known = {name: DEFAULT_TYPES[vehicle_class] for name, vehicle_class in _BUILT_IN.items()}
    known |= DEFAULT_TYPES if defined is None else defined
    found = [known.get(name) or known.get(name.split("@", 1)[0]) for name in names]
    unknown = [name for name, known_as in zip(names, found, strict=True) if known_as is None]
    if defined is None:
        cars = f", a passenger car's for {_listed([name or 'no type' for name in unknown])}" if unknown else ""
        assumed = f"no vehicle_types: sizes are SUMO's defaults for the type's vehicle class{cars}"
        return [known_as or DEFAULT_TYPES["passenger"] for known_as in found], [assumed]
    if unknown and not unknown[0]:
        whose = "a vehicle has" if any(names) else "the vehicles have"
        raise InputError(
            f"{source}: {whose} no type, by which {file} could say the size; SUMO writes types unless "
            "--fcd-output.attributes leaves them out: name type there, or do without vehicle_types"
        )
    if unknown:
        near = difflib.get_close_matches(unknown[0][:_LONGEST_SHOWN], list(defined), n=1, cutoff=0.5)
        hint = f"; did you mean {_SHORT.repr(near[0])}?" if near else ""
        raise InputError(
            f"{source}: type {_SHORT.repr(unknown[0])} is none of the {len(defined)} that {file} defines{hint}"
        )
    return found, []


# --- Which frame an instant of SUMO's floating car data is: times are in the files, numbers are not -------

_COARSEST_ROUNDING_MS = 10  # SUMO writes two digits by default
_ROUNDING_WITHIN = 0.4  # of a step, so that neighbouring instants stay apart
_FEWEST_STEPS = 4  # from which on a rhythm can be told from chance


def frames_of(time_ms: np.ndarray) -> tuple[np.ndarray, float, list[str]]:
    """Frame numbers, and the time from one to the next.

    The step is the longest of which all differences between instants are multiples, if two instants are that close.
    Times that were rounded when they were written, such as 0.00, 0.33, 0.67, 1.00, have no such step: theirs is the
    mean one, if counting it meets every instant within the rounding. Else they are uneven.

    Parameters
    ----------
    time_ms : ndarray, (n,) int64

    Returns
    -------
    frame : ndarray, (n,) int64
        Different for different times, and ascending with them; 0 is about time 0.
    step_s : float
        That of an only instant is the longest of which both it and a second are multiples.
    notes : list of str
        What is doubtful about them, as sentences.
    """
    distinct, of_row = np.unique(time_ms, return_inverse=True)
    if len(distinct) == 1:
        step = int(np.gcd(distinct[0], 1000))
        return time_ms // step, step / 1000, []
    apart = np.diff(distinct)
    common = int(np.gcd.reduce(apart))
    if common == apart.min():
        return time_ms // common, common / 1000, []
    digit = int(np.gcd.reduce(distinct))
    rounded = _rounded(distinct, digit)
    if rounded is not None:
        frame, step = rounded
        return (
            frame[of_row],
            step / 1000,
            [f"times are rounded to {digit / 1000:g} s: a time step of {step / 1000:.4g} s"],
        )
    least, usual, most = (value / 1000 for value in (apart.min(), np.median(apart), apart.max()))
    uneven = (
        f"times are {least:g} to {most:g} s apart, {usual:g} s in the median: frames count steps of {common / 1000:g} s"
    )
    return time_ms // common, common / 1000, [uneven]


def _rounded(distinct: np.ndarray, digit: int) -> tuple[np.ndarray, float] | None:
    """Frame number of every instant and the step [ms], if the instants are multiples of a step rounded to `digit`."""
    apart = np.diff(distinct)
    if digit > _COARSEST_ROUNDING_MS or len(apart) < _FEWEST_STEPS:
        return None
    usual = np.sort(apart)[len(apart) // 2]
    step = apart[np.abs(apart - usual) <= digit].mean()
    if digit > _ROUNDING_WITHIN * step:
        return None
    count = np.concatenate([[0], np.cumsum(np.rint(apart / step).astype(np.int64))])
    if (np.diff(count) < 1).any():
        return None
    step = (distinct[-1] - distinct[0]) / count[-1]
    if (np.abs(distinct - distinct[0] - step * count) > digit).any():
        return None
    return count + int(np.rint(distinct[0] / step)), float(step)


# --- Telling longitude and latitude, ``sumo --fcd-output.geo``, from metres: no column says which they are -

_MOVED_SHARE = 1e-3  # a degree is 111 km: in degrees the share is 1e-5
_CLOSEST_M = 0.5


def _refuse_degrees(rows: dict[str, np.ndarray], source: str | Path) -> None:
    """Refuse longitude and latitude: numbers in their range, between which vehicles get nowhere near their speed."""
    xy, time_ms, vehicle = np.column_stack([rows["x"], rows["y"]]), rows["time"], rows["id"]
    if (np.abs(xy).max(axis=0) > (180, 90)).any():
        return
    order = np.lexsort((time_ms, vehicle))
    same = np.diff(vehicle[order]) == 0
    moved = np.hypot(*np.diff(xy[order], axis=0).T)[same]
    by_speed = rows["speed"][order][1:][same] * (np.diff(time_ms[order])[same] / 1000)
    known = np.isfinite(by_speed)
    if by_speed[known].sum() > 1.0:
        in_degrees = 0 < moved[known].sum() < _MOVED_SHARE * by_speed[known].sum()
    else:  # nobody moves, or no speeds: of all vehicles at one moment, no two are then as far apart as cars must be
        times, counts = np.unique(time_ms, return_counts=True)
        fullest = xy[time_ms == times[counts.argmax()]]
        in_degrees = len(fullest) > 1 and np.ptp(fullest, axis=0).max() < _CLOSEST_M
    if in_degrees:
        raise InputError(
            f"{source}: x and y are longitude and latitude; metres are needed: run SUMO without --fcd-output.geo, "
            "or with --fcd-output.utm"
        )
