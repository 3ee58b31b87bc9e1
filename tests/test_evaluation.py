"""Scores over many frames: the sums, the same whatever the number of processes, and clean ends when one goes wrong."""

from __future__ import annotations

import errno
import math
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from multiprocessing.context import SpawnProcess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from blender_lidar.casting import is_available
from blender_lidar.errors import InputError, WorkerError
from blender_lidar.run.vehicle_table import VEHICLE_COLUMNS, distance_bands, lanes, vehicle_table, vehicle_tables
from blender_lidar.run.verdict import judge
from blender_lidar.scene.mounting import Mounting
from blender_lidar.scene.observation import Observation, Scoring
from blender_lidar.scene.settings import ModelSettings
from blender_lidar.scoring.evaluation import Evaluator, Totals, Workplace, mapped_by, workplace_of
from blender_lidar.scoring.fidelity import Fidelity, coarse_observation
from blender_lidar.scoring.frame_scorer import FrameScorer, singles
from blender_lidar.scoring.workers import MappedWorkers, Workers
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.lidar import Lidar
from blender_lidar.sensors.model import load_model
from tests.sample_traffic import counted_frames
from tests.waiting import WAIT_S, wait_for

pytestmark = pytest.mark.versions

SEEN = Observation((Lidar(beam_lattice(load_model("RS-16"), stride=20), 40.0, 0.4),), "exact", "body", 0.05)
SCORING = Scoring(0.005, "mean", -1.0, "corrected")
MOUNTINGS = [
    Mounting(height_m=2.0),
    Mounting(height_m=4.1, tilt_x=0.33),
    Mounting(height_m=3.0, tilt_x=0.1, tilt_y=0.1, yaw=0.4),
]
LAYOUTS, POSES = [(one,) for one in MOUNTINGS], [one.pose for one in MOUNTINGS]


FRAMES = counted_frames(5)
ROOT = str(Path(__file__).parents[1])


@pytest.fixture(scope="module")
def alone() -> Totals:
    with Evaluator(FRAMES, SEEN, SCORING) as evaluator:
        return evaluator.totals(LAYOUTS)


@pytest.fixture(scope="module")
def pair():
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(2)) as evaluator:
        yield evaluator


def test_one_worker_and_two_give_the_same_bits(alone, pair):
    for _ in range(2):  # with trees new and kept
        together = pair.totals(LAYOUTS)
        for mine, theirs in zip(alone, together, strict=True):
            assert mine.dtype == theirs.dtype
            assert mine.tobytes() == theirs.tobytes()


def test_any_map_gives_the_same_bits(alone):
    with mapped_by(map), Evaluator(FRAMES[:1], SEEN, SCORING) as evaluator:
        assert isinstance(workplace_of(ModelSettings()).employ(abs, 1), MappedWorkers)
        assert isinstance(evaluator.workers, Workers)  # unless it is asked for
    with ThreadPoolExecutor(3) as pool, Evaluator(FRAMES, SEEN, SCORING, Workplace(mapping=pool.map)) as evaluator:
        for _ in range(2):
            for mine, theirs in zip(evaluator.totals(LAYOUTS), alone, strict=True):
                assert mine.tobytes() == theirs.tobytes()
    assert isinstance(workplace_of(ModelSettings()).employ(abs, 1), Workers)
    with pytest.raises(InputError, match=r"^mapped_by: is 3; allowed: a function"), mapped_by(3):
        pass


@pytest.mark.parametrize("chosen", [(0,), (3, 1), (4, 0, 2, 1, 3)])
def test_some_of_the_frames_score_as_they_do_among_all_in_the_order_asked_for(alone, pair, chosen):
    some = pair.totals(LAYOUTS, chosen)
    for mine, theirs in zip(some, alone, strict=True):
        assert np.array_equal(mine, theirs[..., list(chosen)])


def test_a_coarser_fidelity_scores_as_an_evaluator_of_its_own_observation_does():
    whole = SEEN.with_lidar(lattice=beam_lattice(load_model("RS-16"), stride=1))
    fidelity = Fidelity("box", stride=40)
    with Evaluator(FRAMES, whole, SCORING) as evaluator:
        coarse = evaluator.totals(LAYOUTS, (2, 0), fidelity)
    with Evaluator([FRAMES[2], FRAMES[0]], coarse_observation(whole, fidelity), SCORING) as evaluator:
        expected = evaluator.totals(LAYOUTS)
    for mine, theirs in zip(coarse, expected, strict=True):
        assert np.array_equal(mine, theirs)


