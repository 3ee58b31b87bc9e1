"""Landscapes as stages of a study: each is stored in its folder as soon as it is known, and read from there after."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Protocol

from .landscape import Landscape
from .landscapes import SEARCHED, Job, landscapes
from .site import Site
from .stages import StudyFolder


class Counter(Protocol):
    """Shows how far a part of the study has come."""

    def advance(self, steps: int) -> None:
        """Count `steps` more."""

    def close(self) -> None:
        """The part has ended."""


CounterMaker = Callable[[int, str], Counter]
"""Makes a counter up to a total, for what is counted."""


class LandscapeStages:
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
        every = (self.stage(name, never) for name in names)
        return [stored if isinstance(stored, str) else Landscape.from_dict(stored) for stored in every]

    @contextmanager
    def counting(self, total: int, what: str) -> Iterator[Callable[[int], None]]:
        """A counter that is closed when the block ends."""
        shown = self._counter(total, what)
        try:
            yield shown.advance
        finally:
            shown.close()


def never() -> object:
    """For a stage that is known to be stored."""
    raise RuntimeError("this stage is stored before it is read")
