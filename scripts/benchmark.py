"""Time frames, ours by stage beside what others cast with, in one run; and how time and memory grow.

    python scripts/benchmark.py [SCENE.toml] [--sensor RS-80] [--detail body] [--frames 10] [--repeats 7]
        [--caster NAME] [--growth] [--whole] [--only stages|rivals|metric|whole|growth] [--json FILE] [--picture FILE]

Rounds are interleaved: everything is timed once in each, one after another, so that a busy moment of the machine falls
on all. Medians and quartiles are over the rounds, ratios of pairs within the same round. --growth measures 1 to 256
frames, 10 to 1,000 vehicles, 16 to 128 rings and 1 to all processors, each point in a process of its own; --whole adds
the paper's 2,000 evaluations by DE-PSO over 60 frames for RS-16 and RS-80, which takes minutes. Ctrl-C ends it; what
was measured until then is printed and stored.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # one core

from blender_lidar.benchmark.case import MOUNTINGS
from blender_lidar.benchmark.document import document
from blender_lidar.benchmark.machine import machine
from blender_lidar.benchmark.picture import draw
from blender_lidar.benchmark.plan import GROWTH, PAPER, PARTS, USUAL, Options, Told, carry_out
from blender_lidar.benchmark.report import report
from blender_lidar.casting import CASTERS
from blender_lidar.commands.progress import Progress
from blender_lidar.errors import BlenderLidarError
from blender_lidar.formats.atomic import check_place, write_text
from blender_lidar.world.shapes import DETAILS

SCENE = Path(__file__).parents[1] / "scenes" / "i80.toml"


def main(argv: list[str] | None = None) -> int:
    args = _arguments(argv)
    try:
        return _benchmark(args)
    except BlenderLidarError as error:
        print(f"benchmark: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("benchmark: stopped", file=sys.stderr)
        return 1


def _benchmark(args) -> int:
    for path, option in ((args.json, "--json"), (args.picture, "--picture")):
        if path:
            check_place(path, option)
    here = machine()  # with the load from before
    progress = _Bars()
    try:
        found = carry_out(_options(args), Told(progress.begins, progress.advances))
    finally:
        progress.close()
    print(report(found, here))
    if args.json:
        write_text(args.json, json.dumps(document(found, here), indent=2) + "\n")
    if args.picture and (found.times or found.growth):
        draw(args.picture, found, here)
    if found.stopped:
        print("benchmark: stopped; what was measured until then is kept", file=sys.stderr)
    return 1 if found.stopped else 0


def _arguments(argv):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0], allow_abbrev=False)
    parser.add_argument("scene", nargs="?", default=str(SCENE))
    parser.add_argument("--sensor", default="RS-80", choices=sorted(MOUNTINGS))
    parser.add_argument("--detail", choices=DETAILS, help="level of detail of the vehicles, in place of the scene's")
    parser.add_argument("--frames", type=_positive, default=10, help="how many are timed; 10")
    parser.add_argument("--repeats", type=_positive, default=7, help="rounds; 7")
    parser.add_argument(
        "--caster",
        action="append",
        choices=CASTERS,
        default=[],
        help="may be repeated; all that are installed but exact",
    )
    parser.add_argument("--growth", action="store_true", help="growth over frames, vehicles, rings and workers too")
    parser.add_argument("--whole", action="store_true", help="the paper's whole optimisations too")
    parser.add_argument("--only", choices=PARTS, help="one part alone")
    parser.add_argument("--most-frames", type=_positive, default=256, help="where growth over frames ends; 256")
    parser.add_argument("--most-workers", type=_positive, default=0, help="where growth over workers ends")
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--picture", metavar="FILE.png")
    return parser.parse_args(argv)


def _options(args) -> Options:
    parts = (args.only,) if args.only else USUAL
    parts += ((GROWTH,) if args.growth else ()) + ((PAPER,) if args.whole else ())
    return Options(
        args.scene,
        args.sensor,
        args.detail,
        args.frames,
        args.repeats,
        tuple(args.caster),
        tuple(dict.fromkeys(parts)),
        args.most_frames,
        args.most_workers,
    )


def _positive(text):
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"is {text!r}; allowed: a whole number from 1")
    return int(text)


class _Bars:
    """Progress of one part after another."""

    def __init__(self) -> None:
        self._progress: Progress | None = None

    def begins(self, what: str, steps: int) -> None:
        self.close()
        self._progress = Progress(steps, what)

    def advances(self) -> None:
        self._progress.advance(1)

    def close(self) -> None:
        if self._progress is not None:
            self._progress.close()


if __name__ == "__main__":
    sys.exit(main())
