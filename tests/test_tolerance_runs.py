"""Runs with a tolerance: both optima in every file, the sharp one as without one, stopped and resumed at will."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.cli import main
from blender_lidar.commands.options import parse_tolerance
from blender_lidar.report.cautions import cautions, costliest_text
from blender_lidar.report.summary import answer, kept_text
from blender_lidar.report.tables import comparison_table
from blender_lidar.run import replay
from blender_lidar.run.tolerance import tolerance_text
from blender_lidar.scoring.evaluation import Workplace
from blender_lidar.scoring.frame_scorer import FrameScorer
from tests.refusals import refused
from tests.report_samples import Page
from tests.small_scene import CASTER, MAPPED, done, without_charts, without_times, write_scene
from tests.test_resume import stored_evaluations

pytestmark = [
    pytest.mark.usefixtures("quick"),
    pytest.mark.skipif(CASTER == "exact", reason="no fast caster is installed: these runs would take ten minutes"),
]

FEW = {"traffic": {"frames": 4}, "search": {"particles": 3, "iterations": 3}}
TOLERANCE = "tilt_deg=4,height_m=0.3"  # so wide that the two searches part on a handful of vehicles
WORDS = ("--tolerance", TOLERANCE)
NAMES = ("baseline", "sharp", "optimised")


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run with a tolerance, one without, and one mounting evaluated over it, all of the same scene."""
    folder = tmp_path_factory.mktemp("runs")
    scene = str(write_scene(folder, {**FEW, **MAPPED}))
    verbs = {
        "robust": ["optimise", scene, *WORDS],
        "plain": ["optimise", scene],
        "given": ["evaluate", scene, *WORDS, "--height", "3.3", "--tilt-x", "14"],
    }
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        for name, words in verbs.items():
            assert main([*words, "--out", str(folder / name)]) == 0
    return folder


def stored(folder: Path) -> dict:
    return json.loads((folder / "result.json").read_text())


