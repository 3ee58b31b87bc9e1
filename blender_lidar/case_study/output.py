"""What the case study leaves in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping

from ..errors import MissingExtraError
from ..formats.atomic import write_text
from ..formats.tables import to_csv
from ..study.stages import StudyFolder
from .charts import draw_charts
from .clouds import draw_clouds, write_clouds
from .mountings import baseline_coordinates, coordinates
from .published import EVEN, SENSORS
from .report import report_text
from .sites import CaseStudy
from .tables import as_table, fig9_rows, sensitivity_rows, spacing_rows, table2_rows

RESULT, REPORT, CLOUDS = "case_study.json", "report.md", "clouds"
TABLES = {
    "table2.csv": table2_rows,
    "fig9.csv": fig9_rows,
    "spacing.csv": spacing_rows,
    "sensitivity.csv": sensitivity_rows,
}
FILES = (RESULT, REPORT, CLOUDS, *TABLES)


def write_results(case: CaseStudy, folder: StudyFolder, result: Mapping) -> list[str]:
    """Write tables, clouds, pictures, the report and, last of all, the whole result; returns the names of the files.

    Without matplotlib there are no pictures, and the last name says so.
    """
    for name, rows in TABLES.items():
        write_text(folder.file(name), to_csv(*as_table(rows(result))))
    written, pictures, note = list(TABLES), [], []
    for sensor in SENSORS:
        site, of = case.site(sensor), result["sensors"][sensor]
        best = coordinates(site, (of["height_m"], of["tilt_deg"]))
        mountings = {"baseline": baseline_coordinates(site), "optimised": best}
        written += write_clouds(site, folder.file(CLOUDS), mountings)
        try:
            name = f"fig8_{sensor.lower()}.png"
            draw_clouds(site, folder.file(name), mountings)
            pictures.append(name)
        except MissingExtraError as error:
            note = [f"no pictures: {error}"]
    if not note:
        pictures = [*draw_charts(result, folder.file, EVEN), *pictures]
    write_text(folder.file(REPORT), report_text(result, pictures))
    write_text(folder.file(RESULT), json.dumps(result, indent=2) + "\n")
    return [REPORT, RESULT, *written, *pictures, *note]
