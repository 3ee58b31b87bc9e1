"""The worlds in which detectors are trained and judged: clean, hard enough that they can fail, and at a crossing."""

from __future__ import annotations

from blender_lidar.names import CLASSES

Options = dict[tuple[str, str], tuple[object, str]]


def hard_world() -> Options:
    """Clutter, vehicles that differ, a road that is not flat, noise, lost returns, a mounting known only nearly.

    In the place of a scene's settings, as `scene.scenario.load_scenario` takes them.
    """
    settings = {
        ("world", "clutter"): 1.0,
        ("world", "variety"): 1.0,
        ("world", "variety_seed"): 1000,  # no site of the training has it
        ("road", "grade_percent"): 1.0,
        ("road", "cross_fall_percent"): 1.0,
        ("road", "crown_percent"): 2.0,
        ("sensor", "range_noise_m"): "datasheet",
        ("sensor", "dropout"): 0.02,
        ("sensor", "glass_dropout"): 0.5,
        ("sensor", "range_at_10_percent_m"): "datasheet",
        ("objective", "tolerance"): {"height_m": 0.05, "tilt_deg": 1.0},
    }
    return {place: (value, place[1]) for place, value in settings.items()}


def crossing_world() -> Options:
    """The hard world at an intersection on its map, where people walk; maps have neither clutter nor slopes.

    Candidate poles have no tolerance; whoever takes one of them gives it that of the hard world.
    """
    left_out = ("road", "objective")
    kept = {place: given for place, given in hard_world().items() if place[0] not in left_out and place[1] != "clutter"}
    return kept | {("objective", "classes"): (CLASSES, "classes")}
