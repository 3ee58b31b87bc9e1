"""The command line: one verb each for what can be done with a scene."""

from __future__ import annotations

import argparse
import importlib
import os
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress

from . import __version__
from .errors import BlenderLidarError, printable

_VERBS = ("optimise", "evaluate", "stability", "scan", "score", "compare", "build", "render", "sensors", "doctor")
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
    if argv is None:
        _keep_stdout()
    with warnings.catch_warnings():  # which puts back what shows warnings
        warnings.showwarning = _one_line_warning
        try:
            code = _carried_out(argv)
            print(end="", flush=True)  # while a closed pipe or a full disk can still be told
            return code
        except BlenderLidarError as error:
            return _failed(str(error), error.exit_code)
        except BrokenPipeError:  # the reader of our output, such as `head`, has seen enough
            _drop_stdout()
            return FAILED
        except KeyboardInterrupt:
            return _failed("stopped", FAILED)
        except MemoryError:
            return _failed("out of memory; try fewer --frames or --workers 1", FAILED)
        except OSError as error:
            if error.filename is not None:
                return _failed(f"{error.filename}: {error.strerror}", WRONG_INPUT)
            _drop_stdout()
            return _failed(f"output cannot be written: {error.strerror or error}", FAILED)


def _carried_out(argv: Sequence[str] | None) -> int:
    try:
        args = _parser().parse_args(argv)
    except SystemExit as stop:  # argparse has printed what was wrong, or the help
        return GOOD if not stop.code else WRONG_INPUT
    return args.run(args)


def _failed(text: str, code: int) -> int:
    print(f"blender-lidar: {printable(' '.join(text.split()))}", file=sys.stderr)
    return code


def _keep_stdout() -> None:
    """Let what libraries written in C print on stdout, as Blender does when it starts, go to stderr.

    It stays so until the process ends, as they may print what they have buffered only then.
    """
    if sys.stdout is None or sys.stderr is None:  # closed by whoever started us
        return
    with suppress(OSError):  # no real files
        ours = os.dup(sys.stdout.fileno())
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        line_by_line = 1 if sys.stdout.isatty() else -1
        sys.stdout = os.fdopen(ours, "w", line_by_line, sys.stdout.encoding, "backslashreplace")


def _drop_stdout() -> None:
    """Let what is still to be written, as Python ends, go nowhere."""
    with suppress(OSError):  # no real file, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parser() -> argparse.ArgumentParser:
    parser = _OneLineParser(
        prog="blender-lidar",
        description="Where should a LiDAR hang beside the road, how high and how tilted, so that it perceives the most "
        "vehicles?",
    )
    parser.add_argument("--version", action="version", version=f"blender_lidar {__version__}")
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=_OneLineParser)
    for verb in _VERBS:
        importlib.import_module(f".commands.{verb}", __package__).add_parser(subparsers)
    return parser


class _OneLineParser(argparse.ArgumentParser):
    """An argument error is one line, like every other; options are written out, lest a new one changes a short one."""

    def __init__(self, **settings) -> None:
        super().__init__(**settings, allow_abbrev=False)

    def error(self, message: str):
        print(f"{self.prog}: {' '.join(message.split())} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(WRONG_INPUT)


def _one_line_warning(message, category, filename, lineno, file=None, line=None) -> None:
    print(f"blender-lidar: note: {' '.join(str(message).split())}", file=sys.stderr)
