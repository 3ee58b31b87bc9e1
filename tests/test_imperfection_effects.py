"""scripts/imperfection_effects.py: its table says what runs with the same settings say."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.small_scene import cli, without_charts, write_scene

PATH = Path(__file__).parents[1] / "scripts" / "imperfection_effects.py"


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("imperfection_effects", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def table(out):
    """Numbers of each row by its name."""
    rows = [re.match(r"(\S+(?: \S+)*) {2,}(.*)", line) for line in out.splitlines()[2:]]
    return {row[1]: [float(number) for number in re.findall(r"[+-]?\d+\.\d+", row[2])] for row in rows}


def test_every_row_is_what_runs_with_those_settings_differ_by(script, tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene = write_scene(tmp_path)
    assert script.main([str(scene), "--draws", "2", "--height", "3", "--tilt-x", "10"]) == 0
    found = table(capsys.readouterr().out)
    assert [*found] == ["perfect", *(name for name, _, _ in script.EFFECTS)]

    def run(**sensor):
        name = "-".join(f"{key}{value}" for key, value in sensor.items()) or "perfect"
        changed = write_scene(tmp_path, {"sensor": sensor})
        assert cli(capsys, "evaluate", changed, "--height", 3, "--tilt-x", 10, "--out", tmp_path / name)[0] == 0
        result = json.loads((tmp_path / name / "result.json").read_text())
        return np.array([result["objective_per_vehicle"], 100 * result["detectable_share"]])

    perfect = run()
    assert found["perfect"][:2] == pytest.approx(perfect, abs=6e-5)
    for name, on, drawn in script.EFFECTS:
        added = [run(**on, **({drawn: draw} if drawn else {"noise_seed": draw})) - perfect for draw in (1, 2)]
        expected = np.column_stack([np.mean(added, axis=0), np.std(added, axis=0, ddof=1)]).ravel()
        assert found[name][:4] == pytest.approx(expected, abs=6e-5), name
    assert found["drop-out 0.1"][6] == pytest.approx(-0.1 * found["perfect"][3], rel=0.2)


def test_a_sensor_that_the_scene_makes_imperfect_is_perfect_in_the_first_row(script, tmp_path, capsys):
    tables = []
    for changes in (
        {},
        {"sensor": {"dropout": 0.5, "glass_dropout": 1.0, "range_at_10_percent_m": 9.0, "unit_spread_deg": 0.1}},
    ):
        assert script.main([str(write_scene(tmp_path, changes)), "--draws", "1"]) == 0
        tables.append(table(capsys.readouterr().out))
    assert tables[0]["perfect"] == tables[1]["perfect"]


@pytest.mark.parametrize(
    ("words", "told"),
    [(["--height", "nan"], "--height: is nan; allowed: "), (["--sensor", "RS-17"], "--sensor: unknown sensor 'RS-17'")],
)
def test_what_cannot_be_is_refused_in_one_line(script, tmp_path, capsys, words, told):
    assert script.main([str(write_scene(tmp_path)), *words]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("imperfection_effects: ")
    assert told in err
    assert err.count("\n") == 1
