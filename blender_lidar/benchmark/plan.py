"""What a benchmark does, part by part, and what came of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from ..casting import CASTERS, is_available, resolve
from ..errors import InputError
from ..scenario import load_scenario
from ..stop_signals import stops_recognised
from . import growth, whole
from .case import MOUNTINGS, FrameCase, cases_of, summary_of
from .rivals import rivals_missing, rivals_of, yardsticks_of
from .stages import metric_entry, stage_entries
from .targets import Verdict, verdicts
from .timing import Entry, Timing, in_rounds

STAGES, RIVALS, METRIC, WHOLE, GROWTH, PAPER = "stages", "rivals", "metric", "whole", "growth", "paper"
PARTS = (STAGES, RIVALS, METRIC, WHOLE, GROWTH)
USUAL = (STAGES, RIVALS, METRIC, WHOLE)
_TOO_SLOW = "exact"  # for a frame of this size minutes go by


@dataclass(frozen=True, slots=True)
class Options:
    """What is asked for.

    Attributes
    ----------
    scene : str
        Path of the scene file.
    sensor : str
        A name of `case.MOUNTINGS`.
    detail : str or None
        In place of the scene's.
    frames : int
        How many are timed.
    repeats : int
        Rounds.
    casters : tuple of str
        Those that are timed; empty for all that are here but `exact`.
    parts : tuple of str
        Of `PARTS`, and `PAPER` for the paper's whole optimisations.
    most_frames, most_workers : int
        Where growth ends; 0 workers are as many as there are processors.
    """

    scene: str
    sensor: str = "RS-80"
    detail: str | None = None
    frames: int = 10
    repeats: int = 7
    casters: tuple[str, ...] = ()
    parts: tuple[str, ...] = USUAL
    most_frames: int = 256
    most_workers: int = 0

    @property
    def overrides(self) -> dict:
        """Of the scene."""
        given = {("sensor", "name"): (self.sensor, "--sensor")}
        if self.detail:
            given["world", "detail"] = (self.detail, "--detail")
        return given


@dataclass(slots=True)
class Found:
    """What came of it; what was not asked for, or not come to before it was stopped, is empty."""

    about: dict[str, object] = field(default_factory=dict)
    times: dict[str, Timing] = field(default_factory=dict)
    wholes: dict[str, Timing] = field(default_factory=dict)
    growth: list[growth.Series] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)
    stopped: bool = False

    @property
    def verdicts(self) -> list[Verdict]:
        """On the targets."""
        return verdicts(self.times)


class Told(NamedTuple):
    """Whom to tell how it comes along: what begins and in how many steps, and each step."""

    begins: Callable[[str, int], None] = lambda what, steps: None
    advances: Callable[[], None] = lambda: None


def carry_out(options: Options, told: Told = Told()) -> Found:  # noqa: B008 (it holds nothing)
    """Do all parts that are asked for; when interrupted, return what there is until then.

    Raises
    ------
    BlenderLidarError
        For a scene that cannot be used, a sensor that the paper has no mounting for, a caster that is not here.
    """
    if options.sensor not in MOUNTINGS:
        raise InputError(f"--sensor is {options.sensor!r}; allowed: {', '.join(sorted(MOUNTINGS))}")
    found, casters = Found(), _casters(options)
    for name in CASTERS[:-1]:
        if not is_available(name):
            found.left_out[f"caster {name}"] = "its library is not installed"
    if _TOO_SLOW not in casters:
        found.left_out[f"caster {_TOO_SLOW}"] = f"minutes for a frame; asked for by --caster {_TOO_SLOW}"
    try:
        with stops_recognised():
            _carry_out(options, casters, found, told)
    except KeyboardInterrupt:
        found.stopped = True
    return found


def _carry_out(options: Options, casters: Sequence[str], found: Found, told: Told) -> None:
    if {STAGES, RIVALS, METRIC} & set(options.parts):
        _frame(options, casters, found, told)
    if WHOLE in options.parts:
        few = whole.few_evaluations(options.scene, options.overrides, casters)
        _time([few], "whole optimisations", min(options.repeats, 3), found.wholes, told, warm=False)
    if PAPER in options.parts:
        overrides = {key: value for key, value in options.overrides.items() if key != ("sensor", "name")}
        for entry in whole.paper_evaluations(options.scene, overrides, options.casters or casters[:1], told.advances):
            told.begins(f"the paper's {entry.name}", whole.PAPER_EVALUATIONS)
            in_rounds([[entry]], 1, warm=False, into=found.wholes)
    if GROWTH in options.parts:
        _grow(options, casters, found, told)


def _casters(options: Options) -> tuple[str, ...]:
    if options.casters:
        return tuple(resolve(name, "--caster") for name in dict.fromkeys(options.casters))
    return tuple(name for name in CASTERS if name != _TOO_SLOW and is_available(name))


def _frame(options: Options, casters: Sequence[str], found: Found, told: Told) -> None:
    """Time frames, cast by us and by others, and the metric."""
    frames = [] if options.parts == (METRIC,) else cases_of(_scenario(options), options.frames)
    columns = [_entries(case, casters, options.parts) for case in frames]
    if frames:
        found.about = summary_of(frames)
        _time(columns, "frames", options.repeats, found.times, told)
    if RIVALS in options.parts:
        found.left_out |= rivals_missing()
    if METRIC in options.parts:
        _time([[metric_entry()]], "the metric", options.repeats, found.times, told)


def _scenario(options: Options):
    return load_scenario(options.scene, options.overrides)


def _entries(case: FrameCase, casters: Sequence[str], parts: Sequence[str]) -> list[Entry]:
    rivals = rivals_of(case) if RIVALS in parts else yardsticks_of(case)
    ours = stage_entries(case, casters) if {STAGES, RIVALS} & set(parts) else []
    return ours + [rival.entry for rival in rivals]


def _time(columns, what: str, rounds: int, into: dict[str, Timing], told: Told, warm: bool = True) -> None:
    told.begins(what, rounds)
    in_rounds(columns, rounds, warm=warm, told=told.advances, into=into)


def _grow(options: Options, casters: Sequence[str], found: Found, told: Told) -> None:
    """All series with every caster that is fast enough for it."""
    chosen = options.casters or tuple(name for name in casters if name != "bvh")
    if "bvh" in casters and "bvh" not in chosen:
        found.left_out["growth of bvh"] = "minutes for 256 frames; asked for by --caster bvh"
    basis = {"detail": options.detail or _scenario(options).model.detail, "sensor": options.sensor}
    settings = growth.steps(options.most_frames, options.most_workers or None)
    for caster in chosen:
        for over, values in settings.items():
            told.begins(f"growth over {over}, {caster}", options.repeats * len(values))
            last = slice(len(found.growth), None)

            def keep(series: growth.Series, last: slice = last) -> None:
                found.growth[last] = [series]

            growth.grow(over, values, options.repeats, caster=caster, **basis, told=told.advances, kept=keep)
