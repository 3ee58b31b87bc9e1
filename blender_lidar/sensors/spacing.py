"""Sensors that nobody builds: a model's beams, spaced otherwise, to tell what their spacing does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .model import LidarModel


def evenly_spaced(model: LidarModel) -> LidarModel:
    """The same sensor with its elevations spread evenly between its lowest and its highest beam.

    Number of rings, field of view, azimuths, firing times and ranges stay.
    """
    elevation = np.linspace(model.elevation_rad[0], model.elevation_rad[-1], model.rings)
    elevation.setflags(write=False)
    return replace(
        model,
        name=f"{model.name} evenly spaced",
        description=f"{model.name} with its {model.rings} beams spread evenly over its field of view",
        source=f"made from the table of {model.name}",
        confidence="none: there is no such sensor",
        aliases=(),
        elevation_rad=elevation,
    )
