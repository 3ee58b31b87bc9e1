"""What Numba compiles is kept from one process to the next, and never outlives the source that it came from."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import blender_lidar
from blender_lidar.compiled import numba_works

pytestmark = pytest.mark.skipif(not numba_works(), reason="Numba, of the extra fast, is not installed")

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
