"""Files as a full disk, a broken download or an editor leaves them, and the promise that every reader keeps of them.

`fuzz` changes a sample in a few places, always the same ones, and reads it: it comes to an object or to one line.
"""

from __future__ import annotations

import gzip
import random
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from blender_lidar.errors import BlenderLidarError

EXAMPLES = 20
TOKENS = (
    *(b"", b"0", b"-1", b"0.5", b"1e9", b"1e308", b"nan", b"inf", b"1_0", b"1,234", b"null", b"NULL", b"true"),
    *(b"4" * 30, b" ", b"\r\n", b"\t", b"\0", b'"', b"\\", b",", b";", b",,,", b"#", b"<", b"&", b"[", b"]", b"{"),
    *(b"=", b"car", b"x" * 300, "\u00e9".encode(), b"\xff", b"\xc3"),
)
_DELIMITERS = b' ,;\t\n"=<>/[]{}:'


def is_one_line(text: str) -> bool:
    """Whether a message is one line that a terminal shows as it is, and that a person can read."""
    return bool(text) and text.isprintable() and len(text) <= 2500


def fuzz(
    read: Callable[[Path], object],
    path: Path,
    samples: bytes | Sequence[bytes],
    check: Callable[[object], None] = lambda found: None,
    *,
    packed: bool = False,
) -> int:
    """Read a file whose samples are whole, then `EXAMPLES` that are not; `packed` ones also as gzip.

    Returns
    -------
    int
        How many were refused: a reader that takes all that it is given refuses none.
    """
    samples, refused = [samples] if isinstance(samples, bytes) else samples, []
    for sample in samples:
        path.write_bytes(sample)
        check(read(path))
    rng = random.Random(1)
    for number in range(EXAMPLES):
        content = samples[number % len(samples)]
        if packed and number % 4 == 1:
            content = gzip.compress(content, mtime=0)
        for _ in range(1 + number % 4):
            content = changed(content, rng)
        path.write_bytes(gzip.compress(content, mtime=0) if packed and number % 4 == 2 else content)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                warnings.filterwarnings("ignore", "[^\n]* points left out: [^\n]*", UserWarning)
                check(read(path))
        except BlenderLidarError as error:
            refused.append(str(error))
    assert [line for line in refused if not is_one_line(line)] == []
    return len(refused)


def changed(content: bytes, rng: random.Random) -> bytes:
    """The bytes with one change: cut short, a line or a field lost, repeated, shuffled or replaced."""
    at, token = rng.randrange(len(content) + 1), rng.choice(TOKENS)
    start, stop = _field(content, at)
    lines = content.split(b"\n")
    line = rng.randrange(len(lines))
    mark = max((b",", b";", b" ", b"\t"), key=lines[line].count)
    fields = lines[line].split(mark)
    rng.shuffle(fields)
    return rng.choice(
        [
            content[:at],
            content[:at] + content[at + rng.randrange(1, 40) :],
            content[:at] + token + content[at:],
            content[:start] + token + content[stop:],
            content[:start] + token + content[stop:],
            b"\n".join([*lines[:line], *[lines[line]] * rng.choice((0, 2, 20)), *lines[line + 1 :]]),
            b"\n".join([*lines[:line], mark.join(fields), *lines[line + 1 :]]),
        ]
    )


def _field(content: bytes, at: int) -> tuple[int, int]:
    """Where the field around a place starts and ends."""
    start = stop = at
    while start > 0 and content[start - 1] not in _DELIMITERS and at - start < 60:
        start -= 1
    while stop < len(content) and content[stop] not in _DELIMITERS and stop - at < 60:
        stop += 1
    return start, stop
