"""Sensors that differ from the one in the scene: other units of it, noise, lost returns, azimuths."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from ..sensors.beams import beam_lattice
from ..study.site import Site, lattice_of
from ..study.variation import Variation
from .variations import SENSOR

SPREADS_DEG = (0.03, 0.1)
NOISES_M = (0.02, 0.05)
DROPOUTS = (0.1, 0.3)
GLASS_DROPOUTS = (0.5, 1.0)  # the first is drawn, the second loses them all
WEAK_RETURNS_M = (60.0, 30.0)
PHASES = (1.0 / 3.0, 2.0 / 3.0)  # of a step between columns


def sensor_variations(site: Site, draws: int) -> list[Variation]:
    """Each imperfection alone, what is drawn `draws` times over; phase and step of the azimuths."""
    numbers = range(1, draws + 1)
    drawn = (
        ("unit-to-unit spread", "unit_spread_deg", {f"{value:g} deg": value for value in SPREADS_DEG}, "unit"),
        ("range noise", "range_noise_m", {f"{value:g} m": value for value in NOISES_M}, "noise_seed"),
        ("drop-out", "dropout", {f"{value:g}": value for value in DROPOUTS}, "noise_seed"),
        ("glass drop-out", "glass_dropout", {f"{GLASS_DROPOUTS[0]:g}": GLASS_DROPOUTS[0]}, "noise_seed"),
    )
    found = [
        Variation(SENSOR, what, text, partial(_with_sensor, settings={key: value, seed: number}), number)
        for what, key, values, seed in drawn
        for text, value in values.items()
        for number in numbers
    ]
    fixed = (
        ("glass drop-out", "glass_dropout", {f"{GLASS_DROPOUTS[1]:g}": GLASS_DROPOUTS[1]}),
        ("10 % target seen", "range_at_10_percent_m", {f"to {value:g} m": value for value in WEAK_RETURNS_M}),
        ("rotation rate", "rotation_hz", {f"{rate:g} Hz": rate for rate in _other_rates(site)}),
    )
    found += [
        Variation(SENSOR, what, text, partial(_with_sensor, settings={key: value}))
        for what, key, values in fixed
        for text, value in values.items()
    ]
    return found + [
        Variation(SENSOR, "azimuth phase", f"{share:.2f} of a step", partial(_turned, share=share)) for share in PHASES
    ]


def _other_rates(site: Site) -> list[float]:
    return [rate for rate in site.model.rotation_hz if rate != site.observation.lattice.rotation_hz]


def _with_sensor(site: Site, settings: dict[str, float]) -> Site:
    """The site with other keys of [sensor]."""
    sensor = replace(site.scenario.sensor, **settings)
    lattice = lattice_of(sensor)
    observation = replace(site.observation, lattice=lattice, imperfections=sensor.imperfections)
    return replace(site, model=lattice.model, observation=observation)


def _turned(site: Site, share: float) -> Site:
    """The site with its sensor's columns shifted by a share of their step."""
    old = site.observation.lattice
    lattice = beam_lattice(site.model, old.rotation_hz, phase_rad=share * old.step_rad)
    return replace(site, observation=replace(site.observation, lattice=lattice))
