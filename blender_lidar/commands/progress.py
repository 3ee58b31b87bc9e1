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


class Progress:
    """Counts up to `total`; `close` it at the end.

    On a terminal it is tqdm's bar where tqdm is installed; without a terminal, or without tqdm, it is one line each
    tenth of the way.
    """

    def __init__(self, total: int, what: str, done: int = 0) -> None:
        self._total, self._what, self._done = total, what, done
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
        elif 10 * self._done // self._total > 10 * before // self._total:
            self._print(note)

    def _print(self, note):
        print(f"{self._what}: {self._done} of {self._total} {note}".rstrip(), file=sys.stderr, flush=True)


class RunProgress:
    """Shows how a run comes along, first the search, or both where there is a tolerance, then the map.

    It is a `run.replay.Listener` and a context manager.

    Parameters
    ----------
    variables : sequence of str
        Names of the searched coordinates.
    metric : Metric
        What is maximised.
    """

    def __init__(self, variables: Sequence[str], metric: Metric = PE_VGOP) -> None:
        self._metric = metric
        self._names = [MOUNTING_OR_LEAN[key].option.removeprefix("--") for key in variables]
        self._searched: Search | MultiFidelitySearch | None = None
        self._evaluations, self._mapping = 0, False
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
            self._show(Progress(search.budget, search.label, search.evaluations))
            self._mapping = False
        self._searched, self._evaluations = search, search.evaluations

    def mapping(self, points: int) -> None:
        if not self._mapping:
            self._mapping = True
            self._show(Progress(POINTS[0] * POINTS[1], "map of heights and tilts"))
        self._shown.advance(points)

    def _show(self, progress: Progress) -> None:
        """Show another in place of the one before."""
        self.__exit__()
        self._shown = progress

    def _best(self, search):
        if isinstance(search, MultiFidelitySearch) and search.best_value == -math.inf:
            return search.stage
        names = search.variables or self._names  # which differ from place to place
        mount = ", ".join(f"{name} {value:.2f}" for name, value in zip(names, search.best_x, strict=True))
        return f"best {self._metric.total(search.best_value, -2)} at {mount}"


def _terminal_bar(total, what, done):
    if not sys.stderr.isatty():
        return None
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    return tqdm(total=total, initial=done, desc=what, bar_format=_BAR, file=sys.stderr, dynamic_ncols=True)
