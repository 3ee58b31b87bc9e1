"""What the case study says to the paper's claims."""

from __future__ import annotations

import copy
import json

import pytest

from blender_lidar.case_study.claims import claims
from tests.case_study_run import result_of_a_study, told


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The result of a study and its folder."""
    return result_of_a_study(tmp_path_factory.mktemp("study"))


def test_every_claim_has_a_verdict_and_stands_in_the_report(finished):
    result, out = finished
    found = claims(result)
    assert len(found) == 10
    text = (out / "report.md").read_text(encoding="utf-8")
    for claim in found:
        assert f"| {claim.text} | {claim.ours} | **{claim.verdict}** |" in text
    widths = {}
    for line in text.splitlines():  # a cell with a bar in it would break its row
        if line.startswith("|---"):
            widths["now"] = line.count("|")
        elif line.startswith("|") and "now" in widths and not line.startswith("| ---"):
            assert line.count("|") == widths["now"] or line == widths.get("head"), line
        else:
            widths.pop("now", None)


def verdict(result, number):
    return claims(result)[number].verdict


def test_verdicts_follow_the_numbers(finished):
    result = copy.deepcopy(json.loads(json.dumps(finished[0])))

    def order(axis, strict, with_ties):
        result["order"][axis] |= {"strict": strict, "with_ties": with_ties}
        for pair in result["order"][axis]["pairs"]:
            pair["above"] = 0.5

    order("height", 0.95, 0.95)
    order("tilt", 0.05, 0.08)
    assert [verdict(result, number) for number in (0, 1)] == ["reproduced", "not reproduced"]
    order("height", 0.0, 0.99)
    order("tilt", 0.5, 0.6)
    assert [verdict(result, number) for number in (0, 1)] == ["not shown: ties", "undecided"]
    result["order"]["tilt"]["pairs"][1]["above"] = 1.0
    assert verdict(result, 1) == "reproduced in part"

    for of in result["sensors"].values():
        of["height_interval_90"] = [of["published"]["height_m"], 4.5]
        of["tilt_interval_90"] = [0.0, of["published"]["tilt_deg"]]
    assert verdict(result, 2) == "reproduced"
    result["sensors"]["RS-32"]["tilt_interval_90"] = [20.0, 25.0]
    assert verdict(result, 2) == "reproduced in part"

    def changes(*means):
        rows = [row for row in result["fig9"] if row["band"] == "all" and row["measure"] == "detectable"]
        for row, mean in zip(rows, means, strict=False):
            row["change"] = {"mean": mean, "interval_90": None if mean is None else [mean - 0.01, mean + 0.01]}

    changes(0.1, 0.3, 0.2)
    assert [verdict(result, number) for number in (3, 4)] == ["reproduced", "reproduced"]
    changes(0.3, 0.1, -0.2)
    assert [verdict(result, number) for number in (3, 4)] == ["not reproduced", "not reproduced"]
    changes(0.1, 0.105, 0.0)
    assert [verdict(result, number) for number in (3, 4)] == ["reproduced in part", "undecided"]


LOST, LEVEL, WON = (-0.2, -0.1), (-0.1, 0.1), (0.1, 0.2)


@pytest.mark.parametrize(
    ("near", "far", "expected"),
    [
        (WON, WON, "reproduced"),
        (WON, LEVEL, "reproduced in part"),
        (LEVEL, LEVEL, "undecided"),
        (WON, LOST, "not reproduced"),
    ],
)
def test_more_is_gained_far_away_only_if_the_interval_of_the_difference_says_so(finished, near, far, expected):
    result = copy.deepcopy(finished[0])
    for sensor, ends in (("RS-32", near), ("RS-80", far)):
        for row in result["fig9_halves"]:
            if row["sensor"] == sensor:
                good = told(ends if row["measure"] == "detectable" else WON)
                row.update({"near": 0.0, "far": good["mean"], "far_less_near": good})
    assert verdict(result, 6) == expected


@pytest.mark.parametrize(
    ("share", "bits", "expected"),
    [
        (LOST, WON, "reproduced"),
        (LEVEL, LOST, "undecided"),  # the entropy is no second chance
        (WON, LOST, "not reproduced"),
        (None, LOST, "undecided"),
    ],
)
def test_the_detectable_share_alone_decides_on_the_loss_near_by(finished, share, bits, expected):
    result = copy.deepcopy(finished[0])
    for row in result["fig9"]:
        if (row["sensor"], row["band"]) == ("RS-80", "0-20 m"):
            row["change"] = {"mean": 0.0, "interval_90": None}
            if ends := {"detectable": share, "entropy_bits": bits}.get(row["measure"]):
                row["change"] = told(ends)
    assert verdict(result, 8) == expected


@pytest.mark.parametrize(
    ("change", "at_optimum", "spacing", "even", "expected"),
    [
        (LOST, LOST, LOST, WON, "reproduced"),
        (LOST, LOST, LOST, LEVEL, "reproduced"),
        (LOST, LOST, LOST, LOST, "reproduced in part"),  # even beams lose too
        (LOST, LOST, LEVEL, LEVEL, "reproduced in part"),  # they were as much worse before
        (LOST, LEVEL, LOST, WON, "undecided"),  # a lead that is lost, and no more
        (LOST, WON, LOST, LOST, "not reproduced"),
        (LEVEL, LOST, LOST, WON, "undecided"),  # no loss is shown, whatever else is
        (WON, LOST, LOST, WON, "no loss here"),
    ],
)
def test_uneven_beams_cause_a_loss_only_if_there_is_one_and_they_are_worse_at_the_optimum(
    finished, change, at_optimum, spacing, even, expected
):
    result = copy.deepcopy(finished[0])
    near = next(row for row in result["spacing"] if row["band"] == "0-20 m" and row["measure"] == "detectable")
    near |= {"change": told(change), "spacing_at_optimum": told(at_optimum), "spacing": told(spacing)}
    near["change_evenly_spaced"] = told(even)
    assert verdict(result, 9) == expected
    near["change"] = {"mean": -0.1, "interval_90": None}
    assert verdict(result, 9) == "undecided"
