"""Golden values: what fixed scenes, clouds, searches, studies and comparisons came to is what they come to still.

`python -m tests.test_golden --write [NAME ...]` computes them anew, all or those of the names, into golden.json. Do so
only where numbers are meant to change, and say why. What may differ is said in scripts/research/golden.py.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import runpy
import sys
import tempfile
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import cache, partial
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.casting import is_available
from blender_lidar.cli import main
from blender_lidar.optimise import de_pso, maximise
from blender_lidar.optimise.multi_fidelity import Asked
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.scoring.scores import VehicleScores
from rival_metrics import OPTIONS
from tests.small_scene import mounting, traffic_rows, write_scene, write_table
from tests.test_auto_search import made_search

pytestmark = pytest.mark.versions

ROOT = Path(__file__).parents[1]
GOLDEN = Path(__file__).with_name("golden.json")
KITTI = ROOT.parent / "shared" / "data" / "kitti"
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "research" / "golden.py"))
differences, content, IGNORED = (SCRIPT[name] for name in ("differences", "content", "IGNORED"))
CASTERS = ("raster", "embree", "bvh", "exact")
IMPERFECT = {
    "sensor": {"range_noise_m": 0.02, "dropout": 0.1, "glass_dropout": 0.5, "range_at_10_percent_m": 30.0},
    "world": {"barriers": [{"kind": "concrete", "y_m": 5.5, "x_m": [-8.0, 12.0]}]},
}
AS_PRINTED = {"objective": {"reading": "paper", "view": "max"}}
INSTALLER = {"tilt_deg": 1.0, "height_m": 0.05, "yaw_deg": 2.0}
METHODS = ("hardened", "de-pso", "grid", "random")


def scored(site, frame, poses):
    """Points (s, n), occupancies (s, n, 3) and what each vehicle adds to the objective (s, n), of s mountings."""
    scorer = FrameScorer(frame, site.observation)
    scores = VehicleScores(site.scoring, site.observation, site.search)
    of = scores.of(frame, scorer, singles(poses))
    return of.seen.points, of.seen.occupancy, of.objective


def without_numba(patch: pytest.MonkeyPatch) -> None:
    """Have frames scored by NumPy alone, as Blender does it where Numba is not installed."""
    patch.setattr("blender_lidar.scoring.frame_scorer.numba_works", lambda: False)


# --- scenes -----------------------------------------------------------------------------------------------------------


def busy_scene(folder: Path, caster: str, **changes) -> Path:
    """Two lanes of vehicles that are not quite parallel to the road, seen by an uneven sensor within 30 m.

    Their sizes are no multiples of a cell, lest which cell a surface lies in depends on how a processor rounds.
    """
    rows = traffic_rows(vehicles=80)
    for number, row in enumerate(rows):
        row[5:8] = [round(size * (1.0 + 0.03 * math.sin(row[1] + place)), 4) for place, size in enumerate(row[5:8])]
        row[8] = round(6.0 * math.sin(number), 4)
    write_table(folder / "traffic.csv", rows)
    tables = {
        "traffic": {"frames": 3},
        "sensor": {"name": "RS-LiDAR-32", "range_gate_m": 30.0, **changes.pop("sensor", {})},
        "model": {"caster": caster},
    }
    return write_scene(folder, {**tables, **changes})


def fixed_poses(number: int = 40):
    """Mountings all over the six coordinates; the first hang at usual places."""
    rng = np.random.default_rng(17)
    low, high = [-3.0, -1.0, 1.9, -5.0, -15.0, -60.0], [3.0, 1.0, 5.5, 40.0, 15.0, 60.0]
    places = rng.uniform(low, high, (number, 6))
    places[:4] = [[0, 0, height, tilt, 0, 0] for height, tilt in ((2.0, 0.0), (3.0, 10.0), (4.5, 23.0), (4.5, 0.0))]
    names = ("x_m", "y_m", "height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg")
    return [mounting(dict(zip(names, row, strict=True))).pose for row in places.tolist()]


def needs(*casters: str) -> None:
    for caster in casters:
        if not is_available(caster):
            pytest.skip(f"the caster {caster} is not installed")


def command(*words: object) -> str:
    """Run the command line in this process without charts; its stdout."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setitem(sys.modules, "matplotlib", None)
        code = main([str(word) for word in words])
    assert code == 0, err.getvalue()
    return out.getvalue()


