"""Reading settings key by key: what is accepted, and that every refusal names the place and what is allowed."""

from __future__ import annotations

import math
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.toml_table import TomlTable, read_toml, to_toml


def table(text: str, origins: dict[str, str] | None = None) -> TomlTable:
    return TomlTable(tomllib.loads(text), "site.toml: [road]", origins)


def refusal(call) -> str:
    with pytest.raises(InputError) as caught:
        call()
    return str(caught.value)


# --- values -----------------------------------------------------------------------------------------------------------


def test_values_arrive_as_plain_python_types():
    settings = table('a = 2\nb = "x"\nc = [1, 2.5]\nd = [3, 4]\ne = [1, 2]\nf = 7')
    assert settings.number("a") == 2.0
    assert isinstance(settings.number("a"), float)
    assert settings.text("b") == "x"
    assert settings.numbers("c", count=2) == (1.0, 2.5)
    assert settings.number_or_pair("d", 0.0) == (3.0, 4.0)
    assert settings.whole_numbers("e") == (1, 2)
    assert settings.whole("f") == 7
    settings.finish()


def test_a_missing_key_takes_its_default_and_none_stays_none():
    settings = table("")
    assert settings.number("a", 1.5) == 1.5
    assert settings.whole("b", None) is None
    assert settings.text("c", None) is None
    assert settings.numbers("d", None, count=2) is None
    assert settings.whole_numbers("e", None) is None
    assert settings.number_or_pair("f", (1.0, 2.0)) == (1.0, 2.0)


def test_a_missing_key_without_default_is_named():
    assert refusal(lambda: table("").text("path")) == "site.toml: [road] path: is missing"


@pytest.mark.parametrize("value", ['"2"', "true", "nan", "inf", "-inf", "[1]", "2020-01-01", "{ a = 1 }"])
def test_what_is_no_finite_number_is_refused_with_its_value_and_place(value):
    text = refusal(lambda: table(f"a = {value}").number("a"))
    assert text.startswith("site.toml: [road] a: is ")
    assert text.endswith("; allowed: a number")


@pytest.mark.parametrize(
    ("limits", "allowed"),
    [
        ({"low": 3.0}, "at least 3"),
        ({"high": 1.0}, "at most 1"),
        ({"above": 2.0}, "more than 2"),
        ({"above": 2.0, "high": 9.0}, "more than 2 and at most 9"),
        ({"low": 3.0, "high": 9.0}, "at least 3 and at most 9"),
        ({"below": 2.0}, "less than 2"),
        ({"low": 0.0, "below": 1.0}, "at least 0 and less than 1"),
    ],
)
def test_a_number_out_of_range_is_refused_with_the_range(limits, allowed):
    assert refusal(lambda: table("a = 2").number("a", **limits)) == f"site.toml: [road] a: is 2; allowed: {allowed}"


@pytest.mark.parametrize(("value", "expected"), [('"auto"', "auto"), ("1", 1.0), ("0.5", 0.5)])
def test_a_number_or_one_text_is_either(value, expected):
    found = table(f"a = {value}").number_or_text("a", None, "auto", low=0.0)
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        ('"Auto"', "is 'Auto'; allowed: a number, or \"auto\""),
        ("true", "is True; allowed: a number"),
        ("nan", "is nan; allowed: a number"),
        ("[1]", "is [1]; allowed: a number"),
        ("-1", "is -1; allowed: at least 0"),
    ],
)
def test_what_is_neither_a_number_nor_that_text_is_refused(value, said):
    text = refusal(lambda: table(f"a = {value}").number_or_text("a", None, "auto", low=0.0))
    assert text == f"site.toml: [road] a: {said}"


def test_a_number_just_out_of_range_is_shown_with_all_its_digits():
    assert "is 90.0000001;" in refusal(lambda: table("a = 90.0000001").number("a", high=90.0))


@pytest.mark.parametrize("value", ["2.0", '"2"', "true", "[2]", "2020-01-01"])
def test_what_is_no_whole_number_is_refused(value):
    assert refusal(lambda: table(f"a = {value}").whole("a")).endswith("allowed: a whole number")


def test_a_whole_number_keeps_every_digit():
    assert table(f"a = {2**53 - 1}").whole("a") == 2**53 - 1


@pytest.mark.parametrize("read", ["number", "whole", "whole_numbers", "number_or_pair"])
def test_an_integer_of_hundreds_of_digits_is_refused_in_a_short_line(read):
    value = "1" + 400 * "0"
    settings = table(f"a = [{value}]" if read == "whole_numbers" else f"a = {value}")
    text = refusal(lambda: getattr(settings, read)("a", None))
    assert text.startswith("site.toml: [road] a: is 1000")
    assert len(text) < 200


@pytest.mark.parametrize("value", ["3", "true", '""', '["x"]', '"a\\u0000b"'])
def test_what_is_no_text_is_refused(value):
    assert refusal(lambda: table(f"a = {value}").text("a")).endswith("allowed: a text in quotes, not empty")


def test_a_text_that_is_none_of_the_allowed_is_refused_with_the_nearest():
    text = refusal(lambda: table('view = "maen"').text("view", allowed=("mean", "max", "min")))
    assert text == ("site.toml: [road] view: unknown view 'maen'; did you mean 'mean'? allowed: mean, max, min")


@pytest.mark.parametrize("value", ["3", "[1]", "[1, 2, 3]", '"ab"', '[1, "b"]', "[1, true]", "[nan, 1]"])
def test_what_is_no_list_of_two_numbers_is_refused(value):
    assert refusal(lambda: table(f"a = {value}").numbers("a", count=2)).startswith("site.toml: [road] a: is ")


