"""What casters hit beside the float64 oracle: on a few frames, from a few mountings, at every level of detail."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ..casting import caster_class
from ..sensors.beams import beam_lattice
from ..sensors.pose import Pose
from ..study.scoring import CountedFrame
from ..study.site import Site
from ..world.shapes import DETAILS
from ..world.triangles import vehicle_triangles
from .ladder import ORACLE

_STRIDE = 4  # of the oracle's columns: it is slow


@dataclass(frozen=True, slots=True)
class HitCount:
    """Rays of one caster that differ from the oracle's.

    Attributes
    ----------
    caster, detail : str
    rays, hits : int
        Cast, and those that meet something as the oracle says.
    hit_or_miss : int
        Rays that only one of the two has meeting anything.
    vehicle : int
        Rays that meet different vehicles.
    largest_range_m : float
        Largest difference of ranges where both meet the same vehicle [m].
    """

    caster: str
    detail: str
    rays: int
    hits: int
    hit_or_miss: int
    vehicle: int
    largest_range_m: float


def count_hits(site: Site, frames: Sequence[CountedFrame], poses: Sequence[Pose], casters: Sequence[str]) -> list[dict]:
    """A `HitCount` for each caster and level of detail, as JSON holds it."""
    lattice = beam_lattice(site.model, site.observation.lattice.rotation_hz, stride=_STRIDE)
    reach = site.observation.max_range_m
    counts = []
    for detail in DETAILS:
        met = {name: [] for name in (ORACLE, *casters)}
        for frame in frames:
            triangles = vehicle_triangles(frame.vehicles, detail)
            trees = {name: caster_class(name)(triangles.corners, closed=True) for name in met}
            for pose in poses:
                rays = pose.to_world(lattice.directions.reshape(-1, 3))
                for name, tree in trees.items():
                    found = tree.cast(pose.position, rays, reach)
                    owner = np.where(found.triangle >= 0, triangles.owner[found.triangle], -1)
                    met[name].append((found.distance, owner))
        columns = {name: [np.concatenate(column) for column in zip(*of, strict=True)] for name, of in met.items()}
        counts += [asdict(_count(name, detail, columns[ORACLE], columns[name])) for name in casters]
    return counts


def _count(caster, detail, oracle, found) -> HitCount:
    (true_range, true_owner), (range_m, owner) = oracle, found
    hit, true_hit = np.isfinite(range_m), np.isfinite(true_range)
    both = hit & true_hit
    same = both & (owner == true_owner)
    return HitCount(
        caster=caster,
        detail=detail,
        rays=len(hit),
        hits=int(true_hit.sum()),
        hit_or_miss=int((hit != true_hit).sum()),
        vehicle=int((both & ~same).sum()),
        largest_range_m=float(np.abs(range_m[same] - true_range[same]).max(initial=0.0)),
    )
