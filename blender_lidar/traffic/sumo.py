"""Reading SUMO's floating car data (FCD: XML, CSV or Parquet) and vehicle types, to boxes in the road frame.

Facts of the format: https://sumo.dlr.de/docs/Simulation/Output/FCDOutput.html; that x and y are the middle of the front
bumper, say SUMO's developers (sumo-user list, msg01529).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from ..csv_header import TableLayout, delimiter_of, fields_of, first_lines, short
from ..csv_tables import MAX_ROWS, Column, Rows, read_rows
from ..errors import InputError
from ..rigid import Rigid
from .sumo_types import assumed_sides, is_config, person_type, read_types, start_tags, types_of
from .tracks import drop_repeats, vehicle_ids, vehicle_numbers
from .vehicles import CLASSES, Recording, RepairReport, ground_sample

_LANE = re.compile(".*_([0-9]{1,5})", re.DOTALL)
_LARGEST_LANE = 2**15 - 2
_WITHIN_DEGREES = 1.0  # 111 km: no scene is as large; in metres, no traffic is as small


def read_sumo(
    path: str | Path,
    *,
    vehicle_types: str | Path | Sequence[str | Path] | None = None,
    origin_m: tuple[float, float] | None = None,
    heading_deg: float | None = None,
) -> Recording:
    """Read floating car data, ``sumo --fcd-output``: XML or CSV, plain or gzip, or Parquet.

    Frame numbers count time steps, as `frames_of` finds them. Vehicles whose ids are all whole numbers keep them; else
    they are numbered from 0 by first appearance; persons, who may have the same ids, are numbered after them. Persons
    in a vehicle are left out. Lanes count from 1, the rightmost: SUMO's index plus one. Headings are SUMO's own,
    neither smoothed nor limited.

    Parameters
    ----------
    path : path
    vehicle_types : path or several, optional
        Route or additional files with the ``<vType>`` that the recording names. Without them a type in whose name is
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
    if is_config(path):
        raise InputError(
            f"{path}: is SUMO's configuration, not its output; init takes it, or give the file of its fcd-output"
        )
    files = [vehicle_types] if isinstance(vehicle_types, str | Path) else list(vehicle_types or ())
    defined = read_types(*files) if files else None
    rows, names, report = _collected(path)
    types, assumed, unknown = types_of(names["type"], defined, f"{path}: vehicle_types {', '.join(map(str, files))}")
    sides = assumed_sides(types)
    types += [person_type(name, defined) for name in names["person_type"]]
    names["type"] += names["person_type"]
    unknown = np.append(unknown, np.zeros(len(names["person_type"]), dtype=bool))
    frame, step_s, notes = frames_of(rows["time"])
    notes += report.notes
    content = np.column_stack([rows[name] for name in ("x", "y", "angle", "type", "lane")])
    kept, duplicates, repeated = drop_repeats(rows["id"], frame, content)
    on_road = np.array([kind.class_name is not None for kind in types])[rows["type"][kept]]
    strangers = Counter(names["type"][code] for code in rows["type"][kept[~on_road]])
    if not on_road.any():
        raise InputError(f"{path}: no vehicle on a road; all are {', '.join(map(short, sorted(strangers)))}")
    if origin_m is None and heading_deg is None:
        notes.insert(0, "neither origin_m nor heading_deg: the road's origin and x axis are the net's own")
    if strangers:
        counts = ", ".join(f"{count:,} of {short(name)}" for name, count in sorted(strangers.items()))
        notes.append(f"rows of vehicles on no road: {counts}")
    vehicle_id, numbered = vehicle_numbers(names["id"])
    vehicle_id = np.append(vehicle_id, 1 + vehicle_id.max() + np.arange(len(names["person"])))
    notes += numbered
    rows, frame = {name: column[kept[on_road]] for name, column in rows.items()}, frame[kept[on_road]]
    cars = np.unique(rows["id"][unknown[rows["type"]]])
    size = np.array([kind.size_m for kind in types])[rows["type"]]
    class_index = np.array([CLASSES.index(kind.class_name or "car") for kind in types])[rows["type"]]
    heading = heading_of_sumo_angle(rows["angle"])
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    T_site_net = Rigid.about_z(math.radians(heading_deg or 0.0), origin_m or (0.0, 0.0)).inverse
    # SUMO records the front centre, of persons too (`MSPModel_Striping`, where they walk by stripes).
    centre = T_site_net.points(np.column_stack([rows["x"], rows["y"]]) - size[:, :1] / 2 * forward)
    ground = ground_sample(centre, rows["z"])
    return Recording.from_rows(
        frame=frame,
        time_s=rows["time"] / 1000,
        vehicle_id=vehicle_id[rows["id"]],
        class_index=class_index,
        centre_m=np.column_stack([centre, size[:, 2] / 2]),
        size_m=size,
        heading_rad=T_site_net.headings(heading),
        lane=np.array([_lane_number(name) for name in names["lane"]])[rows["lane"]],
        time_step_s=step_s,
        source=str(path),
        report=replace(
            report,
            rows_used=len(frame),
            duplicates=duplicates,
            repeated=repeated,
            left_out=report.left_out + strangers.total(),
            types_unknown=len(cars),
            notes=tuple(notes),
            assumed=(*assumed, *_not_used(ground)),
            assumed_sizes=sides,
            ground=ground,
        ),
    )


