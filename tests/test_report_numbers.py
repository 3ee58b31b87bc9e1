"""The page of a run says what result.json and the vehicle tables say."""

from __future__ import annotations

import csv
import shutil

import pytest

from blender_lidar.report.cautions import cautions, optimum_text
from blender_lidar.report.summary import answer, decimals_of, key_figures
from blender_lidar.run.folder import RunFolder
from blender_lidar.traffic.vehicles import counted
from tests.report_samples import Page, change, hangs, page_of, result_of


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
    share, gain = "detectable share [%]", "gain [percentage points]"
    on = f"Held-out frames, {held['blocks']} blocks of time"
    keys = "detectable_share_interval_90", "detectable_share_gain_interval_90"
    share_90, gain_90 = ([[100 * end for end in (each[key] or ())] for each in (base_held, held)] for key in keys)
    expected = {
        ": height [m]": [base["deployment"]["height_m"], result["deployment"]["height_m"]],
        ": tilt across the road [deg]": [mount["deployment"]["tilt_x_deg"] for mount in (base, result)],
        "Searched frames: objective [bits]": [base["objective"], result["objective"]],
    }
    for name, scores in (("Searched frames", (base, result)), (on, (base_held, held))):
        shares = [100 * each["detectable_share"] for each in scores]
        expected |= {
            f"{name}: boxes (a vehicle in a frame)": [each["boxes"] for each in scores],
            f"{name}: different vehicles": [each["distinct_vehicles"] for each in scores],
            f"{name}: {share}": shares,
            f"{name}: {gain}": [shares[1] - shares[0]],
            f"{name}: objective per vehicle [bits]": [each["objective_per_vehicle"] for each in scores],
        }
    expected[f"{on}: gain per vehicle [bits]"] = [held["gain_over_baseline"]]
    intervals = [[*share_90[0], *share_90[1]], gain_90[1], held["interval_90"]]
    rows = table_rows(page, "Baseline and optimised")
    found = [values for name, values in rows.items() if name.startswith(f"{on}: 90 % interval")]
    assert {name: values for name, values in rows.items() if ": 90 % interval" not in name}.keys() == expected.keys()
    for name, values in expected.items():
        within = 0.501 if "%]" in name or "points]" in name else 0.051 if "objective [" in name else 0.00501
        assert rows[name] == pytest.approx(values, abs=within), name
    assert [len(values) for values in found] == [len(values) for values in intervals if values]
    for values, ends in zip(found, filter(None, intervals), strict=True):
        assert values == pytest.approx(ends, abs=0.501 if max(ends) > 3.0 else 0.0501)


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
        numbers = rows[name]
        shares = [100 * sum(found for _, found in side) / len(side) for side in sides]
        assert numbers[:2] == [len(sides[0]), len(vehicles[name])]
        assert numbers[2] == pytest.approx(shares[0], abs=0.501)
        assert numbers[-2:] == pytest.approx([sum(bits for bits, _ in side) / len(side) for side in sides], abs=0.0051)
        found = groups[name]
        ends = [found[f"{key}_interval_90"] for key in ("before", "after", "gain")]
        expected = [len(sides[0]), len(vehicles[name])]
        for value, pair in zip((*shares, shares[1] - shares[0]), ends, strict=True):
            expected += [value, *(100 * end for end in pair)] if pair else [value]
        assert [one for one in numbers[:-2] if one == one] == pytest.approx(expected, abs=0.501)


def test_the_answer_gives_mounting_shares_gains_and_intervals_of_the_held_out_frames(stored_runs, page):
    result = result_of(RunFolder(stored_runs / "searched"))
    held, base = result["holdout"], result["baseline"]["holdout"]
    result["holdout"] = held = held | {"blocks": 6, "interval_90": [0.01, 0.31], "distinct_vehicles": 12, "boxes": 40}
    held |= {"detectable_share": 0.876, "detectable_share_interval_90": [0.83, 0.93]}
    held |= {"detectable_share_gain": 0.226, "detectable_share_gain_interval_90": [0.19, 0.28]}
    base |= {"detectable_share": 0.65, "detectable_share_interval_90": [0.591, 0.709], "objective_per_vehicle": 0.5}
    result["holdout"] = hangs(held, objective_per_vehicle=0.66)
    result["baseline"]["holdout"] = hangs(base)
    said, place = answer(result), result["deployment"]
    assert said == (
        f"Hang the RS-16 {place['height_m']:.2f} m above the road, tilted {place['tilt_x_deg']:.1f}° down towards "
        "the road: on "
        "held-out traffic (40 boxes of 12 vehicles) 88 % of the vehicles are detectable (90 % interval 83 to 93) "
        "instead of 65 % (59 to 71) under the baseline, 23 percentage points more (19 to 28), and the objective "
        "gains 0.16 bits per vehicle (0.01 to 0.31)."
    )
    own = result_of(RunFolder(stored_runs / "searched"))
    assert page.text(page.find("p", **{"class": "answer"})[0]) == answer(own)
    figures = dict(key_figures(result))
    assert figures["detectable on held-out traffic (90 %: 83 to 93)"] == "65 \N{RIGHTWARDS ARROW} 88 %"
    assert figures["gain in detectable vehicles (90 %: +19 to +28)"] == "+23 percentage points"
    assert figures["gain in objective per vehicle (90 %: +0.01 to +0.31)"] == "+0.16 bits"


