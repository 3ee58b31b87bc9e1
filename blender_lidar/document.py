"""Results as typed quantities: numbers with units, 90 % intervals and their basis; statements, tables, a document.

Who computes makes them, once; who shows them (terminal, page, sheet, panel) looks nothing up, computes and rounds
nothing. The twin of `toml_table.Setting`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

# --- A number ---------------------------------------------------------------------------------------------------------

HELD_OUT, SEARCHED, SCORED, LEFT_OUT = "held-out", "searched", "scored", "left out in turn"
"""Splits of frames: those that did not choose the mounting, did, chose nothing, or did not in turn (cross-fitting)."""


class Basis(NamedTuple):
    """What a quantity stands on.

    Attributes
    ----------
    split : str
        `HELD_OUT`, `SEARCHED`, `SCORED` or `LEFT_OUT` frames.
    boxes, vehicles, blocks : int
        Boxes (a vehicle in a frame), different vehicles, blocks of time.
    hung : bool
        The mean over installation errors; otherwise exactly as planned.
    chosen_here : bool
        Whether what is judged was chosen on it, so that it has no interval.
    """

    split: str
    boxes: int = 0
    vehicles: int = 0
    blocks: int = 0
    hung: bool = False
    chosen_here: bool = False


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number that is shown.

    Attributes
    ----------
    key : str
        Its name in result.json.
    label : str
    value : float
        In its unit.
    unit : str
        "%", "points" (of per cent), "bits", "m", "°"; empty for a plain number.
    interval_90 : (float, float), or None
    basis : Basis, or None
        None in a table that has one, and of what was not measured.
    decimals : int
        Digits after the point without an interval; one more is the most with one.
    signed : bool
        A difference, which has a plus.
    shown : float, or None
        What is written in place of `value`, so that differences add up as they are written: see `adding_up`.
    """

    key: str
    label: str
    value: float
    unit: str = ""
    interval_90: tuple[float, float] | None = None
    basis: Basis | None = None
    decimals: int = 0
    signed: bool = False
    shown: float | None = None

    @property
    def number(self) -> str:
        """The number alone."""
        return self._written(self.value if self.shown is None else self.shown)

    @property
    def within(self) -> str:
        """The ends of its interval; "" without one."""
        return " to ".join(map(self._written, self.interval_90)) if self.interval_90 else ""

    def __str__(self) -> str:
        unit = self.unit if self.unit == "°" else f" {self.unit}"
        return f"{self.number}{unit}".rstrip() + (f" ({self.within})" if self.interval_90 else "")

    @property
    def digits(self) -> int:
        """Decimals that are written: with an interval down to its half-width's first digit, or the second of 1x."""
        if not self.interval_90 or self.shown is not None:
            return self.decimals
        step = (self.interval_90[1] - self.interval_90[0]) / 4.0
        most = self.decimals + 1
        return min(max(math.ceil(-math.log10(step)), 0), most) if step > 0.0 else most

    @property
    def holds_nought(self) -> bool | None:
        """Whether the interval holds 0; None without one."""
        return None if self.interval_90 is None else self.interval_90[0] <= 0.0 <= self.interval_90[1]

    def _written(self, number: float) -> str:
        digits = max(self.digits, 0)
        return f"{round(number, digits) + 0.0:{'+' if self.signed else '-'}.{digits}f}"  # what rounds to 0 has no minus


def adding_up(before: Quantity, after: Quantity, gain: Quantity) -> tuple[Quantity, Quantity, Quantity]:
    """Before, after and their difference with the same digits, so that the difference is that of what is written.

    A difference that is known to more digits than both, as of nearly equal mountings, or that would leave its interval
    is written by its own.
    """
    digits = min(before.digits, after.digits)
    if gain.digits > digits:
        return before, after, gain
    digits = min(digits, gain.digits)
    first, last = round(before.value, digits), round(after.value, digits)
    low, high = (-math.inf, math.inf) if gain.interval_90 is None else (round(end, digits) for end in gain.interval_90)
    if not low <= round(last - first, digits) <= high:
        return before, after, gain
    shown = first, last, last - first
    return tuple(
        replace(one, decimals=digits, shown=number) for one, number in zip((before, after, gain), shown, strict=True)
    )


# --- Statements, tables, and all of a result --------------------------------------------------------------------------

ANSWER, DOUBT, CAUTION, NOTE, ASSUMED, MEANING = "answer", "doubt", "caution", "note", "assumed", "meaning"
"""Kinds of statements: what was found, what leaves it in doubt, what to know first, the rest; what was assumed; what a
word means."""


