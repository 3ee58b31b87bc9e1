"""What counts as success and what the hardened search is to achieve: fixed before anything was judged."""

from __future__ import annotations

BBOB_SUCCESS = 1e-2  # f - f*
BBOB_ALSO = (1e-1, 1e-4)  # reported besides
SCENE_SUCCESS = 0.01  # regret as a share of [best known - baseline]
SCENE_ALSO = (0.05, 0.001)
MARGIN = 0.05  # share of successes by which the best rival may at most be ahead, interval included

BBOB_TARGETS = tuple(10.0 ** (2.0 - 0.2 * k) for k in range(51))  # of the runtime ECDF: 1e2 to 1e-8
SCENE_TARGETS = tuple(10.0 ** (-0.1 * k) for k in range(41))  # 1 to 1e-4