@pytest.mark.parametrize("caster", ["raster", "embree", "bvh"])
def test_one_worker_and_two_give_the_same_bits_with_every_caster(caster):
    """The one worker comes first, so that this process has loaded the caster's library when the others start."""
    if not is_available(caster):
        pytest.skip(f"the library of {caster} is not installed")
    found = []
    for workers in (1, 2):
        with Evaluator(FRAMES, replace(SEEN, caster=caster), SCORING, Workplace(workers)) as evaluator:
            found.append(evaluator.totals(LAYOUTS).objective.tobytes())
    assert found[0] == found[1]


def test_a_mounting_has_the_same_score_whatever_else_is_asked(alone, pair):
    for number, layout in enumerate(LAYOUTS):
        np.testing.assert_array_equal(pair.totals([layout]).objective[0], alone.objective[number])
    np.testing.assert_array_equal(pair.totals(LAYOUTS[::-1]).detectable, alone.detectable[::-1])


def test_totals_are_the_sums_of_equations_10_and_11_over_each_frame(alone):
    for column, frame in enumerate(FRAMES):
        seen = FrameScorer(frame, SEEN).see(singles(POSES))
        for row in range(len(POSES)):
            bits, found = 0.0, 0
            for shares in seen.occupancy[row].tolist():
                if sum(shares) / 3.0 >= 0.005:
                    bits -= sum(p * math.log2(p) for p in shares if p > 0.0)
                    found += 1
                else:
                    bits -= 1.0
            assert alone.objective[row, column] == pytest.approx(bits, rel=1e-12)
            assert alone.detectable[row, column] == found
        assert alone.vehicles[column] == frame.counted.sum()


def test_shares_are_over_the_vehicles_of_all_frames(alone):
    vehicles = sum(frame.counted.sum() for frame in FRAMES)
    np.testing.assert_allclose(alone.per_vehicle(), alone.objective.sum(axis=1) / vehicles, rtol=1e-12)
    np.testing.assert_allclose(alone.detectable_share(), alone.detectable.sum(axis=1) / vehicles, rtol=1e-12)


def test_the_reading_the_threshold_the_view_and_the_loss_reach_the_score(alone):
    def objective(**changes):
        settings = {"threshold": 0.005, "view": "mean", "loss": -1.0, "reading": "corrected"} | changes
        with Evaluator(FRAMES, SEEN, Scoring(**settings)) as evaluator:
            return evaluator.totals(LAYOUTS)

    missed = alone.vehicles.sum() - alone.detectable.sum(axis=1)
    assert (missed > 0).all()
    total = alone.objective.sum(axis=1)
    np.testing.assert_allclose(objective(loss=-3.0).objective.sum(axis=1), total - 2.0 * missed)
    np.testing.assert_allclose(objective(reading="paper").objective.sum(axis=1), total + 2.0 * missed)
    assert (objective(view="min").detectable.sum(axis=1) < alone.detectable.sum(axis=1)).all()
    assert (objective(threshold=0.0).detectable == alone.vehicles).all()


def test_a_frame_that_does_not_say_which_vehicles_count_counts_all():
    every = [replace(frame, counted=np.ones(len(frame), dtype=bool)) for frame in FRAMES[:2]]
    with (
        Evaluator(every, SEEN, SCORING) as said,
        Evaluator([replace(f, counted=None) for f in every], SEEN, SCORING) as not_said,
    ):
        np.testing.assert_array_equal(said.vehicles, not_said.vehicles)
        np.testing.assert_array_equal(said.weight, not_said.weight)
        np.testing.assert_array_equal(said.totals(LAYOUTS).objective, not_said.totals(LAYOUTS).objective)


def test_more_workers_than_frames_and_no_frames_are_fine():
    with Evaluator(FRAMES[:1], SEEN, SCORING, Workplace(8)) as evaluator:
        assert evaluator.totals(LAYOUTS).objective.shape == (3, 1)
    with Evaluator([], SEEN, SCORING, Workplace(2)) as evaluator:
        assert evaluator.totals(LAYOUTS).objective.shape == (3, 0)
    nothing = replace(FRAMES[0], counted=np.zeros(len(FRAMES[0]), dtype=bool))
    with Evaluator([nothing, FRAMES[0]], SEEN, SCORING) as evaluator:
        assert evaluator.totals(LAYOUTS).objective[:, 0].tolist() == [0.0, 0.0, 0.0]


