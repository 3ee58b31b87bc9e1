"""What to maximise (Eqs. 10, 11) and how: the hardened search, DE-PSO and its rivals.

A function in, a best point out; needs numpy alone.
"""

from ..metrics.view_grids import READINGS
from .baselines import GridSearch, RandomSearch
from .de_pso import DePso, DePsoSettings
from .hardened import Hardened, HardenedSettings
from .objective import VIEWS, detectable, vehicle_score
from .search import Search
from .solve import SEARCHES, Objective, SearchResult, de_pso, make_search, maximise, run

__all__ = [
    "READINGS",
    "SEARCHES",
    "VIEWS",
    "DePso",
    "DePsoSettings",
    "GridSearch",
    "Hardened",
    "HardenedSettings",
    "Objective",
    "RandomSearch",
    "Search",
    "SearchResult",
    "de_pso",
    "detectable",
    "make_search",
    "maximise",
    "run",
    "vehicle_score",
]
