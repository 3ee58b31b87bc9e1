"""The command line as a whole: verbs, exit codes, what goes to stdout and stderr, and that the verbs agree."""

from __future__ import annotations

import csv
import json
import re
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest

from blender_lidar import __version__, cli
from blender_lidar.commands import doctor
from blender_lidar.commands.progress import Progress
from blender_lidar.report.text import document_text
from blender_lidar.run.answer import run_document
from blender_lidar.run.folder import RunFolder
from blender_lidar.traffic.table import BOX_NEEDED, OPTIONAL
from tests.small_scene import cli as run
from tests.small_scene import done, write_scene, write_table

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

VERBS = ("optimise", "evaluate", "scan", "score", "sensors", "doctor")
MOUNT = ("--height", 3.3, "--tilt-x", 12.5, "--tilt-y", 2.0, "--yaw", 3.0, "--x", -1.5, "--y", 0.5)


def process(*words: object, **settings) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "blender_lidar", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False, **settings)


def piped(*words: object, reads: int) -> tuple[int, str]:
    """Exit code and stderr where a reader of stdout leaves after some bytes."""
    command = [sys.executable, "-m", "blender_lidar", *map(str, words)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as child:
        child.stdout.read(reads)
        child.stdout.close()
        error = child.stderr.read().decode()
        return child.wait(), error


# --- help and versions ------------------------------------------------------------------------------------------------


def test_help_of_init_names_the_columns_of_a_table(capsys):
    _, out, _ = run(capsys, "init", "--help")
    assert set(BOX_NEEDED + OPTIONAL) <= set(re.findall(r"\w+", out))


def test_help_names_every_verb(capsys):
    code, out, err = run(capsys, "--help")
    assert (code, err) == (0, "")
    assert all(f"\n    {verb} " in out for verb in VERBS)


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_has_help_that_explains_every_option(capsys, verb):
    code, out, err = run(capsys, verb, "--help")
    assert (code, err) == (0, "")
    lines = out.splitlines()
    for number, line in enumerate(lines):
        if line.startswith("  --"):
            explained = len(line.split("  ")) > 2 or lines[number + 1].startswith(" " * 20)
            assert explained, line
    headings = [line for line in lines if re.fullmatch(r"[^ ].*:", line)]
    assert len({*headings}) == len(headings)


def test_python_m_is_the_command_line():
    done = process("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"blender_lidar {__version__}\n", "")


def test_a_wrong_command_line_exits_2():
    done = process("optimize")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("blender-lidar")


def test_help_needs_no_library_that_is_heavy():
    program = "import sys; from blender_lidar.cli import main; main(['--help']); print(*sys.modules, sep='\\n')"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert not {"bpy", "matplotlib", "embreex", "numba", "tqdm", "pandas"} & {*done.stdout.split("\n")}


def test_doctor_finds_what_is_installed_and_scans_a_wall(capsys):
    code, out, err = run(capsys, "doctor")
    assert err == ""
    assert out.startswith(f"blender_lidar {__version__}, Python 3.")
    assert "caster exact   works: " in out
    works = any(f"caster {name:<7} works: " in out for name in ("raster", "bvh", "embree"))
    assert code == (0 if works else 1)
    assert ("All is well." in out) == works


def test_doctor_without_a_fast_caster_fails_and_says_what_to_install(capsys, monkeypatch):
    monkeypatch.setattr(doctor, "is_available", lambda name: name == "exact")
    code, out, _ = run(capsys, "doctor")
    assert code == 1
    assert out.splitlines()[-1].startswith('No fast caster works: pip install "blender_lidar[fast]"')


def test_what_needs_scipy_says_so_where_it_is_missing(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "scipy", None)
    code, _, err = run(capsys, "chart", "scene.toml")
    assert (code, err) == (2, "blender-lidar: chart needs scipy (pip install scipy)\n")


def test_doctor_shows_what_a_broken_caster_raises(capsys, monkeypatch):
    class Broken:
        def __init__(self, corners) -> None:
            raise OSError("libembree4.so is missing")

    monkeypatch.setattr(doctor, "caster_class", lambda name: Broken)
    code, out, _ = run(capsys, "doctor")
    assert code == 1
    assert "caster exact   fails: OSError: libembree4.so is missing" in out


# --- streams ----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(sys.platform == "win32", reason="pipes close differently there")
@pytest.mark.parametrize("words", [["sensors"], ["sensors", "RS-80", "--json"], ["optimise", "--help"]])
@pytest.mark.parametrize("reads", [0, 1])
def test_a_reader_that_leaves_early_is_no_error_to_talk_about(words, reads):
    code, error = piped(*words, reads=reads)
    assert error == ""
    assert code in (0, 1)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full")
def test_a_disk_that_is_full_is_one_line():
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "blender_lidar", "sensors"]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "blender-lidar: output cannot be written: No space left on device\n"


def test_stdout_holds_the_json_and_nothing_else_whatever_blender_prints(tmp_path):
    pytest.importorskip("bpy")
    done = process("evaluate", write_scene(tmp_path), "--caster", "bvh", "--out", "run", "--json")
    assert done.returncode == 0, done.stderr
    assert done.stdout == Path("run/result.json").read_text()
    assert "Error" not in done.stderr


def after(program: str, *words: str) -> subprocess.CompletedProcess:
    """The command line in a process that has begun with a program of its own."""
    program = f"import os, sys; {program}; from blender_lidar.cli import main; sys.exit(main())"
    return subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=False)


