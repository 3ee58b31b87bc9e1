"""What an installer's errors do to a mounting, as sentences."""

from __future__ import annotations

from collections.abc import Mapping

from ..metrics.catalogue import metric_named

_LIMITS = {
    "height_m": ("height", "m", "height_m"),
    "tilt_x_deg": ("tilt across the road", "deg", "tilt_deg"),
    "tilt_y_deg": ("tilt along the road", "deg", "tilt_deg"),
    "yaw_deg": ("yaw", "deg", "yaw_deg"),
}


def tolerance_text(settings: Mapping) -> str:
    """How far off its plan a mounting may end up; `settings` is what result.json has of a `Tolerance`."""
    widths = (("height_m", "m of height"), ("tilt_deg", "deg of either tilt"), ("yaw_deg", "deg of yaw"))
    return ", ".join(f"+/-{settings[key]:g} {what}" for key, what in widths if settings[key])


def aim_text(settings: Mapping) -> str:
    """What of the objective over these errors counts."""
    return "mean" if settings["aim"] == "mean" else "what nine of ten installations reach"


def tolerance_notes(result: Mapping) -> list[str]:
    """What robustness costs and gains, what is kept, and which error matters most; none where there was no tolerance.

    `result` is the content of result.json.
    """
    if result.get("tolerance") is None:
        return []
    notes = [kept_text(result), costliest_text(result)]
    if result["tolerance"]["sharp"] is not None:
        notes.append(_against_sharp(result))
    return [f"{note[0].upper()}{note[1:]}." for note in notes if note]


def kept_text(result: Mapping) -> str:
    """How much of its gain the mounting keeps; empty where it has none."""
    scores, where = _judged(result)
    if scores["gain_kept"] is None:
        return ""
    settings = result["tolerance"]["settings"]
    return (
        f"within {tolerance_text(settings)} the mounting keeps {100 * scores['gain_kept']:.0f} % of its gain "
        f"({aim_text(settings)}, {where})"
    )


def costliest_text(result: Mapping) -> str:
    """Which single error at its limit costs most; empty where none costs anything."""
    settings, (scores, where) = result["tolerance"]["settings"], _judged(result)
    ends = [
        (loss, key, sign)
        for key, losses in scores["loss_at_limits"].items()
        if key in _LIMITS
        for loss, sign in zip(losses, "-+", strict=True)
    ]
    loss, key, sign = max(ends, default=(0.0, "", ""))
    if loss <= 0.0:
        return ""
    name, unit, width = _LIMITS[key]
    lost = metric_named(result["metric"]).amount(loss)
    return f"of the single errors {name} {sign}{settings[width]:g} {unit} costs most: {lost} per vehicle ({where})"


def _against_sharp(result: Mapping) -> str:
    """What robustness costs where all hangs as planned, and what it gains where it does not."""
    block, metric = result["tolerance"], metric_named(result["metric"])
    if block["sharp"]["deployment"] == result["deployment"]:
        return "the search over the tolerance found no better mounting than the sharp one"
    held = block["robust"]["optimised"]["holdout"]
    if held is None or "over_sharp" not in held:
        return ""
    parts = []
    for name, where in (("as_planned", "as planned"), ("over_tolerance", "over the tolerance")):
        difference = held["over_sharp"][name]
        told = metric.amount(difference["objective_per_vehicle"], sign="+")
        if difference["interval_90"]:
            low, high = (metric.number(end, 0, "+") for end in difference["interval_90"])
            told += f" (90 %: {low} to {high})"
        parts.append(f"{where} {told}")
    return f"beside the sharp mounting the robust one has, per vehicle on held-out frames, {' and '.join(parts)}"


def _judged(result: Mapping) -> tuple[Mapping, str]:
    """Scores of the mounting over the tolerance where it is judged, and which frames that is."""
    scores = result["tolerance"]["robust"]["optimised"]
    if scores["holdout"] is not None:
        return scores["holdout"], "held-out frames"
    return scores, "scored frames" if result["search"] is None else "searched frames"
