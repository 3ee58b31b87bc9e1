"""Commands that must be refused, in one line and with nothing left behind."""

from __future__ import annotations

from pathlib import Path

from tests.small_scene import cli


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
