"""The rays of real sweeps, cast against our shapes in the labelled boxes: every car real and simulated, ray by ray."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from ...casting import caster_class
from ...errors import InputError
from ...metrics.vgop import entropy, occupancy, to_vehicle_frame
from ...metrics.view_grids import VIEW_NAMES
from ...sensors.imperfections import PERFECT, Imperfections
from ...traffic.fleet import kind_of
from ...traffic.vehicles import VAN_LONGER_THAN_M
from ...world.meshes import GLASS, REFLECTIVITY
from ...world.shapes import shape
from ...world.triangles import Triangles, place
from . import LABEL_MARGIN_M, MEASURED_LOSSES
from .cars import BEARINGS
from .labelled import LabelledBoxes, LabelledClouds, LabelledSweep, joined
from .rings import NO_POINT, Firings, Rays, Rings, recover_rings

NEAREST_M, FARTHEST_M = 10.0, 50.0
CLEARANCE_M = 0.15
"""Hits less than this above a box's floor are left out, of both sides: in KITTI the road shows as a hump of returns
from 0.2 m below the floors of the labels (they are drawn by hand, and roads slope) to 0.1 m above."""
RIM_M = 0.05
"""Returns up to this far outside a box are the car's as well: one cell, as the metric has it."""
GROWN_M = 0.3  # a ray is a car's if it meets its box grown by this to all sides and up, above the clearance
_LIFT_M = np.array([0.0, 0.0, 0.5 * (GROWN_M + CLEARANCE_M)])
_GROWTH_M = np.array([2.0 * GROWN_M, 2.0 * GROWN_M, GROWN_M - CLEARANCE_M])
SHORT_M = 0.3  # a return so far before the grown box came from something else, which hides the car
# --- Variants of the simulation ---------------------------------------------------------------------------------------

RETURN_LOSSES = {
    "none": "no loss",
    "glass": "glass",
    "any": "drop-out",
    "both": "glass, drop-out",
    "weak": "weak returns",
    "all": "all of these",
}
PICTURED = "weak"  # the losses that pictures of cars are drawn with
MEASURED = Imperfections(**MEASURED_LOSSES)


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


def shapes_of_labels(boxes: LabelledBoxes) -> list[str | None]:
    """Name of the shape of each box; None for a plain box. A car longer than 4.9 m is a van, as in traffic."""
    names = []
    for label, length in zip(boxes.label.tolist(), boxes.size_m[:, 0].tolist(), strict=True):
        name = _CLASS_OF.get(label)
        if name == "car" and length > VAN_LONGER_THAN_M:
            name = "van"
        names.append(None if name is None else kind_of(name, length))
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
    for row, name in enumerate(shapes_of_labels(boxes)):
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


