"""What a second worker is worth, and what a task costs: in this process, in two of our own, on a cluster of two.

    python scripts/research/benchmark_workers.py [scenes/i80.toml] [--rounds 5] [--batches 3] [--json FILE]

The cluster is one of this machine, a dask scheduler and two worker processes; without dask.distributed it is left out.
Places take turns within each round, so that what else the machine does falls on all of them. A batch is what the search
asks for at a time: 20 mountings on every searched frame. Trees are built before the clock runs.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import repeat
from pathlib import Path
from statistics import median

import numpy as np

from arguments import SCENES, overrides_of, parser_of, positive, run_script
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import Site, prepare
from blender_lidar.scoring.evaluation import Evaluator, Workplace
from blender_lidar.signals import stops_watched

MOUNTINGS = 20
TASKS = 200


def main(argv: list[str] | None = None) -> int:
    return run_script("benchmark_workers", lambda: _benchmark(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--frames", type=positive, help="searched frames; the scene's")
    parser.add_argument("--rounds", type=positive, default=5, help="of which the median is told; 5")
    parser.add_argument("--batches", type=positive, default=3, help="of 20 mountings, in each round; 3")
    parser.add_argument("--json", metavar="FILE", help="write the figures there too")
    return parser.parse_args(argv)


def _benchmark(args) -> None:
    site = prepare(load_scenario(args.scene, overrides_of(args)))
    with tempfile.TemporaryDirectory() as folder, two_workers(Path(folder)) as address:
        places = {"this process": Workplace(1), "two processes": Workplace(2)}
        if address is not None:
            places["cluster of two"] = Workplace(1, address)
        found = {"scene": args.scene, "frames": len(site.search), "mountings": MOUNTINGS}
        found["task_us"] = {name: task_us(place) for name, place in places.items()}
        found["handed_out_s"] = {name: hand_out_s(site, place) for name, place in places.items()}
        found["batch_s"] = batch_times(site, places, args.rounds, args.batches)
    print(told(found))
    if args.json:
        Path(args.json).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


@contextmanager
def two_workers(folder: Path) -> Iterator[str | None]:
    """The address of a cluster of this machine; None where dask.distributed is not installed."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # where tests are
    try:
        import distributed  # noqa: F401

        from tests.local_cluster import LocalCluster
    except ImportError as error:
        print(f"no cluster: {error}", file=sys.stderr)
        yield None
        return
    with LocalCluster(folder) as cluster:
        yield cluster.address


def task_us(place: Workplace) -> float:
    """What a task costs besides its work, which is next to none here, one of many that are asked for together [us]."""
    workers = place.employ(abs, TASKS)
    try:
        workers.await_ready()
        workers.map(range(TASKS))
        return 1e6 * median(seconds(lambda: workers.map(range(TASKS))) for _ in range(5)) / TASKS
    finally:
        workers.close()


def hand_out_s(site: Site, place: Workplace) -> float:
    """Until workers are there that hold the scene, trees not built yet [s]."""

    def come_and_go() -> None:
        with Evaluator(site.search, site.observation, site.scoring, place.processes, place.cluster) as evaluator:
            evaluator.workers.await_ready()

    return median(seconds(come_and_go) for _ in range(3))


def batch_times(site: Site, places: dict[str, Workplace], rounds: int, batches: int) -> dict[str, list[float]]:
    """Seconds that a batch takes in each place, round by round."""
    low, high = np.array(site.scenario.deployment.lower), np.array(site.scenario.deployment.upper)
    points = np.random.default_rng(1).uniform(low, high, (MOUNTINGS, len(low)))
    poses = [site.scenario.deployment.pose(point) for point in points]
    taken: dict[str, list[float]] = {name: [] for name in places}
    with ExitStack() as stack:
        evaluators = {}
        for name, place in places.items():
            given = (site.search, site.observation, site.scoring, place.processes, place.cluster)
            evaluators[name] = stack.enter_context(Evaluator(*given))
            evaluators[name].workers.await_ready()
        expected = evaluators["this process"].totals(poses).objective.tobytes()
        for evaluator in evaluators.values():
            for _ in range(4):  # until each process has built the trees that it will be asked for
                if evaluator.totals(poses).objective.tobytes() != expected:
                    raise SystemExit("places differ in their scores")
        for _ in range(rounds):
            for name, evaluator in evaluators.items():
                work = partial(list, map(evaluator.totals, repeat(poses, batches)))
                taken[name].append(seconds(work) / batches)
    return taken


def seconds(work: Callable[[], object]) -> float:
    """How long it takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def told(found: dict) -> str:
    """The figures as a table."""
    alone = found["batch_s"]["this process"]
    lines = [f"{found['scene']}: {found['frames']} frames, batches of {found['mountings']} mountings", ""]
    lines.append(f"{'':<16}{'empty task':>12}{'handed out':>12}{'batch, median':>15}{'range':>18}{'speed-up':>10}")
    lines.append(f"{'':<16}{'us':>12}{'s':>12}{'s':>15}{'s':>18}{'':>10}")
    for name, taken in found["batch_s"].items():
        gain = median(one / mine for one, mine in zip(alone, taken, strict=True))
        spread = f"{min(taken):.3f} to {max(taken):.3f}"
        lines.append(
            f"{name:<16}{found['task_us'][name]:>12.1f}{found['handed_out_s'][name]:>12.3f}{median(taken):>15.3f}"
            f"{spread:>18}{gain:>10.2f}"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    with stops_watched():  # so that a stop leaves no cluster behind
        sys.exit(main())
