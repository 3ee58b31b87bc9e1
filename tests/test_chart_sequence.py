"""Which fidelities are near enough: asked from many beams to few, so that among many luck passes none."""

from __future__ import annotations

import numpy as np

from blender_lidar.speed_accuracy.noise import Noise
from blender_lidar.speed_accuracy.recommendation import sentence
from blender_lidar.speed_accuracy.rungs import recommended
from blender_lidar.speed_accuracy.sequence import BOUND_LEVEL, mark_within
from blender_lidar.study.statistics import student_t

NOISE = Noise(bias=0.1, error=0.05, error_90=(0.04, 0.06), tau=0.9, apart=0.01)  # 5 % of a gain of 1


def row(name: str, median: float, bound: float | None, error: float = 0.001, **changes) -> dict:
    return {
        "name": name,
        "text": name,
        "detail": "body",
        "twin": None,
        "same_as_twin": None,
        "stride": 1,
        "frames": round(10 * median),
        "culled": True,
        "ground": False,
        "milliseconds": {"median": median},
        "speedup": 80.0 / median,
        "regret_bound": bound,
        "error_share": error,
        **changes,
    }


def reference() -> dict:
    return row("reference", 80.0, 0.0, 0.0, detail="detailed")


def marked(rows: list[dict], key: str, noise: Noise | None = NOISE) -> list[str]:
    mark_within(rows, 0.01, noise, 1.0)
    return [one["name"] for one in rows if one[key]]


def test_the_fastest_of_those_that_are_surely_near_enough_is_recommended():
    rows = [reference(), row("near", 8.0, 0.009, 0.04), row("slower", 10.0, 0.0), row("not sure", 2.0, 0.02)]
    assert marked(rows, "within") == ["reference", "near", "slower"]
    assert sentence(rows[0], recommended(rows), 0.01, 0.3) == (
        "Cheapest within 1 % of the gain: near: 8 ms an evaluation, 10 times faster than the reference (reference)."
    )


def test_what_is_cheaper_than_one_that_fails_is_not_asked_at_its_level_of_detail():
    rows = [
        reference(),
        row("passes", 9.0, 0.009),
        row("fails", 8.0, 0.011),
        row("lucky", 1.0, -0.5),
        row("another level", 2.0, 0.0, detail="box"),
    ]
    assert marked(rows, "asked") == ["reference", "passes", "fails", "another level"]
    assert marked(rows, "within") == ["reference", "passes", "another level"]
    assert recommended(rows)["name"] == "another level"


def test_beams_make_the_order_and_where_they_are_as_many_frames_do_whatever_the_clock_says():
    rows = [
        reference(),
        row("a quarter", 9.0, 0.0, stride=4, frames=30),
        row("half of the frames", 3.0, 0.5, frames=15),
        row("half of the columns", 2.0, 0.0, stride=2, frames=30),
        row("all", 1.0, 0.0, frames=30),
    ]
    assert marked(rows, "asked") == ["reference", "half of the frames", "half of the columns", "all"]
    assert marked(rows, "within") == ["reference", "half of the columns", "all"]


def test_an_error_beyond_tolerance_and_noise_is_not_near_whatever_the_regret():
    rows = [reference(), row("lucky", 8.0, 0.0, 0.2)]
    assert marked(rows, "within") == ["reference"]
    rows = [reference(), row("within the noise", 8.0, 0.0, 0.04)]
    assert marked(rows, "within") == ["reference", "within the noise"]
    assert marked(rows, "within", None) == ["reference"]


def test_twins_share_the_answer_of_what_they_come_to_and_are_not_asked():
    rows = [
        reference(),
        row("near", 8.0, 0.0),
        row("quicker caster", 7.0, 0.0, twin="near", same_as_twin=True),
        row("ground", 6.0, 0.0, twin="near", same_as_twin=True, ground=True),
        row("leaks", 5.0, None, None, twin="near", same_as_twin=False),
    ]
    assert marked(rows, "within") == ["reference", "near", "quicker caster", "ground"]
    assert marked(rows, "asked") == ["reference", "near"]
    assert recommended(rows)["name"] == "quicker caster"


def test_where_nothing_cheaper_will_do_the_reference_is_named_and_where_nothing_gains_nothing_is():
    rows = [reference(), row("without blocks", 8.0, None)]
    mark_within(rows, 0.01, None, 0.3)
    assert "only the reference, reference: 80 ms" in sentence(rows[0], recommended(rows), 0.01, 0.3)
    assert sentence(rows[0], rows[0], 0.01, 0.0).startswith("No mounting gains anything over the baseline")


def test_of_forty_eight_that_all_lose_the_tolerance_one_passes_at_most_once_in_twenty_times():
    """Each by itself at 95 % passes a few in every second chart."""
    rng, blocks, passed, alone = np.random.default_rng(1), 10, 0, 0
    single, together = (student_t(level, blocks - 1) for level in (0.95, BOUND_LEVEL))
    trials = 1000
    for _ in range(trials):
        lost = rng.normal(0.01, 0.02, (48, blocks))
        middle, error = lost.mean(axis=1), lost.std(axis=1, ddof=1) / np.sqrt(blocks)
        rows = [reference()]
        for number, bound in enumerate((middle + together * error).tolist()):
            rows.append(row(str(number), 50.0 - number, bound, detail=("box", "body", "detailed")[number % 3]))
        passed += len(marked(rows, "within")) > 1
        alone += bool((middle + single * error <= 0.01).any())
    assert passed <= trials * 0.05 + 3.0 * np.sqrt(trials * 0.05 * 0.95)
    assert passed > 0
    assert alone > 0.5 * trials