# --- what is pinned ---------------------------------------------------------------------------------------------------


def hits(folder: Path, caster: str, frames: int = 3, mountings: int = 40, **changes) -> dict:
    """What mountings see of each counted vehicle of each frame; occupancies as [top, side, front] of each."""
    needs(caster)
    site = prepare(load_scenario(busy_scene(folder, caster, **changes)))
    poses, found = fixed_poses()[:mountings], []
    for frame in site.search[:frames]:
        points, occupancy, objective = scored(site, frame, poses)
        sums = {"occupancy": occupancy.reshape(len(poses), -1), "objective": objective.sum(axis=1)}
        columns = {"vehicle_id": frame.vehicle_id[frame.counted], "points": points, **sums}
        found.append({"frame": int(frame.frame), **{name: of.tolist() for name, of in columns.items()}})
    return {"frame_ids": [int(frame) for frame in site.plan.search], "frames": found}


def part_of(found: dict, frames: int, mountings: int) -> dict:
    """The first frames and mountings of what `hits` found."""
    kept = [
        {key: rows if key in ("frame", "vehicle_id") else rows[:mountings] for key, rows in frame.items()}
        for frame in found["frames"][:frames]
    ]
    return {"frame_ids": found["frame_ids"], "frames": kept}


def digest(array: np.ndarray) -> str:
    """The beginning of the SHA-256 of whole numbers or texts."""
    return hashlib.sha256(" ".join(map(str, array.ravel().tolist())).encode()).hexdigest()[:16]


def summary(numbers: np.ndarray) -> list[float]:
    """How many, their mean size and a weighted sum in which every place has its own weight."""
    numbers = np.asarray(numbers, dtype=float).ravel()
    finite = np.where(np.isfinite(numbers), numbers, 0.0)
    weight = 1.0 + np.arange(len(finite)) % 997
    return [len(numbers), int(np.isfinite(numbers).sum()), math.fsum(np.abs(finite)), math.fsum(weight * finite)]


def cloud(folder: Path, caster: str, **changes) -> dict:
    """One frame's cloud, ground included: a digest of each exact column, sums of the others and every 499th point."""
    needs(caster)
    scene, path = busy_scene(folder, caster, **changes), folder / "cloud.npz"
    mount = ("--height", 4.1, "--tilt-x", 19, "--tilt-y", 2, "--yaw", -10, "--x", 0.5)
    command("scan", scene, "--frame", 30, *mount, "--out", path)
    with np.load(path) as columns:
        found = {"header": json.loads(str(columns["header"]))}
        found["header"].pop("caster", None)
        for name in sorted(set(columns.files) - {"header"}):
            column = columns[name]
            exact = not np.issubdtype(column.dtype, np.floating)
            found[name] = digest(column) if exact else [*summary(column), *column[::499].ravel().tolist()]
    return found


def metrics_of_a_cloud(folder: Path) -> dict:
    """Every metric that a cloud allows, and the rivals, of each vehicle of a frame."""
    needs("raster")
    scene = busy_scene(folder, "raster", traffic={"frame_ids": [30], "frames": None, "holdout": 0.0})
    command("scan", scene, "--frame", 30, "--height", 4.1, "--tilt-x", 19, "--out", folder / "cloud.npz")
    command("evaluate", scene, "--height", 4.1, "--tilt-x", 19, "--out", folder / "run")
    words = ["--points", folder / "cloud.npz", "--boxes", folder / "run" / "vehicles.csv", "--metric", "all"]
    words += [word for name, option in OPTIONS.items() if name != "distance" for word in ("--metric", option)]
    found = {assign: json.loads(command("score", *words, "--assign", assign, "--json")) for assign in ("id", "box")}
    for result in found.values():
        for key in ("points", "boxes"):
            if isinstance(result.get(key), str):
                del result[key]
    return found


