"""The installation sheet as a part of the page: its plain text, set so that it can be read on a phone on the ladder."""

from __future__ import annotations

import re

from .elements import Markup, element, joined, many

_LABELLED = re.compile(r"(\S+(?: \S+)*) {2,}(\S.*)")


def sheet_markup(text: str) -> list[Markup]:
    """What installation.txt says, line by line.

    Lines ``- text`` become items of a list and lines ``Label    text`` terms and descriptions; an indented line goes on
    with the one above it, and any other is a heading. No word is left out, whatever the text.
    """
    blocks: list[tuple[str, list[list[str]]]] = []  # kind, entries; an entry's words, the label first where it has one
    for line in text.splitlines():
        words, labelled = line.strip(), _LABELLED.fullmatch(line)
        if not words:
            blocks.append(("", []))  # what follows begins anew
        elif line.startswith("- "):
            _append(blocks, "item", [line[2:].strip()])
        elif labelled and not line.startswith(" "):
            _append(blocks, "term", [*labelled.groups()])
        elif line.startswith(" ") and blocks and blocks[-1][0] in _SET:
            blocks[-1][1][-1][-1] += f" {words}"
        else:
            _append(blocks, "heading", [words])
    return [_SET[kind](entries) for kind, entries in blocks if entries]


def _append(blocks, kind, entry):
    if not blocks or blocks[-1][0] != kind:
        blocks.append((kind, []))
    blocks[-1][1].append(entry)


def _headings(entries):
    return many("h3", [text for (text,) in entries])


def _items(entries):
    return element("ul", many("li", [text for (text,) in entries]))


def _terms(entries):
    pairs = [joined(element("dt", label), element("dd", text)) for label, text in entries]
    return element("dl", *pairs, class_="terms")


_SET = {"heading": _headings, "item": _items, "term": _terms}
