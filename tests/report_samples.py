"""Runs whose pages are looked at, and pages taken apart."""

from __future__ import annotations

import json
import struct
import zlib
from html.parser import HTMLParser
from pathlib import Path

import pytest

from blender_lidar.cli import main
from blender_lidar.document import as_json
from blender_lidar.report.page import report_html
from blender_lidar.run.answer import run_document
from blender_lidar.run.as_hung import AS_PLANNED
from blender_lidar.run.folder import RunFolder
from tests.small_scene import HEADER, MAPPED, traffic_rows, without_charts, write_scene, write_table

VOID = {"meta", "img"}


def hangs(scores: dict, **changes: object) -> dict:
    """Scores of a mounting with some changed, and the same as hung, as of a LiDAR that hangs already."""
    scores, names = scores | changes, {planned: hung for hung, planned in AS_PLANNED.items()}
    same = {names.get(key, key): value for key, value in scores.items()}
    return scores | {"as_hung": {key: same.get(key, value) for key, value in scores["as_hung"].items()}}


class Page(HTMLParser):
    """A page taken apart; an element that is not closed, or closed in the wrong order, is an error."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: list[tuple[tuple[str, ...], str]] = []  # the elements around each text, by number
        self._open: list[tuple[str, int]] = []
        self.declared: list[str] = []
        self.comments: list[str] = []
        self.feed(text)
        self.close()
        assert not self._open, f"never closed: {self._open}"

    def handle_decl(self, decl):
        self.declared.append(decl)

    def handle_comment(self, data):
        self.comments.append(data)

    def handle_starttag(self, tag, attrs):
        assert len(dict(attrs)) == len(attrs), f"<{tag}> has an attribute twice"
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append((tag, len(self.elements) - 1))

    def handle_endtag(self, tag):
        assert self._open, f"</{tag}> closes nothing"
        assert self._open[-1][0] == tag, f"</{tag}> closes <{self._open[-1][0]}>"
        self._open.pop()

    def handle_data(self, data):
        self.texts.append((tuple(number for _, number in self._open), data))

    def tags(self) -> list[str]:
        return [tag for tag, _ in self.elements]

    def find(self, tag: str, **attributes: str) -> list[int]:
        """Numbers of the elements of a kind."""
        return [
            number
            for number, (name, present) in enumerate(self.elements)
            if name == tag and attributes.items() <= present.items()
        ]

    def text(self, number: int) -> str:
        """All text within an element."""
        return "".join(text for around, text in self.texts if number in around)

    def within(self, tag: str, outer: int) -> list[int]:
        """Numbers of the elements of a kind whose text lies within another."""
        found = []
        for around, _ in self.texts:
            found += [n for n in around if outer in around and self.elements[n][0] == tag and n not in found]
        return found


def png(width: int, height: int, shade: int) -> bytes:
    """A whole grey PNG."""
    rows = b"".join(b"\0" + bytes([shade]) * width for _ in range(height))
    chunks = [
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows)),
        (b"IEND", b""),
    ]
    signature = b"\x89PNG\r\n\x1a\n"
    return signature + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def with_lanes() -> tuple[list[list[object]], tuple[str, ...]]:
    return [[*row, 1 + int(row[4] > 5.0)] for row in traffic_rows()], (*HEADER, "lane")


def make_runs(folder: Path) -> Path:
    """Three runs without charts: a search with a map and lanes, one mounting given, and one with nothing held out."""
    rows, header = with_lanes()
    write_table(folder / "traffic.csv", rows, header)
    scene, all_of_it = str(write_scene(folder, MAPPED)), {"traffic": {"holdout": 0.0}}
    mount = ["--height", "4", "--tilt-y", "-3", "--yaw", "5"]
    with pytest.MonkeyPatch.context() as patch:
        without_charts(patch)
        assert main(["optimise", scene, "--detail", "box", "--out", str(folder / "searched")]) == 0
        assert main(["evaluate", scene, *mount, "--out", str(folder / "given")]) == 0
        assert main(["optimise", str(write_scene(folder, all_of_it)), "--out", str(folder / "whole")]) == 0
    return folder


def page_of(folder: RunFolder) -> str:
    """The page of a run, made from its folder."""
    return report_html(RunFolder(folder.path))


def result_of(folder: RunFolder) -> dict:
    return json.loads(folder.file("result.json").read_text())


def change(folder: RunFolder, result: dict) -> None:
    """Write another result into a folder, with the document that it makes."""
    told = {"document": as_json(run_document(result))} if isinstance(result, dict) and "lidars" in result else {}
    folder.file("result.json").write_text(json.dumps({**result, **told} if told else result))


def said(result: dict, *kinds: str) -> str:
    """The statements of a result, of all kinds or of some, as one text with their labels."""
    found = run_document(result).statements
    return " ".join(
        f"{one.label}: {one.text}" if one.label else one.text for one in found if not kinds or one.kind in kinds
    )
