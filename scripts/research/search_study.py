"""How the searches do beside each other and beside other people's: the tables of docs/evidence/search.md made again.

    python scripts/research/search_study.py [--out DIR] [--resume] [--part bbob] [--traffic FILE] [--quick]

Judges on BBOB in 2, 3 and 5 dimensions and on scenes/i80.toml with two and with five coordinates searched, 2,000
evaluations to a run; with --traffic FILE the scene is judged on that recording besides. What is done is stored
instance by instance; a study that was stopped goes on with --resume, and --report reports what there is. It needs the
extra `study`.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # small matrices: more threads only get in each other's way

from arguments import SCENES, counting, parser_of, positive, run_script
from blender_lidar import optimise
from blender_lidar.casting import resolve
from blender_lidar.errors import InputError, MissingExtraError
from blender_lidar.files import write_text
from blender_lidar.scene.provenance import file_digest, run_identity
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.studies.driver import StudyFolder
from search_judgement import judgement, parts_of
from search_problems import (
    BBOB_DIMENSIONS,
    BBOB_FUNCTIONS,
    CASES,
    INSTANCES,
    Problem,
    bbob_problem,
    scene_problem,
)
from search_report import draw_ecdf, report_text
from search_solvers import SOLVERS, Counted, solve

SCENE = SCENES / "i80.toml"
FIRST_BBOB = 125  # 1 to 9 and 32 to 124 judged earlier versions of the hardened search
FIRST_SCENE = 63  # a seed; which frames an instance looks at depends on it modulo `INSTANCES`
PARTS = ("bbob", *CASES)
PAGE, NUMBERS = "search.md", "search.json"
PICTURES = {
    "search_ecdf_bbob.png": ("BBOB", "BBOB: how soon f - f* falls below targets from 100 to 1e-8"),
    "search_ecdf_scene.png": ("scene", "The scene: how soon the regret falls below targets from 100 to 0.01 %"),
}


def main(argv: list[str] | None = None) -> int:
    return run_script("search_study", lambda: _study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--out", default="runs/search", metavar="DIR", help="folder of the results; runs/search")
    parser.add_argument("--resume", action="store_true", help="go on with the study in --out that was stopped")
    parser.add_argument("--seeds", type=positive, default=31, help="instances and seeds of every problem; 31")
    parser.add_argument("--quick", action="store_true", help="2 seeds and 200 evaluations, to see that all works")
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part; may be given again")
    parser.add_argument(
        "--traffic", action="append", default=[], metavar="FILE", help="a further recording; may be given again"
    )
    parser.add_argument("--report", action="store_true", help="run nothing: report what is stored")
    parser.add_argument("--workers", type=positive, default=1, help="processes, of this machine alone; 1")
    return parser.parse_args(argv)


def _study(args):
    seeds, budget = (2, 200) if args.quick else (args.seeds, 2000)
    judged = judging(PARTS, seeds, budget, SCENE, args.traffic)
    wanted = [task for task in judged if task.part in (args.part or PARTS)]
    folder = StudyFolder(args.out, study_identity(SCENE, seeds, budget, args.traffic))
    with folder.locked(resume=args.resume):
        if not args.report:
            with counting(len(wanted), "judging") as advance:
                carry_out(folder, wanted, args.workers, advance)
        written = write_results(folder, judged)
    print(f"Results in {folder.path}: {', '.join(written)}", file=sys.stderr)


@dataclass(frozen=True, slots=True)
class Task:
    """A piece of the study that can be carried out apart: what all solvers make of one instance.

    Attributes
    ----------
    name : str
        Of its stage.
    part : str
        "bbob", or a name of `CASES`.
    what : str
        The dimension of BBOB.
    instance : int
        Which instance, and which seed.
    budget : int
        Evaluations of each run.
    scene, traffic : str
        Paths of the scene and of the recording, empty for the scene's own.
    """

    name: str
    part: str
    what: str
    instance: int
    budget: int
    scene: str = ""
    traffic: str = ""

    @property
    def recording(self) -> str:
        """Name of the recording that an instance of the scene looks at."""
        return Path(self.traffic).name if self.traffic else "shipped"

    def run(self) -> list[dict]:
        """One dictionary for each run: solver, problem, and what `Counted.record` keeps."""
        return list(self._bbob() if self.part == "bbob" else self._scene())

    def _bbob(self) -> Iterator[dict]:
        for function in BBOB_FUNCTIONS:
            problem = bbob_problem(function, int(self.what), self.instance)
            for name in SOLVERS:
                yield self._judged(problem, name)

    def _scene(self) -> Iterator[dict]:
        with scene_problem(self.scene, self.part, self.instance, self.traffic or None) as (problem, baseline):
            for name in SOLVERS:
                yield {**self._judged(problem, name), "baseline": baseline}

    def _judged(self, problem: Problem, name: str) -> dict:
        found = solve(SOLVERS[name], Counted(problem, self.budget), self.instance)
        return {"solver": name, "problem": problem.name, "optimum": problem.best, **found}


def judging(
    parts: Sequence[str], seeds: int, budget: int, scene: str | Path, traffic: Sequence[str] = ()
) -> list[Task]:
    """The pieces of the judging: instance by instance, so that a study that was stopped has all problems evenly.

    `traffic` are files of further recordings that the scene is judged on; all have instances and seeds of their own.
    """
    names = [Path(path).name for path in traffic]
    if len(set(names)) < len(names):
        raise InputError(f"--traffic: recordings {', '.join(names)}; allowed: each name once")
    found = [
        Task(f"bbob_{d}d_{instance}", "bbob", str(d), instance, budget)
        for instance in range(FIRST_BBOB, FIRST_BBOB + seeds)
        for d in BBOB_DIMENSIONS
    ]
    for case in CASES:
        for seed in range(FIRST_SCENE, FIRST_SCENE + min(seeds, INSTANCES)):  # there are no more choices of frames
            for place, recording in enumerate(["", *traffic]):
                instance = seed + place * INSTANCES
                name = f"{case}_{instance}".replace(" ", "_")
                found.append(Task(name, case, "", instance, budget, str(scene), str(recording)))
    return [task for task in found if task.part in parts]


def carry_out(folder: StudyFolder, tasks: Iterable[Task], workers: int, done: Callable[[int], None]) -> None:
    """Run every task whose stage the folder, which is locked, does not hold; `done` is called for each, held or not."""
    tasks = list(tasks)
    waiting = [task for task in tasks if not folder.holds(task.name)]
    if len(waiting) < len(tasks):
        done(len(tasks) - len(waiting))
    if workers == 1:
        for task in waiting:
            folder.stage(task.name, task.run)
            done(1)
        return
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        try:
            running = {pool.submit(task.run): task for task in waiting}
            for future in as_completed(running):
                folder.stage(running[future].name, future.result)
                done(1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def study_identity(scene: str | Path, seeds: int, budget: int, traffic: Sequence[str] = ()) -> dict[str, object]:
    """What the stages depend on; the digests are those of the searches as they were frozen, and of the study's code."""
    own, searches = Path(__file__).parent, Path(optimise.__file__).parent
    scenario = load_scenario(scene)
    return {
        "budget": budget,
        **run_identity(scenario, resolve(scenario.model.caster, "caster")),
        "libraries": [f"{name} {version(name)}" for name in ("numpy", "scipy", "cmaes", "ioh")],
        **{f"--traffic {place}": file_digest(Path(path)) for place, path in enumerate(traffic, 1)},
        **{f"optimise/{path.name}": file_digest(path) for path in sorted(searches.glob("*.py"))},
        **{path: file_digest(own / path) for path in ("search_problems.py", "search_solvers.py")},
    }


def write_results(folder: StudyFolder, tasks: Sequence[Task]) -> list[str]:
    """Report what is stored of `tasks`, with pictures where matplotlib is installed; the names of the files."""
    stored = [(task, folder.stage(task.name, task.run)) for task in tasks if folder.holds(task.name)]
    parts = parts_of(stored)
    judged = judgement(parts)
    write_text(folder.file(PAGE), report_text(judged))
    write_text(folder.file(NUMBERS), json.dumps(judged, indent=1) + "\n")
    written = [PAGE, NUMBERS]
    for name, (label, title) in PICTURES.items():
        chosen = [part for part in parts if part.label.startswith(label)]
        try:
            if chosen:
                draw_ecdf(folder.file(name), chosen, title)
                written.append(name)
        except MissingExtraError as error:
            print(f"no pictures: {error}", file=sys.stderr)
    return written


if __name__ == "__main__":
    sys.exit(main())
