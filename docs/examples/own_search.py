"""A search of one's own, by ask and tell: a (1 + 8) evolution strategy.

From the command line, in this folder:

    blender-lidar optimise i80 --search own_search.py:Evolution
"""

import numpy as np

import blender_lidar as bl


class Evolution:
    """Children around the best point so far; their spread grows when one is better and shrinks when none is."""

    def __init__(self, lower, upper, *, seed, budget):
        self.lower, self.upper = lower, upper
        self.rng = np.random.default_rng(seed)
        self.best, self.value, self.spread = (lower + upper) / 2, -np.inf, 0.3

    def ask(self):
        """The candidates to evaluate next, (8, d): the same whenever it is told the same."""
        steps = self.rng.normal(size=(8, self.lower.size)) * self.spread * (self.upper - self.lower)
        self.asked = np.clip(self.best + steps, self.lower, self.upper)
        return self.asked

    def tell(self, values):
        """Their values, the higher the better; the last batch may be cut to the budget."""
        better = values.max() > self.value
        if better:
            self.best, self.value = self.asked[values.argmax()], values.max()
        self.spread *= 1.5 if better else 0.8


if __name__ == "__main__":  # workers load this file too, and must not search
    for search in (Evolution, "hardened"):
        site = bl.load_scene("i80", search=search, frames=4, particles=5, iterations=8)
        run = bl.best_mounting(site, progress=True)
        print(f"{run.result['search']}: {run.result['objective']:.1f} bits, {run.mounting['tilt_x_deg']:.1f} degrees")
