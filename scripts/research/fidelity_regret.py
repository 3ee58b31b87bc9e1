"""How much faster `--fidelity auto` is than searching at full fidelity, and what it gives up.

    python scripts/research/fidelity_regret.py [SCENE.toml] [--sensors RS-16,RS-80] [--frames 60] [--resume]

At full fidelity stand the exhaustive 26 x 26 grid of heights and tilts and 2,000 evaluations of each of --searches,
one run of each for each seed; `auto` has as many seeds. All are timed on the same frames, workers and caster, taking
turns, each with its own building of frames: the search alone, once all workers are there and have loaded compiled code,
and for `auto` and the grid also with the start of the other processes. Regret is the share of the gain over the
baseline, [F(rival) - F(auto)] / [F(rival) - F(baseline)], that auto leaves: to the grid's best point, to the mounting
that a search found with the same seed, and to the best of all mountings known; on the searched frames, and on held-out
ones. Its upper 95 % bound is over seeds, Student's; on held-out frames the larger of that and one over resampled blocks
of time. What is done is stored run by run.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np

from arguments import SCENES, counting, overrides_of, parser_of, positive, run_script
from blender_lidar.errors import InputError
from blender_lidar.files import write_text
from blender_lidar.optimise import SEARCHES, GridSearch, run
from blender_lidar.run.optimise import asked_objective, fresh_auto_search, fresh_search, rung_costs
from blender_lidar.scene.mounting import pose_at
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator, workplace_of
from blender_lidar.statistics import block_sums, linear_interval_90, student_t_95
from blender_lidar.studies.driver import StudyFolder

AUTO, GRID, BEST = "auto", "grid", "best known"
TABLE = "fidelity_regret.txt"


def main(argv: list[str] | None = None) -> int:
    return run_script("fidelity_regret", lambda: _study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--sensors", default="RS-16,RS-80", help="models, separated by commas")
    parser.add_argument("--traffic", help="trajectory file in place of the scene's")
    parser.add_argument("--frames", type=positive, default=60)
    parser.add_argument("--seeds", type=positive, default=11)
    parser.add_argument("--searches", default="hardened,de-pso", help="rivals at full fidelity; none: the grid alone")
    parser.add_argument("--evaluations", type=positive, default=2000, help="of each rival search; 20 or more")
    parser.add_argument("--rival-seeds", type=positive, help="seeds of the rival searches; as many as of auto")
    parser.add_argument("--grid-runs", type=positive, default=3, help="how often the grid is timed, of either kind")
    parser.add_argument("--workers", type=int, default=0, help="processes; 0 takes one for each processor")
    parser.add_argument("--out", default="runs/fidelity_regret", metavar="DIR")
    parser.add_argument("--resume", action="store_true")
    args = parser.parse_args(argv)
    args.searches = [] if args.searches == "none" else args.searches.split(",")
    for name in args.searches:
        if name not in SEARCHES:
            parser.error(f"--searches: {name!r}; allowed: {', '.join(SEARCHES)}, or none")
    args.rival_seeds = min(args.rival_seeds or args.seeds, args.seeds)
    return args


def _study(args):
    sites = {}
    for sensor in args.sensors.split(","):
        sites[sensor] = _site(args, sensor, 1)
        if sites[sensor].scenario.deployment.variables != ("height_m", "tilt_x_deg"):
            raise InputError(f"{args.scene}: [deployment] height_m and tilt_x_deg, and they alone, must be pairs")
    given = ("evaluations", "seeds", "searches", "rival_seeds", "grid_runs")
    processes = workplace_of(next(iter(sites.values())).scenario.model).processes
    identity = {key: getattr(args, key) for key in given} | {"workers": processes}
    for sensor, site in sites.items():
        identity[sensor] = {key: value for key, value in site.identity.items() if key != "[search] seed"}
    folder = StudyFolder(args.out, identity, [TABLE])
    tasks = [(sensor, *task) for sensor in sites for task in _tasks(args)]
    runs = {sensor: {} for sensor in sites}
    with folder.locked(resume=args.resume):
        with counting(len(tasks), "runs") as advance:
            for sensor, name, seed, waited in tasks:
                where = f"{sensor}_{name}_{seed}{'' if waited else '_whole'}".replace("/", "_")
                made = folder.stage(where, lambda task=(sensor, name, seed, waited): _run(args, *task))
                runs[sensor][name, seed, waited] = made
                advance(1, f"{sensor} {name} seed {seed}: {made['seconds']:.1f} s")
        lines = [line for sensor in sites for line in _report(args, sensor, sites[sensor], runs[sensor], folder)]
        text = "\n".join(lines) + "\n"
        write_text(folder.file(TABLE), text)
    print(text, end="")


def _tasks(args):
    """Runs, as name, seed and whether workers are waited for first, so that auto and its rivals take turns."""
    grids = np.linspace(1, args.seeds, min(args.grid_runs, args.seeds)).astype(int).tolist()
    tasks = []
    for seed in range(1, args.seeds + 1):
        tasks += [(AUTO, seed, True), (AUTO, seed, False)]
        tasks += [(name, seed, True) for name in args.searches if seed <= args.rival_seeds]
        tasks += [(GRID, seed, waited) for waited in (True, False) if seed in grids]
    return tasks


def _site(args, sensor, seed):
    own = {("sensor", "name"): (sensor, "--sensors"), ("search", "seed"): (seed, "--seeds")}
    return prepare(load_scenario(args.scene, {**overrides_of(args), **own}))


def _run(args, sensor, name, seed, waited):
    """One search: the mounting, seconds and casts of a frame by fidelity; `waited` leaves the workers' start out."""
    site = _site(args, sensor, seed)
    deployment, begun = site.scenario.deployment, time.perf_counter()
    others = site.holdout[: 2 * workplace_of(site.scenario.model).processes] or site.search[:1]
    with site_evaluator(site, (*site.search, *others)) as evaluator:
        if waited:
            evaluator.workers.await_ready()
            _load_compiled(site, evaluator, others)
        started = time.perf_counter() if waited else begun
        x, rungs = _auto(site, evaluator) if name == AUTO else _full(args, site, evaluator, name)
        seconds = time.perf_counter() - started
    start = started - begun
    return {"x": x.tolist(), "seconds": seconds, "start": start, "rungs": rungs, "mount": deployment.coordinates(x)}


