"""Bad input, verb by verb: one line on stderr that names the place, exit code 2, and nothing left behind."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.refusals import files, refused
from tests.scene_texts import MINIMAL
from tests.small_scene import cli, done, traffic_rows, write_scene, write_table

pytestmark = pytest.mark.usefixtures("quick")

RUN_VERBS = ("optimise", "evaluate")
SCENE_VERBS = (*RUN_VERBS, "scan")


def words_for(verb: str, scene: object, out: Path) -> list[object]:
    return [verb, scene, *(["--frame", 30, "--out", out / "cloud.npz"] if verb == "scan" else ["--out", out / "run"])]


@pytest.fixture(params=SCENE_VERBS)
def verb(request):
    return request.param


# --- the scene file ---------------------------------------------------------------------------------------------------

NO_SCENES = {
    b"": "[traffic] path: is missing",
    bytes(range(128, 256)): "is text in another encoding; allowed: UTF-8",
    '[traffic]\npath = "a.csv"\n'.encode("utf-16"): "is text in UTF-16; allowed: UTF-8",
    b"[traffic\n": "is not TOML",
}
BAD_LINES = {
    "fram = 3": "[traffic]: unknown key 'fram'; did you",
    "[rod]": "unknown table 'rod'; did you mean 'road'",
    "[road]\nsetback_m = nan": "[road] setback_m: is nan",
    '[road]\nlanes = "2"': "[road] lanes: is '2'",
    "[deployment]\nheight_m = [4, 2]": "[deployment] height_m: is [4, 2]",
    '[sensor]\nname = "RS-17"': "[sensor] name: unknown sensor 'RS-17'",
    '[model]\ncaster = "embre"': "[model] caster: unknown caster 'embre'; did you mean 'embree'",
    "[sensor]\nrange_gate_m = 1e4": "[sensor] range_gate_m: is 10000.0; allowed for RS-16",
}
BAD_SCENES = NO_SCENES | {f"{MINIMAL}{line}\n".encode(): message for line, message in BAD_LINES.items()}


@pytest.mark.parametrize(("content", "message"), BAD_SCENES.items(), ids=list(BAD_SCENES.values()))
def test_a_scene_file_that_cannot_be_used(tmp_path, capsys, content, message):
    write_scene(tmp_path).write_bytes(content)
    line = refused(capsys, tmp_path, *words_for("evaluate", tmp_path / "scene.toml", tmp_path))
    assert f"scene.toml: {message}" in line


def test_a_scene_that_is_not_there_or_is_a_folder(tmp_path, capsys, verb):
    assert "none.toml: there is no such file" in refused(capsys, tmp_path, *words_for(verb, "none.toml", tmp_path))
    assert "is a folder" in refused(capsys, tmp_path, *words_for(verb, tmp_path, tmp_path))


# --- the traffic ------------------------------------------------------------------------------------------------------


def test_a_cell_that_cannot_be_used_is_named_by_line_and_column(tmp_path, capsys):
    rows = traffic_rows()
    rows[3][3] = "twelve"
    write_table(tmp_path / "traffic.csv", rows)
    line = refused(capsys, tmp_path, *words_for("scan", write_scene(tmp_path), tmp_path))
    assert "traffic.csv:5: x_m is 'twelve'" in line  # the header is line 1


def test_a_traffic_file_that_is_not_there_or_is_a_folder(tmp_path, capsys, verb):
    words = words_for(verb, write_scene(tmp_path), tmp_path)
    assert "none.csv: there is no such file" in refused(capsys, tmp_path, *words, "--traffic", "none.csv")
    assert f"{tmp_path}: is a folder" in refused(capsys, tmp_path, *words, "--traffic", tmp_path)


@pytest.mark.parametrize("verb", RUN_VERBS)
def test_traffic_far_from_the_mount(tmp_path, capsys, verb):
    rows = [[*row[:3], row[3] + 5000.0, *row[4:]] for row in traffic_rows()]
    write_table(tmp_path / "traffic.csv", rows)
    line = refused(capsys, tmp_path, *words_for(verb, write_scene(tmp_path), tmp_path))
    assert "no vehicle in the region, within 20 m of x 0 m, y 0 m" in line
    assert "drive at x 4964 to 5036 m, y 4 to 7 m; check [traffic] origin_m and heading_deg, and [region]" in line


def test_a_pole_in_a_lane_or_in_a_vehicle(tmp_path, capsys, verb):
    on_the_road = write_scene(tmp_path, {"deployment": {"y_m": 4.0}})
    line = refused(capsys, tmp_path, *words_for(verb, on_the_road, tmp_path))
    assert (
        "the mount at x 0 m, y 4 m stands on the carriageway; allowed: off the lanes, such as x 0, y 2 m or x 0, y 9 m"
        in line
    )
    rows = [*traffic_rows(), *([frame, 999, "car", 0.0, 0.0, 4.0, 2.0, 1.5, 0.0, 2.0 * frame] for frame in range(60))]
    write_table(tmp_path / "traffic.csv", rows)
    line = refused(capsys, tmp_path, *words_for(verb, write_scene(tmp_path), tmp_path))
    assert "stands inside vehicle 999 of frame " in line


# --- options ----------------------------------------------------------------------------------------------------------

BAD_OPTIONS = {
    SCENE_VERBS: [
        ("--sensor RS-17", "--sensor: unknown sensor 'RS-17'; did you mean 'RS-16'?"),
        ("--caster optix", "argument --caster: invalid choice: 'optix'"),
        ("--colour red", "unrecognized arguments: --colour red"),
    ],
    RUN_VERBS: [
        ("--frames 0", "--frames: is 0; allowed: at least 1"),
        ("--frames many", "--frames: is 'many'; allowed: a whole number"),
        ("--frame-ids 999", "no frame 999"),
        ("--frame-ids 9,x", "--frame-ids: 'x'; allowed: frame numbers such as 100,150 or 100:160:5"),
        ("--frame-ids 9:1", "--frame-ids: '9:1'; allowed: a range"),
        ("--frame-ids 9 --frames 3", "--frame-ids: lists the frames that --frames spreads evenly"),
        ("--metric view-cover", "--metric: unknown metric 'view-cover'; did you mean 'view-coverage'?"),
        ("--workers -1", "--workers: is -1; allowed: 0 to 256"),
    ],
    ("optimise",): [
        ("--particles 2", "--particles: is 2; allowed: 3 to 10000"),
        ("--search bayes", "--search: unknown search 'bayes'; allowed: hardened, de-pso, grid, random, FILE.py:NAME"),
        ("--resume extra", "unrecognized arguments: extra"),
    ],
    ("evaluate", "scan"): [
        ("--height 0", "--height: is 0.0; allowed: 0.1 to 100"),
        ("--height nan", "--height: is nan; allowed: a number"),
        ("--height tall", "--height: is 'tall'; allowed: a number"),
        ("--tilt-x 91", "--tilt-x: is 91.0; allowed: -90 to 90"),
        ("--y 3", "--x, --y: the mount at x 0 m, y 3 m stands on the carriageway"),
    ],
}


@pytest.mark.parametrize(
    ("verb", "words", "message"),
    [(verb, *case) for verbs, cases in BAD_OPTIONS.items() for verb in verbs for case in cases],
    ids=lambda value: value[:40],
)
def test_options_and_mountings_that_cannot_be_used(tmp_path, capsys, verb, words, message):
    line = refused(capsys, tmp_path, *words_for(verb, write_scene(tmp_path), tmp_path), *words.split())
    assert message in line
    # Of what argparse finds, the verb's own help says what is allowed.
    if message.startswith(("argument ", "unrecognized ")):
        assert line.startswith(f"blender-lidar {verb}: ")
        assert line.endswith(f"(see blender-lidar {verb} --help)")


def test_a_scene_that_leaves_nothing_to_search(tmp_path, capsys):
    path = write_scene(tmp_path, {"deployment": {"height_m": 3.0}})
    line = refused(capsys, tmp_path, "optimise", path)
    assert "[deployment] fixes every coordinate; give at least one a pair [low, high], or use evaluate" in line


@pytest.mark.parametrize("words", ["", "optimize", "optimise", "scan", "optimise --x"])
def test_incomplete_commands(tmp_path, capsys, words):
    assert "--help" in refused(capsys, tmp_path, *words.split())


# --- scan -------------------------------------------------------------------------------------------------------------


def test_a_frame_that_the_recording_does_not_have(tmp_path, capsys):
    words = ["scan", write_scene(tmp_path), "--out", tmp_path / "cloud.npz", "--frame"]
    assert "--frame: " in refused(capsys, tmp_path, *words, 99)
    assert "--frame: is '1.5'; allowed: a whole number" in refused(capsys, tmp_path, *words, 1.5)


def test_a_cloud_of_an_unknown_format(tmp_path, capsys):
    line = refused(capsys, tmp_path, "scan", write_scene(tmp_path), "--frame", 30, "--out", tmp_path / "cloud.xyz")
    assert "--out: " in line
    assert "'.xyz'; allowed: .npz, .pcd" in line


# --- score ------------------------------------------------------------------------------------------------------------
# What is wrong with a cloud or a table itself is in test_clouds and test_traffic_table.


@pytest.fixture
def boxes(tmp_path):
    rows = [[0, 7, "car", 0.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0], [0, 8, "car", 9.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0]]
    return write_table(tmp_path / "boxes.csv", rows)


@pytest.fixture
def points(tmp_path):
    path = tmp_path / "points.npz"
    np.savez(path, xyz=np.array([[0.0, 4.0, 0.7], [9.0, 4.0, 0.7]]), vehicle_id=np.array([7, 8]))
    return path


@pytest.mark.parametrize("name", ["empty.pcd", "binary.npz", "cloud.las"])
def test_a_cloud_that_cannot_be_scored(tmp_path, capsys, boxes, name):
    (tmp_path / name).write_bytes(b"" if name == "empty.pcd" else b"LASF")
    line = refused(capsys, tmp_path, "score", "--points", tmp_path / name, "--boxes", boxes, "--assign", "box")
    assert name in line


def test_clouds_and_boxes_that_are_not_there_or_are_folders(tmp_path, capsys, boxes, points):
    def line(cloud, table):
        return refused(capsys, tmp_path, "score", "--points", cloud, "--boxes", table)

    assert "none.npz" in line("none.npz", boxes)
    assert f"{tmp_path}: is a folder" in line(tmp_path, boxes)
    assert "none.csv: there is no such file" in line(points, "none.csv")
    assert f"{tmp_path}: is a folder" in line(points, tmp_path)


def test_boxes_that_cannot_be_used(tmp_path, capsys, points):
    table = write_table(tmp_path / "boxes.csv", [[0, 7, "car", 0.0, 5.0, -4.0, 2.0, 1.5, 0.0, 0.0]])
    assert "boxes.csv:2: " in refused(capsys, tmp_path, "score", "--points", points, "--boxes", table)


def test_a_cloud_without_vehicle_ids_asks_for_assignment_by_box(tmp_path, capsys, boxes):
    np.savez(tmp_path / "bare.npz", xyz=np.zeros((2, 3)))
    line = refused(capsys, tmp_path, "score", "--points", tmp_path / "bare.npz", "--boxes", boxes)
    assert "does not say which vehicle a point belongs to; use --assign box" in line


def test_boxes_with_texts_for_ids_ask_for_assignment_by_box(tmp_path, capsys, points):
    rows = [[0, "veh_7", "car", 0.0, 5.0, 4.0, 2.0, 1.5, 0.0, 0.0]]
    words = ["score", "--points", points, "--boxes", write_table(tmp_path / "boxes.csv", rows)]
    assert "boxes.csv: vehicle_id are texts, and a cloud's are numbers" in refused(capsys, tmp_path, *words)
    assert cli(capsys, *words, "--assign", "box")[0] == 0


def test_boxes_of_several_frames_need_a_frame(tmp_path, capsys, points):
    table = write_table(tmp_path / "boxes.csv", traffic_rows())
    assert "name one with --frame" in refused(capsys, tmp_path, "score", "--points", points, "--boxes", table)
    line = refused(capsys, tmp_path, "score", "--points", points, "--boxes", table, "--frame", 99)
    assert "no frame 99" in line


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--cell", "0"], "--cell: is 0.0; allowed: at least 0.001"),
        (["--cell", "nan"], "--cell: is nan; allowed: a number"),
        (["--threshold", "-1"], "--threshold: is -1.0; allowed: at least 0"),
        (["--ground-clearance", "-0.1"], "--ground-clearance: is -0.1; allowed: at least 0"),
        (["--ground-clearance", "low"], "--ground-clearance: is 'low'; allowed: a number"),
        (["--assign", "near"], "argument --assign: invalid choice: 'near'"),
        (["--view", "back"], "argument --view: invalid choice: 'back'"),
    ],
    ids=lambda value: " ".join(value)[:24],
)
def test_options_of_score_that_cannot_be_used(tmp_path, capsys, boxes, points, words, expected):
    assert expected in refused(capsys, tmp_path, "score", "--points", points, "--boxes", boxes, *words)


@pytest.mark.parametrize("out", ["file/scores.csv", "folder"])
def test_scores_that_cannot_be_written(tmp_path, capsys, boxes, points, out):
    (tmp_path / "file").write_text("here")
    (tmp_path / "folder").mkdir()
    line = refused(capsys, tmp_path, "score", "--points", points, "--boxes", boxes, "--out", out)
    assert f"{out}: cannot be written: " in line


# --- where nothing can be written -------------------------------------------------------------------------------------


@pytest.mark.parametrize("out", ["file/run", "file"])
@pytest.mark.parametrize("verb", RUN_VERBS)
def test_a_run_folder_that_cannot_be_made(tmp_path, capsys, verb, out):
    (tmp_path / "file").write_text("here")
    line = refused(capsys, tmp_path, verb, write_scene(tmp_path), "--out", out)
    assert f"--out: {out}: the folder cannot be made: " in line


@pytest.mark.parametrize("verb", RUN_VERBS)
def test_a_run_folder_that_is_there_but_cannot_be_written(tmp_path, capsys, verb):
    (tmp_path / "run" / ".lock").mkdir(parents=True)
    line = refused(capsys, tmp_path, verb, write_scene(tmp_path), "--out", tmp_path / "run")
    assert f"--out: {tmp_path / 'run'}: cannot be written: " in line


@pytest.mark.parametrize("name", ["photos/site.jpg", "convergence.png", "study.json"])
@pytest.mark.parametrize(
    "words", ["optimise", "optimise --resume", "evaluate", "stability", "chart", "scan --frame-ids 20,30"]
)
def test_a_folder_that_holds_foreign_files_is_not_written_to(tmp_path, capsys, words, name):
    if name == "study.json" and words in ("stability", "chart"):
        return  # which one of ours would be
    if words == "chart":
        pytest.importorskip("scipy")
    scene, mine = write_scene(tmp_path), tmp_path / "thesis" / name
    mine.parent.mkdir(parents=True)
    mine.write_text("mine")
    verb, *more = words.split()
    line = refused(capsys, tmp_path, verb, scene, *more, "--out", tmp_path / "thesis")
    assert f" {name.partition('/')[0]} that no " in line
    assert line.endswith(" has written; give another folder")
    assert [path for path in (tmp_path / "thesis").rglob("*") if path.is_file()] == [mine]


def test_sweeps_of_kittis_own_are_not_scanned_over_but_clouds_of_an_earlier_scan_are(tmp_path, capsys):
    scan = ["scan", write_scene(tmp_path), "--frame-ids", "20,30", "--out", tmp_path / "clouds"]
    (tmp_path / "clouds").mkdir()
    (tmp_path / "clouds" / "000020.bin").write_text("mine")
    line = refused(capsys, tmp_path, *scan, "--format", "bin")
    assert "holds a file 000020.bin that no scan has written" in line
    (tmp_path / "clouds" / "000020.bin").unlink()
    for one in ("bin", "bin", "pcd", "sustechpoints", "sustechpoints"):
        done(capsys, *scan, "--format", one)


@pytest.mark.parametrize("out", ["file/cloud.npz", "none/cloud.pcd", "folder.npz"])
def test_a_cloud_that_cannot_be_written(tmp_path, capsys, out):
    (tmp_path / "file").write_text("here")
    (tmp_path / "folder.npz").mkdir()
    line = refused(capsys, tmp_path, "scan", write_scene(tmp_path), "--frame", 30, "--out", out)
    assert f"{out}: cannot be written: " in line


def test_a_folder_with_a_scene_of_the_users_own_is_not_written_to(tmp_path, capsys):
    path = write_scene(tmp_path)
    text = path.read_text()
    for words in (["optimise"], ["optimise", "--resume"], ["evaluate"]):
        line = refused(capsys, tmp_path, *words, path, "--out", tmp_path)
        assert "holds a file scene.toml that no run has written; give another folder" in line
    assert path.read_text() == text


@pytest.mark.skipif(sys.platform == "win32", reason="there are no limits on the size of files")
def test_a_disk_that_is_full_leaves_no_half_file(tmp_path):
    """A limit on the size of files stands in for the full disk."""
    path = write_scene(tmp_path)
    words = [[str(word) for word in words_for(verb, path, tmp_path)] for verb in SCENE_VERBS]
    program = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (700, 700)); sys.modules['matplotlib'] = None;"
        f"from blender_lidar.cli import main; print([main(verb) for verb in {words!r}])"
    )
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True)
    assert done.stdout.splitlines()[-1] == "[1, 1, 1]"
    assert [line.partition("cannot be written: ")[2] for line in done.stderr.splitlines()] == 3 * ["File too large"]
    assert files(tmp_path) == {path, tmp_path / "traffic.csv"}