def test_what_a_library_prints_behind_our_back_goes_to_stderr():
    noise = "load = sensors.model_names; sensors.model_names = lambda: (os.write(1, b'noise'), load())[1]"
    done = after(f"from blender_lidar.commands import sensors; {noise}", "sensors", "--json")
    assert (done.returncode, done.stderr) == (0, "noise")
    assert json.loads(done.stdout)


@pytest.mark.parametrize("closed", ["stdout", "stderr"])
def test_a_stream_that_is_closed_is_no_reason_to_fail(closed):
    done = after(f"sys.{closed} = None", "sensors")
    assert (done.returncode, done.stderr) == (0, "")


def test_the_answer_comes_first_and_progress_goes_to_stderr(tmp_path, capsys):
    out, err = done(capsys, "optimise", write_scene(tmp_path), "--out", "run")
    described, title, message, before, meant, where = out.rstrip().split("\n\n")
    assert [line.split()[0] for line in described.splitlines()] == [
        "Sensor",
        "Traffic",
        "Region",
        "Searched",
        "Casting",
    ]
    result = json.loads(Path("run/result.json").read_text())
    assert " ".join(title.split()) == result["document"]["title"]
    labels = [line.split("  ")[1] for line in message.splitlines() if line[:2] == "  " and line[2] not in " !"]
    assert labels == ["Best found", "Detectable", "Gain", "Stands at"]  # it hangs already
    assert " ".join(message.split()).startswith("! Held-out traffic shows a gain in the objective, but not that more ")
    assert before.startswith(
        "Before you act\n  ! Every vehicle is detectable under either mounting, so the detectable "
    )
    assert "[objective] threshold is 0.005; try a higher one." in " ".join(before.split())
    assert meant.startswith("( ) 90 % interval. Detectable: occupancy ")
    assert where == (
        "run: report.html (tables, charts, meanings), installation.txt, result.json, vehicles.csv\n"
        "blender-lidar report run --all prints the tables"
    )
    assert len(out.splitlines()) - len(described.splitlines()) <= 30
    assert "search: 12 of 12 best " in err
    assert max(map(len, out.replace(str(tmp_path), "").splitlines())) <= 120


def test_a_finished_run_is_printed_again_and_all_of_it_has_every_statement_and_table(tmp_path, capsys):
    out, _ = done(capsys, "optimise", write_scene(tmp_path), "--out", "run")
    again, _ = done(capsys, "report", "run")
    assert out.endswith(again)
    every, _ = done(capsys, "report", "run", "--all")
    document, words = RunFolder("run").document, " ".join(every.split())
    for one in document.statements:
        assert " ".join(one.text.split()) in words
    for table in document.tables:
        assert table.title in every
    printed, _ = done(capsys, "report", "run", "--json")
    assert json.loads(printed) == json.loads(Path("run/result.json").read_text())


def test_notes_of_plan_and_traffic_are_told_once(tmp_path, capsys):
    done(capsys, "optimise", write_scene(tmp_path), "--out", "run")
    result = RunFolder("run").result
    result["notes"], result["traffic_report"]["notes"] = ["few frames", "guessed"], ["guessed"]
    lines = document_text(run_document(result), every=True).splitlines()
    assert [lines.count(f"    {note}") for note in ("Few frames.", "Guessed.")] == [1, 1]


