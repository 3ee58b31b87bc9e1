"""Which metrics are held against detectors: the catalogue's, PE-VGOP's logarithm, and those that learn from cars."""

from __future__ import annotations

import numpy as np

from ..errors import InputError, unknown_name
from ..metrics.catalogue import METRICS
from ..metrics.metric import VIEW, Metric, VehicleReturns
from .learned_metrics import LEARNED

OURS = "view-coverage"
PAPERS = "pe-vgop"
_OFFSET_BITS = 0.001  # so that a car without a point has a logarithm


def log_pe_vgop(returns: VehicleReturns) -> np.ndarray:
    """ln(PE-VGOP + 0.001), (n,): the same order as PE-VGOP, in which detectors saturate later."""
    return np.log(METRICS[PAPERS].values(returns) + _OFFSET_BITS)


LOG_PE_VGOP = Metric("log-pe-vgop", "ln(PE-VGOP + 0.001)", "", higher_is_better=True, score=log_pe_vgop)


def comparable() -> dict[str, Metric]:
    """Metrics of single cars, by name: those that learn from a scene's traffic are left out."""
    of_cars = {name: one for name, one in METRICS.items() if one.learn is None and VIEW not in one.needs}
    first = {name: of_cars.pop(name) for name in (OURS, PAPERS)}
    return {**first, LOG_PE_VGOP.name: LOG_PE_VGOP, **of_cars, **LEARNED}


def chosen_metrics(names: str | None, option: str = "--metrics") -> tuple[Metric, ...]:
    """The metrics that an option names, divided by commas; all by default.

    Raises
    ------
    InputError
        For one that is not known or named twice.
    """
    known = comparable()
    if names is None:
        return tuple(known.values())
    chosen = [name.strip() for name in names.split(",")]
    for number, name in enumerate(chosen):
        if name not in known:
            raise unknown_name(name, known, "metric", option)
        if name in chosen[:number]:
            raise InputError(f"{option}: names {name} twice")
    return tuple(known[name] for name in chosen)
