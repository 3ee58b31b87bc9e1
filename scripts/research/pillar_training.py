"""PointPillars in JAX: what the network shall say of labelled clouds, its loss, and a step of training."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from blender_lidar.detection.ground import fit_ground
from blender_lidar.detection.pillar_network import (
    HEAT,
    LEVEL,
    OFFSET,
    POINT_FEATURES,
    SIZE,
    STRIDE,
    TURN,
    forward,
    shapes,
)
from blender_lidar.detection.pillars import PILLAR_M, Area, Pillars, pillars_of
from blender_lidar.traffic.boxes import KINDS

WINDOW = 256, 96  # cells along and across: 102.4 x 38.4 m
BATCH = 4  # windows of one sensor
WARM_UP, HIGHEST_RATE, LAST_RATE = 200, 2e-3, 1e-5  # steps, and Adam's step size

# --- The operations of the network in JAX -----------------------------------------------------------------------------


@partial(jax.custom_vjp, nondiff_argnums=(2,))
def segment_maxima(values, cell, cells):
    """Largest of the values of each cell, 0 where none is larger; what lies in no cell has the number `cells`."""
    return jnp.maximum(jax.ops.segment_max(values, cell, cells, indices_are_sorted=True), 0.0)


def _maxima_forward(values, cell, cells):
    found = segment_maxima(values, cell, cells)
    return found, (values, cell, found)


def _maxima_backward(cells, kept, gradient):
    values, cell, found = kept
    return jnp.where(values == found.at[cell].get(mode="clip"), gradient.at[cell].get(mode="clip"), 0.0), None


segment_maxima.defvjp(_maxima_forward, _maxima_backward)


class JaxOperations:
    """What `pillar_network.forward` needs, in JAX and for any number of frames."""

    relu = staticmethod(jax.nn.relu)
    maxima = staticmethod(segment_maxima)

    @staticmethod
    def concatenate(parts):
        """Arrays joined along their last axis."""
        return jnp.concatenate(parts, axis=-1)

    @staticmethod
    def convolve(image, kernel):
        """3 x 3 convolution with zeros around the image."""
        return lax.conv_general_dilated(image, kernel, (1, 1), "SAME", dimension_numbers=("NHWC", "HWIO", "NHWC"))


# --- Windows of clouds, and what the network shall say of them --------------------------------------------------------


class Window(NamedTuple):
    """A part of a labelled cloud: x and y from the LiDAR, z from where the road is believed to be [m].

    `boxes` (v, 9) are x, y, z, length, width, height [m], heading [rad], kind and points; `lidar_m` is the height of
    the LiDAR [m], `lean_deg` how far it leans.
    """

    points: np.ndarray
    boxes: np.ndarray
    lidar_m: float
    lean_deg: float
    area: Area


class Targets(NamedTuple):
    """What the network shall say of the output cells of a window.

    `heat` (x, y, 3) is 1 at centres and less about them; `counts` (x, y, 3) is 0 where nothing is learnt of the heat,
    about vehicles that no beam met; `box` (x, y, 8) and `weight` (x, y) are of the box whose centre is near.
    """

    heat: np.ndarray
    counts: np.ndarray
    box: np.ndarray
    weight: np.ndarray


_NEAR = 0.5  # heat from which a cell learns of the box


def targets_of(boxes: np.ndarray, area: Area) -> Targets:
    """The targets of a window; `boxes` as of `Window`, z counted from the fitted ground."""
    along, across = area.along // STRIDE, area.across // STRIDE
    side = STRIDE * PILLAR_M
    heat, counts = np.zeros((along, across, len(KINDS)), np.float32), np.ones((along, across, len(KINDS)), np.float32)
    box, weight = np.zeros((along, across, 8), np.float32), np.zeros((along, across), np.float32)
    for x, y, z, length, width, height, heading, kind, points in boxes:
        centre = (np.array([x, y]) - area.first_m) / side - 0.5  # in output cells, from the middle of the first
        nearest = np.rint(centre).astype(int)
        if (nearest < 0).any() or (nearest >= (along, across)).any():
            continue
        reach = math.ceil(0.5 * length / side) + 1
        low = np.maximum(nearest - reach, 0)
        high = np.minimum(nearest + reach + 1, (along, across))
        at = np.ix_(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        dx, dy = (np.arange(low[k], high[k]) - centre[k] for k in (0, 1))
        dx, dy = dx[:, None], dy[None]
        cos, sin = math.cos(heading), math.sin(heading)
        ahead, left = cos * dx + sin * dy, cos * dy - sin * dx
        spread = np.exp(
            -0.5 * (ahead / max(length / side / 6.0, 0.6)) ** 2 - 0.5 * (left / max(width / side / 4.0, 0.6)) ** 2
        )
        if not points:
            counts[at] = np.minimum(counts[at], (spread < 0.1)[..., None])
            continue
        middle = nearest - low
        spread[tuple(middle)] = 1.0
        kind = int(kind)
        heat[(*at, kind)] = np.maximum(heat[(*at, kind)], spread)
        closer = (spread >= _NEAR) & (spread > weight[at])
        cells = np.nonzero(closer)
        values = np.empty((len(cells[0]), 8), np.float32)
        values[:, 0], values[:, 1] = -(dx + 0.0 * dy)[cells], -(dy + 0.0 * dx)[cells]
        values[:, 2:6] = z, *np.log([length, width, height])
        values[:, 6:] = math.sin(2.0 * heading), math.cos(2.0 * heading)
        box[low[0] + cells[0], low[1] + cells[1]] = values
        weight[low[0] + cells[0], low[1] + cells[1]] = spread[cells]
    counts[heat.max(axis=-1) > 0.3] = 1.0
    return Targets(heat, counts, box, weight)


def shown(window: Window, flip: tuple[bool, bool], most_points: int, rng: np.random.Generator):
    """Pillars and targets of a window, mirrored along x, y or both."""
    sign = np.where(flip, -1.0, 1.0)
    points, boxes, area = window.points.astype(float), window.boxes.copy(), window.area
    points[:, :2] *= sign
    boxes[:, :2] *= sign
    boxes[:, 6] = np.arctan2(sign[1] * np.sin(boxes[:, 6]), sign[0] * np.cos(boxes[:, 6]))
    size = PILLAR_M * np.array([area.along, area.across])
    first = np.where(flip, -(np.array(area.first_m) + size), area.first_m)
    area = Area(tuple(first.tolist()), area.along, area.across)
    ground = fit_ground(points)
    pillars = pillars_of(points, ground, window.lidar_m - ground.level, area)
    if len(pillars.cell) > most_points:
        kept = np.sort(rng.choice(len(pillars.cell), most_points, replace=False))
        pillars = pillars._replace(points=pillars.points[kept], cell=pillars.cell[kept])
    boxes[:, 2] = ground.above(boxes[:, :3])
    return pillars, targets_of(boxes, area)


def batch_of(items: Sequence[tuple[Pillars, Targets]], most_points: int):
    """Frames as one: cells counted through them, points filled up to the same number with some in no cell."""
    along, across = WINDOW
    count, frames = along * across, len(items)
    points = np.zeros((frames * most_points, POINT_FEATURES), np.float32)
    cell = np.full(frames * most_points, frames * count, np.int32)
    at = 0
    for row, (pillars, _) in enumerate(items):
        points[at : at + len(pillars.cell)] = pillars.points
        cell[at : at + len(pillars.cell)] = pillars.cell + row * count
        at += len(pillars.cell)
    cells = np.concatenate([pillars.cells for pillars, _ in items])
    return (points, cell, cells), Targets(
        *(np.stack(one) for one in zip(*(target for _, target in items), strict=True))
    )


# --- Loss and training ------------------------------------------------------------------------------------------------

_RARE = -math.log(99.0)  # logit of the share of cells that are centres: where the heat begins


def fresh_weights(seed: int) -> dict[str, jnp.ndarray]:
    """He's initialisation (2015), the ends of residual blocks smaller; boxes begin as those of a car."""
    rng, found = np.random.default_rng(seed), {}
    for name, shape in shapes().items():
        if name.endswith(".b"):
            found[name] = np.zeros(shape)
            continue
        scale = math.sqrt(2.0 / math.prod(shape[:-1]))
        if name.endswith("b.w"):
            scale *= 0.3
        found[name] = rng.normal(0.0, scale, shape)
    found["out.w"] *= 0.1
    first = found["out.b"]
    first[HEAT], first[LEVEL], first[SIZE], first[TURN] = _RARE, 0.8, np.log([4.5, 2.0, 1.6]), (0.0, 1.0)
    return {name: jnp.asarray(array, jnp.float32) for name, array in found.items()}