def history(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as stream:
        return list(csv.DictReader(stream))


# --- what a run leaves ------------------------------------------------------------------------------------------------


def test_without_a_tolerance_nothing_but_a_null_key_is_added(runs):
    assert stored(runs / "plain")["tolerance"] is None
    assert not (runs / "plain" / "history_sharp.csv").exists()
    assert "tolerance" not in (runs / "plain" / "scene.toml").read_text()


def test_the_sharp_search_is_that_of_a_run_without_a_tolerance(runs):
    plain, robust = stored(runs / "plain"), stored(runs / "robust")
    sharp = robust["tolerance"]["sharp"]
    assert {key: plain[key] for key in sharp} == sharp
    assert (runs / "robust" / "history_sharp.csv").read_bytes() == (runs / "plain" / "history.csv").read_bytes()
    assert (runs / "robust" / "score_map.csv").read_bytes() == (runs / "plain" / "score_map.csv").read_bytes()
    assert robust["map"] == plain["map"]
    assert robust["baseline"] == plain["baseline"]


def test_the_block_says_what_was_allowed_and_what_it_took(runs):
    block = stored(runs / "robust")["tolerance"]
    assert block["settings"] == {"height_m": 0.3, "tilt_deg": 4.0, "yaw_deg": 0.0, "aim": "mean"}
    assert (block["searched_errors"], block["judged_errors"]) == (9, 121)
    assert block["evaluations"] == {
        "sharp": 18,
        "robust": 9,
    }  # the sharp one's search, and from the map's best point on
    assert stored(runs / "robust")["evaluations"] == 27
    assert set(block["robust"]) == set(NAMES)


def test_the_mounting_is_the_best_of_both_searches_over_the_tolerance(runs):
    result = stored(runs / "robust")
    robust = result["tolerance"]["robust"]
    assert robust["optimised"]["objective"] >= robust["sharp"]["objective"]
    table = history(runs / "robust" / "history.csv")
    best = table[int(np.argmax([float(row["objective"]) for row in table]))]
    found = {key: float(best[key]) for key in ("height_m", "tilt_x_deg")}
    mount, sharp = result["deployment"], result["tolerance"]["sharp"]["deployment"]
    assert {key: mount[key] for key in found} == found or mount == sharp


def test_scores_over_the_tolerance_are_those_that_evaluate_finds(runs, tmp_path, capsys):
    result = stored(runs / "robust")
    for name, mount in (("optimised", result["deployment"]), ("sharp", result["tolerance"]["sharp"]["deployment"])):
        words = ["--height", repr(mount["height_m"]), "--tilt-x", repr(mount["tilt_x_deg"])]
        out, _ = done(capsys, "evaluate", runs / "scene.toml", *WORDS, *words, "--out", tmp_path / name, "--json")
        found, expected = json.loads(out)["tolerance"]["robust"], result["tolerance"]["robust"]
        assert found["baseline"] == expected["baseline"]
        message = {**expected[name], "holdout": dict(expected[name]["holdout"])}
        message["holdout"].pop("over_sharp", None)
        assert found["optimised"] == message


def test_numbers_over_the_tolerance_agree_with_each_other(runs):
    result = stored(runs / "robust")
    block, base = result["tolerance"], result["baseline"]
    scores = {"sharp": block["sharp"], "optimised": result}
    for name, planned in scores.items():
        over = block["robust"][name]
        for mine, exact, reference in (
            (over, planned, base),
            (over["holdout"], planned["holdout"], base["holdout"]),
        ):
            gain = exact["objective_per_vehicle"] - reference["objective_per_vehicle"]
            kept = (mine["objective_per_vehicle"] - reference["objective_per_vehicle"]) / gain
            assert mine["gain_kept"] == (pytest.approx(kept) if gain > 0 else None)
            assert set(mine["loss_at_limits"]) == {"height_m", "tilt_x_deg", "tilt_y_deg"}
        assert over["objective"] == pytest.approx(over["objective_per_vehicle"] * result["vehicles"])
        held = over["holdout"]
        low, high = held["interval_90"]
        assert low <= held["gain_over_baseline"] <= high
    beside = block["robust"]["optimised"]["holdout"]["over_sharp"]
    for name, parts in (
        ("as_planned", (result["holdout"], block["sharp"]["holdout"])),
        ("over_tolerance", [block["robust"][key]["holdout"] for key in ("optimised", "sharp")]),
    ):
        mine, sharp = (part["objective_per_vehicle"] for part in parts)
        assert beside[name]["objective_per_vehicle"] == pytest.approx(mine - sharp, abs=1e-12)
        low, high = beside[name]["interval_90"]
        assert low <= mine - sharp <= high


def test_an_evaluation_over_a_tolerance_has_no_sharp_mounting(runs):
    result = stored(runs / "given")
    block = result["tolerance"]
    assert (block["sharp"], block["evaluations"], block["searched_errors"]) == (None, None, None)
    assert set(block["robust"]) == {"baseline", "optimised"}
    assert (runs / "given" / "history_sharp.csv").exists() is False
    assert result["deployment"]["height_m"] == 3.3


def test_the_low_aim_asks_for_more_errors_and_promises_less(runs, tmp_path):
    words = ["evaluate", str(runs / "scene.toml"), "--height", "3.3", "--tilt-x", "14"]
    assert main([*words, "--tolerance", f"{TOLERANCE},aim=low", "--out", str(tmp_path / "low")]) == 0
    low, mean = (stored(place)["tolerance"]["robust"]["optimised"] for place in (tmp_path / "low", runs / "given"))
    assert low["objective_per_vehicle"] < mean["objective_per_vehicle"]
    assert low["loss_at_limits"] == mean["loss_at_limits"]


def test_one_set_of_processes_and_one_scorer_for_each_frame_serve_a_whole_run(runs, tmp_path, monkeypatch):
    """Three were started one after the other, and the final tables built every tree again."""
    employed, built = [], []
    employ, build = Workplace.employ, FrameScorer.__init__
    told = stored(runs / "robust")["other_traffic"]  # which has frames of its own
    monkeypatch.setattr("blender_lidar.run.optimise.other_traffic", lambda *given: told)
    monkeypatch.setattr(Workplace, "employ", lambda *given: employed.append(given) or employ(*given))
    monkeypatch.setattr(FrameScorer, "__init__", lambda *given: built.append(given) or build(*given))
    assert main(["optimise", str(runs / "scene.toml"), *WORDS, "--out", str(tmp_path / "run")]) == 0
    result = stored(tmp_path / "run")
    assert len(employed) == 1
    assert len(built) == len(result["frame_ids"]) + len(result["holdout_frame_ids"])


def kept_on_held_out(result: dict) -> list[str]:
    """Shares of the gain that the sharp and the robust mounting keep, as a table has them."""
    shares = [result["tolerance"]["robust"][name]["holdout"]["gain_kept"] for name in ("sharp", "optimised")]
    return ["-" if share is None else f"{100 * share:.1f}" for share in shares]


# --- what is said -----------------------------------------------------------------------------------------------------


def test_the_table_shows_both_optima_and_what_they_keep(runs, tmp_path, capsys):
    shutil.copytree(runs / "robust", tmp_path / "run")
    out, _ = done(capsys, "optimise", runs / "scene.toml", *WORDS, "--out", tmp_path / "run", "--resume")
    assert "Tolerance  +/-0.3 m of height, +/-4 deg of either tilt: mean; a second search scores" in out
    lines = out.splitlines()
    heading = next(line for line in lines if line.startswith("Mounting"))
    assert heading.split() == ["Mounting", "baseline", "sharp", "robust"]
    result = stored(runs / "robust")
    heights = next(line for line in lines if "height [m]" in line).split()[-3:]
    mounts = (result["baseline"], result["tolerance"]["sharp"], result)
    assert heights == [f"{mount['deployment']['height_m']:.2f}" for mount in mounts]
    assert "Held-out frames, +/-0.3 m of height, +/-4 deg of either tilt: mean" in lines
    assert [line.split()[-2:] for line in lines if "gain kept [%]" in line][-1] == kept_on_held_out(result)


def test_gains_beside_a_baseline_that_hangs_off_did_not_say_that_they_are_over_it_as_planned(runs):
    result = stored(runs / "robust")
    names = [row[0] for row in comparison_table(result).sections[-1][1]]
    assert "gain over the baseline as planned [bits]" in names
    assert not any(name.startswith("gain per vehicle") for name in names)
    held = result["tolerance"]["robust"]["optimised"]["holdout"]
    planned = result["baseline"]["holdout"]["objective_per_vehicle"]
    assert held["gain_over_baseline"] == pytest.approx(held["objective_per_vehicle"] - planned)
    assert result["tolerance"]["robust"]["baseline"]["holdout"]["objective_per_vehicle"] != planned


def test_the_page_shows_both_optima(runs):
    page = Page((runs / "robust" / "report.html").read_text(encoding="utf-8"))
    result = stored(runs / "robust")
    captions = {page.text(page.within("caption", n)[0]): n for n in page.find("table")}
    table = captions["Baseline, sharp and robust mounting"]
    rows = {page.text(page.within("th", n)[0]): n for n in page.within("tr", table) if page.within("th", n)}
    signs = str.maketrans({"\N{MINUS SIGN}": "-", "\N{EN DASH}": "-"})
    kept = [page.text(cell).translate(signs) for cell in page.within("td", rows["gain kept [%]"])]
    assert kept == kept_on_held_out(result)
    items = [page.text(number) for number in page.find("li")]
    assert all(note in items for note in cautions(result))
    assert page.text(page.find("p", **{"class": "answer"})[0]) == answer(result)


def test_the_sheet_tells_what_is_kept_and_what_costs_most(runs):
    result, sheet = stored(runs / "robust"), (runs / "robust" / "installation.txt").read_text()
    assert f"With installation errors of {tolerance_text(result['tolerance']['settings'])}" in sheet
    assert f"- {kept_text(result)}" in sheet
    assert f"- {costliest_text(result)}" in sheet
    assert "installation errors" not in (runs / "plain" / "installation.txt").read_text()


def test_the_costliest_single_error_is_the_one_that_loses_most(runs):
    result = stored(runs / "given")
    losses = {"height_m": [0.01, -0.2], "tilt_x_deg": [0.25, 0.1], "tilt_y_deg": [0.0, 0.0]}
    result["tolerance"]["robust"]["optimised"]["holdout"]["loss_at_limits"] = losses
    assert costliest_text(result) == (
        "of single installation errors, tilt across the road -4 deg costs most: 0.250 bits per vehicle "
        "(held-out frames)"
    )
    result["tolerance"]["robust"]["optimised"]["holdout"]["loss_at_limits"] = {"height_m": [-0.1, 0.0]}
    assert costliest_text(result) == ""


def test_a_search_that_found_nothing_better_says_so(runs):
    result = stored(runs / "robust")
    result["tolerance"]["sharp"]["deployment"] = result["deployment"]
    assert "The search over the tolerance found no mounting better than the sharp one." in cautions(result)


def test_what_robustness_costs_and_brings_is_told_with_its_intervals(runs):
    result = stored(runs / "robust")
    result["tolerance"]["sharp"]["deployment"] = {**result["deployment"], "tilt_x_deg": 1.0}
    result["tolerance"]["robust"]["optimised"]["holdout"]["over_sharp"] = {
        "as_planned": {"objective_per_vehicle": -0.005, "interval_90": [-0.016, 0.006]},
        "over_tolerance": {"objective_per_vehicle": 0.004, "interval_90": None},
    }
    assert (
        "On held-out frames the robust mounting has, compared with the sharp one and per vehicle, -0.005 bits (90 %: "
        "-0.016 to +0.006) as planned and +0.004 bits over the tolerance."
    ) in cautions(result)


# --- options ----------------------------------------------------------------------------------------------------------


def test_an_option_reads_as_the_scenes_table():
    assert parse_tolerance("tilt_deg=1, height_m = 0.05,aim=low", "--tolerance") == {
        "tilt_deg": 1.0,
        "height_m": 0.05,
        "aim": "low",
    }
    assert parse_tolerance("none", "--tolerance") is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("tilt=1", "--tolerance: unknown key 'tilt'; did you mean 'tilt_deg'? allowed: height_m, tilt_deg, yaw_deg"),
        ("tilt_deg=-1", "--tolerance tilt_deg: is -1.0; allowed: 0 to 10"),
        ("height_m=low", "--tolerance height_m: is 'low'; allowed: a number"),
        ("tilt_deg=1,aim=best", "--tolerance aim: unknown aim 'best'; allowed: mean, low"),
        ("tilt_deg=0", "--tolerance: leaves every coordinate exact; allowed: at least one of height_m, tilt_deg"),
        ("1", "--tolerance: '1' is no key=value; allowed: such as tilt_deg=1,height_m=0.05, or none"),
        ("yaw_deg=1,yaw_deg=2", "--tolerance: 'yaw_deg=2' is there twice; allowed: such as"),
    ],
)
def test_a_wrong_tolerance_is_one_line_that_names_the_key(tmp_path, capsys, given, message):
    line = refused(capsys, tmp_path, "optimise", write_scene(tmp_path), "--tolerance", given, "--out", tmp_path / "run")
    assert line.startswith(f"blender-lidar: {message}")


