"""The best mounting of a scene, from within Blender; what follows -- are the arguments of `blender-lidar optimise`:

blender --background --factory-startup --python-exit-code 1 --python scripts/optimise.py -- SCENE.toml ...
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # Blender's own Python need not have the package installed

from blender_lidar.cli import main

if __name__ == "__main__":
    arguments = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    sys.exit(main(["optimise", *arguments]))
