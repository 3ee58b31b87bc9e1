"""What to maximise (Eqs. 10, 11) and how: the hardened search, DE-PSO and its rivals.

A function in, a best point out; needs numpy alone.
"""

from ..names import READINGS as READINGS
from ..names import SEARCHES as SEARCHES
from ..names import VIEWS as VIEWS
from .baselines import GridSearch as GridSearch
from .baselines import RandomSearch as RandomSearch
from .de_pso import DePso as DePso
from .de_pso import DePsoSettings as DePsoSettings
from .hardened import Hardened as Hardened
from .objective import detectable as detectable
from .objective import vehicle_score as vehicle_score
from .search import Search as Search
from .solve import Objective as Objective
from .solve import SearchResult as SearchResult
from .solve import de_pso as de_pso
from .solve import make_search as make_search
from .solve import maximise as maximise
from .solve import run as run
from .solve import search_named as search_named
