"""The report of a study, `chart` or `stability`: its sections as text and as Markdown, its tables and its pictures."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from ..errors import MissingExtraError
from ..files import to_csv, write_text
from ..run.words import warnings_text
from ..studies.driver import StudyFolder
from .text import WIDTH, markdown_table, text_table

PAGE = "report.md"


class Section(NamedTuple):
    """A part of a report: its heading, a table, its header first, and lines below; what is empty is left out."""

    heading: str
    table: Sequence[Sequence[str]]
    lines: Sequence[str]


@dataclass(frozen=True, slots=True)
class StudyReport:
    """How a study tells what it came to; all callables are given its result.

    Attributes
    ----------
    title : str
    result : str
        Name of the file that holds the result itself, as JSON.
    tables : mapping of str to callable
        Rows of each CSV file, by its name; a column may be missing in some of them. Keys of a mapping, and the ends of
        an interval, get columns of their own.
    pictures : mapping of str to callable
        Draws a picture at the path that it is given first, by its name; False where there is nothing to draw.
    sections : callable
        The sections, the same for a page and for a terminal.
    answer : callable
        Lines with what it comes to: the first ones of a page, and the last ones on a terminal.
    """

    title: str
    result: str
    tables: Mapping[str, Callable[[Mapping], Sequence[Mapping]]]
    pictures: Mapping[str, Callable[[Path, Mapping], bool]]
    sections: Callable[[Mapping], Sequence[Section]]
    answer: Callable[[Mapping], Sequence[str]]

    def write(self, folder: StudyFolder, result: Mapping) -> list[str]:
        """Write tables, pictures, the report and, last of all, the whole result; returns the names of the files.

        Without matplotlib there are no pictures, and the last name says so.
        """
        for name, rows_of in self.tables.items():
            rows = [
                dict(column for key, value in row.items() for column in _columns(key, value)) for row in rows_of(result)
            ]
            columns = list(dict.fromkeys(key for row in rows for key in row))
            write_text(folder.file(name), to_csv(columns, [[row.get(key, "") for key in columns] for row in rows]))
        drawn, note = [], []
        try:
            drawn = [name for name, draw in self.pictures.items() if draw(folder.file(name), result)]
        except MissingExtraError as error:
            note = [f"no pictures: {error}"]
        write_text(folder.file(PAGE), self.markdown(result, drawn))
        write_text(folder.file(self.result), json.dumps(result, indent=2) + "\n")
        return [PAGE, self.result, *self.tables, *drawn, *note]

    def text(self, result: Mapping) -> str:
        """The report for a terminal, the answer first."""
        parts = []
        first = Section("", (), [*warnings_text(result), *self.answer(result)])
        for heading, table, lines in (first, *self.sections(result)):
            texts = (textwrap.fill(line, WIDTH, subsequent_indent="  ") for line in lines)
            parts.append("\n".join([*filter(None, [heading]), *text_table(table), *texts]))
        return "\n\n".join(parts)

    def markdown(self, result: Mapping, pictures: Sequence[str]) -> str:
        """The report as a page of Markdown, the answer first."""
        first = (*warnings_text(result), *self.answer(result))
        parts = [f"# {self.title}", "", *(f"- **{line}**" for line in first), ""]
        for heading, table, lines in self.sections(result):
            parts += [f"## {heading}", ""] if heading else []
            parts += [*markdown_table(table), ""] if table else []
            parts += [*(f"- {line}" for line in lines), ""] if lines else []
            if not heading:
                parts += [f"![{name.removesuffix('.png').replace('_', ' ')}]({name})" for name in pictures] + [""]
        return "\n".join(parts)


def _columns(key: str, value: object) -> list[tuple[str, object]]:
    """The columns of a value, one level deep."""
    if key.endswith("interval_90"):
        value = dict(zip(("low", "high"), value or (None, None), strict=True))
    return [(f"{key}_{name}", one) for name, one in value.items()] if isinstance(value, Mapping) else [(key, value)]
