"""A study's folder: stages are stored whole, a stopped study goes on, and nothing foreign is written over."""

from __future__ import annotations

import json
from contextlib import contextmanager

import pytest

from blender_lidar.errors import InputError, OutputError
from blender_lidar.files import folder_lock
from blender_lidar.scene.provenance import run_identity
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.studies import driver as stages
from blender_lidar.studies.driver import IDENTITY, STAGES, StudyFolder
from tests.small_scene import write_scene

SETTINGS = {"seed": 1, "file": "abc"}


def test_a_stage_is_computed_once_and_is_the_same_when_read_again(tmp_path):
    calls = []

    def compute():
        calls.append(1)
        return {"third": 1 / 3, "pair": (0.1, 2), "nothing": None}

    with StudyFolder(tmp_path / "run", SETTINGS).locked() as folder:
        fresh = folder.stage("one", compute)
    with StudyFolder(tmp_path / "run", SETTINGS).locked(resume=True) as folder:
        again = folder.stage("one", compute)
    assert fresh == again == {"third": 1 / 3, "pair": [0.1, 2], "nothing": None}
    assert calls == [1]


def test_a_stage_that_fails_leaves_nothing_and_the_study_goes_on(tmp_path):
    def fail():
        raise RuntimeError("stopped")

    with StudyFolder(tmp_path / "run", SETTINGS).locked() as folder:
        folder.stage("one", lambda: 1)
        with pytest.raises(RuntimeError):
            folder.stage("two", fail)
    assert [path.name for path in (tmp_path / "run" / STAGES).iterdir()] == ["one.json"]
    with StudyFolder(tmp_path / "run", SETTINGS).locked(resume=True) as folder:
        assert folder.stage("two", lambda: 2) == 2


def test_a_folder_that_holds_a_study_is_left_alone_unless_it_goes_on(tmp_path):
    with StudyFolder(tmp_path / "run", SETTINGS).locked():
        pass
    with pytest.raises(InputError, match="holds a study already"):
        StudyFolder(tmp_path / "run", SETTINGS).check()
    StudyFolder(tmp_path / "run", SETTINGS).check(resume=True)
    with pytest.raises(InputError, match="had seed = 1, not 2"):
        StudyFolder(tmp_path / "run", SETTINGS | {"seed": 2}).check(resume=True)


def test_resuming_where_nothing_is_stored_starts_from_the_beginning(tmp_path):
    with StudyFolder(tmp_path / "run", SETTINGS).locked(resume=True) as folder:
        assert folder.stage("one", lambda: 1) == 1


@pytest.mark.parametrize("name", ["report.md", STAGES])
def test_files_that_no_study_has_written_are_not_written_over(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=f"holds a file {name} that no study has written"):
        StudyFolder(tmp_path, SETTINGS).check(resume=True)
    assert (tmp_path / name).read_text() == "mine"


def test_a_damaged_identity_is_refused_by_name(tmp_path):
    (tmp_path / IDENTITY).write_text("{")
    with pytest.raises(InputError, match=IDENTITY):
        StudyFolder(tmp_path, SETTINGS).check(resume=True)


def test_a_damaged_stage_is_refused_by_name(tmp_path):
    with StudyFolder(tmp_path, SETTINGS).locked() as folder:
        (tmp_path / STAGES / "one.json").write_text("{")
        with pytest.raises(InputError, match=r"one\.json: is damaged: .*; remove it"):
            folder.stage("one", lambda: 1)


def test_a_study_that_another_run_began_before_the_lock_was_had_is_not_written_into(tmp_path, monkeypatch):
    @contextmanager
    def late_lock(path):
        """The other run comes and goes after our check and before our lock."""
        monkeypatch.setattr(stages, "folder_lock", folder_lock)
        with StudyFolder(path, SETTINGS | {"seed": 2}).locked() as other:
            other.stage("one", lambda: "theirs")
        with folder_lock(path):
            yield

    monkeypatch.setattr(stages, "folder_lock", late_lock)
    with pytest.raises(InputError, match="had seed = 2, not 1"), StudyFolder(tmp_path, SETTINGS).locked(resume=True):
        pass
    assert json.loads((tmp_path / IDENTITY).read_text())["seed"] == 2


def test_a_study_made_by_other_code_is_not_gone_on_with(tmp_path, monkeypatch):
    """Identities knew the version alone, which does not change from one commit to the next."""
    scenario = load_scenario(write_scene(tmp_path))
    with StudyFolder(tmp_path / "study", run_identity(scenario, "exact")).locked():
        pass
    monkeypatch.setattr("blender_lidar.scene.provenance.source_digest", lambda: "0123456789ab")
    with pytest.raises(InputError, match=r"the study there was made by other code, .* not '.* \(0123456789ab\)'"):
        StudyFolder(tmp_path / "study", run_identity(scenario, "exact")).check(resume=True)


def test_what_a_killed_study_had_not_finished_writing_is_swept_away_and_no_file_of_anybody_else(tmp_path):
    """A study removed every hidden file that matches `.*-????????.*`."""
    kept, left = [".notes-12345678.txt", ".photo.png.1.part"], [f"{STAGES}/.blender_lidar-1-abcdefgh.json"]
    with StudyFolder(tmp_path, SETTINGS).locked():
        pass
    for name in [*kept, *left]:
        (tmp_path / name).write_text("{")
    with StudyFolder(tmp_path, SETTINGS).locked(resume=True):
        assert all((tmp_path / name).exists() for name in kept)
        assert not any((tmp_path / name).exists() for name in left)


def test_the_identity_is_stored_as_it_was_given(tmp_path):
    with StudyFolder(tmp_path, SETTINGS | {"grid": (2, 3)}).locked():
        pass
    assert json.loads((tmp_path / IDENTITY).read_text()) == SETTINGS | {"grid": [2, 3]}
    StudyFolder(tmp_path, SETTINGS | {"grid": (2, 3)}).check(resume=True)


def test_a_folder_whose_name_is_too_long_is_refused_in_one_line(tmp_path):
    with pytest.raises(OutputError, match="the folder cannot be made: File name too long"):
        StudyFolder(tmp_path / ("x" * 300), SETTINGS).check()
