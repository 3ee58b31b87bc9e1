"""Judge what a run says of its answer as hung: beside ten times the traffic, and beside the sharp answer.

SUMO generates five straight roads and five signalised crossings that nothing was tuned on. Each is recorded four times
for ten minutes; each recording gets its answer with the installer's errors in mind, and the sharp one, which is best
if it hangs exactly as planned. A hundred other minutes tell what the answers are worth as hung, under errors that are
drawn here, without the package's own. A 90 % interval should hold that truth nine times in ten, and an answer never be
worse as hung than the sharp one.

    pip install "blender_lidar[fast,sumo,maps]"
    python scripts/research/installation_judgement.py --out sites --sharp-only
    python scripts/research/installation_judgement.py --out sites [--nets FOLDER] [--called TRY]

The first makes the traffic and judges the sharp answers alone. FOLDER has SUMO configurations, each of which is a
further site at its first proposed pole. Traffic, answers and truths stay in the folder, so that a run goes on where it
was stopped; answers of another TRY are kept apart.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from arguments import Silent, counting, parser_of, positive, run_script
from blender_lidar.files import whole_file, write_text
from blender_lidar.run.folder import RunFolder
from blender_lidar.run.optimise import optimise_site
from blender_lidar.scene.mounting import MOUNTED, Layout
from blender_lidar.scene.scenario import Scenario
from blender_lidar.scene.site import prepare
from blender_lidar.scoring.evaluation import site_evaluator
from blender_lidar.statistics import block_sums, resampled_weights
from installation_sites import TrafficSite, scene_of, sites
from stability_calibration import TIMES

RECORDINGS = 4
HALF_WIDTHS = {"height_m": 0.05, "tilt_x_deg": 0.5, "tilt_y_deg": 0.5, "yaw_deg": 2.0}  # of the installer's errors
ERRORS, RESAMPLES, SEED = 60, 200, 85
SHARP, BASELINE = "sharp", "baseline"
SEARCH = {"particles": 20, "iterations": 40, "seed": 1}


def sharp_deployment() -> dict:
    """[deployment] of an answer that is to hang exactly as planned."""
    return {"installer": False}


def errors_drawn(number: int, seed: int) -> list[dict[str, float]]:
    """Errors of the coordinates, independent and uniform: one in each slice of each one's range (Latin hypercube)."""
    rng = np.random.default_rng(seed)
    slices = np.stack([rng.permutation(number) for _ in HALF_WIDTHS], axis=1)
    shares = 2.0 * (slices + rng.random(slices.shape)) / number - 1.0
    return [dict(zip(HALF_WIDTHS, row, strict=True)) for row in (shares * list(HALF_WIDTHS.values())).tolist()]


def hung(scenario: Scenario, deployment: Mapping[str, float], errors: Sequence[Mapping]) -> list[Layout]:
    """A mounting as planned, then under each error."""
    planned = {key: deployment[key] for key in MOUNTED}
    off = [{key: value + error.get(key, 0.0) for key, value in planned.items()} for error in errors]
    return [(scenario.lidar.mounting(table),) for table in (planned, *off)]


class Truth:
    """What a mounting is worth on the truth's traffic: vehicles that it detects in each block of time, (1 + m, b).

    The first row is that of the mounting as planned, the others are those of the errors.
    """

    def __init__(self, detectable: np.ndarray, vehicles: np.ndarray) -> None:
        self.detectable, self.vehicles = detectable, vehicles
        shares = detectable.sum(axis=1) / vehicles.sum()
        self.planned, self.hung = float(shares[0]), float(shares[1:].mean())

    def standard_error(self, other: Truth | None = None) -> float:
        """Of the share as hung, or of what it is above that of another mounting, by the blocks."""
        found = self.detectable[1:].mean(axis=0) - (0.0 if other is None else other.detectable[1:].mean(axis=0))
        rest = found - found.sum() / self.vehicles.sum() * self.vehicles
        return float(np.sqrt(len(rest) / (len(rest) - 1) * (rest**2).sum()) / self.vehicles.sum())

    def share_above(self, limit: float) -> float:
        """In what part of installations, each in resampled blocks of time, the share lies above a limit."""
        weights = resampled_weights(len(self.vehicles), np.random.default_rng(SEED), RESAMPLES)
        return float((self.detectable[1:] @ weights.T / (weights @ self.vehicles) > limit).mean())


