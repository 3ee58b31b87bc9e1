"""The command line: one verb each for what can be done with a scene."""

from __future__ import annotations

import argparse
import importlib
import io
import os
import re
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress

from . import __doc__ as question
from . import __version__
from .commands.parsers import add_verbs
from .commands.verbs import VERBS
from .errors import BlenderLidarError, MissingExtraError, one_line, output_error
from .signals import stops_deferred, stops_recognised, stops_watched

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
    if argv is not None:
        return _exit_code(argv)
    _open_streams()
    _keep_stdout()
    with stops_watched():
        return _exit_code(None)


def _exit_code(argv: Sequence[str] | None) -> int:
    """Carry out what the arguments ask for and return the exit code; what goes wrong is one line."""
    with warnings.catch_warnings():  # which puts back what shows warnings
        warnings.showwarning = _one_line_warning
        try:
            with stops_recognised():
                code = _carried_out(argv)
            print(end="", flush=True)  # while a closed pipe or a full disk can still be reported
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
                failure = output_error(str(error.filename), error)
                return _failed(str(failure), failure.exit_code)
            _drop_stdout()
            return _failed(f"output cannot be written: {error.strerror or error}", FAILED)


def _carried_out(argv: Sequence[str] | None) -> int:
    words = _joined(sys.argv[1:] if argv is None else argv)
    parser, verbs = _parsers(words)
    try:
        args, unknown = parser.parse_known_args(words)
        if unknown:  # argparse would name the help of the whole command line
            verbs[args.verb].error(f"unrecognized arguments: {' '.join(unknown)}")
    except SystemExit as stop:  # argparse has printed what was wrong, or the help
        return GOOD if not stop.code else WRONG_INPUT
    module, function = args.run.split(".")
    with stops_deferred():  # an import that is interrupted may fail in any way
        _check_numpy()
        carry_out = getattr(importlib.import_module(f".commands.{module}", __package__), function)
    return carry_out(args)


def _joined(words: Sequence[str]) -> list[str]:
    """The same with ``--at -5,3`` as ``--at=-5,3``, which argparse would take for options."""
    found = []
    for word in words:
        if found and found[-1] == "--at" and re.match(r"-[\d.]", word):
            found[-1] = f"--at={word}"
        else:
            found.append(word)
    return found


def _failed(text: str, code: int) -> int:
    print(f"blender-lidar: {one_line(text)}", file=sys.stderr)
    return code


def _open_streams() -> None:
    """Let a stream that whoever started us has closed go nowhere, and what stderr cannot take be lost.

    Else the next file that is opened would take the stream's number, and what libraries print; a run would end because
    the disk with its log is full, or its terminal closed.
    """
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), "r" if name == "stdin" else "w"))
    with suppress(AttributeError):  # no real stream
        encoding = sys.stderr.encoding
        sys.stderr = _Unfailing(sys.stderr.detach(), encoding, "backslashreplace", line_buffering=True)


class _Unfailing(io.TextIOWrapper):
    """A stream of messages, none of which is worth failing for."""

    def write(self, text: str) -> int:
        with suppress(OSError):
            super().write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError):
            super().flush()


def _keep_stdout() -> None:
    """Let what libraries written in C print on stdout, as Blender does when it starts, go to stderr.

    It stays so until the process ends, as they may print what they have buffered only then.
    """
    with suppress(OSError):  # no real files
        ours = os.dup(sys.stdout.fileno())
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        line_by_line = 1 if sys.stdout.isatty() else -1
        sys.stdout = os.fdopen(ours, "w", line_by_line, sys.stdout.encoding, "backslashreplace")


def _drop_stdout() -> None:
    """Let what is still to be written, as Python ends, go nowhere."""
    with suppress(OSError):  # no real file, as in tests
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _parsers(words: Sequence[str]) -> tuple[argparse.ArgumentParser, dict[str, argparse.ArgumentParser]]:
    """The parser of the whole command line, and that of each verb; that of the one that is asked for with options."""
    parser = _OneLineParser(prog="blender-lidar", description=question)
    parser.add_argument("--version", action="version", version=f"blender_lidar {__version__}")
    subparsers = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=_OneLineParser)
    add_verbs(subparsers, VERBS, words)
    return parser, subparsers.choices


def _check_numpy() -> None:
    """Say in one line where NumPy is missing: Debian's Blender takes its packages from an activated environment."""
    try:
        importlib.import_module("numpy")
    except ImportError as error:
        raise MissingExtraError(
            f"no NumPy that works in {sys.prefix}, where this Python looks for it ({type(error).__name__}); "
            "install it there, or, where Blender took an activated virtual environment, run deactivate before Blender"
        ) from error


class _HelpFormatter(argparse.HelpFormatter):
    """Help whose examples keep their lines."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return text if text.startswith("examples:") else super()._fill_text(text, width, indent)


class _OneLineParser(argparse.ArgumentParser):
    """An argument error is one line, like every other; options cannot be abbreviated: a new one changes none."""

    def __init__(self, **settings) -> None:
        super().__init__(**settings, allow_abbrev=False, formatter_class=_HelpFormatter)

    def error(self, message: str):
        print(f"{self.prog}: {one_line(message)} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(WRONG_INPUT)


def _one_line_warning(message, category, filename, lineno, file=None, line=None) -> None:
    print(f"blender-lidar: note: {one_line(str(message))}", file=sys.stderr)
