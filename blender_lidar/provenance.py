"""What a result depends on: settings, the content of the input files, versions."""

from __future__ import annotations

import hashlib
import json
import platform
import sys
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from . import __version__
from .errors import InputError, MissingFileError
from .settings import Scenario


def run_identity(scenario: Scenario, caster: str) -> dict[str, object]:
    """What must be the same for two runs to have the same result: settings and the content of the input files."""
    tables = scenario.as_tables()
    tables["model"] = {"caster": caster}  # the number of workers changes nothing
    tables["traffic"]["path"] = f"file with SHA-256 {file_digest(scenario.traffic.path)}"
    if scenario.traffic.vehicle_types is not None:
        tables["traffic"]["vehicle_types"] = f"file with SHA-256 {file_digest(scenario.traffic.vehicle_types)}"
    if scenario.sensor.is_file:
        tables["sensor"]["name"] = f"file with SHA-256 {file_digest(scenario.sensor.name)}"
    for key, path in (("blend", scenario.world.blend), ("mesh", scenario.world.mesh)):
        if path is not None:
            tables["world"][key] = f"file with SHA-256 {file_digest(path)}"
    flat = {f"[{table}] {key}": value for table, content in tables.items() for key, value in content.items()}
    return json.loads(json.dumps({"blender_lidar": __version__, **flat}))


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file's content."""
    try:
        with Path(path).open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from error


def versions(caster: str) -> dict[str, str]:
    """Versions of what a result depends on."""
    libraries = ("numpy", "pandas", *{"embree": ("embreex",), "bvh": ("bpy",)}.get(caster, ()))
    found = {"blender_lidar": __version__, "python": platform.python_version()}
    for library in libraries:
        with suppress(PackageNotFoundError):
            found[library] = version(library)
    if caster == "bvh" and "bpy" not in found:  # within a real Blender
        found["bpy"] = sys.modules["bpy"].app.version_string
    return found
