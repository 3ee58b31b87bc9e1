"""Which Blender wrote a .blend file: older ones may crash on what a newer one has written, instead of saying so."""

from __future__ import annotations

import gzip
import re
from contextlib import suppress
from pathlib import Path

import bpy

from ...errors import InputError

_GZIP, _ZSTANDARD = b"\x1f\x8b", b"\x28\xb5\x2f\xfd"
_HEADER = re.compile(rb"BLENDER(?:[-_][vV](\d)(\d\d)|\d\d-\d\dv(\d\d)(\d\d))")  # until 4.5, and from 5.0 on
_HEADER_BYTES = 17


def check_version(path: Path) -> None:
    """Refuse a .blend file that a newer Blender has written than the one that is to read it.

    A file packed with Zstandard is let through where the library `zstandard` is not there to look into it.

    Raises
    ------
    InputError
        Naming both versions.
    """
    written = _version(_first_bytes(path))
    if written is not None and written > bpy.app.version[:2]:
        here, there = (".".join(map(str, version)) for version in (bpy.app.version[:2], written))
        raise InputError(f"{path}: was written by Blender {there}, and this is {here}; save it with an older one")


def _version(header: bytes) -> tuple[int, int] | None:
    found = _HEADER.match(header)
    if found is None:
        return None
    major, minor = (found[1], found[2]) if found[1] else (found[3], found[4])
    return int(major), int(minor)


def _first_bytes(path: Path) -> bytes:
    """The first bytes of a file, unpacked; none of a file that cannot be unpacked."""
    with suppress(OSError, EOFError):
        with path.open("rb") as stream:
            start = stream.read(_HEADER_BYTES)
        if start.startswith(_GZIP):
            with gzip.open(path) as stream:
                return stream.read(_HEADER_BYTES)
        return _unpacked(path) if start.startswith(_ZSTANDARD) else start
    return b""


def _unpacked(path: Path) -> bytes:
    try:
        import zstandard  # comes with the module bpy
    except ImportError:
        return b""
    with path.open("rb") as stream, suppress(zstandard.ZstdError):
        return zstandard.ZstdDecompressor().stream_reader(stream).read(_HEADER_BYTES)
    return b""
