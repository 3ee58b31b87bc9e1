"""Which sweeps had a say in our shapes and figures, and which can judge them: from a data set's ``frames.csv``."""

from __future__ import annotations

import csv
from pathlib import Path

from ..errors import InputError

FRAMES_FILE = "frames.csv"
TUNED, UNTOUCHED = "tuned", "untouched"
RULE = (
    "tuned: the frames of KITTI's train split, and every second one of the others with labels of the object benchmark, "
    "the first, third ... by name; untouched: all others, with them the whole tracking drive"
)
_COLUMNS = ("frame", "split", "label_kind")


def tuned_frames(folder: Path) -> frozenset[str] | None:
    """Names of the sweeps of a folder that shapes and figures were tuned on, by `RULE`; None without a ``frames.csv``.

    Raises
    ------
    InputError
        If that file lacks a column.
    """
    path = folder / FRAMES_FILE
    if not path.is_file():
        return None
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: cannot be read ({error})") from error
    missing = [name for name in _COLUMNS if rows and rows[0].get(name) is None]
    if missing:
        raise InputError(f"{path}: no column {missing[0]!r}; needed: {', '.join(_COLUMNS)}")
    train = {row["frame"] for row in rows if row["split"] == "train"}
    others = sorted(row["frame"] for row in rows if row["split"] != "train" and row["label_kind"].startswith("object"))
    return frozenset(train | set(others[::2]))
