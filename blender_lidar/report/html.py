"""HTML elements as text, tables, pictures, lists: what is put into one is escaped, unless it is an element itself."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable
from pathlib import Path

from ..errors import InputError
from ..files import read_file
from ..run.folder import refused_by_name

_VOID = {"meta", "img", "col"}  # have no closing tag
# What HTML does not allow even as a reference: control characters, halves of surrogate pairs, non-characters.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")
_LABELLED = re.compile(r"(\S+(?: \S+)*) {2,}(\S.*)")
_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_FIRST, _LAST = slice(12, 16), slice(-8, -4)  # names of the first chunk, which holds the size, and of the last
_WIDTH, _HEIGHT = slice(16, 20), slice(20, 24)


class Markup(str):
    """HTML that is ready."""

    __slots__ = ()


def escaped(text: object) -> Markup:
    """A text as HTML; what is HTML already stays as it is."""
    if isinstance(text, Markup):
        return text
    return Markup(html.escape(_FORBIDDEN.sub("\N{REPLACEMENT CHARACTER}", str(text))))


def joined(*parts: object) -> Markup:
    """Parts one after the other, each escaped; None and "" add nothing."""
    return Markup("".join(escaped(part) for part in parts if part is not None))


def element(tag: str, *content: object, **attributes: object) -> Markup:
    """An element.

    Parameters
    ----------
    tag : str
        Its name.
    *content : object
        Texts and elements.
    **attributes : object
        An underscore at the end of a name is left out and others become hyphens (``class_``, ``aria_label``); an
        attribute that is None is left out.
    """
    written = "".join(
        f' {name.removesuffix("_").replace("_", "-")}="{escaped(value)}"'
        for name, value in attributes.items()
        if value is not None
    )
    if tag in _VOID:
        return Markup(f"<{tag}{written}>")
    return Markup(f"<{tag}{written}>{joined(*content)}</{tag}>")


def many(tag: str, items: list[object], **attributes: object) -> Markup:
    """An element of the same kind for each item, a line each."""
    return Markup("\n".join(element(tag, item, **attributes) for item in items))


def table(caption: str, *parts: Markup, class_: str | None = None) -> Markup:
    """A table that scrolls by itself where the page is too narrow for it."""
    inner = element("table", element("caption", caption), *parts, class_=class_)
    return element("div", inner, class_="scroll", role="region", aria_label=caption, tabindex=0)


def terms(entries: Iterable[tuple[str, str]]) -> Markup:
    """A list of terms, each with what it means."""
    pairs = (joined(element("dt", term), element("dd", meaning)) for term, meaning in entries)
    return element("dl", *pairs, class_="terms")


def image(path: Path, alt: str) -> Markup:
    """A PNG within the page itself.

    Raises
    ------
    InputError
        When the file cannot be read or is no whole PNG.
    """
    with refused_by_name(path):
        data = read_file(path)
    if not data.startswith(_SIGNATURE) or data[_FIRST] != b"IHDR" or data[_LAST] != b"IEND":
        raise InputError(f"{path}: is no PNG picture, or not a whole one")
    width, height = (int.from_bytes(data[part], "big") for part in (_WIDTH, _HEIGHT))
    source = Markup(f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}")
    return element("img", src=source, width=width, height=height, alt=alt)


def sheet_markup(text: str) -> list[Markup]:
    """What installation.txt says, line by line.

    Lines ``- text`` become items of a list and lines ``Label    text`` terms and descriptions; an indented line goes on
    with the one above it, and any other is a heading. No word is left out, whatever the text.
    """
    blocks: list[tuple[str, list[list[str]]]] = [("", [])]  # kind, entries; an entry's words, its label before them
    for line in text.splitlines():
        words, labelled = line.strip(), _LABELLED.fullmatch(line)
        if not words:
            kind, entry = "", []  # what follows begins anew
        elif line.startswith("- "):
            kind, entry = "item", [line[2:].strip()]
        elif labelled and not line.startswith(" "):
            kind, entry = "term", [*labelled.groups()]
        elif line.startswith(" ") and blocks[-1][0]:
            blocks[-1][1][-1][-1] += f" {words}"
            continue
        else:
            kind, entry = "heading", [words]
        if blocks[-1][0] != kind:
            blocks.append((kind, []))
        blocks[-1][1].append(entry)
    return [_SET[kind](entries) for kind, entries in blocks if kind]


_SET = {
    "heading": lambda entries: many("h3", [text for (text,) in entries]),
    "item": lambda entries: element("ul", many("li", [text for (text,) in entries])),
    "term": terms,
}