def leaves_ctrl_c_alone(process):
    """Whether a process ignores or blocks SIGINT; a worker does so once it has started."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    masks = [int(line.split()[1], 16) for line in status.splitlines() if line.startswith(("SigIgn", "SigBlk"))]
    return any(mask >> (signal.SIGINT - 1) & 1 for mask in masks)


def stop_while_working(children):
    """What Ctrl-C does: a terminal sends SIGINT to the parent and to its children."""
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(2)) as evaluator:
        evaluator.workers.await_ready()
        children += multiprocessing.active_children()
        assert all(map(leaves_ctrl_c_alone, children))
        for child in children:
            os.kill(child.pid, signal.SIGINT)
        assert evaluator.totals(LAYOUTS[:1]).objective.shape == (1, 5)
        raise KeyboardInterrupt


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc to look at a process's signals")
def test_workers_leave_ctrl_c_to_the_parent_and_end_with_it():
    before = set(multiprocessing.active_children())
    children = []
    with pytest.raises(KeyboardInterrupt):
        stop_while_working(children)
    assert len(set(children) - before) == 1  # this process works as well
    assert not any(child.is_alive() for child in set(children) - before)


def test_ctrl_c_while_the_workers_end_waits_until_they_have(monkeypatch):
    """As when it is pressed twice: the first ends the search, the second comes while workers finish what they do."""
    before = set(multiprocessing.active_children())
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    evaluator = Evaluator(FRAMES, SEEN, SCORING, Workplace(3)).__enter__()
    evaluator.workers.await_ready()
    children = set(multiprocessing.active_children()) - before
    executor = evaluator.workers._executor
    shutdown = executor.shutdown

    def interrupted(**how):
        signal.raise_signal(signal.SIGINT)
        shutdown(**how)

    monkeypatch.setattr(executor, "shutdown", interrupted)
    try:
        with pytest.raises(KeyboardInterrupt):
            evaluator.__exit__(None, None, None)
        assert len(children) == 2
        assert not any(child.is_alive() for child in children)
    finally:
        signal.signal(signal.SIGINT, handler)
        shutdown(wait=True, cancel_futures=True)


def totals_until_refused(evaluator):
    """The pool notices a dead worker a moment later, or when it is next asked."""
    for _ in range(200):
        evaluator.totals(LAYOUTS[:1])
        time.sleep(0.05)


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="has no SIGKILL")
def test_a_worker_that_is_killed_is_one_line():
    before = set(multiprocessing.active_children())
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(3)) as evaluator:
        evaluator.workers.await_ready()
        children = set(multiprocessing.active_children()) - before
        os.kill(next(iter(children)).pid, signal.SIGKILL)
        with pytest.raises(WorkerError, match="worker process ended abruptly") as failure:
            totals_until_refused(evaluator)
    assert "\n" not in str(failure.value)
    assert not any(child.is_alive() for child in children)


def program(body):
    """Another Python on its standard input: what it says, line by line, is read with `.stdout`."""
    head = """
        from blender_lidar.errors import WorkerError
        from blender_lidar.scoring.evaluation import Evaluator, Workplace
        from tests.test_evaluation import FRAMES, SCORING, SEEN, counted_frames
        """
    return textwrap.dedent(head) + textwrap.dedent(body)


def test_a_system_that_lets_only_some_workers_start_is_an_error_and_no_hang(monkeypatch):
    before, start, started = set(multiprocessing.active_children()), SpawnProcess.start, []

    def start_one(process):
        if started:
            raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
        started.append(process)
        start(process)

    monkeypatch.setattr(SpawnProcess, "start", start_one)
    with pytest.raises(WorkerError, match="3 worker processes cannot be started: Resource temporarily unavailable"):
        Evaluator(FRAMES, SEEN, SCORING, Workplace(4)).__enter__()
    assert len(started) == 1
    assert not set(multiprocessing.active_children()) - before


def test_nothing_stays_of_what_workers_read_when_they_start_nor_of_workers_that_were_starting(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    before = set(multiprocessing.active_children())
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(3)):
        children = set(multiprocessing.active_children()) - before
    assert len(children) == 2
    assert not any(child.is_alive() for child in children)
    assert not list(tmp_path.iterdir())
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(2)) as evaluator:
        assert len(list(tmp_path.glob("blender_lidar-*"))) == 1
        evaluator.workers.await_ready()
        assert not list(tmp_path.glob("blender_lidar-*"))
        assert evaluator.totals(LAYOUTS[:1]).objective.shape == (1, 5)


@pytest.mark.skipif(not is_available("bvh"), reason="the library of bvh is not installed")
def test_workers_start_from_a_program_that_has_imported_bpy(tmp_path):
    path = tmp_path / "run.py"
    body = """
        import sys
        if __name__ == "__main__":
            before = list(sys.path)
            with Evaluator(FRAMES, SEEN, SCORING, Workplace(2)) as evaluator:
                evaluator.workers.await_ready()
                print("started", sys.path == before)
        """
    path.write_text("import bpy\n" + program(body))
    paths = os.environ | {"PYTHONPATH": ROOT}
    done = subprocess.run([sys.executable, path], cwd=ROOT, env=paths, capture_output=True, text=True, timeout=WAIT_S)
    assert "started True" in done.stdout, done.stderr


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to look at other processes")
def test_workers_end_when_their_parent_is_killed(tmp_path):
    path = tmp_path / "run.py"
    body = """
        import multiprocessing, time
        if __name__ == "__main__":
            with Evaluator(FRAMES, SEEN, SCORING, Workplace(3)):
                print(*(child.pid for child in multiprocessing.active_children()), flush=True)
                time.sleep(600)
        """
    path.write_text(program(body))
    run = subprocess.Popen(
        [sys.executable, path], cwd=ROOT, env=os.environ | {"PYTHONPATH": ROOT}, stdout=subprocess.PIPE, text=True
    )
    with run:
        workers = [int(number) for number in run.stdout.readline().split()]
        run.kill()
    try:
        assert len(workers) == 2
        wait_for(lambda: not any(map(is_running, workers)), "for the workers to end")
    finally:
        for worker in filter(is_running, workers):
            os.kill(worker, signal.SIGKILL)


def test_nobody_waits_for_workers_that_are_starting(alone):
    """The start of another process takes a second, and this one can do the work meanwhile."""
    before = set(multiprocessing.active_children())
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(2)) as evaluator:
        (child,) = set(multiprocessing.active_children()) - before
        os.kill(child.pid, signal.SIGSTOP)  # it will never come
        try:
            together = evaluator.totals(LAYOUTS)
        finally:
            os.kill(child.pid, signal.SIGCONT)
    assert together.objective.tobytes() == alone.objective.tobytes()


def is_running(process_id):
    """Whether there is such a process, other than one that has ended and waits to be fetched."""
    try:
        return Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_starting_workers_leaves_the_environment_as_it_was(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with Evaluator(FRAMES, SEEN, SCORING, Workplace(2)):
        assert os.environ["OMP_NUM_THREADS"] == "3"
        assert "OPENBLAS_NUM_THREADS" not in os.environ


def test_the_vehicle_table_adds_up_to_the_totals(alone):
    table = vehicle_table(LAYOUTS[1], search=Evaluator(FRAMES, SEEN, SCORING))
    assert tuple(table) == VEHICLE_COLUMNS
    assert {len(column) for column in table.values()} == {alone.vehicles.sum()}
    score = np.where(table["detectable"], table["entropy_bits"], -1.0)
    for column in range(len(FRAMES)):
        mine = table["frame"] == column
        assert score[mine].sum() == pytest.approx(alone.objective[1, column], rel=1e-12)
        assert table["detectable"][mine].sum() == alone.detectable[1, column]
    np.testing.assert_allclose(table["distance_m"], np.hypot(table["x_m"], table["y_m"]))
    assert set(table["split"]) == {"search"}
    assert set(table["class"]) <= {"car", "van", "truck", "bus", "motorcycle"}


def test_both_splits_stand_in_one_table_and_frames_in_which_nobody_counts_in_none():
    searched, held_out = FRAMES[:2], FRAMES[2:3]
    alone = vehicle_table(LAYOUTS[0], search=Evaluator(searched, SEEN, SCORING))
    nobody = replace(FRAMES[0], counted=np.zeros(len(FRAMES[0]), dtype=bool))
    for empty in ([], [nobody]):
        evaluator = Evaluator(searched, SEEN, SCORING, held_out=empty)
        table = vehicle_table(LAYOUTS[0], search=evaluator, holdout=evaluator.held_out)
        for name in VEHICLE_COLUMNS:
            np.testing.assert_array_equal(table[name], alone[name])
            assert table[name].dtype == alone[name].dtype
    evaluator = Evaluator(searched, SEEN, SCORING, held_out=held_out)
    both = vehicle_table(LAYOUTS[0], search=evaluator, holdout=evaluator.held_out)
    assert both["split"].tolist() == ["search"] * len(alone["frame"]) + ["holdout"] * FRAMES[2].counted.sum()
    np.testing.assert_array_equal(both["points"][: len(alone["frame"])], alone["points"])


def test_distances_and_lanes_sort_every_vehicle_into_one_group():
    table = vehicle_table(LAYOUTS[0], search=Evaluator(FRAMES, SEEN, SCORING))
    for groups in (distance_bands(table), lanes(table)):
        assert np.sum([mine for _, mine in groups], axis=0).tolist() == [1] * len(table["frame"])
        assert len({name for name, _ in groups}) == len(groups)
    for name, mine in distance_bands(table):
        low, high = (float(number) for number in name.removesuffix(" m").split("-"))
        assert ((table["distance_m"][mine] >= low) & (table["distance_m"][mine] < high)).all()


def test_a_lane_number_of_both_directions_is_two_lanes():
    heading = np.array([0.0, -3.0, 179.0, -178.0, 2.0, 1.0])
    table = {"lane": np.array([1, 1, 1, 1, 2, 0]), "heading_deg": heading}
    names = {name: np.flatnonzero(rows).tolist() for name, rows in lanes(table)}
    assert names == {"no lane": [5], "lane 1, towards +x": [0, 1], "lane 1, towards -x": [2, 3], "lane 2": [4]}


@pytest.mark.parametrize("axis_deg", [0.0, 45.0, 90.0, 133.0])
@pytest.mark.parametrize(("against", "lanes_found"), [(0, 1), (2, 1), (100, 2)])
def test_a_lane_of_any_direction_is_one_until_enough_drive_against_it(axis_deg, against, lanes_found):
    heading = axis_deg + np.random.default_rng(1).normal(0.0, 2.0, 1000) + 180.0 * (np.arange(1000) < against)
    found = lanes({"lane": np.ones(1000, dtype=int), "heading_deg": heading})
    assert len(found) == lanes_found
    assert sorted(int(rows.sum()) for _, rows in found) == ([1000] if lanes_found == 1 else [against, 1000 - against])


def verdict(holdout, block):
    plan = {"search_block": np.arange(len(FRAMES)), "holdout_block": np.array(block, dtype=np.int64)}
    plan |= {name.replace("block", "recording"): np.zeros_like(of) for name, of in plan.items()}
    plan |= {"search": np.array([one.frame for one in FRAMES]), "holdout": np.array([one.frame for one in holdout])}
    scenario = SimpleNamespace(recordings=("one",), search=SimpleNamespace(seed=1))
    site = SimpleNamespace(plan=SimpleNamespace(**plan), scenario=scenario, scoring=SCORING, holdout=holdout)
    with Evaluator(FRAMES, SEEN, SCORING, held_out=holdout) as evaluator:
        layouts = {"optimised": LAYOUTS[1], "baseline": LAYOUTS[0]}
        tables = vehicle_tables(list(layouts.values()), search=evaluator, holdout=evaluator.held_out)
        return judge(site, layouts, dict(zip(layouts, tables, strict=True)), evaluator, 1)[0]


def test_the_verdict_is_the_gain_over_the_baseline_on_held_out_frames(alone):
    held_out = counted_frames(6, seed=50)
    found = verdict(held_out, [0, 0, 1, 1, 2, 2])
    assert found["optimised"]["objective"] == pytest.approx(alone.objective[1].sum())
    assert found["baseline"]["objective_per_vehicle"] == pytest.approx(alone.per_vehicle()[0])
    with Evaluator(held_out, SEEN, SCORING) as evaluator:
        judged = evaluator.totals([LAYOUTS[1], LAYOUTS[0]])
    mine = found["optimised"]["holdout"]
    gain = judged.per_vehicle()[0] - judged.per_vehicle()[1]
    assert mine["gain_over_baseline"] == pytest.approx(gain, rel=1e-12)
    assert mine["interval_90"][0] < gain < mine["interval_90"][1]
    assert (mine["frames"], mine["blocks"], mine["vehicles"]) == (6, 3, judged.vehicles.sum())
    assert found["baseline"]["holdout"]["gain_over_baseline"] == 0.0
    assert found["baseline"]["holdout"]["interval_90"] == [0.0, 0.0]


def test_a_verdict_without_held_out_vehicles_or_with_few_blocks_says_so():
    nobody = replace(FRAMES[0], counted=np.zeros(len(FRAMES[0]), dtype=bool))
    assert verdict([], [])["optimised"]["holdout"] is None
    assert verdict([nobody], [0])["optimised"]["holdout"] is None
    assert verdict(counted_frames(2, seed=50), [0, 1])["optimised"]["holdout"]["interval_90"] is None
