"""Which of several things none other beats in both of two costs."""

from __future__ import annotations

import numpy as np


def pareto_front(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rows that no other row is as good as in both costs and better than in one, (f,), by rising first cost.

    Equal rows are all kept.
    """
    order = np.lexsort((second, first))
    kept, least, last = [], np.inf, None
    for row in order.tolist():
        both = (first[row], second[row])
        if second[row] < least or both == last:
            kept.append(row)
            least, last = second[row], both
    return np.array(kept, dtype=int)
