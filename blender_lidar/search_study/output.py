"""What a study of the searches leaves: its page, its pictures and its numbers."""

from __future__ import annotations

import json
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..casting import resolve
from ..errors import MissingExtraError
from ..formats.atomic import write_text
from ..plots.search_ecdf import Panel, plot_search_ecdf
from ..provenance import file_digest, run_identity
from ..scenario import load_scenario
from ..study.stages import StudyFolder
from .judgement import Part, judgement, parts_of
from .report import report_text
from .runs import stored
from .scene_problems import CASES, FRAMES, INSTANCES
from .solvers import SCIPY_DE, SOLVERS
from .tasks import FIRST_BBOB, FIRST_SCENE, Task

PAGE, NUMBERS = "search.md", "search.json"
ECDF_BBOB, ECDF_SCENE = "search_ecdf_bbob.png", "search_ecdf_scene.png"
FILES = (PAGE, NUMBERS, ECDF_BBOB, ECDF_SCENE)
SCHEMA = 1
_OPTIMISE = Path(__file__).parents[1] / "optimise"
_LIBRARIES = ("numpy", "scipy", "cmaes", "ioh", "numba", "embreex")


def study_identity(scene: str | Path, seeds: int, budget: int, traffic: Sequence[str] = ()) -> dict[str, object]:
    """What the stages depend on; the digests are those of the searches as they were frozen."""
    digests = {f"optimise/{path.name}": file_digest(path) for path in sorted(_OPTIMISE.glob("*.py"))}
    scenario = load_scenario(scene)
    return {
        "study schema": SCHEMA,
        "budget": budget,
        **run_identity(scenario, resolve(scenario.model.caster, "caster")),
        "solvers": list(SOLVERS),
        "SciPy DE": SCIPY_DE,
        "first instances": [FIRST_BBOB, FIRST_SCENE],
        "frames": FRAMES,
        "instances": INSTANCES,
        "cases": CASES,
        "libraries": _libraries(),
        **{f"--traffic {place}": file_digest(Path(path)) for place, path in enumerate(traffic, 1)},
        **digests,
    }


def write_results(folder: StudyFolder, tasks: Sequence[Task]) -> list[str]:
    """Report what is stored of `tasks`; the names of the files written.

    Charts are left out, with a word in the page's place, where matplotlib is not installed.
    """
    found = stored(folder, tasks)
    tuned = {task.what: rows for task, rows in found if task.part == "tuning"}
    parts = parts_of([(task, rows) for task, rows in found if task.part != "tuning"])
    judged = judgement(parts)
    write_text(folder.file(PAGE), report_text(judged, tuned, _about()))
    write_text(folder.file(NUMBERS), json.dumps({**judged, "tuning": tuned}, indent=1) + "\n")
    written = [PAGE, NUMBERS]
    for name, chosen, what in (
        (
            ECDF_BBOB,
            [part for part in parts if part.label.startswith("BBOB")],
            "BBOB: how soon f - f* falls below targets from 100 to 1e-8",
        ),
        (
            ECDF_SCENE,
            [part for part in parts if part.label.startswith("scene")],
            "The scene: how soon the regret falls below targets from 100 to 0.01 %",
        ),
    ):
        if chosen and _drawn(folder.file(name), chosen, what):
            written.append(name)
    return written


def _drawn(path: Path, parts: Sequence[Part], what: str) -> bool:
    panels = [
        Panel(
            f"{part.label}: {len(part.group):,} runs each",
            part.evaluations,
            {name: part.reached(name) for name in SOLVERS},
        )
        for part in parts
    ]
    try:
        plot_search_ecdf(
            path, panels, "Share of targets reached", title=what, subtitle="Runtime ECDF over (problem, target) pairs"
        )
    except MissingExtraError:
        return False
    return True


def _libraries() -> list[str]:
    """The libraries that the rivals are made of, with their versions."""
    found = []
    for name in _LIBRARIES:
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"no {name}")
    return found


def _about() -> str:
    versions = [f"Python {platform.python_version()}", *_libraries()]
    return (
        "\n## How to make it again\n\n`python scripts/search_study.py --out DIR` judges, with `--traffic FILE` on that "
        "recording besides (the extra `sumo` and `scripts/make_traffic.py --seed SEED --out FILE` make one), "
        'with `--tune` it makes the record of the tuning; `pip install -e ".[fast,plots,study]"`.\n'
        f"{', '.join(versions)}; frames were cast by {resolve('auto', 'caster')}.\n"
    )
