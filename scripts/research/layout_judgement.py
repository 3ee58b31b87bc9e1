"""Judge the search of layouts: pairs beside all pairs of a grid, three and four LiDARs beside ten times the budget.

    python scripts/research/make_crossing.py --sample hidden --seed 7101
    python scripts/research/layout_judgement.py hidden [--frames 20] [--only pairs|more] [--json FILE]

The site is the shipped intersection, the traffic that of the folder, which no default was chosen with. All that is
compared is scored on the same searched frames. A loss is a share of the gain over the baselines. The pairs are on two
given poles, and on any two of the eight.
"""

from __future__ import annotations

import itertools
import json
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from arguments import SCENES, Silent, counting, parser_of, positive, run_script
from blender_lidar.files import check_place, write_text
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.layout_search import LayoutObjective, LayoutSearch
from blender_lidar.run.replay import Replay
from blender_lidar.run.searches import layout_search
from blender_lidar.scene.mounting import Layout
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import Site, prepare
from blender_lidar.scoring.evaluation import Evaluator, site_evaluator

NAMES = ("one", "two", "three", "four")
GIVEN_POLES = ("north_east", "south_west")
GRIDS = {"on two given poles": (9, 11), "on any two poles": (4, 6)}  # heights and tilts of each LiDAR
SEARCHED = {"height_m": [2.0, 6.0], "tilt_x_deg": [0.0, 25.0]}


def main(argv: list[str] | None = None) -> int:
    return run_script("layout_judgement", lambda: _judge(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("folder", type=Path, help="what make_crossing.py --sample has written")
    parser.add_argument("--frames", type=positive, default=20, help="searched frames; 20")
    parser.add_argument("--iterations", type=positive, default=20, help="of 20 particles, for each LiDAR; 20")
    parser.add_argument("--only", choices=("pairs", "more"), help="pairs alone, or three and four alone")
    parser.add_argument("--json", metavar="FILE")
    return parser.parse_args(argv)


def site_of(folder: Path, lidars: int, frames: int, iterations: int, *, poles: Sequence[str] = ()) -> Site:
    """The intersection with so many RS-16, on given poles or on any."""
    tables = tomllib.loads((SCENES / "crossing.toml").read_text(encoding="utf-8"))
    del tables["deployment"]
    tables["traffic"] |= {"path": str(folder / "crossing_sample.xml.gz"), "frames": frames}
    tables["traffic"]["vehicle_types"] = str(folder / "crossing_types.xml")
    tables["road"]["net"] = str(folder / "crossing.net.xml.gz")
    tables["search"]["iterations"] = iterations
    hung = {"poles": str(folder / "crossing_poles.csv"), **SEARCHED}
    on = poles or [None] * lidars
    tables["lidar"] = [{"name": name, **hung, "pole": pole} for name, pole in zip(NAMES, on, strict=False)]
    return prepare(scenario_of(tables))


def found_by(site: Site, evaluator: Evaluator) -> tuple[LayoutSearch, float]:
    """The search, carried out, and the seconds that it took."""

    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        replay = Replay(RunFolder(Path(folder)), {}, resume=False)
        found = layout_search(site, LayoutObjective(site, evaluator), replay, Silent())
        found.run()
    return found, time.perf_counter() - started


def grid_layouts(site: Site, heights: int, tilts: int) -> list[list[Layout]]:
    """All pairs of a grid of mountings, those with one first LiDAR together, which is then held."""
    singles = []
    for lidar in site.scenario.lidars:
        axes = [np.linspace(*SEARCHED["height_m"], heights), np.linspace(*SEARCHED["tilt_x_deg"], tilts)]
        singles.append([place.mounting(x) for place in lidar.deployment.places for x in itertools.product(*axes)])
    ordered = len(site.scenario.lidar.deployment.places) > 1  # alike: the second of two is on a later pole
    first = {id(one): number // (heights * tilts) for number, one in enumerate(singles[0])}
    pole = [number // (heights * tilts) for number in range(len(singles[1]))]
    rows = [
        [(a, b) for b, on in zip(singles[1], pole, strict=True) if not ordered or on > first[id(a)]] for a in singles[0]
    ]
    return [row for row in rows if row]


def _judge(args) -> None:
    if args.json:
        check_place(args.json, "--json")
    rows = []
    for what, grid in GRIDS.items() if args.only != "more" else ():
        site = site_of(args.folder, 2, args.frames, args.iterations, poles=GIVEN_POLES if "given" in what else ())
        with site_evaluator(site, site.search) as evaluator:
            base = float(evaluator.totals([site.scenario.baselines]).objective.sum())
            found, seconds = found_by(site, evaluator)
            batches, best = grid_layouts(site, *grid), -np.inf
            with counting(len(batches), f"pairs {what}") as advance:
                for batch in batches:
                    best = max(best, float(evaluator.totals(batch).objective.sum(axis=1).max()))
                    advance(1)
        pairs = sum(map(len, batches))
        rows.append(_row(f"two {what}, beside {pairs:,} pairs of a grid", found, base, best, seconds))
        print(rows[-1]["text"], flush=True)
    for lidars in (3, 4) if args.only != "pairs" else ():
        every = []
        for iterations in (args.iterations, 10 * args.iterations):
            site = site_of(args.folder, lidars, args.frames, iterations)
            with site_evaluator(site, site.search) as evaluator:
                base = float(evaluator.totals([site.scenario.baselines]).objective.sum())
                every.append(found_by(site, evaluator))
        (found, seconds), (more, _) = every
        rows.append(_row(f"{lidars}, beside ten times the budget", found, base, float(more.value), seconds))
        print(rows[-1]["text"], flush=True)
    if args.json:
        write_text(args.json, json.dumps(rows, indent=2) + "\n")


def _row(what: str, found: LayoutSearch, base: float, best: float, seconds: float) -> dict[str, object]:
    """What a search has lost to the best that is known, as a share of the gain."""
    top = max(best, float(found.value))
    loss = (top - float(found.value)) / (top - base)
    steps = [_value(found, layout) for layout in found.steps]
    evaluations = sum(search.evaluations for _, search in found.searches)
    text = f"{what}: loses {100 * loss:.2f} % of the gain; {evaluations:,} evaluations, {seconds:.0f} s"
    values = {"value": float(found.value), "best": best, "baseline": base, "steps": steps}
    return {"what": what, "loss": loss, "evaluations": evaluations, "seconds": seconds, "text": text, **values}


def _value(found: LayoutSearch, layout: Layout) -> float:
    return float(found.objective.of_layouts([layout])[0])


if __name__ == "__main__":
    sys.exit(main())
