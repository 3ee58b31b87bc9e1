"""The study in pieces that can be carried out apart: a stage each, what all solvers made of one instance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError
from . import bbob, development
from .counted import Counted
from .problems import Problem
from .scene_problems import CASES, INSTANCES, scene_problem
from .solvers import SOLVERS, solve
from .tuning import CHOICES

FIRST_BBOB = 125  # 1 to 9 and 32 to 124 judged earlier versions of the hardened search
FIRST_SCENE = 63  # a seed; which frames an instance looks at depends on it modulo `INSTANCES`
PARTS = ("bbob", *CASES)
SHIPPED = "shipped"  # the recording that the scene names
_TUNING_SEEDS = 1000  # the first of them; none is judged on


@dataclass(frozen=True, slots=True)
class Task:
    """A piece of the study.

    Attributes
    ----------
    name : str
        Of its stage.
    part : str
        "bbob", a name of `CASES`, or "tuning".
    what : str
        The dimension of BBOB, or the choice that is tuned.
    instance : int
        Which instance, and which seed; of the tuning how many.
    budget : int
        Evaluations of each run.
    scene : str
        Path of the scene file.
    traffic : str, optional
        Path of the recording in place of the scene's.
    """

    name: str
    part: str
    what: str
    instance: int
    budget: int
    scene: str
    traffic: str | None = None

    @property
    def recording(self) -> str:
        """Name of the recording that an instance of the scene looks at."""
        return SHIPPED if self.traffic is None else Path(self.traffic).name

    def run(self) -> list[dict]:
        """One dictionary for each run: solver, problem, and what `Counted.record` keeps."""
        if self.part == "tuning":
            return list(self._tuning())
        return list(self._bbob() if self.part == "bbob" else self._scene())

    def _bbob(self) -> Iterator[dict]:
        for function in bbob.FUNCTIONS:
            problem = bbob.bbob_problem(function, int(self.what), self.instance)
            for name in SOLVERS:
                yield self._judged(problem, name)

    def _scene(self) -> Iterator[dict]:
        with scene_problem(self.scene, self.part, self.instance, self.traffic) as (problem, baseline):
            for name in SOLVERS:
                yield {**self._judged(problem, name), "baseline": baseline}

    def _judged(self, problem: Problem, name: str) -> dict:
        found = solve(SOLVERS[name], Counted(problem, self.budget), self.instance)
        return {"solver": name, "problem": problem.name, "optimum": problem.best, **found}

    def _tuning(self) -> Iterator[dict]:
        for problem_name in development.NAMES:
            for dimension in development.DIMENSIONS:
                solved = 0
                for seed in range(_TUNING_SEEDS, _TUNING_SEEDS + self.instance):
                    problem = development.development_problem(problem_name, dimension, seed)
                    found = solve(CHOICES[self.what], Counted(problem, self.budget), seed)
                    solved += -found["best"][-1] <= development.TARGET
                yield {"problem": problem_name, "dimension": dimension, "solved": solved, "seeds": self.instance}


def judging(parts: list[str], seeds: int, budget: int, scene: str | Path, traffic: Sequence[str] = ()) -> list[Task]:
    """The pieces of the judging: instance by instance, so that a study that was stopped has all problems evenly.

    `traffic` are files of further recordings that the scene is judged on; all have instances and seeds of their own.

    Raises
    ------
    InputError
        For more seeds than a recording has instances, or recordings of one name.
    """
    if seeds > INSTANCES and set(parts) & set(CASES):
        raise InputError(f"{seeds} seeds; a recording has {INSTANCES} instances: leave it out with --part bbob")
    names = [Path(path).name for path in traffic]
    if len(set(names)) < len(names):
        raise InputError(f"--traffic: recordings {', '.join(names)}; allowed: each name once")
    found = list(_on_bbob(seeds, budget, str(scene))) if "bbob" in parts else []
    for case in CASES:
        if case in parts:
            found += _on_scene(case, seeds, budget, str(scene), traffic)
    return found


def _on_bbob(seeds: int, budget: int, scene: str) -> Iterator[Task]:
    for instance in range(FIRST_BBOB, FIRST_BBOB + seeds):
        for d in bbob.DIMENSIONS:
            yield Task(f"bbob_{d}d_{instance}", "bbob", str(d), instance, budget, scene)


def _on_scene(case: str, seeds: int, budget: int, scene: str, traffic: Sequence[str]) -> Iterator[Task]:
    for seed in range(FIRST_SCENE, FIRST_SCENE + seeds):
        for place, recording in enumerate([None, *traffic]):
            instance = seed + place * INSTANCES
            yield Task(f"{case}_{instance}".replace(" ", "_"), case, "", instance, budget, scene, recording)


def tuning(seeds: int, budget: int) -> list[Task]:
    """The pieces of the tuning: one for each choice."""
    return [Task(f"tuning_{place}", "tuning", choice, seeds, budget, "") for place, choice in enumerate(CHOICES)]
