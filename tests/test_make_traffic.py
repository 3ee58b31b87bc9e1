"""scripts/research/make_traffic.py and the file it ships, scenes/i80_sample.csv.gz."""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import MissingExtraError

pd = pytest.importorskip("pandas")

import tests.research  # noqa: F401
import make_traffic as script

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "scenes" / "i80_sample.csv.gz"
HEADER = (
    "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_Length,v_Width,v_Class,v_Vel,"
    "v_Acc,Lane_ID,Preceding,Following,Space_Headway,Time_Headway,Location"
)
FOOT_M = 0.3048


def sumo_is_missing() -> bool:
    try:
        script.find_tool("sumo")
        script.find_tool("netconvert")
    except MissingExtraError:
        return True
    return False


needs_sumo = pytest.mark.skipif(sumo_is_missing(), reason="SUMO is not installed")


@pytest.fixture(scope="module")
def sample():
    return pd.read_csv(SAMPLE)


@pytest.fixture(scope="module")
def instants(sample):
    return sample[sample["Frame_ID"] % 100 == 0]


# The shipped file


def test_the_shipped_file_is_small_and_has_the_portals_header():
    assert SAMPLE.stat().st_size <= 2e6
    with gzip.open(SAMPLE, "rt", encoding="utf-8") as file:
        assert file.readline().rstrip("\n") == HEADER


def test_every_shipped_row_says_that_it_is_synthetic(sample):
    assert set(sample["Location"]) == {"synthetic-i80"}


def test_it_holds_90_instants_10_s_apart_each_with_two_neighbours(sample):
    centres = 100 * np.arange(1, 91)
    expected = np.sort(np.concatenate([centres - 5, centres, centres + 5]))
    np.testing.assert_array_equal(np.unique(sample["Frame_ID"]), expected)
    assert (sample["Global_Time"] - 100 * sample["Frame_ID"]).nunique() == 1
    assert not sample.duplicated(["Vehicle_ID", "Frame_ID"]).any()


def test_it_is_as_dense_and_slow_as_i80_from_start_to_end(instants):
    count = instants.groupby("Frame_ID").size()
    speed = instants["v_Vel"].mean() * FOOT_M
    assert 120 <= count.mean() <= 140
    assert 7.0 <= speed <= 8.0
    thirds = count.to_numpy().reshape(3, -1).mean(axis=1)
    assert np.all(np.abs(thirds / count.mean() - 1) < 0.2)


def test_its_lanes_slow_down_from_left_to_right(instants):
    speed = instants.groupby("Lane_ID")["v_Vel"].mean() * FOOT_M
    published = pd.Series([13.4, 9.1, 9.2, 6.5, 6.8, 6.4], index=range(1, 7))
    assert (speed.loc[1:6] - published).abs().max() < 1.5


def test_its_traffic_stops_and_goes(instants):
    speed = instants.loc[instants["Lane_ID"].between(2, 6), "v_Vel"] * FOOT_M
    assert (speed < 2).mean() > 0.05
    assert (speed > 12).mean() > 0.05


def test_its_sizes_and_classes_are_those_of_i80(sample):
    vehicles = sample.drop_duplicates("Vehicle_ID")
    assert sample.groupby("Vehicle_ID")[["v_Length", "v_Width", "v_Class"]].nunique().to_numpy().max() == 1
    share = vehicles["v_Class"].value_counts(normalize=True)
    assert 0.03 <= share[3] <= 0.05
    assert 0.01 <= share[1] <= 0.02
    cars = vehicles[vehicles["v_Class"] == 2]
    length = np.percentile(cars["v_Length"] * FOOT_M, [5, 25, 50, 75, 95])
    np.testing.assert_allclose(length, [3.66, 4.21, 4.51, 4.82, 5.55], atol=0.1)
    width = np.percentile(cars["v_Width"] * FOOT_M, [5, 50, 95])
    np.testing.assert_allclose(width, [1.65, 2.10, 2.59], atol=0.06)


def test_its_vehicles_move_as_fast_as_they_say_and_never_jump(sample):
    track = sample.sort_values(["Vehicle_ID", "Frame_ID"])
    step = track.groupby("Vehicle_ID")[["Frame_ID", "Local_X", "Local_Y", "v_Vel"]].diff()
    near = (step["Frame_ID"] == 5).to_numpy()
    mean_speed = (track["v_Vel"] - step["v_Vel"] / 2)[near]
    assert np.abs(step["Local_Y"][near] - 0.5 * mean_speed).max() * FOOT_M < 0.3
    assert step["Local_X"][near].abs().max() * FOOT_M < 0.8


def test_its_vehicles_stay_on_the_road_and_in_the_section(sample):
    past_the_ramp = sample[sample["Local_Y"] * FOOT_M > script.MERGE_END_M]
    assert (sample["Local_X"] - sample["v_Width"] / 2).min() > 0
    assert (past_the_ramp["Local_X"] + past_the_ramp["v_Width"] / 2).max() < 72
    assert sample["Local_Y"].between(0, 1650).all()
    assert set(past_the_ramp["Lane_ID"]) == set(range(1, 7))


