"""Many cheap LiDARs or few good ones: RS-16 x n beside RS-80 x m, at the shipped intersection and on I-80.

    python scripts/research/many_or_good.py [--frames 20] [--iterations 20] [--json FILE] [--picture FILE.png]

"More low-resolution LiDARs can beat fewer high-resolution ones" (SEIP, arXiv 2305.17892). Each number of LiDARs is
searched over the same poles, heights and tilts, one after the other with polish, on searched frames, and judged on
held-out ones; all intervals are 90 %, over blocks of time, and all differences paired. The price ratio at which m good
LiDARs and some cheap ones are worth the same is n* / m, where n* cheap ones, between two whole numbers on a straight
line, score what m good ones do.
"""

from __future__ import annotations

import json
import sys
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from arguments import SCENES, counting, parser_of, positive, run_script
from blender_lidar.files import check_place, write_text
from blender_lidar.report.figure import sheet
from blender_lidar.scene.scenario import scenario_of
from blender_lidar.scene.site import Site, prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.statistics import block_sums, drawn_blocks, interval_90, statistic_interval_90
from layout_judgement import found_by

CHEAP, GOOD = "RS-16", "RS-80"
MOST = {CHEAP: 4, GOOD: 2}
SEARCHED = {"height_m": [2.0, 6.0], "tilt_x_deg": [0.0, 25.0]}
I80_POLES = "name,x_m,y_m,facing_deg\n" + "".join(
    f"{side} {x:+g},{x:g},{y:g},{facing:g}\n"
    for side, y, facing in (("right", 0.0, 90.0), ("left", 25.96, -90.0))
    for x in (-40.0, -20.0, 0.0, 20.0, 40.0)
)


def main(argv: list[str] | None = None) -> int:
    return run_script("many_or_good", lambda: _study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__)
    parser.add_argument("--frames", type=positive, default=20, help="searched frames; 20")
    parser.add_argument("--iterations", type=positive, default=20, help="of 20 particles, for each LiDAR; 20")
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--picture", metavar="FILE.png")
    return parser.parse_args(argv)


def site_of(name: str, sensor: str, args, poles: Path) -> Site:
    """A shipped site with the most LiDARs of a model, on any of its poles."""
    tables = tomllib.loads((SCENES / f"{name}.toml").read_text(encoding="utf-8"))
    del tables["deployment"]
    tables.pop("baseline", None)
    tables["traffic"]["frames"] = args.frames
    tables["sensor"]["name"] = sensor
    if name == "i80":
        tables["region"] = {"stretches": [{"x_m": [-50.0, 50.0]}]}
    tables["search"] = {"seed": 1, "iterations": args.iterations}
    tables["lidar"] = [{"name": f"lidar{k + 1}", "poles": str(poles), **SEARCHED} for k in range(MOST[sensor])]
    return prepare(scenario_of(tables, folder=SCENES))


def curve_of(site: Site) -> dict[str, np.ndarray]:
    """Objective and detectable boxes of each number of LiDARs in each held-out block (n, b), vehicles (b,)."""
    with site_evaluator(site, site.search, site.holdout) as evaluator:
        found, _ = found_by(site, evaluator)
        totals, block = evaluator.held_out.totals(found.steps), site.plan.holdout_block
    return {
        "PE-VGOP, bits per vehicle": block_sums(totals.objective, block),
        "detectable share": block_sums(totals.detectable, block),
        "vehicles": block_sums(totals.vehicles, block),
    }


def crossing_number(cheap: np.ndarray, good: np.ndarray) -> np.ndarray:
    """How many cheap LiDARs score what a good layout does, (r,), from curves (r, n) and (r,); NaN beyond the last.

    Between whole numbers it is linear; where the first does more it is 1.
    """
    rising = np.maximum.accumulate(cheap, axis=1)
    return np.array([_reached(row, value) for row, value in zip(rising, good, strict=True)])


def _reached(curve: np.ndarray, value: float) -> float:
    above = np.flatnonzero(curve >= value)
    if not len(above):
        return np.nan
    first = int(above[0])
    if first == 0:
        return 1.0
    return first + (value - curve[first - 1]) / (curve[first] - curve[first - 1])


