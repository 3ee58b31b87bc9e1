"""What a comparison with detectors leaves in its folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from ..errors import InputError, MissingExtraError
from ..formats.atomic import check_folder, make_folder, write_text
from ..formats.tables import to_csv, write_columns
from .agreement_charts import draw_charts
from .detector_study import Findings
from .findings_tables import car_columns, correlation_table
from .resampled_cars import Draws

RESULT, CARS, CORRELATION = "compare.json", "cars.csv", "correlation.csv"


def check_place(folder: Path) -> None:
    """Refuse early a folder that cannot be made, or that holds results already.

    Raises
    ------
    OutputError, InputError
        Naming it.
    """
    check_folder(folder, "--out")
    present = [name for name in (RESULT, CARS, CORRELATION) if (folder / name).exists()]
    if present:
        raise InputError(f"--out: {folder}: holds {present[0]} already; give another folder")


def write_findings(findings: Findings, result: Mapping, draws: Draws, folder: Path) -> tuple[list[str], str]:
    """Write tables, pictures and, last of all, the result; returns the files' names, and why there are no pictures.

    Raises
    ------
    OutputError
        If a file or the folder cannot be written.
    """
    make_folder(folder, "--out")
    write_columns(folder / CARS, car_columns(findings))
    write_text(folder / CORRELATION, to_csv(*correlation_table(findings)))
    pictures, note = [], ""
    try:
        pictures = draw_charts(findings, draws, folder.joinpath)
    except MissingExtraError as error:
        note = f"no pictures: {error}"
    write_text(folder / RESULT, json.dumps(result, indent=2, allow_nan=False) + "\n")
    return [RESULT, CARS, CORRELATION, *pictures], note
