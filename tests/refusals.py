"""Commands that must be refused, in one line and with nothing left behind; and tables with a bad cell."""

from __future__ import annotations

from pathlib import Path

from tests.small_scene import HEADER, cli, traffic_rows


def files(folder: Path) -> set[Path]:
    return set(folder.rglob("*"))


def refused(capsys, folder: Path, *words: object, begun: bool = False) -> str:
    """The one line that a command is refused with; checks that it is one, and that nothing was left.

    One that has `begun` may have said what it is about to do.
    """
    before = files(folder)
    code, out, err = cli(capsys, *words)
    assert code == 2, err
    assert begun or out == ""
    assert "Traceback" not in err
    lines = err.splitlines()
    assert len(lines) == 1, err
    assert lines[0].startswith("blender-lidar")
    assert files(folder) == before
    return lines[0]


def changed(column: str, value: object, row: int = 3) -> list[list[object]]:
    rows = traffic_rows()
    rows[row][HEADER.index(column)] = value
    return rows


BAD_CELLS = {
    "text in a number": ("x_m", "twelve"),
    "NaN": ("x_m", "nan"),
    "infinite": ("y_m", "inf"),
    "negative size": ("length_m", -4.0),
    "size of nothing": ("width_m", 0),
    "half a frame": ("frame", 2.5),
    "unknown class": ("class", "lorry"),
    "nothing": ("height_m", ""),
}
