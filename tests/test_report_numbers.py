"""The page of a run says what result.json and the vehicle tables say."""

from __future__ import annotations

import csv
import shutil

import numpy as np
import pytest

from blender_lidar.document import ANSWER, CAUTION, DOUBT
from blender_lidar.run.answer import doubt, run_document
from blender_lidar.run.folder import RunFolder
from blender_lidar.traffic.vehicles import counted
from tests.report_samples import Page, change, hangs, page_of, result_of, said


@pytest.fixture
def folder(stored_runs, tmp_path) -> RunFolder:
    """A copy of the search, to be changed."""
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    return RunFolder(tmp_path / "run")


@pytest.fixture
def page(stored_runs) -> Page:
    """The page of the search."""
    return Page((stored_runs / "searched" / "report.html").read_text(encoding="utf-8"))


def table_rows(page: Page, caption: str) -> dict[str, list[str]]:
    """Cells of each row of a table by the heading that it stands under and what stands before them."""
    table = next(n for n in page.find("table") if page.text(page.within("caption", n)[0]).startswith(caption))
    rows, section = {}, ""
    for number in page.within("tr", table):
        heads = page.within("th", number)
        cells = [page.text(cell).replace("\N{MINUS SIGN}", "-") for cell in page.within("td", number)]
        if len(heads) == 1 and not any(cells):
            section = page.text(heads[0])
        elif len(heads) == 1:
            rows[f"{section}: {page.text(heads[0])}"] = [cell for cell in cells if cell]
    return rows


def test_the_scores_are_those_of_the_result(stored_runs, page):
    result = result_of(RunFolder(stored_runs / "searched"))
    rows = table_rows(page, "Baseline and optimised")
    base, held, base_held = result["baseline"], result["holdout"], result["baseline"]["holdout"]
    splits = {"Searched frames": (base, result)}  # it hangs already: planned and hung are one
    splits[f"Held-out frames, {held['blocks']} blocks of time"] = (base_held, held)
    for split, scores in splits.items():
        for what, key in (("boxes", "boxes"), ("different vehicles", "distinct_vehicles")):
            assert rows[f"{split}: {what}"] == [f"{one[key]:,}" for one in scores]
        *shares, gain = (float(cell) for cell in rows[f"{split}: detectable share [%, points]"] if " to " not in cell)
        assert shares == pytest.approx([100.0 * one["detectable_share"] for one in scores], abs=0.501)
        assert gain == pytest.approx(shares[1] - shares[0], abs=1e-9)  # as they are written
        values = [float(cell) for cell in rows[f"{split}: objective per vehicle [bits]"] if " to " not in cell]
        assert values[:2] == pytest.approx([one["objective_per_vehicle"] for one in scores], abs=0.00501)
    assert values[2] == pytest.approx(held["gain_over_baseline"], abs=0.0501)