@pytest.mark.parametrize("value", ["[1]", "[]", "[1, 2, 3]", '"x"', '["a", "b"]', "[[1, 2], 3]", "{ low = 1 }"])
def test_what_is_neither_number_nor_pair_is_refused(value):
    assert refusal(lambda: table(f"a = {value}").number_or_pair("a", 0.0)).startswith("site.toml: [road] a: is ")


@pytest.mark.parametrize("value", ["[4.5, 2.0]", "[2.0, 2.0]"])
def test_a_pair_upside_down_or_empty_is_refused(value):
    expected = f"site.toml: [road] a: is {value}; allowed: the lower bound first, below the upper"
    assert refusal(lambda: table(f"a = {value}").number_or_pair("a", 0.0)) == expected


def test_both_ends_of_a_pair_must_be_in_range():
    assert "is 200; allowed: at least 0 and at most 100" in refusal(
        lambda: table("a = [1, 200]").number_or_pair("a", 0.0, low=0.0, high=100.0)
    )


@pytest.mark.parametrize("value", ["3", "[]", "[1.5]", '["1"]', "[true]", '"12"'])
def test_what_is_no_list_of_whole_numbers_is_refused(value):
    assert refusal(lambda: table(f"a = {value}").whole_numbers("a")).startswith("site.toml: [road] a: is ")


# --- places -----------------------------------------------------------------------------------------------------------


def test_a_value_from_an_option_is_refused_by_the_name_of_the_option():
    settings = table("a = -1", {"a": "--seed"})
    assert refusal(lambda: settings.whole("a", low=0)).startswith("--seed: is -1; allowed: 0 to ")
    assert settings.overridden("a")
    assert not settings.overridden("b")


def test_tables_within_tables_are_named_with_their_path():
    settings = table("[height_m]\ncar = -1")
    assert refusal(lambda: settings.table("height_m").number("car", above=0.0)) == (
        "site.toml: [road.height_m] car: is -1; allowed: more than 0"
    )


def test_a_table_of_the_file_itself_is_named_as_it_is_written():
    root = TomlTable({"road": 3}, "site.toml")
    assert refusal(lambda: root.table("road")) == "site.toml: [road]: is 3; allowed: a table"


def test_an_array_of_tables_is_no_table():
    root = TomlTable(tomllib.loads("[[road]]\nlanes = 3"), "site.toml")
    assert refusal(lambda: root.table("road")).startswith("site.toml: [road]: is [{'lanes': 3}]; allowed: a table")


def test_keys_that_nothing_asked_for_are_refused_with_the_nearest_known_one():
    settings = table("lnes = 3")
    settings.whole("lanes", 6)
    assert refusal(settings.finish) == "site.toml: [road]: unknown key 'lnes'; did you mean 'lanes'? allowed: lanes"


def test_tables_gives_all_tables_and_knows_their_names_from_then_on():
    settings = table("[RS-16]\na = 1\n[RS-32]\na = 2")
    assert {name: own.number("a") for name, own in settings.tables().items()} == {"RS-16": 1.0, "RS-32": 2.0}
    settings.finish()


# --- files ------------------------------------------------------------------------------------------------------------


def test_a_file_with_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_toml(path) == {"a": 1}


@pytest.mark.parametrize(
    "content",
    [b"a = ", b"a = 1\na = 2", b"\xff\xfe\x00", b"\x00\x01\x02", b"a = 1" + 5000 * b"0", 2000 * b"a = [" + b"1"],
    ids=["no value", "twice", "not UTF-8", "binary", "5001 digits", "deep"],
)
def test_a_file_that_is_no_toml_is_refused_in_one_line_with_its_name(tmp_path, content):
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    text = refusal(lambda: read_toml(path))
    assert text.startswith(f"{path}: is not ")
    assert "\n" not in text


def test_a_missing_file_a_folder_and_an_impossible_name_are_refused(tmp_path):
    with pytest.raises(MissingFileError, match="there is no such file"):
        read_toml(tmp_path / "none.toml")
    assert refusal(lambda: read_toml(tmp_path)) == f"{tmp_path}: is a folder; allowed: a TOML file"
    assert "cannot be read" in refusal(lambda: read_toml(tmp_path / (300 * "x")))


def test_a_huge_file_is_refused_before_it_is_parsed(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_bytes(b"#" * (1 << 20) + b"\n")
    assert "larger than" in refusal(lambda: read_toml(path))


# --- writing ----------------------------------------------------------------------------------------------------------

texts = st.text(st.characters(exclude_categories=["Cs"]))
scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | texts
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3), max_leaves=6)
contents = st.dictionaries(texts, values | st.dictionaries(texts, values, max_size=3), max_size=4)


@given(st.dictionaries(texts, contents, max_size=3))
def test_what_is_written_is_read_back_by_a_toml_parser(tables):
    assert tomllib.loads(to_toml(tables)) == tables


@given(st.floats(allow_nan=False))
def test_floats_keep_every_bit(value):
    read = tomllib.loads(to_toml({"a": {"b": value}}))["a"]["b"]
    assert math.copysign(1.0, read) == math.copysign(1.0, value)
    assert read == value


def test_none_is_left_out_and_numpy_numbers_and_tuples_are_written_plainly():
    text = to_toml({"a": {"b": None, "c": np.float64(0.5), "d": (1, 2)}})
    assert tomllib.loads(text) == {"a": {"c": 0.5, "d": [1, 2]}}


@pytest.mark.parametrize("value", [object(), "\ud800", b"x"])
def test_what_toml_has_no_place_for_is_refused(value):
    assert "has no place in a TOML file" in refusal(lambda: to_toml({"a": {"b": value}}))
