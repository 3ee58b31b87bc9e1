"""Typed results: how a number is written, differences that add up, and every surface tells the same."""

from __future__ import annotations

import json
import shutil

import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.document import (
    ANSWER,
    Basis,
    Document,
    Quantity,
    Table,
    adding_up,
    as_json,
    document_from,
    statement,
)
from blender_lidar.report.page import minus
from blender_lidar.report.text import document_text, short_lines, table_text
from blender_lidar.run.folder import RunFolder
from tests.report_samples import result_of


@pytest.mark.parametrize(
    ("ends", "digits"),
    [((83.0, 93.0), 0), ((0.277, 0.390), 2), ((0.0, 0.5), 1), ((-0.1, 0.2), 2), ((94.0, 100.0), 0), ((5.0, 5.0), 3)],
)
def test_a_number_has_the_digits_that_its_interval_allows(ends, digits):
    assert Quantity("", "", 0.3, interval_90=ends, decimals=2).digits == digits


def test_a_number_is_written_with_unit_sign_and_interval():
    assert str(Quantity("", "", 87.6, "%", (83.0, 92.4))) == "88 % (83 to 92)"
    assert str(Quantity("", "", 20.7, "points", (17.6, 24.2), signed=True)) == "+21 points (+18 to +24)"
    assert str(Quantity("", "", -0.001, "bits", decimals=2)) == "0.00 bits"  # no minus of nought
    assert str(Quantity("", "", 25.0, "°", decimals=1)) == "25.0°"
    assert [Quantity("", "", 0.0, interval_90=ends).holds_nought for ends in ((-1.0, 0.0), (0.1, 1.0), None)] == [
        True,
        False,
        None,
    ]


SHARES = st.floats(0.0, 100.0, allow_nan=False)


@given(SHARES, SHARES, st.floats(0.0, 20.0), st.floats(0.0, 20.0), st.floats(0.0, 1.0))
def test_differences_add_up_as_they_are_written(before, after, half, other, share_of_pair):
    ends = (before - half, before + half), (after - other, after + other)
    gain = after - before
    parts = [Quantity("", "", value, "%", pair) for value, pair in zip((before, after), ends, strict=True)]
    around = share_of_pair * (half + other)  # of a paired difference it may be much narrower
    parts.append(Quantity("", "", gain, "points", (gain - around, gain + around), signed=True))
    written = adding_up(*parts)
    first, last, difference = (float(one.number) for one in written)
    assert abs(difference - gain) <= 10.0 ** -written[2].digits + 1e-9
    if written[2].shown is not None:
        assert difference == pytest.approx(last - first, abs=1e-9)
    low, high = map(float, written[2].within.split(" to "))
    assert low <= difference <= high


BASIS = Basis("held-out", 40, 30, 8, hung=True)
SHARE = Quantity("detectable", "detectable", 87.6, "%", (83.0, 92.4), BASIS)
DOCUMENT = Document(
    "RS-16 at a place",
    (statement(ANSWER, "{share} of the vehicles", "Detectable", first=True, share=SHARE),),
    (
        Table(
            "t",
            "Shares",
            ("lane", "detectable: before", "boxes"),
            (("one", SHARE, "40"), ("More",), ("two", None, "3")),
        ),
    ),
    {"Search": "hardened"},
)


def test_a_document_is_read_back_as_it_was_written():
    assert document_from(json.loads(json.dumps(as_json(DOCUMENT)))) == DOCUMENT
    assert DOCUMENT.quantity("detectable") == SHARE


def test_a_table_has_an_interval_beside_its_number_and_a_unit_in_its_head():
    assert table_text(DOCUMENT.tables[0]).splitlines() == [
        "Shares",
        "       detectable",
        "lane   before [%]      90 %  boxes",
        "  one          88  83 to 92     40",
        "More",
        "  two                            3",
    ]


@pytest.mark.parametrize("name", ["searched", "given", "whole"])
def test_terminal_page_and_panel_write_every_first_quantity_alike(stored_runs, name):
    run = RunFolder(stored_runs / name)
    page = (stored_runs / name / "report.html").read_text(encoding="utf-8")
    surfaces = {
        "terminal": " ".join(document_text(run.document).split()),
        "page": page,
        "panel": " ".join(short_lines(run.document)),
    }
    shown = [one for one in run.document.statements if one.first and one.kind in ("answer", "doubt", "caution")]
    assert shown
    for one in shown:
        for surface, text in surfaces.items():
            for quantity in one.quantities:
                assert (minus(str(quantity)) if surface == "page" else str(quantity)) in text, (surface, quantity.key)
    sheet = (stored_runs / name / "installation.txt").read_text(encoding="utf-8")
    assert str(run.document.quantity("detectable")) in " ".join(sheet.split())


@pytest.mark.parametrize("name", ["searched", "given", "whole"])
def test_what_was_chosen_on_what_judges_it_has_no_interval(stored_runs, name):
    for one in RunFolder(stored_runs / name).document.statements:
        for quantity in one.quantities:
            assert not (quantity.basis and quantity.basis.chosen_here and quantity.interval_90), quantity.key


@pytest.mark.parametrize("name", ["searched", "given", "whole"])
def test_the_twenty_lines_are_no_more_than_thirty(stored_runs, name):
    lines = document_text(RunFolder(stored_runs / name).document, ["a", "b"]).splitlines()
    assert len(lines) <= 30
    assert max(map(len, lines)) <= 120


def test_a_run_of_another_schema_is_refused_in_one_line(stored_runs, tmp_path):
    shutil.copytree(stored_runs / "given", tmp_path / "run")
    folder = RunFolder(tmp_path / "run")
    folder.file("result.json").write_text(json.dumps(result_of(folder) | {"schema": 1}))
    with pytest.raises(Exception, match="schema is not 2, the one that this version writes"):
        _ = RunFolder(tmp_path / "run").document
