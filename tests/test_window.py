"""The add-on in Blender's real window, used by real keys and mouse: live drag, undo, optimise, Escape, save, reopen."""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.session

ROOT = Path(__file__).resolve().parents[1]
MISSING = [name for name in ("blender", "xvfb-run", "xdotool") if shutil.which(name) is None]
SCREEN = ["xvfb-run", "-a", "-s", "-screen 0 1400x1000x24"]
BLENDER = ["blender", "--factory-startup", "--window-geometry", "0", "0", "1400", "1000", "--python"]


def colours(path):
    """How many different values the bytes of a PNG's rows take: its window is blank where there are few."""
    data, at, packed = path.read_bytes(), 8, b""
    while at < len(data):
        (size,) = struct.unpack(">I", data[at : at + 4])
        packed += data[at + 8 : at + 8 + size] if data[at + 4 : at + 8] == b"IDAT" else b""
        at += 12 + size
    return len(np.unique(np.frombuffer(zlib.decompress(packed), dtype=np.uint8)))


@pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}")
def test_a_lidar_is_dragged_undone_optimised_stopped_saved_and_opened_again_in_the_window(tmp_path):
    build = [sys.executable, ROOT / "scripts" / "build_extension.py", "--out", tmp_path / "dist"]
    subprocess.run(build, capture_output=True, check=True)
    (made,) = (tmp_path / "dist").iterdir()
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment |= {"PATH": "/usr/bin:/bin", "LIBGL_ALWAYS_SOFTWARE": "1"}
    environment |= {"BLENDER_USER_RESOURCES": str(tmp_path / "user")}
    (tmp_path / "user").mkdir()
    command = [*SCREEN, *BLENDER, ROOT / "tests" / "window_session.py", "--", made, tmp_path / "out"]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=400, check=False)
    printed = run.stdout + run.stderr
    assert run.returncode == 0, printed
    assert not re.search(r"Error|Traceback", printed), printed
    message = json.loads(next(line for line in run.stdout.splitlines() if line.startswith('{"points"')))
    assert message["points"] > 1000
    pictures = sorted((tmp_path / "out").glob("*.png"))
    assert len(pictures) == 7
    assert all(colours(path) > 100 for path in pictures), pictures
