"""Progress on stderr: a bar on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys


class Progress:
    """Counts up to `total`; `close` it at the end.

    On a terminal it is tqdm's bar where tqdm is installed; without a terminal, or without tqdm, it is one line each tenth of the
    way.
    """

    def __init__(self, total: int, what: str, done: int = 0) -> None:
        self._total, self._what, self._done = total, what, done
        self._bar = _terminal_bar(total, what, done)

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
            print(f"{self._what}: {self._done} of {self._total} {note}".rstrip(), file=sys.stderr, flush=True)


def _terminal_bar(total, what, done):
    if not sys.stderr.isatty():
        return None
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    return tqdm(total=total, initial=done, desc=what, unit="", file=sys.stderr, dynamic_ncols=True, leave=True)
