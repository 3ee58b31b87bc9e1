"""The ladder of fidelities: every level of detail with every share of beams and frames, then what changes no result."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

from ..casting import CASTERS, RASTER, is_available
from ..study.fidelity import Fidelity
from ..study.site import Site
from ..study.site_fidelity import site_at
from ..study.variation import Variation
from ..world.shapes import DETAILS

BEST_DETAIL = DETAILS[-1]
STRIDES = (1, 2, 4, 8)
FRAME_SHARES = (1, 2, 4, 8)  # one of so many frames is looked at
ORACLE = "exact"
LADDER = "ladder"


@dataclass(frozen=True, slots=True)
class Rung:
    """One fidelity of the ladder.

    Attributes
    ----------
    fidelity : Fidelity
        Its phase is 0; `phased` has the others.
    twin : Fidelity or None
        Where casting differs in speed alone: the fidelity that must come to the same, and whose figures it then has.
    """

    fidelity: Fidelity
    twin: Fidelity | None = None


def ladder(site: Site) -> list[Rung]:
    """All rungs, the reference first."""
    counts = frame_counts(len(site.search))
    rungs = [
        Rung(Fidelity(detail, stride, frames=frames))
        for detail in reversed(DETAILS)
        for stride in strides(site)
        for frames in counts
    ]
    for caster in other_casters(site):
        rungs += [Rung(Fidelity(detail, caster=caster), Fidelity(detail)) for detail in reversed(DETAILS)]
    own = Fidelity(site.scenario.model.detail)
    rungs.append(Rung(replace(own, ground=True), own))
    return [*rungs, *(Rung(replace(own, caster=caster, culled=False), own) for caster in casters_that_cull(site))]


def casters_that_cull(site: Site) -> list[str | None]:
    """The scene's own, by None, or where it draws whole turns the first other one."""
    return [None] if site.observation.caster != RASTER else other_casters(site)[:1]


def other_casters(site: Site) -> list[str]:
    """The casters that are installed, but for the scene's own and the oracle."""
    return [name for name in CASTERS if name not in (ORACLE, site.observation.caster) and is_available(name)]


def missing_casters() -> list[str]:
    """The casters that are not installed."""
    return [name for name in CASTERS if not is_available(name)]


def strides(site: Site) -> tuple[int, ...]:
    """Those of `STRIDES` that leave a turn at least a few columns."""
    return tuple(stride for stride in STRIDES if site.observation.lattice.columns >= 4 * stride)


def frame_counts(frames: int) -> list[int | None]:
    """How many frames each share leaves, None for all of them; a count that another share has too is left out."""
    counts = [None if share == 1 else max(round(frames / share), 1) for share in FRAME_SHARES]
    return [count for row, count in enumerate(counts) if count not in counts[:row] and count != frames]


def phased(fidelity: Fidelity, most: int) -> list[Fidelity]:
    """The fidelity at all phases of its stride, or at so many of them, spread evenly."""
    kept = min(fidelity.stride, most)
    return [replace(fidelity, phase=fidelity.stride * number // kept) for number in range(kept)]


def on_all_frames(rungs: Sequence[Rung], most_phases: int) -> Iterator[Fidelity]:
    """What must be scored for the rungs without a twin: each detail, stride and phase once, on all frames."""
    whole = {replace(rung.fidelity, frames=None) for rung in rungs if rung.twin is None}
    for fidelity in sorted(whole, key=lambda one: (-DETAILS.index(one.detail), one.stride)):
        yield from phased(fidelity, most_phases)


def variation(fidelity: Fidelity) -> Variation:
    """A fidelity as a change of the site; the number of frames stays."""
    whole = replace(fidelity, frames=None)
    return Variation(LADDER, whole.name, f"phase {fidelity.phase}", partial(site_at, fidelity=whole))