def search(folder: Path, method: str, fidelity: str = "full", frames: int = 9, installer: object = False) -> dict:
    """A whole run of 120 evaluations: result, baseline and vehicles; sums of its tables."""
    needs("raster")
    changes = {
        "traffic": {"frames": frames},
        "deployment": {"tilt_x_deg": [0.0, 25.0], "installer": installer},
        "search": {"method": method, "fidelity": fidelity, "particles": 8, "iterations": 15},
    }
    scene, out = busy_scene(folder, "raster", **changes), folder / "run"
    command("optimise", scene, "--out", out)
    found = {"result": content(out / "result.json")}
    for path in sorted(out.glob("*.csv")):
        rows = content(path)
        columns = {key: np.array([row[key] for row in rows]) for key in rows[0] if not _texts(rows, key)}
        if "heading_deg" in columns:  # written to 0.001: where a tie falls depends on the processor
            columns["heading_deg"] = np.round(columns["heading_deg"].astype(float), 1)
        found[path.name] = {key: summary(column) for key, column in columns.items()}
    return found


def _texts(rows: list[dict], key: str) -> bool:
    return any(isinstance(row[key], str) for row in rows)


def whole_numbers(x: np.ndarray) -> np.ndarray:
    """Two hills of whole numbers: no rounding of it depends on the machine."""
    steps = np.floor(np.asarray(x) * 64.0)
    hills = [np.abs(steps - top).sum(axis=-1) for top in (35.0, 150.0)]
    return np.maximum(400.0 - hills[0], 300.0 - 2.0 * hills[1])


def path(search, variables: int = 2) -> dict:
    """Every candidate of a search on whole numbers, batch by batch, and its answer."""
    asked = []

    def objective(x):
        asked.append(x.tolist())
        return whole_numbers(x)

    found = search(objective, np.full(variables, -1.0), np.full(variables, 3.0))
    assert found.evaluations == sum(map(len, asked)) <= 200
    return {"asked": asked, "best": [*found.x.tolist(), found.value]}


def path_by_name(method: str, variables: int = 2):
    return lambda folder: path(partial(maximise, seed=3, evaluations=200, search=method), variables)


def path_as_printed(folder: Path) -> dict:
    return path(partial(de_pso, seed=3, particles=10, iterations=12, reading="paper"))


def path_of_auto(folder: Path) -> dict:
    """The same of the search over two fidelities: what it asks for, and on which beams and frames."""
    search, asked = made_search(2), []
    while not search.done:
        batch = search.ask()
        coarse = isinstance(batch, Asked)
        x = batch.x if coarse else batch
        asked.append([batch.fidelity.name if coarse else "", list(batch.frames) if coarse else [], x.tolist()])
        search.tell(whole_numbers(x) * (2.0 if coarse else 3.0))
    return {"asked": asked, "best": [*search.best_x.tolist(), search.best_value]}


def study(folder: Path, verb: str) -> dict:
    """A quick study of a scene of four frames."""
    needs(*CASTERS)
    changes = {
        "traffic": {"frames": 4},
        "sensor": {"name": "RS-16"},
        "deployment": {"tilt_x_deg": [0.0, 25.0], "installer": False},
        "search": {"particles": 8, "iterations": 15},
    }
    rivals = [word for option in OPTIONS.values() for word in ("--rival", option)] if verb == "stability" else []
    command(verb, busy_scene(folder, "raster", **changes), "--quick", *rivals, "--out", folder / "study")
    return content(folder / "study" / f"{verb}.json")


