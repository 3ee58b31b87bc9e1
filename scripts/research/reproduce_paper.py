"""The paper's case study made again: Table II, Fig. 9, and how far to trust them.

    python scripts/research/reproduce_paper.py [--traffic FILE] [--out DIR] [--resume] [--quick]

RS-16, RS-32 and RS-80 by scenes/paper.toml: optima by an exhaustive grid with DE-PSO beside it, intervals from blocks
of time resampled jointly, a search beyond the paper's bounds, what is seen by distance, what RS-80's uneven beams do,
and every setting that the paper leaves unstated varied alone. A run that was stopped goes on with --resume and comes
to the same. About 12 minutes on two cores, with --quick two.
"""

from __future__ import annotations

import json
import sys
from math import prod

import numpy as np

from arguments import SCENES, counting, overrides_of, parser_of, run_script
from blender_lidar.files import write_text
from blender_lidar.optimise import READINGS
from blender_lidar.scene.provenance import versions
from blender_lidar.scene.site import Site
from blender_lidar.signals import stops_watched
from blender_lidar.statistics import interval_90
from blender_lidar.studies.driver import StudyFolder
from case_study import EVEN, FULL, PUBLISHED, QUICK, SENSORS, CaseStudy, baseline_of, open_case
from case_study import with_even_beams as even
from case_study_distance import by_distance, decomposition
from case_study_optima import (
    WIDE,
    Landscape,
    joint_optima,
    judged,
    landscape,
    near_best,
    order_shares,
    orders,
    searched_optimum,
    sensitivity_variants,
    variant_rows,
)
from case_study_report import report_text, tables

RESULT, REPORT = "case_study.json", "report.md"
NEAR_BEST = (0.01, 0.05)  # shares of the gain


