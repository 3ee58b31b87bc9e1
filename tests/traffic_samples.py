"""Text in NGSIM's dialects, made up: vehicles at constant speed in six lanes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from blender_lidar.errors import BlenderLidarError
from blender_lidar.traffic import Recording, read_traffic

P1_ORIGIN_MS = 1_113_433_134_900
"""Global_Time of frame 0 of I-80's first period; the others begin 3,632 s and 4,430 s later."""
P2_ORIGIN_MS = P1_ORIGIN_MS + 3_632_000
P3_ORIGIN_MS = P1_ORIGIN_MS + 4_430_000

_FIRST_14 = [
    *("Vehicle_ID", "Frame_ID", "Total_Frames", "Global_Time", "Local_X", "Local_Y", "Global_X", "Global_Y"),
    *("v_Length", "v_Width", "v_Class", "v_Vel", "v_Acc", "Lane_ID"),
]
_ARTERIAL = ["O_Zone", "D_Zone", "Int_ID", "Section_ID", "Direction", "Movement"]
_LAST_4 = ["Preceding", "Following", "Space_Headway", "Time_Headway"]
NATIVE_COLUMNS = [*_FIRST_14, *_LAST_4]
PORTAL_COLUMNS = [*_FIRST_14, *_ARTERIAL, *_LAST_4, "Location"]
PORTAL_COLUMNS[8] = "v_length"  # as the portal writes it

Columns = dict[str, np.ndarray]
"""Native column name to (n,) values, in NGSIM's units."""


def columns(
    vehicles: int = 12,
    frames: int = 120,
    *,
    first_frame: int = 100,
    frame_step: int = 1,
    origin_ms: int = P1_ORIGIN_MS,
    seed: int = 0,
) -> Columns:
    """Rows by vehicle, then frame, as the native files are ordered; vehicle ids count from 1."""
    rng = np.random.default_rng(seed)
    number = np.repeat(np.arange(vehicles), frames)
    frame = np.tile(first_frame + frame_step * np.arange(frames), vehicles)
    elapsed_s = (frame - first_frame) * 0.1
    lane = np.arange(vehicles) % 6 + 1
    speed = rng.uniform(15.0, 45.0, 6)[lane - 1]
    v_class = np.where(np.arange(vehicles) % 10 == 9, 3, 2)
    length = np.where(v_class == 3, rng.uniform(25, 50, vehicles), rng.uniform(13, 18, vehicles)).round(1)
    zero = np.zeros(len(number))
    return {
        "Vehicle_ID": number + 1,
        "Frame_ID": frame,
        "Total_Frames": np.full(len(number), frames),
        "Global_Time": origin_ms + 100 * frame,
        "Local_X": (lane * 12 - 6.0)[number],
        "Local_Y": (100.0 + 60.0 * (number // 6) + speed[number] * elapsed_s).round(3),
        "Global_X": zero + 6042842.116,
        "Global_Y": zero + 2133117.662,
        "v_Length": length[number],
        "v_Width": np.where(v_class == 3, 8.5, 6.4)[number],
        "v_Class": v_class[number],
        "v_Vel": speed[number].round(2),
        "v_Acc": zero,
        "Lane_ID": lane[number],
        "Preceding": zero.astype(int),
        "Following": zero.astype(int),
        "Space_Headway": zero,
        "Time_Headway": zero + 9999.99,
    }


def joined(*parts: Columns) -> Columns:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def picked(given: Columns, which: np.ndarray) -> Columns:
    return {name: values[which] for name, values in given.items()}


def native(given: Columns, *, arterial: bool = False, separator: str = " ", line_end: str = " \n") -> str:
    """18 or 24 columns without a header, padded as the native files are unless the separator is a tab or comma."""
    names = NATIVE_COLUMNS if not arterial else PORTAL_COLUMNS[:-1]
    given = given | {"v_length": given["v_Length"]}
    texts = [[str(value) for value in given[name].tolist()] if name in given else None for name in names]
    width = 9 if separator == " " else 0
    rows = zip(*(text if text is not None else ["3"] * len(given["Frame_ID"]) for text in texts), strict=True)
    return "".join(separator.join(field.rjust(width) for field in row) + line_end for row in rows)


def portal(given: Columns, location: str = "i-80", *, header: bool = True) -> str:
    """The web portal's CSV: byte-order mark, changed letter case, quoted thousands, CRLF, frames descending."""
    lines = ["\ufeff" + ",".join(PORTAL_COLUMNS)] if header else []
    known = {name.lower(): values for name, values in given.items()}
    for row in reversed(range(len(given["Frame_ID"]))):
        fields = []
        for name in PORTAL_COLUMNS:
            value = known[name.lower()][row].item() if name.lower() in known else ""
            counted = name in ("Frame_ID", "Total_Frames", "Local_Y") and value >= 1000
            fields.append(f'"{value:,}"' if counted else str(value))
        fields[-1] = location
        lines.append(",".join(fields))
    return "\r\n".join(lines) + "\r\n"


def api(given: Columns, location: str = "i-80") -> str:
    """The portal's API: lower case, plain numbers, missing ones NULL, ordered by time."""
    lines = [",".join(PORTAL_COLUMNS).lower()]
    known = {name.lower(): values for name, values in given.items()}
    for row in np.lexsort((given["Vehicle_ID"], given["Frame_ID"])):
        fields = [str(known[name.lower()][row]) if name.lower() in known else "NULL" for name in PORTAL_COLUMNS]
        fields[-1] = location
        lines.append(",".join(fields))
    return "\n".join(lines) + "\n"


def assert_same_boxes(given: Recording, expected: Recording) -> None:
    for name in ("frame", "vehicle_id", "class_index", "centre_m", "size_m", "heading_rad", "lane", "frame_time_s"):
        np.testing.assert_array_equal(getattr(given, name), getattr(expected, name), err_msg=name)
    assert given.time_step_s == expected.time_step_s


def write(folder: Path, text: str) -> Path:
    """A recording of that text."""
    path = folder / "recording.txt"
    path.write_text(text, encoding="utf-8", newline="")
    return path


def refused(path: Path, read: Callable = read_traffic, **settings: object) -> str:
    """The one line that a file is refused with; the file is called FILE in it."""
    with pytest.raises(BlenderLidarError) as caught:
        read(path, **settings)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(str(path), "FILE")
