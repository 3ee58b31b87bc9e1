"""Several recordings, [[traffic]]: each counts by its weight, blocks are resampled within it, the worst is named."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from blender_lidar.errors import InputError
from blender_lidar.run.folder import SCENE, RunFolder
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare, read_recordings
from blender_lidar.toml_table import to_toml
from blender_lidar.traffic import Recording, RepairReport, joined_recordings
from tests.refusals import refused
from tests.report_samples import said
from tests.small_scene import (
    MAPPED,
    REGION,
    SETTINGS,
    cli,
    done,
    traffic_rows,
    without_times,
    write_table,
)

pytestmark = [pytest.mark.usefixtures("quick"), pytest.mark.versions]

MORNING = {"path": "morning.csv", "frames": 6, "holdout": 0.4, "block_s": 10.0}
EVENING = {"path": "evening.csv", "frames": 4, "holdout": 0.5, "block_s": 12.0}
WORDS = ("--workers", 1, "--json")


def scene_of(folder, *recordings, **changes):
    """A scene of some recordings, as `[traffic]` if there is one; their files beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, seed, vehicles in (("morning", 1, 40), ("evening", 2, 15)):
        write_table(folder / f"{name}.csv", traffic_rows(vehicles=vehicles, seed=seed))
    tables = {name: table | changes.get(name, {}) for name, table in ({"objective": {}} | SETTINGS | REGION).items()}
    tables["traffic"] = list(recordings) if len(recordings) > 1 else recordings[0]
    (folder / "scene.toml").write_text(to_toml(tables), encoding="utf-8")
    return folder / "scene.toml"


def evaluated(capsys, scene, out):
    return json.loads(done(capsys, "evaluate", scene, "--height", 3, *WORDS, "--out", out)[0])


def rows_of(folder):
    with (folder / "vehicles.csv").open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_a_vehicle_that_is_left_out_may_be_in_one_of_the_recordings_alone(tmp_path):
    both = load_scenario(scene_of(tmp_path, *({**one, "leave_out": [3, 30]} for one in (MORNING, EVENING))))
    every = read_recordings(load_scenario(scene_of(tmp_path, MORNING, EVENING)))
    assert [{3, 30} & set(one.vehicle_id) for one in every] == [{3, 30}, {3}]
    for one, other in zip(read_recordings(both), every, strict=True):
        assert set(one.vehicle_id) == set(other.vehicle_id) - {3, 30}
    nowhere = load_scenario(scene_of(tmp_path, MORNING | {"leave_out": [987]}, EVENING))
    with pytest.raises(InputError, match=r"morning\.csv, .*evening\.csv has no vehicle 987"):
        read_recordings(nowhere)


@pytest.mark.parametrize(("weights", "counts"), [((1.0, 1.0), (6, 4)), ((3.0, 0.5), (6, 4)), ((1.0, 1.0), (5, 5))])
def test_the_objective_is_the_mean_over_time_by_the_weights_however_many_the_frames(tmp_path, capsys, weights, counts):
    own = [one | {"frames": count} for one, count in zip((MORNING, EVENING), counts, strict=True)]
    alone = [evaluated(capsys, scene_of(tmp_path, one), tmp_path / f"{at}") for at, one in enumerate(own)]
    named = [one | {"weight": weight} for one, weight in zip(own, weights, strict=True)]
    both = evaluated(capsys, scene_of(tmp_path, *named), tmp_path / "both")

    def mean(objective, vehicles, frames):
        shares = [weight / one[frames] for weight, one in zip(weights, found, strict=True)]
        amounts = (
            [one[objective] for one in found]
            if objective in found[0]
            else [one["objective_per_vehicle"] * one[vehicles] for one in found]
        )
        total = sum(share * amount for share, amount in zip(shares, amounts, strict=True))
        return total / sum(share * one[vehicles] for share, one in zip(shares, found, strict=True))

    found = alone
    assert both["objective_per_vehicle"] == pytest.approx(mean("objective", "vehicles", "frames"), rel=1e-12)
    found = [one["holdout"] for one in alone]
    expected = mean("objective", "vehicles", "frames")
    assert both["holdout"]["objective_per_vehicle"] == pytest.approx(expected, rel=1e-12)
    assert both["vehicles"] == sum(one["vehicles"] for one in alone)
    for one, row in zip(alone, both["recordings"], strict=True):
        for key in ("objective_per_vehicle", "detectable_share"):
            assert row[key] == pytest.approx(one[key], rel=1e-12)
            assert row["holdout"][key] == pytest.approx(one["holdout"][key], rel=1e-12)
        assert row["holdout"]["gain_over_baseline"] == pytest.approx(one["holdout"]["gain_over_baseline"], rel=1e-9)
    table = rows_of(tmp_path / "both")
    searched = [row for row in table if row["split"] == "search"]
    weight = np.array([float(row.get("weight", 1.0)) for row in searched])
    bits = np.array([float(row["entropy_bits"]) if row["detectable"] == "1" else -1.0 for row in searched])
    assert weight @ bits / weight.sum() == pytest.approx(both["objective_per_vehicle"], abs=1e-5)


