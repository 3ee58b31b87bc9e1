"""The mountings of a run side by side, as rows: the command line prints them, the page sets them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ..metrics.catalogue import metric_named
from ..metrics.metric import Metric
from ..study.tolerance_text import aim_text, tolerance_text
from .summary import COORDINATE_NAMES, mounting_name, sharp_of, was_searched

_ALWAYS_SHOWN = ("height_m", "tilt_x_deg")


@dataclass(frozen=True, slots=True)
class Section:
    """Rows of a comparison under one heading: what, then a text for each of `compared_names`, "" where it has none."""

    heading: str
    rows: list[tuple[str, ...]]


def compared_names(result: Mapping) -> tuple[str, ...]:
    """What the mountings of a run are called: the baseline, the sharp one where there is one, the run's own."""
    return ("baseline", *(("sharp",) if sharp_of(result) else ()), mounting_name(result))


def comparison_sections(result: Mapping) -> list[Section]:
    """The mountings of a run side by side; `result` is the content of result.json."""
    sharp, metric = sharp_of(result), metric_named(result["metric"])
    compared = [result["baseline"], *([sharp] if sharp else []), result]
    mounts = [scores["deployment"] for scores in compared]
    total = (metric.in_unit("objective"), *(metric.number(scores["objective"], -2) for scores in compared))
    sections = [
        Section(
            "Mounting",
            [
                (f"{name} [{unit}]", *(f"{mount[key]:.2f}" for mount in mounts))
                for key, (name, unit) in COORDINATE_NAMES.items()
                if key in _ALWAYS_SHOWN or any(mount[key] for mount in mounts)
            ],
        ),
        Section(
            "Searched frames" if was_searched(result) else "Scored frames", [total, *_score_rows(metric, compared)]
        ),
    ]
    if result["holdout"]:
        held = [scores["holdout"] for scores in compared]
        interval = f"90 % interval, {result['holdout']['blocks']} blocks"
        rows = [*_score_rows(metric, held), *_gain_rows(metric, held, interval)]
        sections.append(Section("Held-out frames", rows))
    return sections + _sections_over_tolerance(result)


def _sections_over_tolerance(result: Mapping) -> list[Section]:
    """The same scores where every mounting may be off by the tolerance; none where the run had none."""
    if result.get("tolerance") is None:
        return []
    block, metric = result["tolerance"], metric_named(result["metric"])
    compared = [block["robust"][name] for name in ("baseline", "sharp", "optimised") if name in block["robust"]]
    off, aim = tolerance_text(block["settings"]), aim_text(block["settings"])
    searched = Section(
        f"{'Searched' if was_searched(result) else 'Scored'} frames, {off}: {aim}",
        [*_score_rows(metric, compared), _kept_row(compared)],
    )
    if result["holdout"] is None:
        return [searched]
    held = [scores["holdout"] for scores in compared]
    interval = f"90 % interval, {result['holdout']['blocks']} blocks"
    gain = "gain over the baseline as planned"
    rows = [*_score_rows(metric, held), *_gain_rows(metric, held, interval, gain), _kept_row(held)]
    return [searched, Section(f"Held-out frames, {off}: {aim}", rows)]


def _kept_row(compared: Sequence[Mapping]) -> tuple[str, ...]:
    shares = (scores["gain_kept"] for scores in compared[1:])
    return ("gain kept [%]", "", *("-" if share is None else f"{100 * share:.1f}" for share in shares))


def _score_rows(metric: Metric, compared):
    return [
        (
            metric.in_unit("objective per vehicle"),
            *(metric.number(scores["objective_per_vehicle"], 1) for scores in compared),
        ),
        ("detectable share [%]", *(f"{100 * scores['detectable_share']:.1f}" for scores in compared)),
    ]


def _gain_rows(metric: Metric, compared, interval: str, name: str = "gain per vehicle"):
    """Rows of the gains over the baseline, which comes first and has none, and of their intervals if they have any."""
    gains = (metric.number(scores["gain_over_baseline"], 1, "+") for scores in compared[1:])
    rows = [(metric.in_unit(name), "", *gains)]
    if compared[-1]["interval_90"]:
        rows.append((interval, "", *(_span(metric, scores["interval_90"]) for scores in compared[1:])))
    return rows


def _span(metric: Metric, pair) -> str:
    return " to ".join(metric.number(end, 1, "+") for end in pair)