def answer_of(site: TrafficSite, folder: Path, number: int, name: str, seed: int, workers: int) -> dict:
    """The result of a run on a recording, kept in a folder."""
    run = RunFolder(folder / f"{number}_{name}")
    if not run.file("result.json").exists():
        changed = {"search": SEARCH, "model": {"workers": workers}}
        changed["deployment"] = sharp_deployment() if name == SHARP else {}
        prepared = prepare(scene_of(site, folder / f"{number}", 1, seed, **changed))
        with run.begun(resume=True):
            optimise_site(prepared, run, Silent(), resume=True)
    return json.loads(run.file("result.json").read_text(encoding="utf-8"))


def truths_of(
    site: TrafficSite, folder: Path, plans: Mapping[str, Mapping], seed: int, workers: int
) -> dict[str, Truth]:
    """What some mountings are worth on ten times the traffic, kept in a folder."""
    kept = {name: folder / f"{name}.npz" for name in plans}
    missing = [
        name for name, path in kept.items() if not path.exists() or str(np.load(path)["plan"]) != str(plans[name])
    ]
    if missing:
        changed = {"deployment": sharp_deployment(), "model": {"workers": workers}}
        scenario = scene_of(site, folder / "truth", TIMES, seed, **changed)
        prepared, errors = prepare(scenario), errors_drawn(ERRORS, seed)
        plan = prepared.plan
        block = np.concatenate([plan.search_block, plan.search_block.max() + 1 + plan.holdout_block])
        with site_evaluator(prepared, prepared.search, prepared.holdout) as evaluator:
            for name in missing:
                layouts = hung(scenario, plans[name], errors)
                parts = [scorer.totals(layouts) for scorer in (evaluator, evaluator.held_out)]
                counts = [
                    np.concatenate([getattr(one, key) for one in parts], -1) for key in ("detectable", "vehicles")
                ]
                detectable, vehicles = (block_sums(one, block) for one in counts)
                with whole_file(kept[name]) as path:
                    np.savez(path, plan=str(plans[name]), detectable=detectable, vehicles=vehicles)
    return {name: Truth(*map(np.load(path).get, ("detectable", "vehicles"))) for name, path in kept.items()}


def told_of(result: Mapping, as_hung: bool) -> dict:
    """What a result says of the share of its answer, with the interval, and of the gain."""
    judged = result["cross_fitted"]["optimised"] if result["cross_fitted"] else result["holdout"]
    if as_hung:
        told = judged["as_hung"]
        return {**told, "share": told["detectable_share"]}
    named = {"share": "detectable_share", "interval_90": "detectable_share_interval_90"}
    named |= {"gain": "detectable_share_gain", "gain_interval_90": "detectable_share_gain_interval_90"}
    return {key: judged[name] for key, name in named.items()}


def holds(interval: Sequence[float] | None, value: float) -> bool:
    """Whether there is an interval and it holds a value."""
    return interval is not None and interval[0] <= value <= interval[1]


def row_of(told: Mapping, truth: Truth, baseline: Truth, sharp: Truth | None = None) -> dict:
    """An answer beside its truth; beside the sharp answer of the same recording, where it is not that one itself."""
    gain, ends = truth.hung - baseline.hung, told["interval_90"]
    row = {**told, "planned_true": truth.planned, "hung_true": truth.hung, "true_error": truth.standard_error()}
    row |= {"half": ends and 0.5 * (ends[1] - ends[0]), "held": holds(ends, truth.hung), "gain_true": gain}
    row["gain_held"] = holds(told["gain_interval_90"], gain)
    if sharp is not None:
        row |= {"over_sharp": truth.hung - sharp.hung, "over_sharp_error": truth.standard_error(sharp)}
        row["above_nine_of_ten"] = truth.share_above(told["nine_of_ten"])
    return row


def rows_of(site: TrafficSite, folder: Path, seed: int, names: Sequence[str], workers: int) -> list[dict]:
    """All answers of a site beside their truths, one of each recording by what it is called."""
    found = {
        (number, name): answer_of(site, folder, number, name, seed + number, workers)
        for number in range(1, RECORDINGS + 1)
        for name in names
    }
    plans = {f"{number}_{name}": result["deployment"] for (number, name), result in found.items()}
    plans[BASELINE] = found[1, SHARP]["baseline"]["deployment"]
    truths, rows = truths_of(site, folder, plans, seed, workers), []
    for number in range(1, RECORDINGS + 1):
        of = {name: (told_of(found[number, name], name != SHARP), truths[f"{number}_{name}"]) for name in names}
        sharp = of[SHARP][1]
        rows.append(
            {name: row_of(*one, truths[BASELINE], None if name == SHARP else sharp) for name, one in of.items()}
        )
    return rows


