"""A document for a terminal: its twenty lines, or all of it; tables in columns."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Iterable, Iterator, Sequence

from ..document import ANSWER, ASSUMED, CAUTION, DOUBT, MEANING, NOTE, Document, Quantity, Statement, Table

WIDTH = 120  # of texts for a terminal
_NARROWEST = 40  # of a table's last column, which is wrapped
_SHORT = 110  # of what was assumed, among the first lines
_MARK = {DOUBT: "! ", CAUTION: "! ", NOTE: "  "}


def document_text(document: Document, where: Sequence[str] = (), *, every: bool = False) -> str:
    """What is told first: the answer, what to know before acting, and `where` the results are; or `every` thing."""
    doubts, answers = document.of(DOUBT), document.of(ANSWER, first=not every)
    label = max((len(one.label) for one in answers), default=0)
    parts = [
        _wrapped("", document.title),
        [line for one in doubts for line in _wrapped(f"  {_MARK[DOUBT]}", one.text)]
        + [line for one in answers for line in _wrapped(f"  {one.label:<{label}}  ", one.text)],
        list(_to_know(document, every)),
        [line for text in _meanings(document, every) for line in _wrapped("", text)],
        *([table_text(table)] for table in document.tables if every),
        list(where),
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _to_know(document: Document, every: bool) -> Iterator[str]:
    """Cautions, notes and assumptions; of these only what is assumed among the first lines."""
    found = [one for kind in (CAUTION, NOTE) for one in document.of(kind, first=not every)]
    assumed = document.of(ASSUMED)
    if found or assumed:
        yield "Before you act"
    for one in found:
        yield from _wrapped(f"  {_MARK[one.kind]}", one.text)
    for one in assumed:
        text = f"Assumed: {one.text}"
        yield from _wrapped("    ", text if every else textwrap.shorten(text, _SHORT, placeholder=" ..."))


def labelled(one: Statement) -> str:
    """A statement behind its label, if it has one."""
    return f"{one.label}: {one.text}" if one.label else one.text


def _meanings(document: Document, every: bool) -> list[str]:
    """What words mean; the first alone after what brackets hold."""
    if every:
        return [labelled(one) for one in document.of(MEANING)]
    return [" ".join(["( ) 90 % interval.", *(labelled(one) for one in document.of(MEANING, first=True))])]


def _wrapped(indent: str, text: str) -> list[str]:
    """A text on lines that fit the terminal, the first behind an `indent`."""
    width = min(shutil.get_terminal_size((WIDTH, 24)).columns, WIDTH)
    return textwrap.wrap(
        text, width, initial_indent=indent, subsequent_indent=" " * len(indent), break_on_hyphens=False
    )


def short_lines(document: Document) -> list[str]:
    """What is told first, for a panel: doubts, the answer, cautions, and what brackets hold."""
    return [*map(labelled, document.of(DOUBT, ANSWER, CAUTION, first=True)), "In brackets 90 % intervals."]


def filled(sentences: Iterable[str]) -> str:
    """Sentences, each once and on lines of its own that fit the terminal."""
    return "\n".join(line for sentence in dict.fromkeys(sentences) for line in _wrapped("", sentence))


# --- Tables -----------------------------------------------------------------------------------------------------------


def columns_of(table: Table) -> tuple[list[tuple[str, str]], list[list[str]]]:
    """Heads, each a group and a text, and rows of texts: an interval has a column of its own beside its number.

    A unit that all quantities of a column have stands in its head; where they differ, in the row's name.
    """
    rows = [row for row in table.rows if len(row) > 1]
    heads, cells = [("", table.columns[0])], [[str(row[0])] for row in table.rows]
    for number, head in enumerate(table.columns[1:], start=1):
        found = [row[number] for row in rows]
        units = {one.unit for one in found if isinstance(one, Quantity)}
        with_interval = any(isinstance(one, Quantity) and one.interval_90 for one in found)
        group, _, text = head.rpartition(": ")
        heads.append((group, f"{text} [{units.pop()}]" if len(units) == 1 and units != {""} else text))
        if with_interval:
            heads.append((group, "90 %"))
        for line, row in zip(cells, table.rows, strict=True):
            cell = row[number] if len(row) > 1 else None
            line.append(cell.number if isinstance(cell, Quantity) else cell or "")
            if with_interval:
                line.append(cell.within if isinstance(cell, Quantity) else "")
    if any(
        len({one.unit for one in column if isinstance(one, Quantity)}) > 1
        for column in list(zip(*rows, strict=True))[1:]
    ):
        for line, row in zip(cells, table.rows, strict=True):
            units = {one.unit: None for one in row[1:] if isinstance(one, Quantity) and one.unit}
            line[0] += f" [{', '.join(units)}]" if units else ""
    return heads, cells


def table_text(table: Table) -> str:
    """A table in columns: the first flush left, numbers flush right."""
    heads, cells = columns_of(table)
    groups = [group if not number or group != heads[number - 1][0] else "" for number, (group, _) in enumerate(heads)]
    is_heading = [len(row) == 1 and len(table.columns) > 1 for row in table.rows]
    indent = "  " * any(is_heading)
    rows = [[head for _, head in heads]]
    rows += [[line[0] if bare else indent + line[0], *line[1:]] for line, bare in zip(cells, is_heading, strict=True)]
    rows = [groups, *rows] if any(groups) else rows
    widths = [max(len(row[number]) for row in rows[any(groups) :]) for number in range(len(heads))]
    lines = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in rows[any(groups) :]
    ]
    if any(groups):
        lines.insert(0, _over(groups, widths))
    return "\n".join([table.title, *lines])


def _over(groups: Sequence[str], widths: Sequence[int]) -> str:
    """The line of groups above the heads, each from its first column on."""
    line, start = "", 0
    for group, width in zip(groups, widths, strict=True):
        line = line.ljust(start) + group if group else line
        start += width + 2
    return line.rstrip()


def text_table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows, the header first, in columns; the last column is wrapped to the width of a terminal."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)][:-1]
    indent = sum(widths) + 2 * len(widths)
    lines = []
    for *cells, last in rows:
        start = "".join(f"{cell:<{width}}  " for cell, width in zip(cells, widths, strict=True))
        found = textwrap.wrap(last, max(WIDTH - indent, _NARROWEST)) or [""]
        lines += [(start + found[0]).rstrip(), *(" " * indent + more for more in found[1:])]
    return lines


def markdown_table(rows: Iterable[Sequence[str]]) -> list[str]:
    """Rows, the header first, as a table of Markdown."""
    header, *rest = rows
    return [f"| {' | '.join(row)} |" for row in (header, ["---"] * len(header), *rest)]