@dataclass(frozen=True, slots=True)
class Statement:
    """A sentence, or a line behind a label, with the quantities that it writes.

    Attributes
    ----------
    kind : str
        One of the kinds above.
    text : str
    label : str
        What it is about, in two words; "" of a sentence.
    quantities : tuple of Quantity
    first : bool
        Whether it belongs to the twenty lines.
    """

    kind: str
    text: str
    label: str = ""
    quantities: tuple[Quantity, ...] = ()
    first: bool = False


def statement(kind: str, text: str, label: str = "", *, first: bool = False, **quantities: Quantity) -> Statement:
    """A statement whose text names its quantities in braces: ``"{gain}"``, or ``"{gain.number}"`` without the unit."""
    return Statement(kind, text.format(**quantities), label, tuple(quantities.values()), first)


@dataclass(frozen=True, slots=True)
class Table:
    """Quantities in columns.

    Attributes
    ----------
    key, title : str
    columns : tuple of str
        Heads, the first of what the rows are; one ``"group: head"`` stands under a group.
    rows : tuple of tuples
        A name, then a `Quantity`, a text or None in each column; a row of a name alone is a heading.
    basis : Basis, or None
        Of all of its cells.
    """

    key: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    basis: Basis | None = None


@dataclass(frozen=True, slots=True)
class Document:
    """All that is told of a result.

    Attributes
    ----------
    title : str
        What was judged, and on what.
    statements : tuple of Statement
        In the order in which they are read; doubts stand before figures.
    tables : tuple of Table
    settings : mapping of str to str
        How it was computed.
    """

    title: str
    statements: tuple[Statement, ...]
    tables: tuple[Table, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)

    def of(self, *kinds: str, first: bool = False) -> list[Statement]:
        """The statements of some kinds, or the `first` of these alone."""
        return [one for one in self.statements if one.kind in kinds and (one.first or not first)]

    def quantity(self, key: str) -> Quantity:
        """The quantity of that name in its statements."""
        return next(one for each in self.statements for one in each.quantities if one.key == key)


# --- As JSON ----------------------------------------------------------------------------------------------------------


def as_json(document: Document) -> dict[str, Any]:
    """A document as JSON holds it."""
    return {
        "title": document.title,
        "statements": [
            {**_given(one), "quantities": [_quantity_as_json(each) for each in one.quantities]}
            for one in document.statements
        ],
        "tables": [
            {
                **_given(one),
                "rows": [[_quantity_as_json(x) if isinstance(x, Quantity) else x for x in row] for row in one.rows],
                "basis": one.basis and one.basis._asdict(),
            }
            for one in document.tables
        ],
        "settings": dict(document.settings),
    }


def document_from(given: Mapping[str, Any]) -> Document:
    """A document from what `as_json` has made of it."""
    statements = (
        Statement(**{**one, "quantities": tuple(map(_quantity_from, one["quantities"]))}) for one in given["statements"]
    )
    tables = (
        Table(
            one["key"],
            one["title"],
            tuple(one["columns"]),
            tuple(tuple(_quantity_from(x) if isinstance(x, Mapping) else x for x in row) for row in one["rows"]),
            one["basis"] and Basis(**one["basis"]),
        )
        for one in given["tables"]
    )
    return Document(given["title"], tuple(statements), tuple(tables), given["settings"])


def _given(value: Any) -> dict[str, Any]:
    """The fields of a statement, quantity or table."""
    return {name: getattr(value, name) for name in value.__slots__}


def _quantity_as_json(quantity: Quantity) -> dict[str, Any]:
    """A quantity without what it has not."""
    told = _given(quantity) | {"basis": quantity.basis and quantity.basis._asdict()}
    return {name: value for name, value in told.items() if value is not None and value is not False}


def _quantity_from(given: Mapping[str, Any]) -> Quantity:
    ends, basis = given.get("interval_90"), given.get("basis")
    return Quantity(**{**given, "interval_90": ends and tuple(ends), "basis": basis and Basis(**basis)})


def listed(texts: Iterable[str]) -> str:
    """Texts as a sentence lists them: a, b and c."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def as_sentence(text: str) -> str:
    """A text that begins with a capital letter and ends with a full stop, if with no question mark."""
    return f"{text[0].upper()}{text[1:]}{'' if text.endswith(('?', '.')) else '.'}"