def heading_of_sumo_angle(angle_deg: np.ndarray) -> np.ndarray:
    """SUMO's angle, clockwise from the net's +y [degrees], as a heading, counter-clockwise from +x [rad]."""
    return np.radians(90.0 - angle_deg)


def _not_used(ground: np.ndarray) -> list[str]:
    """What becomes of heights that are not all alike."""
    if not len(ground):
        return []
    low, high = ground[:, 2].min(), ground[:, 2].max()
    return [f"Ground: z from {low:.1f} to {high:.1f} m checks the grade alone; vehicles stand on the plane of [road]"]


def kind_of_fcd(path: str | Path) -> str | None:
    """What a file looks like: any ``"xml"``, or a ``"table"`` with SUMO's names of columns; None if neither.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be opened, is empty or neither text nor Parquet.
    """
    line = first_lines(path)[0][1]
    if line.lstrip().startswith("<"):
        return "xml"
    names = {name.lower() for name in fields_of(line, delimiter_of(line, ()))}
    return "table" if "timestep_time" in names or names >= {"time", "id", "x", "y"} else None


def _lane_number(lane: str) -> int:
    """The number of a lane by its id: ``"edge_0"`` is 1; 0 where it holds no index."""
    found = _LANE.fullmatch(lane)
    return int(found[1]) + 1 if found and int(found[1]) <= _LARGEST_LANE else 0


# --- Rows of floating car data as arrays, whichever kind of file they come from ---------------------------

_FAR = 1e10  # metres, degrees: squares and sums stay finite
_PLACE = Column("a finite number (SUMO leaves it out if --fcd-output.attributes does)", -_FAR, _FAR)
FCD_COLUMNS = {
    "time": Column("a finite number of seconds (leave out SUMO's --human-readable-time)", -_FAR, _FAR),
    **dict.fromkeys(("x", "y", "angle"), _PLACE),
    "z": Column("a finite number", -_FAR, _FAR, optional=True),
}
"""The columns of numbers; ``time`` is in s, ``angle`` clockwise from the net's +y [degrees]."""
FCD_NEEDED = ("time", "id", "x", "y", "angle")
_TEXTS = ("id", "type", "lane")
_NO_POSITION = -(2.0**30)  # SUMO's INVALID_DOUBLE: the vehicle is nowhere, as while it teleports
_KINDS = ("vehicle", "person", "container")
_CONTAINER = "DEFAULT_CONTAINERTYPE"  # what a container is, whatever it is called
_OF_PERSONS = {"id": "person", "type": "person_type"}  # whose ids and types are names of their own


