"""Files as an attacker, or a full disk, would hand them over, and the promise that every reader keeps about them.

`damaged` is a Hypothesis strategy of a sample's bytes changed in a few places; `kept_promise` reads such a file and
fails unless it comes to an object or to one line.
"""

from __future__ import annotations

import gzip
import os
import signal
import tracemalloc
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blender_lidar.errors import BlenderLidarError

EXAMPLES = int(os.environ.get("BLENDER_LIDAR_FUZZ", "20"))
"""Examples for each reader: few in the suite, always the same; ``BLENDER_LIDAR_FUZZ=20000`` looks for new failures."""
FUZZED = settings(
    max_examples=EXAMPLES,
    derandomize=EXAMPLES <= 100,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow, HealthCheck.data_too_large],
)
SECONDS = 20
"""Longer than any sample takes by far, also on a slow machine."""
TIMES_INPUT, BESIDES = 150, 24 * 2**20
"""What reading may take in memory: so many bytes for each of the file, and so many besides [bytes]."""

NUMBERS = (
    *("0", "-0", "-1", "0.5", "1e308", "-1e308", "1e-320", "nan", "NaN", "inf", "-inf", "1e999", "1e9", "1e15"),
    *("9007199254740993", "9223372036854775808", "18446744073709551616", "1" + "0" * 400, "4" * 5000),
    *("1_0", "\uff11\uff12", "\u0663", "0x10", "1,234", "1e", "+5", " 7 ", "1.0", "true", "null", "NULL", ".", "1d3"),
)
TEXTS = (
    *("", " ", "\0", "\r", "\n", "\r\n", "\t", "\x0b", "\x1b[31m", "\u2028", "\x85", "\ufeff", '"', '""', "'", "\\"),
    *(",", ";", ",,,,", "#", "<", ">", "&", "&amp;", "&#0;", "<!--", "]]>", "[", "]", "{", "}", "[[", "=", ".", ":"),
    *("car", "x" * 300, "x" * 70_000, "a." * 200 + "a", "[" * 3000, "{'a':" * 2000, "\\ud800", "\\u0000", "é", "🚗"),
)
_NOT_UTF_8 = (b"\xff", b"\xfe\xff", b"\xed\xa0\x80", b"\xc3")
_TOKENS = (*(text.encode("utf-8") for text in (*NUMBERS, *TEXTS)), *_NOT_UTF_8)
_DELIMITERS = b' ,;\t\n"=<>/[]{}:'

Change = tuple[str, float, float, int]


class Hung(BaseException):
    """A reader that did not come back; no reader can take it for a fault of the file's."""


@contextmanager
def watchdog(seconds: int = SECONDS) -> Iterator[None]:
    """End what hangs, where the system has alarms."""
    if not hasattr(signal, "SIGALRM"):
        yield
        return

    def bark(*_: object) -> None:
        raise Hung(f"not done after {seconds} s")

    before = signal.signal(signal.SIGALRM, bark)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def is_one_line(text: str) -> bool:
    """Whether a message is one line that a terminal shows as it is, and that a person can read."""
    return bool(text) and text.isprintable() and len(text) <= 2500


def kept_promise(
    read: Callable[[Path], object], path: Path, check: Callable[[object], None] | None = None
) -> str | None:
    """What a file is refused with; fails for anything but a sound object or one line, in time and within memory."""
    refusal = found = None
    tracemalloc.start()
    try:
        with warnings.catch_warnings(), watchdog():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", "[^\n]* points left out: [^\n]*", UserWarning)
            found = read(path)
    except BlenderLidarError as error:
        refusal = str(error)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    size = path.stat().st_size
    assert peak <= TIMES_INPUT * size + BESIDES, f"{peak:,} bytes for a file of {size:,}"
    if refusal is not None:
        assert is_one_line(refusal), repr(refusal)
    elif check is not None:
        check(found)
    return refusal


def fuzz(
    read: Callable[[Path], object],
    path: Path,
    samples: bytes | Sequence[bytes],
    check: Callable[[object], None] | None = None,
    *,
    packed: bool = False,
) -> int:
    """Read a file whose samples are whole, then `EXAMPLES` that are not; `packed` ones also as gzip.

    Returns
    -------
    int
        How many were refused: a reader that takes whatever it is given refuses none.
    """
    samples = [samples] if isinstance(samples, bytes) else samples
    refused = 0
    for sample in samples:
        path.write_bytes(sample)
        found = read(path)  # and with it every library that is imported when it is needed
        if check is not None:
            check(found)

    @FUZZED
    @given(st.sampled_from(samples).flatmap(lambda sample: damaged(sample, packed=packed)))
    def keeps_its_promise(content: bytes) -> None:
        nonlocal refused
        path.write_bytes(content)
        refused += kept_promise(read, path, check) is not None

    keeps_its_promise()
    return refused


_changes = st.lists(
    st.tuples(
        st.sampled_from(
            ("flip", "delete", "insert", "truncate", "repeat line", "drop line", "swap fields", "field", "field")
        ),
        st.floats(0.0, 1.0, exclude_max=True),
        st.floats(0.0, 1.0, exclude_max=True),
        st.integers(0, 2**16),
    ),
    min_size=1,
    max_size=6,
)


def damaged(sample: bytes, *, packed: bool = False) -> st.SearchStrategy[bytes]:
    """A file's bytes changed in one to six places; with `packed` some are gzip, changed before or after packing."""

    def made(changes: list[Change], how: int) -> bytes:
        content = sample
        if how == 2:
            content = gzip.compress(content, mtime=0)
        for change in changes:
            content = changed(content, change)
        return gzip.compress(content, mtime=0) if how == 1 else content

    return st.builds(made, _changes, st.sampled_from((0, 0, 0, 1, 2) if packed else (0,)))


def changed(content: bytes, change: Change) -> bytes:
    """The bytes with one change: of a kind, at a share of the length, with a second place and a number to choose by."""
    kind, first, second, number = change
    at = int(first * len(content))
    token = _TOKENS[number % len(_TOKENS)]
    if kind == "flip" and content:
        return content[:at] + bytes([content[at] ^ (1 << number % 8)]) + content[at + 1 :]
    if kind == "delete":
        return content[:at] + content[at + 1 + int(second * second * 200) :]
    if kind == "insert":
        return content[:at] + token + content[at:]
    if kind == "truncate":
        return content[:at]
    if kind == "field":
        start, stop = _field(content, at)
        return content[:start] + token + content[stop:]
    lines = content.split(b"\n")
    line = int(first * len(lines))
    if kind == "repeat line":
        lines[line : line + 1] = [lines[line]] * (2 + number % 40)
    elif kind == "drop line":
        del lines[line]
    elif kind == "swap fields":
        mark = max((b",", b";", b" ", b"\t"), key=lines[line].count)
        fields = lines[line].split(mark)
        one, other = number % len(fields), int(second * len(fields))
        fields[one], fields[other] = fields[other], fields[one]
        lines[line] = mark.join(fields)
    return b"\n".join(lines)


def _field(content: bytes, at: int) -> tuple[int, int]:
    """Where the field around a place starts and ends."""
    start = stop = at
    while start > 0 and content[start - 1] not in _DELIMITERS and at - start < 60:
        start -= 1
    while stop < len(content) and content[stop] not in _DELIMITERS and stop - at < 60:
        stop += 1
    return start, stop
