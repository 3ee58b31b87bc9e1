"""Sim-to-real comparison: recorded, labelled clouds beside the simulation of the same rays against the same boxes.

Every vehicle is paired with itself: the rays that the sensor sent towards its box are cast against our shapes at the
same place. A ray that something unlabelled stopped well before the box says nothing of the vehicle and counts on
neither side.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from types import SimpleNamespace

import numpy as np

from ..casting import caster_class
from ..clouds.rings import Rings, rings_of
from ..errors import InputError
from ..metrics.vgop import entropy, occupancy, to_vehicle_frame
from ..metrics.view_grids import VIEW_NAMES
from ..sensors.beams import BeamLattice
from ..sensors.imperfections import PERFECT, Imperfections
from ..sensors.pose import Pose
from ..statistics import FEWEST_BLOCKS, RESAMPLES, interval_90, resampled_weights
from ..world.meshes import GLASS, REFLECTIVITY
from ..world.shapes import shape
from ..world.triangles import Triangles, place
from .recorded import NO_POINT, PLACE_ALONE, Firings, LabelledBoxes, Rays, RecordedFrame

CLEARANCE_M = 0.15
"""Hits less than this above a box's floor are left out, of both sides: in KITTI the road shows as a hump of returns
from 0.2 m below the floors of the labels (they are drawn by hand, and roads slope) to 0.1 m above."""
RIM_M = 0.05
"""Returns up to this far outside a box are the vehicle's as well: one cell, as the metric has it."""
GROWN_M = 0.3  # a ray is a vehicle's if it meets its box grown by this to all sides and up, above the clearance
SHORT_M = 0.3  # a return so far before the grown box came from something else, which hides the vehicle
BAND_EDGES_M = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 75.0, 110.0, 150.0, np.inf)
NO_LOSSES = "none"
AT_THE_ORIGIN = Pose(height_m=0.0)
_SEED = 1


@dataclass(frozen=True, slots=True)
class Setup:
    """How recorded clouds are simulated.

    Attributes
    ----------
    details : tuple of str
        Levels of detail of `world.shapes.DETAILS`.
    caster : str
        A name of `casting.CASTERS`.
    pose : Pose
        Of the sensor in the frame of the clouds.
    losses : mapping of str to Imperfections
        Each by its name: every level of detail is seen with each of them.
    margin_m : tuple of float
        By how much labels are longer, wider and higher than the vehicles in them [m].
    clearance_m : float
        Hits less than this above a box's floor are left out, of both sides [m].
    classes : tuple of str or None
        Labels of what is compared; None: all that has a shape. All else that is labelled only hides.
    between_m : tuple of float
        Nearest and farthest horizontal distance of box centres from the sensor [m], the latter excluded.
    blind_deg : sequence of (float, float)
        Sectors of azimuth in which the sensor returns nothing, clockwise from its +y: rays there say nothing.
    """

    details: tuple[str, ...]
    caster: str
    pose: Pose = AT_THE_ORIGIN
    losses: Mapping[str, Imperfections] = field(default_factory=lambda: {NO_LOSSES: PERFECT})
    margin_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clearance_m: float = CLEARANCE_M
    classes: tuple[str, ...] | None = None
    between_m: tuple[float, float] = (0.0, np.inf)
    blind_deg: Sequence[tuple[float, float]] = ()


def scene_triangles(boxes: LabelledBoxes, detail: str, margin_m: Sequence[float]) -> Triangles:
    """Every labelled thing as triangles in the frame of the cloud, one closed mesh each; `owner` is its row.

    `margin_m` (3,) as in `Setup`; the shape stands on the floor of its box.
    """
    corners, owner, surface = [np.empty((0, 3, 3))], [np.empty(0, np.int32)], [np.empty(0, np.uint8)]
    for row, name in enumerate(boxes.shape.tolist()):
        size, centre = boxes.size_m[row].copy(), boxes.centre_m[row].copy()
        unit = shape(name, detail) if name else shape("car", "box")
        if name:
            taken = np.minimum(margin_m, 0.5 * size)
            size, centre = size - taken, centre - [0.0, 0.0, 0.5 * taken[2]]
        placed = place(unit.vertices, centre[None], size[None], boxes.heading_rad[row : row + 1])[0]
        corners.append(placed[unit.faces])
        owner.append(np.full(len(unit.faces), row, dtype=np.int32))
        surface.append(unit.surface)
    return Triangles(np.concatenate(corners), np.concatenate(owner), np.concatenate(surface))