@pytest.mark.parametrize(("caption", "column"), [("By distance", "distance_m"), ("By lane", "lane")])
def test_groups_are_what_the_vehicle_tables_say(stored_runs, page, caption, column):
    """Counted row by row from the files, held-out boxes alone."""
    rows, sums, vehicles = table_rows(page, caption), {}, {}
    files = [stored_runs / "searched" / name for name in ("vehicles_baseline.csv", "vehicles.csv")]
    for after, path in enumerate(files):
        with path.open(newline="") as stream:
            for row in csv.DictReader(stream):
                if row["split"] != "holdout":
                    continue
                value = float(row[column])
                low = int(value // 10) * 10
                name = f": lane {value:.0f}" if column == "lane" else f": {low}-{low + 10} m"
                bits = float(row["entropy_bits"]) if row["detectable"] == "1" else -1.0
                sums.setdefault(name, ([], []))[after].append((bits, int(row["detectable"])))
                vehicles.setdefault(name, set()).add(row["vehicle_id"])
    groups = {f": {one['name']}": one for one in result_of(RunFolder(stored_runs / "searched"))["groups"]}
    assert rows.keys() == sums.keys()
    for name, sides in sums.items():
        cells, group = rows[name], groups[name]
        shares = [100 * sum(found for _, found in side) / len(side) for side in sides]
        if len(sides[0]) < 10:
            assert cells[2] == f"{sum(found for _, found in sides[0])} of {len(sides[0])}"
            continue
        assert cells[:2] == [f"{len(sides[0])}", f"{len(vehicles[name])}"]
        told = [float(cell) for cell in cells[2:] if " to " not in cell]
        assert told[:2] == pytest.approx(shares, abs=0.501)
        assert told[2] == pytest.approx(told[1] - told[0])
        assert told[3:] == pytest.approx([sum(bits for bits, _ in side) / len(side) for side in sides], abs=0.0051)
        ends = [group[f"{key}_interval_90"] for key in ("before", "after", "gain")]
        found = [[float(end) for end in cell.split(" to ")] for cell in cells if " to " in cell]
        assert np.ravel(found) == pytest.approx(np.ravel([one for one in ends if one]) * 100, abs=0.501)


def test_the_answer_gives_mounting_shares_gains_and_intervals_of_the_held_out_frames(stored_runs, page):
    result = result_of(RunFolder(stored_runs / "searched"))
    held, base = result["holdout"], result["baseline"]["holdout"]
    result["holdout"] = held = held | {"blocks": 6, "interval_90": [0.01, 0.31], "distinct_vehicles": 12, "boxes": 40}
    held |= {"detectable_share": 0.876, "detectable_share_interval_90": [0.83, 0.93]}
    held |= {"detectable_share_gain": 0.226, "detectable_share_gain_interval_90": [0.19, 0.28]}
    base |= {"detectable_share": 0.65, "detectable_share_interval_90": [0.591, 0.709], "objective_per_vehicle": 0.5}
    result["holdout"] = hangs(held, objective_per_vehicle=0.66, gain_over_baseline=0.16)
    result["baseline"]["holdout"] = hangs(base)
    place = result["deployment"]
    lines = {one.label: one.text for one in run_document(result).of(ANSWER)}
    hang = f"{place['height_m']:.2f} m above the road, tilted {place['tilt_x_deg']:.1f}° down towards the road"
    assert lines["Hang it"] == hang
    assert lines["Detectable"] == "88 % (83 to 93) of the vehicles; baseline, 2.00 m, level: 65 % (59 to 71)"
    assert lines["Gain"] == "+23 points (+19 to +28); objective per vehicle +0.16 bits (+0.01 to +0.31)"
    assert run_document(result).title.endswith("judged on 40 held-out boxes (of 12 vehicles, 6 blocks of time)")
    stored = RunFolder(stored_runs / "searched").document
    terms = page.find("dl", **{"class": "answer"})[0]
    for one in stored.of(ANSWER):
        assert one.text in page.text(terms).replace("\N{MINUS SIGN}", "-")


def test_the_answer_hides_no_doubt(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    held, base = result["holdout"] | {"blocks": 6, "interval_90": [0.1, 0.2]}, result["baseline"]
    held |= {"detectable_share_gain_interval_90": [0.1, 0.3]}

    def doubted(**changes):
        return doubt(result | {"holdout": hangs(held, **changes)})

    lost = {"detectable_share_gain": -0.1, "gain_over_baseline": -0.25}
    assert doubted() == ""
    assert doubted(**lost).startswith("Held-out traffic does not confirm the search: there the mounting does worse ")
    assert doubted(interval_90=[-0.1, 0.2]).startswith("Held-out traffic does not show that this gains anything: ")
    for shares in (None, [0.0, 0.3], [-0.1, 0.3]):
        assert doubted(detectable_share_gain_interval_90=shares).startswith(
            "Held-out traffic shows a gain in the objective, but not that more vehicles become detectable"
        )
    assert doubted(detectable_share_gain_interval_90=[-0.3, -0.1]).startswith("Held-out traffic does not confirm the ")
    assert doubted(blocks=5) == "Held-out traffic is only 5 blocks of time, too few to be sure of an interval"
    assert doubted(interval_90=None) == "Too few blocks of time are held out for an interval"
    few = {"detectable_share_interval_90": None, "distinct_vehicles": 9}
    few = result | {"holdout": hangs(held, **few)}
    assert "; no interval, as there are fewer than 10 different vehicles" in said(few, ANSWER)
    assert doubt(result | {"objective_as_hung": base["objective_as_hung"]}).startswith("No mounting that was tried is ")
    whole = result_of(RunFolder(stored_runs / "whole"))
    assert doubt(whole).startswith("Traffic left out in turn does not confirm the search: there ")
    alone = run_document(whole | {"cross_fitted": None})
    assert [one.text for one in alone.of(DOUBT)] == ["Nothing was held out, so this has no independent check."]
    assert alone.of(ANSWER)[0].label == "Best found"
    assert "; no interval, as the same traffic has chosen the mounting" in said(whole | {"cross_fitted": None}, ANSWER)
    for one in alone.statements:
        assert not any(each.interval_90 for each in one.quantities if each.basis and each.basis.chosen_here)
    given = said(result_of(RunFolder(stored_runs / "given")), ANSWER)
    assert given.startswith(
        "Mounting: 4.00 m above the road, tilted 3.0° down along the nearest lane, with its traffic, "
    )


def test_a_sensor_of_ones_own_is_named_as_a_name(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    assert run_document(result | {"sensor": "own"}).title.startswith('LiDAR "own" at ')


@pytest.mark.parametrize(("share", "says"), [(0.0, "No vehicle is"), (1.0, "Every vehicle is"), (0.5, "")])
def test_a_threshold_that_tells_no_mountings_apart_is_named(stored_runs, share, says):
    result, shares = result_of(RunFolder(stored_runs / "searched")), {"detectable_share": share}
    base = result["baseline"] | {"holdout": hangs(result["baseline"]["holdout"], **shares)}
    found = said(result | {"holdout": hangs(result["holdout"], **shares), "baseline": base}, CAUTION)
    assert ("[objective] threshold is 0.005; try a " in found) == bool(says)
    assert says in found


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
    assert "The height lies at the bound of [deployment]: a value beyond may be better." in items
    assert "A note on frames." in items
    used = result["traffic_report"]["rows_used"]
    assert f"{used:,} of {used:,} rows used" in items
    sheet = " ".join(page.text(page.find("section", **{"class": "sheet"})[0]).split())
    assert "Inclinometer on the sensor's base" in sheet
    scene, computed = page.find("pre")[-1], page.find("table", **{"class": "settings"})[0]
    assert page.text(scene) == folder.file("scene.toml").read_text()
    assert all(version in page.text(computed) for version in result["versions"].values())
    assert page.tags().count("details") == page.tags().count("summary") == 2