class PairedSweep:
    """One sweep's chosen cars, real and simulated: the rays towards them, box after box, and columns of numbers.

    The rays meet a car's box grown to all sides and up, without what lies below the clearance; a ray that meets two
    boxes is there twice.

    Parameters
    ----------
    sweep : LabelledSweep
    rows : ndarray of int64, (c,)
        The chosen cars among its boxes.
    rings : Rings
        As `recover_rings` finds them.
    number : int
        Of the sweep: what is left to chance belongs to it.

    Attributes
    ----------
    rays : Rays, (k,)
    box : ndarray of int64, (k,)
        Row of the sweep's box that each ray belongs to.
    real : ndarray of bool, (k,)
        Whether the real return came from the box.
    hidden : ndarray of bool, (k,)
        Whether it came from something well before the box: the ray says nothing of the car.
    """

    def __init__(self, sweep: LabelledSweep, rows: np.ndarray, rings: Rings, number: int) -> None:
        self.sweep, self.rows, self._number = sweep, rows, number
        firings = Firings(sweep.points, rings)
        found = [self._towards(firings, row) for row in rows.tolist()]
        *rays, self.box, self.real, self.hidden = map(np.concatenate, zip(*found, strict=True))
        self.rays = Rays(*rays)

    def _towards(self, firings: Firings, row: int) -> tuple[np.ndarray, ...]:
        points, boxes = self.sweep.points, self.sweep.boxes
        centre, size, heading = boxes.centre_m[row], boxes.size_m[row], float(boxes.heading_rad[row])
        rays, entry = firings.towards(centre + _LIFT_M, size + _GROWTH_M, heading)
        real = rays.point != NO_POINT
        real[real] = on_vehicle(to_vehicle_frame(points[rays.point[real]], centre, heading), size)
        return *rays, np.full(len(real), row), real, ~real & (rays.range_m < entry - SHORT_M)

    def simulate(self, detail: str, caster: str, margin_m: np.ndarray) -> tuple[np.ndarray, ...]:
        """Cast the rays against the sweep's scene at a level of detail.

        Returns
        -------
        distance_m : ndarray, (k,)
            To the first thing [m]; inf where there is none.
        glass, reflectivity : ndarray, (k,)
            Whether that is glass, and its reflectivity; meaningless where there is nothing.
        cosine : ndarray, (k,)
            Of the incidence on it; 1 where there is nothing.
        of_car : ndarray of bool, (k,)
            Whether it is the car whose ray it is.
        """
        scene = scene_triangles(self.sweep.boxes, detail, margin_m)
        tree = caster_class(caster)(scene.corners, closed=True)
        hits = tree.cast(self.rays.origin, self.rays.direction)
        met = np.flatnonzero(hits.triangle >= 0)
        triangle, rays = hits.triangle[met], len(self.box)
        surface, cosine, of_car = np.zeros(rays, dtype=np.uint8), np.ones(rays), np.zeros(rays, dtype=bool)
        surface[met] = scene.surface[triangle]
        cosine[met] = np.abs(np.einsum("ij,ij->i", tree.normals(triangle), self.rays.direction[met]))
        of_car[met] = scene.owner[triangle] == self.box[met]
        return hits.distance, surface == GLASS, REFLECTIVITY[surface], cosine, of_car

    def returned(self, seen: tuple[np.ndarray, ...], imperfections: Imperfections) -> tuple[np.ndarray, np.ndarray]:
        """What an imperfect sensor measures of what `simulate` gives, as `scan` has it.

        Returns
        -------
        distance_m : ndarray, (k,)
            As measured along each ray [m]; inf where nothing returned.
        hit : ndarray of bool, (k,)
            Whether the ray hit its car, on it and above the clearance.
        """
        *met, of_car = seen
        # As a lattice of one ring, so that every ray draws its own numbers.
        row = SimpleNamespace(rings=1, columns=len(of_car), column=lambda ring, slot: slot + 0 * ring)
        model = imperfections.measurement(row, self._number, min_range_m=-np.inf)
        distance_m = model.measured(np.arange(len(of_car)), *met)
        hit = of_car & np.isfinite(distance_m)
        hit[hit] = on_vehicle(self.local(distance_m, hit), self.sweep.boxes.size_m[self.box[hit]])
        return distance_m, hit

    def real_columns(self) -> dict[str, np.ndarray]:
        """What does not depend on the variant, (c,) each."""
        toward = self._count(np.ones(len(self.box), dtype=bool))
        return {
            "frame": np.full(len(self.rows), self.sweep.frame),
            **self.sweep.boxes.select(self.rows).columns(),
            "rays": toward,
            "hidden_share": self._count(self.hidden) / np.maximum(toward, 1),
            "unreturned_share": self._count(self.rays.point == NO_POINT) / np.maximum(toward, 1),
            "real_points": self._count(self.real),
            **self._scores("real", self.rays.range_m, self.real),
        }

    def columns(self, distance_m: np.ndarray, hit: np.ndarray) -> dict[str, np.ndarray]:
        """What comes of what `returned` gives, (c,) each; residuals are NaN where no ray hit in both."""
        shown = hit & ~self.hidden
        both = shown & self.real
        off, box = self.rays.range_m[both] - distance_m[both], self.box[both]
        medians = np.full((2, len(self.rows)), np.nan)
        for column, row in enumerate(self.rows):
            if (box == row).any():
                medians[:, column] = np.median([off[box == row], np.abs(off[box == row])], axis=1)
        return {
            "simulated_points": self._count(shown),
            "both_points": self._count(both),
            **self._scores("simulated", distance_m, shown),
            "simulated_entropy_hidden_kept_bits": self._scores("", distance_m, hit)["_entropy_bits"],
            "residual_median_m": medians[0],
            "residual_abs_median_m": medians[1],
        }

    def residuals(self, distance_m: np.ndarray, hit: np.ndarray) -> np.ndarray:
        """Of rays that hit in both: simulated point in the car's unit box, real less simulated range [m], (k, 4)."""
        both = hit & ~self.hidden & self.real
        placed = self.local(distance_m, both) / self.sweep.boxes.size_m[self.box[both]]
        return np.column_stack([placed, self.rays.range_m[both] - distance_m[both]])

    def local(self, distance_m: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Points at the distances (k,) of all rays, for those that a mask picks, in the frames of their cars [m]."""
        points = self.rays.origin[which] + distance_m[which, None] * self.rays.direction[which]
        boxes = self.sweep.boxes
        return to_vehicle_frame(points, boxes.centre_m, boxes.heading_rad, self.box[which])

    def _scores(self, of: str, distance_m: np.ndarray, which: np.ndarray) -> dict[str, np.ndarray]:
        boxes = self.sweep.boxes
        share = occupancy(self.local(distance_m, which), self.box[which], boxes.size_m)[self.rows]
        columns = {f"{of}_p_{view}": column for view, column in zip(VIEW_NAMES, share.T, strict=True)}
        return {**columns, f"{of}_entropy_bits": entropy(share).sum(axis=1)}

    def _count(self, which: np.ndarray) -> np.ndarray:
        return np.bincount(self.box[which], minlength=len(self.sweep.boxes))[self.rows]


def on_vehicle(local: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Which points (k, 3) in a vehicle's frame count as its own [m]; `size` (3,) or (k, 3)."""
    inside = (np.abs(local) <= 0.5 * size + RIM_M).all(axis=1)
    return inside & (local[:, 2] >= CLEARANCE_M - 0.5 * size[..., 2])


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
    table : dict of str to ndarray, (v * c,)
        A row for each variant and car, variant after variant: those of `PairedSweep.real_columns`, ``detail, losses``,
        those of `PairedSweep.columns` and ``error_bits``, simulated less real PE-VGOP. ``paired["error_bits"]`` is
        (v, c).
    residuals : dict of str to ndarray, (k, 4)
        As `PairedSweep.residuals`, by level of detail, of all sweeps.
    sensor : dict
        What was recovered of the sensor, over all sweeps.
    left_out : dict of str to int
        Labelled cars that were not compared, by reason.
    pictured : tuple of PicturedCar
        Of the cars seen along their axis and of the others the ones with the most points.
    """

    variants: tuple[Variant, ...]
    table: dict[str, np.ndarray]
    residuals: dict[str, np.ndarray]
    sensor: dict
    left_out: dict[str, int]
    pictured: tuple[PicturedCar, ...]

    def __len__(self) -> int:
        return len(self.table["frame"]) // len(self.variants)

    def __getitem__(self, name: str) -> np.ndarray:
        """A column, (v, c)."""
        return self.table[name].reshape(len(self.variants), -1)


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
    rings, pictured = [], {}
    tables: list[list] = [[] for _ in ways]
    residuals: dict[str, list] = {way.detail: [] for way in ways}
    for number, frame in enumerate(clouds.frames):
        sweep = clouds.read(frame)
        rows = _chosen(sweep.boxes, classes, left_out)
        if len(rows):
            rings.append(recover_rings(sweep.points, f"{clouds.folder}: {frame}"))
            paired = PairedSweep(sweep, rows, rings[-1], number)
            real = paired.real_columns()
            seen = {detail: paired.simulate(detail, caster, np.asarray(margin_m, dtype=float)) for detail in residuals}
            found = [paired.returned(seen[way.detail], way.imperfections) for way in ways]
            for way, one, table in zip(ways, found, tables, strict=True):
                named = {key: np.full(len(rows), getattr(way, key)) for key in ("detail", "losses")}
                table.append({**real, **named, **paired.columns(*one)})
                if way.losses == "none":
                    residuals[way.detail].append(paired.residuals(*one))
            _picture(pictured, paired, ways, found)
        report()
    if not rings:
        raise InputError(
            f"{clouds.folder}: none of its {len(clouds)} sweeps has a whole {' or '.join(classes)} at "
            f"{NEAREST_M:g} to {FARTHEST_M:g} m"
        )
    table = joined([one for tables_of_one in tables for one in tables_of_one])
    table["error_bits"] = table["simulated_entropy_bits"] - table["real_entropy_bits"]
    return PairedCars(
        variants=ways,
        table=table,
        residuals={detail: np.concatenate(found) for detail, found in residuals.items()},
        sensor=_sensor_facts(rings),
        left_out=dict(left_out),
        pictured=tuple(one for _, one in sorted(pictured.items())),
    )


def _chosen(boxes: LabelledBoxes, classes: Sequence[str], left_out: Counter) -> np.ndarray:
    """Rows of the cars to compare; the others are counted by the reason why not."""
    left = boxes.of_class(classes)
    for reason, why in (
        ("cut off by the picture", boxes.truncation > 0.0),  # NaN where the data set does not say
        ("nearer", boxes.distance_m < NEAREST_M),
        ("farther", boxes.distance_m >= FARTHEST_M),
    ):
        left_out[reason] += int((left & why).sum())
        left &= ~why
    return np.flatnonzero(left)


def _picture(pictured: dict, paired: PairedSweep, ways: tuple[Variant, ...], found: list[tuple]) -> None:
    """Keep the car with the most points of those seen along, and of those seen across their axis."""
    boxes = paired.sweep.boxes
    for row, bearing in zip(paired.rows.tolist(), boxes.bearing_deg[paired.rows].tolist(), strict=True):
        kind, mine = bearing >= BEARINGS["oblique"], paired.box == row
        real = paired.local(paired.rays.range_m, mine & paired.real)
        if kind not in pictured or len(real) > len(pictured[kind].real):
            simulated = {
                way.detail: paired.local(distance_m, mine & hit & ~paired.hidden)
                for way, (distance_m, hit) in zip(ways, found, strict=True)
                if way.losses == PICTURED
            }
            line = int(boxes.label_line[row])
            pictured[kind] = PicturedCar(paired.sweep.frame, line, boxes.size_m[row], real, simulated)


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
        **{key: np.median([getattr(one, key) for one in rings], axis=0).tolist() for key in ("height_m", "lateral_m")},
    }
