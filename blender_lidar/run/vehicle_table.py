"""The vehicle table, one row for each box (a counted vehicle in one frame): what a mounting sees of it.

The detectable share, with its interval, comes from such tables, of all boxes and of groups of them: by distance, lane,
class and zone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..metrics.catalogue import PE_VGOP, metric_named
from ..metrics.vgop import entropy
from ..optimise import vehicle_score
from ..road.road_map import RoadMap
from ..scene.mounting import Layout
from ..scene.observation import first_zone
from ..scene.settings import ObjectiveSettings
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..scoring.scores import Scored
from ..statistics import (
    FEW_VEHICLES,
    block_sums,
    drawn_blocks,
    many_to_one_reach_90,
    of_blocks,
    share_gain_interval_90,
    share_interval_90,
    statistic_interval_90,
)
from ..traffic.boxes import WAY_COLUMNS, Boxes
from ..traffic.frames import FramePlan

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


class BoxShares:
    """Detectable shares with intervals and objective of the boxes of one split, before (the baseline) and after.

    Parameters
    ----------
    before, after : mapping of str to ndarray, (n,)
        Vehicle tables of the baseline and of a mounting.
    block, recording : ndarray of int, (n,)
        Block of time and recording of each row.
    seed : int or None
        For the resampling of blocks; None where these boxes have chosen the mounting, and no interval is given.
    """

    def __init__(
        self, before: Mapping, after: Mapping, block: np.ndarray, recording: np.ndarray, seed: int | None
    ) -> None:
        self.before, self.after, self.block, self.recording, self._seed = before, after, block, recording, seed

    @classmethod
    def of_split(cls, before: Mapping, after: Mapping, split: str, plan: FramePlan, seed: int | None) -> BoxShares:
        """That of the frames of a split, ``"search"`` or ``"holdout"``, of a plan."""
        before, after = (
            {key: values[table["split"] == split] for key, values in table.items()} for table in (before, after)
        )
        frame, block, recording = (getattr(plan, f"{split}{what}") for what in ("", "_block", "_recording"))
        at = np.searchsorted(frame, before["frame"])
        return cls(before, after, block[at], recording[at], seed)

    def shares(self, rows: np.ndarray | slice = slice(None)) -> dict[str, object]:
        """Detectable shares of some rows before and after, their difference, and 90 % intervals, as JSON holds them."""
        vehicle, block, recording = self.before["vehicle_id"][rows], self.block[rows], self.recording[rows]
        before, after = self.before["detectable"][rows], self.after["detectable"][rows]
        ends, of = [None] * 3, (vehicle, block, self._seed, recording)
        if self._seed is not None:
            ends = [share_interval_90(before, *of), share_interval_90(after, *of)]
            ends.append(share_gain_interval_90(before, after, *of))
        before_90, after_90, gain_90 = (pair and list(pair) for pair in ends)
        return {
            "boxes": len(vehicle),
            "distinct_vehicles": len(np.unique(vehicle)),
            "before": float(before.mean()),
            "before_interval_90": before_90,
            "after": float(after.mean()),
            "after_interval_90": after_90,
            "gain": float(after.mean() - before.mean()),
            "gain_interval_90": gain_90,
        }

    def interval_90(self, flags: np.ndarray) -> list[float] | None:
        """90 % interval of the share of boxes with a flag, (n,) bool."""
        if self._seed is None:
            return None
        ends = share_interval_90(flags, self.before["vehicle_id"], self.block, self._seed, self.recording)
        return ends and list(ends)

    def with_detectable(self, before: np.ndarray, after: np.ndarray) -> BoxShares:
        """The same boxes with other `detectable`, (n,) each: shares of installations, 0 to 1."""
        tables = {**self.before, "detectable": before}, {**self.after, "detectable": after}
        return BoxShares(*tables, self.block, self.recording, self._seed)

    def reach_90(self, detectable: np.ndarray, first: int) -> np.ndarray | None:
        """Half the simultaneous 90 % intervals of k detectable shares less that of a `first`: see
        `many_to_one_reach_90`.

        `detectable` (k, n) is that of the boxes under k mountings; None where there is no interval.
        """
        if self._seed is None or len(np.unique(self.before["vehicle_id"])) < FEW_VEHICLES:
            return None
        order = np.r_[first, np.delete(np.arange(len(detectable)), first)]
        boxes, strata = block_sums(np.ones(len(self.block)), self.block), of_blocks(self.recording, self.block)
        reach = many_to_one_reach_90(block_sums(detectable[order], self.block), boxes, self._seed, strata)
        return None if reach is None else reach[np.argsort(order)]

    def low_share(self, detectable: np.ndarray, share: float) -> float | None:
        """Quantile of the detectable share over a resampled set of blocks and one of equally likely installations.

        `detectable` (m, n) is that of m installations, `share` which quantile; None where there is no interval.
        """
        if self._seed is None or len(np.unique(self.before["vehicle_id"])) < FEW_VEHICLES:
            return None
        boxes, strata = block_sums(np.ones(len(self.block)), self.block), of_blocks(self.recording, self.block)
        if (drawn := drawn_blocks(boxes, self._seed, strata)) is None:
            return None
        _, weights, _ = drawn
        hits = block_sums(detectable, self.block)
        shares = np.einsum("rb,mb->rm", weights, hits) / (weights @ boxes)[:, None]
        return float(np.quantile(shares, share))

    def objective_gain(self, before: np.ndarray, after: np.ndarray) -> dict[str, object]:
        """Objective per vehicle of two mountings, from those of boxes (n,), their difference and its 90 % interval."""
        sums = [block_sums(values, self.block) for values in (before, after)]
        weight = block_sums(vehicle_weight(self.before), self.block)
        values = [float(one.sum() / weight.sum()) for one in sums]
        ends = None
        if self._seed is not None:
            strata = of_blocks(self.recording, self.block)
            lost = sums[1] - sums[0]
            ends = statistic_interval_90(lambda of: (of @ lost) / (of @ weight), weight, self._seed, strata)
        gain = {"gain": values[1] - values[0], "gain_interval_90": ends and list(ends)}
        return {**dict(zip(("before", "after"), values, strict=True)), **gain}

    def share_scores(self, rows: np.ndarray | slice = slice(None)) -> dict[str, object]:
        """The same of the mounting beside the baseline, by the names that result.json has beside other scores."""
        shares = self.shares(rows)
        named = {f"detectable_share_{key}": shares[key] for key in ("gain", "gain_interval_90")}
        named["detectable_share_interval_90"] = shares["after_interval_90"]
        return {key: shares[key] for key in ("boxes", "distinct_vehicles")} | named

    def groups(self, site: Site) -> list[dict[str, object]]:
        """`shares` of each group: ``by``, ``name``, and the objective per vehicle.

        By distance, lane, class, zone, approach and movement, as far as the site has them.
        """
        metric, objective = metric_named(site.scoring.metric), site.scenario.objective
        weight, rows = vehicle_weight(self.before), []
        scores = [
            vehicle_score(
                metric.merit(metric_values(table)), table["detectable"], site.scoring.loss, site.scoring.reading
            )
            for table in (self.before, self.after)
        ]
        apart = np.abs(self.before["distance_m"] - self.after["distance_m"]).max(initial=0.0)
        distance = "distance" if apart <= _SAME_PLACE_M else "distance from the baseline"
        found = {distance: distance_bands(self.before), "lane": lanes(self.before), "class": classes(self.before)}
        found["zone"] = zones(self.before, objective) if objective.zones else []
        if APPROACH in self.before:
            if any(self.before[WAY_COLUMNS[-1]]):
                found["lane"] = _map_lanes(self.before, site.scenario.road_map)
            found |= {APPROACH: approaches(self.before), MOVEMENT: movements(self.before)}
        if "lane" in found and not self.before["lane"].any() and APPROACH not in self.before:
            del found["lane"]
        for by, groups in found.items():
            for name, chosen in groups:
                of = weight[chosen]
                means = [float(np.average(score[chosen], weights=of)) if of.any() else None for score in scores]
                mean = dict(zip(("objective_before", "objective_after"), means, strict=True))
                rows.append({"by": by, "name": name, **self.shares(chosen), **mean})
        return rows


def add_shares(site: Site, verdict: Mapping[str, dict], tables: Mapping[str, Mapping], seed: int | None) -> BoxShares:
    """Add to what `judge` says of each mounting its boxes, vehicles and detectable share with intervals.

    Parameters
    ----------
    verdict : mapping
        Of `run.verdict.judge`, which is added to.
    tables : mapping
        Of each mounting its vehicle table.
    seed : int or None
        Of the searched frames, None where they have chosen a mounting; held-out ones take the scene's.

    Returns
    -------
    BoxShares
        Of the mounting on the frames that judge it.
    """
    held_out, shares_of = verdict["optimised"]["holdout"] is not None, {}
    for name, scores in verdict.items():
        for split, of, by in (("search", scores, seed), ("holdout", scores["holdout"], site.scenario.search.seed)):
            if of is None:
                continue
            judged = BoxShares.of_split(tables["baseline"], tables[name], split, site.plan, by)
            shares_of[name, split] = judged
            rows = [(of, slice(None))]
            for number, row in enumerate(scores.get("recordings", ())):
                rows.append((row if split == "search" else row["holdout"], judged.recording == number))
            for scored, chosen in rows:
                if scored is not None:
                    scored |= judged.share_scores(chosen)
                    if name == "baseline" and scored["detectable_share_interval_90"]:  # it gains nothing over itself
                        scored["detectable_share_gain_interval_90"] = [0.0, 0.0]
    return shares_of["optimised", "holdout" if held_out else "search"]