def summary(rows: Sequence[Mapping], count: int) -> list[str]:
    """How intervals hold the truth as hung and how wide they are; all answers of one kind, as many of each site."""
    halves = [row["half"] for row in rows if row["half"] is not None]
    apart = np.array([row["share"] for row in rows]).reshape(count, -1).std(axis=1, ddof=1)
    off = np.array([row["share"] - row["hung_true"] for row in rows])
    held, gains = (sum(row[key] for row in rows) for key in ("held", "gain_held"))
    error = np.median([row["true_error"] for row in rows])
    spread, wrong = (1.645 * np.sqrt((one**2).mean()) for one in (apart, off))
    half, spread, wrong, mean, error = 100.0 * np.array([np.median(halves), spread, wrong, off.mean(), error])
    return [
        f"{held} of {len(rows)} intervals hold the truth as hung ({len(halves)} given), {gains} of the gain's",
        f"half-width {half:.1f} points (median); 1.645 times the spread of a site's four {spread:.1f}, and times the",
        f"error {wrong:.1f}; told less truth {mean:+.1f} (mean); standard error of a truth {error:.1f} (median)",
    ]


def judge(args: argparse.Namespace) -> None:
    """Run all, and print a row for each site and what they come to."""
    names, found = [SHARP] if args.sharp_only else [SHARP, args.called], {}
    every = {name: one for name, one in sites(args.nets).items() if args.only in (None, name)}
    with counting(len(every), "sites") as advance:
        for name, site in every.items():
            found[name] = rows_of(site, args.out / name, SEED + zlib.crc32(name.encode()) % 10_000, names, args.workers)
            advance(1)
    write_text(args.out / f"judged_{names[-1]}.json", json.dumps(found, indent=1))
    titles = ["sharp, planned", "+/-", "true", "as hung, true", "edge"]
    titles += [] if args.sharp_only else ["as hung", "+/-", "true", "held", "over sharp", "+/-"]
    print(f"{'[points]':<14}" + "".join(f"{title:>15}" for title in titles))
    for name, rows in found.items():
        print(f"{name:<14}" + "".join(f"{one:>15}" for one in cells(rows, names)))
    every = {name: [row[name] for rows in found.values() for row in rows] for name in names}
    for name, rows in every.items():
        print(f"{name}:", *summary(rows, len(found)), sep="\n  ")
    if not args.sharp_only:
        print("", *beside_sharp(every[args.called]), sep="\n  ")


def cells(rows: Sequence[Mapping], names: Sequence[str]) -> list[str]:
    """What the table has of a site: means over its recordings, in points; half-widths where all have one."""

    def mean(name: str, key: str) -> float:
        values = [row[name][key] for row in rows]
        return math.nan if None in values else 100.0 * float(np.mean(values))

    values = [mean(SHARP, key) for key in ("share", "half", "planned_true", "hung_true")]
    found = [f"{value:.1f}" for value in (*values, values[2] - values[3])]
    for name in names[1:]:
        found += [f"{mean(name, key):.1f}" for key in ("share", "half", "hung_true")]
        found.append(f"{sum(row[name]['held'] for row in rows)} of {len(rows)}")
        found += [f"{mean(name, key):.1f}" for key in ("over_sharp", "over_sharp_error")]
    return found


def beside_sharp(rows: Sequence[Mapping]) -> list[str]:
    """How the answers compare with the sharp ones of the same recordings, both as hung; and where nine of ten lie."""
    over, error = (100.0 * np.array([row[key] for row in rows]) for key in ("over_sharp", "over_sharp_error"))
    worst, reach = int(np.argmin(over)), 1.645 * error
    return [
        f"over the sharp answer {over.mean():+.1f} points (mean), worst {over[worst]:+.1f} +/- {reach[worst]:.1f}; "
        f"{(over + reach < 0).sum()} of {len(rows)} worse and {(over - reach > 0).sum()} better, beyond 90 %",
        f"above nine of ten: {100 * np.mean([row['above_nine_of_ten'] for row in rows]):.0f} % of installations in "
        "resampled blocks",
    ]


if __name__ == "__main__":
    parser = parser_of(__doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="where traffic and answers are kept")
    parser.add_argument("--nets", type=Path, metavar="FOLDER", help="SUMO configurations of further sites")
    parser.add_argument("--only", metavar="SITE", help="this site alone")
    parser.add_argument("--sharp-only", action="store_true", help="the sharp answers alone")
    parser.add_argument("--called", default="hung", metavar="TRY", help="what the other answers are called (hung)")
    parser.add_argument("--workers", type=positive, default=2, help="processes (default 2)")
    asked = parser.parse_args()
    sys.exit(run_script(parser.prog, lambda: judge(asked)))
