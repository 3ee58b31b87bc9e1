"""Peak memory of this process and those it started: of what is resident, libraries' own arrays among it.

`tracemalloc` sees what Python and NumPy allocate, and none of what Embree and Blender do; and the peak that `getrusage`
tells of a process that was started by a larger one is the larger one's. So what Linux says of the process itself is
read; elsewhere `getrusage` has to do.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from contextlib import suppress
from pathlib import Path

MIB = 1 << 20


def forget_peak() -> None:
    """Let the peak begin anew from what is resident now, where Linux lets us."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def resident_mib() -> float | None:
    """What is resident now [MiB]; None where that cannot be told."""
    return _status("VmRSS", os.getpid())


def peak_mib() -> float | None:
    """The most that was resident at a time [MiB], added up over this process and its children that still run."""
    own = _status("VmHWM", os.getpid())
    if own is None:
        return _peak_by_getrusage()
    children = (_status("VmHWM", child.pid) for child in multiprocessing.active_children())
    return own + sum(peak for peak in children if peak is not None)


def _status(field: str, pid: int | None) -> float | None:
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="utf-8")
    except OSError:
        return None
    for line in text.splitlines():
        if line.startswith(f"{field}:"):
            return int(line.split()[1]) / 1024.0  # kB
    return None


def _peak_by_getrusage() -> float | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (MIB if sys.platform == "darwin" else 1024.0)
