"""The page of a run whose folder is damaged: one line that names the file, and never half a page."""

from __future__ import annotations

import re
import shutil

import pytest

from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError, OutputError
from blender_lidar.report.page import write_report
from blender_lidar.run.folder import RunFolder
from tests.refusals import refused
from tests.report_samples import page_of
from tests.small_scene import without_charts, write_scene


@pytest.fixture
def folder(stored_runs, tmp_path) -> RunFolder:
    """A copy of the search, to be changed."""
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    return RunFolder(tmp_path / "run")


def one_line(error: BlenderLidarError) -> str:
    assert len(str(error).splitlines()) == 1
    return str(error)


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    for place in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(MissingFileError, match="is not the folder of a run") as caught:
            write_report(RunFolder(place))
        assert str(place) in one_line(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_run_that_was_stopped_is_refused_and_says_how_to_go_on(folder):
    folder.file("result.json").rename(folder.file("checkpoint.json"))
    with pytest.raises(MissingFileError, match="has not ended; go on with it: optimise --resume"):
        page_of(folder)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("vehicles.csv", r"(?m)^(\d+),\d+,", r"\1,x,"),
        ("vehicles.csv", "distance_m", "distance"),
        ("vehicles.csv", r"\d+\.\d+,1,2,search", "nan,1,2,search"),
        ("vehicles_baseline.csv", r"\n[^\n]*\n$", "\n"),
        ("vehicles_baseline.csv", "holdout", "search"),
        ("scene.toml", r"\[traffic\]", "[traffic"),
        ("scene.toml", "path = ", "way = "),
    ],
)
def test_a_damaged_file_is_refused_by_name(folder, name, old, new):
    text = folder.file(name).read_text()
    damaged = re.sub(old, new, text, count=1)
    assert damaged != text
    folder.file(name).write_text(damaged)
    with pytest.raises(InputError, match=re.escape(name)) as caught:
        page_of(folder)
    one_line(caught.value)


@pytest.mark.parametrize("name", ["vehicles.csv", "vehicles_baseline.csv", "scene.toml", "installation.txt"])
def test_a_file_that_is_missing_is_named(folder, name):
    folder.file(name).unlink()
    with pytest.raises(BlenderLidarError, match=re.escape(name)):
        page_of(folder)


def test_a_page_that_cannot_be_written_is_one_line(folder):
    folder.file("report.html").unlink()
    folder.file("report.html").mkdir()
    with pytest.raises(OutputError, match=r"report\.html: cannot be written") as caught:
        write_report(RunFolder(folder.path))
    one_line(caught.value)


def test_a_page_that_no_run_has_written_is_not_replaced(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "report.html").write_text("mine")
    line = refused(capsys, tmp_path, "evaluate", write_scene(tmp_path), "--out", tmp_path / "run")
    assert "holds a file report.html that no run has written" in line
    assert (tmp_path / "run" / "report.html").read_text() == "mine"
