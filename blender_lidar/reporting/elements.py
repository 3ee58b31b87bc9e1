"""HTML elements as text: whatever is put into one is escaped, unless it is an element itself."""

from __future__ import annotations

import html
import re

_VOID = {"meta", "img", "col"}  # have no closing tag
# What HTML does not allow even as a reference: control characters, halves of surrogate pairs, non-characters.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef\ufffe\uffff]")


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


def minus(text: str) -> str:
    """A number's text with a minus that is as wide as a plus."""
    return text.replace("-", "\N{MINUS SIGN}")


def many(tag: str, items: list[object], **attributes: object) -> Markup:
    """An element of the same kind for each item, a line each."""
    return Markup("\n".join(element(tag, item, **attributes) for item in items))
