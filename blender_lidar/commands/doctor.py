"""blender-lidar doctor: what is installed, and does it work?"""

from __future__ import annotations

import argparse
import platform
import sys
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from .. import __version__
from ..casting import CASTERS, caster_class, is_available
from ..sensors.beams import beam_lattice
from ..sensors.model import load_model
from ..sensors.pose import Pose

_OPTIONAL = {
    "scipy": "",
    "bpy": "blender",
    "numba": "fast",
    "embreex": "fast",
    "matplotlib": "plots",
    "tqdm": "plots",
    "pyarrow": "parquet",
    "eclipse-sumo": "sumo",
    "pandas": "sumo",
    "distributed": "cluster",
}
_TOLERANCE_M = 1e-4


def run(args: argparse.Namespace) -> int:
    """Carry it out; 0 if a fast caster works, else 1."""
    print(f"blender_lidar {__version__}, Python {platform.python_version()} ({sys.platform}), NumPy {np.__version__}")
    for name, extra in _OPTIONAL.items():
        try:
            found = version(name)
        except PackageNotFoundError:
            package = f'"blender_lidar[{extra}]"' if extra else name
            found = f"not installed (pip install {package})"
        print(f"  {name:<13} {found}")
    verdicts = {name: _check(name) for name in CASTERS}
    for name, verdict in verdicts.items():
        print(f"caster {name:<7} {verdict}")
    works = any(verdicts[name].startswith("works") for name in CASTERS[:-1])
    advice = 'No fast caster works: pip install "blender_lidar[fast]" or "blender_lidar[blender]"'
    print("All is well." if works else advice)
    return 0 if works else 1


def _check(name: str) -> str:
    """Scan a wall 10 m ahead with the beams of an RS-16 that reach it, and compare with the plane's equation."""
    if not is_available(name):
        return "not installed"
    corners = np.array([[-50.0, 10.0, -50.0], [50.0, 10.0, -50.0], [50.0, 10.0, 50.0], [-50.0, 10.0, 50.0]])
    pose = Pose(height_m=2.0, tilt_x=0.1)
    rays = pose.to_world(beam_lattice(load_model("RS-16"), stride=8).directions.reshape(-1, 3))
    rays = rays[rays[:, 1] > 0.25]
    try:
        found = caster_class(name)(corners[[[0, 1, 2], [0, 2, 3]]]).cast(pose.position, rays).distance
    except Exception as error:  # the user needs to see what a broken library raises
        return f"fails: {type(error).__name__}: {error}"
    error = np.abs(found - 10.0 / rays[:, 1])
    wrong, worst = int((error > _TOLERANCE_M).sum()), error.max()
    if wrong:
        return f"fails: {wrong} of {len(rays)} rays differ, ranges by up to {worst:.2g} m"
    return f"works: {len(rays)} rays at a wall, ranges within {worst:.1g} m"
