"""What `chart` and `stability` share in words and files: shares in per cent, tables, and the files of a study."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence

from ..errors import MissingExtraError
from ..files import to_csv, write_text
from ..studies.driver import StudyFolder

WIDTH = 120  # of texts for a terminal


def tenths(share: float) -> str:
    """A share in per cent, to one digit; what rounds to nothing has no sign."""
    return f"{round(100.0 * share, 1) + 0.0:.1f}"


def percent(share: float | None, interval: Sequence[float] | None = None) -> str:
    """A share in per cent, and its interval where there is one; nothing for None."""
    if share is None:
        return ""
    return f"{tenths(share)} %" + ("" if interval is None else f" ({' to '.join(map(tenths, interval))})")


def wrapped(lines: Iterable[str]) -> list[str]:
    """Lines no wider than a terminal."""
    return [part for line in lines for part in textwrap.wrap(line, WIDTH, subsequent_indent="  ")]


def text_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows, the header first, in columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def markdown_table(rows: Iterable[Sequence[str]]) -> list[str]:
    """Rows, the header first, as a table of Markdown."""
    header, *rest = rows
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rest)]


def write_study(
    folder: StudyFolder,
    result: Mapping,
    names: tuple[str, str],
    tables: Mapping[str, Sequence[Mapping]],
    draw: Callable[[], list[str]],
    markdown: Callable[[Mapping, Sequence[str]], str],
    missing: str,
) -> list[str]:
    """Write tables, pictures, the report and, last of all, the whole result; returns the names of the files.

    Parameters
    ----------
    folder : StudyFolder
    result : mapping
    names : (str, str)
        Of the report and of the result.
    tables : mapping of str to sequence of mapping
        Rows of each CSV file; a column may be missing in some of them.
    draw : callable
        Draws the pictures and returns their names. Without matplotlib there are none, and the last name says that they
        are `missing`.
    markdown : callable
        The report from the result and the names of the pictures.
    """
    for name, rows in tables.items():
        columns = list(dict.fromkeys(key for row in rows for key in row))
        write_text(folder.file(name), to_csv(columns, [[row.get(key, "") for key in columns] for row in rows]))
    note: list[str] = []
    try:
        pictures = draw()
    except MissingExtraError as error:
        pictures, note = [], [f"{missing}: {error}"]
    report, whole = names
    write_text(folder.file(report), markdown(result, pictures))
    write_text(folder.file(whole), json.dumps(result, indent=2) + "\n")
    return [report, whole, *tables, *pictures, *note]
