"""Which cars are looked at together, and which frames are resampled together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..study.statistics import FEWEST_BLOCKS

FEWEST_CARS = 10
TRAINING = "train"
ALL = "all"


@dataclass(frozen=True, slots=True, eq=False)
class CarSet:
    """Cars that are looked at together.

    Attributes
    ----------
    name : str
    member : ndarray of bool, (n,)
    """

    name: str
    member: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class Clusters:
    """What is resampled as one.

    Attributes
    ----------
    unit : str
        For people: ``"drive"``, ``"frame"``, ``"5 frames"``.
    of_car : ndarray of int64, (n,)
        Cluster of each car, numbered from 0 without gaps.
    too_narrow : bool
        Whether clusters are known, or must be feared, to depend on each other, so that intervals come out too narrow.
    """

    unit: str
    of_car: np.ndarray
    too_narrow: bool

    @property
    def number(self) -> int:
        return int(self.of_car.max()) + 1


def car_sets(about: Mapping[str, np.ndarray], cars: int) -> list[CarSet]:
    """All cars, each split, each kind of labels (by its first word but "KITTI"), and each kind within each split.

    Of sets with the same cars only the first is kept.
    """
    sets = []
    split = about.get("split")
    if split is not None:
        # What a detector has not seen comes first, what it learned from last.
        names = sorted(set(split.tolist()), key=lambda name: (name == TRAINING, name))
        sets += [CarSet(name, split == name) for name in names]
    sets.append(CarSet(ALL, np.ones(cars, dtype=bool)))
    if "label_kind" in about:
        kind = kinds(about["label_kind"])
        sets += [CarSet(name, kind == name) for name in sorted(set(kind.tolist()))]
        if split is not None:
            sets += [
                CarSet(f"{of} {name}", (split == of) & (kind == name))
                for of in sorted(set(split.tolist()))
                for name in sorted(set(kind.tolist()))
            ]
    kept: list[CarSet] = []
    for one in sets:
        if one.member.any() and not any(np.array_equal(one.member, other.member) for other in kept):
            kept.append(one)
    return kept


def main_set(sets: list[CarSet]) -> CarSet:
    """The one that judges: the first that no detector learned from, or all cars where nothing is told."""
    return next((one for one in sets if one.name != TRAINING), sets[0])


def kinds(label_kind: np.ndarray) -> np.ndarray:
    """The word that tells kinds of labels apart: ``object label_2 (...)`` is ``object``."""
    words = [text.split() for text in label_kind.tolist()]
    return np.array([next((word for word in line if word != "KITTI"), "") for line in words], dtype=str)


def clusters(frame: np.ndarray, about: Mapping[str, np.ndarray], block_frames: int) -> Clusters:
    """What is resampled as one in a set of cars: a drive where it is told and there are enough, else a frame.

    Parameters
    ----------
    frame : ndarray of str, (n,)
    about : mapping of str to ndarray of str, (n,)
        Perhaps with ``drive`` and ``label_kind``.
    block_frames : int
        So many frames of one drive, or of one kind of labels, in the order of their names, count as one where drives
        are not resampled.
    """
    drive, kind = about.get("drive"), about.get("label_kind")
    if drive is not None and len(np.unique(drive)) >= FEWEST_BLOCKS:
        return Clusters("drive", _numbered(drive), False)
    within = drive if drive is not None else kinds(kind) if kind is not None else np.zeros(len(frame), dtype="<U1")
    # Frames of one drive, or of sequences, show the same cars again.
    dependent = drive is not None or (kind is not None and bool((within == "tracking").any()))
    block = np.empty(len(frame), dtype=np.int64)
    for name in np.unique(within):
        mine = within == name
        block[mine] = _numbered(frame[mine]) // block_frames
    label = np.char.add(np.char.add(within.astype(str), " "), block.astype(str))
    return Clusters("frame" if block_frames == 1 else f"{block_frames} frames", _numbered(label), dependent)


def _numbered(labels: np.ndarray) -> np.ndarray:
    return np.unique(labels, return_inverse=True)[1].reshape(-1).astype(np.int64)
