"""Opening a file of vehicles, plain or gzip, and refusing early what cannot be one."""

from __future__ import annotations

import gzip
import io
import os
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError, MissingFileError
from ..input_file import MOST_TIMES_UNPACKED, most_records, most_unpacked, open_file

MAX_ROWS = 20_000_000
"""The whole NGSIM portal file has 12 million."""
MAX_BYTES = 4 * 2**30
"""Room for `MAX_ROWS` rows of 200 bytes: a gzip file that unpacks to more is refused."""
MAX_COLUMNS = 1_000
"""SUMO's tool xml2csv.py makes a hundred."""
_LONGEST_LINE = 2**16
_HEAD_BYTES = 2**17


class _GuardedStream(io.RawIOBase):
    """The unpacked bytes of a file: turns damage into an `InputError` and stops a decompression bomb."""

    def __init__(self, file: BinaryIO, path: Path) -> None:
        packed = file.peek(2)[:2] == b"\x1f\x8b"
        self._packed = os.fstat(file.fileno()).st_size if packed else None
        self._file = file
        self._stream = gzip.GzipFile(fileobj=file) if packed else file
        self._path = path
        self._total = self._records = 0
        self._line = 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:
        try:
            data = self._stream.read(len(buffer))
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(f"{self._path}: truncated or damaged gzip file ({error})") from error
        except OSError as error:
            raise InputError(f"{self._path}: cannot be read ({error.strerror or error})") from error
        self._refuse_excess(data)
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._file.close()
        super().close()

    def _refuse_excess(self, data: bytes) -> None:
        self._total += len(data)
        if self._total > MAX_BYTES:
            raise InputError(f"{self._path}: more than {MAX_BYTES / 2**30:.0f} GiB of text; a recording has less")
        if self._packed is not None:
            self._refuse_bomb(data, self._packed)
        last = data.rfind(b"\n")
        self._line = self._line + len(data) if last < 0 else len(data) - last - 1
        if self._line > _LONGEST_LINE:
            raise InputError(f"{self._path}: a line longer than {_LONGEST_LINE:,} characters; not a file of vehicles")

    def _refuse_bomb(self, data: bytes, packed: int) -> None:
        self._records += data.count(b"\n") + data.count(b"<")
        if self._total > most_unpacked(packed):
            what = f"unpacks to more than {MOST_TIMES_UNPACKED} times its size"
        elif self._records > most_records(packed):
            what = f"{packed:,} bytes that unpack to more than {most_records(packed):,} lines"
        else:
            return
        raise InputError(f"{self._path}: {what}; if it is a recording all the same, unpack it first")


def open_bytes(path: str | Path) -> io.BufferedReader:
    """Open a file for reading, unpacked if its content (not its name) is gzip.

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        If it is a folder, a pipe or a device, or may not be read; later, from reading, if it is damaged or absurdly
        large.
    """
    path = Path(path)
    return io.BufferedReader(_GuardedStream(_opened(path), path), buffer_size=2**20)


def first_bytes(path: str | Path, count: int) -> bytes:
    """The first bytes of a file as they lie there, packed or not.

    Raises
    ------
    MissingFileError, InputError
        If it cannot be opened or read.
    """
    path = Path(path)
    try:
        with _opened(path) as stream:
            return stream.read(count)
    except OSError as error:
        if isinstance(error, MissingFileError):
            raise
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def _opened(path: Path) -> BinaryIO:
    try:
        return open_file(path)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: a folder; a file of vehicles is needed") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def table_lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """The first lines of a table and their numbers from 1, without blank lines and comments that start with ``#``.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if the file is empty or not text.
    """
    for number, line in enumerate(_head(path).split("\n"), start=1):
        if line.strip() and not line.startswith("#"):
            yield number, line.rstrip("\r")


def _head(path: str | Path) -> str:
    with open_bytes(path) as stream:
        head = stream.read(_HEAD_BYTES)
    if not head.strip():
        raise InputError(f"{path}: empty; a file of vehicles is needed")
    if head.startswith(b"PK\x03\x04"):
        raise InputError(f"{path}: a zip archive; unpack it and give the .txt or .csv file inside")
    if len(head) == _HEAD_BYTES:
        head = head[: head.rfind(b"\n") + 1]
    try:
        text = head.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file (UTF-8)") from error
    if "\0" in text:
        raise InputError(f"{path}: not a text file (it holds zero bytes)")
    return text
