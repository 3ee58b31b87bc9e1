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
_HEADING = re.compile(r"(?m)^((?!- )\S+(?: \S+)*)$")
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


def table(caption: str, *parts: Markup, class_: str | None = None) -> Markup:
    """A table that scrolls by itself where the page is too narrow for it."""
    inner = element("table", element("caption", caption), *parts, class_=class_)
    return element("div", inner, class_="scroll", role="region", aria_label=caption, tabindex=0)


def terms(entries: Iterable[tuple[str, str]], class_: str = "terms") -> Markup:
    """A list of terms, each with what it means."""
    pairs = (joined(element("dt", term), element("dd", meaning)) for term, meaning in entries)
    return element("dl", *pairs, class_=class_)


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
    """What installation.txt says, as it stands, except for its headings.

    A heading is a line that is no item of a list, ``- text``, no ``Label    text`` and not indented.
    """
    parts = _HEADING.split(text)  # before the first heading, then each heading and what is below it
    return [
        element("h3" if number % 2 else "pre", part.strip("\n")) for number, part in enumerate(parts) if part.strip()
    ]
