"""The study that asks whether metrics choose mountings that serve a detector: its arithmetic and its kept files."""

from __future__ import annotations

import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.detection.pillars import SHIPPED
from blender_lidar.detection.scores import CRITERIA, MISSED, Matches, average_precision, recall
from blender_lidar.metrics.catalogue import METRICS, PE_VGOP

FRAMES = 24


@pytest.fixture(scope="module")
def study():
    pytest.importorskip("scipy")
    return importlib.import_module("detector_decision")


def found(*confidence):
    """Matches of one frame: vehicles that are found so surely, 0 for missed ones, and no false alarms."""
    sure = np.array(confidence, dtype=float)
    hits = sure[sure > 0.0]
    return Matches(
        frames=1,
        confidence=hits,
        hit=np.ones(len(hits), dtype=bool),
        frame=np.zeros(len(hits), dtype=int),
        distance_m=np.full(len(hits), 20.0),
        found=np.where(sure > 0.0, sure, MISSED),
        vehicle_frame=np.zeros(len(sure), dtype=int),
        vehicle_distance_m=np.full(len(sure), 20.0),
    )


def test_matches_of_frames_are_those_of_all(study):
    whole = study.joined([found(0.9, 0.0), found(0.2), found(0.8, 0.7, 0.0)])
    assert whole.frames == 3
    assert whole.frame.tolist() == [0, 1, 2, 2]
    assert whole.vehicle_frame.tolist() == [0, 0, 1, 2, 2, 2]
    assert recall(whole, 0.3)[0] == pytest.approx(3 / 6)
    assert average_precision(whole)[0] == pytest.approx(4 / 6)


def choices(study, own_share, its_share, trainings=2):
    """One sensor: how many of ten vehicles each training finds in each frame at its own choice and at the metric's."""
    rng = np.random.default_rng(3)
    judged = []
    for share in (own_share, its_share):
        of_trainings = []
        for _ in range(trainings):
            frames = [found(*(0.9 * (rng.random(10) < share))) for _ in range(FRAMES)]
            of_trainings.append([study.joined(frames)] * len(CRITERIA))
        judged.append(of_trainings)
    made = study.Made(np.zeros((0, 2)), judged, 10.0 * np.arange(FRAMES), 45.0)
    of_detector = {(which, t): 0 for which in study.OUTCOMES for t in range(trainings)}
    mounts = [{"height_m": 2.0}, {"height_m": 4.0}]
    rank = {(metric, which): 0.5 for metric in METRICS for which in study.OUTCOMES}
    return study.Choices(mounts, dict.fromkeys(METRICS, 1), of_detector, {0: 0, 1: 1}, made, rank)


def test_a_loss_is_what_the_detector_finds_less_at_the_metrics_choice(study):
    from scipy.stats import t as student_t

    sides = {"RS-16": choices(study, 0.9, 0.5), "RS-32": choices(study, 0.8, 0.8)}
    rows = list(study.rows_of(sides, "hard", study.FREE))
    mine = {(row["metric"], row["outcome"], row["sensor"]): row for row in rows}
    assert len(mine) == len(rows) == len(METRICS) * 2 * 3
    for which in study.OUTCOMES:
        one, other, mean = (mine[PE_VGOP.name, which, sensor] for sensor in ("RS-16", "RS-32", study.MEAN))
        assert one["of_detectors_choice"][0] != one["of_detectors_choice"][1]
        assert one["loss"] == pytest.approx(np.mean(one["of_detectors_choice"]) - np.mean(one["of_metrics_choice"]))
        assert 0.25 < one["loss"] < 0.55
        assert mean["loss"] == pytest.approx(0.5 * (one["loss"] + other["loss"]))
        low, high = mean["interval_90"]
        assert low < mean["loss"] < high
        wider = (mean["upper_97.5"] - mean["loss"]) / (high - mean["loss"])
        assert wider == pytest.approx(student_t.ppf(0.975, 3) / student_t.ppf(0.95, 3))
        assert (mean["blocks"], mean["block_s"]) == (4, 60.0)  # 240 s of frames
    assert "Primary: pe-vgop fails" in " ".join(study.verdicts(rows))
    assert "chooses nothing" in " ".join(study.verdicts([]))


