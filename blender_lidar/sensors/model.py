"""The LiDAR models: which beams each fires, when, how far and how precisely."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError, unknown_name
from .files import SUFFIXES, SensorFile, read_sensor_file

DATA_FOLDER = Path(__file__).parent / "data"


@dataclass(frozen=True, slots=True, eq=False)
class LidarModel:
    """One rotating LiDAR. All arrays are (r,) float64, read-only, in ring order: ring 0 is the lowest beam.

    The beams start at one point, the optical centre: the few centimetres between it and a real sensor's lens are left
    out, and so is the turning of the head within one firing column (less than one azimuth step).

    Attributes
    ----------
    name, description, source, confidence : str
        What it is, where the numbers come from, and how far to trust them.
    aliases : tuple of str
        Other names that `load_model` takes.
    elevation_rad : ndarray, (r,)
        Angle above the sensor's horizontal plane [rad], rising with the ring.
    azimuth_offset_rad : ndarray, (r,)
        Azimuth from that of the firing column [rad], positive clockwise seen from above.
    fire_time_s : ndarray, (r,)
        Firing time after the start of the column [s]; NaN where no source gives it.
    rotation_hz : tuple of float
        Rotation rates the sensor has [Hz].
    default_rotation_hz : float
        The rate used when none is asked for [Hz].
    block_time_s : float
        Time between firing columns [s].
    range_min_m, range_max_m : float
        Distances that the sensor reports [m].
    range_noise_m : float
        Standard deviation of a measured range [m].
    range_at_10_percent_m : float or None
        Farthest range at which it sees a target of 10 % reflectivity [m]; None where no source gives it.
    """

    name: str
    description: str
    source: str
    confidence: str
    aliases: tuple[str, ...]
    elevation_rad: np.ndarray
    azimuth_offset_rad: np.ndarray
    fire_time_s: np.ndarray
    rotation_hz: tuple[float, ...]
    default_rotation_hz: float
    block_time_s: float
    range_min_m: float
    range_max_m: float
    range_noise_m: float
    range_at_10_percent_m: float | None = None

    @property
    def rings(self) -> int:
        """Number of beams in one firing column."""
        return len(self.elevation_rad)

    def rotation_rate(self, rotation_hz: float | None = None) -> float:
        """`rotation_hz` if the sensor has that rate, its default if None [Hz].

        Raises
        ------
        InputError
            The sensor does not have that rate.
        """
        if rotation_hz is None:
            return self.default_rotation_hz
        for rate in self.rotation_hz:
            if math.isclose(rate, rotation_hz):
                return rate
        allowed = ", ".join(f"{rate:g}" for rate in self.rotation_hz)
        raise InputError(f"{self.name} does not turn at {rotation_hz} Hz; allowed: {allowed}")

    def columns(self, rotation_hz: float | None = None) -> int:
        """Firing columns in one turn: ``round(T_rev / T_block)``.

        Raises
        ------
        InputError
            The sensor does not have that rate.
        """
        return round(1.0 / (self.rotation_rate(rotation_hz) * self.block_time_s))


def model_names() -> list[str]:
    """Names of the models that come with the package, without their aliases."""
    return [model.name for model in _shipped()]


def load_model(name_or_path: str | Path) -> LidarModel:
    """One of the package's models by name or alias, or a user's own from a file.

    Parameters
    ----------
    name_or_path : str or Path
        A name from `model_names` or an alias (capitals, hyphens, underscores and spaces do not matter), or the path of
        a TOML file laid out as those in ``sensors/data``, or of a CSV file with columns ``ring, elevation_deg`` and
        perhaps ``azimuth_offset_deg, fire_offset_us``. What a file leaves out is taken as in `files.SensorFile`:
        10 Hz, 55.55 us, 0.4 to 200 m, noise 0.02 m.

    Raises
    ------
    MissingFileError
        A path at which there is no file.
    InputError
        An unknown name, or a file that cannot be used.
    """
    if isinstance(name_or_path, str):
        for model in _shipped():
            if _plain(name_or_path) in map(_plain, (model.name, *model.aliases)):
                return model
        path = Path(name_or_path)
        if path.suffix.lower() not in SUFFIXES and path.name == name_or_path:
            names = [name for model in _shipped() for name in (model.name, *model.aliases)]
            raise InputError(f"{unknown_name(name_or_path, names, 'sensor')}, or the path of a .toml or .csv file")
    return _model(read_sensor_file(Path(name_or_path)))


@functools.cache
def _shipped() -> tuple[LidarModel, ...]:
    return tuple(_model(read_sensor_file(path)) for path in sorted(DATA_FOLDER.glob("*.toml")))


def _plain(name: str) -> str:
    return "".join(letter for letter in name.casefold() if letter not in "-_ ")


def _model(file: SensorFile) -> LidarModel:
    _, elevation_deg, azimuth_offset_deg, fire_offset_us = file.beams.T
    return LidarModel(
        name=file.name,
        description=file.description,
        source=file.source,
        confidence=file.confidence,
        aliases=file.aliases,
        elevation_rad=_frozen(np.radians(elevation_deg)),
        azimuth_offset_rad=_frozen(np.radians(azimuth_offset_deg)),
        fire_time_s=_frozen(fire_offset_us * 1e-6),
        rotation_hz=file.rotation_hz,
        default_rotation_hz=file.default_rotation_hz,
        block_time_s=file.block_time_us * 1e-6,
        range_min_m=file.range_min_m,
        range_max_m=file.range_max_m,
        range_noise_m=file.range_noise_m,
        range_at_10_percent_m=file.range_at_10_percent_m,
    )


def _frozen(values: np.ndarray) -> np.ndarray:
    values.setflags(write=False)
    return values
