"""The network of our PointPillars (Lang et al. 2019, CVPR) with a centre head (Yin et al. 2021, CVPR), in NumPy.

Pillars are square cells of the ground. A small net describes the points of each, what it finds is laid out as an image
seen from above, and convolutions tell for every second cell how likely a vehicle's centre lies there, and its box.
`forward` is written once for two sets of operations: `NumPyOperations` here, for detecting, and those of JAX in
scripts/research/train_detector.py, for training.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

POINT_FEATURES, CELL_FEATURES = 9, 5  # of each point, and of each cell besides what its points say
HEAT, OFFSET, LEVEL, SIZE, TURN = slice(0, 3), slice(3, 5), slice(5, 6), slice(6, 9), slice(9, 11)
OUTPUTS = 11
"""Of each output cell: a logit for each of `boxes.KINDS`, then of the vehicle whose centre lies there: offset of the
centre from the cell's middle, in output cells; its height above the ground [m]; logarithms of length, width and height
[m]; sine and cosine of twice the heading, as front and rear look alike."""
STRIDE = 2  # cells to a side of an output cell
COARSEST = 8  # cells to a side of what the deepest convolutions see: areas are whole multiples of it
_PILLAR, _WIDTHS = 32, (32, 64, 64)  # channels of a pillar, and of the three levels
_BLOCKS = (1, 1, 2)  # residual blocks of each level: the last see as far as long lorries reach

Weights = Mapping[str, np.ndarray]


def shapes() -> dict[str, tuple[int, ...]]:
    """Shape of each array of weights: ``.w`` of a linear map or of a 3 x 3 convolution, ``.b`` what it adds."""
    found = {"points": (POINT_FEATURES, _PILLAR), "pillar": (2 * _PILLAR, _PILLAR)}
    width = _PILLAR + CELL_FEATURES
    for level, (wider, blocks) in enumerate(zip(_WIDTHS, _BLOCKS, strict=True), start=1):
        found[f"down{level}"] = (4 * width, wider)
        for block in range(1, blocks + 1):
            found |= {f"level{level}.{block}{half}": (3, 3, wider, wider) for half in "ab"}
        width = wider
    for level in (2, 1):
        found[f"up{level}"] = (_WIDTHS[level], 4 * _WIDTHS[level - 1])
    found["head"] = (3, 3, _WIDTHS[0], _WIDTHS[0])
    found["out"] = (_WIDTHS[0], OUTPUTS)
    biases = {f"{name}.b": shape[-1:] for name, shape in found.items()}
    return {**{f"{name}.w": shape for name, shape in found.items()}, **biases}


class Operations(Protocol):
    """What `forward` needs of an array library; images are (frames, cells along x, cells along y, channels)."""

    def relu(self, values):
        """The larger of each value and 0."""

    def concatenate(self, parts):
        """Arrays joined along their last axis."""

    def maxima(self, values, cell, cells: int):
        """Largest of the values (m, c) of each cell, (cells, c); 0 where none is larger. `cell` (m,) rises."""

    def convolve(self, image, kernel):
        """3 x 3 convolution of an image with zeros around it, kernel (3, 3, c, d)."""


class NumPyOperations:
    """`Operations` in NumPy, for one frame at a time."""

    @staticmethod
    def relu(values: np.ndarray) -> np.ndarray:
        """The larger of each value and 0, in place."""
        return np.maximum(values, 0.0, out=values)

    @staticmethod
    def concatenate(parts) -> np.ndarray:
        """Arrays joined along their last axis."""
        return np.concatenate(parts, axis=-1)

    @staticmethod
    def maxima(values: np.ndarray, cell: np.ndarray, cells: int) -> np.ndarray:
        """Largest of the values of each cell."""
        found = np.zeros((cells, values.shape[1]), dtype=values.dtype)
        if len(cell):
            first = np.flatnonzero(np.diff(cell, prepend=-1))
            found[cell[first]] = np.maximum(np.maximum.reduceat(values, first, axis=0), 0.0)
        return found

    @staticmethod
    def convolve(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
        """3 x 3 convolution as nine products of matrices, each of the whole image moved by a cell (no copies).

        Rows lie one after the other with zeros between them, so that moving is a matter of where one begins to read.
        """
        _, rows, columns, channels = image.shape
        padded = np.zeros((rows + 3, columns + 2, channels), dtype=image.dtype)
        padded[1 : rows + 1, 1 : columns + 1] = image[0]
        flat, count = padded.reshape(-1, channels), rows * (columns + 2)
        total, one = np.zeros((2, count, kernel.shape[3]), dtype=image.dtype)
        for row in range(3):
            for column in range(3):
                start = row * (columns + 2) + column
                total += np.matmul(flat[start : start + count], kernel[row, column], out=one)
        return total.reshape(1, rows, columns + 2, -1)[:, :, :columns]


def forward(weights: Weights, points, cell, cells, operations: Operations = NumPyOperations):
    """What the network makes of frames.

    Parameters
    ----------
    weights : mapping
        Arrays of the `shapes`.
    points : array, (m, POINT_FEATURES)
        Features of each point, in the order of their cells.
    cell : array of int, (m,)
        The cell that each lies in, counted through frames, x and y; rising.
    cells : array, (frames, x, y, CELL_FEATURES)
        Features of each cell; x and y are multiples of `COARSEST`.

    Returns
    -------
    array, (frames, x / 2, y / 2, OUTPUTS)
    """
    frames, along, across, _ = cells.shape
    relu, join = operations.relu, operations.concatenate

    def linear(name, values):
        return values @ weights[f"{name}.w"] + weights[f"{name}.b"]

    def convolved(name, image):
        return operations.convolve(image, weights[f"{name}.w"]) + weights[f"{name}.b"]

    count = frames * along * across
    described = relu(linear("points", points))
    of_cell = operations.maxima(described, cell, count)
    described = relu(linear("pillar", join([described, of_cell[cell]])))
    image = operations.maxima(described, cell, count).reshape(frames, along, across, _PILLAR)
    image = join([image, cells])
    levels = []
    for level, blocks in enumerate(_BLOCKS, start=1):
        image = relu(linear(f"down{level}", _patches(image)))
        for block in range(1, blocks + 1):
            inner = relu(convolved(f"level{level}.{block}a", image))
            image = relu(image + convolved(f"level{level}.{block}b", inner))
        levels.append(image)
    for level in (2, 1):
        image = relu(levels[level - 1] + _unpatched(linear(f"up{level}", image)))
    return linear("out", relu(convolved("head", image)))


def _patches(image):
    """Each 2 x 2 cells as one with four times the channels."""
    frames, along, across, channels = image.shape
    pairs = image.reshape(frames, along // 2, 2, across // 2, 2, channels)
    return pairs.transpose(0, 1, 3, 2, 4, 5).reshape(frames, along // 2, across // 2, 4 * channels)


def _unpatched(image):
    """The inverse of `_patches`."""
    frames, along, across, channels = image.shape
    pairs = image.reshape(frames, along, across, 2, 2, channels // 4)
    return pairs.transpose(0, 1, 3, 2, 4, 5).reshape(frames, 2 * along, 2 * across, channels // 4)