def _collected(path: str | Path) -> tuple[dict[str, np.ndarray], dict[str, list[str]], RepairReport]:
    """All rows that are somewhere, checked: columns (n,), the texts behind codes, and counts.

    ``time`` is in ms, as SUMO's clock counts, and ascends; ``z`` is NaN where the file has none; ``id``, ``type`` and
    ``lane`` are places in the lists of texts, which are in order of first appearance, a missing type or lane being the
    empty text; ids and types of persons, ``person`` and ``person_type``, count on after those of vehicles.
    """
    known: dict[str, dict[str, int]] = {name: {} for name in (*_TEXTS, *_OF_PERSONS.values())}
    parts: list[dict[str, np.ndarray]] = []
    rows_read = 0
    latest_ms = -(10**15)
    for rows in (_xml_rows if kind_of_fcd(path) == "xml" else _table_rows)(path):
        used = rows.columns["tag"] != ""
        rows_read += int(used.sum())
        if rows_read > MAX_ROWS:
            raise InputError(f"{path}: more than {MAX_ROWS:,} rows; split the file")
        if not used.any():
            continue
        rows = rows if used.all() else rows.select(used)
        part = _coded(rows, known)
        part |= {name: rows.numbers(name, column) for name, column in FCD_COLUMNS.items()}
        part["time"] = np.rint(1000.0 * part["time"]).astype(np.int64)
        early = np.flatnonzero(np.diff(part["time"], prepend=latest_ms) < 0)
        if len(early):
            raise InputError(f"{rows.where(early[0])}: time {part['time'][early[0]] / 1000} s comes after a later one")
        latest_ms = part["time"][-1]
        parts.append(part)
    names = parts[0] if parts else ()
    columns = {"x": np.zeros(0)} | {name: np.concatenate([part[name] for part in parts]) for name in names}
    somewhere = columns["x"] != _NO_POSITION
    if not (somewhere & (columns.get("id", columns["x"]) >= 0)).any():
        raise InputError(f"{path}: no vehicle in {rows_read:,} rows; at least one is needed")
    off_map = int((~somewhere).sum())
    columns = {name: column[somewhere] for name, column in columns.items()}
    carried, notes = _in_vehicles(columns), ()
    if _elsewhere(columns):
        carried, notes = columns["id"] < 0, (_PERSONS_ELSEWHERE,)
    columns = {name: column[~carried] for name, column in columns.items()}
    for name in _OF_PERSONS:
        columns[name] = np.where(columns[name] < 0, len(known[name]) - 1 - columns[name], columns[name])
    xy = np.stack([columns["x"], columns["y"]])
    if (np.abs(xy).max(axis=1) <= (180, 90)).all() and 0 < np.ptp(xy, axis=1).max() < _WITHIN_DEGREES:
        raise InputError(
            f"{path}: x and y are longitude and latitude; metres are needed: run SUMO without --fcd-output.geo, "
            "or with --fcd-output.utm"
        )
    report = RepairReport(rows_read=rows_read, left_out=int(carried.sum()), off_map=off_map, notes=notes)
    return columns, {name: list(index) for name, index in known.items()}, report


def _coded(rows: Rows, known: dict[str, dict[str, int]]) -> dict[str, np.ndarray]:
    """The columns of texts as places in their lists, (n,) each; of persons' ids and types -1 and less."""
    person = rows.columns["tag"] == "person"
    part = {}
    for name in _TEXTS:
        part[name] = np.empty(len(rows), dtype=np.int64)
        for which, own in ((~person, name), (person, _OF_PERSONS.get(name, name))):
            if which.any():
                some, index = rows.select(which), known[own]
                found = vehicle_ids(some, name, index) if name == "id" else some.codes(name, index)
                part[name][which] = found if own == name else -1 - found
    return part


