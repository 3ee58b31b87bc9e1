"""Files that are written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..errors import OutputError, output_error


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
    temporary = None
    try:
        if path.exists() and not path.is_file():
            raise OSError("is there and is not a regular file")
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}-", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())  # a name must never point to a file whose content a power cut would lose
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OutputError:  # says already what and where
        raise
    except OSError as error:
        raise output_error(f"{path}: cannot be written", error) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


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
        if path.is_symlink() and not path.exists():
            raise OutputError(f"{option}: {path}: the folder cannot be made: a link there leads nowhere")
        there = next(place for place in (path, *path.absolute().parents) if place.exists())
    except OutputError:
        raise
    except OSError as error:  # a name too long, say
        raise output_error(f"{option}: {path}: the folder cannot be made", error) from error
    if not there.is_dir():
        raise OutputError(f"{option}: {path}: the folder cannot be made: {there} is a file")


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
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")


def write_bytes(path: str | Path, data: bytes) -> None:
    """Write `data` to `path`, whole or not at all."""
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
