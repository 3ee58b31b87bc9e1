"""Settings: what each kind accepts, that every refusal names the place and what is allowed, and TOML there and back."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from blender_lidar.errors import InputError, MissingFileError
from blender_lidar.toml_table import Setting, TomlTable, checked, read_toml, setting, settings_of, to_toml

pytestmark = pytest.mark.versions

PAIR = float | tuple[float, float]


def table(text: str, origins: dict[str, str] | None = None) -> TomlTable:
    return TomlTable(tomllib.loads(text), "site.toml: [road]", origins)


def value(text: str, kind: object = float, **declared: object) -> object:
    """The value of a = `text` as a setting declares it."""
    return table(f"a = {text}").read({"a": Setting(kind=kind, **declared)})["a"]


def refusal(call) -> str:
    with pytest.raises(InputError) as caught:
        call()
    return str(caught.value)


def refused(text: str, kind: object = float, **declared: object) -> str:
    message = refusal(lambda: value(text, kind, **declared))
    assert message.startswith("site.toml: [road] a: ")
    return message.removeprefix("site.toml: [road] a: ")


# --- values -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "kind", "expected"),
    [
        ("2", float, 2.0),
        ('"x"', str, "x"),
        ("true", bool, True),
        ("[1, 2.5]", tuple[float, float], (1.0, 2.5)),
        ("[3, 4]", PAIR, (3.0, 4.0)),
        ("3", PAIR, 3.0),
        ("[1, 2]", tuple[int, ...], (1, 2)),
        (str(2**53 - 1), int, 2**53 - 1),
    ],
)
def test_values_arrive_as_plain_python_types(text, kind, expected):
    found = value(text, kind)
    assert (found, type(found)) == (expected, type(expected))
    for default in (None, expected):
        assert table("").read({"a": Setting(kind=kind, default=default)}) == {"a": default}


WRONG = {
    (float, "a number"): ['"2"', "true", "nan", "inf", "-inf", "[1]", "2020-01-01", "{ a = 1 }"],
    (int, "a whole number"): ["2.0", '"2"', "true", "[2]", "2020-01-01"],
    (str, "a text in quotes, not empty"): ["3", "true", '""', '["x"]', '"a\\u0000b"'],
    (bool, "true or false"): ["1", '"true"'],
    (tuple[float, float], ""): ["3", "[1]", "[1, 2, 3]", '"ab"', '[1, "b"]', "[1, true]", "[nan, 1]"],
    (PAIR, ""): ["[1]", "[]", "[1, 2, 3]", '"x"', '["a", "b"]', "[[1, 2], 3]", "{ low = 1 }"],
    (tuple[int, ...], ""): ["3", "[]", "[1.5]", '["1"]', "[true]", '"12"'],
}
WRONG = [(kind, allowed, text) for (kind, allowed), texts in WRONG.items() for text in texts]


@pytest.mark.parametrize(("kind", "allowed", "text"), WRONG)
def test_what_is_of_another_kind_is_refused_with_its_value_and_place(kind, allowed, text):
    message = refused(text, kind)
    assert message.startswith("is ")
    assert message.endswith(allowed)
    assert "; allowed: " in message


@pytest.mark.parametrize(
    ("limits", "allowed"),
    [
        ({"low": 3.0}, "at least 3"),
        ({"high": 1.0}, "at most 1"),
        ({"above": 2.0}, "more than 2"),
        ({"above": 2.0, "high": 9.0}, "more than 2 and at most 9"),
        ({"low": 3.0, "high": 9.0}, "3 to 9"),
        ({"below": 2.0}, "less than 2"),
        ({"low": 0.0, "below": 1.0}, "at least 0 and less than 1"),
    ],
)
def test_a_number_out_of_range_is_refused_with_the_range(limits, allowed):
    assert refused("2", **limits) == f"is 2; allowed: {allowed}"


@pytest.mark.parametrize(("text", "expected"), [('"auto"', "auto"), ("1", 1.0), ("0.5", 0.5)])
def test_a_number_or_one_text_is_either(text, expected):
    found = value(text, word="auto", low=0.0)
    assert (found, type(found)) == (expected, type(expected))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('"Auto"', "is 'Auto'; allowed: a number, or \"auto\""),
        ("true", 'is True; allowed: a number, or "auto"'),
        ("nan", 'is nan; allowed: a number, or "auto"'),
        ("[1]", 'is [1]; allowed: a number, or "auto"'),
        ("-1", "is -1; allowed: at least 0"),
    ],
)
def test_what_is_neither_a_number_nor_that_text_is_refused(text, said):
    assert refused(text, word="auto", low=0.0) == said


def test_a_text_that_is_none_of_the_allowed_is_refused_with_the_nearest():
    message = refusal(
        lambda: checked("maen", Setting(kind=str, allowed=("mean", "max", "min")), "site.toml: [road] view")
    )
    assert message == "site.toml: [road] view: unknown view 'maen'; did you mean 'mean'? allowed: mean, max, min"


def test_what_does_not_fit_is_refused_with_the_form_that_would():
    even = {"kind": int, "fits": lambda number: number % 2 == 0, "form": "an even number"}
    assert value("2", **even) == 2
    assert refused("3", **even) == "is 3; allowed: an even number"


def test_both_ends_of_a_pair_must_be_in_range():
    assert refused("[1, 200]", PAIR, low=0.0, high=100.0) == "is 200; allowed: 0 to 100"


# --- declarations -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Pole:
    height_m: float = setting(2.0, above=0.0, option="--height", help="above the road")
    lanes: tuple[int, ...] | None = setting(None)


@dataclass(frozen=True, slots=True)
class Site:
    name: str = setting()
    pole: Pole | None = setting(None)
    poles: tuple[Pole, ...] = setting(())
    note: str = ""


def test_a_dataclass_declares_a_table_and_the_tables_within_it():
    found = table('name = "a"\npole = {height_m = 3}\n[[poles]]\n[[poles]]\nlanes = [1]').read(settings_of(Site))
    assert Site(**found) == Site(
        name="a", pole=Pole(height_m=3.0), poles=(Pole(height_m=2.0), Pole(height_m=2.0, lanes=(1,)))
    )
    assert settings_of(Pole)["height_m"] == Setting(default=2.0, above=0.0, option="--height", help="above the road")
    assert settings_of(Pole)["lanes"].kind == tuple[int, ...]
    assert "note" not in settings_of(Site)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pole = 3", "[road.pole]: is 3; allowed: a table"),
        ("pole = {hight_m = 3}", "[road.pole]: unknown key 'hight_m'; did you mean 'height_m'? allowed: height_m, lan"),
        ("[pole]\nheight_m = 0", "[road.pole] height_m: is 0; allowed: more than 0"),
        ("poles = 3", "[road] poles: is 3; allowed: a list of tables"),
        ("poles = [{}, 3]", "[road] poles 2: is 3; allowed: a table"),
    ],
)
def test_a_table_that_is_not_as_declared_is_refused_with_its_path(text, message):
    settings = table(f'name = "a"\n{text}')
    assert refusal(lambda: settings.read(settings_of(Site))).startswith(f"site.toml: {message}")


# --- places -----------------------------------------------------------------------------------------------------------


def test_a_table_of_numbers_has_those_that_are_given_and_no_others():
    declared = {"a": Setting(kind=Mapping[str, float], allowed=("car", "bus"), above=0.0)}
    assert table("").read(declared) == {"a": {}}
    assert table("a = {bus = 3}").read(declared) == {"a": {"bus": 3.0}}
    assert refusal(lambda: table("a = {bus = 0}").read(declared)).endswith("[road.a] bus: is 0; allowed: more than 0")
    assert "[road.a]: unknown key 'vus'; did you mean 'bus'?" in refusal(lambda: table("a = {vus = 3}").read(declared))


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
    assert text.startswith((f"{path}: is not ", f"{path}: is text in UTF-16; allowed: UTF-8"))
    assert "\n" not in text


def test_a_missing_file_a_folder_and_an_impossible_name_are_refused(tmp_path):
    with pytest.raises(MissingFileError, match="there is no such file"):
        read_toml(tmp_path / "none.toml")
    assert refusal(lambda: read_toml(tmp_path)) == f"{tmp_path}: is a folder; allowed: a TOML file"
    assert "cannot be read" in refusal(lambda: read_toml(tmp_path / (300 * "x")))


# --- writing ----------------------------------------------------------------------------------------------------------

texts = st.text(st.characters(exclude_categories=["Cs"]))
scalars = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | texts
values = st.recursive(scalars, lambda inner: st.lists(inner, max_size=3), max_leaves=6)
contents = st.dictionaries(texts, values | st.dictionaries(texts, values, max_size=3), max_size=4)


@given(st.dictionaries(texts, contents, max_size=3))
def test_what_is_written_is_read_back_by_a_toml_parser(tables):
    assert tomllib.loads(to_toml(tables)) == tables


def test_none_is_left_out_and_numpy_numbers_and_tuples_are_written_plainly():
    text = to_toml({"a": {"b": None, "c": np.float64(0.5), "d": (1, 2)}})
    assert tomllib.loads(text) == {"a": {"c": 0.5, "d": [1, 2]}}


# --- paths of Windows -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", [r"C:\data\x.csv", r"C:\Users\me\x.csv", r"..\x.csv", r"\\server\x.csv"])
def test_a_path_with_backslashes_in_double_quotes_is_told_what_to_write_instead(tmp_path, path):
    (tmp_path / "own.toml").write_text(f'[traffic]\nformat = "table"\npath = "{path}"\n')
    message = refusal(lambda: read_toml(tmp_path / "own.toml"))
    assert "is not TOML: " in message
    assert "write paths in single quotes or with forward slashes" in message
    (tmp_path / "own.toml").write_text(f"[traffic]\npath = '{path}'\n")
    assert read_toml(tmp_path / "own.toml")["traffic"]["path"] == path


@pytest.mark.parametrize("path", [r"C:\temp\new.csv", r"data\flow.csv", r"C:\rows\before.csv"])
def test_a_path_whose_backslashes_make_escapes_is_told_so_too(path):
    message = refused(f'"{path}"', str, is_path=True)
    assert "no path; in double quotes a backslash begins an escape: write paths in single quotes" in message
