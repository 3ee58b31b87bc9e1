"""The folder of a study of several stages: each is stored whole when it ends, so that a study that stopped goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ..errors import InputError, shown
from ..formats.atomic import check_folder, make_folder, write_text
from ..formats.lock import folder_lock
from ..input_file import read_text

IDENTITY = "study.json"
STAGES = "stages"
_DIGEST, _VALUE = "sha256", "value"  # of a stored stage


class StudyFolder:
    """A folder in which a study leaves its stages and its results; it is made when `locked`.

    Parameters
    ----------
    path : path
        Where it is, or will be.
    identity : mapping
        What must be the same for two runs to come to the same: settings, content of files, versions. As JSON holds it.
    results : iterable of str
        Names of the files that the study will write, besides its stages.
    """

    def __init__(self, path: str | Path, identity: Mapping[str, object], results: Iterable[str] = ()) -> None:
        self.path = Path(path)
        self._identity = json.loads(json.dumps(identity))
        self._results = tuple(results)

    def file(self, name: str) -> Path:
        """Path of a file of the study."""
        return self.path / name

    def check(self, *, resume: bool = False) -> None:
        """Refuse a place that this study must not write to.

        Raises
        ------
        OutputError
            When there can be no folder.
        InputError
            When it holds a study and `resume` is False, one with other settings, or files of the same names that no
            study has written.
        """
        check_folder(self.path, "--out")
        if self.file(IDENTITY).exists():
            self._check_identity(resume)
            return
        present = [name for name in self._results if self.file(name).exists()]
        stages = self.file(STAGES)
        if stages.is_file() or any(stages.glob("*")):  # an empty folder is what `locked` makes
            present.insert(0, STAGES)
        if present:
            raise InputError(f"--out: {self.path}: holds {present[0]}, which no study has written; give another folder")

    @contextmanager
    def locked(self, *, resume: bool = False) -> Iterator[StudyFolder]:
        """Make the folder and keep other processes out of it while the block lasts.

        Raises
        ------
        OutputError
            When another run is at work there, or the folder cannot be made or written.
        InputError
            As `check`.
        """
        self.check(resume=resume)
        make_folder(self.file(STAGES), "--out")
        with folder_lock(self.path):
            self.check(resume=resume)  # again: another run may have come between the first check and the lock
            if not self.file(IDENTITY).exists():
                write_text(self.file(IDENTITY), json.dumps(self._identity, indent=2) + "\n")
            self._sweep()
            yield self

    def holds(self, name: str) -> bool:
        """Whether an earlier run has stored that stage."""
        return self._stored(name).exists()

    def stage(self, name: str, compute: Callable[[], object]) -> object:
        """What `compute` returns, from the folder if an earlier run has stored it there.

        It goes through JSON either way, so that both are the same to the last digit; its digest is stored with it.

        Raises
        ------
        InputError
            When the stored file is not as a run has left it.
        """
        path = self._stored(name)
        if not path.exists():
            text = json.dumps(compute())
            write_text(path, f'{{"{_DIGEST}": "{_digest(text)}", "{_VALUE}": {text}}}\n')
        try:
            stored = json.loads(read_text(path))
            if not isinstance(stored, dict) or set(stored) != {_DIGEST, _VALUE}:
                raise ValueError("it holds no stage")
            if stored[_DIGEST] != _digest(json.dumps(stored[_VALUE])):
                raise ValueError("its content has changed")
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: is damaged: {error}; remove it to have it made again") from error
        return stored[_VALUE]

    def _stored(self, name: str) -> Path:
        return self.file(STAGES) / f"{name}.json"

    def _check_identity(self, resume: bool) -> None:
        path = self.file(IDENTITY)
        try:
            stored = json.loads(read_text(path))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"{path}: cannot be read: {error}") from error
        if not isinstance(stored, dict):
            raise InputError(f"{path}: is no file of a study")
        if not resume:
            raise InputError(
                f"--out: {self.path}: holds a study already; give another folder, or go on with it: --resume"
            )
        for key in sorted({*stored, *self._identity}):
            if stored.get(key) != self._identity.get(key):
                raise InputError(
                    f"--resume: {self.path}: the study there had {key} = {shown(stored.get(key))}, not "
                    f"{shown(self._identity.get(key))}; give it the same settings, or another --out"
                )

    def _sweep(self) -> None:
        """Remove what a killed run had not finished writing, also in folders among the results."""
        folders = [self.file(name) for name in self._results if self.file(name).is_dir()]
        for folder in (self.path, self.file(STAGES), *folders):
            for pattern in (".*-????????.*", ".*.png.*.part"):
                for leftover in folder.glob(pattern):
                    leftover.unlink(missing_ok=True)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