def test_rows_that_were_not_used_are_told_without_being_asked(tmp_path, capsys):
    scene = write_scene(tmp_path)
    out, _ = done(capsys, "optimise", scene, "--out", "whole")
    assert "rows used" not in out
    with (tmp_path / "traffic.csv").open("a") as traffic:
        traffic.write((tmp_path / "traffic.csv").read_text().splitlines()[-1] + "\n")
    out, _ = done(capsys, "optimise", scene, "--out", "repeated")
    assert re.search(r"\n +[\d,]+ of [\d,]+ rows used\n +1 duplicate row dropped\n", out)


def test_a_printed_mounting_is_that_of_the_result_with_units(tmp_path, capsys):
    _, out, _ = run(capsys, "evaluate", write_scene(tmp_path), *MOUNT, "--out", "run")
    _, every, _ = run(capsys, "report", "run", "--all")
    lines = {cells[0]: cells[1:] for cells in (re.split(r"\s{2,}", line.strip()) for line in every.splitlines())}
    tilts = {"tilt across the road [°]": ["0.00", "12.50"], "tilt along the road [°]": ["0.00", "2.00"]}
    others = {"yaw [°]": ["0.00", "3.00"], "x along the road [m]": ["0.00", "-1.50"]}
    message = {"height [m]": ["2.00", "3.30"], **tilts, **others}
    assert message.items() <= lines.items()
    assert "Searched  " not in out.partition("\n\n")[0]  # nothing is searched


@pytest.mark.parametrize("height_m", [[2.0, 2.2], [2.0, 4.5], [4.0, 4.5]])
def test_an_optimum_on_a_bound_is_pointed_out_and_no_other(tmp_path, capsys, height_m):
    scene = write_scene(tmp_path, {"deployment": {"height_m": height_m}})
    _, out, _ = run(capsys, "optimise", scene, "--search", "grid", "--particles", 11, "--iterations", 1, "--out", "run")
    best = json.loads(Path("run/result.json").read_text())["deployment"]["height_m"]
    said = " ".join(out.split())
    assert ("height lies at the bound of [deployment]: " in said) == (best in height_m)
    assert (f": {best + 1.0:.2f} m with a tilt of " in said) == (best == height_m[1])


def test_a_search_that_finds_nothing_better_than_the_baseline_says_so(tmp_path, capsys):
    scene = write_scene(tmp_path, {"deployment": {"height_m": [50.0, 60.0]}})  # out of range of every vehicle
    _, out, _ = run(capsys, "optimise", scene, "--out", "run")
    assert "No mounting that was tried is better than the baseline." in out
    result = json.loads(Path("run/result.json").read_text())
    assert result["objective"] == -result["vehicles"]


def test_without_matplotlib_a_run_succeeds_and_one_line_says_how_to_get_charts(tmp_path, capsys):
    out, err = done(capsys, "optimise", write_scene(tmp_path), "--out", "run")
    assert [line for line in err.splitlines() if "matplotlib" in line] == [
        'blender-lidar: note: no charts: charts need matplotlib: pip install "blender_lidar[plots]"'
    ]
    assert out.splitlines()[-2].startswith("run: report.html (tables, charts, meanings), installation.txt, ")
    assert not list(Path("run").glob("*.png"))


def test_a_warning_is_one_line_and_python_is_left_as_it_was(capsys, monkeypatch, tmp_path):
    def warn(_):
        warnings.warn("two\nlines", stacklevel=2)
        return 0

    before = warnings.showwarning
    monkeypatch.setattr(doctor, "run", warn)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        assert run(capsys, "doctor") == (0, "", "blender-lidar: note: two lines\n")
    assert warnings.showwarning is before


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (KeyboardInterrupt(), 1, "stopped"),
        (MemoryError(), 1, "out of memory; try fewer --frames or --workers 1"),
        (OSError(36, "File name too long", "x.csv"), 2, "x.csv: File name too long"),
        (OSError(28, "No space left on device"), 1, "output cannot be written: No space left on device"),
        (ZeroDivisionError(), None, ""),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else "",
)
def test_what_may_happen_to_any_verb_is_one_line_but_a_mistake_of_ours_is_not_hidden(
    capsys, monkeypatch, error, code, line
):
    def fail(_):
        raise error

    monkeypatch.setattr(doctor, "run", fail)
    if code is None:
        with pytest.raises(ZeroDivisionError):
            cli.main(["doctor"])
    else:
        assert run(capsys, "doctor") == (code, "", f"blender-lidar: {line}\n")


def test_progress_without_a_terminal_is_a_line_each_tenth_of_the_way(capsys):
    progress = Progress(200, "search")
    for _ in range(200):
        progress.advance(1, "best 3 bits")
    progress.close()
    lines = capsys.readouterr().err.splitlines()
    assert lines == [f"search: {done} of 200 best 3 bits" for done in range(20, 201, 20)]


