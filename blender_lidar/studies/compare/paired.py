"""The rays of real sweeps, cast against our shapes in the labelled boxes: every car real and simulated, ray by ray."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from ...casting import caster_class
from ...errors import InputError
from ...metrics.vgop import entropy, occupancy, to_vehicle_frame
from ...metrics.view_grids import VIEWS
from ...sensors.imperfections import PERFECT, Imperfections
from ...traffic.vehicles import VAN_LONGER_THAN_M
from ...world.meshes import GLASS, REFLECTIVITY
from ...world.shapes import shape, shape_of
from ...world.triangles import Triangles, place
from .cars import BEARINGS
from .labelled import LabelledBoxes, LabelledClouds, LabelledSweep
from .rings import NO_POINT, Firings, Rings, crossing, recover_rings

NEAREST_M, FARTHEST_M = 10.0, 50.0
CLEARANCE_M = 0.15
"""Hits less than this above a box's floor are left out, of both sides: in KITTI the road shows as a hump of returns
from 0.2 m below the floors of the labels (they are drawn by hand, and roads slope) to 0.1 m above."""
RIM_M = 0.05
"""Returns up to this far outside a box are the car's as well: one cell, as the metric has it."""
GROWN_M = 0.3  # a ray is a car's if it meets its box grown by this to all sides and up, above the clearance
SHORT_M = 0.3  # a return so far before the grown box came from something else, which hides the car
LABEL_MARGIN_M = (0.15, 0.06, 0.01)
"""By how much KITTI's labels are longer, wider and higher than the cars in them [m], fitted to the tuned frames."""

# --- Variants of the simulation ---------------------------------------------------------------------------------------

LOSSES = {
    "none": "no loss",
    "glass": "glass",
    "any": "drop-out",
    "both": "glass, drop-out",
    "weak": "weak returns",
    "all": "all of these",
}
PICTURED = "weak"  # the losses that pictures of cars are drawn with
MEASURED = Imperfections(0.02, 0.05, glass_dropout=0.3, range_at_10_percent_m=50.0)
"""What an HDL-64E loses of cars: noise and the range to which a 10 % target is seen are the model's own; the shares are
what is lost besides, by the tuned frames of KITTI. On those 35 to 50 m do about as well."""


class Variant(NamedTuple):
    """One way to simulate a sweep.

    Attributes
    ----------
    detail : str
        Level of detail of `world.shapes.DETAILS`.
    losses : str
        A key of `LOSSES`: nothing; returns from glass by chance; any returns by chance, and noisy ranges; both; returns
        that are too weak; all of these.
    imperfections : Imperfections
    """

    detail: str
    losses: str
    imperfections: Imperfections


def variants(details: Sequence[str], lossy: Imperfections = MEASURED) -> tuple[Variant, ...]:
    """Every level of detail, without and with each of the losses of `lossy`; a box has no glass to lose by."""
    limit, seed = lossy.range_at_10_percent_m, lossy.seed
    ways = {
        "none": PERFECT,
        "glass": Imperfections(glass_dropout=lossy.glass_dropout, seed=seed),
        "any": Imperfections(lossy.range_noise_m, lossy.dropout, seed=seed),
        "both": Imperfections(lossy.range_noise_m, lossy.dropout, glass_dropout=lossy.glass_dropout, seed=seed),
        "weak": Imperfections(range_at_10_percent_m=limit, seed=seed),
        "all": lossy,
    }
    return tuple(
        Variant(detail, losses, ways[losses])
        for detail, losses in product(details, ways)
        if detail != "box" or losses not in ("glass", "both")
    )


# --- The scene --------------------------------------------------------------------------------------------------------

# Labels of KITTI (and of SUSTechPOINTS, which names things alike) and the class whose shape stands for each; what has
# no shape of its own only hides others and is a plain box. People fill about half of theirs.
_CLASS_OF = {"Car": "car", "Van": "van", "Truck": "truck", "Tram": "bus", "Bus": "bus"}
_CLASS_OF |= {"Cyclist": "motorcycle", "Motorcycle": "motorcycle"}
_PEOPLE = ("Pedestrian", "Person_sitting", "Person")


def shape_names(boxes: LabelledBoxes) -> list[str | None]:
    """Name of the shape of each box; None for a plain box. A car longer than 4.9 m is a van, as in traffic."""
    names = []
    for label, length in zip(boxes.label.tolist(), boxes.size_m[:, 0].tolist(), strict=True):
        name = _CLASS_OF.get(label)
        if name == "car" and length > VAN_LONGER_THAN_M:
            name = "van"
        names.append(None if name is None else shape_of(name, length))
    return names