# --- One cloud --------------------------------------------------------------------------------------------------------


class PairedFrame:
    """One recorded cloud's chosen vehicles, real and simulated: the rays towards them, box after box.

    A ray that meets two boxes is there twice.

    Parameters
    ----------
    frame : RecordedFrame
    rows : ndarray of int64, (c,)
        The chosen vehicles among its boxes.
    rings : Rings
        Of its points.
    setup : Setup
    number : int
        Of the cloud: what is left to chance belongs to it.

    Attributes
    ----------
    rays : Rays, (k,)
    box : ndarray of int64, (k,)
        Row of the box that each ray belongs to.
    real : ndarray of bool, (k,)
        Whether the real return came from the box.
    hidden : ndarray of bool, (k,)
        Whether it came from something well before the box, or lies in a blind sector: it says nothing of the vehicle.
    """

    def __init__(self, frame: RecordedFrame, rows: np.ndarray, rings: Rings, setup: Setup, number: int) -> None:
        self._frame, self._rows, self._setup, self._number = frame, rows, setup, number
        firings = Firings(frame.points, rings, setup.pose)
        found = [self._towards(firings, row) for row in rows.tolist()]
        *rays, self.box, self.real, self.hidden = map(np.concatenate, zip(*found, strict=True))
        self.rays = Rays(*rays)

    def _towards(self, firings: Firings, row: int) -> tuple[np.ndarray, ...]:
        points, boxes, clearance_m = self._frame.points, self._frame.boxes, self._setup.clearance_m
        centre, size, heading = boxes.centre_m[row], boxes.size_m[row], float(boxes.heading_rad[row])
        lift = np.array([0.0, 0.0, 0.5 * (GROWN_M + clearance_m)])
        growth = np.array([2.0 * GROWN_M, 2.0 * GROWN_M, GROWN_M - clearance_m])
        rays, entry = firings.towards(centre + lift, size + growth, heading)
        real = rays.point != NO_POINT
        real[real] = on_vehicle(to_vehicle_frame(points[rays.point[real]], centre, heading), size, clearance_m)
        x, y, _ = (rays.direction @ self._setup.pose.rotation.T).T
        azimuth, blind = np.degrees(np.arctan2(x, y)), np.zeros(len(real), dtype=bool)
        for first, last in self._setup.blind_deg:
            blind |= (azimuth - first) % 360.0 <= (last - first) % 360.0
        return *rays, np.full(len(real), row), real, ~real & (blind | (rays.range_m < entry - SHORT_M))

    def simulate(self, detail: str) -> tuple[np.ndarray, ...]:
        """Cast the rays against the labelled scene at a level of detail.

        Returns
        -------
        distance_m : ndarray, (k,)
            To the first thing [m]; inf where there is none.
        glass, reflectivity : ndarray, (k,)
            Whether that is glass, and its reflectivity; meaningless where there is nothing.
        cosine : ndarray, (k,)
            Of the incidence on it; 1 where there is nothing.
        of_vehicle : ndarray of bool, (k,)
            Whether it is the vehicle whose ray it is.
        """
        scene = scene_triangles(self._frame.boxes, detail, self._setup.margin_m)
        tree = caster_class(self._setup.caster)(scene.corners, closed=True)
        hits = tree.cast(self.rays.origin, self.rays.direction)
        met = np.flatnonzero(hits.triangle >= 0)
        triangle, rays = hits.triangle[met], len(self.box)
        surface, cosine, of_vehicle = np.zeros(rays, dtype=np.uint8), np.ones(rays), np.zeros(rays, dtype=bool)
        surface[met] = scene.surface[triangle]
        cosine[met] = np.abs(np.einsum("ij,ij->i", tree.normals(triangle), self.rays.direction[met]))
        of_vehicle[met] = scene.owner[triangle] == self.box[met]
        return hits.distance, surface == GLASS, REFLECTIVITY[surface], cosine, of_vehicle

    def returned(self, seen: tuple[np.ndarray, ...], losses: Imperfections) -> tuple[np.ndarray, np.ndarray]:
        """What an imperfect sensor measures of what `simulate` gives, as `scan` has it.

        Returns
        -------
        distance_m : ndarray, (k,)
            As measured along each ray [m]; inf where nothing returned.
        hit : ndarray of bool, (k,)
            Whether the ray hit its vehicle, above the clearance.
        """
        *met, of_vehicle = seen
        # As a lattice of one ring, so that every ray draws its own numbers.
        row = SimpleNamespace(rings=1, columns=len(of_vehicle), column=lambda ring, slot: slot + 0 * ring)
        model = losses.measurement(row, self._number, min_range_m=-np.inf)
        distance_m = model.measured(np.arange(len(of_vehicle)), *met)
        hit = of_vehicle & np.isfinite(distance_m)
        sizes = self._frame.boxes.size_m[self.box[hit]]
        hit[hit] = on_vehicle(self._local(distance_m, hit), sizes, self._setup.clearance_m)
        return distance_m, hit

    def real_columns(self) -> dict[str, np.ndarray]:
        """What does not depend on the simulation, (c,) each."""
        boxes, toward = self._frame.boxes.select(self._rows), self._count(np.ones(len(self.box), dtype=bool))
        return {
            "frame": np.full(len(self._rows), self._frame.name),
            "vehicle_id": boxes.vehicle_id,
            "class": boxes.label,
            "distance_m": distance_m(boxes, self._setup.pose),
            **dict(zip(("length_m", "width_m", "height_m"), boxes.size_m.T, strict=True)),
            "rays": toward,
            "hidden_share": self._count(self.hidden) / np.maximum(toward, 1),
            "real_points": self._count(self.real),
            **self._scores("real", self.rays.range_m, self.real),
        }

    def columns(self, distance_m: np.ndarray, hit: np.ndarray) -> dict[str, np.ndarray]:
        """What comes of what `returned` gives, (c,) each; `range_error_m` is NaN where no ray hit in both."""
        shown = hit & ~self.hidden
        both = shown & self.real
        off, box = np.abs(self.rays.range_m[both] - distance_m[both]), self.box[both]
        medians = [np.median(off[box == row]) if (box == row).any() else np.nan for row in self._rows]
        return {
            "simulated_points": self._count(shown),
            "both_points": self._count(both),
            **self._scores("simulated", distance_m, shown),
            "range_error_m": np.array(medians),
        }

    def _local(self, distance_m: np.ndarray, which: np.ndarray) -> np.ndarray:
        """Points at the distances (k,) of all rays, for those that a mask picks, in the frames of their boxes [m]."""
        points = self.rays.origin[which] + distance_m[which, None] * self.rays.direction[which]
        boxes = self._frame.boxes
        return to_vehicle_frame(points, boxes.centre_m, boxes.heading_rad, self.box[which])

    def _scores(self, of: str, distance_m: np.ndarray, which: np.ndarray) -> dict[str, np.ndarray]:
        boxes = self._frame.boxes
        share = occupancy(self._local(distance_m, which), self.box[which], boxes.size_m)[self._rows]
        columns = {f"{of}_p_{view}": column for view, column in zip(VIEW_NAMES, share.T, strict=True)}
        return {**columns, f"{of}_entropy_bits": entropy(share).sum(axis=1)}

    def _count(self, which: np.ndarray) -> np.ndarray:
        return np.bincount(self.box[which], minlength=len(self._frame.boxes))[self._rows]


