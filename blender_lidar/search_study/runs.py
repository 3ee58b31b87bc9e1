"""Carrying out the pieces of a study that its folder does not hold yet, in one process or several."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed

from ..study.stages import StudyFolder
from .tasks import Task


def carry_out(folder: StudyFolder, tasks: Iterable[Task], workers: int, done: Callable[[int], None]) -> None:
    """Run every task whose stage is not stored; `done` is told of each, stored before or not.

    Parameters
    ----------
    folder : StudyFolder
        Locked by the caller.
    tasks : iterable of Task
    workers : int
        Processes; 1 is this one.
    done : callable
    """
    waiting = []
    for task in tasks:
        if folder.holds(task.name):
            done(1)
        else:
            waiting.append(task)
    if workers == 1:
        for task in waiting:
            folder.stage(task.name, task.run)
            done(1)
        return
    spawned = multiprocessing.get_context("spawn")  # as everywhere here: a fork takes half of the threads' locks along
    with ProcessPoolExecutor(workers, mp_context=spawned) as pool:
        try:
            running = {pool.submit(_run, task): task for task in waiting}
            for future in as_completed(running):
                found = future.result()
                folder.stage(running[future].name, lambda found=found: found)
                done(1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def stored(folder: StudyFolder, tasks: Iterable[Task]) -> list[tuple[Task, list[dict]]]:
    """The tasks whose stages the folder holds, and what they came to."""
    return [(task, folder.stage(task.name, task.run)) for task in tasks if folder.holds(task.name)]


def _run(task: Task) -> list[dict]:
    return task.run()
