"""``blender-lidar sensors``: the LiDAR models there are, and one of them in full."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..report.beam_fan import MOUNT_HEIGHT_M, fan_text, ground_distance_m, plot_beam_fan
from ..sensors.model import LidarModel, load_model, model_names

_WIDTH = 100
_ONE_BLOCK_RINGS = 20  # longer ring tables are folded into two blocks side by side
_BLOCK_GAP = " " * 6
_RING_ROW = "{:>4} {:>9} {:>8} {:>7} {:>8}"
_RING_HEADER = (("ring", "elevation", "azimuth", "fired", "road at"), ("", "deg", "deg", "us", "m"))


def add_parser(subparsers: argparse._SubParsersAction) -> None:
    """Add the ``sensors`` verb to the command line."""
    parser = subparsers.add_parser(
        "sensors",
        help="list the LiDAR models, or show one with its beam fan",
        description="List the LiDAR models; with NAME show one in full, with its beam fan and its table of rings.",
    )
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="a model's name or alias, or the path of a .toml or .csv"
    )
    parser.add_argument("--json", action="store_true", help="print JSON on stdout and nothing else there")
    parser.add_argument("--out", type=Path, metavar="PNG", help="draw NAME's beam fan into this file")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the list, or the model `args.name`; draw its fan if `args.out` is given.

    Raises
    ------
    BlenderLidarError
        An unknown model, a sensor file that cannot be used, a chart that cannot be drawn or written.
    """
    if args.name is None:
        if args.out is not None:
            raise InputError(
                f"--out {args.out}: draws one sensor, so it needs a NAME; allowed: {', '.join(model_names())}"
            )
        models = [load_model(name) for name in model_names()]
        print(_json([_summary(model) for model in models]) if args.json else _listing(models))
        return 0
    model = load_model(args.name)
    if args.out is not None:
        if args.out.suffix.lower() != ".png":
            raise InputError(f"--out {args.out}: the fan is drawn as a .png")
        plot_beam_fan(model, args.out)
        print(f"beam fan drawn: {args.out}", file=sys.stderr)
    print(_json(_facts(model)) if args.json else _portrait(model))
    return 0


def _summary(model: LidarModel) -> dict[str, Any]:
    low, high = _degrees(model.elevation_rad[[0, -1]])
    return {
        "name": model.name,
        "aliases": list(model.aliases),
        "description": model.description,
        "confidence": model.confidence,
        "rings": model.rings,
        "elevation_min_deg": low,
        "elevation_max_deg": high,
        "default_rotation_hz": model.default_rotation_hz,
        "columns": model.columns(),
        "points_per_second": _points_per_second(model),
        "range_min_m": model.range_min_m,
        "range_max_m": model.range_max_m,
    }


def _facts(model: LidarModel) -> dict[str, Any]:
    names = ("ring", "elevation_deg", "azimuth_offset_deg", "fire_offset_us")
    return {
        **_summary(model),
        "source": model.source,
        "rotation_hz": list(model.rotation_hz),
        "columns_by_rotation_hz": {f"{rate:g}": model.columns(rate) for rate in model.rotation_hz},
        "block_time_us": round(model.block_time_s * 1e6, 6),
        "range_noise_m": model.range_noise_m,
        "range_at_10_percent_m": model.range_at_10_percent_m,
        "beams": [dict(zip(names, beam, strict=True)) for beam in _beams(model)],
    }


def _beams(model: LidarModel) -> list[tuple[int, float, float, float | None]]:
    """Ring, elevation [degrees], azimuth offset [degrees], fire offset [us; None where not known] of every beam."""
    elevation, azimuth = _degrees(model.elevation_rad), _degrees(model.azimuth_offset_rad)
    fire = [None if math.isnan(time) else round(float(time) * 1e6, 6) for time in model.fire_time_s]
    return list(zip(range(model.rings), elevation, azimuth, fire, strict=True))


def _degrees(angles: np.ndarray) -> list[float]:
    # Files give four decimals at most; what lies beyond is the way to radians and back. Adding 0 turns -0 into 0.
    return [round(float(angle), 6) + 0.0 for angle in np.degrees(angles)]


