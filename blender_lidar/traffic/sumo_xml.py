"""SUMO's floating car data as XML, as ``sumo --fcd-output run.fcd.xml`` writes them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ..errors import InputError, printable
from .sumo_rows import NEEDED, OPTIONAL, FcdChunk
from .xml_tags import Tag, start_tags

ROOT = "fcd-export"
_ATTRIBUTES = tuple(name for name in (*NEEDED, *OPTIONAL) if name != "time")


def xml_chunks(path: str | Path) -> Iterator[FcdChunk]:
    """The vehicles of a file; persons and containers are counted.

    Raises
    ------
    MissingFileError, InputError
        If the file cannot be read, is not well-formed, or is some other XML.
    """
    time: str | None = None
    for tags in start_tags(path):
        rows: list[tuple] = []
        lines: list[int] = []
        left_out = 0
        for tag in tags:
            _, depth, name, attributes = tag
            if depth == 3 and name == "vehicle" and time is not None:
                rows.append((time, *map(attributes.get, _ATTRIBUTES)))
                lines.append(tag.line)
            elif depth == 3 and name in ("person", "container") and time is not None:
                left_out += 1
            elif depth == 2 and name != "vehicle":
                time = attributes.get("time", "") if name == "timestep" else None
            elif depth == 1 or name == "vehicle":
                _check_place(path, tag)
        if rows or left_out:
            yield _chunk(path, rows, lines, left_out)


def _check_place(path: str | Path, tag: Tag) -> None:
    if tag.depth == 1 and tag.name != ROOT:
        found = printable(tag.name, 40)
        raise InputError(
            f"{path}:{tag.line}: the root element is <{found}>; a recording of SUMO's has <{ROOT}> (--fcd-output)"
        )
    if tag.name == "vehicle":
        raise InputError(f"{path}:{tag.line}: <vehicle> outside a <timestep>; SUMO writes it inside one")


def _chunk(path: str | Path, rows: list[tuple], lines: list[int], left_out: int) -> FcdChunk:
    columns = zip(*rows, strict=True) if rows else [()] * (1 + len(_ATTRIBUTES))
    return FcdChunk(
        columns=dict(zip(("time", *_ATTRIBUTES), columns, strict=True)),
        where=lambda row: f"{path}:{lines[row]}",
        left_out=left_out,
    )
