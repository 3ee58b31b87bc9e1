"""The page of a run: HTML that loads nothing and lets no user's text through; one line where its folder is damaged."""

from __future__ import annotations

import base64
import re
import shutil
import struct
import tomllib
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import blender_lidar
from blender_lidar.errors import BlenderLidarError, InputError, MissingFileError, OutputError
from blender_lidar.report.html import element, sheet_markup
from blender_lidar.report.page import CHARTS, render_file, write_report
from blender_lidar.run.folder import RunFolder
from tests.report_samples import Page, page_of, png
from tests.small_scene import done, without_charts, write_scene

LOADING = {"src", "href", "srcset", "poster", "data", "action", "formaction", "background", "cite", "ping", "manifest"}
CHART_FILES = [name for name in CHARTS if name != "detections.png"]  # which goes with detection.json
RENDER_FILES = [render_file(name, view) for view in ("above", "pole") for name in ("baseline", "optimised")]


@pytest.fixture
def folder(stored_runs, tmp_path) -> RunFolder:
    """A copy of the search, to be changed."""
    shutil.copytree(stored_runs / "searched", tmp_path / "run")
    return RunFolder(tmp_path / "run")


def draw(folder: RunFolder, names: list[str]) -> None:
    for number, name in enumerate(names):
        folder.file(name).write_bytes(png(8 + number, 5, 17 * number))


# --- HTML -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["searched", "given", "whole"])
def test_every_run_leaves_a_page_that_is_well_formed(stored_runs, name):
    text = (stored_runs / name / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.declared == ["DOCTYPE html"]
    assert text.startswith("<!DOCTYPE html>")
    assert [page.tags().count(tag) for tag in ("html", "head", "body", "main", "h1", "title")] == [1] * 6
    assert page.elements[0] == ("html", {"lang": "en"})
    assert page.elements[page.find("head")[0] + 1] == ("meta", {"charset": "utf-8"})
    assert page.find("meta", name="viewport")
    headings = [int(tag[1]) for tag in page.tags() if re.fullmatch("h[1-6]", tag)]
    assert all(after <= before + 1 for before, after in pairwise(headings))


def test_every_header_cell_says_what_it_heads_and_rows_are_of_one_length(stored_runs):
    page = Page((stored_runs / "searched" / "report.html").read_text(encoding="utf-8"))
    assert len(page.find("table")) == 5  # scores, distance, lanes, classes, methods
    assert all(present.get("scope") in {"col", "row", "rowgroup"} for tag, present in page.elements if tag == "th")
    width, widths, held = 0, [], []  # `held`: columns that cells of the rows above still take
    for tag, present in [*page.elements, ("tr", {})]:
        if tag in ("tr", "table"):
            if width:
                widths.append(width)
            held = [] if tag == "table" else [rows - 1 for rows in held if rows > 1]
            width = len(held)
        elif tag in ("td", "th"):
            width += int(present.get("colspan", 1))
            held += [int(present["rowspan"])] if "rowspan" in present else []
    assert set(widths) == {2, 7, 8, 11}


def test_the_same_folder_gives_the_same_bytes(folder):
    draw(folder, CHART_FILES)
    write_report(RunFolder(folder.path))
    first = folder.file("report.html").read_bytes()
    assert write_report(RunFolder(folder.path)) == folder.file("report.html")
    assert folder.file("report.html").read_bytes() == first == page_of(folder).encode()


# --- pictures ---------------------------------------------------------------------------------------------------------


def test_pictures_are_the_folders_own_bytes_and_nothing_is_loaded_from_elsewhere(folder):
    names = [*RENDER_FILES, *CHART_FILES]
    draw(folder, names)
    text = page_of(folder)
    page = Page(text)
    images = [present for tag, present in page.elements if tag == "img"]
    start = "data:image/png;base64,"
    assert all(image["src"].startswith(start) for image in images)
    found = [base64.b64decode(image["src"].removeprefix(start), validate=True) for image in images]
    assert sorted(found) == sorted(folder.file(name).read_bytes() for name in names)
    for image, data in zip(images, found, strict=True):
        assert (int(image["width"]), int(image["height"])) == struct.unpack(">II", data[16:24])
        assert len(image["alt"]) > 10
    check_loads_nothing(page)


def check_loads_nothing(page: Page) -> None:
    assert not {"script", "link", "iframe", "object", "embed", "base", "form", "svg", "a"} & set(page.tags())
    for tag, present in page.elements:
        assert not [name for name in present if name.startswith("on")]
        assert all(present[name].startswith("data:") for name in LOADING & present.keys()), tag
        assert "url(" not in present.get("style", "")
    style = page.text(page.find("style")[0])
    assert "url(" not in style
    assert "@import" not in style
    policy = page.elements[page.find("meta", **{"http-equiv": "Content-Security-Policy"})[0]][1]["content"]
    assert policy.startswith("default-src 'none'")


def test_renders_stand_in_pairs_above_the_tables(folder):
    draw(folder, RENDER_FILES)
    page = Page(page_of(folder))
    order = [tag for tag in page.tags() if tag in ("figure", "img", "table")]
    assert order[:7] == ["figure", "img", "img", "figure", "img", "img", "table"]
    sides = [
        page.text(number) for number in page.find("div") if page.text(number).startswith(("Baseline:", "Optimised:"))
    ]
    assert sum(side.startswith("Baseline: height 2.00 m, tilt 0.0°") for side in sides) >= 2


@pytest.mark.parametrize("names", [[], CHART_FILES[:2], CHART_FILES])
def test_the_page_is_made_with_the_charts_that_are_there_and_says_where_there_are_none(folder, names):
    draw(folder, names)
    text = page_of(folder)
    assert Page(text).tags().count("figure") == len(names)
    assert ("There are no charts" in text) == (not names)


@pytest.mark.parametrize(
    "content",
    [b"", b"\x89PNG\r\n\x1a\n", png(3, 3, 9)[:-6], b"GIF89a" * 9],
    ids=["nothing", "signature", "cut off", "another format"],
)
def test_a_picture_that_is_not_whole_is_refused_by_name_and_the_page_stays_as_it_was(folder, content):
    before = folder.file("report.html").read_bytes()
    folder.file("clouds.png").write_bytes(content)
    with pytest.raises(InputError, match=r"clouds\.png: is no PNG picture, or not a whole one$"):
        write_report(RunFolder(folder.path))
    assert folder.file("report.html").read_bytes() == before


# --- users' texts -----------------------------------------------------------------------------------------------------


def test_a_scene_and_traffic_named_like_scripts_are_only_text(tmp_path, capsys, monkeypatch):
    without_charts(monkeypatch)
    name = "<script>alert(1)<script>&\"'"
    traffic = "<img src=x onerror=alert(1)>.csv"
    scene = write_scene(tmp_path, {"traffic": {"path": traffic}})
    (tmp_path / "traffic.csv").rename(tmp_path / traffic)
    scene.rename(tmp_path / f"{name}.toml")
    done(capsys, "evaluate", tmp_path / f"{name}.toml", "--height", 4, "--out", tmp_path / "run")
    page = Page((tmp_path / "run" / "report.html").read_text(encoding="utf-8"))
    assert page.text(page.find("h1")[0]) == f"{name} RS-16"
    assert traffic in page.text(page.find("header")[0])
    check_loads_nothing(page)


@given(st.text(max_size=30) | st.text("<&>\"'a\0\x85\ud800\udfff\ufffe", max_size=30))
def test_any_text_can_stand_in_an_element_and_an_attribute(text):
    markup = element("p", text, title=text)
    markup.encode("utf-8")
    assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff]", markup)
    page = Page(markup)
    assert page.tags() == ["p"]
    clean = re.sub("[^\t\n\r -~\xa0-\ud7ff\ue000-\ufdcf\ufdf0-\ufffd\U00010000-\U0010ffff]", "\ufffd", text)
    assert page.text(0) == page.elements[0][1]["title"] == clean


