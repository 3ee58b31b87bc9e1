"""The long parts of the study: each is stored in its folder as soon as it is known, and read from there afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict
from typing import Protocol

from ..casting import is_available
from ..study.landscape import Landscape
from ..study.landscapes import HELD_OUT, SEARCHED, Job, landscapes
from ..study.site import Site
from ..study.stages import StudyFolder
from ..study.variation import Variation
from .attacked import attack_finding
from .attacks import ATTACKS
from .caster_attacks import JUDGED, AttackCount, count_attack
from .effort import Effort
from .findings import UNDECIDED, Finding
from .landscape import best_candidate, chooses
from .mountings import BASELINE, CANDIDATES, REFERENCE, Mountings
from .seeds import answer_of_seed, evaluations_of
from .variations import CASTERS
from .varied import Draw


class Counter(Protocol):
    """Shows how far a part of the study has come."""

    def advance(self, steps: int) -> None:
        """Count `steps` more."""

    def close(self) -> None:
        """The part has ended."""


CounterMaker = Callable[[int, str], Counter]
"""Makes a counter up to a total, for what is counted."""


class StoredStages:
    """A study's folder, and how its progress is told.

    Parameters
    ----------
    folder : StudyFolder
        Locked by the caller.
    counter : callable
        Told of progress.
    """

    def __init__(self, folder: StudyFolder, counter: CounterMaker) -> None:
        self._folder, self._counter = folder, counter

    def stage(self, name: str, compute: Callable[[], object]) -> object:
        """What `compute` returns, or has returned before; see `StudyFolder.stage`."""
        return self._folder.stage(name, compute)

    def answers(self, site: Site, effort: Effort) -> list[dict]:
        """What the search finds with the scene's seed, and with the ones that follow it."""
        first = site.scenario.search.seed
        seeds = range(first, first + effort.seeds)
        names = {seed: f"seed_{seed}" for seed in seeds}
        missing = [seed for seed in seeds if not self._folder.holds(names[seed])]
        total = len(missing) * evaluations_of(site, effort.budget)
        if missing:
            with self.counting(total, f"{len(missing)} searches") as advance, site.evaluator(site.search) as evaluator:
                for seed in missing:
                    answer = answer_of_seed(site, evaluator, seed, effort.budget, advance)
                    self.stage(names[seed], lambda answer=answer: answer)
        return [self.stage(names[seed], _never) for seed in seeds]

    def landscapes(self, site: Site, jobs: Sequence[Job], what: str) -> list[Landscape | str]:
        """What the mountings of each job come to, stored as soon as it is known."""
        names = [f"{job.variation.stage}_{job.split.replace(' ', '_')}" for job in jobs]
        missing = [(name, job) for name, job in zip(names, jobs, strict=True) if not self._folder.holds(name)]
        if missing:
            frames = sum(len(site.search if job.split == SEARCHED else site.holdout) for _, job in missing)
            scored = [job for _, job in missing]
            with (
                self.counting(frames, what) as advance,
                closing(landscapes(site, scored, advance)) as found,  # a stop ends its processes
            ):
                for (name, _), landscape in zip(missing, found, strict=True):
                    stored = landscape if isinstance(landscape, str) else landscape.as_dict()
                    self.stage(name, lambda stored=stored: stored)
        every = (self.stage(name, _never) for name in names)
        return [stored if isinstance(stored, str) else Landscape.from_dict(stored) for stored in every]

    def draws(
        self, site: Site, variations: Sequence[Variation], mountings: Mountings, judging: str
    ) -> dict[tuple[str, str, str], list[Draw | str]]:
        """The best mounting of each variation, chosen on the searched frames and judged beside the one in question.

        By section, what and value, as several draws of one change share them.
        """
        searched = self.landscapes(site, [Job(one, mountings.poses) for one in variations], "the scene varied")
        known = [number for number, found in enumerate(searched) if not isinstance(found, str)]
        rows = {number: [REFERENCE, BASELINE, CANDIDATES + best_candidate(searched[number])] for number in known}
        if judging == HELD_OUT:
            jobs = [
                Job(variations[number], tuple(mountings.poses[row] for row in rows[number]), HELD_OUT)
                for number in known
            ]
            judged = dict(zip(known, self.landscapes(site, jobs, "variations judged"), strict=True))
        else:
            judged = {number: searched[number].select(rows[number]) for number in known}
        draws: dict[tuple[str, str, str], list[Draw | str]] = {}
        for number, (variation, found) in enumerate(zip(variations, searched, strict=True)):
            draw = judged.get(number, found)
            if not isinstance(draw, str):
                draw = Draw(best_candidate(found), chooses(found), draw)
            draws.setdefault((variation.section, variation.what, variation.value), []).append(draw)
        return draws

    def attacks(self, *, quick: bool) -> list[Finding]:
        """Every caster that is installed under every attack."""
        casters, found = attacked_casters(), []
        if not casters:
            return [Finding(CASTERS, "under attack", "", UNDECIDED, "none is installed but the oracle itself")]
        with self.counting(len(ATTACKS), "casters under attack") as advance:
            for name in ATTACKS:

                def count(name=name) -> list[dict]:
                    return [asdict(count_attack(caster, name, quick=quick)) for caster in casters]

                stored = self.stage("_".join(["attack", *name.split()]), count)
                found.append(attack_finding([AttackCount(**one) for one in stored]))
                advance(1)
        return found

    @contextmanager
    def counting(self, total: int, what: str) -> Iterator[Callable[[int], None]]:
        """A counter that is closed when the block ends."""
        shown = self._counter(total, what)
        try:
            yield shown.advance
        finally:
            shown.close()


def attacked_casters() -> list[str]:
    """The casters that are installed, but for the oracle itself."""
    return [caster for caster in JUDGED if is_available(caster)]


def _never() -> object:
    raise RuntimeError("this stage is stored before it is read")