@pytest.mark.parametrize(
    ("ends", "decimals"),
    [((83.0, 93.0), 0), ((0.277, 0.390), 2), ((0.0, 0.5), 1), ((-0.1, 0.2), 2), ((94.0, 100.0), 0), ((5.0, 5.0), 3)],
)
def test_a_number_has_the_digits_that_its_interval_allows(ends, decimals):
    assert decimals_of(ends, 3) == decimals


def test_the_answer_hides_no_doubt(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    held, base = result["holdout"] | {"blocks": 6, "interval_90": [0.1, 0.2]}, result["baseline"]
    held |= {"detectable_share_gain_interval_90": [0.1, 0.3]}

    def said(**changes):
        return answer(result | {"holdout": hangs(held, **changes)})

    lost = {"objective_per_vehicle": base["holdout"]["objective_per_vehicle"] - 0.25}
    assert said().startswith("Hang the RS-16 ")
    assert "loses 0.2 bits per vehicle (0.1 to 0.5)" in said(**lost, interval_90=[-0.5, -0.1])
    assert said(**lost).startswith(
        "Held-out traffic does not confirm the search: there the mounting does worse than the baseline; the best "
    )
    assert said(interval_90=[-0.1, 0.2]).startswith("Held-out traffic does not show that this gains anything ")
    for shares in (None, [0.0, 0.3], [-0.1, 0.3]):
        assert said(detectable_share_gain_interval_90=shares).startswith(
            "Held-out traffic shows a gain in the objective, but not that more vehicles become detectable; the best "
        )
    assert said(detectable_share_gain_interval_90=[-0.3, -0.1]).startswith("Held-out traffic does not confirm the ")
    assert said(blocks=5).startswith("Held-out traffic is only 5 blocks of time, too few to be sure of an interval; ")
    assert said(interval_90=None).startswith("Too few blocks of time are held out for an interval; ")
    few = {"detectable_share_interval_90": None, "distinct_vehicles": 9}
    assert said(**few).endswith("; shares have no interval, as there are fewer than 10 different vehicles.")
    assert answer(result | {"objective_as_hung": base["objective_as_hung"]}).startswith(
        "No mounting that was tried is better"
    )
    whole = answer(result_of(RunFolder(stored_runs / "whole")))
    assert whole.startswith("Traffic left out in turn does not confirm the search: there ")
    alone = answer(result_of(RunFolder(stored_runs / "whole")) | {"cross_fitted": None})
    assert alone.startswith("Nothing was held out, so this has no independent check; the best mounting found has ")
    assert "on the traffic that was used to choose the mounting" in alone
    assert alone.endswith("there is no interval, as the same traffic has chosen the mounting.")
    given = answer(result_of(RunFolder(stored_runs / "given")))
    assert given.startswith("The RS-16 4.00")
    assert "tilted 3.0° down along the nearest lane, with its traffic, turned 5.0°" in given


def test_a_sensor_of_ones_own_is_named_as_a_name(stored_runs):
    result = result_of(RunFolder(stored_runs / "searched"))
    assert ' has the LiDAR "own" ' in answer(result | {"sensor": "own"})


@pytest.mark.parametrize(("share", "said"), [(0.0, "No vehicle is"), (1.0, "Every vehicle is"), (0.5, "")])
def test_a_threshold_that_tells_no_mountings_apart_is_named(stored_runs, share, said):
    result, shares = result_of(RunFolder(stored_runs / "searched")), {"detectable_share": share}
    base = result["baseline"] | {"holdout": hangs(result["baseline"]["holdout"], **shares)}
    found = " ".join(cautions(result | {"holdout": hangs(result["holdout"], **shares), "baseline": base}))
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
