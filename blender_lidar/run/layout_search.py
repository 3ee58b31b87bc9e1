"""Search of a layout of several LiDARs: greedy, with exchange of poles, block coordinate descent and a joint polish.

The best single LiDAR comes first. Then one LiDAR after the other is added, each where it gains most beside those that
hang. After each addition the LiDARs are searched again one at a time while the others are held, which costs one cast a
mounting, then moved to free poles where that is better, and at last all coordinates are polished together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np

from ..optimise import Search
from ..optimise.hardened import Polish
from ..optimise.multi_fidelity import Asked
from ..scene.deployment import Place, SearchSpace, variable_of
from ..scene.mounting import Layout, Mounting
from ..scene.poles import free_places
from ..scene.scene_tables import LEAST_BUDGET
from ..scene.site import Site
from ..scoring.evaluation import Evaluator
from ..scoring.fidelity import Fidelity
from ..statistics import block_sums
from .replay import Listener, Replay

_KEPT = 2  # candidate places that are searched with the whole budget; each is looked at with an eighth of it
_LOOK, _AGAIN = 8, 4  # shares of the budget: to look at a candidate place, and to search a LiDAR again
_AGAIN_LEAST = 200  # evaluations for each coordinate, as far as the budget goes
_SWEEPS = 4  # over all LiDARs, at most
_POLISH = 60  # evaluations for each coordinate
_STILL = 1e-3  # of the objective's gain over what hung before: less ends the sweeps
_BATCH = 100  # layouts of a record that are scored again together


class _Tried(NamedTuple):
    """The one mounting of a place at which nothing is searched, with the history of a search."""

    history: np.ndarray


MakeSearch = Callable[[SearchSpace, int, int], Search]
"""A fresh search of a space, with a budget of evaluations and a seed."""


class LayoutObjective:
    """The objective of layouts on the searched frames, and of complete ones the sums over each block of time."""

    def __init__(self, site: Site, evaluator: Evaluator) -> None:
        self._site, self._evaluator = site, evaluator
        self.by_block: dict[Layout, np.ndarray] = {}

    def of_layouts(self, layouts: Sequence[Layout]) -> np.ndarray:
        """Of some layouts, (s,)."""
        objective = self._evaluator.totals(layouts).objective
        blocks = block_sums(objective, self._site.plan.search_block)
        self.by_block |= {one: sums for one, sums in zip(layouts, blocks, strict=True) if None not in one}
        return objective.sum(axis=1)

    def of_points(self, space: SearchSpace, asked: np.ndarray | Asked) -> np.ndarray:
        """Of points of a search space, (s,), at the fidelity that is asked for."""
        if not isinstance(asked, Asked):
            return self.of_layouts([space.layout(row) for row in asked])
        fidelity = None if asked.fidelity == Fidelity(self._site.observation.detail) else asked.fidelity
        layouts = [space.layout(row) for row in asked.x]
        return self._evaluator.totals(layouts, asked.frames, fidelity).objective.sum(axis=1)

    def tried(self, searches: Sequence[tuple[SearchSpace, Search | _Tried]]) -> tuple[list[Layout], np.ndarray]:
        """All complete layouts that searches have tried, and their objective in each block, (n, b)."""
        layouts = [
            space.layout(row)
            for space, search in searches
            if None not in space.slots
            for row in search.history[:, 3:-2]
        ]
        unknown = [layout for layout in dict.fromkeys(layouts) if layout not in self.by_block]
        for start in range(0, len(unknown), _BATCH):  # those of a run that this one goes on with
            self.of_layouts(unknown[start : start + _BATCH])
        return layouts, np.array([self.by_block[layout] for layout in layouts])


@dataclass
class LayoutSearch:
    """The search of a scene's layout, carried out by `run`.

    Attributes
    ----------
    site : Site
    objective : LayoutObjective
    replay, listener
        Carry out and tell of each of its searches.
    make : callable
        Makes a search as the scene asks for.
    budget : int
        Evaluations of the search of one LiDAR.
    layout : list of Mounting or None
        The layout so far; begins with the LiDARs that hang already.
    places : list of Place or None
        Where each of the others was put.
    value : float
        The layout's objective.
    steps : list of Layout
        What the layout was when it had each number of LiDARs, those included that hung at first if there are any.
    searches : list of (SearchSpace, Search)
        In the order in which they were carried out.
    """

    site: Site
    objective: LayoutObjective
    replay: Replay
    listener: Listener
    make: MakeSearch
    budget: int
    layout: list[Mounting | None] = field(init=False)
    places: list[Place | None] = field(init=False)
    value: float = field(init=False)
    steps: list[Layout] = field(default_factory=list)
    searches: list[tuple[SearchSpace, Search | _Tried]] = field(default_factory=list)

    def run(self) -> None:
        """Carry it out."""
        lidars = self.site.scenario.lidars
        self.layout = [one.deployment.places[0].mounting([]) if one.is_held else None for one in lidars]
        self.places = [None] * len(lidars)
        self.value = -np.inf
        if any(self.layout):
            self.value = self.objective.of_layouts([tuple(self.layout)])[0]
            self.steps.append(tuple(self.layout))
        while None in self.layout:
            before, moved = self.value, True
            self._add()
            for _ in range(_SWEEPS):
                last = self.value
                moved = moved and self._exchange()
                self._search_again()
                if not moved and self.value - last <= _STILL * abs(self.value - before):
                    break
            self._polish_together()
            self.steps.append(tuple(self.layout))

    def space(self, *searched: int) -> SearchSpace:
        """The space of some of the LiDARs that were put somewhere, the others held where they hang."""
        slots = [self.places[k] if k in searched else mounting for k, mounting in enumerate(self.layout)]
        return SearchSpace(tuple(slots), tuple(lidar.name for lidar in self.site.scenario.lidars))

    def point(self, *searched: int) -> list[float]:
        """Where the layout lies in that space."""
        return [x for k in searched for x in point_of(self.places[k], self.layout[k])]

    def accept(self, space: SearchSpace, search: Search) -> bool:
        """Take the best that a search has found, where that is better than the layout so far."""
        better = search.best_value > self.value
        if better:
            self.layout, self.value = list(space.layout(search.best_x)), search.best_value
        return better

    def carry_out(self, space: SearchSpace, search: Search, label: str) -> Search:
        """One search after the others."""
        search.label, search.variables = label, space.variables
        self.replay.carry_out(search, partial(self.objective.of_points, space), self.listener)
        self.searches.append((space, search))
        return search

    def polish(self, space: SearchSpace, start: Sequence[float], label: str) -> Search:
        """A local search from a point of a space."""
        polish = Polish(
            space.lower,
            space.upper,
            start=np.array(start),
            seed=self._seed(),
            evaluations=_POLISH * len(space.lower),
            periodic=space.periodic,
        )
        return self.carry_out(space, polish, label)

    def _seed(self) -> int:
        return self.site.scenario.search.seed + len(self.searches)

    def _look(self, place: Place) -> int:
        """Evaluations by which a candidate place is looked at."""
        return max(LEAST_BUDGET * len(place.bounds), self.budget // _LOOK)

    def _free(self, number: int) -> list[Place]:
        """The candidate places of a LiDAR that leave a pole to each of the others."""
        hung = {k: one.xy for k, one in enumerate(self.layout) if one is not None and k != number}
        return free_places([lidar.deployment for lidar in self.site.scenario.lidars], number, hung)

    def _add(self) -> None:
        """Put up the LiDAR that gains most beside those that hang, on the place where it does."""
        lidars, kinds = self.site.scenario.lidars, []
        for number, lidar in enumerate(lidars):
            kind = lidar.sensor, lidar.deployment
            if self.layout[number] is None and kind not in (known for _, known in kinds):
                kinds.append((number, kind))  # those alike are put up in the scene's order
        candidates = [(number, place) for number, _ in kinds for place in self._free(number)]
        if len(candidates) > 1:
            values = [self._search(*one, self._look(one[1]))[1] for one in candidates]
            order = np.argsort(-np.array(values), kind="stable")[:_KEPT]
            candidates = [candidates[row] for row in order.tolist()]
        found = [(*self._search(number, place, self.budget), number, place) for number, place in candidates]
        mounting, value, number, place = max(found, key=lambda one: one[1])  # the first of equals
        self.layout[number], self.places[number], self.value = mounting, place, value

    def _search(self, number: int, place: Place, budget: int) -> tuple[Mounting, float]:
        """The best mounting of one LiDAR on a place beside what hangs, and the layout's objective with it."""
        slots = [*self.layout]
        slots[number] = place
        lidars = self.site.scenario.lidars
        space = SearchSpace(tuple(slots), tuple(lidar.name for lidar in lidars))
        if not place.bounds:
            value = float(self.objective.of_layouts([space.layout([])])[0])
            self.searches.append((space, _Tried(np.array([[1.0, 1.0, 1.0, value, value]]))))
            return place.mounting([]), value
        label = ", ".join(filter(None, [lidars[number].name, place.label]))
        search = self.carry_out(space, self.make(space, budget, self._seed()), label)
        return space.layout(search.best_x)[number], search.best_value

    def _put_up(self) -> list[int]:
        """The LiDARs that were put somewhere so far."""
        return [number for number, place in enumerate(self.places) if place is not None]

    def _exchange(self) -> bool:
        """Move LiDARs to free poles where that is better; whether any was moved."""
        moved = False
        if len(self._put_up()) < 2:
            return moved
        for number in self._put_up():
            own = self.places[number]
            for place in self._free(number) if own.pole is not None else ():
                if place == own:
                    continue
                mounting, value = self._search(number, place, self._look(place))
                if value > self.value:
                    self.layout[number], self.places[number], self.value = mounting, place, value
                    moved = True
        return moved

    def _search_again(self) -> None:
        """Search each LiDAR again while the others are held."""
        for number in self._put_up() if sum(one is not None for one in self.layout) > 1 else ():
            place = self.places[number]
            if place.bounds:
                space = self.space(number)
                budget = max(min(self.budget, _AGAIN_LEAST * len(place.bounds)), self.budget // _AGAIN)
                search = self.make(space, budget, self._seed())
                self.accept(space, self.carry_out(space, search, f"{self.site.scenario.lidars[number].name}, again"))

    def _polish_together(self) -> None:
        """Polish all coordinates of the LiDARs that were put up."""
        searched = [number for number in self._put_up() if self.places[number].bounds]
        if searched:
            space, one = self.space(*searched), self.site.scenario.lidars[searched[0]].name
            label = "all together" if len(searched) > 1 else f"{one}, polish"
            self.accept(space, self.polish(space, self.point(*searched), label))


def point_of(place: Place, mounting: Mounting) -> list[float]:
    """The searched coordinates of a mounting on a place."""
    table = mounting.as_table()
    values = [table[key] if table[key] is not None else low for key, (low, _) in place.bounds.items()]
    ends = np.array(list(place.bounds.values())).reshape(-1, 2).T
    return np.clip(values, *ends).tolist()


def layout_history(search: LayoutSearch) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows of history.csv of all its searches, numbered through, and the coordinates that they have.

    These are the coordinates of each LiDAR that was put somewhere, and where it has several places their x and y; NaN
    as long as it does not hang.
    """
    columns, keys = [], []
    for number, (lidar, place) in enumerate(zip(search.site.scenario.lidars, search.places, strict=True)):
        if place is not None:
            own = [*(("x_m", "y_m") if place.pole is not None else ()), *place.bounds]
            keys += [(number, key) for key in own]
            columns += [variable_of(lidar.name, key) for key in own]
    rows, evaluation, iteration = [], 0, 0
    for space, one in search.searches:
        history = one.history
        tables = [[None if m is None else _table_of(m) for m in space.layout(x)] for x in history[:, 3:-2]]
        x = [[np.nan if row[number] is None else row[number][key] for number, key in keys] for row in tables]
        numbers = history[:, :3] + (evaluation, iteration, 0)
        rows.append(np.column_stack([numbers, np.reshape(x, (len(history), len(keys))), history[:, -2]]))
        evaluation, iteration = numbers[-1, 0], numbers[-1, 1]
    joined = np.concatenate([np.empty((0, 4 + len(keys))), *rows])
    return np.column_stack([joined, np.maximum.accumulate(joined[:, -1])]), tuple(columns)


def _table_of(mounting: Mounting) -> Mapping[str, float]:
    """Its coordinates, of which none is missing."""
    return {key: np.nan if value is None else value for key, value in mounting.as_table().items()}


def coordinates_of(space: SearchSpace, layouts: Sequence[Layout]) -> np.ndarray:
    """The coordinates of layouts in a space whose LiDARs they all have, (n, d)."""
    searched = [number for number, slot in enumerate(space.slots) if isinstance(slot, Place)]
    points = [[x for k in searched for x in point_of(space.slots[k], layout[k])] for layout in layouts]
    return np.reshape(points, (len(layouts), len(space.lower)))


def on_same_masts(one: Layout, other: Layout, space: SearchSpace) -> bool:
    """Whether two layouts stand on the same masts, as far as these are no coordinates of the space."""
    return all(
        "x_m" in slot.bounds or "y_m" in slot.bounds or a.xy == b.xy
        for slot, a, b in zip(space.slots, one, other, strict=True)
        if isinstance(slot, Place)
    )
