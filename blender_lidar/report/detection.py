"""What a detector found, in a sentence and a table; `result` is everywhere the content of detection.json."""

from __future__ import annotations

from collections.abc import Mapping

from ..document import Quantity, Table, adding_up
from ..run.quantities import points, share

_ROWS = {
    "recall_0.1": "recall at confidence 0.1",
    "precision_0.1": "precision at 0.1",
    "recall_0.3": "recall at confidence 0.3",
    "precision_0.3": "precision at 0.3",
    "ap_centre_2m": "AP, centres within 2 m",
    "ap_iou_0.5": "AP, bird's-eye IoU 0.5",
    "ap_iou_0.7": "AP, bird's-eye IoU 0.7",
}
_TABLED = {  # of groups
    "recall_0.3": "recall at 0.3",
    "precision_0.3": "precision at 0.3",
    "ap_centre_2m": "AP within 2 m",
    "ap_iou_0.5": "AP at IoU 0.5",
}


def detection_text(result: Mapping) -> str:
    """How many vehicles are found at the mounting, beside the baseline where that was judged, and how sure that is."""
    given, baseline = result["mountings"]["given"], result["mountings"].get("baseline")
    if given["recall_0.3"] is None:
        return "No vehicle counts in these frames."
    recall, said = _sure(given, "recall_0.3"), "At confidence 0.3 the detector finds"
    if baseline is None:
        said += f" {recall} of the vehicles"
    else:
        over = given["over_baseline"]["recall_0.3"]
        gain = points("recall_gain", "gain in recall", over["difference"], over["interval_90"])
        before, recall, gain = adding_up(_sure(baseline, "recall_0.3"), recall, gain)
        unsure = "; no interval" if gain.interval_90 is None else "; not shown" if gain.holds_nought else ""
        said += f" {recall} of the vehicles instead of {before} under the baseline: {gain}{unsure}"
    if given["precision_0.3"] is not None:
        said += f", and {_sure(given, 'precision_0.3')} of what it finds are vehicles"
    if given["with_return"] is not None:
        said += f"; {_percent(given['with_return'])} % have a return at all"
    if "detectable_share" in result:
        said += f", and the fused points make {_percent(result['detectable_share'])} % detectable"
    empty = given["without_boxes"]
    scenes = f"{result['scans']} scans" if "scans" in result else f"{result['frames']} frames"
    return said + (f"; {empty} of the {scenes} have no detection." if empty else ".")


def _sure(scores: Mapping, key: str) -> Quantity:
    """A share with its interval."""
    return share(key, _ROWS[key], scores[key], scores["interval_90"][key])


def detection_table(result: Mapping) -> Table:
    """Recall always with precision, AP, and groups of vehicles, in per cent, for each mounting or all of a data set."""
    scores = list(result["mountings"].values())
    names, unit = (["all mountings"], "scan") if "scans" in result else (list(result["mountings"]), "frame")
    over, ends_of = scores[-1].get("over_baseline"), scores[-1].get("interval_90")
    fused = scores[-1].get("over", {})  # by late fusion, which is better than others by so much
    names = ["late fusion" if fused and name == "given" else name for name in names]
    more = ["difference", "90 %"] if over or fused else ["90 %"] if ends_of else []
    blank = [None] * len(more)
    rows = [("vehicles", *(f"{one['vehicles']:,}" for one in scores), *blank)]
    if all(one["with_return"] is not None for one in scores):
        rows.append(("with a return", *(_percent(one["with_return"]) for one in scores), *blank))
    for key, text in _ROWS.items():
        cells = [_percent(one[key]) for one in scores]
        if over:
            cells += _difference(over[key])
        elif ends_of:
            cells += ["-" if ends_of[key] is None else " to ".join(map(_percent, ends_of[key]))]
        else:
            cells += blank
        rows.append((text, *cells))
    rows.append((f"false alarms a {unit} at 0.3", *(f"{one['false_alarms_0.3']:.2f}" for one in scores), *blank))
    for name, gains in fused.items():
        rows.append((f"Late fusion less {name}",))
        rows += [(what, *[None] * len(scores), *_difference(gains[key])) for key, what in _TABLED.items()]
    for group, title in (("by_distance", "By distance"), ("by_kind", "By kind"), ("by_approach", "By approach")):
        of_group = []
        for name in scores[-1].get(group, ()):
            counts = (f"{one[group][name]['vehicles']:,}" for one in scores)
            of_group.append((f"{name:<14}vehicles", *counts, *blank))
            for key, what in _TABLED.items():
                if key in scores[-1][group][name]:
                    cells = (_percent(one[group][name][key]) for one in scores)
                    of_group.append((f"{'':<14}{what}", *cells, *blank))
        rows += [(title,), *of_group] if of_group else []
    return Table("detection", "Detection", ("[%]", *names, *more), tuple(rows))


def _difference(gain: Mapping) -> list[str]:
    """A difference and its interval, in points."""
    ends = gain["interval_90"]
    difference = "-" if gain["difference"] is None else f"{100 * gain['difference']:+.1f}"
    return [difference, "-" if ends is None else " to ".join(f"{100 * end:+.1f}" for end in ends)]


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"
