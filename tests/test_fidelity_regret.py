"""The proof of --fidelity auto: its table is of what was run, bad options end in a line."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

from tests.small_scene import MAPPED, write_scene

SCRIPT = Path(__file__).parents[1] / "scripts" / "fidelity_regret.py"
main = runpy.run_path(str(SCRIPT))["main"]
QUICK = [
    "--sensors",
    "RS-16",
    "--frames",
    "3",
    "--seeds",
    "2",
    "--evaluations",
    "40",
    "--workers",
    "1",
    "--grid-runs",
    "2",
]


def test_it_tells_speed_and_regret_and_goes_on_from_what_is_stored(tmp_path, capsys):
    scene = str(write_scene(tmp_path, MAPPED))
    words = [scene, *QUICK, "--searches", "de-pso", "--grid-runs", "2", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert told == (tmp_path / "out" / "fidelity_regret.txt").read_text()
    for rival in ("grid", "de-pso"):
        assert f"  {rival}: alone median" in told
        assert f"searched: regret to {rival}: mean" in told
    assert "searched: regret to best known: mean" in told
    worst = [float(line.split("worst ")[1].split(" %")[0]) for line in told.splitlines() if "to best known" in line]
    assert worst[0] >= 0.0  # nothing is better than the best known on the frames that were searched
    assert main(words) == 2
    assert "--resume" in capsys.readouterr().err
    assert main([*words, "--resume"]) == 0
    assert capsys.readouterr().out == told


def test_a_scene_that_searches_something_else_ends_in_one_line(tmp_path, capsys):
    scene = str(write_scene(tmp_path))
    assert main([scene, *QUICK, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_an_unknown_rival_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main([str(write_scene(tmp_path, MAPPED)), "--searches", "pso"])
    assert "allowed: hardened, de-pso, grid, random, or none" in capsys.readouterr().err
