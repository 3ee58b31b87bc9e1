"""Sites and scorers with one thing changed, as ablations have them; all can be sent to another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..sensors.beams import beam_lattice
from ..study.scoring import CountedFrame
from ..study.site import Site, lattice_of
from ..study.site_fidelity import with_scenery
from ..study.variation import Scorer
from ..world.barriers import barrier
from ..world.triangles import vehicle_triangles
from .bare_shapes import bare_shape
from .ladder import BEST_DETAIL
from .motion import MovingScorer, recorded_velocity, velocity_at
from .plain_scorer import PlainScorer, SinglePrecisionScorer, check_perfect

FREE_FLOW_M_S = 30.0

# --- changed sites ----------------------------------------------------------------------------------------------------


def with_barrier(site: Site, given: tuple[str, float, tuple[float, float]]) -> Site:
    """The site with a barrier: its kind, its y and between which x [m]."""
    return with_scenery(site, barrier(*given))


def perfect(site: Site) -> Site:
    """The site as it is; one with an imperfect sensor is refused."""
    check_perfect(site.observation)
    return site


def with_best_detail(site: Site) -> Site:
    """The site with vehicles at the best level of detail; one with an imperfect sensor is refused."""
    return replace(site, observation=replace(perfect(site).observation, detail=BEST_DETAIL))


def with_sensor(site: Site, settings: Mapping[str, float | None]) -> Site:
    """The site with other keys of [sensor]."""
    sensor = replace(site.scenario.sensor, **settings)
    lattice = lattice_of(sensor)
    observation = replace(site.observation, lattice=lattice, imperfections=sensor.imperfections)
    return replace(site, model=lattice.model, observation=observation)


def without_offsets(site: Site) -> Site:
    """The site with a sensor all of whose rings look where their column does."""
    model = replace(site.model, azimuth_offset_rad=np.zeros(site.model.rings))
    lattice = beam_lattice(model, site.observation.lattice.rotation_hz)
    return replace(site, model=model, observation=replace(site.observation, lattice=lattice))


# --- other ways to see a frame ----------------------------------------------------------------------------------------


def bare(site: Site, frame: CountedFrame) -> Scorer:
    """Vehicles without wheels and mirrors."""
    triangles = vehicle_triangles(frame.vehicles, BEST_DETAIL, bare_shape)
    return PlainScorer(frame, site.observation, triangles)


def single(site: Site, frame: CountedFrame) -> Scorer:
    """Ranges and points in float32."""
    return SinglePrecisionScorer(frame, site.observation)


def moving(site: Site, frame: CountedFrame) -> Scorer:
    """Vehicles that move during a turn as they were recorded, and their boxes with them."""
    return MovingScorer(frame, site.observation, recorded_velocity(site.recording, frame.vehicles))


def moving_unknown(site: Site, frame: CountedFrame) -> Scorer:
    """The same; boxes stay where they are in the middle of the turn."""
    velocity = recorded_velocity(site.recording, frame.vehicles)
    return MovingScorer(frame, site.observation, velocity, boxes_move=False)


def moving_fast(site: Site, frame: CountedFrame) -> Scorer:
    """All vehicles at one speed, and their boxes with them."""
    return MovingScorer(frame, site.observation, velocity_at(frame.vehicles, FREE_FLOW_M_S))