def scene_triangles(boxes: LabelledBoxes, detail: str, margin_m: np.ndarray) -> Triangles:
    """Every labelled thing as triangles in the sensor's frame, one closed mesh each; `owner` is its row.

    Parameters
    ----------
    boxes : LabelledBoxes
    detail : str
        Level of detail of `world.shapes.DETAILS`.
    margin_m : ndarray, (3,)
        By how much a label's box is longer, wider and higher than the vehicle in it [m]. The shape stands on the floor.
    """
    corners, owner, surface = [np.empty((0, 3, 3))], [np.empty(0, np.int32)], [np.empty(0, np.uint8)]
    for row, name in enumerate(shape_names(boxes)):
        size, centre = boxes.size_m[row].copy(), boxes.centre_m[row].copy()
        if name is None:
            unit = shape("car", "box")
            if boxes.label[row] in _PEOPLE:
                size *= (0.6, 0.6, 1.0)
        else:
            unit, taken = shape(name, detail), np.minimum(margin_m, 0.5 * size)
            size, centre = size - taken, centre - [0.0, 0.0, 0.5 * taken[2]]
        placed = place(unit.vertices, centre[None], size[None], boxes.heading_rad[row : row + 1])[0]
        corners.append(placed[unit.faces])
        owner.append(np.full(len(unit.faces), row, dtype=np.int32))
        surface.append(unit.surface)
    return Triangles(np.concatenate(corners), np.concatenate(owner), np.concatenate(surface))


# --- One sweep --------------------------------------------------------------------------------------------------------


class CarRays(NamedTuple):
    """The rays towards the chosen boxes of one sweep, box after box; a ray that meets two is there twice.

    Attributes
    ----------
    origin, direction, point, range_m
        As in `rings.Rays`.
    box : ndarray of int64, (k,)
        Row of the sweep's box.
    real : ndarray of bool, (k,)
        Whether the real return came from the box.
    hidden : ndarray of bool, (k,)
        Whether it came from something well before the box: the ray says nothing of the car.
    """

    origin: np.ndarray
    direction: np.ndarray
    point: np.ndarray
    range_m: np.ndarray
    box: np.ndarray
    real: np.ndarray
    hidden: np.ndarray


def car_rays(sweep: LabelledSweep, which: np.ndarray, rings: Rings) -> CarRays:
    """The rays towards the boxes `which`, (c,) rows, of a sweep; `rings` as `recover_rings` finds them.

    They meet the box grown to all sides and up, without what lies below the clearance.
    """
    firings, boxes = Firings(sweep.points, rings), sweep.boxes
    lift = np.array([0.0, 0.0, 0.5 * (GROWN_M + CLEARANCE_M)])
    more = np.array([2.0 * GROWN_M, 2.0 * GROWN_M, GROWN_M - CLEARANCE_M])
    found = []
    for row in which.tolist():
        centre, size, heading = boxes.centre_m[row], boxes.size_m[row], float(boxes.heading_rad[row])
        around, grown = centre + lift, size + more
        rays = firings.towards(around, grown, heading)
        entry, _ = crossing(rays, around, grown, heading)
        real = rays.point != NO_POINT
        real[real] = on_vehicle(to_vehicle_frame(sweep.points[rays.point[real]], centre, heading), size)
        hidden = ~real & (rays.range_m < entry - SHORT_M)
        found.append((*rays, np.full(len(real), row), real, hidden))
    return CarRays(*map(np.concatenate, zip(*found, strict=True)))