def main(argv: list[str] | None = None) -> int:
    return run_script("reproduce_paper", lambda: study(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "paper.toml")
    parser.add_argument("--traffic", metavar="FILE", help="trajectory file in place of the scene's")
    parser.add_argument("--period", help="recording period of an NGSIM file: 1, 2 ... or 0400-0415")
    parser.add_argument("--location", help="site of a file that mixes several: i-80")
    parser.add_argument("--frames", type=int, help="number of searched frames")
    parser.add_argument("--reading", choices=READINGS, help="the paper's equations as corrected, or as printed")
    parser.add_argument("--caster")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--workers", type=int, help="processes; 0 takes one for each processor; 2 without --cluster")
    parser.add_argument("--cluster", metavar="ADDRESS", help="dask scheduler whose workers are used instead")
    parser.add_argument("--out", default="runs/paper", metavar="DIR", help="folder of the results; runs/paper")
    parser.add_argument("--resume", action="store_true", help="go on with the run in --out that was stopped")
    parser.add_argument("--quick", action="store_true", help="fewer frames, coarser grids")
    args = parser.parse_args(argv)
    if args.workers is None and args.cluster is None:
        args.workers = 2
    return args


def study(args) -> None:
    """Carry out what the folder does not hold yet, and write the results."""
    case = open_case(args.scene, overrides_of(args), QUICK if args.quick else FULL)
    with opened(case, args.out, args.resume) as folder:
        result = reproduce(case, folder)
        written = write_results(folder, result)
    print(report_text(result))
    print(f"Results in {folder.path}: {', '.join(written)}", file=sys.stderr)


def opened(case: CaseStudy, out, resume: bool):
    """The study's folder, locked."""
    return StudyFolder(out, case.identity()).locked(resume=resume)


def write_results(folder: StudyFolder, result: dict) -> list[str]:
    """Write tables, the page and, last, the result; returns names."""
    texts = {**tables(result), REPORT: report_text(result)}
    for name, text in texts.items():
        write_text(folder.file(name), text)
    write_text(folder.file(RESULT), json.dumps(result, indent=2) + "\n")
    return [*texts, RESULT]


def reproduce(case: CaseStudy, folder: StudyFolder) -> dict:
    """Carry out every stage that the folder, which is locked, does not hold; all results as one dictionary."""
    sites = {sensor: case.site(sensor) for sensor in SENSORS}
    first, rs80 = sites[SENSORS[0]], sites["RS-80"]
    seed = first.scenario.search.seed
    found = {sensor: _landscape(folder, site, case.effort.grid, None, "grid") for sensor, site in sites.items()}
    resampled = joint_optima(list(found.values()), seed)
    optima = {sensor: found[sensor].map.best[:2] for sensor in SENSORS}
    sensors = {}
    for row, (sensor, site) in enumerate(sites.items()):
        wide = _landscape(folder, site, case.effort.wide_grid, WIDE, "wide grid")
        searched = _search(folder, site)
        mountings = {"grid": optima[sensor], "de_pso": (searched["height_m"], searched["tilt_x_deg"])}
        sensors[sensor] = {
            **_about(site),
            **_optimum(found[sensor], None if resampled is None else resampled[row]),
            "wide": _wide(wide, site),
            "de_pso": searched,
            "judged": folder.stage(f"judged_{sensor.lower()}", lambda at=(site, mountings): judged(*at, seed)),
        }
    return {
        "scene": case.scene,
        "traffic": first.scenario.recordings[0].path,
        "reading": first.scenario.objective.reading,
        "seed": seed,
        "caster": first.observation.caster,
        "frames": len(first.search),
        "block_s": case.block_s,
        "blocks": len(found[SENSORS[0]].filled),
        "judged_frames": len(first.holdout),
        "judged_blocks": len(np.unique(first.plan.holdout_block)),
        "notes": list(dict.fromkeys(note for site in sites.values() for note in site.plan.notes)),
        "effort": case.effort._asdict(),
        "sensors": sensors,
        "order": None if resampled is None else _orders(resampled),
        **folder.stage("fig9", lambda: _fig9(sites, optima, seed)),
        "spacing": folder.stage("spacing", lambda: decomposition(rs80, even(rs80), optima["RS-80"], seed)),
        **_sensitivity(case, folder, seed),
        "versions": versions(first.observation.caster),
    }


def _landscape(folder, site: Site, grid, bounds, what) -> Landscape:
    def compute():
        with counting(prod(grid), f"{site.model.name}, {what}") as advance:
            return landscape(site, grid, bounds, advance).as_dict()

    return Landscape.from_dict(folder.stage(f"{what.replace(' ', '_')}_{site.model.name.lower()}", compute))


def _search(folder, site: Site) -> dict:
    def compute():
        settings = site.scenario.search
        with counting(settings.particles * settings.iterations, f"{site.model.name}, {settings.method}") as advance:
            return searched_optimum(site, advance)

    return folder.stage(f"search_{site.model.name.lower()}", compute)


def _about(site: Site) -> dict:
    return {
        "rings": site.model.rings,
        "range_gate_m": site.scenario.lidar.sensor.range_gate_m,
        "vehicles": sum(int(frame.counted.sum()) for frame in site.search),
        "judged_vehicles": sum(int(frame.counted.sum()) for frame in site.holdout),
        "baseline_mounting": list(baseline_of(site)),
        "published": PUBLISHED[site.model.name]._asdict(),
    }


def _best(found: Landscape) -> dict:
    height, tilt, value = found.map.best
    return {
        "height_m": height,
        "tilt_deg": tilt,
        "objective_per_vehicle": value,
        "gain": found.gain,
        "height_on_bound": bool(height == found.map.height_m[-1]),
        "tilt_on_bound": bool(tilt == found.map.tilt_deg[-1]),
    }


def _optimum(found: Landscape, resampled) -> dict:
    heights, tilts = (None, None) if resampled is None else (list(interval_90(values)) for values in resampled)
    return {
        **_best(found),
        "height_interval_90": heights,
        "tilt_interval_90": tilts,
        "baseline_per_vehicle": found.baseline["per_vehicle"],
        "near_best": [near_best(found, share) for share in NEAR_BEST],
        "map": {name: getattr(found.map, name).tolist() for name in ("height_m", "tilt_deg", "per_vehicle")},
    }


def _wide(found: Landscape, site: Site) -> dict:
    """The optimum beyond the paper's bounds, and the best tilt at each height."""
    least, most = site.scenario.lidar.deployment.places[0].bounds["tilt_x_deg"]
    inside = found.map.per_vehicle[:, (found.map.tilt_deg >= least) & (found.map.tilt_deg <= most)]
    return {
        **_best(found),
        "height_m_in_papers_tilts": float(found.map.height_m[inside.max(axis=1).argmax()]),
        "bounds": {name: list(pair) for name, pair in WIDE.items()},
        "by_height": [
            {"height_m": float(h), "tilt_deg": float(found.map.tilt_deg[row.argmax()]), "per_vehicle": float(row.max())}
            for h, row in zip(found.map.height_m, found.map.per_vehicle, strict=True)
        ],
    }


def _orders(resampled) -> dict:
    """The paper's orders: tilts fall and heights rise with the number of beams."""
    heights, tilts = zip(*resampled, strict=True)
    return {
        "tilt": order_shares(dict(zip(SENSORS, tilts, strict=True))),
        "height": order_shares(dict(zip(reversed(SENSORS), reversed(heights), strict=True))),
    }


def _fig9(sites, optima, seed: int) -> dict[str, list[dict]]:
    """Fig. 9 for the three sensors, and for RS-80's optimum with evenly spaced beams."""
    found = [by_distance(site, sensor, optima[sensor], seed) for sensor, site in sites.items()]
    found.append(by_distance(even(sites["RS-80"]), EVEN, optima["RS-80"], seed))
    return {name: [row for of in found for row in of[name]] for name in ("fig9", "fig9_halves")}


def _sensitivity(case: CaseStudy, folder: StudyFolder, seed: int) -> dict:
    each, rows = sensitivity_variants(case), []
    with counting(len(each), "what the paper leaves unstated") as advance:
        for sensor, variant in each:
            name = "_".join(f"sensitivity {variant.what} {variant.value} {sensor}".lower().split())
            rows += folder.stage(name, lambda at=(sensor, variant): variant_rows(case, *at, seed))
            advance(1)
    return {"sensitivity": rows, "sensitivity_orders": orders(rows)}


if __name__ == "__main__":
    with stops_watched():
        sys.exit(main())