def _in_vehicles(columns: dict[str, np.ndarray]) -> np.ndarray:
    """Which rows are of persons in vehicles, (n,) bool: they are where a vehicle is at the same time."""
    person = columns["id"] < 0
    if not person.any():
        return person
    places = np.column_stack([columns["time"], columns["x"], columns["y"]]).view("V24")[:, 0]  # three floats as one
    return person & np.isin(places, places[~person])


_APART_M = 10_000.0
_PERSONS_ELSEWHERE = (
    "persons are left out: they are kilometres from all vehicles, as SUMO writes them with --fcd-output.utm"
)


def _elsewhere(columns: dict[str, np.ndarray]) -> bool:
    """Whether persons are in another frame than vehicles: SUMO writes vehicles alone in UTM."""
    person = columns["id"] < 0
    middles = [[np.median(columns[axis][which]) for axis in "xy"] for which in (person, ~person) if which.any()]
    return len(middles) == 2 and float(np.hypot(*np.subtract(*middles))) > _APART_M


# --- XML --------------------------------------------------------------------------------------------------

_CHUNK_TAGS = 10_000
_ROOT = "fcd-export"
_ATTRIBUTES = ("id", "x", "y", "angle", "type", "lane")


def _xml_rows(path: str | Path) -> Iterator[Rows]:
    """The vehicles, persons and containers of a file as ``sumo --fcd-output run.fcd.xml`` writes it."""
    time: str | None = None
    tags = start_tags(path)
    line, root, _ = next(tags)
    if root != _ROOT:
        raise InputError(
            f"{path}:{line}: the root element is <{short(root)}>; a recording of SUMO's has <{_ROOT}> (--fcd-output)"
        )
    while chunk := list(islice(tags, _CHUNK_TAGS)):
        names = (*_ATTRIBUTES, "z") if any("z" in attributes for _, _, attributes in chunk) else _ATTRIBUTES
        rows, lines = [], []
        for line, name, attributes in chunk:
            if name == "timestep":
                time = attributes.get("time", "")
            elif name in _KINDS:
                if time is None:
                    raise InputError(f"{path}:{line}: <{name}> outside a <timestep>; SUMO writes it inside one")
                if "segment" in attributes:
                    raise InputError(
                        f"{path}:{line}: is of a mesoscopic run, whose vehicles have no places of their own; run SUMO "
                        "without --mesosim"
                    )
                if name == "container":
                    name, attributes["type"] = "person", _CONTAINER
                rows.append((name, time, *map(attributes.get, names)))
                lines.append(line)
        if rows:
            columns = dict(zip(("tag", "time", *names), np.array(rows, dtype=object).T, strict=True))
            yield Rows(columns, lines, f"{path}:")


# --- CSV and Parquet, which call an attribute by several names --------------------------------------------
# SUMO's own files (since 1.22) name all columns after the first element of the recording, ``vehicle_x`` or
# ``person_x``, and put vehicles, persons and containers into the same ones: only vehicles have a lane.
# ``--output.column-header`` makes them ``x`` or ``timestep_vehicle_x``. SUMO's tool ``xml2csv.py`` gives each kind of
# element columns of its own.

_OWN = {f"{kind}_{name}": FCD_COLUMNS[name] for kind in _KINDS[1:] for name in ("x", "y", "angle", "z")}
_MARKS = ("tag", *(f"{kind}_{name}" for kind in _KINDS[1:] for name in ("id", "type")))  # that tell what a row is
_OPTIONAL = ("type", "lane", "z", *_MARKS, *_OWN)


