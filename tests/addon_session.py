"""What the add-on must do in a Blender: run by a Blender or by its Python, each check in a new file.

    python tests/addon_session.py FOLDER
    blender --background --factory-startup --python tests/addon_session.py -- FOLDER

Prints a line of JSON: by check what went wrong, "" where nothing did.
"""

from __future__ import annotations

import json
import shutil
import sys
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import blender_lidar
from tests import (
    addon_checks_anything,
    addon_checks_files,
    addon_checks_hanging,
    addon_checks_settings,
    addon_checks_timeline,
    addon_checks_vehicles,
)
from tests.addon_sample import FOLDER, new_file

_MODULES = (
    addon_checks_anything,
    addon_checks_hanging,
    addon_checks_files,
    addon_checks_settings,
    addon_checks_timeline,
    addon_checks_vehicles,
)
CHECKS = {name: check for module in _MODULES for name, check in vars(module).items()}


def main():
    sys.modules["matplotlib"] = None  # charts take longer than all else, also in a process that Optimise starts
    (FOLDER.parent / "no_charts").mkdir(parents=True, exist_ok=True)
    (FOLDER.parent / "no_charts" / "matplotlib.py").write_text("raise ImportError('not in this Python')\n")
    sys.path.insert(0, str(FOLDER.parent / "no_charts"))
    sentence = {}
    blender_lidar.register()
    wanted = sys.argv[-1] if sys.argv[-1].startswith("check_") else "check_"
    for name, check in [(name, check) for name, check in CHECKS.items() if name.startswith(wanted)]:
        shutil.rmtree(FOLDER, ignore_errors=True)
        FOLDER.mkdir(parents=True)
        try:
            check()
            sentence[name.removeprefix("check_")] = ""
        except Exception:
            sentence[name.removeprefix("check_")] = traceback.format_exc()
    new_file()
    blender_lidar.unregister()
    sys.stdout.write(json.dumps({"checks": sentence}) + "\n")


if __name__ == "__main__":
    main()