def on_vehicle(local: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Which points (k, 3) in a vehicle's frame count as its own [m]; `size` (3,) or (k, 3)."""
    inside = (np.abs(local) <= 0.5 * size + RIM_M).all(axis=1)
    return inside & (local[:, 2] >= CLEARANCE_M - 0.5 * np.broadcast_to(size, local.shape)[:, 2])


class Simulated(NamedTuple):
    """What the rays of a sweep meet in a scene of shapes.

    Attributes
    ----------
    distance_m : ndarray, (k,)
        To the first thing [m]; inf where there is none.
    surface : ndarray of uint8, (k,)
        What that is made of, an index into `shapes.SURFACES`; meaningless where there is nothing.
    cosine : ndarray, (k,)
        Cosine of the incidence on it; 1 where there is nothing.
    of_car : ndarray of bool, (k,)
        Whether that is the car whose ray it is.
    """

    distance_m: np.ndarray
    surface: np.ndarray
    cosine: np.ndarray
    of_car: np.ndarray


class Returned(NamedTuple):
    """What one variant made of a sweep's rays.

    Attributes
    ----------
    distance_m : ndarray, (k,)
        As measured along each ray [m]; inf where nothing returned.
    hit : ndarray of int64
        Rays that hit their car, on it and above the clearance.
    shown : ndarray of int64
        Those of them that nothing hid in reality.
    both : ndarray of int64
        Those of them that hit it in reality too.
    """

    distance_m: np.ndarray
    hit: np.ndarray
    shown: np.ndarray
    both: np.ndarray


@dataclass(frozen=True, slots=True)
class _RowOfBeams:
    """Rays as imperfections know them: a lattice of one ring, so that every ray draws its own numbers."""

    columns: int
    rings: int = 1

    def column(self, ring: np.ndarray, slot: np.ndarray) -> np.ndarray:
        return slot + 0 * ring


class PairedSweep:
    """One sweep's chosen cars, real and simulated, as columns of numbers.

    Parameters
    ----------
    sweep : LabelledSweep
    rays : CarRays
        Towards the boxes `rows`.
    rows : ndarray of int64, (c,)
        The chosen cars.
    number : int
        Of the sweep: what is left to chance belongs to it.
    """

    def __init__(self, sweep: LabelledSweep, rays: CarRays, rows: np.ndarray, number: int) -> None:
        self.sweep, self.rays, self.rows, self._number = sweep, rays, rows, number
        self.real = np.flatnonzero(rays.real)

    def simulate(self, detail: str, caster: str, margin_m: np.ndarray) -> Simulated:
        """Cast the rays against the sweep's scene at a level of detail."""
        rays, scene = self.rays, scene_triangles(self.sweep.boxes, detail, margin_m)
        tree = caster_class(caster)(scene.corners, closed=True)
        hits = tree.cast(rays.origin, rays.direction)
        met = hits.triangle >= 0
        surface, cosine = np.zeros(len(met), dtype=np.uint8), np.ones(len(met))
        of_car = np.zeros(len(met), dtype=bool)
        surface[met] = scene.surface[hits.triangle[met]]
        cosine[met] = np.abs(np.einsum("ij,ij->i", tree.normals(hits.triangle[met]), rays.direction[met]))
        of_car[met] = scene.owner[hits.triangle[met]] == rays.box[met]
        return Simulated(hits.distance, surface, cosine, of_car)

    def returned(self, seen: Simulated, imperfections: Imperfections) -> Returned:
        """What an imperfect sensor measures, as `scan` has it."""
        every, surface = np.arange(len(seen.distance_m)), seen.surface
        model = imperfections.measurement(_RowOfBeams(len(every)), self._number, min_range_m=-np.inf)
        distance = model.measured(every, seen.distance_m, surface == GLASS, REFLECTIVITY[surface], seen.cosine)
        hit = np.flatnonzero(seen.of_car & np.isfinite(distance))
        hit = hit[on_vehicle(self.local(distance, hit), self.sweep.boxes.size_m[self.rays.box[hit]])]
        shown = hit[~self.rays.hidden[hit]]
        return Returned(distance, hit, shown, np.intersect1d(shown, self.real, assume_unique=True))

    def real_columns(self) -> dict[str, np.ndarray]:
        """What does not depend on the variant, (c,) each."""
        rays, boxes = self.rays, self.sweep.boxes.select(self.rows)
        toward = self._count(np.arange(len(rays.box)))
        return {
            "frame": np.full(len(boxes), self.sweep.frame),
            "label_line": boxes.label_line,
            "distance_m": boxes.distance_m,
            "bearing_deg": boxes.bearing_deg,
            **dict(zip(("length_m", "width_m", "height_m"), boxes.size_m.T, strict=True)),
            "occlusion": boxes.occlusion.astype(int),
            "rays": toward,
            "hidden_share": self._count(np.flatnonzero(rays.hidden)) / np.maximum(toward, 1),
            "unreturned_share": self._count(np.flatnonzero(rays.point == NO_POINT)) / np.maximum(toward, 1),
            "real_points": self._count(self.real),
            **self._scores("real", rays.range_m, self.real),
        }

    def columns(self, found: Returned) -> dict[str, np.ndarray]:
        """What a variant comes to, (c,) each; residuals are NaN where no ray hit in both."""
        off, box = self.residuals(found), self.rays.box[found.both]
        residuals = [off[box == row] for row in self.rows]
        return {
            "simulated_points": self._count(found.shown),
            "both_points": self._count(found.both),
            **self._scores("simulated", found.distance_m, found.shown),
            "simulated_entropy_hidden_kept_bits": self._scores("", found.distance_m, found.hit)["_entropy_bits"],
            "residual_median_m": np.array([np.median(one) if len(one) else np.nan for one in residuals]),
            "residual_abs_median_m": np.array([np.median(np.abs(one)) if len(one) else np.nan for one in residuals]),
        }

    def local(self, distance_m: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Points at the distances (k,) of all rays, for some `rows` of them, in the frames of their cars [m]."""
        points = self.rays.origin[rows] + distance_m[rows, None] * self.rays.direction[rows]
        return to_vehicle_frame(points, self.sweep.boxes.centre_m, self.sweep.boxes.heading_rad, self.rays.box[rows])

    def residuals(self, found: Returned) -> np.ndarray:
        """Real less simulated range of the rays that hit in both [m]."""
        return self.rays.range_m[found.both] - found.distance_m[found.both]

    def _scores(self, of: str, distance_m: np.ndarray, rows: np.ndarray) -> dict[str, np.ndarray]:
        share = occupancy(self.local(distance_m, rows), self.rays.box[rows], self.sweep.boxes.size_m)[self.rows]
        columns = {f"{of}_p_{view}": column for view, column in zip(VIEWS, share.T, strict=True)}
        return {**columns, f"{of}_entropy_bits": entropy(share).sum(axis=1)}

    def _count(self, rows: np.ndarray) -> np.ndarray:
        return np.bincount(self.rays.box[rows], minlength=len(self.sweep.boxes))[self.rows]


# --- All sweeps -------------------------------------------------------------------------------------------------------


class PicturedCar(NamedTuple):
    """A car to be drawn: its points in its own frame [m], in reality and by level of detail."""

    frame: str
    label_line: int
    size_m: np.ndarray
    real: np.ndarray
    simulated: dict[str, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class PairedCars:
    """Every whole car of every sweep of a data set, real and simulated.

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
    pictured : tuple of PicturedCar
        Of the cars seen along their axis and of the others the ones with the most points.
    """

    variants: tuple[Variant, ...]
    cars: dict[str, np.ndarray]
    of: tuple[dict[str, np.ndarray], ...]
    residuals: dict[str, np.ndarray]
    sensor: dict
    left_out: dict[str, int]
    pictured: tuple[PicturedCar, ...]

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
    classes: Sequence[str] = ("Car",),
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
        rows = _chosen(sweep.boxes, classes, left_out)
        if len(rows):
            rings.append(recover_rings(sweep.points, f"{clouds.folder}: {frame}"))
            paired = PairedSweep(sweep, car_rays(sweep, rows, rings[-1]), rows, number)
            cars.append(paired.real_columns())
            seen = {detail: paired.simulate(detail, caster, np.asarray(margin_m, dtype=float)) for detail in residuals}
            found = [paired.returned(seen[way.detail], way.imperfections) for way in ways]
            for way, one, table in zip(ways, found, of, strict=True):
                table.append(paired.columns(one))
                if way.losses == "none":
                    size_m = sweep.boxes.size_m[paired.rays.box[one.both]]
                    placed = paired.local(one.distance_m, one.both) / size_m
                    residuals[way.detail].append(np.column_stack([placed, paired.residuals(one)]))
            _picture(pictured, paired, ways, found)
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


def _chosen(boxes: LabelledBoxes, classes: Sequence[str], left_out: Counter) -> np.ndarray:
    """Rows of the cars to compare; the others are counted by the reason why not."""
    cut = boxes.truncation > 0.0  # NaN where the data set does not say
    near, far = ~cut & (boxes.distance_m < NEAREST_M), ~cut & (boxes.distance_m >= FARTHEST_M)
    car = boxes.of_class(classes)
    for reason, which in {"cut off by the picture": cut, "nearer": near, "farther": far}.items():
        left_out[reason] += int((car & which).sum())
    return np.flatnonzero(car & ~cut & ~near & ~far)


def _picture(pictured: dict, paired: PairedSweep, ways: tuple[Variant, ...], found: list[Returned]) -> None:
    """Keep the car with the most points of those seen along, and of those seen across their axis."""
    sweep, rays = paired.sweep, paired.rays
    for row, bearing in zip(paired.rows.tolist(), sweep.boxes.bearing_deg[paired.rows].tolist(), strict=True):
        kind = bearing >= BEARINGS["oblique"][0]
        real = paired.real[rays.box[paired.real] == row]
        if kind not in pictured or len(real) > len(pictured[kind].real):
            simulated = {
                way.detail: paired.local(one.distance_m, one.shown[rays.box[one.shown] == row])
                for way, one in zip(ways, found, strict=True)
                if way.losses == PICTURED
            }
            line, size_m = int(sweep.boxes.label_line[row]), sweep.boxes.size_m[row]
            pictured[kind] = PicturedCar(sweep.frame, line, size_m, paired.local(rays.range_m, real), simulated)


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
    middle = np.median(elevation, axis=0)
    return facts | {
        "elevation_deg": middle.tolist(),
        "elevation_spread_deg": float(np.median(np.abs(elevation - middle))),
        "height_m": np.median([one.height_m for one in rings], axis=0).tolist(),
        "lateral_m": np.median([one.lateral_m for one in rings], axis=0).tolist(),
    }


def _joined(tables: list[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