def _table_rows(path: str | Path) -> Iterator[Rows]:
    """The rows of a file that ``sumo --fcd-output`` wrote as CSV or Parquet, or the tool ``xml2csv.py``."""
    line, text = first_lines(path)[0]
    delimiter = delimiter_of(text, ())
    layout = TableLayout(_attributes(fields_of(text, delimiter)), delimiter, line + 1)
    layout.check(FCD_NEEDED, _OPTIONAL, path)
    yield from map(_with_tags, read_rows(path, layout, FCD_COLUMNS | _OWN, (*_TEXTS, *_MARKS)))


def _attributes(header: Sequence[str]) -> list[str]:
    """Which attribute each column of a header holds."""
    names = [name.strip().lower().removeprefix("timestep_") for name in header]
    kind = next((kind for kind in _KINDS if f"{kind}_id" in names), "vehicle")
    return [name.removeprefix(f"{kind}_") for name in names]


def _with_tags(rows: Rows) -> Rows:
    """The same rows with the column ``tag``: vehicle, person or nothing, as in an empty timestep.

    SUMO's own columns do not tell persons from containers, whose types do; its tool gives both columns of their own.
    """

    def given(name: str) -> np.ndarray:
        values = rows.columns.get(name, np.full(len(rows), None))
        if values.dtype.kind == "f":
            return ~np.isnan(values)
        values = values.astype(object)
        return (values != "") & (values == values) & np.not_equal(values, None)  # NaN is not equal to itself

    there = given("id") | given("x")
    columns, other = dict(rows.columns), np.zeros(len(rows), dtype=bool)
    for kind in _KINDS[1:]:
        own = ~there & given(f"{kind}_id")
        other |= own
        for name in ("id", "type", "x", "y", "angle", "z") if own.any() else ():
            theirs = columns.get(f"{kind}_{name}", np.full(len(rows), None))
            columns[name] = np.where(own, theirs, columns.get(name, np.full(len(rows), None)))
        if kind == "container" and own.any():
            columns["type"] = np.where(own, _CONTAINER, columns["type"])
    if "lane" in rows.columns:
        other |= there & ~given("lane")
    if "tag" in rows.columns:
        other |= there & np.isin(rows.columns["tag"].astype(str), _KINDS[1:])
    return replace(rows, columns={**columns, "tag": np.select([other, there], ["person", "vehicle"], "")})


# --- Which frame an instant of SUMO's floating car data is: times are in the files, numbers are not -------

_COARSEST_ROUNDING_MS = 10  # SUMO writes two digits by default
_ROUNDING_WITHIN = 0.4  # of a step, so that neighbouring instants stay apart
_FEWEST_STEPS = 4  # fewer may show a rhythm by chance


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
    apart = np.diff(distinct) if len(distinct) > 1 else np.array([distinct[0], 1000])
    common = int(np.gcd.reduce(apart))
    if len(distinct) == 1 or common == apart.min():
        return time_ms // common, common / 1000, []
    digit = int(np.gcd.reduce(distinct))
    usual = np.sort(apart)[len(apart) // 2]
    step = apart[np.abs(apart - usual) <= digit].mean()
    count = np.concatenate([[0], np.cumsum(np.rint(apart / step).astype(np.int64))])
    may_be_rounded = digit <= min(_COARSEST_ROUNDING_MS, _ROUNDING_WITHIN * step) and len(apart) >= _FEWEST_STEPS
    if may_be_rounded and (np.diff(count) >= 1).all():
        step = (distinct[-1] - distinct[0]) / count[-1]
        if (np.abs(distinct - distinct[0] - step * count) <= digit).all():
            frame = count + int(np.rint(distinct[0] / step))
            note = f"times are rounded to {digit / 1000:g} s: a time step of {step / 1000:.4g} s"
            return frame[of_row], float(step / 1000), [note]
    least, usual, most = (value / 1000 for value in (apart.min(), np.median(apart), apart.max()))
    apart_s = f"{least:g} to {most:g} s apart, {usual:g} s in the median"
    return time_ms // common, common / 1000, [f"times are {apart_s}: frames count steps of {common / 1000:g} s"]
