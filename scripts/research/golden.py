"""Golden runs of the shipped scene: regression reference of whole results, made before a change and compared after it.

    python scripts/research/golden.py --write FOLDER
    python scripts/research/golden.py --compare FOLDER [--only optimise_RS-16]

Runs `optimise`, `stability --quick` and `chart --quick` on scenes/i80.toml with RS-16 and RS-80, which takes the better
part of an hour on two cores. Numbers must agree to 1e-9, relative; times and what follows from them (the chart's Pareto
marks and its recommendation), versions and identities may differ. Exit code 1 tells of differences.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "scenes" / "i80.toml")
SENSORS = ("RS-16", "RS-80")
VERBS = {"optimise": [], "stability": ["--quick"], "chart": ["--quick"]}
RUNS = {f"{verb}_{sensor}": [verb, "--sensor", sensor, *words] for verb, words in VERBS.items() for sensor in SENSORS}
QUARTILES = {f"milliseconds_{name}" for name in ("first_quartile", "median", "third_quartile")}
TIMES = {"seconds", "milliseconds", *QUARTILES, "build_milliseconds_per_frame", "speedup"}
CHOSEN_BY_TIME = {"pareto", "recommended", "sentence", "validated"}
IGNORED = TIMES | CHOSEN_BY_TIME | {"versions", "identity"}
PROSE = {"text", "notes"}  # may be reworded, except for the numbers in it


def differences(kept: object, found: object, where: str = "", within: float = 1e-9) -> list[str]:
    """Where two results as JSON holds them disagree, a line each; keys that only the second has are no difference."""
    if isinstance(kept, dict) and isinstance(found, dict):
        lines = [f"{where}/{key}: is gone" for key in kept if key not in found and key not in IGNORED]
        for key in kept:
            if key in found and key not in IGNORED:
                pair = (_numbers(one[key]) if key in PROSE else one[key] for one in (kept, found))
                lines += differences(*pair, f"{where}/{key}", within)
        return lines
    if isinstance(kept, list) and isinstance(found, list):
        if len(kept) != len(found):
            return [f"{where}: {len(kept)} entries, now {len(found)}"]
        parts = (
            differences(*pair, f"{where}[{row}]", within) for row, pair in enumerate(zip(kept, found, strict=True))
        )
        return [line for part in parts for line in part]
    same = kept == found
    if {type(kept), type(found)} in ({float}, {int, float}):
        same = math.isclose(kept, found, rel_tol=within, abs_tol=1e-12) or (math.isnan(kept) and math.isnan(found))
    return [] if same else [f"{where}: {kept!r}, now {found!r}"]


def _numbers(prose: object) -> list[str]:
    """The numbers in a text or in a list of texts."""
    return re.findall(r"\d+(?:\.\d+)?", str(prose))


def content(path: Path) -> object:
    """What a JSON or CSV file holds; the rows of a table as dictionaries."""
    if path.suffix == ".json":
        return json.loads(path.read_text(encoding="utf-8"))
    with path.open(encoding="utf-8", newline="") as stream:
        return [{key: _value(text) for key, text in row.items()} for row in csv.DictReader(stream)]


def _value(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def run(name: str, folder: Path) -> None:
    """Carry out the run of that name of `RUNS`, and leave its JSON and CSV files in the folder."""
    with tempfile.TemporaryDirectory() as scratch:
        words = [sys.executable, "-m", "blender_lidar", *RUNS[name], SCENE, "--out", f"{scratch}/out"]
        started = time.perf_counter()
        subprocess.run(words, check=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, stdout=subprocess.DEVNULL)
        folder.mkdir(parents=True, exist_ok=True)
        for path in [*Path(scratch, "out").glob("*.json"), *Path(scratch, "out").glob("*.csv")]:
            shutil.copy(path, folder)
    print(f"{name}: {time.perf_counter() - started:.0f} s", flush=True)


def compare(kept: Path, found: Path) -> list[str]:
    """The differences between the files of two folders."""
    lines = []
    for path in sorted(kept.iterdir()):
        where, there = f"{kept.name}/{path.name}", found / path.name
        lines += differences(content(path), content(there), where) if there.exists() else [f"{where}: is gone"]
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--write", type=Path, metavar="FOLDER", help="run all and store the results there")
    action.add_argument("--compare", type=Path, metavar="FOLDER", help="run all again, and report what differs from it")
    parser.add_argument("--only", choices=RUNS, nargs="+", default=list(RUNS), help="leave the other runs out")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder, lines = args.write or Path(scratch), []
        for name in args.only:
            run(name, folder / name)
            lines += compare(args.compare / name, folder / name) if args.compare else []
    print("\n".join(lines) if lines or args.write else "no difference")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