def _points_per_second(model: LidarModel) -> int:
    return round(model.rings * model.columns() * model.default_rotation_hz)


def _json(content: object) -> str:
    return json.dumps(content, indent=2, allow_nan=False)


def _listing(models: Sequence[LidarModel]) -> str:
    header = ("name", "rings", "elevation", "columns", "points/s", "range [m]", "confidence", "also called")
    rows = [_listing_row(model) for model in models]
    widths = [max(map(len, cells)) for cells in zip(header, *rows, strict=True)]
    # Numbers to the right, words to the left.
    template = "  ".join(f"{{:{side}{width}}}" for side, width in zip("<><>><<<", widths, strict=True))
    lines = [template.format(*row).rstrip() for row in (header, ["-" * width for width in widths], *rows)]
    return "\n".join(
        [
            *lines,
            "",
            "Elevation in degrees; columns and points at the default rotation rate, one return per beam.",
            "blender-lidar sensors NAME shows one in full; NAME may also be the path of your own .toml or .csv.",
        ]
    )


def _listing_row(model: LidarModel) -> tuple[str, ...]:
    low, high = _degrees(model.elevation_rad[[0, -1]])
    return (
        model.name,
        str(model.rings),
        f"{low:+.3g} to {high:+.3g}",
        str(model.columns()),
        f"{_points_per_second(model):,}",
        f"{model.range_min_m:g}-{model.range_max_m:g}",
        model.confidence.partition(":")[0],
        ", ".join(model.aliases),
    )


def _portrait(model: LidarModel) -> str:
    low, high = _degrees(model.elevation_rad[[0, -1]])
    columns = ", ".join(f"{model.columns(rate)} at {rate:g} Hz" for rate in model.rotation_hz)
    facts = {
        "also called": ", ".join(model.aliases),
        "rings": f"{model.rings}, {low:+.4g} to {high:+.4g} degrees",
        "columns a turn": f"{columns} ({model.default_rotation_hz:g} Hz is the default)",
        "points a second": f"{_points_per_second(model):,} at {model.default_rotation_hz:g} Hz, one return per beam",
        "column every": f"{model.block_time_s * 1e6:g} us",
        "range": f"{model.range_min_m:g} to {model.range_max_m:g} m, noise {model.range_noise_m:g} m (1 sigma)",
        "10 % target": "" if model.range_at_10_percent_m is None else f"seen to {model.range_at_10_percent_m:g} m",
        "confidence": model.confidence,
        "source": model.source,
    }
    title = f"{model.name}: {model.description}" if model.description else model.name
    return "\n".join(
        [
            *textwrap.wrap(title, _WIDTH),
            "",
            *(line for name, text in facts.items() if text for line in _paragraph(name, text)),
            "",
            f"Level at {MOUNT_HEIGHT_M:g} m, from the side, heights stretched; below it how many rings meet the road",
            "",
            fan_text(model),
            "",
            *_ring_table(model),
        ]
    )


def _paragraph(name: str, text: str) -> list[str]:
    return textwrap.wrap(text, _WIDTH, initial_indent=f"{name:<17}", subsequent_indent=" " * 17, break_on_hyphens=False)


def _ring_table(model: LidarModel) -> list[str]:
    rows = []
    for (ring, elevation, azimuth, fire), distance in zip(_beams(model), ground_distance_m(model), strict=True):
        fired = "?" if fire is None else f"{fire:.3f}"
        road = f"{distance:.1f}" if math.isfinite(distance) else "-"
        rows.append(_RING_ROW.format(ring, f"{elevation:.3f}", f"{azimuth:.3f}", fired, road))
    height = len(rows) if len(rows) <= _ONE_BLOCK_RINGS else math.ceil(len(rows) / 2)
    header = [_RING_ROW.format(*names) for names in _RING_HEADER]
    blocks = [[*header, *rows[start : start + height]] for start in range(0, len(rows), height)]
    return [
        *(_BLOCK_GAP.join(lines).rstrip() for lines in itertools.zip_longest(*blocks, fillvalue="")),
        "",
        f"azimuth: from that of the firing column, clockwise positive; road at: met when level at {MOUNT_HEIGHT_M:g} m",
    ]
