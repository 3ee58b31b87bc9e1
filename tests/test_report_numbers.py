"""The page of a run says what result.json and the vehicle tables say."""

from __future__ import annotations

import csv
import shutil

import pytest

from blender_lidar.report.cautions import cautions, optimum_text
from blender_lidar.report.summary import answer, key_figures
from blender_lidar.run.folder import RunFolder
from blender_lidar.traffic.vehicles import counted
from tests.report_samples import Page, change, page_of, result_of


@pytest.fixture
def folder(stored_runs, tmp_path) -> RunFolder:
    """A copy of the search, to be changed."""
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.fixture
def page(stored_runs) -> Page:
    """The page of the search."""
    return Page((stored_runs / "searched" / "report.html").read_text(encoding="utf-8"))


def table_rows(page: Page, caption: str) -> dict[str, list[float]]:
    """Numbers of each row of a table by what stands before them; NaN where there is none."""
    table = next(n for n in page.find("table") if page.text(page.within("caption", n)[0]).startswith(caption))
    rows, section = {}, ""
    for number in page.within("tr", table):
        heads = page.within("th", number)
        numbers = [page.text(cell).replace("\N{MINUS SIGN}", "-") for cell in page.within("td", number)]
        if len(heads) == 1 and not numbers:
            section = page.text(heads[0])
        elif len(heads) == 1:
            values = [
                float(part) if part != "\N{EN DASH}" else float("nan")
                for cell in numbers
                for part in cell.split(" to ")
            ]
            rows[f"{section}: {page.text(heads[0])}"] = values
    return rows


def test_the_scores_are_those_of_the_result(stored_runs, page):
    result = result_of(RunFolder(stored_runs / "searched"))
    rows = table_rows(page, "Baseline and optimised")
    base, held, base_held = result["baseline"], result["holdout"], result["baseline"]["holdout"]
    expected = {
        ": height [m]": [base["deployment"]["height_m"], result["deployment"]["height_m"]],
        ": tilt across the road [deg]": [mount["deployment"]["tilt_x_deg"] for mount in (base, result)],
        "Searched frames: objective [bits]": [base["objective"], result["objective"]],
        "Searched frames: objective per vehicle [bits]": [scores["objective_per_vehicle"] for scores in (base, result)],
        "Searched frames: detectable share [%]": [100 * scores["detectable_share"] for scores in (base, result)],
        "Held-out frames: objective per vehicle [bits]": [s["objective_per_vehicle"] for s in (base_held, held)],
        "Held-out frames: detectable share [%]": [100 * scores["detectable_share"] for scores in (base_held, held)],
        "Held-out frames: gain per vehicle [bits]": [held["gain_over_baseline"]],
        f"Held-out frames: 90 % interval, {held['blocks']} blocks": held["interval_90"],
    }
    assert rows.keys() == expected.keys()
    for name, values in expected.items():
        assert rows[name] == pytest.approx(values, abs=0.0501 if "%]" in name or "objective [" in name else 0.00501), (
            name
        )


