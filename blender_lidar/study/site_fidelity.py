"""A site as a fidelity sees it: all of its frames."""

from __future__ import annotations

from dataclasses import replace

from ..casting.standing import StandingScenery
from ..world.ground import ground_plane
from ..world.scenery import Scenery, join
from .fidelity import Fidelity
from .rungs import coarse_observation
from .site import Site


def site_at(site: Site, fidelity: Fidelity) -> Site:
    """The site at a fidelity, from one whose observation has every beam; fewer beams are scored on larger cells.

    Its frames stay: what looks at fewer of them takes their columns of what all come to.

    Raises
    ------
    InputError
        For a stride beyond the columns of a turn.
    """
    seen = replace(site, observation=coarse_observation(site.observation, fidelity))
    if fidelity.ground:
        reach = site.reach_m + site.scenario.sensor.imperfections.most_noise_m
        seen = with_scenery(seen, ground_plane(site.region.centre_xy, reach))
    return seen


def with_scenery(site: Site, more: Scenery) -> Site:
    """The site with something more that stands still and hides vehicles."""
    observation = site.observation
    standing = () if observation.scenery is None else (observation.scenery.scenery,)
    scenery = StandingScenery(join([*standing, more]), observation.caster)
    return replace(site, observation=replace(observation, scenery=scenery))
