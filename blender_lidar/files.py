"""Files: written whole or not at all, folders locked, CSV tables, and opening what a user names.

Only regular files are opened: a named pipe would be waited for without end, and a device read without end. Errors of
opening are plain `OSError`; `reading` makes them a user's.
"""

from __future__ import annotations

import csv
import errno
import gzip
import hashlib
import io
import math
import os
import secrets
import stat
import warnings
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO

from .errors import BlenderLidarError, InputError, MissingFileError, OutputError, output_error

if TYPE_CHECKING:
    import numpy as np

# --- Files that are written whole or not at all -----------------------------------------------------------

_TEMPORARY = ".blender_lidar-"  # how names of temporary files begin; process id, random characters and suffix follow


@contextmanager
def whole_file(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path`; it takes the place of `path` when the block ends well, else nothing is left.

    The temporary file keeps the suffix of `path`, for writers that choose their format by it.

    Raises
    ------
    OutputError
        When the file cannot be written, or what is there is no regular file: a folder, a device, a named pipe.
    """
    path = Path(path)
    temporary = path.parent / f"{_TEMPORARY}{os.getpid()}-{secrets.token_hex(4)}{path.suffix}"
    try:
        if path.exists() and not path.is_file():
            raise OSError("is there and is not a regular file")
        temporary.touch(exist_ok=False)
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())  # a name must never point to a file whose content a power cut would lose
        temporary.replace(path)
    except OutputError:  # says already what and where
        raise
    except OSError as error:
        raise output_error(f"{path}: cannot be written", error) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def sweep(folder: Path) -> None:
    """Remove the temporary files that killed processes of ours left in a folder, and nothing else.

    The caller holds the folder's lock: nobody else is writing there.
    """
    for leftover in folder.glob(f"{_TEMPORARY}[0-9]*-????????*"):
        leftover.unlink(missing_ok=True)


def check_place(path: str | Path, option: str) -> None:
    """Refuse early, before the work, a file whose folder is not there; `option` says what gave it.

    Raises
    ------
    OutputError
        Naming the folder.
    """
    if not Path(path).parent.is_dir():
        raise OutputError(f"{option}: {path}: cannot be written: there is no folder {Path(path).parent}")


def check_folder(path: Path, option: str) -> None:
    """Refuse early a folder that cannot be made; `option` says what gave it.

    Raises
    ------
    OutputError
        Naming the folder, and the file that stands in its way.
    """
    try:
        there = next(place for place in (path, *path.absolute().parents) if place.exists() or place.is_symlink())
    except OSError as error:  # the working folder has gone
        raise output_error(f"{option}: {path}: the folder cannot be made", error) from error
    if not there.is_dir():
        what = "is a file" if there.exists() else "is a link that leads nowhere"
        raise OutputError(f"{option}: {path}: the folder cannot be made: {there} {what}")


def check_unused(folder: Path, option: str, by: str, ours: Callable[[Path], object] = lambda path: False) -> None:
    """Refuse early a folder that holds foreign files, except for hidden ones and what is `ours`.

    `option` says what gave it, `by` who would have written what may be there: ``"run"``.

    Raises
    ------
    InputError
        Naming the first of them.
    """
    if folder.is_dir():
        for path in sorted(folder.iterdir()):
            if not (path.name.startswith(".") or ours(path)):
                what = "folder" if path.is_dir() else "file"
                text = f"holds a {what} {path.name} that no {by} has written; give another folder"
                raise InputError(f"{option}: {folder}: {text}")


def make_folder(path: Path, option: str) -> None:
    """Make a folder, and those above it, unless it is there; `option` says what gave it.

    Raises
    ------
    OutputError
        When it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(f"{option}: {path}: the folder cannot be made", error) from error


def write_text(path: str | Path, text: str) -> None:
    """Write `text` as UTF-8 to `path`, whole or not at all; half a character, as file names may hold, becomes a ?."""
    write_bytes(path, text.encode("utf-8", errors="replace"))


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


# --- A lock on a folder: one process at a time ------------------------------------------------------------


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Make a folder and keep other processes out of it while the block lasts; a process that is killed lets go.

    What killed processes left there is swept. Where the block ends with an error before anything was written, no folder
    is left.

    Raises
    ------
    OutputError
        When another process is at work there, or the folder cannot be made or written.
    """
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        with _lock_file(folder):
            sweep(folder)
            yield
    except BaseException:
        for place in missing:  # the deepest first; what is not empty stays
            with suppress(OSError):
                place.rmdir()
        raise


@contextmanager
def _lock_file(folder: Path) -> Iterator[None]:
    path = folder / ".lock"
    stream = _locked_stream(path, folder)
    try:
        yield
    finally:
        with suppress(OSError):  # while it is held: whoever has opened it by now sees that it is gone
            path.unlink()
        stream.close()
        with suppress(OSError):  # Windows removes no open file, so neither this one of ours nor one that others hold
            path.unlink()


def _locked_stream(path: Path, folder: Path) -> IO[str]:
    """The lock's file, open and locked; it is still the one of that name, which its last holder may have removed."""
    while True:
        make_folder(folder, "--out")  # a run that fails removes the folder that it has made
        try:
            stream = path.open("a")
        except OSError as error:
            raise output_error(f"--out: {folder}: cannot be written", error) from error
        try:
            _take(stream, folder)
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                    return stream
        except BaseException:
            stream.close()
            raise
        stream.close()


def _take(stream: IO[str], folder: Path) -> None:
    """Lock an open file as the system does it, by `fcntl` or, on Windows, by `msvcrt`."""
    try:
        try:
            import fcntl
        except ImportError:
            import msvcrt

            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in _HELD_BY_ANOTHER:
            raise OutputError(f"--out: {folder}: another run is at work there") from error
        # a file system without locks
        text = f"{folder}: another run there would not be noticed, as it cannot be locked: {error.strerror}"
        warnings.warn(text, stacklevel=2)


_HELD_BY_ANOTHER = {errno.EWOULDBLOCK, errno.EAGAIN, errno.EACCES, errno.EDEADLK}


# --- CSV tables: a header line, then rows; numbers with the digits that matter ----------------------------


def write_columns(
    path: str | Path, columns: Mapping[str, np.ndarray], decimals: Mapping[str, int] | None = None, *, head: str = ""
) -> None:
    """Write columns of equal length as CSV.

    Parameters
    ----------
    path : path
        The file; written whole or not at all.
    columns : mapping of str to ndarray, (n,)
        Names and values; True and False become 1 and 0.
    decimals : mapping of str to int, optional
        Digits after the point for a column of floats; others are written so that reading gives the same float.
    head : str
        Lines before the header.
    """
    decimals = decimals or {}
    import numpy as np  # here alone: whoever asks for help does not wait for it

    texts = [_texts(np.asarray(values), decimals.get(name)) for name, values in columns.items()]
    write_text(path, head + to_csv(list(columns), zip(*texts, strict=True)))


def to_csv(header: Sequence[str], rows) -> str:
    """A header and rows as the text of a CSV file."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()


def number(text: str) -> float:
    """A text of a file as a number; NaN if it is none: ``"1_0"`` and digits of other scripts are to Python alone."""
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan


def _texts(values, decimals):
    if values.dtype == bool:
        values = values.astype(int)
    if decimals is not None:
        return [f"{value:.{decimals}f}" for value in values.tolist()]
    return [repr(value) if isinstance(value, float) else str(value) for value in values.tolist()]


# --- Opening a file that a user names: a regular file -----------------------------------------------------


def open_file(path: str | Path) -> BinaryIO:
    """Open a regular file for reading, without waiting for anything.

    Raises
    ------
    FileNotFoundError, IsADirectoryError, OSError
        With a `strerror` that says why.
    """
    kind = stat.S_IFMT(Path(path).stat().st_mode)
    if kind not in (stat.S_IFREG, stat.S_IFDIR):  # a folder says so itself
        raise OSError(errno.EINVAL, "is a named pipe or a device; a regular file is needed", str(path))
    return Path(path).open("rb")


@contextmanager
def open_bytes(path: str | Path, *, unpack: bool = True) -> Iterator[BinaryIO]:
    """Open a file that a user names, unpacked if its content (not its name) is gzip.

    Raises
    ------
    MissingFileError
        If there is no such file.
    InputError
        If it is a folder, a pipe or a device, may not be read, or turns out to be damaged while it is read.
    """
    with reading(path, "a table or recording"), open_file(path) as file:
        packed = unpack and file.peek(2)[:2] == b"\x1f\x8b"
        try:
            yield gzip.GzipFile(fileobj=file) if packed else file
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise InputError(f"{path}: truncated or damaged gzip file ({error})") from error


@contextmanager
def reading(path: str | Path, what: str) -> Iterator[None]:
    """Let what keeps a file from being read be a user's error; `what` is needed: ``"a TOML file"``.

    Raises
    ------
    MissingFileError, InputError
        In place of the `OSError` of the block.
    """
    try:
        yield
    except BlenderLidarError:  # says already what and where
        raise
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: is a folder; allowed: {what}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error


def read_file(path: str | Path, most_bytes: int | None = None) -> bytes:
    """The content of a regular file, or its first `most_bytes`.

    Raises
    ------
    OSError
        As `open_file`.
    """
    with open_file(path) as stream:
        return stream.read() if most_bytes is None else stream.read(most_bytes)


def read_npz(path: str | Path) -> dict[str, np.ndarray]:
    """The arrays of an NPZ file, by their names.

    Raises
    ------
    OSError
        As `open_file`.
    ValueError
        If it is none, or damaged.
    """
    import numpy as np

    with open_file(path) as stream:
        try:
            with np.lib.npyio.NpzFile(stream) as archive:
                return {name: archive[name] for name in archive.files}
        except Exception as error:  # of a dozen kinds, by NumPy, zipfile, zlib and tokenize
            raise ValueError(str(error) or type(error).__name__) from error


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


# --- The code that runs -----------------------------------------------------------------------------------


@cache
def source_digest() -> str:
    """The beginning of the SHA-256 of this package's source and tables: the same for the same code anywhere."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*")):
        if path.suffix in (".py", ".toml"):
            digest.update(path.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return digest.hexdigest()[:12]
