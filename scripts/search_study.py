"""How the searches do beside each other and beside other people's: docs/search.md made again.

    python scripts/search_study.py [--out DIR] [--resume] [--seeds 31] [--part bbob] [--traffic FILE] [--quick] [--tune]

Judges on BBOB in 2, 3 and 5 dimensions and on scenes/i80.toml with two and with five coordinates searched, 2,000
evaluations to a run; with --traffic FILE the scene is judged on that recording besides. With --tune it makes the record
of the tuning instead, on the development problems alone. What is done is stored instance by instance; a study that was
stopped goes on with --resume, and --report reports what there is.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")  # small matrices: more threads only get in each other's way

from blender_lidar.commands.progress import Progress
from blender_lidar.errors import BlenderLidarError
from blender_lidar.search_study.output import FILES, study_identity, write_results
from blender_lidar.search_study.runs import carry_out
from blender_lidar.search_study.tasks import PARTS, judging, tuning
from blender_lidar.stop_signals import stops_recognised
from blender_lidar.study.stages import StudyFolder

SCENE = Path(__file__).parents[1] / "scenes" / "i80.toml"


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        with stops_recognised():
            return _study(args)
    except BlenderLidarError as error:
        print(f"search_study: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        traffic = "".join(f" --traffic {path}" for path in args.traffic)
        print(f"search_study: stopped; go on with: --out {args.out} --resume{traffic}", file=sys.stderr)
        return 1


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("--out", default="runs/search", metavar="DIR", help="folder of the results; runs/search")
    parser.add_argument("--resume", action="store_true", help="go on with the study in --out that was stopped")
    parser.add_argument("--seeds", type=_positive, default=31, help="instances and seeds of every problem; 31")
    parser.add_argument("--quick", action="store_true", help="2 seeds and 200 evaluations, to see that all works")
    parser.add_argument("--tune", action="store_true", help="the record of the tuning, on the development problems")
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part; may be given again")
    parser.add_argument(
        "--traffic",
        action="append",
        default=[],
        metavar="FILE",
        help="a further recording; may be given again",
    )
    parser.add_argument("--report", action="store_true", help="run nothing: report what is stored")
    parser.add_argument("--workers", type=_positive, default=1, help="processes, of this machine alone; 1")
    return parser.parse_args(argv)


def _positive(text):
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"is {text!r}; allowed: a whole number from 1")
    return int(text)


def _study(args):
    started = time.monotonic()
    seeds, budget = (2, 200) if args.quick else (args.seeds, 2000)
    everything = [*tuning(seeds, budget), *judging(PARTS, seeds, budget, SCENE, args.traffic)]
    wanted = tuning(seeds, budget) if args.tune else judging(args.part or PARTS, seeds, budget, SCENE, args.traffic)
    folder = StudyFolder(args.out, study_identity(SCENE, seeds, budget, args.traffic), FILES)
    with folder.locked(resume=args.resume):
        if not args.report:
            progress = Progress(len(wanted), "tuning" if args.tune else "judging")
            try:
                carry_out(folder, wanted, args.workers, progress.advance)
            finally:
                progress.close()
        written = write_results(folder, everything)
    print(f"Results in {folder.path} after {time.monotonic() - started:.0f} s: {', '.join(written)}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
