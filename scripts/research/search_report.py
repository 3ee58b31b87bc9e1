"""The judgement of the searches as tables of Markdown, and runtime ECDFs as a picture (docs/evidence/search.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from blender_lidar.report.figure import FAINT, OPTIMISED_LOOK, sheet
from search_judgement import SHOWN, Part
from search_solvers import OURS, SOLVERS


def report_text(judged: Mapping) -> str:
    """All tables."""
    if not judged["parts"]:
        return ""
    found = [_verdict(judged["verdict"]), _successes(judged["parts"]), *map(_part, judged["parts"])]
    return "\n".join([*found, _compared(judged["compared"]), _groups(judged["groups"])])


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _points(estimate: Sequence[float]) -> str:
    value, low, high = (100 * share for share in estimate)
    return f"{value:+.1f} ({low:+.1f} to {high:+.1f})"


def _verdict(verdict: Sequence[Mapping]) -> str:
    head = ["", *(f"against {name}" for name in verdict[0]["de_pso"])]
    head += ["best rival", "its lead [points of success] (95 %)", "at most 5 points"]
    rows = []
    for row in verdict:
        within = row["within_margin"] if row["within_margin"] == SHOWN else f"**{row['within_margin']}**"
        rows.append([row["part"], *row["de_pso"].values(), row["best_rival"], _points(row["ahead"]), within])
    worse = "; ".join(f"{row['part']}: {', '.join(row['worse_groups'])}" for row in verdict if row["worse_groups"])
    note = "Groups of problems where a rival's final regret is significantly lower (Wilcoxon, Holm)"
    return f"## Verdict\n\n{table(head, rows)}\n{note}: {worse or 'none'}.\n"


def _successes(parts: Sequence[Mapping]) -> str:
    head = ["success [%], Wilson's 95 % interval", *(f"{part['label']}, {part['runs']} runs" for part in parts)]
    rows = []
    for name in SOLVERS:
        shares = ([100 * share for share in part["solvers"][name]["success"]] for part in parts)
        cells = [f"{share:.1f} ({low:.1f} to {high:.1f})" for share, low, high in shares]
        rows.append([f"**{name}**" if name == OURS else name, *cells])
    return f"## Success\n\n{table(head, rows)}"


def _part(part: Mapping) -> str:
    scene = part["label"].startswith("scene")
    also = list(part["solvers"][OURS]["also"])
    head = ["solver", *(f"within {100 * float(t):g} % [%]" if scene else f"f - f* <= {t} [%]" for t in also)]
    head += ["median regret", "90 % regret", "evaluations on a bound [%]"]
    rows = []
    for name, row in part["solvers"].items():
        regret = [f"{100 * value:.3f} %" if scene else f"{value:.1e}" for value in row["regret"]]
        shares = [f"{100 * share:.1f}" for share in (*row["also"].values(), row["on_bound"])]
        rows.append([name, *shares[:-1], *regret, shares[-1]])
    text = f"### {part['label']}\n\n{table(head, rows)}"
    if len(part["by_group"]) > 1:
        head = ["success [%] by group", *part["by_group"]]
        rows = [[name, *(f"{100 * group[name]:.0f}" for group in part["by_group"].values())] for name in SOLVERS]
        text += "\n" + table(head, rows)
    return text


def _compared(compared: Sequence[Mapping]) -> str:
    head = ["", f"{OURS} against", "difference of success [points] (95 %)", "McNemar", "lower / higher regret"]
    rows = []
    for row in compared:
        ranks = [f"{row['lower']} / {row['higher']}", _p(row["wilcoxon_holm"])]
        rows.append([row["part"], row["rival"], _points(row["difference"]), _p(row["mcnemar_holm"]), *ranks])
    text = "The same problem and seed for both; p-values after Holm."
    return f"## Pair by pair\n\n{text}\n\n{table([*head, 'Wilcoxon'], rows)}"


def _p(value: float) -> str:
    return "-" if math.isnan(value) else "< 0.0001" if value < 1e-4 else f"{value:.4f}"


def _groups(groups: Sequence[Mapping]) -> str:
    clear = [row for row in groups if row["wilcoxon_holm"] < 0.05]
    better = sum(row["lower"] > row["higher"] for row in clear)
    return (
        f"Of the {len(groups)} comparisons of final regrets by group of problems and rival, {better} are "
        f"significantly in our favour and {len(clear) - better} against us (Wilcoxon, Holm).\n"
    )


# Ours is the heavy one; the others differ in colour, lightness and dash.
_OTHERS = (
    ("#cf7f1b", "--"),
    ("#e3b778", (0, (1.2, 1.2))),
    ("#777777", "-."),
    (FAINT, "-"),
    ("#2a8f6f", "-"),
    ("#8fc3b1", (0, (5, 1.5))),
    ("#a03060", (0, (4, 1, 1, 1))),
)


def draw_ecdf(path: Path, parts: Sequence[Part], title: str) -> None:
    """Draw the runtime ECDF of each part side by side; MissingExtraError where matplotlib is not installed."""
    looks = [{"color": OPTIMISED_LOOK["color"], "linestyle": "-", "linewidth": 2.4, "zorder": 5}]
    looks += [{"color": colour, "linestyle": dash, "linewidth": 1.3} for colour, dash in _OTHERS]
    with sheet(path, 88.0, title, "Runtime ECDF over (problem, target) pairs") as figure:
        figure.get_layout_engine().set(w_pad=0.06)
        every = figure.subplots(1, len(parts), sharey=True, squeeze=False)[0]
        for axes, part in zip(every, parts, strict=True):
            lines = [
                axes.step(part.evaluations, part.reached(name), where="post", label=name, **look)[0]
                for name, look in zip(SOLVERS, looks, strict=True)
            ]
            axes.set_title(f"{part.label}: {len(part.group):,} runs each")
            axes.set_xscale("log")
            axes.set_xlim(max(1.0, part.evaluations[-1] / 200.0), part.evaluations[-1])
            axes.set_ylim(0.0, 1.0)
            axes.xaxis.set_major_formatter("{x:,.0f}")
            axes.set_xlabel("Evaluations")
            axes.grid(visible=True)
        every[0].set_ylabel("Share of targets reached")
        figure.legend(handles=lines, loc="outside lower center", ncols=4, handlelength=3.2)
