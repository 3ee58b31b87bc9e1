"""Clumsy tables of traffic, whole: each is judged as the clean one is or refused in a line, and never another way."""

from __future__ import annotations

import json

import pytest

from blender_lidar.cli import main
from tests.refusals import refused
from tests.small_scene import HEADER, REGION, traffic_rows, without_charts, write_scene

pytestmark = pytest.mark.usefixtures("quick")

ROWS = [dict(zip(HEADER, row, strict=True)) for row in traffic_rows()]
WORDS = ("--height", 3.0, "--tilt-x", 15.0, "--json")


def text(rows=ROWS, separator=",", header=HEADER, end="\n", decimal="."):
    """The table as text."""
    lines = [separator.join(header)]
    lines += [separator.join(str(row[name]).replace(".", decimal) for name in HEADER) for row in rows]
    return end.join([*lines, ""])


def changed(**changes):
    """The table with columns changed, each by a function of its value."""
    return text([row | {name: change(row[name]) for name, change in changes.items()} for row in ROWS])


def edited(change):
    """The table with its lines changed, given as lists of cells."""
    return "".join(",".join(cells) + "\n" for cells in change([line.split(",") for line in text().splitlines()]))


FEET = 3.28084
READ = {
    "semicolons and decimal commas": text(separator=";", decimal=","),
    "columns the other way round, and another one": edited(lambda lines: [["note", *line[::-1]] for line in lines]),
    "rows in any order": text(ROWS[::-1]),
    "ids that are text": changed(vehicle_id=lambda value: f"veh_{value:03d}"),
    "frames and seconds since 1970": changed(frame=lambda n: n + 10**9, time_s=lambda t: t + 1.7e9),
    "the same rows twice": text([*ROWS, *ROWS]),
    "spaces after commas": text(separator=", "),
    "classes in capital letters": changed(**{"class": str.upper}),
    "a minus as it is printed": text().replace("-", "\u2212"),
}
REFUSED = {
    "a row of units": edited(lambda lines: [lines[0], ["", "", ""] + 6 * ["m"] + ["s"], *lines[1:]]),
    "two files in one": text() + text(),
    "a row of totals": edited(lambda lines: [*lines, ["Total", *[""] * (len(lines[0]) - 1)]]),
    "cut off in the middle of a row": text()[:-30],
    "an empty cell": edited(lambda lines: [*lines[:5], [*lines[5][:7], "", *lines[5][8:]], *lines[6:]]),
    "not a number": edited(lambda lines: [*lines[:5], [*lines[5][:3], "NaN", *lines[5][4:]], *lines[6:]]),
    "a comma for thousands": changed(x_m=lambda value: f'"{value + 4000:,.3f}"'),
    "feet for all": changed(
        **dict.fromkeys(("x_m", "y_m", "length_m", "width_m", "height_m"), lambda value: FEET * value)
    ),
    "places in centimetres": changed(x_m=lambda value: 100 * value, y_m=lambda value: 100 * value),
    "longitude and latitude": changed(x_m=lambda x: 11.5 + x / 74_000, y_m=lambda y: 48.1 + y / 111_000),
    "clock time": changed(time_s=lambda value: f"08:{int(value) // 60:02d}:{int(value) % 60:02d}"),
    "x and y swapped": text([row | {"x_m": row["y_m"], "y_m": row["x_m"]} for row in ROWS]),
    "a class that nobody knows": changed(**{"class": lambda value: "ufo"}),
    "sizes of nothing": changed(length_m=lambda value: 0.0),
    "negative sizes": changed(width_m=lambda value: -value),
    "one id for all": changed(vehicle_id=lambda value: 1),
    "frames that count in seconds of the day": changed(frame=lambda value: 0.1 * value),
    "a table of something else": "date,price\n2020-01-01,3.5\n",
    "a picture": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
    "nothing": "",
    "a header alone": text([]),
}


CAUSES = {  # what the line says of each
    "a row of units": "csv:2: frame is nothing",
    "two files in one": "csv:152: frame is 'frame'",
    "a row of totals": "csv:152: frame is 'Total'",
    "cut off in the middle of a row": "csv:151: 4 fields; the first line has 10",
    "an empty cell": "csv:6: height_m is nothing",
    "not a number": "csv:6: x_m is 'NaN'",
    "a comma for thousands": "vehicles drive at x 3964 to 4036 m",
    "feet for all": "probably feet for metres",
    "places in centimetres": "places are not in metres",
    "longitude and latitude": "degrees of longitude and latitude",
    "clock time": "csv:2: time_s is '08:00:00'",
    "x and y swapped": "or x and y are swapped",
    "a class that nobody knows": "csv:2: unknown class 'ufo'; allowed: car, van",
    "sizes of nothing": "csv:2: length_m is 0; allowed: more than 0",
    "negative sizes": "csv:2: width_m is -1.8; allowed: more than 0",
    "one id for all": "several vehicles share a vehicle_id",
    "frames that count in seconds of the day": "csv:4: frame is 0.1; allowed: a whole number",
    "a table of something else": "no traffic that is known: it begins with 'date,price'",
    "a picture": "not a text file",
    "nothing": "no rows; a table is needed",
    "a header alone": "no rows below the header in line 1",
}


def scene_of(folder, content):
    """The scene with such a table."""
    folder.mkdir(exist_ok=True)
    (folder / "traffic.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    return write_scene(folder, REGION)


def judged(folder, content):
    """Numbers that are found of the mounting and of the baseline, on searched and held-out frames."""
    assert main([str(word) for word in ("evaluate", scene_of(folder, content), *WORDS, "--out", folder / "run")]) == 0
    result = json.loads((folder / "run" / "result.json").read_text())
    held, before = result["holdout"], result["baseline"]
    scores = [side[key] for side in (result, held, before) for key in ("objective_per_vehicle", "detectable_share")]
    return [result["vehicles"], held["vehicles"], held["blocks"], *held["interval_90"], *scores]


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    with pytest.MonkeyPatch.context() as monkeypatch:
        without_charts(monkeypatch)
        return judged(tmp_path_factory.mktemp("clean"), text())


@pytest.mark.parametrize("case", READ)
def test_what_leaves_no_doubt_is_judged_as_the_clean_table_is(case, clean, tmp_path):
    assert judged(tmp_path, READ[case]) == pytest.approx(clean, rel=1e-9)


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_refused_in_a_line(case, tmp_path, capsys):
    line = refused(capsys, tmp_path, "evaluate", scene_of(tmp_path, REFUSED[case]), *WORDS, "--out", tmp_path / "run")
    assert "traffic.csv" in line
    assert CAUSES[case] in line