def test_a_vehicle_weighs_its_own_weight_times_that_of_its_recording(tmp_path):
    objective = {"objective": {"class_weights": {"truck": 4.0, "van": 0.5}}}
    weighted = MORNING | {"weight": 2.0}, EVENING
    site = prepare(load_scenario(scene_of(tmp_path, *weighted, **objective)))
    own = [prepare(load_scenario(scene_of(tmp_path / "own", one, **objective))) for one in (MORNING, EVENING)]
    for half in ("search", "holdout"):
        first, second = (getattr(one, half) for one in own)
        factors = [2.0 / len(first)] * len(first) + [1.0 / len(second)] * len(second)
        expected = [factor * frame.weight for factor, frame in zip(factors, first + second, strict=True)]
        found = [frame.weight * 3.0 / len(factors) for frame in getattr(site, half)]
        np.testing.assert_allclose(np.concatenate(found), np.concatenate(expected), rtol=1e-12)


def test_one_table_in_a_list_is_one_recording_to_the_last_digit(tmp_path, capsys):
    alone = evaluated(capsys, scene_of(tmp_path, MORNING), tmp_path / "a")
    text = (tmp_path / "scene.toml").read_text(encoding="utf-8").replace("[traffic]", "[[traffic]]")
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    listed = evaluated(capsys, tmp_path / "scene.toml", tmp_path / "b")
    assert without_times(listed) == without_times(alone)
    assert "recordings" not in listed


def test_two_copies_of_one_recording_score_as_it_does_with_intervals_from_twice_the_blocks(tmp_path, capsys):
    alone = evaluated(capsys, scene_of(tmp_path, MORNING), tmp_path / "a")
    twice = evaluated(capsys, scene_of(tmp_path, MORNING, MORNING | {"name": "again"}), tmp_path / "b")
    assert twice["objective_per_vehicle"] == pytest.approx(alone["objective_per_vehicle"], rel=1e-12)
    assert twice["holdout"]["blocks"] == 2 * alone["holdout"]["blocks"]
    message = "have the same vehicles in the same places: check their paths"
    assert [message in " ".join(one["notes"]) for one in (alone, twice)] == [False, True]
    width = [np.diff(one["holdout"]["interval_90"])[0] for one in (alone, twice)]
    assert 0.4 * width[0] < width[1] < 0.75 * width[0]  # 1 over the root of 2, and more degrees of freedom


def test_frames_and_vehicles_of_the_second_recording_are_counted_on_from_a_power_of_ten(tmp_path):
    site = prepare(load_scenario(scene_of(tmp_path, MORNING, EVENING)))
    own = [prepare(load_scenario(scene_of(tmp_path / "own", one))) for one in (MORNING, EVENING)]
    assert site.plan.search.tolist() == [*own[0].plan.search, *(100 + own[1].plan.search)]
    assert site.plan.search_recording.tolist() == [0] * 6 + [1] * 4
    for half in ("search_block", "holdout_block"):
        first, second = (getattr(one.plan, half) for one in own)
        assert getattr(site.plan, half).tolist() == [*first, *(first.max() + 1 + second)]
    assert set(site.plan.searched_ids) == {*own[0].plan.searched_ids, *(100 + own[1].plan.searched_ids)}
    frame = int(own[1].plan.search[0])
    joined, alone = site.recording.at(100 + frame), own[1].recording.at(frame)
    assert (joined.centre_m == alone.centre_m).all()
    assert (joined.vehicle_id == 100 + alone.vehicle_id).all()
    assert joined.time_s == alone.time_s


@pytest.mark.parametrize("first", [-5, -9, -1000, 0, 7])
def test_frames_of_joined_recordings_stay_apart_whatever_number_they_begin_with(first):
    def recorded(x_m):
        frame = np.arange(first, first + 15)
        columns = {"vehicle_id": np.ones(15), "class_index": np.zeros(15), "heading_rad": np.zeros(15)}
        columns |= {"centre_m": np.full((15, 3), x_m), "size_m": np.ones((15, 3)), "lane": np.zeros(15)}
        given = {"frame": frame, "time_s": 0.1 * frame, "time_step_s": 0.1, "source": "x", "report": RepairReport()}
        return Recording.from_rows(**given, **columns)

    joined = joined_recordings([recorded(0.0), recorded(100.0), recorded(200.0)], ["a", "b", "c"])
    assert len(joined.frames) == 45
    assert (joined.counts == 1).all()
    assert joined.centre_m[:, 0].tolist() == [0.0] * 15 + [100.0] * 15 + [200.0] * 15


