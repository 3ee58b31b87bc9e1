"""What a mounting is judged by: an observation, the vehicles that count, how they are scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..casting.instances import OwnBodies
from ..casting.protocol import StandingScenery
from ..errors import InputError
from ..metrics.catalogue import PE_VGOP
from ..road.road_map import polygon_holds
from ..sensors.beams import BeamLattice
from ..sensors.lidar import Lidar
from ..traffic.boxes import Boxes
from ..traffic.vehicles import CLASSES
from .settings import ObjectiveSettings


@dataclass(frozen=True, slots=True)
class Observation:
    """How the beams of a layout see vehicles, before any score is made of it.

    Attributes
    ----------
    lidars : tuple of Lidar
        What hangs; one for each mounting of a layout, in their order.
    caster : str
        A name of `casting.CASTERS`.
    detail : str
        Level of detail of the vehicles' shapes.
    cell_m : float
        Side of an occupancy cell [m].
    cell_growth : float
        How many times as large metrics' own cells are, where beams are thinned: see `metrics.metric.grown`.
    reading : str
        How Eq. 8 is read: see `metrics.vgop.occupancy`.
    scenery : StandingScenery or None
        What stands still and hides vehicles.
    bodies : OwnBodies or None
        Meshes of the user's in place of our vehicles' shapes.
    culled : bool
        Whether beams that can reach no vehicle are left out; it changes no result. `raster` always does without them.
    """

    lidars: tuple[Lidar, ...]
    caster: str
    detail: str
    cell_m: float
    reading: str = "corrected"
    scenery: StandingScenery | None = None
    bodies: OwnBodies | None = None
    culled: bool = True
    cell_growth: float = 1.0

    @property
    def lidar(self) -> Lidar:
        """The LiDAR of a layout of one."""
        (lidar,) = self.lidars
        return lidar

    @property
    def lattice(self) -> BeamLattice:
        """The beams of that one."""
        return self.lidar.lattice

    def with_lidar(self, **changes) -> Observation:
        """The same with another LiDAR in place of the one."""
        return replace(self, lidars=(replace(self.lidar, **changes),))

    def with_lattices(self, change: Callable[[BeamLattice], BeamLattice]) -> Observation:
        """The same with the beams of every LiDAR changed."""
        return replace(self, lidars=tuple(replace(one, lattice=change(one.lattice)) for one in self.lidars))

    def at(self, time_s: float) -> Observation:
        """The same at a moment [s], with those who walk along the roadsides where they are then."""
        scenery = None if self.scenery is None else self.scenery.at(time_s)
        return self if scenery is self.scenery else replace(self, scenery=scenery)


@dataclass(frozen=True, slots=True)
class Scoring:
    """What is made of what a mounting sees: the metric, and the settings of Eqs. 10 and 11.

    `loss` is None where a vehicle below the threshold adds what the metric gives it, as others do.
    """

    threshold: float
    view: str
    loss: float | None
    reading: str
    metric: str = PE_VGOP.name


def vehicle_weights(vehicles: Boxes, objective: ObjectiveSettings) -> np.ndarray | None:
    """How much each vehicle counts in the objective, (n,): its class's weight times that of the first zone that holds
    its box centre. None where the scene gives no weights.
    """
    if not objective.class_weights and not objective.zones:
        return None
    of_class = np.array([objective.class_weights.get(name, 1.0) for name in vehicles.class_name.tolist()])
    of_zones = np.array([*(zone.weight for zone in objective.zones), 1.0])
    return of_class * of_zones[first_zone(objective, vehicles.centre_m[:, :2])]


def of_scored_class(vehicles: Boxes, objective: ObjectiveSettings) -> np.ndarray:
    """Which vehicles are of a class that [objective] scores, (n,) bool."""
    return np.isin(vehicles.class_index, [CLASSES.index(name) for name in objective.scored_classes])


def first_zone(objective: ObjectiveSettings, xy: np.ndarray) -> np.ndarray:
    """Row of the first zone that holds each place (n, 2) [m], (n,) int; their number where none does."""
    holds = [polygon_holds(zone.polygon_m, xy) for zone in objective.zones]
    return np.argmax([*holds, np.ones(len(xy), dtype=bool)], axis=0)


def check_weights(
    objective: ObjectiveSettings, searched: Sequence[Boxes], held_out: Sequence[Boxes], where: str
) -> None:
    """Refuse a zone that weighs no counted vehicle of the searched frames, and weights that leave none a weight.

    Raises
    ------
    InputError
        Naming `where` the weights came from.
    """
    xy = np.concatenate([frame.centre_m[frame.counted, :2] for frame in searched])
    first = first_zone(objective, xy)
    for number, zone in enumerate(objective.zones, start=1):
        if (first == number - 1).any():
            continue
        if polygon_holds(zone.polygon_m, xy).any():
            raise InputError(
                f"{where} zones {number}: an earlier zone holds every vehicle of the searched frames that is in "
                f"{zone.name!r}, and the first that holds one counts; put the smaller zone first"
            )
        (left, right), (x, y) = xy.min(axis=0), xy.max(axis=0)
        raise InputError(
            f"{where} zones {number}: no vehicle of the searched frames is in {zone.name!r}; "
            f"those that count are at x {left:.1f} to {x:.1f} m, y {right:.1f} to {y:.1f} m"
        )
    if not any(frame.counted_weight.any() for frame in searched):
        classes = np.unique(np.concatenate([frame.class_name[frame.counted] for frame in searched]))
        raise InputError(
            f"{where} class_weights, zones: leave no vehicle of the searched frames a weight above 0; "
            f"their classes are {', '.join(classes.tolist())}"
        )
    if any(frame.counted.any() for frame in held_out) and not any(frame.counted_weight.any() for frame in held_out):
        raise InputError(
            f"{where} class_weights, zones: leave no vehicle of the held-out frames a weight above 0, so that there "
            "is no check of the answer; give more of them a weight, or more frames, or [traffic] holdout = 0"
        )