def _load_compiled(site, evaluator, others):
    """Let all processes load what they run, on frames that are not searched: their trees are the search's to build."""
    places = range(len(site.search), len(site.search) + len(others))
    for _ in range(2):
        evaluator.totals([site.scenario.baseline_pose] * 4, places)


def _auto(site, evaluator):
    """The search from cheap to dear: its best point, and what its rungs took."""
    search = fresh_auto_search(site)
    while not search.done:
        begun = time.perf_counter()
        search.tell(asked_objective(site, evaluator, search.ask()), time.perf_counter() - begun)
    return search.best_x, rung_costs(search)


def _full(args, site, evaluator, name):
    """A search at full fidelity: its best point, and what it scored."""
    deployment, frames = site.scenario.deployment, len(site.search)

    def objective(x):
        return evaluator.totals([deployment.pose(row) for row in x], range(frames)).objective.sum(axis=1)

    if name == GRID:
        search = GridSearch(np.array(deployment.lower), np.array(deployment.upper), points=(26, 26))
    else:
        method = load_scenario(args.scene, {("search", "method"): (name, "--searches")}).search
        method = replace(method, seed=site.scenario.search.seed)
        search = fresh_search(replace(site.scenario, search=method), args.evaluations)
    found = run(search, objective)
    cost = {"detail": site.observation.detail, "stride": 1, "frames": frames, "frame_casts": found.evaluations * frames}
    return found.x, [{**cost, "candidates": found.evaluations}]


def _report(args, sensor, site, runs, folder):
    """The lines of one sensor."""
    mounts = {(name, seed): made["mount"] for (name, seed, waited), made in runs.items() if waited}
    poses = [pose_at(mount) for mount in mounts.values()] + [site.scenario.baseline_pose]
    scores = {}
    judged = {"searched": (site.search, site.plan.search_block), "held-out": (site.holdout, site.plan.holdout_block)}
    for name, (frames, block) in judged.items():
        if not len(frames):
            continue
        made = folder.stage(f"{sensor}_scores_{name}".replace("/", "_"), lambda some=frames: _scored(site, some, poses))
        blocks = block_sums(np.array(made["objective"]), block)
        rows = dict(zip([*mounts, "baseline"], blocks, strict=True))
        scores[name] = rows, block_sums(np.array(made["vehicles"], dtype=float), block)
    seeds = range(1, args.seeds + 1)
    searched = scores["searched"][0]
    known = max(mounts, key=lambda key: searched[key].sum())
    lines = [
        f"{sensor}: {len(site.search)} searched frames, {workplace_of(site.scenario.model)}, "
        f"caster {site.observation.caster}",
        f"  best known: {known[0]} seed {known[1]} at {_at(mounts[known])}",
        *_speed(args, runs),
    ]
    for frames, (rows, vehicles) in scores.items():
        for rival in (GRID, *args.searches, BEST):
            chosen = [seed for seed in seeds if rival not in args.searches or seed <= args.rival_seeds]
            against = [known if rival == BEST else (rival, seed if rival in args.searches else 1) for seed in chosen]
            told = _regret(rows, vehicles, chosen, against, rival, resampled=frames == "held-out")
            lines.append(f"  {frames}: {told}")
    return [*lines, ""]