def compared(curves: Mapping[str, Mapping[str, np.ndarray]], what: str) -> dict[str, object]:
    """Curves with intervals, paired differences, and the price ratios at which both are worth the same."""
    vehicles = curves[CHEAP]["vehicles"]
    share = {name: (lambda w, s=of[what]: w @ s.T / (w @ vehicles)[:, None]) for name, of in curves.items()}
    once = np.ones((1, len(vehicles)))
    rows = {
        name: [
            {"lidars": n + 1, "value": float(value(once)[0, n]), "interval_90": _interval(value, n, vehicles)}
            for n in range(MOST[name])
        ]
        for name, value in share.items()
    }
    differences, ratios = [], []
    drawn = drawn_blocks(vehicles, 1)
    for m in range(MOST[GOOD]):
        for n in range(MOST[CHEAP]):

            def gap(w: np.ndarray, m: int = m, n: int = n) -> np.ndarray:
                return share[CHEAP](w)[:, n] - share[GOOD](w)[:, m]

            ends = statistic_interval_90(gap, vehicles, 1)
            differences.append({"cheap": n + 1, "good": m + 1, "less": float(gap(once)[0]), "interval_90": ends})
        number = crossing_number(share[CHEAP](once), share[GOOD](once)[:, m])[0] / (m + 1)
        found = None
        if drawn is not None:
            filled, of_filled, _ = drawn
            weights = np.zeros((len(of_filled), len(filled)))
            weights[:, filled] = of_filled
            resampled = crossing_number(share[CHEAP](weights), share[GOOD](weights)[:, m]) / (m + 1)
            beyond = float(np.isnan(resampled).mean())
            ends = None if beyond > 0.05 else list(interval_90(resampled[~np.isnan(resampled)]))
            found = {"interval_90": ends, "beyond_most": beyond}
        ratios.append({"good": m + 1, "ratio": None if np.isnan(number) else float(number), **(found or {})})
    return {"curves": rows, "differences": differences, "ratios": ratios}


def _interval(value, n: int, vehicles: np.ndarray):
    return statistic_interval_90(lambda w: value(w)[:, n], vehicles, 1)


def _study(args) -> None:
    for path, option in ((args.json, "--json"), (args.picture, "--picture")):
        if path:
            check_place(path, option)
    result = {}
    with tempfile.TemporaryDirectory() as folder, counting(4, "layouts") as advance:
        poles = {"crossing": SCENES / "crossing_poles.csv", "i80": Path(folder, "poles.csv")}
        poles["i80"].write_text(I80_POLES, encoding="utf-8")
        for name in poles:
            curves = {}
            for sensor in MOST:
                curves[sensor] = curve_of(site_of(name, sensor, args, poles[name]))
                advance(1, f"{name}, {sensor}")
            result[name] = {what: compared(curves, what) for what in curves[CHEAP] if what != "vehicles"}
    print(_text(result))
    if args.json:
        write_text(args.json, json.dumps(result, indent=2) + "\n")
    if args.picture:
        draw(args.picture, result)


def _text(result: Mapping) -> str:
    lines = []
    for site, of in result.items():
        for what, found in of.items():
            lines.append(f"{site}, {what}:")
            for sensor, rows in found["curves"].items():
                lines += [f"  {row['lidars']} x {sensor}: {row['value']:.3f} {_ends(row)}" for row in rows]
            for row in found["differences"]:
                lines.append(f"  {row['cheap']} x {CHEAP} over {row['good']} x {GOOD}: {row['less']:+.3f} {_ends(row)}")
            for row in found["ratios"]:
                most = f"more than {MOST[CHEAP] / row['good']:g}"
                ratio = most if row["ratio"] is None else f"{row['ratio']:.2f} {_ends(row)}"
                lines.append(f"  {row['good']} x {GOOD} and {CHEAP}s are worth the same at a price ratio of {ratio}")
    return "\n".join(lines)


def _ends(row: Mapping) -> str:
    ends = row.get("interval_90")
    return "(no interval)" if ends is None else f"({ends[0]:.3f} to {ends[1]:.3f})"


def draw(path: str | Path, result: Mapping) -> None:
    """Both curves of each site and score, with intervals."""
    title = f"{CHEAP} x n beside {GOOD} x m"
    with sheet(path, 110.0, title, "Held-out traffic; bars are 90 % intervals over blocks of time") as figure:
        grid = figure.subplots(2, len(result), sharex=True)
        for column, (site, of) in enumerate(result.items()):
            for row, (what, found) in enumerate(of.items()):
                axes = grid[row, column]
                for (sensor, points), marker in zip(found["curves"].items(), "os", strict=True):
                    value = [one["value"] for one in points]
                    ends = np.array([one["interval_90"] or (one["value"],) * 2 for one in points]).T
                    axes.errorbar(
                        [one["lidars"] for one in points],
                        value,
                        yerr=np.abs(ends - value),
                        marker=marker,
                        capsize=3,
                        label=sensor,
                    )
                axes.set_title(site if row == 0 else "")
                axes.set_ylabel(what if column == 0 else "")
                axes.set_xlabel("LiDARs" if row else "")
                axes.set_xticks(range(1, MOST[CHEAP] + 1))
                axes.grid(axis="y")
                axes.legend(loc="lower right")


if __name__ == "__main__":
    sys.exit(main())
