"""The KITTI study: resampled correlations against slow ones, intervals that cover, and the digits of the evidence."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("scipy", reason="SciPy is not installed")

import tests.research  # noqa: F401
from scipy import stats
from compare_kitti import BEARINGS, main
from resampled_correlations import (
    Clusters,
    centred_ranks,
    cluster_bootstrap,
    correlation,
    cross_validated_r2,
    group_means,
    of_correlation,
    of_difference,
    orthogonal,
    pearson,
    residual,
)
from tests.recorded_samples import KITTI, needs_kitti

EVIDENCE = Path(__file__).parents[1] / "docs" / "evidence"
SEEDS = given(seed=st.integers(0, 2**32 - 1))


def plain_r(x, y):
    x, y = np.asarray(x, dtype=float) - np.mean(x), np.asarray(y, dtype=float) - np.mean(y)
    norm = math.sqrt((x @ x) * (y @ y))
    return x @ y / norm if norm > 1e-12 else math.nan


def left_over(y, controls):
    """By NumPy's least squares, with a constant."""
    design = np.column_stack([np.ones(len(y)), *controls])
    return y - design @ np.linalg.lstsq(design, y, rcond=None)[0]


def written_out(values, weights):
    return np.repeat(values, weights.astype(int))


def resampled(seed, columns):
    """Some columns of few values, so that ties abound, and weights with zeros."""
    rng = np.random.default_rng(seed)
    number = rng.integers(3, 13)
    weights = rng.integers(0, 4, (5, number)).astype(float)
    weights[0] = 1.0
    weights[:, 0] += 1.0  # none is empty
    return [rng.integers(0, rng.integers(1, 9), number).astype(float) for _ in range(columns)], weights


@settings(max_examples=60)
@SEEDS
def test_correlations_equal_those_of_the_observations_written_out(seed):
    (x, y, *controls), weights = resampled(seed, 4)
    ranks = [centred_ranks(values, weights) for values in (x, y)]
    held = orthogonal([centred_ranks(values, weights) for values in controls], weights)
    partial = correlation(*(residual(values, held, weights) for values in ranks), weights)
    by_rank, straight = correlation(*ranks, weights), pearson(x, y, weights)
    means = group_means(x, y.astype(int), 9, weights)
    for number, drawn in enumerate(weights):
        much = [written_out(values, drawn) for values in (x, y, *controls)]
        expected = [stats.rankdata(values) for values in much]
        np.testing.assert_allclose(by_rank[number], plain_r(*expected[:2]), atol=1e-9)
        np.testing.assert_allclose(straight[number], plain_r(*much[:2]), atol=1e-7)
        rest = [left_over(values, expected[2:]) for values in expected[:2]]
        known = all(np.abs(one).max() > 1e-9 for one in rest)
        np.testing.assert_allclose(partial[number], plain_r(*rest) if known else math.nan, atol=1e-6)
        for group in range(9):
            mine = much[0][much[1] == group]
            np.testing.assert_allclose(means[number, group], mine.mean() if len(mine) else math.nan, atol=1e-12)


def test_cross_validated_r2_equals_a_loop_over_cars():
    rng = np.random.default_rng(2)
    x, fold = rng.normal(size=40), rng.integers(0, 4, 40)
    y = x + 0.5 * rng.normal(size=40)
    weights = rng.integers(0, 3, (3, 40)).astype(float)
    for drawn, share in zip(weights, cross_validated_r2(x, y, fold, weights), strict=True):
        error = of_mean = 0.0
        for one in range(40):
            rest = fold != fold[one]
            error += drawn[one] * (y[one] - np.polyval(np.polyfit(x[rest], y[rest], 1), x[one])) ** 2
            of_mean += drawn[one] * (y[one] - y[rest].mean()) ** 2
        assert share == pytest.approx(1.0 - error / of_mean)


def test_folds_hold_whole_clusters():
    cluster = np.repeat(np.arange(23), 3)
    _, _, fold = cluster_bootstrap(Clusters("frame", cluster))
    assert all(len(set(fold[cluster == one].tolist())) == 1 for one in range(23))
    assert set(np.bincount(fold).tolist()) == {6, 9}


