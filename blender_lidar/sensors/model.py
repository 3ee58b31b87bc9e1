"""The LiDAR models: which beams each fires, when, how far and how precisely; one unit of a model, or its even twin."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InputError, unknown_name
from ..names import SENSOR_SUFFIXES
from .files import Datasheet, rates_with, read_sensor_file

DATA_FOLDER = Path(__file__).parent / "data"
_MAKERS = ("robosense", "hesai", "ouster", "velodyne")


@dataclass(frozen=True, slots=True, eq=False)
class LidarModel(Datasheet):
    """One rotating LiDAR. All arrays are (r,) float64, read-only, in ring order: ring 0 is the lowest beam.

    The beams start at one point, the optical centre: the few centimetres between it and a real sensor's lens are left
    out, and so is the turning of the head within one firing column (less than one azimuth step).

    Attributes
    ----------
    elevation_rad : ndarray, (r,)
        Angle above the sensor's horizontal plane [rad], rising with the ring.
    azimuth_offset_rad : ndarray, (r,)
        Azimuth from that of the firing column [rad], positive clockwise seen from above.
    fire_time_s : ndarray, (r,)
        Firing time after the start of the column [s]; NaN where no source gives it.
    name, rotation_hz, range_max_m, ...
        Those of `Datasheet`, in its units.
    """

    elevation_rad: np.ndarray
    azimuth_offset_rad: np.ndarray
    fire_time_s: np.ndarray

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
        columns = f" with {self.default_columns} columns" if self.default_columns else ""
        raise InputError(f"{self.name} does not turn at {rotation_hz} Hz{columns}; allowed: {allowed}")

    def columns(self, rotation_hz: float | None = None) -> int:
        """Firing columns in one turn: ``round(T_rev / T_block)``, or as many as the sensor is set to.

        Raises
        ------
        InputError
            The sensor does not have that rate.
        """
        rate = self.rotation_rate(rotation_hz)
        return self.default_columns or round(1.0 / (rate * (self.block_time_us * 1e-6)))

    @property
    def assumptions(self) -> dict[str, str]:
        """What is assumed where a user's own file does not say, in words, by the key that would say it."""
        rate, columns = self.default_rotation_hz, self.columns()
        words = {
            "rotation_hz": f"{rate:g} turns a second",
            "block_time_us": f"a column every {self.block_time_us:g} us, {columns} a turn at {rate:g} Hz",
            "range_min_m": f"it sees from {self.range_min_m:g} m",
            "range_max_m": f"it sees to {self.range_max_m:g} m",
            "range_noise_m": f"range noise {self.range_noise_m:g} m where asked for",
            "azimuth_offset_deg": "every beam looks along its column",
            "fire_offset_us": "all beams of a column fire at once",
        }
        return {key: words[key] for key in self.assumed}


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
        perhaps ``azimuth_offset_deg, fire_offset_us``. What a file leaves out is taken as in `files.Datasheet`:
        10 Hz, 55.55 us, 0.4 to 200 m, noise 0.02 m; `LidarModel.assumptions` says which of these were.

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
        if path.suffix.lower() not in SENSOR_SUFFIXES and path.name == name_or_path:
            names = [name for model in _shipped() for name in (model.name, *model.aliases)]
            alike = [name for name in names if _family(name) == _family(name_or_path)]
            unknown = unknown_name(name_or_path, names, "sensor", alike=alike)
            raise InputError(f"{unknown}, or the path of a sensor file: {', '.join(SENSOR_SUFFIXES)}")
    return _model(Path(name_or_path))


@functools.cache
def _shipped() -> tuple[LidarModel, ...]:
    return tuple(_model(path) for path in sorted(DATA_FOLDER.glob("*.toml")))


def _plain(name: str) -> str:
    plain = "".join(letter for letter in name.casefold() if letter not in "-_ ")
    return next((plain.removeprefix(maker) for maker in _MAKERS if plain.startswith(maker)), plain)