def on_vehicle(local: np.ndarray, size: np.ndarray, clearance_m: float) -> np.ndarray:
    """Which points (k, 3) in a vehicle's frame count as its own [m]; `size` (3,) or (k, 3)."""
    inside = (np.abs(local) <= 0.5 * size + RIM_M).all(axis=1)
    return inside & (local[:, 2] >= clearance_m - 0.5 * size[..., 2])


def distance_m(boxes: LabelledBoxes, pose: Pose) -> np.ndarray:
    """Horizontal distance of each box centre from the sensor, (n,) [m]."""
    return np.hypot(*(boxes.centre_m[:, :2] - pose.position[:2]).T)


# --- All clouds -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class CloudComparison:
    """Every chosen vehicle of every cloud, real and simulated.

    Attributes
    ----------
    table : dict of str to ndarray, (d * c,)
        A row for each level of detail, losses and vehicle, in this order: ``detail``, ``losses``, those of
        `PairedFrame.real_columns` and `PairedFrame.columns`, and ``error_bits``, simulated less real PE-VGOP.
    sensor : dict
        What the clouds say of their sensor: the median distance of the points from their rings, ``off_ring_m``, and
        the share of the points that fits the beam table, ``share_on_rings``.
    left_out : dict of str to int
        Labelled vehicles that were not compared, by reason.
    """

    table: dict[str, np.ndarray]
    sensor: dict
    left_out: dict[str, int]