def test_its_vehicles_hardly_overlap(instants):
    """Boxes along the road: what a lane change turns them by is less than the gaps kept."""
    overlaps = 0
    for _, frame in instants.groupby("Frame_ID"):
        front, left = frame["Local_Y"].to_numpy(), (frame["Local_X"] - frame["v_Width"] / 2).to_numpy()
        rear, right = front - frame["v_Length"].to_numpy(), left + frame["v_Width"].to_numpy()
        along = np.minimum.outer(front, front) - np.maximum.outer(rear, rear)
        across = np.minimum.outer(right, right) - np.maximum.outer(left, left)
        overlaps += np.count_nonzero(np.triu((along > 0) & (across > 0), k=1))
    assert overlaps <= 2


def test_the_clip_is_20_s_of_the_same_simulation_with_the_same_numbers(sample):
    clip = pd.read_csv(SAMPLE.with_name("i80_drive.csv.gz"))
    np.testing.assert_array_equal(np.unique(clip["Frame_ID"]), np.arange(2500, 2701, 5))
    assert clip.groupby("Frame_ID").size().min() > 130
    assert set(clip["Location"]) == {"synthetic-i80"}
    both = sample.merge(clip, on=["Vehicle_ID", "Frame_ID"])
    assert len(both) == sample["Frame_ID"].isin(clip["Frame_ID"]).sum()
    for name in ("Local_X", "Local_Y", "v_Length", "v_Width", "v_Class", "v_Vel"):
        np.testing.assert_array_equal(both[f"{name}_x"], both[f"{name}_y"])


def test_time_headway_of_a_stopped_follower_is_ngsims_9999_99():
    table = pd.DataFrame(
        {"Vehicle_ID": [1, 2, 3], "Frame_ID": 1, "Lane_ID": 2, "Local_Y": [90.0, 60.0, 20.0], "v_Vel": [0.0, 0.0, 10.0]}
    )
    table = script.add_neighbours(table).set_index("Vehicle_ID")
    assert table["Space_Headway"].to_dict() == {1: 0.0, 2: 30.0, 3: 40.0}
    assert table["Time_Headway"].to_dict() == {1: 0.0, 2: 9999.99, 3: 4.0}


def test_drawn_vehicles_fit_their_lane_whatever_their_habits():
    vehicles = script.draw_vehicles(np.random.default_rng(1), script.LEVELS["jammed"], 3600.0)
    reach = vehicles["width_m"] / 2 + vehicles["offset_m"].abs() + script.WEAVE_M
    assert reach.max() <= script.LANE_M / 2
    assert vehicles["depart_s"].is_monotonic_increasing
    assert vehicles.loc[vehicles["kind"] == script.TRUCK, "lane"].min() >= 4


def test_fcd_is_read_at_the_wanted_steps_and_inside_the_section_only(tmp_path):
    vehicle = '<vehicle id="{}" x="{}" y="-1.8" speed="5.0" acceleration="0.1"/>'
    steps = [(900.0, 0, 10.0), (900.5, 1, 10.0), (901.0, 2, -3.0), (901.0, 3, 502.0), (901.0, 4, 503.5)]
    text = "".join(f'<timestep time="{t:.2f}">{vehicle.format(i, x)}</timestep>' for t, i, x in steps)
    (tmp_path / "fcd.xml").write_text(f"<fcd-export>{text}</fcd-export>")
    rows = script.read_fcd(tmp_path / "fcd.xml", {9000: 0, 9010: 10})
    np.testing.assert_allclose(rows, [[0, 0, 10.0, -1.8, 5.0, 0.1], [10, 3, 502.0, -1.8, 5.0, 0.1]])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--every-s", "0.8"], "--every-s 0.8"),
        (["--minutes", "nan"], "--minutes"),
        (["--dense-s", "30", "20"], "--dense-s 30 20"),
        (["--out", "nowhere/there.csv"], "--out: nowhere/there.csv"),
    ],
)
def test_a_wrong_option_exits_2_with_one_line_that_names_it(options, named, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = script.main(["--out", "x.csv", *options])
    err = capsys.readouterr().err
    assert code == 2
    assert err.count("\n") == 1
    assert named in err
    assert list(tmp_path.iterdir()) == []


def test_without_sumo_it_exits_2_and_names_the_extra(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sumo", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("SUMO_HOME", raising=False)
    assert script.main(["--out", str(tmp_path / "x.csv")]) == 2
    assert 'pip install "blender_lidar[sumo]"' in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@needs_sumo
def test_a_short_real_run_has_the_layout_and_repeats_with_its_seed(tmp_path):
    options = ["--level", "free", "--minutes", "0.5", "--every-s", "5"]
    for name, seed in (("a.csv", 7), ("b.csv", 7), ("c.csv", 8)):
        assert script.main(["--out", str(tmp_path / name), "--seed", str(seed), *options]) == 0
    a, b, c = ((tmp_path / f"{name}.csv").read_bytes() for name in "abc")
    assert a == b
    assert a != c
    table = pd.read_csv(tmp_path / "a.csv")
    assert ",".join(table.columns) == HEADER
    assert sorted(set(table["Frame_ID"])) == sorted(50 * k + s for k in range(1, 7) for s in (-5, 0, 5))
    assert table["v_Vel"].mean() * FOOT_M > 15
    assert (table.groupby("Vehicle_ID")["Total_Frames"].transform("size") == table["Total_Frames"]).all()
