"""[sensor] of a scene, and the tables of single models within it."""

from __future__ import annotations

from pathlib import Path

from .errors import InputError, MissingFileError
from .sensors.detection_range import STATED_RANGE_LIMITS_M
from .sensors.imperfections import MOST_RANGE_NOISE_M
from .sensors.model import LidarModel, load_model
from .sensors.unit import MOST_SPREAD_DEG, unit_of
from .settings import SensorSettings, is_sensor_file
from .toml_table import TomlTable

DATASHEET = "datasheet"  # in place of a number: the model's own


def sensor_settings(table: TomlTable, folder: Path) -> SensorSettings:
    """The settings of [sensor]; paths in it start from `folder`.

    Raises
    ------
    MissingFileError, InputError
        Naming the file, the table and the key.
    """
    name = _sensor_name(table.text("name", "RS-16"), Path() if table.overridden("name") else folder)
    model = _model_named(name, table.where("name"))
    settings = _of_any_model(table)
    where = {key: table.where(key) for key in settings}
    for sensor, own in table.tables().items():
        found = _of_any_model(own)
        own.finish()
        if _model_named(_sensor_name(sensor, folder), table.where(sensor)).name == model.name:
            for key in settings:
                if found[key] is not None and not table.overridden(key):
                    settings[key], where[key] = found[key], own.where(key)
    try:
        rate = model.rotation_rate(settings["rotation_hz"])
    except InputError as error:
        raise InputError(f"{where['rotation_hz']}: {error}") from error
    gate = model.range_max_m if settings["range_gate_m"] is None else settings["range_gate_m"]
    if not model.range_min_m < gate <= model.range_max_m:
        raise InputError(
            f"{where['range_gate_m']}: is {gate}; allowed for {model.name}: more than {model.range_min_m:g}, "
            f"at most {model.range_max_m:g}"
        )
    spread_deg, unit = settings["unit_spread_deg"] or 0.0, table.whole("unit", 1, low=0)
    try:
        unit_of(model, spread_deg, unit)
    except InputError as error:
        raise InputError(f"{where['unit_spread_deg']}: {error}") from error
    return SensorSettings(
        name=name if is_sensor_file(name) else model.name,
        rotation_hz=rate,
        range_gate_m=gate,
        range_noise_m=_range_noise(settings["range_noise_m"], model, where["range_noise_m"]),
        dropout=settings["dropout"] or 0.0,
        glass_dropout=settings["glass_dropout"] or 0.0,
        range_at_10_percent_m=_range_at_10_percent(
            settings["range_at_10_percent_m"], model, where["range_at_10_percent_m"]
        ),
        unit_spread_deg=spread_deg,
        unit=unit,
        noise_seed=table.whole("noise_seed", 1, low=0),
    )


def _of_any_model(table: TomlTable) -> dict:
    """The keys that [sensor] holds for all models and a table within it for one; None where left out."""
    return {
        "rotation_hz": table.number("rotation_hz", None, above=0.0),
        "range_gate_m": table.number("range_gate_m", None, above=0.0),
        "range_noise_m": table.number_or_text("range_noise_m", None, DATASHEET, low=0.0, high=MOST_RANGE_NOISE_M),
        "dropout": table.number("dropout", None, low=0.0, below=1.0),
        "glass_dropout": table.number("glass_dropout", None, low=0.0, high=1.0),
        "range_at_10_percent_m": table.number_or_text(
            "range_at_10_percent_m", None, DATASHEET, low=STATED_RANGE_LIMITS_M[0], high=STATED_RANGE_LIMITS_M[1]
        ),
        "unit_spread_deg": table.number("unit_spread_deg", None, low=0.0, high=MOST_SPREAD_DEG),
    }


def _range_noise(given: float | str | None, model: LidarModel, where: str) -> float:
    noise = model.range_noise_m if given == DATASHEET else given or 0.0
    if noise > MOST_RANGE_NOISE_M:
        raise InputError(f"{where}: {model.name} has {noise:g}; allowed: at most {MOST_RANGE_NOISE_M:g}")
    return noise


def _range_at_10_percent(given: float | str | None, model: LidarModel, where: str) -> float | None:
    if given == DATASHEET and model.range_at_10_percent_m is None:
        raise InputError(f"{where}: no source gives that of {model.name}; allowed: a number")
    return model.range_at_10_percent_m if given == DATASHEET else given


def _sensor_name(name: str, folder: Path) -> str:
    """A sensor's name as it is, the path of a beam table from `folder` on."""
    return str(folder / name) if is_sensor_file(name) else name


def _model_named(name: str, where: str) -> LidarModel:
    try:
        return load_model(name)
    except MissingFileError as error:
        raise MissingFileError(f"{where}: {error}") from error
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
