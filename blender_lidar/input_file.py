"""Opening a file that a user names: a regular file, and what it unpacks to within reason.

A named pipe would be waited for without end and a device read without end; a packed file of a megabyte may hold a
gigabyte of zeros. Errors are plain `OSError`: each reader says in its own words what it needed.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

MOST_TIMES_UNPACKED = 250
"""Traffic packs 4 to 15 to 1, a jam in which nothing moves 140 to 1 as XML; zeros and blank lines pack 1,000 to 1."""
FREELY_UNPACKED_BYTES = 2**24
"""What any packed file may unpack to, however small it is."""
MOST_RECORDS_A_BYTE = 4
"""Lines, tags or rows for each byte of a packed file; that jam has 2.4."""
FREE_RECORDS = 2**17
"""What any packed file may hold of them."""
_NO_FILES = {
    stat.S_IFIFO: "is a named pipe",
    stat.S_IFCHR: "is a device",
    stat.S_IFBLK: "is a device",
    stat.S_IFSOCK: "is a socket",
}


def open_file(path: str | Path) -> BinaryIO:
    """Open a regular file for reading, without waiting for anything.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        With a `strerror` that says why.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except ValueError as error:
        raise OSError(errno.EINVAL, "its name holds a zero character", str(path)) from error
    try:
        kind = stat.S_IFMT(os.fstat(handle).st_mode)
        if kind == stat.S_IFDIR:
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if kind != stat.S_IFREG:
            what = _NO_FILES.get(kind, "is no file")
            raise OSError(errno.EINVAL, f"{what}; a regular file is needed", str(path))
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_file(path: str | Path, most_bytes: int | None = None) -> bytes:
    """The content of a regular file, or its first `most_bytes`.

    Raises
    ------
    OSError
        As `open_file`.
    """
    with open_file(path) as stream:
        return stream.read() if most_bytes is None else stream.read(most_bytes)


def read_text(path: str | Path) -> str:
    """The content of a regular file of UTF-8 text, with its line ends as ``\\n``.

    Raises
    ------
    OSError
        As `open_file`.
    UnicodeDecodeError
        If it is no such text.
    """
    return read_file(path).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def most_records(packed_bytes: int) -> int:
    """How many lines, tags or rows a packed file of that size may hold: each takes time and memory, however short."""
    return FREE_RECORDS + MOST_RECORDS_A_BYTE * packed_bytes


def most_unpacked(packed_bytes: int) -> int:
    """What a packed file of that size may unpack to [bytes]; more is a bomb, or nothing that a reader is for."""
    return FREELY_UNPACKED_BYTES + MOST_TIMES_UNPACKED * packed_bytes
