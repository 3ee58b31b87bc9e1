"""A run's folder: what is stored while a search goes on, and what is left when it has ended.

Every file is written whole or not at all, so that a run killed at any moment can be resumed from what is there.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from io import TextIOWrapper
from pathlib import Path

import numpy as np

from .. import __version__
from ..document import Document, document_from
from ..errors import BlenderLidarError, InputError, MissingFileError
from ..files import (
    check_folder,
    check_unused,
    folder_lock,
    open_file,
    read_text,
    reading,
    to_csv,
    write_columns,
    write_text,
)
from ..scene.provenance import check_identity
from ..scene.scenario import Scenario
from ..toml_table import to_toml
from ..traffic.boxes import WAY_COLUMNS
from .vehicle_table import WEIGHT, columns_for, points_columns
from .verdict import ScoreMap

RUN_SCHEMA = 2
RESULT, CHECKPOINT, SCENE = "result.json", "checkpoint.json", "scene.toml"
HISTORY, HISTORY_CANDIDATES = "history.csv", "history_candidates.csv"
VEHICLES, VEHICLES_BASELINE, SCORE_MAP = "vehicles.csv", "vehicles_baseline.csv", "score_map.csv"
RANKING = "ranking.csv"
INSTALLATION, REPORT, DETECTION = "installation.txt", "report.html", "detection.json"
_FILES = (RESULT, CHECKPOINT, SCENE, HISTORY, HISTORY_CANDIDATES)
_FILES += (VEHICLES, VEHICLES_BASELINE, SCORE_MAP, INSTALLATION, REPORT)
_SCENE_MARK = "# The scene as blender_lidar "  # how a scene file begins that a run has written

# Columns of the score map, the last where there are several recordings.
_BLOCK_OBJECTIVE, _BLOCK_VEHICLES, _BLOCK_RECORDING = "objective_block_", "vehicles_block_", "recording_block_"
_KINDS = {  # of columns; the others hold floats
    **dict.fromkeys(("class", "split", *WAY_COLUMNS), str),
    **dict.fromkeys(("frame", "vehicle_id", "points", "detectable", "lane"), np.int64),  # and points of each LiDAR
}
_DECIMALS = {
    # Boxes so exactly that `score` counts their cells as the run did: a millimetre may be a whole row of cells.
    **dict.fromkeys(("x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "heading_deg"), 6),
    "distance_m": 3,
    **dict.fromkeys(("p_top", "p_side", "p_front", "entropy_bits"), 6),
}


def of_lidar(name: str, lidar: str) -> str:
    """Name of the file that one of several LiDARs has: ``score_map_north.csv``; that of a single one without one."""
    stem, dot, suffix = name.rpartition(".")
    return f"{stem}_{lidar}{dot}{suffix}" if lidar else name


class RunFolder:
    """The folder of one run, and what the run came to once it has ended.

    It is made when `locked`. Result and tables are read when they are asked for; those of a run of this process are at
    hand, as they would be read.

    Parameters
    ----------
    path : path
        Where it is, or will be.

    Raises
    ------
    MissingFileError, InputError
        From `result`, `optimised` and `baseline`: when no run has ended there, or a file is missing or damaged.
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
            When it holds a run and `resume` is False, or files but no run.
        """
        check_folder(self.path, "--out")
        present = [name for name in _FILES if self.file(name).exists()]
        if not self._is_ours():
            check_unused(self.path, "--out", "run")
        if present and not resume:
            raise InputError(
                f"--out: {self.path}: holds a run already; give another folder, or go on with it: optimise --resume"
            )

    @contextmanager
    def begun(self, *, resume: bool = False) -> Iterator[RunFolder]:
        """The folder `locked` for a run that may write there, which is checked again: another may have come first."""
        self.check(resume=resume)
        with self.locked():
            self.check(resume=resume)
            yield self

    @contextmanager
    def locked(self) -> Iterator[RunFolder]:
        """Make the folder and keep other runs out of it while the block lasts; a killed run lets go by itself.

        Where the block ends with an error before anything was written, no folder is left.

        Raises
        ------
        OutputError
            When another run is at work there, or the folder cannot be made or written.
        """
        with folder_lock(self.path):
            yield self

    def file(self, name: str) -> Path:
        """Path of a file of the run."""
        return self.path / name

    def write_scene(self, scenario: Scenario) -> None:
        """Write the scene as used, every default spelt out."""
        text = to_toml(scenario.with_whole_paths())
        write_text(self.file(SCENE), f"{_SCENE_MARK}{__version__} used it.\n{text}")

    def write_checkpoint(self, identity: Mapping, batches: Sequence[Mapping]) -> None:
        """Store what the searches have asked for, and the values that they were given, batch by batch."""
        write_text(self.file(CHECKPOINT), json.dumps({"identity": identity, "batches": batches}))

    def read_checkpoint(self, identity: Mapping) -> list:
        """The batches that are stored; none where no search had begun.

        Raises
        ------
        InputError
            When the file is damaged, or the run had other settings.
        """
        content = self._read_json(CHECKPOINT, identity)
        with refused_by_name(self.file(CHECKPOINT)):
            return [] if content is None else list(content["batches"])

    def read_result(self, identity: Mapping | None = None) -> dict | None:
        """The result of a run that has ended, None where none has; settings are checked as for a checkpoint, if given.

        Raises
        ------
        InputError
            When the file is damaged, or the run had other settings.
        """
        return self._read_json(RESULT, identity)

    @cached_property
    def result(self) -> dict:
        """The content of result.json."""
        found = self.read_result()
        if found is None and self.file(CHECKPOINT).exists():
            raise MissingFileError(f"{self.path}: the run there has not ended; go on with it: optimise --resume")
        if found is None:
            raise MissingFileError(f"{self.path}: is not the folder of a run: there is no {RESULT}")
        if found.get("schema") != RUN_SCHEMA:
            raise InputError(f"{self.file(RESULT)}: schema is not {RUN_SCHEMA}, the one that this version writes")
        return found

    @cached_property
    def document(self) -> Document:
        """What is told of the run."""
        return document_from(self.result["document"])

    @cached_property
    def optimised(self) -> dict[str, np.ndarray]:
        """The vehicle table of the run's mounting, searched and held-out frames."""
        return self._read_vehicles(VEHICLES)

    @cached_property
    def baseline(self) -> dict[str, np.ndarray]:
        """That of the baseline: the same vehicles in the same order."""
        found = self._read_vehicles(VEHICLES_BASELINE)
        if any(not np.array_equal(found[key], self.optimised[key]) for key in ("frame", "vehicle_id", "split")):
            raise InputError(f"{self.file(VEHICLES_BASELINE)}: lists other vehicles than {VEHICLES}")
        return found

    @property
    def judged(self) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        """The vehicle tables of the baseline and of the run's mounting, on the frames that judge: see `result`.

        Those are all frames where every block of time has judged (cross-fitting).
        """
        split = "holdout" if self.result["holdout"] else "search"
        rows = (self.optimised["split"] == split) | bool(self.result.get("cross_fitted"))
        return tuple({key: column[rows] for key, column in table.items()} for table in (self.baseline, self.optimised))

    def finish(self, result: Mapping) -> dict:
        """Write the result, which ends the run, and drop the checkpoint; returns it as it would be read."""
        text = json.dumps(result, indent=2)
        write_text(self.file(RESULT), text + "\n")
        self.file(CHECKPOINT).unlink(missing_ok=True)
        self.result = json.loads(text)
        return self.result

    def write_history(self, name: str, history: np.ndarray, variables: tuple[str, ...]) -> None:
        """Write every evaluation: number, iteration, particle, variables, objective, best so far.

        `name` is `HISTORY`, of what found the answer, or `HISTORY_CANDIDATES` of the search that found its candidates:
        each frame under an installation error of its own.
        """
        numbers = ("evaluation", "iteration", "particle")
        columns = dict(zip((*numbers, *variables, "objective", "best"), history.T, strict=True))
        write_columns(self.file(name), columns | {key: columns[key].astype(int) for key in numbers})

    def write_vehicles(self, optimised: Mapping[str, np.ndarray], baseline: Mapping[str, np.ndarray]) -> None:
        """Write the vehicle tables of both mountings, rounded once for the files and for what is shown of the run."""
        self.optimised, self.baseline = _rounded(optimised), _rounded(baseline)
        write_columns(self.file(VEHICLES), self.optimised, _DECIMALS)
        write_columns(self.file(VEHICLES_BASELINE), self.baseline, _DECIMALS)

    def write_ranking(self, poles: Sequence[Mapping]) -> None:
        """Write candidate poles, the best first, one row for each."""
        rows = [
            {**row, **row["deployment"]} | {f"holdout_{k}": v for k, v in (row["holdout"] or {}).items()}
            for row in poles
        ]
        for row in rows:
            for of in ("", "detectable_share_"):
                ends = row.pop(f"holdout_{of}interval_90", None) or (None, None)
                row[f"holdout_{of}low_90"], row[f"holdout_{of}high_90"] = ends
        names = [
            key for key in dict.fromkeys(key for row in rows for key in row) if key not in ("deployment", "holdout")
        ]
        write_text(self.file(RANKING), to_csv(names, ([row.get(key) for key in names] for row in rows)))

    def write_score_map(self, score_map: ScoreMap, lidar: str = "") -> None:
        """Write the objective over height and tilt, of one LiDAR of several, one row for each grid point."""
        height, tilt = np.meshgrid(score_map.height_m, score_map.tilt_deg, indexing="ij")
        columns = {
            "height_m": height.ravel().round(9),
            score_map.tilt: tilt.ravel().round(9),
            "objective_per_vehicle": score_map.per_vehicle.ravel(),
            "detectable_share": score_map.detectable_share.ravel(),
        }
        objective, vehicles = score_map.block_objective, score_map.block_vehicles
        if (vehicles % 1.0 == 0.0).all():  # as they are unless weighted
            vehicles = vehicles.astype(int)
        blocks = range(len(vehicles))
        columns |= {f"{_BLOCK_OBJECTIVE}{block}": objective[..., block].ravel() for block in blocks}
        columns |= {f"{_BLOCK_VEHICLES}{block}": np.full(height.size, vehicles[block]) for block in blocks}
        recording = score_map.block_recording
        if recording is not None and recording.any():
            columns |= {f"{_BLOCK_RECORDING}{block}": np.full(height.size, recording[block]) for block in blocks}
        write_columns(self.file(of_lidar(SCORE_MAP, lidar)), columns)

    def read_columns(self, *, of_search: bool = False) -> dict[str, np.ndarray]:
        """The columns of history.csv by their names, (evaluations,) each; or `of_search`, where that has its own."""
        own = of_search and self.file(HISTORY_CANDIDATES).exists()
        with _columns_of(self.file(HISTORY_CANDIDATES if own else HISTORY)) as columns:
            return columns

    def _read_vehicles(self, name):
        """The vehicle table of a file."""
        with refused_by_name(self.file(RESULT)):
            metric, lidars = self.result["metric"], [one["name"] for one in self.result["lidars"]]
        with _columns_of(self.file(name)) as columns:
            names = columns_for(metric, WEIGHT in columns, WAY_COLUMNS[0] in columns, lidars)
            table = {key: columns[key] for key in names}
            for key, values in table.items():
                if _KINDS.get(key) is not str and not np.isfinite(values).all():
                    raise ValueError(f"column {key} holds what is no finite number")
            for key in points_columns(lidars) if len(lidars) > 1 else ():
                table[key] = table[key].astype(np.int64)
            return table | {"detectable": table["detectable"] > 0}

    def read_score_map(self, lidar: str = "") -> ScoreMap | None:
        """The objective over height and tilt, of one LiDAR of several; None where the run has none."""
        path = self.file(of_lidar(SCORE_MAP, lidar))
        if not path.exists():
            return None
        with _columns_of(path) as columns:
            axis = "lean_deg" if "lean_deg" in columns else "tilt_x_deg"
            height, tilt = np.unique(columns["height_m"]), np.unique(columns[axis])
            shape = (len(height), len(tilt))
            objective = [values for name, values in columns.items() if name.startswith(_BLOCK_OBJECTIVE)]
            vehicles, recording = (
                np.array([values[0] for name, values in columns.items() if name.startswith(prefix)])
                for prefix in (_BLOCK_VEHICLES, _BLOCK_RECORDING)
            )
            return ScoreMap(
                height_m=height,
                tilt_deg=tilt,
                per_vehicle=columns["objective_per_vehicle"].reshape(shape),
                detectable_share=columns["detectable_share"].reshape(shape),
                block_objective=np.column_stack(objective).reshape(*shape, -1),
                block_vehicles=vehicles,
                tilt=axis,
                block_recording=recording if len(recording) else None,
            )

    def read_text(self, name: str) -> str:
        """The content of a text file of the run."""
        with refused_by_name(self.file(name)):
            return read_text(self.file(name))

    def _is_ours(self):
        """Whether a run has written its scene here, which is the first thing that a run writes."""
        try:
            with open_file(self.file(SCENE)) as stream:
                return stream.readline(len(_SCENE_MARK)) == _SCENE_MARK.encode()
        except (OSError, ValueError):
            return False

    def _read_json(self, name, identity):
        """The content of a file, None where it is not there; that of a run with another identity is refused."""
        if not self.file(name).exists():
            return None
        with refused_by_name(self.file(name)):
            content = json.loads(self.read_text(name))
            if not isinstance(content, dict):
                raise TypeError(f"is no table but a {type(content).__name__}")
        if identity is not None:
            check_identity(content.get("identity"), identity, f"{self.path}: the run there")
        return content


@contextmanager
def refused_by_name(path: Path) -> Iterator[None]:
    """While a file of a run is read and its content used: what is missing or damaged becomes one line with its name."""
    try:
        with reading(path, "a file of a run"):
            yield
    except BlenderLidarError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError, csv.Error) as error:
        what = f"has no {error}" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
        raise InputError(f"{path}: is damaged, or not of this version: {what}") from error


def _rounded(table: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A vehicle table with the digits that its file keeps."""
    return {
        key: np.char.mod(f"%.{_DECIMALS[key]}f", values).astype(float) if key in _DECIMALS else values
        for key, values in table.items()
    }


@contextmanager
def _columns_of(path: Path) -> Iterator[dict[str, np.ndarray]]:
    """The columns of a table that a run wrote."""
    with refused_by_name(path):
        with TextIOWrapper(open_file(path), encoding="utf-8", newline="") as stream:
            header, *rows = csv.reader(stream)
        columns = dict(zip(header, zip(*rows, strict=True), strict=True))
        yield {name: np.array(texts, dtype=_KINDS.get(name, float)) for name, texts in columns.items()}
