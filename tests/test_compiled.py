"""What Numba compiles is kept from one process to the next, and never outlives the source that it came from."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import blender_lidar
from blender_lidar.casting import is_available
from blender_lidar.compiled import numba_works

pytestmark = [
    pytest.mark.skipif(not numba_works(), reason="Numba, of the extra fast, is not installed"),
    pytest.mark.versions,
]

PAIR = "from typing import NamedTuple\n\n\nclass Pair(NamedTuple):\n    left: float\n    right: float\n"
ADDED = """
from .compiled import compiled
from .{module} import Pair


@compiled
def added(pair):
    return pair.left + pair.right
"""
PROGRAM = """
from package.added import Pair, added
print(added(Pair(1.0, 2.0)), sum(added.stats.cache_hits.values()))
"""


@pytest.fixture
def package(tmp_path):
    """A package of one compiled function, whose argument is defined in a module of its own; runs it anew."""
    folder = tmp_path / "package"
    folder.mkdir()
    (folder / "__init__.py").touch()
    for name in ("compiled.py", "files.py", "errors.py"):
        shutil.copy(Path(blender_lidar.__file__).with_name(name), folder)

    def run(warns: bool = False, cache: str | None = None, program: str = PROGRAM, **modules: str) -> str:
        for name, text in modules.items():
            (folder / f"{name}.py").write_text(text)
        environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        environment["PYTHONDONTWRITEBYTECODE"] = "1"  # two texts of one length in one second are one to Python
        environment |= {} if cache is None else {"NUMBA_CACHE_DIR": cache, "XDG_CACHE_HOME": cache}
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr.count("compiled code cannot be kept") == warns, done.stderr
        return done.stdout

    return run


def test_what_was_compiled_is_found_again_until_any_source_of_the_package_changes(package):
    assert package(shapes=PAIR, added=ADDED.format(module="shapes")) == "3.0 0\n"
    assert (package(), package(other="import numpy\n")) == ("3.0 1\n", "3.0 0\n")
    assert package() == "3.0 1\n"


def test_a_constant_of_a_module_that_compiles_nothing_is_no_longer_the_old_one(package):
    """Only files with the words "compiled import" were looked at: old code stayed, frozen with old numbers."""
    adds = ADDED.replace("pair.right", "pair.right + MORE").replace("import Pair", "import MORE, Pair")
    assert package(shapes=PAIR + "MORE = 1.0\n", added=adds.format(module="shapes")) == "4.0 0\n"
    assert package(shapes=PAIR + "MORE = 2.0\n") == "5.0 0\n"


def test_where_nothing_can_be_kept_one_line_says_so_and_everything_works(package, tmp_path):
    """Two functions, one warning; every process compiled anew without a word."""
    for name in ("no_folder", "package/__pycache__"):
        (tmp_path / name).touch()
    more = ADDED.format(module="shapes") + "\n\n@compiled\ndef other(pair):\n    return pair.left\n"
    assert package(warns=True, cache=str(tmp_path / "no_folder"), shapes=PAIR, added=more) == "3.0 0\n"


def test_two_processes_that_compile_at_once_never_get_the_code_of_other_types(package, tmp_path):
    """Numba named both files alike: the index of the one led to the code of the other, and to wrong numbers."""
    source = "from .compiled import compiled\n\n\n@compiled\ndef corner(values):\n    return values[0, 1]\n"
    program = "import numpy as np\nfrom package.corner import corner\nvalues = np.arange(4.0).reshape(2, 2)\n"
    rows, columns = f"{program}print(corner(values))", f"{program}print(corner(np.asfortranarray(values)))"
    assert package(program=rows, corner=source) == "1.0\n"
    (index,) = (tmp_path / "package" / "__pycache__").glob("corner.corner-*.nbi")
    first = index.read_bytes()
    index.unlink()  # the other process looked before the first one had written
    assert package(program=columns) == "1.0\n"
    index.write_bytes(first)
    assert package(program=rows) == "1.0\n"
    assert package(program=columns) == "1.0\n"


def test_a_full_disk_keeps_nothing_and_ends_no_run(package):
    pytest.importorskip("resource")
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))\n" + PROGRAM
    assert package(program=limited, shapes=PAIR, added=ADDED.format(module="shapes")) == "3.0 0\n"
    assert package() == "3.0 0\n"


def test_a_type_of_compiled_code_that_has_moved_to_another_module_ends_no_run(package, tmp_path):
    assert package(shapes=PAIR, added=ADDED.format(module="shapes")) == "3.0 0\n"
    (tmp_path / "package" / "shapes.py").unlink()
    assert package(forms=PAIR, added=ADDED.format(module="forms")) == "3.0 0\n"
    assert package() == "3.0 1\n"


KERNELS = """
import sys

sys.path[:0] = [{root!r}]
compilations = []


def compiled_for(casters):
    '''Names of the functions that are compiled, not found, while every kernel is used; one is compiled always.'''
    if "bvh" in casters:
        import bpy
    from numba import njit
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, started):
            compilations.append(started.data["dispatcher"].py_func.__name__)

        def on_end(self, ended):
            pass

    event.register("numba:compile", Listener())

    @njit
    def always():
        return 1

    always()
    import numpy as np

    from blender_lidar.casting.protocol import StandingScenery
    from blender_lidar.metrics.vgop import pe_vgop
    from blender_lidar.scene.observation import Observation
    from blender_lidar.scoring.frame_scorer import FrameScorer, singles
    from blender_lidar.sensors.beams import beam_lattice
    from blender_lidar.sensors.lidar import Lidar
    from blender_lidar.sensors.model import load_model
    from blender_lidar.sensors.pose import Pose
    from blender_lidar.world.scenery import barrier
    from tests.sample_traffic import dense_traffic

    vehicles, pose = dense_traffic(vehicles=8, length_m=30.0), Pose(height_m=4.1, tilt_x=0.3)
    lattice = beam_lattice(load_model("RS-16"), stride=20)
    for caster in casters:
        scenery = StandingScenery(barrier("concrete", 10.0, (-40.0, 40.0)), caster)
        seen = Observation((Lidar(lattice, 50.0, 0.4),), caster, "box", 0.05, scenery=scenery)
        scorer = FrameScorer(vehicles, seen)
        scorer.see(singles([pose]))
        scorer.see(singles([pose]), keep_returns=True)
        pe_vgop(*scorer.vehicle_points(pose), vehicles.size_m)
        scorer.shapes.tree.cast(pose.position, pose.to_world(lattice.directions.reshape(-1, 3)))
    return compilations


if __name__ == "__main__":
    from blender_lidar.scoring.workers import Workers

    print(compiled_for(sys.argv[1:]))
    workers = Workers(compiled_for, 2)
    print(workers.submit(sys.argv[1:]).result())
    workers.close()
"""


def test_no_kernel_is_compiled_again_by_a_second_process_a_worker_or_within_blender(tmp_path):
    """The index of `rasterise` named `Mesh`, of a module that imports it: it could not be read, and was removed."""
    script = tmp_path / "kernels.py"
    script.write_text(KERNELS.format(root=str(Path(__file__).parents[1])))
    run = [sys.executable, script, *(name for name in ("raster", "embree", "bvh") if is_available(name))]
    for _ in range(2):  # the first leaves what has not been kept before
        done = subprocess.run(run, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    said = [line for line in done.stdout.splitlines() if line.startswith("[")]  # Blender 5.1 adds lines of its own
    assert said == ["['always']"] * 2
