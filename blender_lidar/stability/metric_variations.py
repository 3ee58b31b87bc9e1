"""The score with other constants, and other scores."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ..metrics.catalogue import METRICS
from ..optimise import VIEWS
from ..study.scoring import scene_field
from ..study.site import Site
from ..study.variation import Variation
from .variations import METRIC

CELLS_M = (0.025, 0.05, 0.1, 0.2)
THRESHOLDS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
LOSSES = (0.0, 0.5, 1.0, 2.0, 4.0)  # abs(C), in the metric's unit


def metric_variations(site: Site) -> list[Variation]:
    """Cell size, view, delta and C of the scene's objective, and every other metric in its place.

    Without a C the objective asks for neither view nor delta.
    """
    scoring, cell_m = site.scoring, site.observation.cell_m
    found = [
        Variation(METRIC, "cell size", f"{100 * value:g} cm", partial(_with_cells, cell_m=value))
        for value in CELLS_M
        if value != cell_m
    ]
    settings = []
    if scoring.loss is not None:
        settings = [
            ("view of Eq. 11", "view", {view: view for view in VIEWS}, scoring.view),
            ("delta of Eq. 11", "threshold", {f"{value:g}": value for value in THRESHOLDS}, scoring.threshold),
            ("abs(C) of Eq. 10", "loss", {f"{value:g}": -value for value in LOSSES}, -abs(scoring.loss)),
        ]
    for what, key, values, now in settings:
        found += [
            Variation(METRIC, what, text, partial(_with_scoring, key=key, value=value))
            for text, value in values.items()
            if value != now
        ]
    return found + [
        Variation(METRIC, "other metric", name, partial(_with_metric, name=name))
        for name in METRICS
        if name != scoring.metric
    ]


def _with_cells(site: Site, cell_m: float) -> Site:
    return replace(site, observation=replace(site.observation, cell_m=cell_m))


def _with_scoring(site: Site, key: str, value: object) -> Site:
    return replace(site, scoring=replace(site.scoring, **{key: value}))


def _with_metric(site: Site, name: str) -> Site:
    """The site with another metric and, as a scene has it that says nothing else, no loss for a missed vehicle."""
    scenario = site.scenario
    centre, radius_m = scenario.deployment.nominal_xy, scenario.sensor.range_gate_m
    field = scene_field(name, scenario.road, centre, radius_m, site.search)
    return replace(site, scoring=replace(site.scoring, metric=name, loss=None, field=field))
