"""The start tags of an XML file, streamed: nothing is built, so that memory does not grow with the file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from ..errors import InputError
from .source import open_bytes

_BLOCK_BYTES = 2**18
_DEEPEST = 32  # SUMO's files nest four or five deep
_LONGEST_TOKEN = 2**20  # a tag or comment that never ends would be read again and again with every block


class Tag(NamedTuple):
    """One start tag.

    Attributes
    ----------
    line : int
        From 1.
    depth : int
        1 for the root element.
    name : str
    attributes : dict of str to str
    """

    line: int
    depth: int
    name: str
    attributes: dict[str, str]


def start_tags(path: str | Path) -> Iterator[list[Tag]]:
    """The start tags of a file, plain or gzip, a block of the file at a time.

    Raises
    ------
    MissingFileError, InputError
        As `open_bytes`; and if the file is not well-formed XML, nests absurdly deep, or declares an encoding that
        cannot be read or a document type, with which come entities.
    """
    path = Path(path)
    tags: list[Tag] = []
    depth = 0
    parser = expat.ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > _DEEPEST:
            raise InputError(f"{path}:{parser.CurrentLineNumber}: elements nest more than {_DEEPEST} deep")
        tags.append(Tag(parser.CurrentLineNumber, depth, name, attributes))

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse_document_type(*_declaration: object) -> None:
        raise InputError(
            f"{path}:{parser.CurrentLineNumber}: declares a document type (<!DOCTYPE ...>); SUMO's files have none"
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse_document_type
    with open_bytes(path) as stream:
        last, fed = False, 0
        while not last:
            block = stream.read(_BLOCK_BYTES)
            last, fed = not block, fed + len(block)
            try:
                parser.Parse(block, last)
            except expat.ExpatError as error:
                raise InputError(
                    f"{path}:{error.lineno}: truncated or damaged XML ({expat.ErrorString(error.code)})"
                ) from error
            except InputError:  # a ValueError too
                raise
            except (LookupError, ValueError) as error:  # unknown, or such as only a few encodings are
                raise InputError(
                    f"{path}: XML in an encoding that cannot be read ({error}); SUMO writes UTF-8"
                ) from error
            if fed - parser.CurrentByteIndex > _LONGEST_TOKEN + len(block):
                line = parser.CurrentLineNumber
                raise InputError(f"{path}:{line}: a tag or comment of more than {_LONGEST_TOKEN:,} bytes")
            yield tags
            tags = []
