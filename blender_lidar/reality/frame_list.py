"""Which sweeps had a say in our shapes and figures, and which can judge them: from a data set's ``frames.csv``."""

from __future__ import annotations

from pathlib import Path

from .car_sets import TRAINING
from .text_table import TextTable

FRAMES_FILE = "frames.csv"
TUNED, UNTOUCHED = "tuned", "untouched"
RULE = (
    "tuned: the frames of KITTI's train split, and every second one of the others with labels of the object benchmark, "
    "the first, third ... by name; untouched: all others, with them the whole tracking drive"
)


def tuned_frames(folder: Path) -> frozenset[str] | None:
    """Names of the sweeps of a folder that shapes and figures were tuned on, by `RULE`; None where no
    ``frames.csv`` tells split and kind of labels.

    Raises
    ------
    InputError
        If that file cannot be used, naming its line or column.
    """
    path = folder / FRAMES_FILE
    if not path.is_file():
        return None
    table = TextTable(path)
    if not {"split", "label_kind"} <= set(table.header):
        return None
    table.need("frame")
    rows = list(zip(*(table.texts(name) for name in ("frame", "split", "label_kind")), strict=True))
    train = {frame for frame, split, _ in rows if split == TRAINING}
    others = sorted(frame for frame, split, kind in rows if split != TRAINING and kind.startswith("object"))
    return frozenset(train | set(others[::2]))
