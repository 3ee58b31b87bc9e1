"""What `compare --paired` has found of each level of detail against a real LiDAR, to stand beside the chart."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from ..errors import InputError
from ..input_file import read_text
from ..reality.paired_output import RESULT
from ..reality.paired_statistics import judging

OPTION = "--paired"


def read_paired(path: str | Path) -> dict:
    """The errors of a paired comparison, from its `paired.json` or the folder that holds it.

    Returns
    -------
    dict
        ``file``, ``set``, ``cars`` and ``variants``: of each detail and losses the median absolute error of PE-VGOP per
        car and its 90 % interval [bits], or None.

    Raises
    ------
    MissingFileError, InputError
        When there is no such file, or it is not of a paired comparison.
    """
    path = Path(path)
    path = path / RESULT if path.is_dir() else path
    try:
        sets = json.loads(read_text(path))["sets"]
        name = judging(sets)
        variants = [_variant(one) for one in sets[name]["variants"]]
        return {"file": path.name, "set": name, "cars": int(sets[name]["cars"]), "variants": variants}
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{OPTION}: {path}: is no {RESULT} of blender-lidar compare --paired") from error


def _variant(one: Mapping) -> dict:
    error = one["absolute_error_bits"]
    interval = error["interval_90"]
    return {
        "detail": str(one["detail"]),
        "losses": str(one["losses"]),
        "error_bits": float(error["median"]),
        "interval_90": None if interval is None else [float(end) for end in interval],
    }
