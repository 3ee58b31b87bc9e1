"""The study that asks whether metrics choose mountings that serve a detector: its arithmetic and its kept files."""

from __future__ import annotations

import importlib
import json

import numpy as np
import pytest

import tests.research  # noqa: F401
from blender_lidar.detection.scores import CRITERIA, Matches, average_precision, recall
from blender_lidar.metrics.catalogue import METRICS, PE_VGOP, VIEW_COVERAGE
from tests.traffic_samples import KITTI  # noqa: F401


@pytest.fixture(scope="module")
def study():
    pytest.importorskip("scipy")
    return importlib.import_module("detector_decision")
