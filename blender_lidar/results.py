"""A run's folder: what is stored while a search goes on, and what is left when it has ended.

Every file is written whole or not at all, so that a run killed at any moment can be resumed from what is there.
"""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from . import __version__
from .errors import InputError, MissingFileError, OutputError
from .formats.atomic import write_text
from .formats.tables import to_csv, write_columns
from .scenario import Scenario
from .study.score_map import ScoreMap
from .study.vehicle_table import COLUMNS
from .toml_table import to_toml

SCHEMA = 1
RESULT, CHECKPOINT, SCENE, HISTORY = "result.json", "checkpoint.json", "scene.toml", "history.csv"
VEHICLES, VEHICLES_BASELINE, SCORE_MAP = "vehicles.csv", "vehicles_baseline.csv", "score_map.csv"

_DECIMALS = {
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "distance_m"), 3),
    "heading_deg": 3,
    **dict.fromkeys(("p_top", "p_side", "p_front", "entropy_bits"), 6),
}


class RunFolder:
    """The folder of one run.

    Parameters
    ----------
    path : path
        Where it is; made if it is not there.

    Raises
    ------
    OutputError
        When it cannot be made or written.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"--out: {self.path}: the folder cannot be made: {error.strerror}") from error
        if not self.path.is_dir():
            raise OutputError(f"--out: {self.path}: is not a folder")

    @contextmanager
    def locked(self) -> Iterator[RunFolder]:
        """Keep other runs out of the folder while the block lasts; a killed run lets go by itself.

        Raises
        ------
        OutputError
            When another run is at work there, or the folder cannot be written.
        """
        try:
            stream = (self.path / ".lock").open("w")
        except OSError as error:
            raise OutputError(f"--out: {self.path}: cannot be written: {error.strerror}") from error
        with stream:
            _lock(stream, self.path)
            yield self
            (self.path / ".lock").unlink(missing_ok=True)

    def file(self, name: str) -> Path:
        """Path of a file of the run."""
        return self.path / name

    def holds_run(self) -> bool:
        """Whether a run was begun or ended here."""
        return self.file(RESULT).exists() or self.file(CHECKPOINT).exists()

    def write_scene(self, scenario: Scenario) -> None:
        """Write the scene as used, every default spelt out."""
        tables = scenario.as_tables()
        tables["traffic"]["path"] = str(Path(tables["traffic"]["path"]).resolve())
        if Path(tables["sensor"]["name"]).is_file():
            tables["sensor"]["name"] = str(Path(tables["sensor"]["name"]).resolve())
        write_text(self.file(SCENE), f"# The scene as blender_lidar {__version__} used it.\n" + to_toml(tables))

    def write_checkpoint(self, identity: Mapping, state: Mapping) -> None:
        """Store how far a search has come."""
        write_text(self.file(CHECKPOINT), json.dumps({"identity": identity, "search": state}))

    def read_checkpoint(self, identity: Mapping) -> dict | None:
        """The stored state of a search, None where none is stored.

        Raises
        ------
        InputError
            When the file is damaged, or the run had other settings.
        """
        content = self._read_json(CHECKPOINT)
        if content is None:
            return None
        if not isinstance(content, dict) or "search" not in content:
            raise InputError(f"{self.file(CHECKPOINT)}: is not the checkpoint of a run")
        self._check_identity(content.get("identity"), identity)
        return content["search"]

    def read_result(self, identity: Mapping) -> dict | None:
        """The result of a run that has ended, None where none has; settings are checked as for a checkpoint."""
        content = self._read_json(RESULT)
        if content is None:
            return None
        self._check_identity(content.get("identity") if isinstance(content, dict) else None, identity)
        return content

    def finish(self, result: Mapping) -> None:
        """Write the result, which ends the run, and drop the checkpoint."""
        write_text(self.file(RESULT), json.dumps(result, indent=2) + "\n")
        self.file(CHECKPOINT).unlink(missing_ok=True)

    def write_history(self, history: np.ndarray, variables: tuple[str, ...]) -> None:
        """Write every evaluation: number, iteration, particle, variables, objective, best so far."""
        rows = ([*map(int, row[:3]), *map(repr, row[3:])] for row in history.tolist())
        header = ["evaluation", "iteration", "particle", *variables, "objective", "best"]
        write_text(self.file(HISTORY), to_csv(header, rows))

    def write_vehicles(self, name: str, table: Mapping[str, np.ndarray]) -> None:
        """Write a vehicle table; `name` is `VEHICLES` or `VEHICLES_BASELINE`."""
        write_columns(self.file(name), {column: table[column] for column in COLUMNS}, _DECIMALS)

    def write_score_map(self, score_map: ScoreMap) -> None:
        """Write the objective over height and tilt, one row for each grid point."""
        height, tilt = np.meshgrid(score_map.height_m, score_map.tilt_deg, indexing="ij")
        columns = {
            "height_m": height.ravel(),
            "tilt_x_deg": tilt.ravel(),
            "objective_per_vehicle": score_map.per_vehicle.ravel(),
            "detectable_share": score_map.detectable_share.ravel(),
        }
        blocks = score_map.block_objective.reshape(height.size, -1).T
        columns |= {f"objective_block_{number}": values for number, values in enumerate(blocks)}
        columns |= {
            f"vehicles_block_{number}": np.full(height.size, int(vehicles))
            for number, vehicles in enumerate(score_map.block_vehicles)
        }
        write_columns(self.file(SCORE_MAP), columns, {"height_m": 4, "tilt_x_deg": 4})

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the run."""
        write_text(self.file(name), text)

    def _read_json(self, name):
        path = self.file(name)
        if not path.exists():
            return None
        try:
            return json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error

    def _check_identity(self, stored, identity):
        if not isinstance(stored, dict):
            raise InputError(f"{self.path}: the run there does not say with which settings it was made")
        for key in sorted({*stored, *identity}):
            if stored.get(key) != identity.get(key):
                raise InputError(
                    f"--resume: {self.path}: the run there had {key} = {stored.get(key)!r}, not {identity.get(key)!r}; "
                    "give it the same settings, or another --out"
                )


def run_identity(scenario: Scenario, caster: str) -> dict[str, object]:
    """What must be the same for two runs to have the same result: settings and the content of the input files."""
    tables = scenario.as_tables()
    tables["model"] = {"caster": caster}  # the number of workers changes nothing
    tables["traffic"]["path"] = file_digest(scenario.traffic.path)
    if Path(scenario.sensor.name).is_file():
        tables["sensor"]["name"] = file_digest(scenario.sensor.name)
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
    return found


def _lock(stream, path):
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        return
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise OutputError(f"--out: {path}: another run is at work there") from error