def compare_frames(
    frames: Iterable[RecordedFrame], lattice: BeamLattice, setup: Setup, report: Callable[[], None] = lambda: None
) -> CloudComparison:
    """Pair every chosen vehicle of recorded clouds with its simulation.

    Parameters
    ----------
    frames : iterable of RecordedFrame
    lattice : BeamLattice
        The sensor's beams.
    setup : Setup
    report : callable
        Called after each cloud.

    Raises
    ------
    InputError
        Where the beam table does not fit a cloud, or there is no vehicle to compare.
    """
    left_out: Counter[str] = Counter()
    labels: set[str] = set()
    facts: list[tuple[float, float]] = []
    tables: dict[tuple[str, str], list] = {key: [] for key in product(setup.details, setup.losses)}
    for number, frame in enumerate(frames):
        rows = chosen(frame.boxes, setup, left_out)
        labels.update(frame.boxes.label.tolist())
        if len(rows):
            rings, share = rings_of(setup.pose.to_sensor(frame.points), lattice, frame.where)
            facts.append((rings.spread_m, share))
            paired = PairedFrame(frame, rows, rings, setup, number)
            real = paired.real_columns()
            for detail in setup.details:
                seen = paired.simulate(detail)
                for name, losses in setup.losses.items():
                    variant = {"detail": np.full(len(rows), detail), "losses": np.full(len(rows), name)}
                    found = paired.columns(*paired.returned(seen, losses))
                    tables[detail, name].append({**variant, **real, **found})
        report()
    if not facts:
        raise _nothing_to_compare(setup, left_out, labels)
    parts = [one for of_variant in tables.values() for one in of_variant]
    table = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}
    table["error_bits"] = table["simulated_entropy_bits"] - table["real_entropy_bits"]
    spread, shares = np.median(facts, axis=0).tolist()
    return CloudComparison(table, {"off_ring_m": spread, "share_on_rings": shares}, dict(left_out))


def _nothing_to_compare(setup: Setup, left_out: Mapping[str, int], labels: set[str]) -> InputError:
    what = " or ".join(setup.classes or ["labelled vehicle"])
    if not any(left_out.values()):
        return InputError(f"no {what} to compare; the labels are {', '.join(sorted(labels)) or 'none'}")
    near, far = setup.between_m
    why = ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count)
    return InputError(f"no {what} to compare at {near:g} to {far:g} m ({why})")


def chosen(boxes: LabelledBoxes, setup: Setup, left_out: Counter) -> np.ndarray:
    """Rows of the vehicles to compare; the others of those classes are counted by the reason why not."""
    left, away = boxes.of_class(setup.classes), distance_m(boxes, setup.pose)
    near, far = setup.between_m
    left_out["of a guessed size"] += int((boxes.label == PLACE_ALONE).sum())
    reasons = {"nearer": away < near, "farther": away >= far}
    for reason, why in reasons.items():
        left_out[reason] += int((left & why).sum())
        left &= ~why
    return np.flatnonzero(left)


