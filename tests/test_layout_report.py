"""What is told of a layout of several LiDARs: text, tables, cautions, sheets, pictures, the page, Python."""

from __future__ import annotations

import copy
import re

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.commands.progress import RunProgress
from blender_lidar.document import ANSWER, CAUTION
from blender_lidar.errors import InputError
from blender_lidar.report.page import report_html
from blender_lidar.report.run_figures import plot_steps
from blender_lidar.results import Run
from blender_lidar.run.answer import optimum_text, run_document
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.quantities import run_tables
from blender_lidar.run.words import conditions, each_lidar, leans, run_text
from blender_lidar.toml_table import to_toml
from tests.small_scene import REGION, done, without_charts, write_scene

NORTH = {"name": "north", "x_m": -8.0, "y_m": 0.0, "height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]}
NORTH["installer"] = False  # as quick, and as planned
SOUTH = {"name": "south", "sensor": "RS-32", "x_m": 8.0, "y_m": 0.0, "height_m": [3.0, 5.0], "lean_deg": 12.0}
SOUTH["installer"] = False


def write_layout(folder, *lidars, **changes):
    """A small scene with [[lidar]] tables in place of [deployment]."""
    path = write_scene(folder, {**REGION, "search": {"particles": 10, "iterations": 6, "seed": 1}, **changes})
    text = re.sub(r"(?m)^\[deployment\]\n(?:(?!^\[).*\n)*", "", path.read_text(encoding="utf-8"))
    path.write_text(f"{text}\n{to_toml({'lidar': list(lidars)})}", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run with charts, which tests only look at, with what it printed."""
    folder = tmp_path_factory.mktemp("layout")
    scene = write_layout(folder, NORTH, SOUTH)
    assert main(["optimise", str(scene), "--out", str(folder / "run")]) == 0
    return RunFolder(folder / "run")


@pytest.fixture
def result(run):
    return copy.deepcopy(run.result)


def lines(result):
    """The lines of the answer by their labels."""
    return {one.label: one.text for one in run_document(result).of(ANSWER)}


def tables(result):
    """The tables by their keys, rows by their names."""
    return {one.key: {row[0]: row[1:] for row in one.rows} for one in run_tables(result)}


def test_the_answer_names_each_lidar_its_sensor_and_the_gain_over_the_best_single_one(result):
    found = lines(result)
    places = [text for label, text in found.items() if label.endswith((", north", ", south"))][:2]
    assert [text.split()[0] for text in places] == ["RS-16", "RS-32"]
    assert "tilted" in places[0]
    assert "leaning 12.0°" in places[1]
    (first,) = result["layout"]["steps"][0]["added"]
    assert f"over the best single LiDAR of its search ({first})" in found["Together"]


def test_a_gain_whose_interval_holds_0_is_said_not_to_be_shown(result):
    gain = result["layout"]["over_single"]
    for ends, says in (([-0.01, 0.2], "not shown"), (None, "no interval"), ([0.1, 0.2], "")):
        gain |= {"share_gain_interval_90": ends, "interval_90": ends}
        assert says in lines(result)["Together"]
        assert bool(re.search("not shown|no interval", lines(result)["Together"])) == bool(says)


def test_what_the_layout_is_compared_with_is_what_it_is(result):
    (first,) = result["layout"]["steps"][0]["added"]
    next(one for one in result["lidars"] if one["name"] == first)["bounds"] = None
    assert f"over what hung already ({first})" in lines(result)["Together"]
    result["search"] = None
    assert f"over the best single LiDAR of them ({first})" in lines(result)["Together"]


def test_the_tables_have_the_figures_of_the_layout_and_no_price_that_nobody_gave(result):
    found = tables(result)
    for one in result["layout"]["covered_by"]:
        assert found["steps"][f"{one['lidars']} or more"][1].value == 100.0 * one["share"]
    assert list(found["parts"]) == ["north, RS-16", "south, RS-32"]
    assert {len(row) for row in found["parts"].values()} == {5}
    assert not any(row[0] for row in found["parts"].values())
    result["lidars"][1]["price"] = 2500.5
    assert [row[0] for row in tables(result)["parts"].values()] == [None, "2500.5"]


def test_a_gain_is_shown_where_its_interval_lies_above_0(result):
    part = result["layout"]["parts"][0]["without"]
    for ends, shown in (([0.1, 0.2], "yes"), ([-0.1, 0.2], "no"), (None, None)):
        part["interval_90"] = ends
        assert tables(result)["parts"]["north, RS-16"][-1] == shown


def test_each_lidar_has_the_rows_of_its_own_orientation(result):
    rows = [row[0] for row in next(one for one in run_tables(result) if one.key == "mountings").rows]
    north, south = rows.index("north"), rows.index("south")
    assert any("tilt across" in row for row in rows[north:south])
    assert not any("lean" in row for row in rows[north:south])
    assert "lean" in rows[south:]


def test_a_lidar_of_a_layout_is_seen_as_a_single_one(result):
    each = each_lidar(result)
    assert [leans(one) for one in each.values()] == [False, True]
    for row, (name, one) in zip(result["lidars"], each.items(), strict=True):
        assert name == row["name"]
        assert one["deployment"] == row["deployment"]
        assert one["baseline"]["deployment"] == result["baseline"]["deployments"][name]
        assert one["detectable_share"] == result["detectable_share"]


def test_the_spread_of_the_optimum_is_told_of_the_lidar_that_it_is_of(result):
    ends = {"north.height_m": [2.0, 3.0], "north.tilt_x_deg": [1.0, 2.0], "south.height_m": [4.0, 4.5]}
    result["spread"] = {"searched": list(ends), "seeds": [], "mountings": 9, "optimum_interval_90": ends}
    north, south = map(optimum_text, each_lidar(result).values())
    assert "height 2.0 to 3.0 m" in north
    assert "tilt" in north
    assert "4.5" not in north
    assert "height 4.0 to 4.5 m" in south
    assert "tilt" not in south
    told = [one.text for one in run_document(result).statements if "ther traffic of this kind" in one.text]
    assert [text[:5].lower() for text in told] == ["north", "south"]


def test_a_bound_that_is_reached_is_told_with_the_name_and_the_table(result):
    result["objective"] = result["baseline"]["objective"] + 1.0
    for row in result["lidars"]:
        row["deployment"]["height_m"] = 4.5
    notes = [one.text for one in run_document(result).of(CAUTION) if "The height lies" in one.text]
    assert len(notes) == 1
    assert notes[0].startswith("north: The height")
    assert "[lidar]" in notes[0]


def test_range_gates_and_imperfections_are_told_of_each_where_they_differ(result):
    assert run_text(result).count("range gate 20 m") == 1
    assert not conditions(result)
    result["lidars"][1]["range_gate_m"] = 60.0
    result["lidars"][1]["imperfections"]["dropout"] = 0.1
    assert "range gate 20 and 60 m" in run_text(result)
    (text,) = conditions(result)
    assert "north exact; south drop-out 10 %" in text


def test_each_mast_has_a_sheet_with_its_neighbour(run):
    for name, other in (("north", "south"), ("south", "north")):
        text = run.read_text(f"installation_{name}.txt")
        assert text.startswith(f"Installation of LiDAR {name} (")
        assert re.search(rf"(?m)^Beside it +{other} \(RS-\d+\).*: x ", text)
        row = next(one for one in run.result["lidars"] if one["name"] == name)
        assert f"Height       {row['deployment']['height_m']:.2f} m" in text
    assert not run.file("installation.txt").exists()


def test_the_page_has_every_mast_and_picture_and_no_file_of_one_lidar(run):
    page = report_html(run)
    assert "layout of 2 roadside LiDARs" in page
    assert "fused scores are an upper bound" in page
    for text in ("Installation sheet of north", "Installation sheet of south", "LiDAR north", "one LiDAR to all"):
        assert text in page
    assert page.count("<img") == len(list(run.path.glob("*.png")))
    assert run.file("score_map_north.png").exists()
    assert not run.file("score_map.png").exists()


def test_python_gives_what_each_lidar_has_by_its_name(run, tmp_path):
    found = Run(None, run.path)
    assert found.mounting["south"]["height_m"] == run.result["lidars"][1]["deployment"]["height_m"]
    assert set(found.score_map) == {"north", "south"}
    assert found.score_map["south"] is None
    history = found.history
    assert {"north.tilt_x_deg", "south.height_m"} <= set(history)
    assert len(history["best"]) > 60
    assert np.isnan(np.asarray(history["north.height_m"])).any()
    assert "north" in found._repr_html_()
    with pytest.raises(InputError, match="north, south"):
        found.plot.score_map("west")
    assert found.plot.score_map("north").startswith(b"\x89PNG")


def test_the_price_is_drawn_only_where_every_step_has_one(result, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr("blender_lidar.report.figure.save", lambda figure, path: drawn.append(len(figure.axes)))
    plot_steps(tmp_path / "a.png", result)
    for step in result["layout"]["steps"]:
        step["price"] = 1000.0
    plot_steps(tmp_path / "b.png", result)
    assert drawn == [1, 2]


def test_evaluate_tells_of_a_given_layout_without_a_search(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene = write_layout(tmp_path, NORTH, SOUTH)
    out, _ = done(capsys, "evaluate", scene, "--lidar", "north,height_m=4,tilt_x_deg=10", "--out", tmp_path / "e")
    assert "RS-16 4.00 m above the road" in " ".join(out.split())
    assert "the best single LiDAR of them" in " ".join(out.split())
    assert "installation_north.txt, installation_south.txt" in out
    assert "at the bound of" not in out


def test_a_layout_with_errors_beside_one_that_hangs_already_is_told(tmp_path, capsys):
    held = {**NORTH, "height_m": 4.0, "tilt_x_deg": 15.0}
    scene = write_layout(tmp_path, held, {**SOUTH, "installer": {"tilt_deg": 1.0}})
    out, _ = done(capsys, "optimise", scene, "--out", tmp_path / "r")
    for text in ("what hung already (north)", ", as hung; baseline", "Searched north: nothing"):
        assert text in " ".join(out.split())
    assert not any(line.startswith("north: Other traffic") for line in out.splitlines())
    assert (tmp_path / "r" / "convergence.png").exists()


def test_a_single_lidar_with_a_name_is_told_as_one(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    scene = write_layout(tmp_path, SOUTH)
    out, _ = done(capsys, "optimise", scene, "--out", tmp_path / "r")
    assert "leaning 12.0°" in out
    assert "LiDARs" not in out
    assert (tmp_path / "r" / "installation.txt").exists()


class _Search:
    budget, evaluations, best_value = 200, 0, 254.3

    def __init__(self, label, variables):
        self.label, self.variables, self.best_x = label, variables, np.arange(len(variables), dtype=float)


def test_progress_of_a_layout_fits_80_columns(capsys):
    with RunProgress(()) as listener:
        for search in (
            _Search("north", ("height_m", "tilt_x_deg")),
            _Search("all together", ("north.height_m", "north.tilt_x_deg", "south.height_m", "south.lean_deg")),
        ):
            search.evaluations = 0
            listener.searching(search)
            search.evaluations = 100
            listener.searching(search)
        for _ in range(2 * 11):
            listener.mapping(26)
    lines = capsys.readouterr().err.splitlines()
    assert max(map(len, lines)) <= 80
    assert any("at height 0.00, tilt_x 1.00" in line for line in lines)
    assert not any(int(done) > int(of) for line in lines for done, of in re.findall(r": (\d+) of (\d+)", line))


def test_each_lidar_of_a_layout_speaks_of_the_angles_of_its_own_table():
    rows = [{"name": name, "leans": leaning, "baseline": {}} for name, leaning in (("a", False), ("b", True))]
    each = each_lidar({"lidars": rows, "spread": None, "baseline": {}})
    assert {name: leans(one) for name, one in each.items()} == {"a": False, "b": True}
