"""Seed faults into a copy of the tree and see whether the suite catches them: mutation testing with a list by hand.

    python scripts/research/seeded_faults.py [--check] [ID ...]

`tests/seeded_faults.toml` tells each fault's place and the tests that catch it. First all of these tests are run as
they are, then each fault's with the fault. With --check no test is run: it only looks whether all places and tests are
there. Exit code 0: all are caught, or there, 1: not all.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
FAULTS = ROOT / "tests" / "seeded_faults.toml"
TIMEOUT_S = 1800.0


def copy_of_tree(folder: Path) -> Path:
    """The tracked and the new files of the tree, with the shared data beside them."""
    tree = folder / "tree"
    listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    for name in subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0"):
        if name and (ROOT / name).is_file():
            (tree / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, tree / name)
    if (ROOT.parent / "shared").exists():
        (folder / "shared").symlink_to((ROOT.parent / "shared").resolve())
    return tree


def outcome(tree: Path, tests: list[str]) -> str:
    """What becomes of some tests in a tree."""
    # No bytecode: a fault of the same length, written within the same second, would not be noticed.
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S)
    except subprocess.TimeoutExpired:
        return "too slow"
    lines = [f": {line}" for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return {0: "passed", 1: "failed"}.get(done.returncode, f"broken, exit code {done.returncode}") + "".join(lines)


def not_there(tree: Path, fault: dict) -> str:
    """What of a fault is not there in a tree: its place, or one of its tests; nothing where all is there."""
    path = tree / fault["file"]
    places = path.read_text(encoding="utf-8").count(fault["old"]) if path.exists() else 0
    if places != 1:
        return f"not found: {places} such places in {fault['file']}"
    for file, _, test in (name.partition("::") for name in fault["tests"]):
        if not (tree / file).exists() or (test and f"def {test}(" not in (tree / file).read_text(encoding="utf-8")):
            return f"not found: {file} {test}"
    return ""


def with_fault(tree: Path, fault: dict) -> str:
    """What the tests say of a fault: caught, MISSED, or that its place is not found."""
    if missing := not_there(tree, fault):
        return missing
    path = tree / fault["file"]
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(fault["old"], fault["new"]), encoding="utf-8")
    try:
        found = outcome(tree, fault["tests"])
    finally:
        path.write_text(text, encoding="utf-8")
    return f"caught: {found}" if found.startswith("failed") else f"MISSED: {found}"


def main() -> int:
    """Carry it out; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="only whether all places and tests are there")
    parser.add_argument("ids", nargs="*", metavar="ID", help="of the faults to seed; all unless said")
    args = parser.parse_args()
    every = {fault["id"]: fault for fault in tomllib.loads(FAULTS.read_text(encoding="utf-8"))["fault"]}
    if not every.keys() >= set(args.ids):
        parser.error(f"no such fault; allowed: {', '.join(every)}")
    chosen = [every[name] for name in args.ids or every]
    if args.check:
        missing = [f"{fault['id']}: {said}" for fault in chosen if (said := not_there(ROOT, fault))]
        print(*missing, f"{len(chosen) - len(missing)} of {len(chosen)} there", sep="\n")
        return 1 if missing else 0
    with tempfile.TemporaryDirectory(prefix="seeded_faults-") as folder:
        tree = copy_of_tree(Path(folder))
        print("without a fault:", sound := outcome(tree, sorted({name for one in chosen for name in one["tests"]})))
        if sound != "passed":
            return 1
        caught = 0
        for fault in chosen:
            started, found = time.monotonic(), with_fault(tree, fault)
            caught += found.startswith("caught")
            print(f"{fault['id']:<28} {time.monotonic() - started:4.0f} s  {found}", flush=True)
    print(f"{caught} of {len(chosen)} caught")
    return 0 if caught == len(chosen) else 1


if __name__ == "__main__":
    sys.exit(main())