# --- Aggregates -------------------------------------------------------------------------------------------------------


def aggregate(table: Mapping[str, np.ndarray]) -> dict:
    """Errors of each variant, over all vehicles and by distance, ready for JSON; `table` as in `CloudComparison`.

    A variant is a level of detail with some losses.

    Whole frames are resampled where there are three or more, else single vehicles.
    """
    variants = list(dict.fromkeys(zip(table["detail"].tolist(), table["losses"].tolist(), strict=True)))
    frames = len(np.unique(table["frame"]))
    by_frame = frames >= FEWEST_BLOCKS
    found = []
    for detail, losses in variants:
        which = (table["detail"] == detail) & (table["losses"] == losses)
        mine = {name: column[which] for name, column in table.items()}
        cluster = mine["frame"] if by_frame else np.arange(len(mine["frame"]))
        bands = np.digitize(mine["distance_m"], BAND_EDGES_M) - 1
        by_distance = [
            {"low_m": BAND_EDGES_M[band], "high_m": BAND_EDGES_M[band + 1] if band + 2 < len(BAND_EDGES_M) else None}
            | errors(mine, cluster, bands == band)
            for band in np.unique(bands).tolist()
        ]
        found.append(
            {"detail": detail, "losses": losses, **errors(mine, cluster, bands >= 0), "by_distance": by_distance}
        )
    vehicles = len(table["frame"]) // len(variants)
    return {"frames": frames, "vehicles": vehicles, "resampled": "frame" if by_frame else "vehicle", "variants": found}


def errors(table: Mapping[str, np.ndarray], cluster: np.ndarray, which: np.ndarray) -> dict:
    """Errors of the vehicles that a mask picks, of one variant; `cluster` (n,) is resampled as one."""
    mine, drawn = {name: column[which] for name, column in table.items()}, cluster[which]
    real, simulated, both = (int(mine[f"{name}_points"].sum()) for name in ("real", "simulated", "both"))
    known = mine["range_error_m"][np.isfinite(mine["range_error_m"])]
    return {
        "vehicles": int(which.sum()),
        "points": {"real": real, "simulated": simulated, "both": both},
        "real_entropy_bits": float(np.median(mine["real_entropy_bits"])),
        "absolute_error_bits": median_interval(np.abs(mine["error_bits"]), drawn),
        "bias_bits": median_interval(mine["error_bits"], drawn),
        "absolute_error_p": {
            view: float(np.median(np.abs(mine[f"simulated_p_{view}"] - mine[f"real_p_{view}"]))) for view in VIEW_NAMES
        },
        "range_error_m": float(np.median(known)) if len(known) else None,
    }


def median_interval(values: np.ndarray, cluster: np.ndarray) -> dict:
    """Median of values (c,) and its 90 % interval over resampled clusters (c,); None for fewer than three."""
    resampled = resampled_medians(values[None], cluster)
    interval = None if resampled is None else list(interval_90(resampled[0]))
    return {"median": float(np.median(values)), "interval_90": interval}


def resampled_medians(values: np.ndarray, cluster: np.ndarray) -> np.ndarray | None:
    """Bootstrap medians (v, resamples) of values (v, c) whose clusters (c,) are drawn; None for too few of them."""
    labels, row = np.unique(cluster, return_inverse=True)
    if len(labels) < FEWEST_BLOCKS:
        return None
    weights = resampled_weights(len(labels), np.random.default_rng(_SEED), RESAMPLES)[:, row]
    medians = []
    for of_one in values:
        order = np.argsort(of_one, kind="stable")
        reached = np.cumsum(weights[:, order], axis=1)
        half, ascending = 0.5 * reached[:, -1:], of_one[order]
        medians.append(
            0.5 * (ascending[np.argmax(reached >= half, axis=1)] + ascending[np.argmax(reached > half, axis=1)])
        )
    return np.array(medians)
