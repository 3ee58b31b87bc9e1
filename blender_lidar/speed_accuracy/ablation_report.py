"""The ablations as text: a row for each, and what the scene needs in a few lines."""

from __future__ import annotations

from collections.abc import Mapping

from .ablated import ABOVE, BELOW, JUDGED, UNTOLD
from .figures import number, percent, signed, with_interval

HEADER = (
    "modelled",
    "",
    "bias",
    "error",
    "tau",
    "best moves by",
    "left out it costs",
    "choices apart",
    "beside the noise floor",
)
_UNITS = {"_m": "m", "_deg": "deg"}


def ablation_cells(row: Mapping) -> tuple[str, ...]:
    """A row under `HEADER`."""
    draws = f"; mean of {row['draws']} draws" if row["draws"] > 1 else ""
    what = (row["what"], row["value"] + draws)
    if row["bias"] is None:
        return (*what, row["note"], "", "", "", "", "", "")
    return (
        *what,
        signed(row["bias"]),
        number(row["error"]),
        number(row["tau"], 3),
        ", ".join(_moved(key, by) for key, by in row["shift"].items()),
        with_interval(row["regret"], row["regret_interval_90"]),
        with_interval(row["apart"], row["apart_interval_90"]),
        _verdicts(row["verdicts"]),
    )


def floor_line(result: Mapping) -> list[str]:
    """What the ablations are held against."""
    floor, count = result["ablation_floor"], result["ablation_mountings"]
    if floor is None:
        return ["Noise floor of the ablations: too few blocks for one"]
    return [
        f"Ablations, on the {count} best mountings by the reference; their noise floor, half of the blocks against the "
        f"other: bias {floor['bias']:.4f}, tau {floor['tau']:.3f}, choices apart by {percent(floor['apart'])} of the "
        "gain. An effect is above or below the floor when its whole 90 % interval is, each for itself; else it cannot "
        "be told"
    ]


def needs(result: Mapping) -> list[str]:
    """What the scene needs: all things by what can be told of them."""
    told = [row for row in result["ablations"] if row["verdicts"]]
    above = [f"{_name(row)} ({', '.join(_having(row, ABOVE))})" for row in told if _having(row, ABOVE)]
    below = [_name(row) for row in told if len(_having(row, BELOW)) == len(JUDGED)]
    rest = [
        f"{_name(row)} ({', '.join(_having(row, UNTOLD))})"
        for row in told
        if _having(row, UNTOLD) and not _having(row, ABOVE)
    ]
    kinds = (("Above the noise floor", above), ("Below it in everything", below), ("Cannot be told", rest))
    return [f"{kind}: {'; '.join(names)}" for kind, names in kinds if names]


def _having(row: Mapping, verdict: str) -> list[str]:
    return [name for name in JUDGED if row["verdicts"][name] == verdict]


def _verdicts(verdicts: Mapping[str, str] | None) -> str:
    """By verdict, shortest where all are the same."""
    if verdicts is None:
        return "no floor known"
    kinds = {kind: [name for name in JUDGED if verdicts[name] == kind] for kind in (ABOVE, UNTOLD, BELOW)}
    if len(kinds[BELOW]) == len(JUDGED):
        return BELOW
    return "; ".join(f"{kind}: {', '.join(names)}" for kind, names in kinds.items() if names and kind != BELOW)


def _name(row: Mapping) -> str:
    return f"{row['what']}, {row['value']}" if row["value"] else row["what"]


def _moved(key: str, by: float) -> str:
    unit = next((unit for ending, unit in _UNITS.items() if key.endswith(ending)), "")
    return f"{round(by, 2) + 0.0:+.2f} {unit}".rstrip()
