"""The command line: one verb each for what can be done with a scene."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import warnings
from collections.abc import Sequence

from . import __version__
from .errors import BlenderLidarError

_VERBS = ("optimise", "evaluate", "scan", "score", "sensors", "doctor")
GOOD, FAILED, WRONG_INPUT = 0, 1, 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; those of the process when None.

    Returns
    -------
    int
        0 good, 1 failed, 2 wrong input (one line on stderr says what and where).
    """
    warnings.showwarning = _one_line_warning
    parser = _parser()
    try:
        args = parser.parse_args(argv)
    except SystemExit as stop:  # argparse has printed what was wrong, or the help
        return GOOD if not stop.code else WRONG_INPUT
    try:
        return args.run(args)
    except BlenderLidarError as error:
        print(f"blender-lidar: {' '.join(str(error).splitlines())}", file=sys.stderr)
        return WRONG_INPUT
    except BrokenPipeError:  # the reader of our output, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except KeyboardInterrupt:
        print("blender-lidar: stopped", file=sys.stderr)
        return FAILED
    except MemoryError:
        print("blender-lidar: out of memory; try fewer --frames or --workers 1", file=sys.stderr)
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = _OneLineParser(
        prog="blender-lidar",
        description="Where should a LiDAR hang beside the road, how high and how tilted, so that it perceives the most vehicles?",
    )
    parser.add_argument("--version", action="version", version=f"blender_lidar {__version__}")
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=_OneLineParser)
    for verb in _VERBS:
        importlib.import_module(f".commands.{verb}", __package__).add_parser(subparsers)
    return parser


class _OneLineParser(argparse.ArgumentParser):
    """An argument error is one line, like every other."""

    def error(self, message: str):
        print(f"{self.prog}: {message} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(WRONG_INPUT)


def _one_line_warning(message, category, filename, lineno, file=None, line=None) -> None:
    print(f"blender-lidar: note: {message}", file=sys.stderr)
