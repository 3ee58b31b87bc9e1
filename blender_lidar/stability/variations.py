"""What sorts of things the study of stability changes about a scene."""

from __future__ import annotations

TRAFFIC, MOUNTING, METRIC, SENSOR, SEARCH, CASTERS = "traffic", "mounting", "metric", "sensor", "search", "casters"
SECTIONS = (TRAFFIC, MOUNTING, METRIC, SENSOR, SEARCH, CASTERS)
