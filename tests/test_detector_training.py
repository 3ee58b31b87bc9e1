"""The training of the shipped detector: its operations in JAX, its targets, its loss, and going on after a stop."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

jnp = pytest.importorskip("jax.numpy", reason="JAX, of the extra detect, is not installed")

import tests.research  # noqa: F401
from blender_lidar.detection.pillar_network import forward, shapes
from blender_lidar.detection.pillars import SHIPPED, Area, boxes_of, load_weights
from blender_lidar.traffic.boxes import bev_iou, boxes_of_rows
from blender_lidar.world.meshes import REFLECTIVITY
from pillar_training import (
    WINDOW,
    JaxOperations,
    Window,
    batch_of,
    fresh_weights,
    loss_of,
    segment_maxima,
    shown,
    targets_of,
)
from train_detector import CROSSING, SITES, TWO_WAY, site_windows, train

AREA = Area((-51.2, -9.6), *WINDOW)
CARS = np.array([(-20.0, 5.0), (-11.3, 8.7), (0.3, 5.1), (17.9, 12.2), (33.3, 16.0)])


def window(seed=1):
    """Cars, a lorry and a motorcycle as scattered points on their boxes, on a plane of ground."""
    rng = np.random.default_rng(seed)
    boxes = [(x, y, 0.75, 4.4, 1.8, 1.5, 0.02, 0, 40) for x, y in CARS]
    boxes += [(-35.0, 16.0, 1.9, 14.0, 2.5, 3.8, 3.13, 1, 40), (8.0, 9.0, 0.7, 2.1, 0.8, 1.4, -0.03, 2, 40)]
    boxes = np.array(boxes)
    on = [box[:3] + rng.uniform(-0.5, 0.5, (40, 3)) * box[3:6] for box in boxes]
    ground = np.column_stack([rng.uniform(-51.0, 51.0, 3000), rng.uniform(-9.0, 28.0, 3000), np.zeros(3000)])
    return Window(np.concatenate([*on, ground]).astype(np.float32), boxes, 4.5, 20.0, AREA)


@pytest.mark.parametrize("flip", [(False, False), (True, False), (False, True), (True, True)])
def test_boxes_that_are_told_are_boxes_that_are_read(flip):
    message = shown(window(), flip, 4096, np.random.default_rng(0))[1]
    heat = np.where(message.heat > 0.0, np.log(np.clip(message.heat, 1e-6, 1.0 - 1e-6)), -20.0)
    heat -= np.log1p(-np.clip(message.heat, 0.0, 1.0 - 1e-6))
    area = Area((-51.2, -28.8) if flip[1] else AREA.first_m, *WINDOW)
    found = boxes_of(np.concatenate([heat, message.box], axis=-1), area)
    rows = window().boxes
    truth = boxes_of_rows([(*row[:7], row[7], 1.0) for row in rows])
    sign = np.where(flip, -1.0, 1.0)
    truth.centre_m[:, :2] *= sign
    truth.heading_rad[:] = np.arctan2(sign[1] * np.sin(truth.heading_rad), sign[0] * np.cos(truth.heading_rad))
    overlap = bev_iou(truth, found)
    assert len(found) == len(truth)
    assert overlap.max(axis=1).min() > 0.999
    best = overlap.argmax(axis=1)
    np.testing.assert_allclose(found.size_m[best], truth.size_m, rtol=1e-5)
    np.testing.assert_allclose(found.centre_m[best, 2], truth.centre_m[:, 2], atol=0.01)
    assert found.kind[best].tolist() == truth.kind.tolist()


def test_nothing_is_learnt_about_vehicles_that_no_beam_met():
    boxes = window().boxes
    boxes[2, 8] = 0
    message = targets_of(boxes, AREA)
    at = tuple(np.floor((boxes[2, :2] - AREA.first_m) / 0.8).astype(int))
    assert not message.counts[at].any()
    assert not message.weight[at]
    assert message.heat.max(axis=-1)[at] == 0.0
    assert (message.heat == 1.0).sum() == len(boxes) - 1


def test_jax_finds_the_maxima_and_gives_gradients_to_the_points_that_have_them():
    import jax

    values, cell = jnp.array([[1.0], [3.0], [-2.0], [5.0]]), jnp.array([0, 0, 1, 3])
    assert segment_maxima(values, cell, 3).tolist() == [[3.0], [0.0], [0.0]]  # the last lies in no cell
    gradient = jax.grad(lambda v: (segment_maxima(v, cell, 3) * jnp.array([[2.0], [7.0], [1.0]])).sum())(values)
    assert gradient.tolist() == [[0.0], [2.0], [0.0], [0.0]]


@pytest.mark.parametrize("seed", [1, 2])
def test_inference_in_numpy_is_that_of_jax(seed):
    weights, _ = load_weights(SHIPPED)
    pillars = shown(window(seed), (False, False), 4096, np.random.default_rng(0))[0]
    ours = forward(weights, *pillars)
    theirs = forward(
        {name: jnp.asarray(array) for name, array in weights.items()},
        *map(jnp.asarray, (pillars.points, pillars.cell.astype(np.int32), pillars.cells)),
        operations=JaxOperations,
    )
    assert np.abs(ours - np.asarray(theirs)).max() < 1e-4
    assert np.abs(ours).max() > 1.0


def test_a_batch_of_windows_is_each_of_them():
    items = [shown(window(seed), (False, False), 512, np.random.default_rng(0)) for seed in (1, 2)]
    (points, cell, cells), targets = batch_of(items, 512)
    weights = fresh_weights(3)
    whole = forward(weights, points, cell, cells, operations=JaxOperations)
    for row, (pillars, _) in enumerate(items):
        one = forward({name: np.asarray(array) for name, array in weights.items()}, *pillars)
        np.testing.assert_allclose(whole[row], one[0], atol=1e-4)
    total, _ = loss_of(weights, (points, cell, cells), targets)
    assert np.isfinite(float(total))


def test_training_learns_and_goes_on_after_a_stop_as_if_there_had_been_none(tmp_path, monkeypatch):
    monkeypatch.setattr("train_detector.CHECKPOINT_S", -1.0)
    monkeypatch.setattr("train_detector.BATCH", 2)
    monkeypatch.setattr("train_detector.MOST_POINTS", {"RS-16": 512})
    windows = {"RS-16": [window(seed) for seed in range(2)]}
    message = []

    def advance(steps, note=""):
        message.append(note)

    class Stop(Exception):
        pass

    whole = train(windows, 5, 4, tmp_path / "whole.npz", advance)

    def stop_after_two(*given, calls=[0]):  # noqa: B006
        calls[0] += 1
        if calls[0] > 2:
            raise Stop
        return batch_of(*given)

    monkeypatch.setattr("train_detector.batch_of", stop_after_two)
    with pytest.raises(Stop):
        train(windows, 5, 4, tmp_path / "stopped.npz", advance)
    monkeypatch.setattr("train_detector.batch_of", batch_of)
    resumed = train(windows, 5, 4, tmp_path / "stopped.npz", advance)
    for name in shapes():
        np.testing.assert_array_equal(resumed[name], whole[name])
    frames = batch_of([shown(one, (False, False), 512, np.random.default_rng(0)) for one in windows["RS-16"]], 512)
    losses = [float(loss_of(weights, *frames)[0]) for weights in (fresh_weights(5), whole)]
    assert losses[1] < losses[0]


SCENES = Path(__file__).parents[1] / "scenes"


def test_a_site_is_a_crossing_where_vehicles_head_anywhere_and_who_walks_is_no_box(tmp_path):
    pytest.importorskip("sumolib", reason="sumolib, of the extra maps, is not installed")
    traffic, crossings = [str(SCENES / "i80_sample.csv.gz")], [str(SCENES / "crossing_sample.xml.gz")]
    number, table = SITES.index(CROSSING), tmp_path / "two_way.csv"
    road = list(site_windows("RS-16", 0, traffic, crossings, 3, table))
    crossing = list(site_windows("RS-16", number, traffic, crossings, 8, table))
    assert [len(road), len(crossing)] == [3, 8]
    off = [np.abs(np.sin(np.concatenate([one.boxes[:, 6] for one in windows]))) for windows in (road, crossing)]
    assert off[0].max() < np.sin(np.radians(15.0))
    assert (off[1] > np.sin(np.radians(15.0))).mean() > 0.5
    within, astray = [], []
    for one in crossing:
        first, size = np.array(one.area.first_m), 0.4 * np.array(WINDOW)
        assert ((one.points[:, :2] >= first) & (one.points[:, :2] < first + size)).all()
        assert {*one.boxes[:, 7].astype(int).tolist()} <= {0, 1, 2}
        assert one.boxes[:, 4].min() > 0.64  # metres of width: a bicycle's at least, a pedestrian has 0.6
        for turned, found in ((1.0, within), (-1.0, astray)):  # its points are where it is, turned as it is
            for box in one.boxes[one.boxes[:, 8] > 20]:
                cos, sin = np.cos(box[6]), turned * np.sin(box[6])
                along = (one.points[:, :2] - turned * box[:2]) @ np.array([[cos, -sin], [sin, cos]])
                held = (np.abs(along) < 0.5 * box[3:5] + 0.3).all(axis=1)
                found.append((held.sum(), box[8] if (np.abs(box[:2] - first - 0.5 * size) < 0.5 * size).all() else 0.0))
    share = [np.array(found)[:, 0].sum() / np.array(found)[:, 1].sum() for found in (within, astray)]
    assert share[0] > 0.8
    assert share[1] < 0.3 * share[0]
    straight = list(site_windows("RS-16", number, traffic, [], 2, table))
    assert max(np.abs(np.sin(one.boxes[:, 6])).max() for one in straight) < np.sin(np.radians(15.0))


def test_a_site_in_a_median_has_traffic_both_ways_on_either_side_of_the_lidar(tmp_path):
    traffic = [str(SCENES / "i80_sample.csv.gz")]
    before, found = REFLECTIVITY.copy(), 0
    for one in site_windows("RS-16", SITES.index(TWO_WAY), traffic, [], 6, tmp_path / "two_way.csv"):
        near = one.boxes[np.abs(one.boxes[:, 1]) < 25.0]
        ahead, left = np.cos(near[:, 6]), near[:, 1] > 0.0
        assert np.abs(ahead).min() > np.cos(np.radians(15.0))
        assert len({*np.sign(ahead[left])}) == len({*np.sign(ahead[~left])}) == 1
        found += (ahead[left] * ahead[~left][0] < 0.0).all()
    assert found == 6
    np.testing.assert_array_equal(REFLECTIVITY, before)
