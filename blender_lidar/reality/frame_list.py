"""What a data set's ``frames.csv`` tells of its sweeps, and which of them had a say in our shapes and figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .car_sets import TRAINING
from .text_table import TextTable

FRAMES_FILE = "frames.csv"
CLUSTERING = ("label_kind", "drive")
TUNED, VALIDATION = "tuned", "validation"
RULE = (
    "tuned: what shapes and losses were fitted to, KITTI's train split and seven other frames with object labels; "
    "validation: all other frames, which decided between fits but entered none"
)
# Every second one by name of those that the first comparison had, written down so that no other choice of frames turns
# one that shapes were fitted to into one that judges them.
_TUNED_BESIDE = frozenset(("000001", "000006", "000192", "001985", "002613", "004016", "006542"))


@dataclass(frozen=True, slots=True, eq=False)
class FrameList:
    """What is told of sweeps.

    Attributes
    ----------
    tuned : frozenset of str or None
        Those that shapes and figures were fitted to, by `RULE`; None where no split is told.
    about : mapping of str to mapping of str to str
        Of the columns of `CLUSTERING` that are there, the text of each sweep.
    """

    tuned: frozenset[str] | None
    about: Mapping[str, Mapping[str, str]]

    def of(self, frames: np.ndarray) -> dict[str, np.ndarray]:
        """What is told of each of the frames (n,), by column; a column that leaves one of them out tells nothing."""
        names = frames.tolist()
        return {
            column: np.array([told[name] for name in names], dtype=str)
            for column, told in self.about.items()
            if all(name in told for name in names)
        }


def read_frame_list(folder: Path) -> FrameList:
    """The list of a folder of sweeps; one that tells nothing where there is none.

    Raises
    ------
    InputError
        If that file cannot be used, naming its line or column.
    """
    path = folder / FRAMES_FILE
    if not path.is_file():
        return FrameList(None, {})
    table = TextTable(path)
    table.need("frame")
    frames = table.texts("frame")
    columns = {name: dict(zip(frames, table.texts(name), strict=True)) for name in CLUSTERING if name in table.header}
    if "split" not in table.header:
        return FrameList(None, columns)
    split = zip(frames, table.texts("split"), strict=True)
    train = {frame for frame, part in split if part == TRAINING}
    return FrameList(frozenset(train | _TUNED_BESIDE.intersection(frames)), columns)
