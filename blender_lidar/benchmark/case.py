"""One frame under one mounting: the beams and triangles that everything is timed on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..casting.culling import cut_vehicles, ray_directions, reachable_beams
from ..scenario import Scenario, pose_at
from ..sensors.beams import BeamLattice
from ..sensors.imperfections import PERFECT, Imperfections
from ..sensors.pose import Pose
from ..study.frame_scorer import Observation
from ..study.site import Region, lattice_of, read_recording
from ..traffic import plan_frames
from ..traffic.vehicles import Vehicles
from ..world.triangles import vehicle_triangles

# The paper's Table II: height [m] and tilt [deg].
MOUNTINGS = {"RS-16": (4.1, 19.0), "RS-32": (4.2, 13.0), "RS-80": (4.4, 9.0)}


@dataclass(frozen=True, eq=False)
class FrameCase:
    """A frame, the mounting that sees it, and how.

    Attributes
    ----------
    vehicles : Vehicles
        All of the frame.
    counted : ndarray of bool, (n,)
        Those that are scored.
    lattice : BeamLattice
        The sensor's beams.
    pose : Pose
        The mounting.
    gate_m : float
        Returns from farther away are lost [m].
    detail : str
        Level of detail of the shapes.
    cell_m : float
        Side of an occupancy cell [m].
    imperfections : Imperfections
        Of the sensor.
    """

    vehicles: Vehicles
    counted: np.ndarray
    lattice: BeamLattice
    pose: Pose
    gate_m: float
    detail: str
    cell_m: float
    imperfections: Imperfections = PERFECT

    @cached_property
    def triangles(self):
        """Of all vehicles."""
        return vehicle_triangles(self.vehicles, self.detail)

    @cached_property
    def directions(self) -> np.ndarray:
        """Of all beams, (b, 3) in the road frame."""
        return np.ascontiguousarray(self.pose.to_world(self.lattice.directions.reshape(-1, 3)))

    @cached_property
    def pieces(self):
        """The counted vehicles, cut for culling."""
        return cut_vehicles(self.vehicles.select(self.counted), self.detail)

    @cached_property
    def survivors(self) -> np.ndarray:
        """Beams that can reach a counted vehicle, (k,) flat indices."""
        return self.cull()

    def cull(self) -> np.ndarray:
        """The same, found again."""
        return next(reachable_beams(self.lattice, self.pieces, [self.pose], self.gate_m))

    def turn_survivors(self) -> np.ndarray:
        """Directions of the survivors in the road frame, (3, k)."""
        return ray_directions(self.lattice, self.survivors, self.pose)

    def observation(self, caster: str) -> Observation:
        """How a caster's scorer is to see it."""
        return Observation(
            self.lattice, self.gate_m, 0.0, caster, self.detail, self.cell_m, imperfections=self.imperfections
        )


def cases_of(scenario: Scenario, frames: int) -> list[FrameCase]:
    """Searched frames of a scene, under the paper's mounting for its sensor."""
    recording, gate = read_recording(scenario), scenario.sensor.range_gate_m
    region = Region(scenario.deployment.nominal_xy, gate)
    height, tilt = MOUNTINGS[scenario.sensor.name]
    pose = pose_at({**scenario.baseline, "height_m": height, "tilt_x_deg": tilt})
    lattice = lattice_of(scenario.sensor)
    made = []
    for frame in plan_frames(recording, region.holds, count=frames).search.tolist():
        vehicles = recording.vehicles(frame)
        made.append(
            FrameCase(
                vehicles,
                region.holds(vehicles),
                lattice,
                pose,
                gate,
                scenario.model.detail,
                scenario.objective.cell_m,
                scenario.sensor.imperfections,
            )
        )
    return made


def summary_of(cases: Sequence[FrameCase]) -> dict[str, object]:
    """What is timed, as JSON holds it: least, median and most of the frames."""
    rows = {
        "vehicles": [len(case.vehicles) for case in cases],
        "vehicles_counted": [int(case.counted.sum()) for case in cases],
        "triangles": [len(case.triangles) for case in cases],
        "survivors": [len(case.survivors) for case in cases],
    }
    first = cases[0]
    return {
        "sensor": first.lattice.model.name,
        "beams": len(first.directions),
        "frames": [case.vehicles.frame for case in cases],
        "detail": first.detail,
        "range_gate_m": first.gate_m,
        **{
            name: [int(value) for value in np.quantile(row, (0.0, 0.5, 1.0), method="nearest")]
            for name, row in rows.items()
        },
    }
