"""The vehicle table, one row for each box (a counted vehicle in one frame): what a mounting sees of it.

The detectable share, with its interval, comes from such tables, of all boxes and of groups of them: by distance, lane,
class and zone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..metrics.catalogue import PE_VGOP
from ..metrics.vgop import entropy
from ..road.road_map import RoadMap
from ..scene.mounting import Layout
from ..scene.observation import first_zone
from ..scene.settings import ObjectiveSettings
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..scoring.scores import Scored
from ..traffic.boxes import WAY_COLUMNS, Boxes

VEHICLE_COLUMNS = (
    "frame",
    "vehicle_id",
    "class",
    "x_m",
    "y_m",
    "z_m",
    "length_m",
    "width_m",
    "height_m",
    "heading_deg",
)
VEHICLE_COLUMNS += ("distance_m", "points", "p_top", "p_side", "p_front", "entropy_bits", "detectable", "lane", "split")
METRIC_VALUE = "metric_value"
"""The column of the chosen metric, in its own unit, where that is another than PE-VGOP: that one is `entropy_bits`."""

WEIGHT = "weight"
"""The column of how much a vehicle counts in the objective, where the scene has weights."""


def columns_for(
    metric: str, weighted: bool = False, ways: bool = False, lidars: Sequence[str] = ("",)
) -> tuple[str, ...]:
    """The columns of the table of a run with a metric, of a scene with weights and with ways or without.

    Of several LiDARs each has a column of its points.
    """
    found = VEHICLE_COLUMNS + (METRIC_VALUE,) * (metric != PE_VGOP.name) + (WEIGHT,) * weighted + WAY_COLUMNS * ways
    return found + (points_columns(lidars) if len(lidars) > 1 else ())


def points_columns(lidars: Sequence[str]) -> tuple[str, ...]:
    """The columns of the points of each LiDAR, by its name."""
    return tuple(f"points_{name}" for name in lidars)


def metric_values(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """The chosen metric of each vehicle of a table, in its own unit, (n,)."""
    return table[METRIC_VALUE] if METRIC_VALUE in table else table["entropy_bits"]


def vehicle_weight(table: Mapping[str, np.ndarray]) -> np.ndarray:
    """How much each vehicle of a table counts in the objective, (n,)."""
    return table[WEIGHT] if WEIGHT in table else np.ones(len(table["frame"]))


def vehicle_tables(layouts: Sequence[Layout], **splits: Evaluator) -> list[dict[str, np.ndarray]]:
    """Score layouts vehicle by vehicle: a table for each.

    Parameters
    ----------
    layouts : sequence of Layout
    **splits : Evaluator
        Of one metric: each with the frames of a split, by the name that the column ``split`` gives them. In one of
        them at least a vehicle counts.

    Returns
    -------
    list of dict of str to ndarray, (n,)
        The columns of `columns_for` the metric; `distance_m` is horizontal, from the nearest LiDAR.
    """
    one = next(iter(splits.values()))
    metric, lidars = one.metric, one.lidars
    weighted = any(frame.weight is not None for evaluator in splits.values() for frame in evaluator.frames)
    found = [
        (frame, scored, split)
        for split, evaluator in splits.items()
        for frame, scored in zip(evaluator.frames, evaluator.by_vehicle(layouts), strict=True)
        if frame.counted.any()
    ]
    tables = []
    for row, layout in enumerate(layouts):
        parts = [
            _frame_table(frame.select(frame.counted), layout, scored, row, split, lidars)
            for frame, scored, split in found
        ]
        names = columns_for(metric, weighted, all(frame.approach is not None for frame, *_ in found), lidars)
        tables.append({name: np.concatenate([part[name] for part in parts]) for name in names})
    return tables


def vehicle_table(layout: Layout, **splits: Evaluator) -> dict[str, np.ndarray]:
    """The table of one layout: see `vehicle_tables`."""
    return vehicle_tables([layout], **splits)[0]


def _frame_table(
    vehicles: Boxes, layout: Layout, scored: Scored, row: int, split: str, names: Sequence[str]
) -> dict[str, np.ndarray]:
    shares = scored.seen.occupancy[row]
    hung = [mounting.pose.position[:2] for mounting in layout if mounting is not None]
    away = [np.hypot(*(vehicles.centre_m[:, :2] - xy).T) for xy in hung] or [np.full(len(vehicles), np.inf)]
    return {
        **vehicles.table(),
        "distance_m": np.min(away, axis=0),
        "points": scored.seen.points[row],
        **dict(zip(("p_top", "p_side", "p_front"), shares.T, strict=True)),
        "entropy_bits": entropy(shares).sum(axis=1),
        "detectable": scored.detectable[row],
        "lane": vehicles.lane,
        "split": np.full(len(vehicles), split),
        METRIC_VALUE: scored.values[row],
        WEIGHT: vehicles.counted_weight,
        **{name: getattr(vehicles, name) for name in WAY_COLUMNS},
        **dict(zip(points_columns(names), scored.seen.by_lidar[row], strict=True)),
    }


# --- Groups of boxes, and the shares of them that are detectable ------------------------------------------------------


def distance_bands(table: dict[str, np.ndarray], width_m: float = 10.0) -> list[tuple[str, np.ndarray]]:
    """Names of the distance bands that hold vehicles, and which rows of a vehicle table each holds."""
    band = (table["distance_m"] // width_m).astype(int)
    return [(f"{number * width_m:g}-{(number + 1) * width_m:g} m", band == number) for number in np.unique(band)]


_QUARTERS = ("+x", "+y", "-x", "-y")
_MEANT_SHARE = 0.05  # of the vehicles of a lane; fewer that head another way are no lane of their own


def lanes(table: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Names of the lanes that hold vehicles, and which rows of a vehicle table each holds.

    A number that is of two lanes, as where each direction of travel counts from its own kerb, is split by headings.
    """
    found, towards = [], np.exp(1j * np.radians(table["heading_deg"]))
    for number in np.unique(table["lane"]):
        rows, name = table["lane"] == number, f"lane {number}" if number else "no lane"
        axis = np.sqrt((towards[rows] ** 2).sum())  # of both ways, as their doubled angles are one
        along = (towards * axis.conj()).real > 0.0
        ways = {_way(towards[one]): one for one in (rows & along, rows & ~along) if one.any()}
        if number and min(one.sum() for one in ways.values()) >= _MEANT_SHARE * rows.sum() and len(ways) > 1:
            found += [(f"{name}, towards {_QUARTERS[way]}", ways[way]) for way in sorted(ways)]
        else:
            found.append((name, rows))
    return found


