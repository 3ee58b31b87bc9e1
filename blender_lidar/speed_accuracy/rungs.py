"""What becomes of each rung: its time and its accuracy; and the fastest of those that are near enough."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..study.fewer_frames import evenly_spread
from ..study.fidelity import Fidelity
from ..study.landscape import Landscape
from .accuracy import Accuracy, Reference, accuracy
from .ladder import Rung
from .pareto import pareto_front
from .sequence import BOUND_LEVEL
from .timing import Timed

SAME = 1e-9  # of a score, relative: what differs by less has met the same hits


def rung_rows(
    rungs: Sequence[Rung],
    reference: Reference,
    scored: Mapping[Fidelity, Sequence[Landscape]],
    checked: Mapping[Fidelity, Landscape],
    timed: Mapping[Fidelity, Timed],
) -> list[dict]:
    """A row for each rung, the reference first; as JSON holds it.

    Parameters
    ----------
    rungs : sequence of Rung
    reference : Reference
    scored : mapping of Fidelity to landscapes
        Of each detail and stride, its phases on all frames.
    checked : mapping of Fidelity to Landscape
        Of rungs with a twin, on the first few mountings.
    timed : mapping of Fidelity to Timed
        Of each fidelity on all frames.
    """
    of_reference = _seconds(rungs[0].fidelity, timed)
    rows = []
    for rung in rungs:
        fidelity = rung.fidelity
        same, found = True, None
        if rung.twin is not None:
            same = _agree(checked[fidelity], scored[rung.twin][0])
        if same:
            found = _accuracy(rung.twin or fidelity, reference, scored)
        seconds = _seconds(fidelity, timed)
        rows.append(
            {
                "name": fidelity.name,
                "text": fidelity.text,
                "detail": fidelity.detail,
                "stride": fidelity.stride,
                "frames": fidelity.frames or len(reference.searched.vehicles),
                "caster": fidelity.caster,
                "culled": fidelity.culled,
                "ground": fidelity.ground,
                "twin": None if rung.twin is None else rung.twin.name,
                "same_as_twin": None if rung.twin is None else same,
                "milliseconds": _quartiles(seconds),
                "build_milliseconds_per_frame": float(1e3 * np.median(timed[_whole(fidelity)].build_s)),
                "speedup": float(np.median(of_reference) / np.median(seconds)),
                **_accuracy_fields(found, reference.gain),
            }
        )
    _mark_front(rows)
    return rows


def recommended(rows: Sequence[dict]) -> dict:
    """The fastest of those that are near enough, the reference being one, with culling and without the ground."""
    plain = (row for row in rows if row["within"] and row["culled"] and not row["ground"])
    return min(plain, key=lambda row: row["milliseconds"]["median"])


def _whole(fidelity: Fidelity) -> Fidelity:
    return replace(fidelity, frames=None)


def _seconds(fidelity: Fidelity, timed: Mapping[Fidelity, Timed]) -> np.ndarray:
    """Of one evaluation in each round, (rounds,) [s]."""
    each = timed[_whole(fidelity)].evaluation_s
    kept = np.arange(each.shape[1]) if fidelity.frames is None else evenly_spread(each.shape[1], fidelity.frames)
    return each[:, kept].sum(axis=1)


def _quartiles(seconds: np.ndarray) -> dict[str, float]:
    quartiles = (1e3 * np.quantile(seconds, [0.25, 0.5, 0.75])).tolist()
    return dict(zip(("first_quartile", "median", "third_quartile"), quartiles, strict=True))


def _accuracy(fidelity, reference, scored) -> Accuracy:
    frames = None
    if fidelity.frames is not None:
        frames = evenly_spread(len(reference.searched.vehicles), fidelity.frames)
    return accuracy(reference, scored[_whole(fidelity)], frames)


def _accuracy_fields(found: Accuracy | None, gain: float) -> dict:
    """None for what is not known: of a rung that ought to come to the same as its twin, and does not."""
    lost = None if found is None else found.regret
    return {
        "bias": None if found is None else found.bias,
        "error": None if found is None else found.error,
        "error_share": found.error / gain if found is not None and gain > 0.0 else None,
        "tau": None if found is None or np.isnan(found.tau) else found.tau,
        "regret": None if lost is None else lost.share,
        "regret_interval_90": None if lost is None or lost.interval_90 is None else list(lost.interval_90),
        "regret_bound": None if lost is None else lost.bound(BOUND_LEVEL),
    }


def _agree(few: Landscape, many: Landscape) -> bool:
    """Whether the first mountings of both come to the same."""
    return bool(np.allclose(few.objective, many.objective[: len(few.objective)], rtol=SAME, atol=SAME))


def _mark_front(rows: Sequence[dict]) -> None:
    known = [row for row in rows if row["error"] is not None]
    time = np.array([row["milliseconds"]["median"] for row in known])
    front = pareto_front(time, np.array([row["error"] for row in known]))
    for row in rows:
        row["pareto"] = False
    for number in front.tolist():
        known[number]["pareto"] = True
