"""What the study of stability leaves in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping

from ..errors import MissingExtraError
from ..formats.atomic import write_text
from ..formats.tables import to_csv
from ..study.stages import StudyFolder
from .charts import PICTURES, draw_charts
from .report import report_markdown, table_rows

RESULT, REPORT, TABLE = "stability.json", "report.md", "stability.csv"
FILES = (RESULT, REPORT, TABLE, *PICTURES)


def write_results(folder: StudyFolder, result: Mapping) -> list[str]:
    """Write table, pictures, the report and, last of all, the whole result; returns the names of the files.

    Without matplotlib there are no pictures, and the last name says so.
    """
    rows = table_rows(result)
    write_text(folder.file(TABLE), to_csv(list(rows[0]), [list(row.values()) for row in rows]))
    note: list[str] = []
    try:
        pictures = draw_charts(result, folder.file)
    except MissingExtraError as error:
        pictures, note = [], [f"no pictures: {error}"]
    write_text(folder.file(REPORT), report_markdown(result, pictures))
    write_text(folder.file(RESULT), json.dumps(result, indent=2) + "\n")
    return [REPORT, RESULT, TABLE, *pictures, *note]