def test_an_option_can_take_a_scenes_tolerance_away(tmp_path):
    scene = write_scene(tmp_path, {**FEW, "objective": {"tolerance": {"tilt_deg": 2.0}}})
    words = ["evaluate", str(scene), "--height", "3", "--out"]
    assert main([*words, str(tmp_path / "with")]) == 0
    assert main([*words, str(tmp_path / "without"), "--tolerance", "none"]) == 0
    assert stored(tmp_path / "with")["tolerance"]["settings"]["tilt_deg"] == 2.0
    assert stored(tmp_path / "without")["tolerance"] is None


# --- resumed ----------------------------------------------------------------------------------------------------------

# Written one after the other: the scene, checkpoints of 3 sharp iterations and of 3 robust ones, both histories, the
# vehicle tables and the sheet, the result, the page.
IN_THE_ROBUST_SEARCH, AT_THE_SECOND_HISTORY = 7, 9
FILES = ("history.csv", "history_sharp.csv", "vehicles.csv", "installation.txt")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A scene of one variable, which saves the map, and the folder of a run of it that nobody disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    scene = write_scene(folder, {**FEW, "search": {**FEW["search"], "method": "de-pso"}})  # whole swarms at a time
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["optimise", str(scene), *WORDS, "--out", str(folder / "run")]) == 0
    return scene, folder / "run"


