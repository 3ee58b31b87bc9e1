"""What to maximise (Eqs. 10, 11) and how: the hardened search, DE-PSO and its rivals.

A function in, a best point out; needs numpy alone.
"""

from ..metrics.readings import READINGS
from .build import SEARCHES, make_search, search_from_state
from .hardened import Hardened, HardenedSettings
from .objective import VIEWS, detectable, vehicle_score
from .protocol import Search
from .rivals import GridSearch, RandomSearch
from .solve import Objective, SearchResult, de_pso, maximise, run
from .swarm import DePso, DePsoSettings

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
    "search_from_state",
    "vehicle_score",
]
