"""Time frames, ours by stage beside what others cast with, in one run.

    python scripts/research/benchmark.py [SCENE.toml] [--sensor RS-80] [--detail body] [--frames 10] [--repeats 7]
        [--caster NAME] [--only ours|rivals|metric|whole] [--json FILE] [--picture FILE]

Rounds are interleaved: everything is timed once in each, one after another, so that a busy moment of the machine falls
on all. Medians and quartiles are over the rounds, ratios of pairs within the same round. `--only ours --frames 2
--repeats 5` times our stages alone, for before and after, in two minutes. Ctrl-C ends it; what was measured until then
is printed and stored.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # one core

from arguments import SCENES, counting, parser_of, positive, run_script
from benchmark_report import Found, document, draw, machine, report
from benchmark_rivals import rivals_missing, rivals_of
from benchmark_stages import (
    MOUNTINGS,
    NumPyProcess,
    cases_of,
    in_rounds,
    metric_entry,
    optimisations,
    stage_entries,
    summary_of,
)
from blender_lidar.casting import CASTERS, is_available, resolve
from blender_lidar.files import check_place, write_text
from blender_lidar.scene.scenario import load_scenario
from blender_lidar.world.shapes import DETAILS

USUAL = ("rivals", "metric", "whole")
PARTS = ("ours", *USUAL)  # "rivals" are timed beside ours
_TOO_SLOW = "exact"  # for a frame of this size minutes go by


def main(argv: list[str] | None = None) -> int:
    return run_script("benchmark", lambda: _benchmark(_arguments(argv)))


def _arguments(argv):
    parser = parser_of(__doc__, SCENES / "i80.toml")
    parser.add_argument("--sensor", default="RS-80", choices=sorted(MOUNTINGS))
    parser.add_argument("--detail", choices=DETAILS, help="level of detail of the vehicles, in place of the scene's")
    parser.add_argument("--frames", type=positive, default=10, help="how many are timed; 10")
    parser.add_argument("--repeats", type=positive, default=7, help="rounds; 7")
    parser.add_argument(
        "--caster", action="append", choices=CASTERS, help="may be repeated; all that are installed but exact"
    )
    parser.add_argument("--only", choices=PARTS, help="one part alone")
    parser.add_argument("--json", metavar="FILE")
    parser.add_argument("--picture", metavar="FILE.png")
    return parser.parse_args(argv)


def _benchmark(args) -> None:
    for path, option in ((args.json, "--json"), (args.picture, "--picture")):
        if path:
            check_place(path, option)
    here, found = machine(), Found()  # with the load from before
    try:
        _carry_out(args, found)
    except KeyboardInterrupt:
        found.stopped = True
    print(report(found, here))
    if args.json:
        write_text(args.json, json.dumps(document(found, here), indent=2) + "\n")
    if args.picture and found.times:
        draw(args.picture, found, here)
    if found.stopped:
        raise KeyboardInterrupt


def _carry_out(args, found: Found) -> None:
    parts = {args.only} if args.only else {*USUAL}
    installed = [name for name in CASTERS if name != _TOO_SLOW and is_available(name)]
    casters = [resolve(name, "--caster") for name in dict.fromkeys(args.caster)] if args.caster else installed
    found.left_out |= {f"caster {name}": "it is not installed" for name in CASTERS if not is_available(name)}
    if _TOO_SLOW not in casters:
        found.left_out[f"caster {_TOO_SLOW}"] = f"minutes for a frame; asked for by --caster {_TOO_SLOW}"
    overrides = {("sensor", "name"): (args.sensor, "--sensor")}
    if args.detail:
        overrides["world", "detail"] = (args.detail, "--detail")
    if parts & {"ours", "rivals"}:
        _frames(args, load_scenario(args.scene, overrides), casters, parts, found)
    if "metric" in parts:
        _time("the metric", [[metric_entry()]], args.repeats, found.times)
    if "whole" in parts:
        few = optimisations(args.scene, overrides, casters)
        _time("whole optimisations", [few], min(args.repeats, 3), found.wholes, warm=False)


def _frames(args, scenario, casters: Sequence[str], parts: set[str], found: Found) -> None:
    """Time frames, cast by us and by others."""
    cases = cases_of(scenario, args.frames)
    found.about = summary_of(cases)
    if "rivals" in parts:
        found.left_out |= rivals_missing()
    without_numba = NumPyProcess(cases, casters)
    try:
        columns = [stage_entries(case, casters) + without_numba.entries(row) for row, case in enumerate(cases)]
        if "rivals" in parts:
            for column, case in zip(columns, cases, strict=True):
                column += [rival.entry for rival in rivals_of(case)]
        _time("frames", columns, args.repeats, found.times)
    finally:
        without_numba.close()


def _time(what: str, columns, rounds: int, into: dict, *, warm: bool = True) -> None:
    with counting(rounds, what) as advance:
        in_rounds(columns, rounds, into, warm=warm, on_done=lambda: advance(1))


if __name__ == "__main__":
    sys.exit(main())
