"""A lock on a folder: one process at a time."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from ..errors import OutputError, output_error
from .atomic import make_folder


@contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Keep other processes out of a folder while the block lasts; a process that is killed lets go by itself.

    Raises
    ------
    OutputError
        When another process is at work there, or the folder cannot be written.
    """
    path = folder / ".lock"
    with _locked(path, folder):
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def _locked(path: Path, folder: Path) -> IO[str]:
    """The lock file, open and locked."""
    while True:
        try:
            stream = _opened(path)
        except FileNotFoundError as error:
            if folder.is_dir():
                raise output_error(f"--out: {folder}: cannot be written", error) from error
            make_folder(folder, "--out")  # a run that has failed removed it after we had found or made it
            continue
        except OSError as error:
            raise output_error(f"--out: {folder}: cannot be written", error) from error
        try:
            _take(stream, folder)
            if os.path.samestat(os.fstat(stream.fileno()), path.stat()):
                return stream
        except BlockingIOError as error:
            stream.close()
            raise OutputError(f"--out: {folder}: another run is at work there") from error
        except FileNotFoundError:
            pass
        stream.close()  # a run that has just ended removed the file between our opening and locking it


def _opened(path: Path) -> IO[str]:
    """The file, made if need be and never emptied; a named pipe in its place is not waited for."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | getattr(os, "O_NONBLOCK", 0), 0o666)
    return os.fdopen(handle, "w")


def _take(stream: IO[str], folder: Path) -> None:
    try:
        import fcntl
    except ImportError:  # a system without such locks
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:  # a file system without them
        text = f"{folder}: another run there would not be noticed, as it cannot be locked: {error.strerror}"
        warnings.warn(text, stacklevel=2)
