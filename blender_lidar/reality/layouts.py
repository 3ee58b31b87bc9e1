"""Which layout a folder of labelled sweeps has."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from ..errors import InputError, MissingFileError
from . import kitti_layout, sustech_layout
from .labelled import LabelledClouds

LAYOUTS = {"KITTI": kitti_layout, "SUSTechPOINTS": sustech_layout}


def open_labelled(folder: str | Path, option: str = "--kitti") -> LabelledClouds:
    """The labelled sweeps of a folder; nothing is read yet but names.

    Raises
    ------
    MissingFileError, InputError
        If the folder is not there, has neither layout, or no sweep with all its files; `option` is named.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MissingFileError(f"{option}: {folder}: there is no such folder")
    for name, layout in LAYOUTS.items():
        if all((folder / part).is_dir() for part in layout.FOLDERS):
            stems = [_stems(folder / part, suffix) for part, suffix in layout.FOLDERS.items()]
            whole = set.intersection(*stems)
            if not whole:
                parts = " and ".join(f"{part}/NAME{suffix}" for part, suffix in layout.FOLDERS.items())
                raise InputError(f"{option}: {folder}: no sweep with all its files; allowed: {parts}")
            unpaired = len(set.union(*stems)) - len(whole)
            return LabelledClouds(folder, name, tuple(sorted(whole)), unpaired, partial(layout.read_sweep, folder))
    wanted = "; or ".join(
        f"{name}: {', '.join(f'{part}/' for part in layout.FOLDERS)}" for name, layout in LAYOUTS.items()
    )
    raise InputError(f"{option}: {folder}: has the layout of no known data set; allowed: {wanted}")


def _stems(folder: Path, suffix: str) -> set[str]:
    return {path.name.removesuffix(suffix) for path in folder.iterdir() if path.name.endswith(suffix)}
