"""Cells of occupancy grids marked by points, compiled: the kernel behind `ViewGrids` and the compiled frame scorer.

A cell is a bit, and the grids of several clouds are united by OR. A place becomes cells in two steps: numbers of cells,
four points at a time as the processor's vectors have it, and then the bits. Indices are unsigned, as Numba would else
ask of each whether it counts from the end.
"""

from __future__ import annotations

import numpy as np

from ..compiled import compiled, inlined

OUTSIDE = -1.0  # for the number of a cell
_BIT, _WORD, _WITHIN = np.uint64(1), np.uint64(6), np.uint64(63)  # 64 bits in a word


@compiled
def mark_points(points, vehicle, half_m, cell_m, cells, start, bits):
    """Mark the cells of points (Eq. 6), as `ViewGrids` does it in NumPy.

    Points (k, 3) in the frames of their vehicles (k,) [m]; those more than a cell beyond their box are dropped.
    `half_m`, `cells` and `start` are those of `ViewGrids`, `bits` a bit for each cell.
    """
    for k in range(len(vehicle)):
        row = np.uint64(vehicle[k])
        half, sides = (half_m[0, row], half_m[1, row], half_m[2, row]), (cells[0, row], cells[1, row], cells[2, row])
        grids = float(start[0, row]), float(start[1, row]), float(start[2, row])
        top, side, front = cells_at(points[k, 0], points[k, 1], points[k, 2], half, sides, cell_m, grids)
        if top != OUTSIDE:
            mark(bits, top, side, front)


@inlined
def cells_at(x, y, z, half, sides, cell_m, grids):
    """Numbers of the cells of a place in the frame of a vehicle [m] in its three views, as floats.

    Of its box `half` is half of the sides [m], `sides` are these in cells; `grids` are the numbers of the first cells.
    """
    length, width, height = float(sides[0]), float(sides[1]), float(sides[2])
    x, y, z = (x + half[0]) / cell_m, (y + half[1]) / cell_m, (z + half[2]) / cell_m
    within_x, within_y = (x >= -1.0) & (x < length + 1.0), (y >= -1.0) & (y < width + 1.0)
    inside = within_x & within_y & (z >= -1.0) & (z < height + 1.0)
    along = np.floor(max(min(x, length - 1.0), 0.0))  # beyond the rim the rim's
    across, up = np.floor(max(min(y, width - 1.0), 0.0)), np.floor(max(min(z, height - 1.0), 0.0))
    top, side, front = (
        grids[0] + along * width + across,
        grids[1] + along * height + up,
        grids[2] + across * height + up,
    )
    return top if inside else OUTSIDE, side, front


@inlined
def mark(bits, top, side, front):
    """Set three bits."""
    a, b, c = np.uint64(np.int64(top)), np.uint64(np.int64(side)), np.uint64(np.int64(front))
    bits[a >> _WORD] |= _BIT << (a & _WITHIN)
    bits[b >> _WORD] |= _BIT << (b & _WITHIN)
    bits[c >> _WORD] |= _BIT << (c & _WITHIN)


@compiled
def count_cells(bits, start, words, hit):
    """Count the marked cells of each view in `hit` (n, 3), and empty them."""
    for row in range(len(hit)):
        for view in range(3):
            first = start[view, row] >> 6
            grid, found = bits[first : first + words[view, row]], np.uint64(0)
            for word in range(len(grid)):
                found += _ones(grid[word])
                grid[word] = np.uint64(0)
            hit[row, view] = found


# Of the population count of a word, by the sums of ever larger fields (Warren, Hacker's Delight, 5-1).
_FIELDS = tuple(map(np.uint64, (0x5555555555555555, 0x3333333333333333, 0x0F0F0F0F0F0F0F0F, 0x0101010101010101)))
_SHIFTS = tuple(map(np.uint64, (1, 2, 4, 56)))


@inlined
def _ones(word):
    """How many bits of a uint64 are set: the compiler makes one instruction of it."""
    word = word - ((word >> _SHIFTS[0]) & _FIELDS[0])
    word = (word & _FIELDS[1]) + ((word >> _SHIFTS[1]) & _FIELDS[1])
    word = (word + (word >> _SHIFTS[2])) & _FIELDS[2]
    return (word * _FIELDS[3]) >> _SHIFTS[3]
