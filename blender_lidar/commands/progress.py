"""Progress on stderr: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence

from ..metrics.catalogue import PE_VGOP
from ..metrics.metric import Metric
from ..optimise import Search
from ..optimise.multi_fidelity import MultiFidelitySearch
from ..run.verdict import POINTS
from ..scene.deployment import MOUNTING_OR_LEAN

_BAR = "{desc} {percentage:3.0f}% |{bar:8}| {remaining} left{postfix}"  # with the best so far it fits 80 columns
_ROOM = 34  # for a label and coordinates


class Progress:
    """Counts up to `total`; `close` it at the end.

    On a terminal it is tqdm's bar where tqdm is installed; without a terminal, or without tqdm, it is one line each
    tenth of the way, or as many `lines` as are asked for.
    """

    def __init__(self, total: int, what: str, done: int = 0, lines: int = 10) -> None:
        self._total, self._what, self._done, self._lines = total, what, done, lines
        self._bar = _terminal_bar(total, what, done)
        if done and self._bar is None:
            self._print("done before")

    def close(self) -> None:
        """Leave the terminal as it should be."""
        if self._bar is not None:
            self._bar.close()

    def advance(self, steps: int, note: str = "") -> None:
        """Count `steps` more and show `note` beside them."""
        before, self._done = self._done, self._done + steps
        if self._bar is not None:
            self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(steps)
        elif self._lines * self._done // self._total > self._lines * before // self._total:
            self._print(note)

    def _print(self, note):
        print(f"{self._what}: {self._done} of {self._total} {note}".rstrip(), file=sys.stderr, flush=True)


class RunProgress:
    """Shows how a run comes along, first the search, then the map, then the judging of the best of both.

    It is a `run.replay.Listener` and a context manager.

    Parameters
    ----------
    variables : sequence of str
        Names of the searched coordinates.
    metric : Metric
        What is maximised.
    lines : int
        Lines that each search takes where there is no terminal.
    """

    def __init__(self, variables: Sequence[str], metric: Metric = PE_VGOP, lines: int = 10) -> None:
        self._lines = lines
        self._metric = metric
        self._names = [MOUNTING_OR_LEAN[key].option.removeprefix("--") for key in variables]
        self._searched: Search | MultiFidelitySearch | None = None
        self._evaluations = self._mapped = 0
        self._shown: Progress | None = None

    def __enter__(self) -> RunProgress:
        return self

    def __exit__(self, *exception) -> None:
        if self._shown is not None:
            self._shown.close()

    def searching(self, search: Search | MultiFidelitySearch) -> None:
        if search is self._searched:
            self._shown.advance(search.evaluations - self._evaluations, self._best(search))
        else:
            self._show(Progress(search.budget, search.label, search.evaluations, self._lines))
        self._searched, self._evaluations = search, search.evaluations

    def mapping(self, points: int) -> None:
        if self._mapped % math.prod(POINTS) == 0:  # the map of the next LiDAR
            self._show(Progress(math.prod(POINTS), "map of heights and tilts"))
        self._mapped += points
        self._shown.advance(points)

    def _show(self, progress: Progress) -> None:
        """Show another in place of the one before."""
        self.__exit__()
        self._shown = progress

    def _best(self, search):
        if isinstance(search, MultiFidelitySearch) and search.best_value == -math.inf:
            return search.stage
        names = search.variables or self._names  # which differ from place to place
        units = any(name.endswith(("_m", "_deg")) for name in names)
        names = [name.removesuffix("_deg").removesuffix("_m") for name in names]
        mount = ", ".join(f"{name} {value:.2f}" for name, value in zip(names, search.best_x, strict=True))
        best = f"best {self._metric.total(search.best_value, -2)}"
        # Those of several LiDARs have units and names: together they may be longer than a line.
        return best if units and len(search.label) + len(mount) > _ROOM else f"{best} at {mount}"


def _terminal_bar(total, what, done):
    if not sys.stderr.isatty():
        return None
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    return tqdm(total=total, initial=done, desc=what, bar_format=_BAR, file=sys.stderr, dynamic_ncols=True)
