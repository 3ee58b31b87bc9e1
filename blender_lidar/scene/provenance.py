"""What a result depends on: settings, the content of the input files, versions."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from .. import __version__
from ..errors import InputError, shown
from ..files import open_file, reading, source_digest
from ..plugins import is_plugin, plugin_file, short_name
from .scenario import Scenario, numbered_tables
from .settings import DECLARED

_CONTENT = "file with SHA-256 "  # how the content of a file stands for it
_PLUGINS = [
    (table, key) for table, settings in DECLARED.items() for key, declared in settings.items() if declared.plugins
]
CODE = "blender_lidar"  # of an identity: version, and a digest of the source


def run_identity(
    scenario: Scenario, caster: str, scenery_digest: str | None = None, bodies: Mapping[str, str] | None = None
) -> dict[str, object]:
    """What must be the same for two runs to have the same result: code, settings and the content of the input files.

    Of scenery it is the `Scenery.digest` that counts, None where there is none, and of vehicles' own bodies that of
    each, by its kind.
    """
    tables = scenario.as_tables()
    del tables["model"]["workers"], tables["model"]["cluster"]  # which change nothing
    tables["model"]["caster"] = caster
    del tables["drawing"]
    tables = numbered_tables(tables)
    for (table, key), path in _input_files(scenario).items():
        digest = _CONTENT + file_digest(path)
        if key == "sensor":  # its settings stand under its path
            if path in tables["sensor"]:
                tables["sensor"][digest] = tables["sensor"].pop(path)
            tables["sensor"]["name"] = digest if tables["sensor"]["name"] == path else tables["sensor"]["name"]
        tables[table][key] = digest
    for table, key in _PLUGINS:
        name = tables[table][key]
        if is_plugin(name):
            tables[table][key] = f"{short_name(name)}, {_CONTENT}{file_digest(plugin_file(name))}"
    if bodies:
        tables["world"]["vehicles"] = {kind: f"triangles with SHA-256 {digest}" for kind, digest in bodies.items()}
    if scenery_digest is not None:
        files = [key for table, key in scenario.files if table == "world" and key in tables[table]]
        tables["world"] |= dict.fromkeys(files, "file that is read")  # it may draw on further files
        tables["world"]["scenery"] = f"triangles with SHA-256 {scenery_digest}"
    flat = {f"[{table}] {key}": value for table, content in tables.items() for key, value in content.items()}
    return json.loads(json.dumps({CODE: f"{__version__} ({source_digest()})", **flat}))


def check_identity(stored: object, identity: Mapping[str, object], what: str, option: str = "--resume") -> None:
    """Refuse to go on with what other code, settings or files have made.

    Parameters
    ----------
    stored : object
        The identity that was stored, as JSON holds it.
    identity : mapping
        The one of now: that of `run_identity`, and perhaps more.
    what : str
        What was stored, and where: ``"runs/a: the run there"``.
    option : str
        By which it is gone on with.

    Raises
    ------
    InputError
        Naming the first thing that differs.
    """
    if not isinstance(stored, dict):
        raise InputError(f"{option}: {what} does not say with which settings it was made")
    for key in sorted({*stored, *identity}):
        before, now = stored.get(key), identity.get(key)
        if before != now:
            had = "was made by other code, blender_lidar" if key == CODE else f"had {key} ="
            instead = "go on with that one, or give" if key == CODE else "give it the same settings, or"
            raise InputError(f"{option}: {what} {had} {shown(before)}, not {shown(now)}; {instead} another --out")


def check_same_inputs(scenario: Scenario, identity: Mapping[str, object]) -> None:
    """Refuse files that are no longer those of a run, whose `run_identity` is given.

    Raises
    ------
    InputError
        Naming the file.
    """
    for (table, key), path in _input_files(scenario).items():
        if identity.get(f"[{table}] {key}") != _CONTENT + file_digest(path):
            raise InputError(f"{path}: is not as it was when the run read it")


@contextmanager
def unchanged_inputs(scenario: Scenario) -> Iterator[None]:
    """Refuse a file that a scene names and that changes while the block reads it: its digest would be another's.

    Raises
    ------
    InputError
        Naming the file.
    """
    before = {path: _stamp(path) for path in _input_files(scenario).values()}
    yield
    for path, stamp in before.items():
        if _stamp(path) != stamp:
            raise InputError(f"{path}: was changed while it was read; start again when it is complete")


def _input_files(scenario: Scenario) -> dict[tuple[str, str], str]:
    """The files that a scene's results depend on, except for scenery, by table and key."""
    return {place: path for place, path in scenario.files.items() if place[0] not in ("world", "drawing")}


def _stamp(path: str) -> tuple[int, int] | None:
    """Size and time of change of a file, by which it is the same as before; None where there is none."""
    with suppress(OSError):
        status = Path(path).stat()
        return status.st_size, status.st_mtime_ns
    return None


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file's content."""
    with reading(path, "a file"), open_file(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def versions(caster: str) -> dict[str, str]:
    """Versions of what a result depends on."""
    libraries = ("numpy", *{"raster": ("numba",), "embree": ("embreex",)}.get(caster, ()))
    found = {"blender_lidar": __version__, "python": platform.python_version()}
    for library in libraries:
        with suppress(PackageNotFoundError):
            found[library] = version(library)
    bpy = sys.modules.get("bpy")  # casts, or has read scenery; within a real Blender it is no installed package
    if bpy is not None:
        found["bpy"] = bpy.app.version_string
    return found
