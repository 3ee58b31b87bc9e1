"""Where evaluations are carried out: in this process, in processes of our own, or on a cluster."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from .cluster_workers import ClusterWorkers
from .shared_work import SharedWork
from .workers import Alone, Workers


@dataclass(frozen=True, slots=True)
class Workplace:
    """Where to work; it changes the time that a run takes and nothing else.

    Attributes
    ----------
    processes : int
        How many, this one among them.
    cluster : str or None
        Address of a dask scheduler, whose workers are used instead.
    """

    processes: int = 1
    cluster: str | None = None

    def __str__(self) -> str:
        if self.cluster is not None:
            return f"cluster {self.cluster}"
        return f"{self.processes} worker{'s' * (self.processes != 1)}"

    def employ(self, function: Callable, most: int) -> Workers:
        """Workers who call a function, up to so many; to be closed.

        Raises
        ------
        WorkerError, MissingExtraError
            When they cannot be had.
        """
        if self.cluster is not None and most:
            return ClusterWorkers(function, self.cluster)
        processes = min(self.processes, most)
        if processes > 1:
            return SharedWork(function, processes)
        return Alone(function)