def test_a_recording_of_one_block_has_no_bound(study):
    one = choices(study, 0.9, 0.5)
    short = replace(one, judged=replace(one.judged, time_s=np.linspace(0.0, 30.0, FRAMES), known={}))
    rows = list(study.rows_of({"RS-16": short}, "hard", study.FREE))
    assert {(row["interval_90"], row["upper_97.5"]) for row in rows} == {(None, None)}
    assert "too few blocks" in " ".join(study.verdicts(rows))


def test_a_metric_that_chooses_as_the_detector_loses_nothing(study):
    one = choices(study, 0.9, 0.5)
    same = study.Choices(one.mounts, dict.fromkeys(METRICS, 0), one.of_detector, one.row, one.judged, one.rank)
    rows = list(study.rows_of({"RS-16": same}, "hard", study.FREE))
    assert {row["loss"] for row in rows} == {0.0}
    assert {tuple(row["interval_90"]) for row in rows} == {(0.0, 0.0)}
    message = " ".join(study.verdicts(rows))
    assert "Primary: pe-vgop holds" in message
    assert "Secondary: view-coverage holds" in message


def test_ties_share_their_rank(study):
    assert study.spearman(np.array([1.0, 1.0, 2.0]), np.array([1.0, 2.0, 3.0])) == pytest.approx(0.866, abs=1e-3)
    assert study.spearman(np.ones(3), np.array([1.0, 2.0, 3.0])) == 0.0


def test_what_is_done_is_kept_and_of_its_own_settings_alone(study, tmp_path, capsys):
    scene = Path(study.SCENES)
    copy = tmp_path / "other.csv.gz"
    copy.write_bytes((scene / "i80_sample.csv.gz").read_bytes())
    words = ["--choose", str(scene / "i80_sample.csv.gz"), "--judge", str(copy), "--weights", str(SHIPPED)]
    words += ["--out", str(tmp_path / "out"), "--sensors", "RS-16", "--worlds", "clean", "--heights", "2", study.FREE]
    words += ["--fixed", "3", "--free", "3", "--choose-frames", "1", "--judge-frames", "2", "--workers", "1"]
    assert study.main(words) == 2
    assert "is the traffic that chooses; allowed: other traffic" in capsys.readouterr().err
    import gzip

    copy.write_bytes(gzip.compress(gzip.decompress(copy.read_bytes()), mtime=7))  # as good as another recording here
    assert study.main(words) == 0
    message = capsys.readouterr().out
    assert "too few blocks" in message
    first = {h: json.loads((tmp_path / "out" / f"decision_clean_{h}.json").read_text()) for h in ("2", study.FREE)}
    chose = {heights: {row["metric"] for row in one["rows"]} for heights, one in first.items()}
    for heights, one in first.items():
        assert one["caster"]
        assert one["verdicts"] == []  # nothing that was declared
        assert len(one["rows"]) == len(chose[heights]) * 2 * 2
    assert {PE_VGOP.name, "points"} < chose["2"]
    assert study.HEIGHT not in chose["2"]
    assert "distance" not in chose["2"] | chose[study.FREE]  # all mountings are in one place
    rows = first[study.FREE]["rows"]
    of_height = [row for row in rows if (row["metric"], row["sensor"]) == (study.HEIGHT, "RS-16")]
    heights_m = [mount["height_m"] for mount in study.mountings("RS-16", study.FREE, 3)]
    assert {row["metrics_choice"]["height_m"] for row in of_height} == {max(heights_m)}
    assert study.main(words) == 0
    assert capsys.readouterr().out == message
    words[words.index("--choose-frames") + 1] = "2"
    assert study.main(words) == 2
    assert "is of other code, traffic, weights or mountings" in capsys.readouterr().err
