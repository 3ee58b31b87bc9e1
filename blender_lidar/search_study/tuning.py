"""What was tried on the development problems, and nowhere else: settings of ours, and of SciPy's as many."""

from __future__ import annotations

from .solvers import Solver, cma_es, hardened, scipy_de

OUR_CHOICES: dict[str, Solver] = {
    "hardened, as frozen": hardened(),
    "hardened, 10 particles": hardened({"particles": 10}),
    "hardened, 40 particles": hardened({"particles": 40}),
    "hardened, no flights": hardened({"flights": 0.0}),
    "hardened, 40 % flights": hardened({"flights": 0.4}),
    "hardened, greed 0.2": hardened({"greed": 0.2}),
    "hardened, greed 0.4": hardened({"greed": 0.4}),
    "hardened, never turned": hardened({"turned": 0.0}),
    "hardened, always turned": hardened({"turned": 1.0}),
    "hardened, opening 0.03": hardened({"opening": 0.03}),
    "hardened, opening 0.25": hardened({"opening": 0.25}),
    "hardened, opening 0.75": hardened({"opening": 0.75}),
    "hardened, no climbs": hardened({"climbs": False}),
}
SCIPY_CHOICES: dict[str, Solver] = {
    **{f"SciPy DE, population {size}": scipy_de(size) for size in (2, 3, 4, 5, 6, 8, 10, 15)},
    "SciPy DE, population 5, Sobol": scipy_de(5, init="sobol"),
    "SciPy DE, population 5, rand1bin": scipy_de(5, strategy="rand1bin"),
    "SciPy DE, population 8, currenttobest1bin": scipy_de(8, strategy="currenttobest1bin"),
    "SciPy DE, population 5, best1exp": scipy_de(5, strategy="best1exp"),
}
CHOICES: dict[str, Solver] = {**OUR_CHOICES, **SCIPY_CHOICES, "CMA-ES, as judged": cma_es}
