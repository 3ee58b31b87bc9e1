"""A motorcycle and its rider at the level `detailed`, 2.2 x 0.9 x 1.4 m up to the helmet; see `detailed_shapes`."""

from __future__ import annotations

from .meshes import block, both_sides, drum, limb


def motorcycle():
    """Its parts and the rider's."""
    return (*_machine(), *_rider())


def _machine():
    yield drum((0.31, 0.0, 0.31), 0.31, 0.16, 12)
    yield drum((1.89, 0.0, 0.31), 0.31, 0.13, 12)
    tail, seat, tank, head = (
        (0.12, 0, 0.80, 0.07, 0.05),
        (0.62, 0, 0.72, 0.14, 0.09),
        (1.16, 0, 0.80, 0.17, 0.15),
        (1.50, 0, 0.88, 0.08, 0.08),
    )
    yield limb([tail, seat, tank, head])
    yield limb([(0.66, 0, 0.46, 0.15, 0.24), (1.40, 0, 0.48, 0.17, 0.26)])  # engine
    yield limb([(1.42, 0, 0.90, 0.10, 0.10), (1.70, 0, 0.92, 0.12, 0.12)])  # headlight
    yield block((1.36, -0.42, 1.00), (1.42, 0.42, 1.05))  # handlebar
    yield from both_sides(
        limb([(1.50, 0.09, 0.96, 0.04, 0.03), (1.89, 0.09, 0.31, 0.04, 0.03)], 4),  # fork
        limb([(0.31, 0.10, 0.31, 0.04, 0.04), (0.80, 0.10, 0.42, 0.04, 0.05)], 4),  # swing arm
        block((1.38, 0.33, 1.03), (1.44, 0.45, 1.16)),  # mirror
    )


def _rider():
    yield limb([(0.70, 0, 0.80, 0.17, 0.12), (0.84, 0, 1.00, 0.18, 0.12), (0.98, 0, 1.18, 0.21, 0.10)])  # torso
    neck, jaw = (1.06, 0, 1.10, 0.08, 0.08), (1.07, 0, 1.19, 0.12, 0.14)
    brow, crown = (1.07, 0, 1.30, 0.12, 0.14), (1.06, 0, 1.40, 0.06, 0.08)
    yield limb([neck, jaw, brow, crown], 8)  # helmet
    yield from both_sides(
        limb([(0.96, 0.20, 1.16, 0.06, 0.06), (1.12, 0.33, 0.98, 0.05, 0.05), (1.40, 0.34, 1.03, 0.04, 0.04)]),  # arm
        limb([(0.72, 0.11, 0.78, 0.08, 0.09), (1.14, 0.21, 0.74, 0.06, 0.07)]),  # thigh
        limb([(1.12, 0.21, 0.76, 0.06, 0.07), (0.88, 0.21, 0.30, 0.05, 0.06)]),  # shank
    )