def loss_of(weights, shown_frames, targets: Targets):
    """Focal loss of the heat (Law and Deng 2018, CornerNet) and L1 of the boxes, each by vehicle."""
    output = forward(weights, *shown_frames, operations=JaxOperations)
    logit = output[..., HEAT]
    sure, unsure = jax.nn.log_sigmoid(logit), jax.nn.log_sigmoid(-logit)
    share = jnp.exp(sure)
    is_centre = targets.heat >= 0.999
    focal = jnp.where(
        is_centre, -((1.0 - share) ** 2) * sure, -((1.0 - targets.heat) ** 4) * share**2 * unsure * targets.counts
    )
    vehicles = jnp.maximum(is_centre.sum(), 1.0)
    said = jnp.concatenate([output[..., OFFSET], output[..., LEVEL], output[..., SIZE], output[..., TURN]], axis=-1)
    off = jnp.abs(said - targets.box) * jnp.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 0.5, 0.5])
    boxes = (off.sum(axis=-1) * targets.weight).sum() / jnp.maximum(targets.weight.sum(), 1.0)
    return focal.sum() / vehicles + 0.5 * boxes, (focal.sum() / vehicles, boxes)


@partial(jax.jit, donate_argnums=(0, 1, 2))
def train_step(weights, mean, square, step, rate, shown_frames, targets):
    """One step of Adam (Kingma and Ba 2015), its gradient clipped to a norm of 5."""
    (_, parts), gradient = jax.value_and_grad(loss_of, has_aux=True)(weights, shown_frames, targets)
    norm = jnp.sqrt(sum((one**2).sum() for one in gradient.values()))
    scale = jnp.minimum(1.0, 5.0 / (norm + 1e-12))
    moved, means, squares = {}, {}, {}
    for name, one in gradient.items():
        means[name] = 0.9 * mean[name] + 0.1 * scale * one
        squares[name] = 0.99 * square[name] + 0.01 * (scale * one) ** 2
        along = means[name] / (1.0 - 0.9**step)
        moved[name] = weights[name] - rate * along / (jnp.sqrt(squares[name] / (1.0 - 0.99**step)) + 1e-8)
    return moved, means, squares, parts


def rate_at(step: int, steps: int) -> float:
    """Step size: a linear warm-up, then half a cosine."""
    if step <= WARM_UP:
        return HIGHEST_RATE * step / WARM_UP
    done = (step - WARM_UP) / max(steps - WARM_UP, 1)
    return LAST_RATE + 0.5 * (HIGHEST_RATE - LAST_RATE) * (1.0 + math.cos(math.pi * done))
