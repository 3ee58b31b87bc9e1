"""What the chart leaves in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

from ..errors import MissingExtraError
from ..formats.atomic import write_text
from ..formats.tables import to_csv
from ..study.stages import StudyFolder
from .picture import draw_chart
from .report import report_markdown

RESULT, REPORT, TABLE, ABLATIONS, PICTURE = "chart.json", "report.md", "chart.csv", "ablation.csv", "chart.png"
FILES = (RESULT, REPORT, TABLE, ABLATIONS, PICTURE)


def write_results(folder: StudyFolder, result: Mapping) -> list[str]:
    """Write tables, picture, the report and, last of all, the whole result; returns the names of the files.

    Without matplotlib there is no picture, and the last name says so.
    """
    for name, rows in ((TABLE, result["rungs"]), (ABLATIONS, result["ablations"])):
        flat = [_flat(row) for row in rows]
        columns = list(dict.fromkeys(key for row in flat for key in row))
        write_text(folder.file(name), to_csv(columns, [[_cell(row.get(key)) for key in columns] for row in flat]))
    pictures, note = [PICTURE], []
    try:
        draw_chart(folder.file(PICTURE), result)
    except MissingExtraError as error:
        pictures, note = [], [f"no picture: {error}"]
    write_text(folder.file(REPORT), report_markdown(result, pictures))
    write_text(folder.file(RESULT), json.dumps(result, indent=2) + "\n")
    return [REPORT, RESULT, TABLE, ABLATIONS, *pictures, *note]


def _flat(row: Mapping) -> dict[str, object]:
    """One level of keys: those of a mapping and the ends of an interval get columns of their own."""
    flat: dict[str, object] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}_{name}": one for name, one in value.items()}
        elif key.endswith("interval_90"):
            flat |= dict(zip((f"{key}_low", f"{key}_high"), value or (None, None), strict=True))
        else:
            flat[key] = value
    return flat


def _cell(value: object) -> object:
    if value is None:
        return ""
    return " ".join(map(str, value)) if isinstance(value, Sequence) and not isinstance(value, str) else value
