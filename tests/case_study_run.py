"""The case study on a handful of vehicles, which takes two seconds."""

from __future__ import annotations

import numpy as np
import pytest

from blender_lidar.case_study.identity import study_identity
from blender_lidar.case_study.output import FILES, write_results
from blender_lidar.case_study.reproduce import reproduce
from blender_lidar.case_study.sites import Effort, open_case
from blender_lidar.study.stages import StudyFolder
from tests.small_scene import MAPPED, without_charts, write_scene

TINY = Effort(frames=5, grid=(2, 3), wide_grid=(2, 2), iterations=1, sensitivity_frames=1, sensitivity_grid=(2, 2))


class Counter:
    """Counts nothing, or stops the study at a stage."""

    def __init__(self, stop_at=""):
        self.stop_at = stop_at

    def __call__(self, total, what):
        if self.stop_at == what:
            raise KeyboardInterrupt
        return self

    def advance(self, steps):
        pass

    def close(self):
        pass


def study(scene, out, counter=None, resume=False):
    case = open_case(str(scene), {}, TINY)
    with StudyFolder(out, study_identity(case), FILES).locked(resume=resume) as folder:
        result = reproduce(case, folder, counter or Counter())
        return result, write_results(case, folder, result)


def told(ends):
    """A mean with its interval, as the case study holds it; None for no interval."""
    return {"mean": None if ends is None else np.mean(ends), "interval_90": None if ends is None else list(ends)}


def result_of_a_study(folder):
    """The result of a study that nothing stopped, in a folder of its own, and the folder."""
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        return study(write_scene(folder, MAPPED), folder / "run")[0], folder / "run"
