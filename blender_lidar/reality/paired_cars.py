"""Every whole car of every sweep of a data set, real and simulated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .cars import BEARINGS, bearing_deg
from .labelled import LabelledClouds, LabelledSweep
from .labelled_scene import CAR, LABEL_MARGIN_M
from .paired_sweep import Outcome, PairedSweep
from .pairing import car_rays
from .rings import Rings, recover_rings
from .variants import DRAWN, Variant

NEAREST_M, FARTHEST_M = 10.0, 50.0


@dataclass(frozen=True, slots=True, eq=False)
class Pictured:
    """A car to be drawn: its points in its own frame [m], in reality and by level of detail."""

    frame: str
    label_line: int
    size_m: np.ndarray
    real: np.ndarray
    simulated: dict[str, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class PairedCars:
    """What was found.

    Attributes
    ----------
    variants : tuple of Variant
    cars : dict of str to ndarray, (c,)
        One row for each car: what does not depend on the variant.
    of : tuple of dict of str to ndarray, (c,)
        What does, in the order of `variants`.
    residuals : dict of str to ndarray, (k, 4)
        By level of detail, of the rays that hit in both: the simulated point in the unit box of its car, and real less
        simulated range [m].
    sensor : dict
        What was recovered of the sensor, over all sweeps.
    left_out : dict of str to int
        Labelled cars that were not compared, by reason.
    pictured : tuple of Pictured
        Of the cars seen along their axis and of the others the ones with the most points.
    """

    variants: tuple[Variant, ...]
    cars: dict[str, np.ndarray]
    of: tuple[dict[str, np.ndarray], ...]
    residuals: dict[str, np.ndarray]
    sensor: dict
    left_out: dict[str, int]
    pictured: tuple[Pictured, ...]

    def __len__(self) -> int:
        return len(self.cars["frame"])

    def errors(self, variant: int, hidden_kept: bool = False) -> np.ndarray:
        """Simulated less real PE-VGOP of each car, (c,) [bits]."""
        name = "simulated_entropy_hidden_kept_bits" if hidden_kept else "simulated_entropy_bits"
        return self.of[variant][name] - self.cars["real_entropy_bits"]


def pair_cars(
    clouds: LabelledClouds,
    ways: tuple[Variant, ...],
    caster: str,
    margin_m: Sequence[float] = LABEL_MARGIN_M,
    classes: Sequence[str] = (CAR,),
    report: Callable[[], None] = lambda: None,
) -> PairedCars:
    """Compare every car at 10 to 50 m that the picture did not cut off.

    Parameters
    ----------
    clouds : LabelledClouds
    ways : tuple of Variant
    caster : str
        A name of `casting.CASTERS`.
    margin_m : sequence of float, (3,)
        By how much labels are longer, wider and higher than what they are drawn about [m].
    classes : sequence of str
        What counts as a car, in the data set's words; capitals do not matter. All else that is labelled only hides.
    report : callable
        Called after each sweep.

    Raises
    ------
    InputError
        For a sweep whose rings cannot be recovered, or when there is no car to compare.
    """
    left_out: Counter[str] = Counter()
    rings, cars, pictured = [], [], {}
    of: list[list] = [[] for _ in ways]
    residuals: dict[str, list] = {way.detail: [] for way in ways}
    for number, frame in enumerate(clouds.frames):
        sweep = clouds.read(frame)
        rows = _chosen(sweep, classes, left_out)
        if len(rows):
            rings.append(recover_rings(sweep.points, f"{clouds.folder}: {frame}"))
            paired = PairedSweep(sweep, car_rays(sweep, rows, rings[-1]), rows, number)
            outcomes = paired.outcomes(ways, caster, np.asarray(margin_m, dtype=float))
            cars.append(paired.real_columns())
            for table, outcome in zip(of, outcomes, strict=True):
                table.append(paired.columns(outcome))
            _picture(pictured, paired, ways, outcomes)
            for way, outcome in zip(ways, outcomes, strict=True):
                if way.losses == "none":
                    residuals[way.detail].append(_placed_residuals(paired, outcome))
        report()
    if not cars:
        raise InputError(
            f"{clouds.folder}: none of its {len(clouds)} sweeps has a whole {' or '.join(classes)} at "
            f"{NEAREST_M:g} to {FARTHEST_M:g} m"
        )
    return PairedCars(
        variants=ways,
        cars=_joined(cars),
        of=tuple(map(_joined, of)),
        residuals={detail: np.concatenate(found) for detail, found in residuals.items()},
        sensor=_sensor_facts(rings),
        left_out=dict(left_out),
        pictured=tuple(one for _, one in sorted(pictured.items())),
    )


def _chosen(sweep: LabelledSweep, classes: Sequence[str], left_out: Counter) -> np.ndarray:
    """Rows of the cars to compare; the others are counted by the reason why not."""
    boxes = sweep.boxes
    car = np.isin(np.char.lower(boxes.label.astype(str)), [name.lower() for name in classes])
    cut = car & (boxes.truncation > 0.0)  # NaN where the data set does not say
    near, far = car & ~cut & (boxes.distance_m < NEAREST_M), car & ~cut & (boxes.distance_m >= FARTHEST_M)
    for reason, which in {"cut off by the picture": cut, "nearer": near, "farther": far}.items():
        left_out[reason] += int(which.sum())
    return np.flatnonzero(car & ~cut & ~near & ~far)


def _picture(pictured: dict, paired: PairedSweep, ways: tuple[Variant, ...], outcomes: list[Outcome]) -> None:
    """Keep the car with the most points of those seen along, and of those seen across their axis."""
    sweep, rays = paired.sweep, paired.rays
    for row, bearing in zip(paired.rows.tolist(), bearing_deg(sweep.boxes.select(paired.rows)).tolist(), strict=True):
        kind = bearing >= BEARINGS["oblique"][0]
        real = paired.real[rays.box[paired.real] == row]
        if kind in pictured and len(real) <= len(pictured[kind].real):
            continue
        simulated = {
            way.detail: paired.local(outcome.distance_m, outcome.shown[rays.box[outcome.shown] == row])
            for way, outcome in zip(ways, outcomes, strict=True)
            if way.losses == DRAWN
        }
        line, size = int(sweep.boxes.label_line[row]), sweep.boxes.size_m[row]
        pictured[kind] = Pictured(sweep.frame, line, size, paired.local(rays.rays.range_m, real), simulated)


def _placed_residuals(paired: PairedSweep, outcome: Outcome) -> np.ndarray:
    size = paired.sweep.boxes.size_m[paired.rays.box[outcome.both]]
    return np.column_stack([paired.local(outcome.distance_m, outcome.both) / size, paired.residuals(outcome)])


def _sensor_facts(rings: list[Rings]) -> dict:
    """What the sweeps say of their sensor: medians over them, and how much they differ."""
    counts = sorted({len(one) for one in rings})
    facts = {
        "rings": counts,
        "azimuth_step_deg": float(np.degrees(np.median([one.step_rad for one in rings]))),
        "off_cone_median_m": float(np.median([one.spread_m for one in rings])),
    }
    if len(counts) > 1:
        return facts
    elevation = np.degrees([one.elevation_rad for one in rings])
    height, lateral = np.array([one.height_m for one in rings]), np.array([one.lateral_m for one in rings])
    return facts | {
        "elevation_deg": np.median(elevation, axis=0).tolist(),
        "elevation_spread_deg": float(np.median(np.abs(elevation - np.median(elevation, axis=0)))),
        "height_m": np.median(height, axis=0).tolist(),
        "lateral_m": np.median(lateral, axis=0).tolist(),
    }


def _joined(tables: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