MADE = {
    "hits": partial(hits, caster="raster"),
    "hits, imperfect": partial(hits, caster="raster", mountings=15, **IMPERFECT),
    "hits, as printed": partial(hits, caster="raster", mountings=5, **AS_PRINTED),
    "cloud": partial(cloud, caster="raster"),
    "cloud, imperfect": partial(cloud, caster="raster", **IMPERFECT),
    "metrics": metrics_of_a_cloud,
    **{f"search {method}": partial(search, method=method) for method in METHODS},
    "search auto": partial(search, method="hardened", fidelity="auto"),
    "search as hung": partial(search, method="hardened", frames=3, installer=INSTALLER),
    "path hardened": path_by_name("hardened"),
    "path hardened in 3": path_by_name("hardened", variables=3),
    "path de-pso": path_by_name("de-pso"),
    "path de-pso as printed": path_as_printed,
    "path grid": path_by_name("grid"),
    "path random": path_by_name("random"),
    "path auto": path_of_auto,
    "chart": partial(study, verb="chart"),
    "stability": partial(study, verb="stability"),
}


@cache
def golden() -> dict:
    return json.loads(GOLDEN.read_text(encoding="utf-8"))


def unlike(kept: object, found: object) -> list[str]:
    """The first lines of what differs by more than a share of 1e-9, after how many there are."""
    lines = differences(kept, json.loads(json.dumps(found)), within=1e-9)
    return [f"{len(lines)} differences:", *lines[:20]] if lines else []


@pytest.mark.parametrize("name", MADE)
def test_the_numbers_are_what_they_were(tmp_path, name):
    assert unlike(golden()[name], MADE[name](tmp_path)) == []


@pytest.mark.parametrize("caster", ["embree", "bvh"])
def test_every_caster_has_the_same_hits(tmp_path, caster):
    assert unlike(golden()["hits"], hits(tmp_path, caster)) == []


def test_the_oracle_has_the_same_hits(tmp_path):
    assert unlike(part_of(golden()["hits"], 1, 3), hits(tmp_path, "exact", 1, 3)) == []


@pytest.mark.parametrize("caster", ["raster", "embree", "bvh"])
def test_numpy_alone_has_the_same_hits(tmp_path, caster, monkeypatch):
    without_numba(monkeypatch)
    assert unlike(part_of(golden()["hits"], 3, 15), hits(tmp_path, caster, 3, 15)) == []


@pytest.mark.parametrize("caster", ["embree", "bvh"])
def test_every_caster_loses_the_same_returns(tmp_path, caster):
    assert unlike(part_of(golden()["hits, imperfect"], 3, 5), hits(tmp_path, caster, 3, 5, **IMPERFECT)) == []


@pytest.mark.parametrize("caster", ["embree", "bvh", "exact"])
def test_every_caster_has_the_same_cloud(tmp_path, caster):
    assert unlike(golden()["cloud"], cloud(tmp_path, caster)) == []


def compact(value: object) -> object:
    """What is compared of a result; numbers to eleven digits, finer than they are compared."""
    if isinstance(value, dict):
        return {key: compact(one) for key, one in value.items() if key not in IGNORED}
    if isinstance(value, list):
        return [compact(one) for one in value]
    return float(f"{value:.11g}") if isinstance(value, float) else value


def write(names: list[str]) -> None:
    """Compute the golden values of these names anew."""
    kept = golden() if GOLDEN.exists() else {}
    for name in names:
        with tempfile.TemporaryDirectory() as folder, suppress(pytest.skip.Exception):
            made = MADE[name](Path(folder))
            kept[name] = made if name.startswith("path") else compact(made)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(kept[name], separators=(',', ':'))}" for name in MADE)
    GOLDEN.write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", nargs="*", choices=MADE, required=True, metavar="NAME")
    write(parser.parse_args().write or list(MADE))
