"""[objective] tolerance of a scene: how far off its plan a mounting may end up."""

from __future__ import annotations

from .errors import InputError
from .settings import Tolerance
from .toml_table import TomlTable

AIMS = ("mean", "low")
_MOST = {"height_m": 1.0, "tilt_deg": 10.0, "yaw_deg": 10.0}  # beyond, it is another mounting and not an error


def tolerance_settings(table: TomlTable | None) -> Tolerance | None:
    """The settings of a table of half-widths, None where there is none.

    Raises
    ------
    InputError
        Naming the file, the table and the key.
    """
    if table is None:
        return None
    widths = {key: table.number(key, 0.0, low=0.0, high=most) for key, most in _MOST.items()}
    tolerance = Tolerance(**widths, aim=table.text("aim", AIMS[0], allowed=AIMS))
    table.finish()
    if not tolerance.half_widths:
        raise InputError(f"{table}: leaves every coordinate exact; allowed: at least one of {', '.join(_MOST)} above 0")
    return tolerance
