"""The paper's case study made again: Table II, Figs. 8 and 9, and how far to trust them.

    python scripts/reproduce_paper.py [--traffic FILE] [--out DIR] [--resume] [--quick]

RS-16, RS-32 and RS-80 by scenes/paper.toml: optima by an exhaustive grid with DE-PSO beside it, intervals from blocks
of time resampled jointly, a search beyond the paper's bounds, what is seen by distance, what RS-80's uneven beams do,
and every setting that the paper leaves unstated varied alone. A run that was stopped goes on with --resume and comes
to the same. About 12 minutes on two cores, with --quick two.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from blender_lidar.case_study.identity import study_identity
from blender_lidar.case_study.output import FILES, write_results
from blender_lidar.case_study.report import report_text
from blender_lidar.case_study.reproduce import reproduce
from blender_lidar.case_study.sites import FULL, QUICK, open_case
from blender_lidar.casting import CASTERS
from blender_lidar.commands.progress import Progress
from blender_lidar.errors import BlenderLidarError
from blender_lidar.optimise import READINGS
from blender_lidar.stop_signals import stops_recognised, stops_watched
from blender_lidar.study.stages import StudyFolder

SCENE = Path(__file__).parents[1] / "scenes" / "paper.toml"
_SETTINGS = {
    "traffic": ("traffic", "path"),
    "period": ("traffic", "period"),
    "location": ("traffic", "location"),
    "frames": ("traffic", "frames"),
    "caster": ("model", "caster"),
    "reading": ("objective", "reading"),
    "seed": ("search", "seed"),
    "workers": ("model", "workers"),
    "cluster": ("model", "cluster"),
}


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        with stops_recognised():
            return _study(args)
    except BlenderLidarError as error:
        print(f"reproduce_paper: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print(f"reproduce_paper: stopped; go on with: --out {args.out} --resume", file=sys.stderr)
        return 1


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("scene", nargs="?", default=str(SCENE), metavar="SCENE.toml")
    parser.add_argument("--traffic", metavar="FILE", help="trajectory file in place of the scene's")
    parser.add_argument("--period", help="recording period of an NGSIM file: 1, 2 ... or 0400-0415")
    parser.add_argument("--location", help="site of a file that mixes several: i-80")
    parser.add_argument("--frames", type=int, help="number of searched frames")
    parser.add_argument("--reading", choices=READINGS, help="the paper's equations as corrected, or as printed")
    parser.add_argument("--caster", choices=("auto", *CASTERS))
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


def _study(args):
    started = time.monotonic()
    given = {name: getattr(args, name) for name in _SETTINGS}
    overrides = {_SETTINGS[name]: (value, f"--{name}") for name, value in given.items() if value is not None}
    case = open_case(args.scene, overrides, QUICK if args.quick else FULL)
    folder = StudyFolder(args.out, study_identity(case), FILES)
    with folder.locked(resume=args.resume):
        result = reproduce(case, folder, Progress)
        written = write_results(case, folder, result)
    print(report_text(result))
    print(f"Results in {folder.path} after {time.monotonic() - started:.0f} s: {', '.join(written)}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    with stops_watched():
        sys.exit(main())