def test_progress_that_goes_on_says_from_where(capsys):
    Progress(200, "search", 60)
    assert capsys.readouterr().err == "search: 60 of 200 done before\n"


# --- the verbs agree --------------------------------------------------------------------------------------------------


def rows(path: str) -> list[dict[str, str]]:
    with Path(path).open(newline="") as stream:
        return list(csv.DictReader(stream))


def test_evaluate_without_a_mounting_is_as_the_scene_fixes_it_else_the_baseline(tmp_path, capsys):
    assert run(capsys, "evaluate", write_scene(tmp_path), "--out", "fixed")[0] == 0
    found = json.loads(Path("fixed/result.json").read_text())["deployment"]
    assert (found["height_m"], found["tilt_x_deg"]) == (2.0, pytest.approx(15.0))
    searched = write_scene(tmp_path, {"deployment": {"tilt_x_deg": [0.0, 25.0]}})
    assert run(capsys, "evaluate", searched, "--out", "run")[0] == 0
    result = json.loads(Path("run/result.json").read_text())
    assert result["deployment"] == result["baseline"]["deployment"]
    assert result["objective"] == result["baseline"]["objective"]
    assert result["holdout"]["gain_over_baseline"] == 0.0


@pytest.fixture
def scored(tmp_path, capsys):
    """A scene, one mounting's vehicles.csv by frame, with a truck and a car that hides."""
    scene = write_scene(tmp_path, {"traffic": {"frames": 3, "holdout": 0.0}})
    assert run(capsys, "evaluate", scene, *MOUNT, "--out", "run")[0] == 0
    table = {}
    for row in rows("run/vehicles.csv"):
        table.setdefault(int(row["frame"]), {})[int(row["vehicle_id"])] = row
    return scene, table


def test_score_by_box_is_near_what_evaluate_wrote(scored, capsys):
    scene, table = scored
    for frame, vehicles in table.items():
        run(capsys, "scan", scene, "--frame", frame, *MOUNT, "--out", "cloud.npz")
        words = ["--points", "cloud.npz", "--boxes", "run/vehicles.csv", "--frame", frame, "--assign", "box", "--json"]
        scores = {
            clearance: json.loads(run(capsys, "score", *words, "--ground-clearance", clearance)[1])["vehicles"]
            for clearance in (0.005, 0.1)
        }
        for bare, clear in zip(*scores.values(), strict=True):
            expected = vehicles[bare["vehicle_id"]]
            assert bare["points"] == pytest.approx(int(expected["points"]), rel=0.01, abs=2)
            for key in ("p_top", "p_side", "p_front"):
                assert bare[key] == pytest.approx(float(expected[key]), abs=0.005)
                assert clear[key] <= bare[key] + 1e-12  # what is near the ground is left out


def test_scores_as_json_csv_and_text_are_the_same(tmp_path, capsys):
    boxes = write_table(tmp_path / "boxes.csv", [[0, 7, "car", 0.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0]])
    np.savez("cloud.npz", xyz=np.array([[0.0, 4.0, 0.7], [0.5, 4.0, 0.7], [9.0, 9.0, 9.0]]))
    words = ["score", "--points", "cloud.npz", "--boxes", boxes, "--assign", "box", "--out", "scores.csv"]
    out, _ = done(capsys, *words, "--json")
    scores = json.loads(out)
    (row,) = rows("scores.csv")
    assert scores["points"] == 3
    (vehicle,) = scores["vehicles"]
    assert (vehicle["points"], vehicle["class"], vehicle["detectable"]) == (2, "car", False)
    for key in ("p_top", "p_side", "p_front", "entropy_bits"):
        assert float(row[key]) == pytest.approx(vehicle[key], abs=1e-6)
    _, text, _ = run(capsys, *words)
    assert text.splitlines()[1].split()[:3] == ["7", "car", "2"]
    assert text.splitlines()[-1].startswith("1 vehicle, 3 points: ")


def test_labels_that_fit_no_box_are_pointed_out(tmp_path, capsys):
    boxes = write_table(tmp_path / "boxes.csv", [[0, 7, "car", 0.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0]])
    np.savez("cloud.npz", xyz=np.zeros((2, 3)), vehicle_id=np.array([8, -1]))
    _, err = done(capsys, "score", "--points", "cloud.npz", "--boxes", boxes)
    assert err.startswith("blender-lidar: note: cloud.npz: none of its vehicles is among the boxes of frame 0 in ")
