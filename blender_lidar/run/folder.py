"""A run's folder: what is stored while a search goes on, and what is left when it has ended.

Every file is written whole or not at all, so that a run killed at any moment can be resumed from what is there.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from pathlib import Path

import numpy as np

from .. import __version__
from ..errors import InputError, MissingFileError
from ..files import (
    check_folder,
    folder_lock,
    make_folder,
    open_file,
    read_text,
    sweep,
    to_csv,
    write_columns,
    write_text,
)
from ..scene.provenance import check_identity
from ..scene.settings import Scenario
from ..toml_table import to_toml
from .verdict import COLUMNS, METRIC_VALUE, ScoreMap

SCHEMA = 1
RESULT, CHECKPOINT, SCENE = "result.json", "checkpoint.json", "scene.toml"
HISTORY, HISTORY_NOMINAL = "history.csv", "history_sharp.csv"
VEHICLES, VEHICLES_BASELINE, SCORE_MAP = "vehicles.csv", "vehicles_baseline.csv", "score_map.csv"
INSTALLATION, REPORT = "installation.txt", "report.html"
_FILES = (RESULT, CHECKPOINT, SCENE, HISTORY, HISTORY_NOMINAL)
_FILES += (VEHICLES, VEHICLES_BASELINE, SCORE_MAP, INSTALLATION, REPORT)
_SCENE_MARK = "# The scene as blender_lidar "  # how a scene file begins that a run has written

_TEXTS, _WHOLE = ("class", "split"), ("frame", "vehicle_id", "points", "lane")  # columns of a vehicle table
_LARGEST_WHOLE = 2**53  # which a float holds exactly
_BLOCK_OBJECTIVE, _BLOCK_VEHICLES = "objective_block_", "vehicles_block_"  # columns of the score map
_DECIMALS = {
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "distance_m"), 3),
    "heading_deg": 3,
    **dict.fromkeys(("p_top", "p_side", "p_front", "entropy_bits"), 6),
}


class RunFolder:
    """The folder of one run; it is made when `locked`.

    Parameters
    ----------
    path : path
        Where it is, or will be.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)

    def check(self, *, resume: bool = False) -> None:
        """Refuse a place that this run must not write to.

        Raises
        ------
        OutputError
            When there can be no folder.
        InputError
            When it holds a run and `resume` is False, or files of the same names that no run has written.
        """
        check_folder(self.path, "--out")
        present = [name for name in _FILES if self.file(name).exists()]
        if not present:
            return
        if not self._is_ours():
            raise InputError(
                f"--out: {self.path}: holds a file {present[0]} that no run has written; give another folder"
            )
        if not resume:
            raise InputError(
                f"--out: {self.path}: holds a run already; give another folder, or go on with it: optimise --resume"
            )

    @contextmanager
    def locked(self) -> Iterator[RunFolder]:
        """Make the folder and keep other runs out of it while the block lasts; a killed run lets go by itself.

        Where the block ends with an error before anything was written, no folder is left.

        Raises
        ------
        OutputError
            When another run is at work there, or the folder cannot be made or written.
        """
        missing = [place for place in (self.path, *self.path.parents) if not place.exists()]
        make_folder(self.path, "--out")
        try:
            with folder_lock(self.path):
                sweep(self.path)
                yield self
        except BaseException:
            for place in missing:  # the deepest first; what is not empty stays
                with suppress(OSError):
                    place.rmdir()
            raise

    def file(self, name: str) -> Path:
        """Path of a file of the run."""
        return self.path / name

    def holds_run(self) -> bool:
        """Whether a run was begun or has ended here."""
        return self.file(RESULT).exists() or self.file(CHECKPOINT).exists()

    def write_scene(self, scenario: Scenario) -> None:
        """Write the scene as used, every default spelt out."""
        tables = scenario.as_tables()
        files = [("traffic", "path"), ("traffic", "vehicle_types"), ("world", "blend"), ("world", "mesh")]
        files += [("sensor", "name")] * scenario.sensor.is_file
        for table, key in files:
            if tables[table][key] is not None:
                tables[table][key] = str(Path(tables[table][key]).resolve())
        write_text(self.file(SCENE), f"{_SCENE_MARK}{__version__} used it.\n" + to_toml(tables))

    def write_checkpoint(self, identity: Mapping, batches: Sequence[Mapping]) -> None:
        """Store what the searches have asked for and were told so far, batch by batch."""
        write_text(self.file(CHECKPOINT), json.dumps({"identity": identity, "batches": batches}))

    def read_checkpoint(self, identity: Mapping) -> list:
        """The batches that are stored; none where no search had begun.

        Raises
        ------
        InputError
            When the file is damaged, or the run had other settings.
        """
        content = self._read_json(CHECKPOINT)
        if content is None:
            return []
        if not isinstance(content.get("batches"), list):
            raise InputError(f"{self.file(CHECKPOINT)}: is not the checkpoint of a run")
        check_identity(content.get("identity"), identity, f"{self.path}: the run there")
        return content["batches"]

    def read_result(self, identity: Mapping) -> dict | None:
        """The result of a run that has ended, None where none has; settings are checked as for a checkpoint."""
        content = self._read_json(RESULT)
        if content is not None:
            check_identity(content.get("identity"), identity, f"{self.path}: the run there")
        return content

    def ended_result(self) -> dict:
        """The result of the run that has ended here, whatever its settings.

        Raises
        ------
        MissingFileError, InputError
            When no run has ended here, or the file is damaged.
        """
        content = self._read_json(RESULT)
        if content is not None:
            return content
        if self.file(CHECKPOINT).exists():
            raise MissingFileError(f"{self.path}: the run there has not ended; go on with it: optimise --resume")
        raise MissingFileError(f"{self.path}: is not the folder of a run: there is no {RESULT}")

    @property
    def scene(self) -> Path:
        """The scene as the run used it."""
        return self.file(SCENE)

    def finish(self, result: Mapping) -> None:
        """Write the result, which ends the run, and drop the checkpoint."""
        write_text(self.file(RESULT), json.dumps(result, indent=2) + "\n")
        self.file(CHECKPOINT).unlink(missing_ok=True)

    def write_history(self, name: str, history: np.ndarray, variables: tuple[str, ...]) -> None:
        """Write every evaluation: number, iteration, particle, variables, objective, best so far.

        `name` is `HISTORY`, or `HISTORY_NOMINAL` for the search of mountings as planned beside one over a tolerance.
        """
        rows = ([*map(int, row[:3]), *map(repr, row[3:])] for row in history.tolist())
        header = ["evaluation", "iteration", "particle", *variables, "objective", "best"]
        write_text(self.file(name), to_csv(header, rows))

    def write_vehicles(self, name: str, table: Mapping[str, np.ndarray]) -> None:
        """Write a vehicle table; `name` is `VEHICLES` or `VEHICLES_BASELINE`."""
        write_columns(self.file(name), {key: table[key] for key in _columns_in(table)}, _DECIMALS)

    def write_score_map(self, score_map: ScoreMap) -> None:
        """Write the objective over height and tilt, one row for each grid point."""
        height, tilt = np.meshgrid(score_map.height_m, score_map.tilt_deg, indexing="ij")
        columns = {
            "height_m": height.ravel().round(9),
            "tilt_x_deg": tilt.ravel().round(9),
            "objective_per_vehicle": score_map.per_vehicle.ravel(),
            "detectable_share": score_map.detectable_share.ravel(),
        }
        blocks = score_map.block_objective.reshape(height.size, -1).T
        columns |= {f"{_BLOCK_OBJECTIVE}{number}": values for number, values in enumerate(blocks)}
        columns |= {
            f"{_BLOCK_VEHICLES}{number}": np.full(height.size, int(vehicles))
            for number, vehicles in enumerate(score_map.block_vehicles)
        }
        write_columns(self.file(SCORE_MAP), columns)

    def read_history(self) -> np.ndarray:
        """The rows of history.csv, (evaluations, columns)."""
        with _reading(self.file(HISTORY)) as columns:
            return np.column_stack([*columns.values()])

    def read_vehicles(self, name: str) -> dict[str, np.ndarray]:
        """A vehicle table; `name` is `VEHICLES` or `VEHICLES_BASELINE`."""
        with _reading(self.file(name)) as columns:
            table = {key: columns[key] for key in _columns_in(columns)}
            for key, values in table.items():
                if key not in _TEXTS and not np.isfinite(values).all():
                    raise ValueError(f"column {key} holds what is no finite number")
                if key in _WHOLE and not ((np.abs(values) <= _LARGEST_WHOLE) & (np.rint(values) == values)).all():
                    raise ValueError(f"column {key} holds what is no whole number")
            whole = {key: table[key].astype(np.int64) for key in _WHOLE}
            return table | whole | {"detectable": table["detectable"] > 0}

    def read_score_map(self) -> ScoreMap | None:
        """The objective over height and tilt, None where the run has none."""
        if not self.file(SCORE_MAP).exists():
            return None
        with _reading(self.file(SCORE_MAP)) as columns:
            height, tilt = (np.unique(columns[key]) for key in ("height_m", "tilt_x_deg"))
            shape = (len(height), len(tilt))
            objective = [values for name, values in columns.items() if name.startswith(_BLOCK_OBJECTIVE)]
            vehicles = [values[0] for name, values in columns.items() if name.startswith(_BLOCK_VEHICLES)]
            return ScoreMap(
                height_m=height,
                tilt_deg=tilt,
                per_vehicle=columns["objective_per_vehicle"].reshape(shape),
                detectable_share=columns["detectable_share"].reshape(shape),
                block_objective=np.column_stack(objective).reshape(*shape, -1),
                block_vehicles=np.array(vehicles),
            )

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the run."""
        write_text(self.file(name), text)

    def _is_ours(self):
        """Whether a run has written its scene here, which is the first thing that a run writes."""
        try:
            with open_file(self.file(SCENE)) as stream:
                return stream.readline(len(_SCENE_MARK)) == _SCENE_MARK.encode()
        except (OSError, ValueError):
            return False

    def _read_json(self, name):
        path = self.file(name)
        if not path.exists():
            return None
        try:
            content = json.loads(read_text(path))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        if not isinstance(content, dict):
            raise InputError(f"{path}: is no file of a run")
        return content


def _columns_in(table: Mapping) -> tuple[str, ...]:
    """The columns of a vehicle table: the chosen metric has one of its own unless it is PE-VGOP."""
    return (*COLUMNS, METRIC_VALUE) if METRIC_VALUE in table else COLUMNS


@contextmanager
def _reading(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a table that a run wrote, numbers as floats; a missing or damaged one is refused by name."""
    try:
        with TextIOWrapper(open_file(path), encoding="utf-8", newline="") as stream:
            header, *rows = csv.reader(stream)
        columns = dict(zip(header, zip(*rows, strict=True), strict=True))
        yield {name: np.array(texts, dtype=str if name in _TEXTS else float) for name, texts in columns.items()}
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: there is no such file") from error
    except (OSError, ValueError, LookupError, csv.Error) as error:
        raise InputError(f"{path}: is damaged: {error}") from error