def test_a_search_over_two_recordings_resumes_and_its_scene_reads_as_it_was(tmp_path, capsys):
    weighted = MORNING | {"weight": 2.0}, EVENING | {"frames": 12, "block_s": 8.0}
    scene = scene_of(tmp_path, *weighted, **MAPPED, search={"seeds": 1})
    result = json.loads(done(capsys, "optimise", scene, *WORDS, "--out", tmp_path / "run")[0])
    assert [row["name"] for row in result["recordings"]] == ["morning", "evening"]
    again = load_scenario(tmp_path / "run" / SCENE)
    assert [(one.name, one.weight) for one in again.recordings] == [("morning", 2.0), ("evening", 1.0)]
    score_map = RunFolder(tmp_path / "run").read_score_map()
    assert sorted(set(score_map.block_recording)) == [0, 1]
    found = result["map"]["optimum_interval_90"]
    assert found is not None
    assert {key: list(pair) for key, pair in score_map.optimum_intervals_90(result["seed"]).items()} == found
    (tmp_path / "run" / "result.json").unlink()
    resumed = json.loads(done(capsys, "optimise", scene, *WORDS, "--out", tmp_path / "run", "--resume")[0])
    assert without_times(resumed) == without_times(result)
    write_table(tmp_path / "evening.csv", traffic_rows(vehicles=16, seed=2))
    code, _, err = cli(capsys, "optimise", scene, *WORDS, "--out", tmp_path / "run", "--resume")
    assert code == 2
    assert "the run there had [traffic 2] path" in err


def test_the_answer_tells_each_recording_and_which_is_seen_worst(tmp_path, capsys):
    out, _ = done(capsys, "evaluate", scene_of(tmp_path, MORNING, EVENING), "--height", 3, "--out", tmp_path / "run")
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    worst = min(result["recordings"], key=lambda row: row["holdout"]["objective_per_vehicle"])
    assert f"Of the recordings {worst['name']} is worst: {worst['holdout']['objective_per_vehicle']:.4f}" in out
    out, _ = done(capsys, "report", tmp_path / "run", "--all")
    rows = {line.split()[0]: line for line in out.splitlines() if line.startswith(("morning", "evening"))}
    assert set(rows) == {"morning", "evening"}
    words = " ".join(out.split())
    assert "The frames of a recording together count as its weight. The objective per vehicle is the weighted" in words
    assert "; weighted share " in said(result | {"metric": "detectable"}, "answer")
    page = (tmp_path / "run" / "report.html").read_text(encoding="utf-8")
    assert "morning.csv and evening.csv" in page
    assert "Each recording alone" in page


REFUSED = {
    ("--traffic", "morning.csv"): "--traffic: is of one recording, but the scene has 2; allowed: in their [[traffic]]",
    ("--frame-ids", "1,2"): "--frame-ids: is of one recording, but the scene has 2; ",
}


@pytest.mark.parametrize("words", list(REFUSED), ids=" ".join)
def test_an_option_about_one_recording_is_refused_where_there_are_two(tmp_path, capsys, words):
    line = refused(capsys, tmp_path, "evaluate", scene_of(tmp_path, MORNING, EVENING), *words, "--out", tmp_path / "o")
    assert REFUSED[words] in line


def test_an_option_about_all_holds_for_each(tmp_path):
    overrides = {("traffic", "frames"): (3, "--frames"), ("traffic", "accept"): (["sizes"], "--accept")}
    scenario = load_scenario(scene_of(tmp_path, MORNING, EVENING), overrides)
    assert [one.frames for one in scenario.recordings] == [3, 3]
    assert [one.accept for one in scenario.recordings] == [("sizes",)] * 2


@pytest.mark.parametrize(
    ("second", "message"),
    [
        (MORNING, "[[traffic]] 2 name: is 'morning', as of another recording; allowed: a name for each"),
        (EVENING | {"weight": 0.0}, "[[traffic]] 2 weight: is 0.0; allowed: more than 0"),
        (EVENING | {"wieght": 1.0}, "[[traffic]] 2: unknown key 'wieght'; did you mean 'weight'?"),
        ({"frames": 3}, "[[traffic]] 2 path: is missing"),
    ],
)
def test_a_wrong_second_table_is_refused_with_its_number(tmp_path, second, message):
    with pytest.raises(InputError) as error:
        load_scenario(scene_of(tmp_path, MORNING, second))
    assert message in str(error.value)


def test_a_recording_of_which_no_vehicle_counts_is_refused_by_its_name(tmp_path, capsys):
    scene = scene_of(tmp_path, MORNING, EVENING)
    rows = [[*row[:3], row[3] + 500.0, *row[4:]] for row in traffic_rows(vehicles=15, seed=2)]
    write_table(tmp_path / "evening.csv", rows)
    line = refused(capsys, tmp_path, "evaluate", scene, "--height", 3, "--out", tmp_path / "o")
    assert "evening.csv" in line
    assert "morning.csv" not in line


def test_a_study_is_about_one_recording(tmp_path, capsys):
    pytest.importorskip("scipy")
    scene = scene_of(tmp_path, MORNING, EVENING)
    for verb in ("stability", "chart"):
        line = refused(capsys, tmp_path, verb, scene, "--out", tmp_path / "o")
        assert "[[traffic]]: 2 recordings are for optimise and evaluate; a study is about one" in line