def _at(mount):
    return f"{mount['height_m']:.3f} m, {mount['tilt_x_deg']:.2f} deg"


def _speed(args, runs):
    """What auto takes, rung by rung, and how many times as much its rivals."""
    names = AUTO, GRID, *args.searches
    made = {name: [run for (some, _, waited), run in runs.items() if some == name and waited] for name in names}
    alone = {name: np.array([run["seconds"] for run in some]) for name, some in made.items()}
    whole = {
        name: np.array([run["seconds"] for (some, _, waited), run in runs.items() if some == name and not waited])
        for name in (AUTO, GRID)
    }
    start = np.median([run["start"] for some in made.values() for run in some])
    yield f"  start of the workers, compiled code loaded: median {start:.1f} s"
    for what, seconds in (("alone", alone), ("with the start, working meanwhile", whole)):
        yield f"  auto {what}: median {np.median(seconds[AUTO]):.2f} s, longest {max(seconds[AUTO]):.2f} s"
    yield f"  {len(made[AUTO])} seeds; the first one:"
    for rung in made[AUTO][0]["rungs"]:
        what = f"{rung['frames']:3d} frames, {rung['detail']}, 1 of {rung['stride']:2d} beams"
        cost = f"{rung['frame_casts']:6d} casts of a frame, {rung['seconds']:.2f} s"
        yield f"    {rung['candidates']:5d} candidates, {what}: {cost}"
    last = np.median([one["rungs"][-1]["frame_casts"] for one in made[AUTO]])
    beams = np.median([sum(rung["frame_casts"] / rung["stride"] for rung in one["rungs"]) for one in made[AUTO]])
    for name in (GRID, *args.searches):
        casts, rival = made[name][0]["rungs"][0]["frame_casts"], np.median(alone[name])
        times = f"alone median {rival:.1f} s, {rival / np.median(alone[AUTO]):.1f} times that of auto"
        if name in whole:
            longer = np.median(whole[name])
            times += f"; with the start {longer:.1f} s, {longer / np.median(whole[AUTO]):.1f} times"
        more = f"{casts / last:.1f} times as many casts of a whole frame, {casts / beams:.1f} times as many beams"
        yield f"  {name}: {times}; {more}"


def _scored(site, frames, poses):
    with site_evaluator(site, frames) as evaluator:
        totals = evaluator.totals(poses)
    return {"objective": totals.objective.tolist(), "vehicles": totals.vehicles.tolist()}


def _regret(rows, vehicles, seeds, against, rival, *, resampled):
    """Mean regret of auto to a rival over the seeds, and its upper 95 % bound."""
    gains = np.array([rows[key].sum() - rows["baseline"].sum() for key in against])
    if not (gains > 0.0).all():
        return f"to {rival}: none, as it gains nothing there"
    lost = np.array([rows[key] - rows[AUTO, seed] for key, seed in zip(against, seeds, strict=True)])
    regrets = lost.sum(axis=1) / gains
    told = f"regret to {rival}: mean {100 * regrets.mean():+.2f} %, median {100 * np.median(regrets):+.2f} %"
    bounds = []
    if len(regrets) > 1:
        bounds.append(regrets.mean() + student_t_95(len(regrets) - 1) * regrets.std(ddof=1) / np.sqrt(len(regrets)))
    if resampled:
        gain = np.array([rows[key] - rows["baseline"] for key in against])
        interval = _interval(lost.mean(axis=0), gain.mean(axis=0), vehicles)
        bounds += [] if interval is None else [interval]
    bound = f", upper 95 % bound {100 * max(bounds):+.2f} %" if bounds else ""
    return f"{told}, worst {100 * regrets.max():+.2f} %{bound}"


def _interval(lost, gain, vehicles):
    """Upper 95 % bound of what is lost as a share of the gain, over blocks of time: None for too few of them."""
    share = float(lost.sum() / gain.sum())
    interval = linear_interval_90(share, ((lost - share * gain) / gain.sum())[vehicles > 0])
    return None if interval is None else interval[1]


if __name__ == "__main__":
    sys.exit(main())
