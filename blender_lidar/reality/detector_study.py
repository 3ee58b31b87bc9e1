"""The whole comparison of metrics with detectors, from folders and tables to findings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ..errors import InputError
from ..metrics.metric import Metric
from .agreement import Agreement, agreements
from .car_sets import ALL, TRAINING, CarSet, car_sets, main_set
from .cars import score_cars, training_cars
from .chosen_metrics import PAPERS, comparable
from .detections import Detections
from .distance_shape import Shape, shapes
from .ground_returns import WithoutGround, without_ground
from .labelled import LabelledClouds
from .learned_metrics import LEARNED, taught
from .matching import JudgedCars, judged_cars, listed_frames, training_frames
from .resampled_cars import Draws

OTHER_CLEARANCE_M = 0.1  # as `score --assign box` has it


@dataclass(frozen=True, slots=True)
class Settings:
    """What may be asked differently.

    Attributes
    ----------
    classes : tuple of str
        What counts as a car, in the data set's words.
    ground_clearance_m : float
        Points less than this above a box's floor are left out [m].
    draws : Draws
        How cars are resampled.
    """

    classes: tuple[str, ...] = ("Car",)
    ground_clearance_m: float = 0.0
    draws: Draws = Draws()  # noqa: RUF009


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What came of it.

    Attributes
    ----------
    judged : JudgedCars
    frames : int
        Sweeps that the detections name.
    metrics : tuple of Metric
        The first is the one that others are held against.
    untaught : tuple of str
        Metrics that were left out for want of frames to learn from.
    sets : tuple of CarSet
    main : CarSet
        The set that judges.
    agreements : tuple of Agreement
    shapes : tuple of Shape
        Of the main set and of all cars.
    other_clearance_m : float
        0 where the results leave out ground returns, else `OTHER_CLEARANCE_M`.
    without_ground : tuple of WithoutGround
        The main set under that other clearance.
    """

    judged: JudgedCars
    frames: int
    metrics: tuple[Metric, ...]
    untaught: tuple[str, ...]
    sets: tuple[CarSet, ...]
    main: CarSet
    agreements: tuple[Agreement, ...]
    shapes: tuple[Shape, ...]
    other_clearance_m: float
    without_ground: tuple[WithoutGround, ...]


def compare(clouds: LabelledClouds, detections: Detections, metrics: Sequence[Metric], settings: Settings) -> Findings:
    """Score the cars that the detections list, and hold the scores against the detectors.

    Raises
    ------
    InputError, MissingFileError
        Of files that cannot be used or do not belong together.
    """
    frames = listed_frames(clouds, detections)
    clearance = settings.ground_clearance_m
    training = training_cars(clouds, training_frames(detections), settings.classes, clearance)
    asked, metrics = metrics, taught(metrics, training)
    if not metrics:
        raise InputError(f"--metrics: {asked[0].name} learns from frames of split {TRAINING}; there are none")
    timed_first = [comparable()[PAPERS], *(one for one in metrics if one.name != PAPERS)]
    cars = score_cars(clouds, frames, settings.classes, timed_first, clearance)
    judged = judged_cars(cars, detections, settings.classes)
    other_m = 0.0 if clearance > 0.0 else OTHER_CLEARANCE_M
    other = score_cars(clouds, frames, settings.classes, timed_first, other_m)
    sets = car_sets(judged.about, len(judged))
    main = main_set(sets)
    shaped = [one for one in sets if one is main or one.name == ALL]
    return Findings(
        judged=judged,
        frames=len(frames),
        metrics=tuple(metrics),
        untaught=tuple(one.name for one in asked if one.name in LEARNED and training is None),
        sets=tuple(sets),
        main=main,
        agreements=tuple(agreements(judged, sets, metrics, settings.draws)),
        shapes=tuple(shapes(judged, shaped, metrics, settings.draws)),
        other_clearance_m=other_m,
        without_ground=tuple(
            without_ground(judged, judged_cars(other, detections, settings.classes).cars, main, metrics, settings.draws)
        ),
    )
