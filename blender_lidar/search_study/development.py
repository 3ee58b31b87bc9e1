"""The problems on which searches are tuned, and on nothing else: shifted, most turned, in boxes beside their optima.

Every box is 10 wide, lies wholly beyond the origin and is centred on nothing. The value at the optimum is 0; values are
negative elsewhere, so that success is -value <= target.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .problems import Problem

DIMENSIONS = (2, 4, 6)
TARGET = 1e-2
WIDTH = 10.0


def sphere(z: np.ndarray) -> np.ndarray:
    """Sum of squares of offsets (s, d)."""
    return np.square(z).sum(axis=1)


def ellipsoid(z: np.ndarray) -> np.ndarray:
    """A sphere with axes from 1 to 100: condition number 1e4."""
    return (10.0 ** (4.0 * np.linspace(0.0, 1.0, z.shape[1])) * np.square(z)).sum(axis=1)


def thin_ellipsoid(z: np.ndarray) -> np.ndarray:
    """A sphere with axes from 1 to 1,000: condition number 1e6."""
    return (10.0 ** (6.0 * np.linspace(0.0, 1.0, z.shape[1])) * np.square(z)).sum(axis=1)


def rosenbrock(z: np.ndarray) -> np.ndarray:
    """A bent valley."""
    z = z + 1.0
    return (100.0 * np.square(z[:, 1:] - np.square(z[:, :-1])) + np.square(z[:, :-1] - 1.0)).sum(axis=1)


def rastrigin(z: np.ndarray) -> np.ndarray:
    """A bowl with a deep dent at every whole number."""
    return (np.square(z) - 10.0 * np.cos(2.0 * np.pi * z) + 10.0).sum(axis=1)


def ackley(z: np.ndarray) -> np.ndarray:
    """A funnel with ripples."""
    funnel = -20.0 * np.exp(-0.2 * np.sqrt(np.square(z).mean(axis=1)))
    return funnel - np.exp(np.cos(2.0 * np.pi * z).mean(axis=1)) + 20.0 + np.e


def stepped_ackley(z: np.ndarray) -> np.ndarray:
    """Ackley in steps of 0.05, as a threshold on points makes the real objective."""
    return np.floor(ackley(z) / 0.05) * 0.05


def ridge(z: np.ndarray) -> np.ndarray:
    """A sharp ridge that falls gently."""
    return np.abs(z[:, 0]) + 30.0 * np.sqrt(np.square(z[:, 1:]).sum(axis=1))


_TURNED: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "sphere": sphere,
    "ellipsoid": ellipsoid,
    "thin ellipsoid": thin_ellipsoid,
    "Rosenbrock": rosenbrock,
    "Rastrigin": rastrigin,
    "Ackley": ackley,
    "stepped Ackley": stepped_ackley,
    "ridge": ridge,
}
_ALONG_THE_AXES = ("Rastrigin along the axes", "rippled ellipsoid along the axes")
NAMES = (*_TURNED, "wall", "peaks", "many peaks", *_ALONG_THE_AXES)


def development_problem(name: str, dimension: int, instance: int) -> Problem:
    """The instance of one of `NAMES`: optimum, box and rotation drawn anew."""
    rng = np.random.default_rng([instance, dimension, NAMES.index(name)])
    lower = 10.0 + 90.0 * rng.random(dimension)
    optimum = lower + WIDTH * (0.15 + 0.7 * rng.random(dimension))
    axes, _ = np.linalg.qr(rng.standard_normal((dimension, dimension)))
    if name == "wall":
        cost = _wall(rng, lower, optimum, axes)
    elif name == "peaks":
        cost = _peaks(rng, lower, optimum, axes, count=12, least=0.5, width=1.3)
    elif name == "many peaks":
        cost = _peaks(rng, lower, optimum, axes, count=60, least=0.3, width=0.55)
    elif name == "Rastrigin along the axes":

        def cost(x: np.ndarray) -> np.ndarray:
            return rastrigin(x - optimum)
    elif name == "rippled ellipsoid along the axes":

        def cost(x: np.ndarray) -> np.ndarray:
            return ellipsoid(x - optimum) + 5.0 * (1.0 - np.cos(np.pi * (x - optimum))).sum(axis=1)
    else:

        def cost(x: np.ndarray) -> np.ndarray:
            return _TURNED[name]((x - optimum) @ axes)

    return Problem(name, lower, lower + WIDTH, lambda x: -cost(x), 0.0)


def _wall(rng, lower, optimum, axes):
    """An ellipsoid whose optimum lies on a bound of half of the variables, which it presses against."""
    pressed = np.arange(lower.size) < (lower.size + 1) // 2
    side = np.where(rng.random(lower.size) < 0.5, lower + WIDTH, lower)
    optimum = np.where(pressed, side, optimum)

    def cost(x: np.ndarray) -> np.ndarray:
        offset = x - optimum
        return 2.0 * np.abs(offset[:, pressed]).sum(axis=1) + ellipsoid(offset @ axes) / 100.0

    return cost


def _peaks(rng, lower, optimum, axes, *, count, least, width):
    """Gaussian peaks of all widths, anywhere; the highest is 1, the others from `least` to 0.9."""
    d = lower.size
    centres = lower + WIDTH * (0.05 + 0.9 * rng.random((count, d)))
    centres[0] = optimum
    heights = np.concatenate([[1.0], least + (0.9 - least) * rng.random(count - 1)])
    widths = width * d**0.5 * np.exp(rng.normal(0.0, 0.3, (count, d)))

    def cost(x: np.ndarray) -> np.ndarray:
        offset = ((x[:, None, :] - centres) @ axes) / widths
        return 1.0 - (heights * np.exp(-0.5 * np.square(offset).sum(axis=2))).max(axis=1)

    return cost
