"""[world] of a scene: what there is besides vehicles."""

from __future__ import annotations

from pathlib import Path

from .errors import InputError
from .settings import BarrierSettings, BoxSettings, WorldSettings
from .toml_table import TomlTable
from .world.barriers import BARRIERS

_BARRIER_X_M, _LONGEST_BARRIER_M = (-200.0, 200.0), 10_000.0
_FARTHEST_M = 1e6  # rays are cast in single precision, which beyond has steps of decimetres


def world_settings(table: TomlTable, folder: Path) -> WorldSettings:
    """The settings of [world] but for the vehicles' level of detail; paths in it start from `folder`.

    Raises
    ------
    InputError
        Naming the file, the table and the key.
    """
    files = {key: table.text(key, None) for key in ("blend", "mesh")}
    for key, name in files.items():
        if name is not None and (Path(name).suffix.lower() == ".blend") != (key == "blend"):
            allowed = "a .blend file" if key == "blend" else "a mesh file that Blender reads; .blend files go to blend"
            raise InputError(f"{table.where(key)}: is {name!r}; allowed: {allowed}")
    return WorldSettings(
        ground=table.boolean("ground", True),
        **{key: None if name is None else str(folder / name) for key, name in files.items()},
        origin_m=table.numbers("origin_m", (0.0, 0.0, 0.0), count=3, largest=1e9),
        heading_deg=table.number("heading_deg", 0.0, low=-360.0, high=360.0),
        boxes=tuple(_box(entry, number) for number, entry in enumerate(table.table_list("boxes"), start=1)),
        barriers=tuple(_barrier(entry) for entry in table.table_list("barriers")),
    )


def _box(table: TomlTable, number: int) -> BoxSettings:
    size_m = table.numbers("size_m", count=3, largest=_FARTHEST_M)
    if not all(length > 0.0 for length in size_m):
        raise InputError(f"{table.where('size_m')}: is {list(size_m)}; allowed: a length, width and height above 0")
    box = BoxSettings(
        name=table.text("name", f"box {number}"),
        centre_m=table.numbers("centre_m", count=3, largest=_FARTHEST_M),
        size_m=size_m,
        heading_deg=table.number("heading_deg", 0.0, low=-360.0, high=360.0),
    )
    table.finish()
    return box


def _barrier(table: TomlTable) -> BarrierSettings:
    x_m = table.number_or_pair("x_m", _BARRIER_X_M, low=-_FARTHEST_M, high=_FARTHEST_M)
    if not isinstance(x_m, tuple):
        raise InputError(f"{table.where('x_m')}: is {x_m}; allowed: a pair [from, to]")
    if x_m[1] - x_m[0] > _LONGEST_BARRIER_M:
        raise InputError(f"{table.where('x_m')}: is {list(x_m)}; allowed: at most {_LONGEST_BARRIER_M:g} m apart")
    barrier = BarrierSettings(
        kind=table.text("kind", allowed=BARRIERS), y_m=table.number("y_m", low=-_FARTHEST_M, high=_FARTHEST_M), x_m=x_m
    )
    table.finish()
    return barrier
