"""Resume by replay: what searches asked for, and the values that they were given, suffice to go on with them.

Searches are deterministic and none reads a clock. So a new search that is given the values on record comes to
where it was, as long as it asks for the same, which is checked to the last bit: other code is refused before, by the
run's identity, but the linear algebra of another processor may round otherwise.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from ..errors import InputError
from ..optimise import Search
from ..optimise.multi_fidelity import Asked, MultiFidelitySearch
from .folder import CHECKPOINT, RunFolder, refused_by_name

_STORE_EVERY_S = 2.0


class Listener(Protocol):
    """Called as a run goes on; every method may do nothing."""

    def searching(self, search: Search | MultiFidelitySearch) -> None:
        """After each batch of evaluations, and once before the first, of each search of the run in turn."""

    def mapping(self, points: int) -> None:
        """After `points` more of the score map's grid points."""


class Replay:
    """The record of a run's searches, one after the other: replayed, then gone on with, and stored as it grows.

    Parameters
    ----------
    folder : RunFolder or None
        Where it is stored; nowhere without one.
    identity : mapping
        What must be the same for a record to be gone on with.
    resume : bool
        Whether there may be one; else it begins empty.
    """

    def __init__(self, folder: RunFolder | None, identity: Mapping, *, resume: bool) -> None:
        self._folder, self._identity = folder, identity
        self._batches = folder.read_checkpoint(identity) if resume else []
        self._replayed = 0

    def carry_out(
        self,
        search: Search | MultiFidelitySearch,
        score: Callable[[np.ndarray | Asked], np.ndarray],
        listener: Listener,
    ) -> None:
        """Bring a search to its end: first by the record, then by what `score` makes of what it asks for.

        Raises
        ------
        InputError
            Where the record is damaged, or the search asks for something else than it holds.
        """
        while self._replayed < len(self._batches) and not search.done:
            self._replay(search, self._batches[self._replayed])
            self._replayed += 1
        listener.searching(search)
        stored_at = -np.inf
        while not search.done:
            asked, started = search.ask(), time.perf_counter()
            found = score(asked)
            seconds = time.perf_counter() - started
            _tell(search, found, seconds)
            self._batches.append({**_as_stored(asked), "values": found.tolist(), "seconds": seconds})
            if self._folder and (time.monotonic() - stored_at >= _STORE_EVERY_S or search.done):
                self._folder.write_checkpoint(self._identity, self._batches)
                stored_at = time.monotonic()
            listener.searching(search)
        self._replayed = len(self._batches)

    def _replay(self, search: Search | MultiFidelitySearch, batch: dict) -> None:
        number = self._replayed + 1
        with refused_by_name(self._folder.file(CHECKPOINT)):
            asked = _as_stored(search.ask())
            alike = asked == {key: batch[key] for key in asked}
            if alike:
                _tell(search, np.array(batch["values"], dtype=float), float(batch["seconds"]))
        if not alike:
            raise InputError(
                f"--resume: {self._folder.path}: the search asks for other mountings in batch {number} than the run "
                "there did, as on another kind of processor; go on there, or give another --out"
            )


def _as_stored(asked: np.ndarray | Asked) -> dict[str, object]:
    """What a search asks for, as JSON holds it."""
    if isinstance(asked, Asked):
        return {"fidelity": asked.fidelity.name, "frames": list(asked.frames), "x": asked.x.tolist()}
    return {"x": asked.tolist()}


def _tell(search: Search | MultiFidelitySearch, values: np.ndarray, seconds: float) -> None:
    if isinstance(search, MultiFidelitySearch):
        search.tell(values, seconds)
    else:
        search.tell(values)
