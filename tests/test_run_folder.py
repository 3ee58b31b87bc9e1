"""What a run leaves: every file of the contract, the same for the same seed, and nobody else's files touched."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blender_lidar import files
from blender_lidar.cli import main
from blender_lidar.errors import InputError, OutputError
from blender_lidar.files import write_text
from blender_lidar.run.folder import RunFolder
from blender_lidar.scene.deployment import MOUNTING_OR_LEAN
from tests.refusals import refused
from tests.report_samples import said
from tests.small_scene import (
    CASTER,
    MAPPED,
    done,
    traffic_rows,
    without_times,
    write_scene,
    write_table,
)

pytestmark = pytest.mark.usefixtures("quick")

VEHICLE_COLUMNS = [
    *("frame", "vehicle_id", "class", "x_m", "y_m", "z_m", "length_m", "width_m", "height_m", "heading_deg"),
    *("distance_m", "points", "p_top", "p_side", "p_front", "entropy_bits", "detectable"),
]
SCORES = {"objective_per_vehicle", "detectable_share"}
RESULT_KEYS = {
    *("sensor", "caster", "detail", "metric", "search", "reading", "seed", "frames", "vehicles", "deployment"),
    *("objective", "holdout", "baseline", "evaluations", "seconds", "versions"),
    *SCORES,
}
CHARTS = ("convergence", "score_map", "by_distance", "blind_zones", "clouds", "other_traffic")


@pytest.fixture(scope="module")
def mapped_run(tmp_path_factory):
    """A run over heights and tilts with everything that it leaves, and what it printed."""
    pytest.importorskip("matplotlib")
    folder = tmp_path_factory.mktemp("mapped")
    words = ["optimise", str(write_scene(folder, MAPPED)), "--detail", "box", "--out", str(folder / "run"), "--json"]
    run = subprocess.run([sys.executable, "-m", "blender_lidar", *words], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return folder / "run", run


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


def result_of(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text())


def optimise(capsys, scene: Path, out: Path, *words: object) -> dict:
    done(capsys, "optimise", scene, "--out", out, *words)
    return result_of(out)


# --- what is there ----------------------------------------------------------------------------------------------------


def test_the_folder_holds_what_was_promised_and_nothing_else(mapped_run):
    folder, _ = mapped_run
    tables = {"vehicles.csv", "vehicles_baseline.csv", "history.csv", "score_map.csv"}
    expected = {"result.json", "scene.toml", "installation.txt", "report.html", *(f"{name}.png" for name in CHARTS)}
    assert {path.name for path in folder.iterdir()} == expected | tables
    assert all(path.stat().st_size for path in folder.iterdir())


def test_the_result_has_every_key_of_the_contract(mapped_run):
    result = result_of(mapped_run[0])
    assert set(result) >= RESULT_KEYS
    assert set(result["deployment"]) == {*MOUNTING_OR_LEAN}
    assert SCORES | {"gain_over_baseline", "interval_90"} <= set(result["holdout"])
    base = result["baseline"]
    assert {"deployment", "objective", "holdout"} | SCORES <= set(base)
    assert set(base["holdout"]) == set(result["holdout"])
    assert {"blender_lidar", "python", "numpy"} <= set(result["versions"])
    assert (result["sensor"], result["caster"], result["detail"]) == ("RS-16", CASTER, "box")
    assert result["metric"] == "pe-vgop"
    assert (result["search"], result["reading"], result["seed"]) == ("hardened", "corrected", 1)
    assert (result["frames"], result["evaluations"]) == (6, 24)  # 12 of the search, 12 from the map's best point on


def test_the_results_numbers_agree_with_each_other_and_with_the_tables(mapped_run):
    folder, _ = mapped_run
    result = result_of(folder)
    for name, scores in (("vehicles.csv", result), ("vehicles_baseline.csv", result["baseline"])):
        table = [row for row in rows(folder / name) if row["split"] == "search"]
        assert len(table) == result["vehicles"]
        found = np.array([int(row["detectable"]) for row in table])
        bits = np.array([float(row["entropy_bits"]) for row in table])
        assert scores["detectable_share"] == pytest.approx(found.mean())
        assert scores["objective"] == pytest.approx(np.where(found, bits, -1.0).sum(), abs=1e-5)  # Eq. 10, C = -1
        assert scores["objective_per_vehicle"] == pytest.approx(scores["objective"] / len(table))
        held = [row for row in rows(folder / name) if row["split"] == "holdout"]
        assert scores["holdout"]["detectable_share"] == pytest.approx(np.mean([int(row["detectable"]) for row in held]))
    gain = result["holdout"]["objective_per_vehicle"] - result["baseline"]["holdout"]["objective_per_vehicle"]
    assert result["holdout"]["gain_over_baseline"] == pytest.approx(gain)
    low, high = result["holdout"]["interval_90"]
    assert low <= gain <= high


@pytest.mark.parametrize("name", ["vehicles.csv", "vehicles_baseline.csv"])
def test_vehicle_tables_begin_with_the_contracts_columns_in_order(mapped_run, name):
    folder, _ = mapped_run
    table = rows(folder / name)
    assert list(table[0])[: len(VEHICLE_COLUMNS)] == VEHICLE_COLUMNS
    mount = result_of(folder)["deployment"]
    for row in table:
        distance = np.hypot(float(row["x_m"]) - mount["x_m"], float(row["y_m"]) - mount["y_m"])
        assert float(row["distance_m"]) == pytest.approx(distance, abs=2e-3)
        assert float(row["z_m"]) == pytest.approx(float(row["height_m"]) / 2, abs=1e-3)


def test_the_history_names_every_evaluation_and_its_best_is_the_result(mapped_run):
    folder, _ = mapped_run
    table, result = rows(folder / "history.csv"), result_of(folder)
    assert list(table[0]) == ["evaluation", "iteration", "particle", "height_m", "tilt_x_deg", "objective", "best"]
    assert [int(row["evaluation"]) for row in table] == list(range(1, result["evaluations"] + 1))
    objective = np.array([float(row["objective"]) for row in table])
    assert [float(row["best"]) for row in table] == np.maximum.accumulate(objective).tolist()
    best = {key: float(value) for key, value in table[int(objective.argmax())].items()}
    assert best["objective"] == pytest.approx(result["objective"])
    assert all(best[key] == result["deployment"][key] for key in ("height_m", "tilt_x_deg"))


def test_json_on_stdout_is_the_result_file_to_the_byte_and_everything_else_is_on_stderr(mapped_run):
    folder, run = mapped_run
    assert run.stdout == (folder / "result.json").read_text()
    assert "Sensor     RS-16" in run.stderr
    assert f"{folder}: report.html" in run.stderr


def test_the_score_map_is_read_back_as_it_was_written(mapped_run):
    folder, _ = mapped_run
    score_map, result = RunFolder(folder).read_score_map(), result_of(folder)
    assert [*score_map.per_vehicle.shape] == result["map"]["points"]
    assert score_map.best == pytest.approx(tuple(result["map"]["best"].values()))
    intervals = score_map.optimum_intervals_90(result["seed"])
    assert {key: list(pair) for key, pair in intervals.items()} == result["map"]["optimum_interval_90"]


def test_the_regret_on_held_out_frames_is_the_gain_that_the_maps_best_mounting_has_there(mapped_run, capsys):
    folder, _ = mapped_run
    result = result_of(folder)
    best = result["map"]["best"]
    mount = ["--height", best["height_m"], "--tilt-x", best["tilt_x_deg"]]
    scene = folder.parent / "scene.toml"
    out, _ = done(
        capsys, "evaluate", scene, "--detail", "box", *mount, "--out", folder.parent / "best_of_map", "--json"
    )
    gain, found = (run["holdout"]["gain_over_baseline"] for run in (json.loads(out), result))
    assert gain > 0
    assert result["map"]["holdout_regret"] == pytest.approx(1.0 - found / gain, abs=1e-9)


@pytest.mark.parametrize(
    ("regret", "says"),
    [(0.25, "gains more: this mounting lacks 25.0 % of it"), (0.001, None)],
)
def test_a_regret_on_held_out_frames_is_told_when_it_is_not_small(mapped_run, regret, says):
    result = result_of(mapped_run[0])
    result["map"]["holdout_regret"] = regret
    message = said(result)
    assert says in message if says else "lacks" not in message


def test_a_run_that_has_ended_is_shown_again_by_resume_with_its_map(mapped_run, capsys):
    folder, first = mapped_run
    scene = folder.parent / "scene.toml"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    out, err = done(capsys, "optimise", scene, "--detail", "box", "--out", folder, "--resume")
    assert "search:" not in err  # nothing is searched again
    assert " ".join(out[out.index("RS-16 at ") :].split()) in " ".join(first.stderr.split())
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before  # shown from memory as from its files


def test_the_result_is_json_even_where_most_held_out_blocks_are_empty(tmp_path, capsys):
    def far(row):
        gone = row[9] > 80 and not 86 <= row[9] <= 90
        return [*row[:3], row[3] + 300.0 * gone, *row[4:]]

    write_table(tmp_path / "traffic.csv", [far(row) for row in traffic_rows()])
    optimise(capsys, write_scene(tmp_path), tmp_path / "run")

    result = json.loads((tmp_path / "run" / "result.json").read_text(), parse_constant=pytest.fail)
    assert result["holdout"]["vehicles"] > 0


# --- the same again ---------------------------------------------------------------------------------------------------


def test_the_same_seed_gives_the_same_result_and_another_seed_another(tmp_path, capsys):
    scene = write_scene(tmp_path)
    first, again = (optimise(capsys, scene, tmp_path / name) for name in ("a", "b"))
    assert without_times(first) == without_times(again)
    for name in ("vehicles.csv", "vehicles_baseline.csv", "history.csv", "installation.txt", "scene.toml"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()
    other = optimise(capsys, scene, tmp_path / "c", "--seed", 2)
    assert other["deployment"] != first["deployment"]


def test_the_scene_in_the_folder_spells_out_what_the_scene_left_out(tmp_path, capsys):
    optimise(capsys, write_scene(tmp_path), tmp_path / "run")
    text = (tmp_path / "run" / "scene.toml").read_text()
    written = tomllib.loads(text)
    assert text.startswith("# The scene as blender_lidar ")
    assert written["traffic"]["path"] == str((tmp_path / "traffic.csv").resolve())
    words = {"metric": "pe-vgop", "reading": "corrected", "view": "mean"}
    plain = {"cell_m": 0.05, "threshold": 0.005, "loss": -1.0, "class_weights": {}, "zones": []}
    assert written["objective"] == words | plain


def test_own_sensors_go_into_the_folders_scene_with_their_whole_path(tmp_path, capsys, monkeypatch):
    (tmp_path / "own.csv").write_text("ring,elevation_deg\n0,-15\n1,-5\n2,0\n")
    scene = write_scene(tmp_path, {"sensor": {"rotation_hz": None}})
    first = optimise(capsys, scene, tmp_path / "a", "--sensor", "own.csv")
    assert first["sensor"] == "own"
    monkeypatch.chdir("/")
    again = optimise(capsys, tmp_path / "a" / "scene.toml", tmp_path / "b")
    assert without_times(again) == without_times(first)


# --- whose folder -----------------------------------------------------------------------------------------------------


def test_without_out_runs_are_numbered_under_runs(tmp_path, capsys):
    scene = write_scene(tmp_path)
    for name in ("scene_rs-16", "scene_rs-16_2"):
        out, _ = done(capsys, "optimise", scene)
        assert f"{Path('runs') / name}: report.html" in out
        assert (tmp_path / "runs" / name / "result.json").exists()


@pytest.mark.parametrize("verb", ["optimise", "evaluate"])
def test_a_folder_that_holds_a_run_is_not_written_again(tmp_path, capsys, verb):
    scene = write_scene(tmp_path)
    optimise(capsys, scene, tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    line = refused(capsys, tmp_path, verb, scene, "--out", tmp_path / "run")
    assert "holds a run already; give another folder, or go on with it: optimise --resume" in line
    assert {path: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before


def test_a_folder_with_hidden_files_may_be_used_and_a_run_with_notes_in_it_resumed(tmp_path, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / ".DS_Store").write_text("the system's")
    scene = write_scene(tmp_path)
    optimise(capsys, scene, tmp_path / "run")
    (tmp_path / "run" / "notes.txt").write_text("mine")
    done(capsys, "optimise", scene, "--out", tmp_path / "run", "--resume")
    assert (tmp_path / "run" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize("name", ["vehicles.csv", "scene.toml", "report.html"])
def test_a_file_of_the_users_own_is_never_written_over(tmp_path, name):
    (tmp_path / name).write_text("mine")
    for resume in (False, True):
        with pytest.raises(InputError, match=f"holds a file {name} that no run has written"):
            RunFolder(tmp_path).check(resume=resume)


def test_two_runs_at_once_in_one_folder_are_refused(tmp_path, capsys):
    pytest.importorskip("fcntl")
    scene = write_scene(tmp_path)
    with RunFolder(tmp_path / "run").locked():
        line = refused(capsys, tmp_path, "optimise", scene, "--out", tmp_path / "run")
    assert line == f"blender-lidar: --out: {tmp_path / 'run'}: another run is at work there"
    assert not list((tmp_path / "run").iterdir())
    assert main(["optimise", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "run")]) == 0


def lock_as_windows(monkeypatch):
    """Let there be no `fcntl`, and a `msvcrt` that locks as that of Windows."""
    fcntl = pytest.importorskip("fcntl")
    msvcrt = SimpleNamespace(LK_NBLCK=2)
    msvcrt.locking = lambda stream, how, size: fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    monkeypatch.setitem(sys.modules, "fcntl", None)
    monkeypatch.setitem(sys.modules, "msvcrt", msvcrt)


@pytest.mark.parametrize("system", ["posix", "windows"])
def test_a_lock_whose_file_was_removed_between_opening_and_locking_it_is_none(tmp_path, monkeypatch, system):
    """A second run opened the file, the first ended and removed it, the second locked what no third would find."""
    if system == "windows":
        lock_as_windows(monkeypatch)
    first, take = RunFolder(tmp_path).locked(), files._take
    first.__enter__()

    def take_late(*given):
        monkeypatch.setattr(files, "_take", take)
        first.__exit__(None, None, None)
        take(*given)

    monkeypatch.setattr(files, "_take", take_late)
    with RunFolder(tmp_path).locked():
        assert (tmp_path / ".lock").exists()
        with pytest.raises(OutputError, match="another run is at work there"), RunFolder(tmp_path).locked():
            pass
    assert not list(tmp_path.iterdir())


def test_a_system_that_removes_no_open_file_leaves_no_lock_either(tmp_path, monkeypatch):
    lock_as_windows(monkeypatch)
    unlink, opened = Path.unlink, []

    def refuse(path, **how):
        if path.name == ".lock" and not opened[-1].closed:
            raise PermissionError("is open")
        unlink(path, **how)

    take = files._take
    monkeypatch.setattr(files, "_take", lambda stream, folder: (opened.append(stream), take(stream, folder)))
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(ValueError, match="early"), RunFolder(tmp_path / "run").locked():
        raise ValueError("early")
    assert not (tmp_path / "run").exists()


def _write_two(folder, *names):
    for name in names:
        write_text(folder.file(name), "here")


def test_a_lock_is_let_go_of_by_an_error_and_an_empty_new_folder_with_it(tmp_path):
    folder = RunFolder(tmp_path / "deep" / "run")
    with pytest.raises(ValueError, match="early"), folder.locked():
        raise ValueError("early")
    assert not (tmp_path / "deep").exists()
    with pytest.raises(OutputError, match="cannot be written"), folder.locked():
        _write_two(folder, "installation.txt", "none/installation.txt")
    assert [path.name for path in folder.path.iterdir()] == ["installation.txt"]
    with folder.locked():
        pass


def test_what_a_killed_run_had_not_finished_writing_is_swept_away_and_no_file_of_anybody_else(tmp_path):
    """Whatever was hidden and looked like `.*-????????.*` or `.*.png.*.part` went too."""
    ours = [".blender_lidar-123-abcd_123.json", ".blender_lidar-7-abcdefgh", ".blender_lidar-7-abcdefgh.png"]
    theirs = [".hidden.json", "mine-abcd1234.json", ".vehicles-12345678.csv", ".photo.png.123.part"]
    theirs += [".blender_lidar-mine"]
    for name in [*ours, *theirs, ".lock"]:
        (tmp_path / name).write_text("half")
    with RunFolder(tmp_path).locked():
        pass
    assert {path.name for path in tmp_path.iterdir()} == set(theirs)


def test_a_damaged_table_is_refused_by_name(tmp_path, capsys):
    scene = write_scene(tmp_path)
    optimise(capsys, scene, tmp_path / "run")
    for name in ("history.csv", "vehicles.csv"):
        whole = (tmp_path / "run" / name).read_bytes()
        for content in (b"", b"a,b\n1\n", b"\xff\xfe", *([b"x,y\n1,2\n"] if name == "vehicles.csv" else [])):
            (tmp_path / "run" / name).write_bytes(content)
            line = refused(capsys, tmp_path, "optimise", scene, "--out", tmp_path / "run", "--resume", begun=True)
            assert f"{name}: is damaged, or not of this version: " in line
        (tmp_path / "run" / name).write_bytes(whole)