@pytest.mark.parametrize(("frames", "per_frame"), [(12, 4), (26, 6)])
def test_intervals_hold_the_true_correlation_and_difference_nine_times_in_ten(frames, per_frame):
    """As many frames and cars as the excerpt's parts have; a third of the variance is the frame's."""
    rng, frame = np.random.default_rng(8), np.repeat(np.arange(frames), per_frame)
    mixing = np.linalg.cholesky([[1.0, 0.8, 0.5], [0.8, 1.0, 0.6], [0.5, 0.6, 1.0]])
    ours, theirs = (6.0 / math.pi * math.asin(r / 2.0) for r in (0.8, 0.6))  # Spearman's of normals
    weights = cluster_bootstrap(Clusters("frame", frame))[1][:401]
    held, held_difference, trials = 0, 0, 250
    for _ in range(trials):
        shared, own = rng.normal(size=(frames, 3)), rng.normal(size=(len(frame), 3))
        columns = ((math.sqrt(1 / 3) * shared[frame] + math.sqrt(2 / 3) * own) @ mixing.T).T
        ranks = [centred_ranks(values, weights) for values in columns]
        first, second = (correlation(ranks[at], ranks[1], weights) for at in (0, 2))
        interval, apart = of_correlation(first, frames), of_difference(first, second, frames)
        held += interval.low <= ours <= interval.high
        held_difference += apart.low <= ours - theirs <= apart.high
    # Four standard errors of the share of 250 trials are 0.076.
    assert 0.82 <= held / trials <= 0.98
    assert 0.82 <= held_difference / trials <= 0.98


# --- The digits of the evidence ---------------------------------------------------------------------------------------


def numbers(text):
    return re.findall(r"-?\d+\.\d+", text.replace("+", ""))


def section(text, start):
    """The lines of an output below the one that begins so, by their first words; the first of each."""
    lines = text[text.index(start) :].split("\n\n")[0].splitlines()[1:]
    parts = (line.strip().partition(" ") for line in reversed(lines))
    return {name: rest for name, _, rest in parts}


def table(page, heading):
    """Rows of the first table of a page below a heading, by their first cell; numbers of the other cells."""
    text = (EVIDENCE / page).read_text(encoding="utf-8")
    rows = re.search(r"(?:^\|.*\n)+", text[text.index(heading) :], re.MULTILINE)[0].splitlines()[2:]
    cells = ([cell.strip().strip("`*") for cell in row.strip("|").split("|")] for row in rows)
    return {name: [numbers(cell) for cell in rest] for name, *rest in cells}


@needs_kitti
def test_the_tables_of_reproduction_md_are_what_the_script_makes(capsys):
    assert main(["detectors", "--kitti", str(KITTI)]) == 0
    out = capsys.readouterr().out
    second, pillars = (section(out, f"{name}, val: ") for name in ("second", "pointpillars"))
    kept = 0
    for name, cells in table("reproduction.md", "## Per car").items():
        if name in second and name != "distance" and all(cells):
            of_second, of_pillars = numbers(second[name]), numbers(pillars[name])
            assert cells == [of_second[:3], of_second[3:6], of_second[6:9], of_pillars[:3], of_pillars[6:9]], name
            kept += 1
    assert kept >= 10
    fall = section(out, "val: R2 of a line")
    for name, cells in table("reproduction.md", "## By distance").items():
        if name in fall:
            assert [one for cell in cells for one in cell] == numbers(fall[name])[-9:], name
    assert list(BEARINGS)[:3] == ["all", "end-on", "oblique"]


@needs_kitti
def test_the_table_of_reality_md_is_what_the_script_makes(capsys):
    assert main(["shapes", "--kitti", str(KITTI)]) == 0
    out = capsys.readouterr().out
    lines = out[out.index("validation: ") :].splitlines()[2:]
    rows = {tuple(line.split()[:2]): numbers(line)[:3] for line in lines if " errs by " not in line}
    losses = ("none", "glass", "drop-out", "weak", "all")
    for lost, cells in zip(losses, table("reality.md", "### What was found").values(), strict=True):
        for detail, cell in zip(("box", "body", "detailed"), cells, strict=True):
            assert cell == rows.get((detail, lost), []), (detail, lost)
