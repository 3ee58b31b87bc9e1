"""``blender-lidar sensors``: the LiDAR models there are, and one of them in full."""

from __future__ import annotations

import argparse
import json
import math
import sys
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..report.beam_fan import MOUNT_HEIGHT_M, ground_distance_m, plot_beam_fan
from ..report.text import text_table
from ..sensors.model import LidarModel, load_model, model_names, with_columns

_WIDTH = 100
_BEAM = ("ring", "elevation_deg", "azimuth_offset_deg", "fire_offset_us")
_LISTING_NOTES = """
Elevation in degrees; columns and points at the default rotation rate, one return per beam. An
Ouster's columns are a choice: --columns 512, 1024 (the default) or 2048.
blender-lidar sensors NAME shows one in full; NAME may also be a sensor file of your own, or a maker's."""


def run(args: argparse.Namespace) -> int:
    """Print the list, or the model `args.name`; draw its fan if `args.out` is given.

    Raises
    ------
    BlenderLidarError
        An unknown model, a sensor file that cannot be used, a chart that cannot be drawn or written.
    """
    if args.name is None:
        if args.out is not None:
            allowed = ", ".join(model_names())
            raise InputError(f"--out {args.out}: draws one sensor, so it needs a NAME; allowed: {allowed}")
        found = [_summary(load_model(name)) for name in model_names()]
        print(json.dumps(found, indent=2) if args.json else _listing(found))
        return 0
    model = load_model(args.name)
    if args.out is not None:
        if Path(args.out).suffix.lower() != ".png":
            raise InputError(f"--out {args.out}: the fan is drawn as a .png")
        plot_beam_fan(model, Path(args.out))
        print(f"beam fan drawn: {args.out}", file=sys.stderr)
    print(json.dumps(_facts(model), indent=2) if args.json else _portrait(model))
    return 0


def _summary(model: LidarModel) -> dict[str, Any]:
    """The facts of the list, as JSON has them."""
    elevation = _degrees(model.elevation_rad)
    return {
        "name": model.name,
        "aliases": list(model.aliases),
        "description": model.description,
        "confidence": model.confidence,
        "rings": model.rings,
        "elevation_min_deg": elevation[0],
        "elevation_max_deg": elevation[-1],
        "default_rotation_hz": model.default_rotation_hz,
        "columns": model.columns(),
        "points_per_second": round(model.rings * model.columns() * model.default_rotation_hz * _seen_share(model)),
        "range_min_m": model.range_min_m,
        "range_max_m": model.range_max_m,
    }


def _seen_share(model: LidarModel) -> float:
    """Share of a turn that its horizontal field of view is."""
    low, high = model.azimuth_deg or (0.0, 360.0)
    return (high - low) / 360.0


def _facts(model: LidarModel) -> dict[str, Any]:
    """All facts of one sensor, as JSON has them; firing times that no source gives are None."""
    angles = _degrees(model.elevation_rad), _degrees(model.azimuth_offset_rad)
    fired = [None if math.isnan(time) else round(float(time) * 1e6, 6) for time in model.fire_time_s]
    beams = zip(range(model.rings), *angles, fired, strict=True)
    return {
        **_summary(model),
        "source": model.source,
        "rotation_hz": list(model.rotation_hz),
        "columns_by_rotation_hz": {f"{rate:g}": model.columns(rate) for rate in model.rotation_hz},
        "columns_a_turn": list(model.columns_a_turn),
        "block_time_us": round(model.block_time_us, 6),
        "azimuth_deg": model.azimuth_deg,
        "range_noise_m": model.range_noise_m,
        "range_at_10_percent_m": model.range_at_10_percent_m,
        "notes": list(model.notes),
        "assumed": model.assumptions,
        "beams": [dict(zip(_BEAM, beam, strict=True)) for beam in beams],
    }


def _degrees(angles: np.ndarray) -> list[float]:
    # Files give four decimals at most; what lies beyond is the way to radians and back. Adding 0 turns -0 into 0.
    return [round(float(angle), 6) + 0.0 for angle in np.degrees(angles)]


def _listing(models: Sequence[dict[str, Any]]) -> str:
    rows = [("name", "rings", "elevation", "columns", "points/s", "range [m]", "confidence", "also called")]
    rows += [
        (
            of["name"],
            str(of["rings"]),
            f"{of['elevation_min_deg']:+.3g} to {of['elevation_max_deg']:+.3g}",
            str(of["columns"]),
            f"{of['points_per_second']:,}",
            f"{of['range_min_m']:g}-{of['range_max_m']:g}",
            of["confidence"].partition(":")[0],
            ", ".join(of["aliases"]),
        )
        for of in models
    ]
    return "\n".join([*text_table(rows), _LISTING_NOTES])


def _portrait(model: LidarModel) -> str:
    of = _facts(model)
    columns = ", ".join(f"{count} at {rate} Hz" for rate, count in of["columns_by_rotation_hz"].items())
    default = f"{model.default_rotation_hz:g} Hz"
    usual = f"{default} is the default"
    if model.columns_a_turn:
        settings = [with_columns(model, count) for count in model.columns_a_turn]
        columns = ", ".join(f"{one.columns()} at {_listed(one.rotation_hz)} Hz" for one in settings)
        usual = f"{model.columns()} at {usual}"
    dark_m = model.range_at_10_percent_m
    values = {
        "also called": ", ".join(model.aliases),
        "rings": f"{model.rings}, {of['elevation_min_deg']:+.4g} to {of['elevation_max_deg']:+.4g} degrees",
        "field of view": "{:g} to {:g} degrees, clockwise".format(*model.azimuth_deg) if model.azimuth_deg else "",
        "columns a turn": f"{columns} ({usual})",
        "points a second": f"{of['points_per_second']:,} at {default}, one return per beam",
        "column every": f"{model.block_time_us:g} us" + (" at least" if model.columns_a_turn else ""),
        "range": f"{model.range_min_m:g} to {model.range_max_m:g} m, noise {model.range_noise_m:g} m (1 sigma)",
        "10 % target": "" if dark_m is None else f"seen to {dark_m:g} m",
        "confidence": model.confidence,
        "source": model.source,
        "as read": "; ".join(model.notes),
        "assumed": "; ".join(f"{text} ({key})" for key, text in model.assumptions.items()),
    }
    lines = textwrap.wrap(f"{model.name}: {model.description}" if model.description else model.name, _WIDTH)
    lines.append("")
    for name, text in values.items():
        if text:
            lines += textwrap.wrap(f"{name:<17}{text}", _WIDTH, subsequent_indent=" " * 17, break_on_hyphens=False)
    return "\n".join([*lines, "", *_ring_table(model, of["beams"])])


def _listed(rates: Sequence[float]) -> str:
    return " or ".join(f"{rate:g}" for rate in rates)


def _ring_table(model: LidarModel, beams: Sequence[dict[str, Any]]) -> list[str]:
    rows = [("ring", "elevation", "azimuth", "fired", "road at"), ("", "deg", "deg", "us", "m")]
    for beam, distance in zip(beams, ground_distance_m(model), strict=True):
        ring, elevation, azimuth, fired = beam.values()
        fired = "?" if fired is None else f"{fired:.3f}"
        road = f"{distance:.1f}" if math.isfinite(distance) else "-"
        rows.append((str(ring), f"{elevation:.3f}", f"{azimuth:.3f}", fired, road))
    return [
        *("{:>4} {:>9} {:>8} {:>7} {:>8}".format(*row) for row in rows),
        "",
        f"azimuth: from that of the firing column, clockwise positive; road at: met when level at {MOUNT_HEIGHT_M:g} m",
    ]
