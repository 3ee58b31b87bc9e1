"""What was tried on the development problems, and nowhere else: settings of ours, and of SciPy's as many."""

from __future__ import annotations

from .solvers import Solver, cma_es, hardened, scipy_de

OUR_CHOICES: dict[str, Solver] = {
    "hardened, as frozen": hardened(),
    "hardened, 10 particles": hardened({"particles": 10}),
    "hardened, 40 particles": hardened({"particles": 40}),
    "hardened, no flights": hardened({"flights": 0.0}),
    "hardened, 40 % flights": hardened({"flights": 0.4}),
    "hardened, greed 0.1": hardened({"greed": 0.1}),
    "hardened, greed 0.4": hardened({"greed": 0.4}),
    "hardened, opening 2": hardened({"opening": 2}),
    "hardened, opening 6": hardened({"opening": 6}),
    "hardened, first step 0.1": hardened({"first_step": 0.1}),
    "hardened, first step 0.25": hardened({"first_step": 0.25}),
    "hardened, no climbs": hardened({"opening": 1_000_000}),
}
SCIPY_CHOICES: dict[str, Solver] = {
    **{f"SciPy DE, population {size}": scipy_de(size) for size in (2, 3, 4, 5, 6, 8, 10, 15)},
    "SciPy DE, population 5, Sobol": scipy_de(5, init="sobol"),
    "SciPy DE, population 5, rand1bin": scipy_de(5, strategy="rand1bin"),
    "SciPy DE, population 8, currenttobest1bin": scipy_de(8, strategy="currenttobest1bin"),
    "SciPy DE, population 5, best1exp": scipy_de(5, strategy="best1exp"),
}
CHOICES: dict[str, Solver] = {**OUR_CHOICES, **SCIPY_CHOICES, "CMA-ES, as judged": cma_es}
