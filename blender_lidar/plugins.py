"""Plug-ins: metrics and searches of one's own, named ``FILE.py:NAME``.

Such a name means the same in every process, so that workers find the plug-in too. What its code raises is reported in
one line, with the line of the file.
"""

from __future__ import annotations

import re
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from inspect import getsourcefile
from pathlib import Path
from types import ModuleType
from typing import Any

from .errors import InputError
from .files import read_file, reading

IN_A_FILE = "FILE.py:NAME"
_IN_A_FILE = re.compile(r"(?P<path>.+\.py):(?P<name>[^\W\d]\w*)")


def is_plugin(name: object) -> bool:
    """Whether a name is that of a plug-in, which may still fail to load."""
    return isinstance(name, str) and _IN_A_FILE.fullmatch(name) is not None


def located(name: str, folder: Path = Path()) -> str:
    """The name of a plug-in as it holds in any working folder: a file's path, absolute, that started from `folder`."""
    found = _IN_A_FILE.fullmatch(name)
    return f"{(folder / found['path']).resolve()}:{found['name']}" if found else name


def short_name(name: str) -> str:
    """The name of a plug-in without the folder of its file."""
    found = _IN_A_FILE.fullmatch(name)
    return f"{Path(found['path']).name}:{found['name']}" if found else name


def name_in_file(code: Callable) -> str:
    """The name under which every process finds a function or class.

    Raises
    ------
    InputError
        When it is defined in no file, as in a cell of a notebook.
    """
    try:
        path = Path(getsourcefile(code) or "")
    except TypeError:  # a class of a notebook, or no function
        path = Path()
    name = getattr(code, "__qualname__", "")
    if not (path.suffix == ".py" and path.is_file() and name.isidentifier()):
        raise InputError(
            f"{name or code!r}: is defined in no file, from which worker processes could load it; allowed: a function "
            "or class at the top level of a .py file (in a notebook: %%writefile own.py)"
        )
    return f"{path.resolve()}:{name}"


def plugin_file(name: str) -> Path:
    """The file that holds the code of a plug-in."""
    return Path(_IN_A_FILE.fullmatch(name)["path"])


def load_plugin(name: str, where: str = "") -> Any:
    """What a plug-in's name stands for; `where` says where the name came from.

    A file is run in each process, and again when it has changed, with another ``__name__`` than ``"__main__"``.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file or name in it, or its code fails, with the line.
    """
    prefix, found = f"{where}: " if where else "", _IN_A_FILE.fullmatch(name)
    path = found["path"]
    with reading(path, "a Python file"):
        source = read_file(path)
    with faults_in_one_line(f"{prefix}{path}", path):
        module = _module(path, source)
    if not hasattr(module, found["name"]):
        raise InputError(f"{prefix}{path}: defines no {found['name']!r}")
    return getattr(module, found["name"])


@contextmanager
def faults_in_one_line(what: str, path: str | None = None) -> Iterator[None]:
    """Tell what the code of others raises in one line: `what` failed, the line of its file, and the error.

    Raises
    ------
    InputError
        In place of any exception of the block but Ctrl-C.
    """
    try:
        yield
    except (Exception, SystemExit) as error:
        if isinstance(error, SyntaxError) and error.filename == path:
            lines = [error.lineno]
        else:
            lines = [at.lineno for at in traceback.extract_tb(error.__traceback__) if at.filename == path]
        line = f", line {lines[-1]}" if lines else ""
        said = error.msg if isinstance(error, SyntaxError) else error
        raise InputError(f"{what}{line}: {type(error).__name__}: {said}") from error


def call_plugin(what: str, code: Callable, *given: object, **settings: object) -> Any:
    """Call a plug-in's function: what it returns; what it raises is reported in one line."""
    with faults_in_one_line(what, getattr(sys.modules.get(code.__module__), "__file__", None)):
        return code(*given, **settings)


@cache
def _module(path: str, source: bytes) -> ModuleType:
    """A file's content, run; like a script it can import what lies beside it."""
    folder, module = str(Path(path).parent), ModuleType(f"blender_lidar_plugin_{Path(path).stem}")
    module.__file__ = path
    sys.modules[module.__name__] = module  # which dataclasses look up
    sys.path.insert(0, folder)
    try:
        exec(compile(source, path, "exec"), vars(module))
    finally:
        sys.path.remove(folder)
    return module