@pytest.mark.parametrize(("caption", "column"), [("By distance", "distance_m"), ("By lane", "lane")])
def test_groups_are_what_the_vehicle_tables_say(stored_runs, page, caption, column):
    """Counted row by row, in another way than the page does."""
    rows = table_rows(page, caption)
    sums: dict[str, dict] = {}
    files = [stored_runs / "searched" / name for name in ("vehicles_baseline.csv", "vehicles.csv")]
    for after, path in enumerate(files):
        with path.open(newline="") as stream:
            for row in csv.DictReader(stream):
                value = float(row[column])
                low = int(value // 10) * 10
                name = f": lane {value:.0f}" if column == "lane" else f": {low}-{low + 10} m"
                bits = float(row["entropy_bits"]) if row["detectable"] == "1" else -1.0
                group = sums.setdefault(name, {})
                group.setdefault((row["split"], after), []).append((bits, int(row["detectable"])))
    assert rows.keys() == sums.keys()
    for name, group in sums.items():
        expected = []
        for split in ("search", "holdout"):
            seen = [group[split, after] for after in (0, 1)]
            expected += [sum(bits for bits, _ in part) / len(part) for part in seen]
            expected += [100 * sum(found for _, found in part) / len(part) for part in seen]
        assert rows[name][:8] == pytest.approx(expected, abs=0.051)
        assert rows[name][:2] == pytest.approx(expected[:2], abs=0.00051)
        assert rows[name][8] == sum(len(group[split, 0]) for split in ("search", "holdout"))


def test_the_answer_gives_mounting_shares_gain_and_interval_of_the_held_out_frames(stored_runs, page):
    result = result_of(RunFolder(stored_runs / "searched"))
    said = answer(result)
    held, base = result["holdout"], result["baseline"]["holdout"]
    assert said.startswith(f"Hang the RS-16 {result['deployment']['height_m']:.2f} m above the road, tilted ")
    for number in (
        f"{result['deployment']['tilt_x_deg']:.1f}° across it",
        f"{100 * held['detectable_share']:.1f} %",
        f"{100 * base['detectable_share']:.1f} %",
        f"gains {held['gain_over_baseline']:.3f} bits",
        "{:.3f} to {:.3f}".format(*held["interval_90"]),
    ):
        assert number in said
    assert page.text(page.find("p", **{"class": "answer"})[0]) == answer(result)


def test_the_answer_gives_the_share_found_before_that_of_the_baseline(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    held, base = result["holdout"], result["baseline"]
    found = result | {
        "holdout": held | {"detectable_share": 0.75},
        "baseline": base | {"holdout": base["holdout"] | {"detectable_share": 0.5}},
    }
    said = answer(found)
    assert "75.0 % of the vehicles are detectable instead of 50.0 % under the baseline" in said
    assert ("detectable on held-out traffic", "50.0 \N{RIGHTWARDS ARROW} 75.0 %") in key_figures(found)


def test_the_answer_hides_no_doubt(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    held, base = result["holdout"], result["baseline"]
    lost = {"objective_per_vehicle": base["holdout"]["objective_per_vehicle"] - 0.25}
    said = answer(result | {"holdout": held | lost})
    assert "loses 0.250" in said
    assert said.startswith("Held-out traffic does not confirm the search, whose best mounting has the RS-16 ")
    assert "there may be no gain at all" in answer(result | {"holdout": held | {"interval_90": [-0.1, 0.2]}})
    assert "there may be no gain" not in answer(result | {"holdout": held | {"interval_90": [0.1, 0.2]}})
    doubtful_loss = answer(result | {"holdout": held | lost | {"interval_90": [-0.5, 0.1]}})
    assert "there may be no loss at all" in doubtful_loss
    assert "no gain" not in doubtful_loss
    assert "at all" not in answer(result | {"holdout": held | lost | {"interval_90": [-0.5, -0.1]}})
    assert "too few blocks of time for an interval" in answer(result | {"holdout": held | {"interval_90": None}})
    assert answer(result | {"objective": base["objective"]}).startswith("No mounting that was tried is better")
    whole = answer(result_of(RunFolder(stored_runs / "whole")))
    assert "on the traffic that was used to choose the mounting" in whole
    assert "nothing was held out" in whole
    given = answer(result_of(RunFolder(stored_runs / "given")))
    assert given.startswith("The RS-16 4.00")
    assert "tilted -3.0° along it, turned 5.0°" in given


def test_a_sensor_of_ones_own_is_named_as_a_name(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    assert answer(result | {"sensor": "own"}).startswith('Hang the LiDAR "own" ')


@pytest.mark.parametrize(("share", "said"), [(0.0, "No vehicle is"), (1.0, "Every vehicle is"), (0.5, "")])
def test_a_threshold_that_tells_no_mountings_apart_is_named(stored_runs, share, said):
    result, shares = result_of(RunFolder(stored_runs / "searched")), {"detectable_share": share}
    base = result["baseline"] | {"holdout": result["baseline"]["holdout"] | shares}
    found = " ".join(cautions(result | {"holdout": result["holdout"] | shares, "baseline": base}))
    assert ("[objective] threshold is 0.005; try a " in found) == bool(said)
    assert said in found


def test_one_of_a_kind_is_told_in_the_singular():
    assert [counted(number, "frame") for number in (0, 1, 2000)] == ["0 frames", "1 frame", "2,000 frames"]
    assert counted(2, "box") == "2 boxes"


def test_cautions_repairs_sheet_scene_and_versions_are_there(folder):
    result = result_of(folder)
    result["notes"] = ["a note on frames"]
    result["deployment"]["height_m"] = 4.5
    change(folder, result)
    page = Page(page_of(folder))
    items = [page.text(number) for number in page.find("li")]
    assert "The best height lies on a bound of [deployment]; a value beyond it may be better." in items
    assert "a note on frames" in items
    used = result["traffic_report"]["rows_used"]
    assert f"{used:,} of {used:,} rows used" in items
    sheet = " ".join(page.text(page.find("section", **{"class": "sheet"})[0]).split())
    assert "Inclinometer on the sensor's base" in sheet
    scene, computed = page.find("pre")[-1], page.find("table", **{"class": "settings"})[0]
    assert page.text(scene) == folder.file("scene.toml").read_text()
    assert all(version in page.text(computed) for version in result["versions"].values())
    assert page.tags().count("details") == page.tags().count("summary") == 2


@pytest.mark.parametrize(("tilt", "outside"), [(14.8, True), (17.6, False), (20.0, False), (25.4, False)])
def test_an_answer_that_the_grid_of_the_map_passes_by_is_told_to_lie_outside_its_interval(tilt, outside):
    result = {
        "map": {"points": [11, 26], "optimum_interval_90": {"height_m": [3.5, 4.5], "tilt_x_deg": [18.0, 25.0]}},
        "bounds": {"height_m": [2.0, 4.5], "tilt_x_deg": [0.0, 25.0]},
        "deployment": {"height_m": 3.9, "tilt_x_deg": tilt},
    }
    assert ("the mounting found lies between its points, outside that range" in optimum_text(result)) == outside
