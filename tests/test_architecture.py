"""Who imports what: rooms in one direction, Blender where it belongs, numpy alone wherever it will do."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import textwrap
import tomllib
from functools import cache
from pathlib import Path

import pytest

import blender_lidar
import tests.research  # noqa: F401
from blender_lidar import names
from blender_lidar.casting import CASTERS, caster_class, is_available
from blender_lidar.clouds.files import WRITERS
from blender_lidar.detection.dataset_files import DATASET_WRITERS
from blender_lidar.metrics.catalogue import METRICS
from blender_lidar.optimise import DePso, GridSearch, Hardened, RandomSearch
from seeded_faults import FAULTS, not_there
from tests import traffic_samples
from tests.small_scene import write_scene
from tests.waiting import WAIT_S

pytestmark = pytest.mark.versions

PACKAGE = Path(blender_lidar.__file__).parent
ROOT = PACKAGE.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
VERBS = (
    "init",
    "optimise",
    "evaluate",
    "stability",
    "chart",
    "scan",
    "detect",
    "dataset",
    "build",
    "render",
    "score",
    "compare",
    "sensors",
    "doctor",
)

# Third-party libraries, and the files or folders that may import them.
LIBRARIES = {
    "numpy": ("",),
    "bpy": ("casting/bvh.py", "world/blender/", "addon/"),
    "bpy_extras": ("addon/",),
    "bl_operators": ("addon/",),
    "blf": ("addon/",),
    "mathutils": ("casting/bvh.py", "world/blender/", "addon/"),
    "gpu": ("addon/",),
    "gpu_extras": ("addon/",),
    "embreex": ("casting/embree.py",),
    "numba": ("compiled.py",),
    "laspy": ("clouds/files.py", "clouds/points.py"),
    "yaml": ("sensors/tables.py",),
    "plyfile": ("clouds/points.py",),
    "lzf": ("clouds/points.py",),
    "zstandard": ("world/blender/site.py",),
    "pyarrow": ("csv_header.py",),
    "sumolib": ("road/sumo_net.py",),
    "matplotlib": ("report/",),
    "tqdm": ("commands/progress.py",),
    "scipy": ("studies/", "road/pole_places.py", "traffic/layout.py", "traffic/motion.py", "traffic/site_layout.py"),
    "sklearn": ("detection/classical.py",),
    "distributed": ("scoring/cluster.py",),
    "pandas": ("results.py",),
}
# Rooms in the order in which the data walks, and those that each may import besides the floor.
FLOOR = {
    "errors",
    "names",
    "files",
    "compiled",
    "csv_header",
    "csv_tables",
    "signals",
    "statistics",
    "plugins",
    "rigid",
    "document",
    "toml_table",
}
ROOMS = {
    **{name: set() for name in FLOOR},
    "metrics": set(),
    "optimise": {"metrics"},
    "sensors": set(),
    "road": set(),
    "traffic": {"road"},
    "world": {"traffic", "sensors", "road"},
    "world/blender": {"traffic", "sensors", "road", "world"},
    "casting": {"sensors", "traffic", "world"},
    "scene": {"metrics", "optimise", "casting", "traffic", "sensors", "world", "road"},
}
_UPWARDS = ("scoring", "clouds", "run", "detection", "studies", "report", "commands")
for _here in _UPWARDS:
    ROOMS[_here] = set(ROOMS) - FLOOR
DOOR = {"commands", "cli", "api", "results", "addon", "__main__", "__init__"}


@cache
def imports(path):
    """What a file imports: (dotted name, whether it is of this package and named relatively), wherever it stands."""
    package = ["blender_lidar", *path.relative_to(PACKAGE).parts[:-1]]
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, False) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.append((node.module, False))
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] + (node.module or "").split(".") * bool(node.module)
            found += [(".".join([*base, alias.name]), True) for alias in node.names]
    return found


def test_names_that_only_type_checkers_import_are_there():
    for path in SOURCES:
        for block in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(block, ast.If) and getattr(block.test, "id", "") == "TYPE_CHECKING":
                for node in (node for node in block.body if isinstance(node, ast.ImportFrom) and node.level):
                    source = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
                    source = (
                        source.with_suffix(".py") if source.with_suffix(".py").is_file() else source / "__init__.py"
                    )
                    text = source.read_text(encoding="utf-8")
                    for name in (alias.name for alias in node.names):
                        assert re.search(rf"^(class |def |from .*\b)?{name}\b", text, re.MULTILINE), f"{path}: {name}"


def room(path):
    parts = path.relative_to(PACKAGE).parts
    return named_room(parts) if len(parts) > 1 else path.stem


def named_room(parts):
    """A folder of the package; the one that knows Blender is a room of its own within its neighbour."""
    return "/".join(parts[:2]) if "/".join(parts[:2]) in ROOMS else parts[0]


def rooms_imported(path):
    """The other rooms that a file takes something from."""
    names = {named_room(name.split(".")[1:]) for name, ours in imports(path) if ours}
    return {name for name in names if (PACKAGE / name).is_dir() or (PACKAGE / f"{name}.py").exists()} - {room(path)}


def named(path):
    return path.relative_to(PACKAGE).as_posix()


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_libraries_are_imported_only_where_they_belong(path):
    for name, ours in imports(path):
        top = name.partition(".")[0]
        if not ours and top not in sys.stdlib_module_names:
            assert top in LIBRARIES, f"{named(path)} imports {name}"
            assert named(path).startswith(LIBRARIES[top]), f"{named(path)} imports {name}"


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_inside_the_package_imports_are_relative(path):
    """As a Blender extension the package has another name."""
    assert not [name for name, ours in imports(path) if not ours and name.partition(".")[0] == "blender_lidar"]


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_a_room_imports_only_rooms_that_it_may(path):
    here = room(path)
    if here in DOOR:
        return
    taken = rooms_imported(path) - FLOOR - {"__init__"}
    assert taken <= ROOMS[here], f"{named(path)} imports {sorted(taken - ROOMS[here])}"


STRAIGHT_ROAD = {"carriageways_y", "lane_width_m", "right_edge_m", "setback_m"}
PROPOSES_A_STRAIGHT_ROAD = ("traffic/layout.py", "report/site_plan.py", "commands/init_scene.py")


def test_only_the_room_of_the_road_and_its_proposal_know_how_a_straight_road_lies():
    """All others ask the `RoadMap`, which other roads have too."""
    for path in SOURCES:
        if not named(path).startswith(("road/", *PROPOSES_A_STRAIGHT_ROAD)):
            nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            used = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
            assert not used & STRAIGHT_ROAD, f"{named(path)} uses {sorted(used & STRAIGHT_ROAD)}"


def test_every_room_is_known():
    assert {room(path) for path in SOURCES} <= {*ROOMS, *DOOR}


def test_rooms_do_not_import_each_other_in_a_circle():
    taken = {here: set() for here in map(room, SOURCES)}
    for path in SOURCES:
        taken[room(path)] |= rooms_imported(path)
    while free := [here for here, others in taken.items() if not others & taken.keys()]:
        for here in free:
            del taken[here]
    assert taken == {}


NUMPY_ALONE = """
    import importlib, pkgutil, sys
    from importlib.metadata import packages_distributions

    for name in packages_distributions():
        if name not in ("numpy", "blender_lidar"):
            sys.modules[name] = None  # as if it were not installed

    def import_all(room):
        for module in pkgutil.walk_packages(importlib.import_module(room).__path__, room + "."):
            if not module.name.endswith(".compiled_marks"):  # which NumPy's own do without
                importlib.import_module(module.name)
    """


def with_numpy_alone(body, *arguments):
    """Run a program in a Python that has numpy and the standard library; what it prints."""
    program = textwrap.dedent(NUMPY_ALONE) + textwrap.dedent(body)
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, arguments)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=WAIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_metric_and_the_search_need_numpy_alone():
    body = """
        import_all("blender_lidar.metrics")
        import_all("blender_lidar.optimise")
        rooms = {name.split(".")[1] for name in sys.modules if name.startswith("blender_lidar.")}
        assert rooms == {"metrics", "optimise", "compiled", "errors", "files", "names", "plugins"}, rooms
        from blender_lidar.optimise import maximise
        print(maximise(lambda x: -(x ** 2).sum(axis=1), [-1.0], [1.0], seed=1, evaluations=50).value > -0.01)
        """
    assert with_numpy_alone(body) == "True\n"


def test_every_room_but_those_of_the_extras_imports_with_numpy_alone():
    body = """
        rooms = "casting clouds commands metrics optimise report run scene scoring sensors traffic world"
        for room in (*rooms.split(), "studies"):
            package = importlib.import_module("blender_lidar." + room)
            for module in pkgutil.iter_modules(package.__path__, package.__name__ + "."):
                if module.ispkg:
                    continue
                missing = None
                try:
                    importlib.import_module(module.name)
                except ImportError as error:
                    missing = error.name
                if missing:
                    print(module.name.removeprefix("blender_lidar."), missing)
        import blender_lidar.cli
        """
    needing = dict(line.split() for line in with_numpy_alone(body).splitlines())
    assert needing.pop("casting.bvh") == "bpy"
    assert needing.pop("casting.embree").startswith("embreex")
    compiled = {name for name, missing in needing.items() if missing == "numba"}
    assert compiled == {
        "casting.kernels",
        "casting.raster",
        "casting.rasterise",
        "metrics.compiled_marks",
        "scoring.compiled_frames",
    }
    assert set(needing) == compiled


BORDER = ("road/settings.py", "road/straight.py", "scene/sugar.py")  # where short forms are said and resolved
SECOND_FORMS = (
    r"(scenario|scene|self)\.straight\b",
    r"\b(StraightRoad|MappedRoad|further_\w+|faces_road|lidar_name)\b",
    r"isinstance\([^)]*[Rr]oad",
    r"\"lean_deg\" in (self|place|deployment|fixed|bounds)",
    r"\bname (==|!=) \"\"",
)


@pytest.mark.parametrize("path", SOURCES, ids=named)
def test_below_the_border_nobody_asks_how_a_scene_was_said(path):
    if named(path) not in BORDER:
        text = path.read_text(encoding="utf-8")
        assert [form for form in SECOND_FORMS if re.search(form, text)] == []


def test_a_constant_and_a_class_have_one_meaning():
    defined = {}
    for path in SOURCES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            names = {target.id for target in targets if isinstance(target, ast.Name) and target.id.isupper()}
            for name in names | ({node.name} if isinstance(node, ast.ClassDef) else set()):
                defined.setdefault(name, set()).add(path.relative_to(PACKAGE).as_posix())
    assert {name: files for name, files in defined.items() if len(files) > 1 and not name.startswith("_")} == {}


def test_boxes_are_scanned_scored_and_optimised_with_numpy_alone(tmp_path):
    scene = write_scene(tmp_path, {"model": {"caster": "exact"}})
    body = """
        from pathlib import Path
        from blender_lidar.cli import main
        scene = Path(sys.argv[1])
        def run(*words):
            code = main([str(word) for word in words])
            assert code == 0, (words, code)
        run("sensors")
        run("scan", scene, "--frame", 20, "--out", scene.parent / "cloud.npz")
        run("score", "--points", scene.parent / "cloud.npz", "--boxes", scene.parent / "traffic.csv", "--frame", 20)
        run("optimise", scene, "--out", scene.parent / "run", "--workers", 1)
        assert main(["doctor"]) in (0, 1)  # without a fast caster it says so
        """
    with_numpy_alone(body, scene)
    assert (tmp_path / "run" / "result.json").exists()
    assert (tmp_path / "cloud.npz").exists()


def test_ngsim_is_read_with_numpy_alone(tmp_path):
    path = tmp_path / "recording.txt"
    path.write_text(traffic_samples.native(traffic_samples.columns(vehicles=3, frames=4)))
    body = """
        from blender_lidar.traffic import read_traffic
        print(len(read_traffic(sys.argv[1])))
        """
    assert with_numpy_alone(body, path) == "12\n"


def test_the_names_that_settings_allow_are_those_of_the_rooms():
    assert tuple(METRICS) == names.METRIC_NAMES
    assert all(metric.learn is None for metric in METRICS.values())  # they score any labelled cloud
    assert tuple(search.name for search in (Hardened, DePso, GridSearch, RandomSearch)) == names.SEARCHES
    assert tuple(WRITERS) == names.CLOUD_SUFFIXES
    assert tuple(DATASET_WRITERS) == names.DATASET_LAYOUTS
    assert all(caster_class(name).__name__ == f"{name.capitalize()}Caster" for name in CASTERS if is_available(name))


@pytest.mark.parametrize("verb", ["", *VERBS])
def test_help_needs_the_standard_library_alone(verb):
    program = """
        import sys
        from blender_lidar.cli import main
        assert main([*sys.argv[1:], "--help"]) == 0
        heavy = {"numpy", "scipy", "pandas", "matplotlib", "bpy", "numba", "distributed", "tqdm"} & sys.modules.keys()
        print(f"imported: {sorted(heavy)}")
        """
    command = [sys.executable, "-c", textwrap.dedent(program), *([verb] if verb else [])]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=WAIT_S, check=True)
    assert done.stdout.endswith("imported: []\n")


def test_every_seeded_fault_has_its_place_in_the_code_and_its_tests():
    faults = tomllib.loads(FAULTS.read_text(encoding="utf-8"))["fault"]
    assert len(faults) >= 56
    assert [text for fault in faults if (text := not_there(ROOT, fault))] == []
