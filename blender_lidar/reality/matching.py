"""Labelled cars and what detectors made of them, brought together row by row."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .car_sets import TRAINING
from .cars import ScoredCars
from .detections import Detections, Detector
from .labelled import LabelledClouds


@dataclass(frozen=True, slots=True, eq=False)
class JudgedCars:
    """n cars that were scored and that detectors were tried on.

    Attributes
    ----------
    cars : ScoredCars
    detectors : tuple of Detector
        A value for each of these cars.
    about : mapping of str to ndarray of str, (n,)
        What is told of each car's frame: ``split``, ``label_kind``, ``drive``.
    unlisted : int
        Labelled cars of the same frames that the table of detections does not list; they are left out.
    """

    cars: ScoredCars
    detectors: tuple[Detector, ...]
    about: Mapping[str, np.ndarray]
    unlisted: int

    def __len__(self) -> int:
        return len(self.cars)


def listed_frames(clouds: LabelledClouds, detections: Detections) -> tuple[str, ...]:
    """The sweeps that the detections name, sorted.

    Raises
    ------
    InputError
        For one that is not in the folder.
    """
    there = set(clouds.frames)
    for line, frame in zip(detections.line.tolist(), detections.frame.tolist(), strict=True):
        if frame not in there:
            raise InputError(
                f"{detections.path}:{line}: frame {frame!r} is no sweep of {clouds.folder}, which has {len(there)}, "
                f"{clouds.frames[0]} to {clouds.frames[-1]}"
            )
    return tuple(sorted(set(detections.frame.tolist())))


def training_frames(detections: Detections) -> tuple[str, ...]:
    """The sweeps that detectors learned from, as far as it is told, sorted."""
    if "split" not in detections.about:
        return ()
    return tuple(sorted(set(detections.frame[detections.about["split"] == TRAINING].tolist())))


def judged_cars(cars: ScoredCars, detections: Detections, classes: Sequence[str]) -> JudgedCars:
    """Find each row of the detections among the cars.

    Raises
    ------
    InputError
        For a row that names no such car.
    """
    of_frame: dict[str, dict[int, int]] = {}
    keys = zip(cars.frame.tolist(), cars.boxes.label_line.tolist(), strict=True)
    for row, (frame, label_line) in enumerate(keys):
        of_frame.setdefault(frame, {})[label_line] = row
    rows = []
    named = zip(detections.line, detections.frame.tolist(), detections.label_line.tolist(), strict=True)
    for line, frame, label_line in named:
        known = of_frame.get(frame, {})
        if label_line not in known:
            there = ", ".join(map(str, known)) or "none"
            raise InputError(
                f"{detections.path}:{line}: label_line {label_line} of frame {frame} is no {' or '.join(classes)}; "
                f"allowed: {there}"
            )
        rows.append(known[label_line])
    order = np.argsort(rows)
    return JudgedCars(
        cars=cars.select(np.array(rows)[order]),
        detectors=tuple(one.select(order) for one in detections.detectors),
        about={name: values[order] for name, values in detections.about.items()},
        unlisted=len(cars) - len(rows),
    )
