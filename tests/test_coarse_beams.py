"""scripts/coarse_beams.py: its figures are those of mountings scored anew, and bad input ends in a line."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from blender_lidar.scenario import load_scenario
from blender_lidar.speed_accuracy.candidates import FIRST, candidates
from blender_lidar.speed_accuracy.ladder import variation
from blender_lidar.speed_accuracy.ranking import weighted_tau
from blender_lidar.study.fidelity import Fidelity
from blender_lidar.study.landscapes import Job, landscapes
from blender_lidar.study.site import prepare
from tests.small_scene import MAPPED, write_scene

main = runpy.run_path(str(Path(__file__).parents[1] / "scripts" / "coarse_beams.py"))["main"]


def test_a_rank_correlation_is_that_of_the_mountings_scored_anew(tmp_path, capsys):
    scene = write_scene(tmp_path, MAPPED)
    assert main([str(scene), "--frames", "6", "--mountings", "12"]) == 0
    told = capsys.readouterr().out
    site = prepare(load_scenario(scene))
    poses = candidates(site.scenario, 12).poses
    values = [
        next(landscapes(site, [Job(variation(Fidelity("body", stride)), poses)])).objective[FIRST:].sum(axis=1)
        for stride in (1, 4)
    ]
    row = re.search(rf"body, every 4th column, {len(site.search)} frames +(\S+) +(\S+)", told)
    assert float(row[2]) == pytest.approx(weighted_tau(values[1], values[0]), abs=0.0051)
    assert row[1] != row[2]
    assert len(re.findall(r"^b\S+, .*-?\d\.\d\d$", told, re.MULTILINE)) == 4 + 3 + 4


def test_an_unknown_sensor_ends_in_one_line(tmp_path, capsys):
    assert main([str(write_scene(tmp_path, MAPPED)), "--sensor", "RS-17"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("coarse_beams: ")