def _way(towards):
    """The quarter of the circle about the mean of directions, unit complex numbers."""
    return round(float(np.degrees(np.angle(towards.sum()))) / 90.0) % 4


def classes(table: Mapping[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Names of the classes of vehicles, and which rows of a vehicle table each holds."""
    return [(str(name), table["class"] == name) for name in np.unique(table["class"])]


APPROACH, MOVEMENT = "approach", "movement"
"""The columns, where a site has approaches, of where a vehicle comes from and how it turns; "" where unknown."""


def approaches(table: Mapping[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Names of the approaches from which vehicles come, and which rows of a vehicle table each holds."""
    return [(str(name), table[APPROACH] == name) for name in np.unique(table[APPROACH]) if name]


def _map_lanes(table: Mapping[str, np.ndarray], road: RoadMap) -> list[tuple[str, np.ndarray]]:
    """Names of the map's lanes that hold vehicles, those in a junction together, and which rows each holds."""
    inner = {lane.name: f"junction {lane.junction}" for lane in road.lanes if lane.junction}
    names = np.array([inner.get(name, name) for name in table[WAY_COLUMNS[-1]].tolist()])
    return [(name or "off the lanes", names == name) for name in np.unique(names).tolist()]


def movements(table: Mapping[str, np.ndarray]) -> list[tuple[str, np.ndarray]]:
    """Names of the movements of each approach, after its own name and a comma, and the rows that each holds."""
    return [
        (f"{name}, {movement}", rows & (table[MOVEMENT] == movement))
        for name, rows in approaches(table)
        for movement in np.unique(table[MOVEMENT][rows]).tolist()
        if movement
    ]


def zones(table: Mapping[str, np.ndarray], objective: ObjectiveSettings) -> list[tuple[str, np.ndarray]]:
    """Names of the scene's zones that hold vehicles, and of what is outside, and the rows that each holds."""
    zone = first_zone(objective, np.column_stack([table["x_m"], table["y_m"]]))
    names = [*(one.name for one in objective.zones), "outside all zones"]
    return [(name, zone == number) for number, name in enumerate(names) if (zone == number).any()]


_SAME_PLACE_M = 1.0  # of distances, between two mounts that stand in one place


def groups_of(before: Mapping[str, np.ndarray], after: Mapping[str, np.ndarray], site: Site) -> list[tuple]:
    """Groups of boxes of vehicle tables of two mountings: what they are by, the name, and the rows that each holds.

    By distance, lane, class, zone, approach and movement, as far as the site has them.
    """
    apart, objective = np.abs(before["distance_m"] - after["distance_m"]).max(initial=0.0), site.scenario.objective
    distance = "distance" if apart <= _SAME_PLACE_M else "distance from the baseline"
    found = {distance: distance_bands(before), "lane": lanes(before), "class": classes(before)}
    found["zone"] = zones(before, objective) if objective.zones else []
    if APPROACH in before:
        if any(before[WAY_COLUMNS[-1]]):
            found["lane"] = _map_lanes(before, site.scenario.road_map)
        found |= {APPROACH: approaches(before), MOVEMENT: movements(before)}
    if "lane" in found and not before["lane"].any() and APPROACH not in before:
        del found["lane"]
    return [(by, name, rows) for by, groups in found.items() for name, rows in groups]