def test_the_sheet_is_shown_as_it_stands_under_its_headings():
    sheet = "One LiDAR\n\nHeight     4 m\n           above\nYaw        0\n\nCheck\n- this\n  too\n- that\n"
    assert [str(block) for block in sheet_markup(sheet)] == [
        "<h3>One LiDAR</h3>",
        "<pre>Height     4 m\n           above\nYaw        0</pre>",
        "<h3>Check</h3>",
        "<pre>- this\n  too\n- that</pre>",
    ]


def test_what_the_package_reads_beside_its_code_is_installed_with_it():
    package = Path(blender_lidar.__file__).parent
    declared = tomllib.loads((package.parent / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    patterns = [f"{name.replace('.', '/')}/{pattern}" for name, globs in declared.items() for pattern in globs]
    made = (".py", ".pyc", ".nbi", ".nbc")  # code, and what Python and Numba compile of it
    files = [path.relative_to(package.parent) for path in package.rglob("*.*") if path.suffix not in made]
    assert files
    assert [path for path in files if not any(fnmatch(path.as_posix(), pattern) for pattern in patterns)] == []


# --- damaged folders: one line that names the file, and never half a page ---------------------------------------------


def one_line(error: BlenderLidarError) -> str:
    assert len(str(error).splitlines()) == 1
    return str(error)


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    for place in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(MissingFileError, match="is not the folder of a run") as caught:
            write_report(RunFolder(place))
        assert str(place) in one_line(caught.value)
    assert not list(tmp_path.iterdir())


def test_a_run_that_was_stopped_is_refused_and_says_how_to_go_on(folder):
    folder.file("result.json").rename(folder.file("checkpoint.json"))
    with pytest.raises(MissingFileError, match="has not ended; go on with it: optimise --resume"):
        page_of(folder)


@pytest.mark.parametrize(
    ("name", "old", "new", "read"),
    [
        ("vehicles.csv", r"(?m)^(\d+),\d+,", r"\1,x,", lambda run: run.optimised),
        ("vehicles.csv", "distance_m", "distance", lambda run: run.optimised),
        ("vehicles.csv", r"\d+\.\d+,1,2,search", "nan,1,2,search", lambda run: run.optimised),
        ("vehicles_baseline.csv", r"\n[^\n]*\n$", "\n", lambda run: run.baseline),
        ("vehicles_baseline.csv", "holdout", "search", lambda run: run.baseline),
        ("scene.toml", r"\[traffic\]", "[traffic", page_of),
        ("scene.toml", "path = ", "way = ", page_of),
    ],
)
def test_a_damaged_file_is_refused_by_name(folder, name, old, new, read):
    text = folder.file(name).read_text()
    damaged = re.sub(old, new, text, count=1)
    assert damaged != text
    folder.file(name).write_text(damaged)
    with pytest.raises(InputError, match=re.escape(name)) as caught:
        read(RunFolder(folder.path))
    one_line(caught.value)


@pytest.mark.parametrize("name", ["scene.toml", "installation.txt"])
def test_a_file_that_is_missing_is_named(folder, name):
    folder.file(name).unlink()
    with pytest.raises(BlenderLidarError, match=re.escape(name)):
        page_of(folder)


def test_a_page_that_cannot_be_written_is_one_line(folder):
    folder.file("report.html").unlink()
    folder.file("report.html").mkdir()
    with pytest.raises(OutputError, match=r"report\.html: cannot be written") as caught:
        write_report(RunFolder(folder.path))
    one_line(caught.value)
