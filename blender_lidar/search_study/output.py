"""What a study of the searches leaves: its text, its pictures and its numbers."""

from __future__ import annotations

from pathlib import Path

from ..provenance import file_digest
from ..study.stages import StudyFolder
from .solvers import SCIPY_DE, SOLVERS
from .tasks import Task

FILES = ("search.md", "search.json", "search_ecdf_bbob.png", "search_ecdf_scene.png")
SCHEMA = 1
_OPTIMISE = Path(__file__).parents[1] / "optimise"


def study_identity(scene, seeds, budget):
    """What the stages depend on; the digests are those of the search as frozen."""
    digests = {f"optimise/{path.name}": file_digest(path) for path in sorted(_OPTIMISE.glob("*.py"))}
    return {
        "study schema": SCHEMA,
        "budget": budget,
        "scene": f"file with SHA-256 {file_digest(scene)}",
        "solvers": list(SOLVERS),
        "SciPy DE": SCIPY_DE,
        **digests,
    }


def write_results(folder: StudyFolder, tasks: list[Task]) -> list[str]:
    return []
