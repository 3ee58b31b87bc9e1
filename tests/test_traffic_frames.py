"""Frames to search on, frames to judge by: nothing that chose a mounting judges it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from blender_lidar.errors import InputError
from blender_lidar.statistics import FEWEST_BLOCKS
from blender_lidar.traffic import RepairReport, instants, plan_frames, well_populated_frames
from blender_lidar.traffic.frames import few_vehicles
from blender_lidar.traffic.vehicles import Recording

pytestmark = pytest.mark.versions

REGION_M = 50.0
SPEED_M_S = 10.0
TRANSIT_S = 2 * REGION_M / SPEED_M_S


def stream(time_s, frames=None, headway_s=2.0, speed_m_s=SPEED_M_S, first_s=-100.0, last_s=1e9):
    """Vehicles that pass x = 0 every `headway_s`, from `first_s` to `last_s`, seen from -300 m to 300 m."""
    time_s = np.asarray(time_s, dtype=float)
    frames = np.round(time_s * 10).astype(int) if frames is None else np.asarray(frames)
    passing = np.arange(first_s, min(last_s, time_s[-1] + 100), headway_s)
    x = (time_s[:, None] - passing) * speed_m_s
    at, vehicle = np.nonzero(np.abs(x) <= 300)
    n = len(at)
    return Recording.from_rows(
        frame=frames[at],
        time_s=time_s[at],
        vehicle_id=vehicle,
        class_index=np.zeros(n),
        centre_m=np.column_stack([x[at, vehicle], np.full(n, 5.0), np.full(n, 0.75)]),
        size_m=np.tile([4.5, 1.9, 1.5], (n, 1)),
        heading_rad=np.zeros(n),
        lane=np.ones(n),
        time_step_s=0.1,
        source="stream",
        report=RepairReport(),
    )


def counted(vehicles):
    return np.abs(vehicles.centre_m[:, 0]) <= REGION_M


def counted_ids(recording, frames, counts=counted):
    every = map(recording.at, frames)
    return {number for vehicles in every for number in vehicles.vehicle_id[counts(vehicles)].tolist()}


@pytest.fixture(scope="module")
def recording():
    return stream(np.arange(0, 300, 0.5))


def times(recording, frames):
    return recording.frame_time_s[np.searchsorted(recording.frames, frames)]


def assert_plan_is_sound(plan, recording):
    assert np.isin(plan.search, recording.frames).all()
    assert np.isin(plan.holdout, recording.frames).all()
    assert not set(plan.search) & set(plan.holdout)
    assert (np.diff(plan.search) > 0).all()
    assert (np.diff(plan.holdout) > 0).all()
    for frames, block in ((plan.search, plan.search_block), (plan.holdout, plan.holdout_block)):
        assert len(frames) == len(block)
        assert set(block) == set(range(len(set(block))))
        assert (np.diff(block) >= 0).all()
    assert plan.searched_ids.tolist() == sorted(counted_ids(recording, plan.search))


def test_the_first_part_is_searched_and_the_rest_held_out_a_block_later(recording):
    plan = plan_frames(recording, counted, count=40)
    assert_plan_is_sound(plan, recording)
    assert len(plan.search) == 40
    search, holdout = times(recording, plan.search), times(recording, plan.holdout)
    assert search[-1] < 0.6 * 300
    assert holdout[0] >= 0.6 * 300 + plan.block_s
    assert holdout[-1] > 300 - 10
    np.testing.assert_allclose(np.diff(search), 4.5, atol=0.51)
    np.testing.assert_allclose(np.diff(holdout), 4.5, atol=0.51)
    assert not plan.notes


def test_a_block_is_longer_than_a_transit_and_holds_several_seconds(recording):
    plan = plan_frames(recording, counted, count=40)
    assert TRANSIT_S <= plan.block_s <= TRANSIT_S + 2
    fast = stream(np.arange(0, 300, 0.5), speed_m_s=50.0)
    assert plan_frames(fast, counted).block_s == 5.0
    assert plan_frames(recording, counted, block_s=17.0).block_s == 17.0


def test_frames_of_different_blocks_are_cut_at_its_multiples(recording):
    plan = plan_frames(recording, counted, count=60)
    search = times(recording, plan.search)
    for number in range(plan.search_block[-1]):
        of_block = search[plan.search_block == number]
        assert of_block[-1] - of_block[0] < plan.block_s
    last = search[plan.search_block == plan.search_block[-1]]
    assert last[-1] - last[0] < 2 * plan.block_s, "what is left over joins the last block"


def test_no_vehicle_counts_in_both_halves(recording):
    plan = plan_frames(recording, counted, count=40)
    assert not counted_ids(recording, plan.search) & counted_ids(recording, plan.holdout)


@settings(max_examples=40)
@given(
    length=st.integers(20, 400),
    count=st.integers(1, 80),
    holdout=st.floats(0, 0.9),
    headway=st.floats(1.0, 5.0),
    block=st.one_of(st.none(), st.floats(5.0, 60.0)),
)
def test_every_plan_is_sound(length, count, holdout, headway, block):
    recording = stream(np.arange(0, length, 1.0), headway_s=headway)
    plan = plan_frames(recording, counted, count=count, holdout=holdout, block_s=block)
    assert_plan_is_sound(plan, recording)
    if len(plan.holdout):
        assert times(recording, plan.holdout)[0] - times(recording, plan.search)[-1] >= plan.block_s - 1e-6
        assert plan.holdout_block[-1] >= 1
    elif holdout:
        assert any(note.startswith("nothing is held out") for note in plan.notes)
    repeat = plan_frames(recording, counted, count=count, holdout=holdout, block_s=block)
    np.testing.assert_array_equal(plan.search, repeat.search)
    np.testing.assert_array_equal(plan.holdout, repeat.holdout)


def test_spacing_takes_the_nearest_frames(recording):
    plan = plan_frames(recording, counted, spacing_s=7.3, holdout=0.0)
    np.testing.assert_allclose(times(recording, plan.search), np.arange(0, 299.5, 7.3), atol=0.26)
    assert len(plan_frames(recording, counted, spacing_s=7.3, count=5).search) == 5


def test_never_more_frames_than_there_are(recording):
    plan = plan_frames(recording, counted, count=10_000)
    assert len(plan.search) == 360
    assert any("360 frames instead of 10000" in note for note in plan.notes)


def test_without_holdout_the_whole_recording_is_searched(recording):
    plan = plan_frames(recording, counted, count=40, holdout=0.0)
    assert_plan_is_sound(plan, recording)
    assert len(plan.holdout) == len(plan.holdout_block) == 0
    assert times(recording, plan.search)[-1] > 290
    assert not plan.notes


def test_a_short_recording_holds_nothing_out_and_says_so():
    short = stream(np.arange(0, 60, 0.5))
    plan = plan_frames(short, counted, count=20)
    assert len(plan.holdout) == 0
    assert times(short, plan.search)[-1] > 55, "then all of it is searched"
    assert plan.notes == (
        "nothing is held out: the recording has 60 s, 110 s are needed for an interval (blocks of 11 s, longer than a "
        "transit); raise [traffic] holdout, or lower block_s, with intervals that may be too narrow",
    )


def with_standing(recording, vehicles, until_s=np.inf):
    """The same with some vehicles that stand in the region from the start."""
    frames = recording.frames[recording.frame_time_s <= until_s]
    count = len(frames) * vehicles
    columns = {
        "frame": np.repeat(frames, vehicles),
        "time_s": np.repeat(recording.frame_time_s[: len(frames)], vehicles),
        "vehicle_id": np.tile(10_000 + np.arange(vehicles), len(frames)),
        "class_index": np.zeros(count),
        "centre_m": np.tile([1.0, 5.0, 0.75], (count, 1)),
        "size_m": np.tile([4.5, 1.9, 1.5], (count, 1)),
        "heading_rad": np.zeros(count),
        "lane": np.ones(count),
    }
    own = {name: getattr(recording, name) for name in columns if name != "time_s"}
    own["time_s"] = np.repeat(recording.frame_time_s, recording.counts)
    return Recording.from_rows(
        **{name: np.concatenate([own[name], columns[name]]) for name in columns},
        time_step_s=0.1,
        source="stream",
        report=RepairReport(),
    )


def test_a_queue_that_stood_there_from_the_start_makes_longer_blocks(recording):
    """A tenth of all vehicles: whole transits alone would make blocks of 11 s."""
    assert plan_frames(recording, counted).block_s == 11.0
    assert plan_frames(with_standing(recording, 20, until_s=59.5), counted).block_s == 60.0


def test_vehicles_that_are_parked_all_the_time_change_no_block(recording):
    plan = plan_frames(with_standing(recording, 20), counted)
    assert plan.block_s == 11.0
    assert len(np.unique(plan.holdout_block)) >= FEWEST_BLOCKS
    assert {*range(10_000, 10_020)} <= {*plan.searched_ids.tolist()}


@pytest.mark.parametrize(
    ("searched", "judging", "message"),
    [
        (10, 10, None),
        (10, None, None),
        (9, 10, "few different vehicles: 9 in the searched frames and 10 in the held-out ones; with fewer than 10"),
        (10, 1, "few different vehicles: 10 in the searched frames and 1 in the held-out ones; with fewer than 10"),
        (1, None, "few different vehicles: 1 in the searched frames; with fewer than 10 an answer may be chance"),
    ],
)
def test_few_different_vehicles_are_told(searched, judging, message):
    note = few_vehicles(searched, judging)
    assert note is None if message is None else note.startswith(message)


def test_listed_frames_are_all_searched_and_judged_by_later_ones(recording):
    ids = [100, 150, 125, 100]
    plan = plan_frames(recording, counted, ids=ids)
    assert_plan_is_sound(plan, recording)
    assert plan.search.tolist() == [100, 125, 150]
    assert times(recording, plan.holdout)[0] >= 15.0 + plan.block_s
    assert not counted_ids(recording, plan.search) & counted_ids(recording, plan.holdout)


def test_listed_frames_at_the_end_are_judged_by_earlier_ones(recording):
    plan = plan_frames(recording, counted, ids=[2800, 2900])
    assert_plan_is_sound(plan, recording)
    assert times(recording, plan.holdout)[-1] <= 280.0 - plan.block_s
    assert plan_frames(recording, counted, ids=[2800, 2900], holdout=0.0).holdout.size == 0
    everywhere = plan_frames(recording, counted, ids=[0, 1500, 2990])
    assert everywhere.holdout.size == 0
    assert everywhere.notes[0].startswith("nothing is held out")


def test_thin_ends_are_skipped_and_said():
    thin = stream(np.arange(0, 400, 0.5), first_s=80.0, last_s=330.0)
    kept = well_populated_frames(thin)
    counts = thin.counts[np.isin(thin.frames, kept)]
    assert counts.min() >= 0.5 * np.median(thin.counts)
    assert thin.frames[0] < kept[0]
    assert kept[-1] < thin.frames[-1]
    plan = plan_frames(thin, counted, count=30)
    assert plan.search[0] >= kept[0]
    assert plan.holdout[-1] <= kept[-1]
    assert "less than half the median traffic" in plan.notes[0]


def test_a_lull_in_the_middle_is_kept():
    thin = stream(np.arange(0, 300, 0.5))
    lull = (thin.frame > 1400) & (thin.frame < 1500) & (thin.vehicle_id % 4 > 0)
    columns = ("frame", "vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane")
    with_lull = Recording.from_rows(
        **{name: getattr(thin, name)[~lull] for name in columns},
        time_s=thin.frame[~lull] * 0.1,
        time_step_s=0.1,
        source="lull",
        report=RepairReport(),
    )
    assert well_populated_frames(with_lull).tolist() == thin.frames.tolist()


def test_of_clustered_frames_only_the_middle_ones_are_instants():
    centres = np.arange(10.0, 910.0, 10.0)
    clustered = stream((centres[:, None] + [-0.5, 0.0, 0.5]).ravel())
    np.testing.assert_array_equal(instants(clustered), np.round(centres * 10).astype(int))
    plan = plan_frames(clustered, counted, count=30)
    assert_plan_is_sound(plan, clustered)
    assert np.isin(plan.search, instants(clustered)).all()
    assert np.isin(plan.holdout, instants(clustered)).all()
    assert len(plan.search) == 30
    assert plan_frames(clustered, counted, ids=[95, 100]).search.tolist() == [95, 100], "asked for by name"


@pytest.mark.parametrize(
    "time_s",
    [
        np.arange(0, 60, 0.1),
        np.arange(0, 900, 10.0),
        np.array([0.0]),
        np.array([0.0, 0.5]),
        np.concatenate([np.arange(0, 30.05, 0.1), np.arange(31, 61.05, 0.1)]),
        np.array([0.0, 0.5, 10.0, 10.5]),
        np.array([0.0, 0.5, 1.0, 10.0, 10.5, 11.0, 20.0]),
    ],
)
def test_frames_that_are_not_clustered_alike_are_all_instants(time_s):
    recording = stream(time_s)
    np.testing.assert_array_equal(instants(recording), recording.frames)


def test_a_single_frame_can_be_planned():
    one = stream([5.0])
    plan = plan_frames(one, counted, count=3)
    assert_plan_is_sound(plan, one)
    assert (plan.search.tolist(), len(plan.notes)) == ([50], 2)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            {"ids": [100, 101, 102]},
            r"stream: no frame 101; the recording has 600 frames from 0 to 2995, 100 is the nearest",
        ),
        ({"spacing_s": -1.0}, r"the spacing of frames is -1\.0 s"),
        ({"block_s": float("nan")}, "the length of a block is nan s"),
        ({"spacing_s": 1e-9}, r"the spacing of frames is 1e-09 s; at least 0\.001 is needed"),
    ],
)
def test_settings_out_of_range(recording, settings, text):
    with pytest.raises(InputError, match=text):
        plan_frames(recording, counted, **settings)