class Killed(BaseException):
    """As by SIGKILL, which tests.test_resume sends: nothing catches it."""


def killed(monkeypatch, scene: Path, out: Path, write: int) -> Path:
    """The folder of a run that came to its end at a write."""
    left, replace = iter(range(write - 1, -1, -1)), Path.replace

    def replace_or_die(self, target):
        if not next(left):
            raise Killed
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replace_or_die)
        patch.setattr(replay, "_STORE_EVERY_S", 0.0)
        with pytest.raises(Killed):
            main(["optimise", str(scene), *WORDS, "--out", str(out)])
    return out


@pytest.mark.parametrize(
    ("write", "begun"),
    [(IN_THE_ROBUST_SEARCH, 9 + 6), (AT_THE_SECOND_HISTORY, 9 + 9)],
)
def test_a_run_killed_in_either_search_goes_on_to_the_same_result(tmp_path, undisturbed, monkeypatch, write, begun):
    scene, expected = undisturbed
    out = killed(monkeypatch, scene, tmp_path / "run", write)
    assert stored_evaluations(out) == begun
    assert main(["optimise", str(scene), *WORDS, "--out", str(out), "--resume"]) == 0
    assert without_times(stored(out)) == without_times(stored(expected))
    for name in FILES:
        assert (out / name).read_bytes() == (expected / name).read_bytes()
    assert {path.name for path in out.iterdir()} == {path.name for path in expected.iterdir()}


def test_a_run_with_another_tolerance_or_none_is_not_gone_on_with(undisturbed, capsys):
    scene, folder = undisturbed
    for words, named in (
        ((), "not None; give it the same settings"),
        (("--tolerance", "tilt_deg=4,height_m=0.2"), "[objective] tolerance = {'aim': 'mean', 'height_m': 0.3, "),
    ):
        line = refused(capsys, folder, "optimise", scene, *words, "--out", folder, "--resume", begun=True)
        assert "the run there had [objective] tolerance = " in line
        assert named in line