def _family(name: str) -> str:
    """What a name begins with, two letters or more: only names of one family are mistaken for one another."""
    letters = re.match("[a-z]*", _plain(name))[0]
    return next((family for family in ("pandar", "rs", "os") if letters.startswith(family)), letters)


def _model(path: Path) -> LidarModel:
    settings, beams = read_sensor_file(path)
    _, elevation_deg, azimuth_offset_deg, fire_offset_us = beams.T
    model = LidarModel(
        **settings,
        elevation_rad=_frozen(np.radians(elevation_deg)),
        azimuth_offset_rad=_frozen(np.radians(azimuth_offset_deg)),
        fire_time_s=_frozen(fire_offset_us * 1e-6),
    )
    return with_columns(model, model.default_columns)


def with_columns(model: LidarModel, columns: int | None) -> LidarModel:
    """A model set to a number of columns a turn, and to the rotation rates at which it fires so many.

    Parameters
    ----------
    model : LidarModel
        The sensor.
    columns : int or None
        One of its `columns_a_turn`; with None the model itself is returned.

    Raises
    ------
    InputError
        The sensor cannot be set to so many.
    """
    if columns is None:
        return model
    if columns not in model.columns_a_turn:
        allowed = ", ".join(map(str, model.columns_a_turn)) or f"what rate and block time make, {model.columns()}"
        raise InputError(f"{model.name} cannot be set to {columns} columns a turn; allowed: {allowed}")
    rates = rates_with(columns, model.rotation_hz, model.block_time_us)
    default = model.default_rotation_hz if model.default_rotation_hz in rates else rates[0]
    return replace(model, default_columns=columns, rotation_hz=rates, default_rotation_hz=default)


def _frozen(values: np.ndarray) -> np.ndarray:
    values.setflags(write=False)
    return values


def unit_of(model: LidarModel, spread_deg: float, unit: int) -> LidarModel:
    """A model as one of its units, as made: every ring's elevation and azimuth offset with a normal error of its own.

    Elevations of real units differ from nominal by about 0.03 degree: those of four RS-LiDAR-16 by 0.031 (standard
    deviation), of three RS-LiDAR-32 by 0.015 to 0.029 (their calibrations, in ros_rslidar and other drivers).

    Where beams of this unit lie in another order than the model's, its rings are numbered again from its lowest beam
    up, as the maker's driver does from a unit's calibration (rs_driver, ``ChanAngles::genUserChan``). Refusing such
    units would leave out what must be common: errors of 0.03 degree swap neighbours of the RS-80's ladder of 0.1 degree
    in three units out of ten, and in six out of ten of the RS-Ruby-128.

    Parameters
    ----------
    model : LidarModel
        The nominal sensor.
    spread_deg : float
        Standard deviation of both errors [degrees], 0 or more; at 0 the model itself is returned.
    unit : int
        Which unit, 0 or more. The same unit draws the same errors, in proportion to the spread.

    Raises
    ------
    InputError
        For a unit with a beam beyond the vertical.
    """
    if spread_deg == 0.0:
        return model
    error = np.random.Generator(np.random.PCG64(unit)).standard_normal((2, model.rings))
    elevation, azimuth_offset = (model.elevation_rad, model.azimuth_offset_rad) + math.radians(spread_deg) * error
    steepest = int(np.argmax(np.abs(elevation)))
    if abs(elevation[steepest]) > 0.5 * math.pi:
        raise InputError(
            f"unit {unit} of {model.name} has ring {steepest} at {math.degrees(elevation[steepest]):.2f} degrees with "
            f"a spread of {spread_deg:g}; allowed: a spread that leaves every beam between -90 and 90"
        )
    upwards = np.argsort(elevation, kind="stable")
    return replace(
        model,
        elevation_rad=_frozen(elevation[upwards]),
        azimuth_offset_rad=_frozen(azimuth_offset[upwards]),
        fire_time_s=_frozen(model.fire_time_s[upwards]),
    )
