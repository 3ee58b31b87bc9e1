"""What the scripts here have in common: their options, options in a scene's place, and errors in one line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from blender_lidar.commands.progress import Progress
from blender_lidar.errors import BlenderLidarError
from blender_lidar.optimise import Search
from blender_lidar.signals import stops_recognised

SCENES = Path(__file__).parents[2] / "scenes"
# Option -> the scene's setting that it replaces, in the scripts that have it.
SETTINGS = {
    "sensor": ("sensor", "name"),
    "traffic": ("traffic", "path"),
    **{name: ("traffic", name) for name in ("period", "location", "frames")},
    "reading": ("objective", "reading"),
    "search": ("search", "method"),
    "seed": ("search", "seed"),
    **{name: ("model", name) for name in ("caster", "workers", "cluster")},
}


def parser_of(text: str, scene: Path | None = None) -> argparse.ArgumentParser:
    """A parser with a module's docstring; where there is a default `scene`, it is the first argument."""
    parser = argparse.ArgumentParser(
        description=text, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    if scene is not None:
        parser.add_argument("scene", nargs="?", default=str(scene), metavar="SCENE.toml")
    return parser


def positive(text: str) -> int:
    """A whole number from 1."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"is {text!r}; allowed: a whole number from 1")
    return int(text)


def overrides_of(args: argparse.Namespace) -> dict:
    """Those of `SETTINGS` that were given, in the place of a scene's settings as `load_scenario` takes them."""
    given = {name: getattr(args, name, None) for name in SETTINGS}
    return {SETTINGS[name]: (value, f"--{name}") for name, value in given.items() if value is not None}


@contextmanager
def counting(total: int, what: str) -> Iterator[Callable[..., None]]:
    """Shows progress on stderr: what it gives is called with steps, and perhaps a note, as they are done."""
    progress = Progress(total, what)
    try:
        yield progress.advance
    finally:
        progress.close()


def run_script(name: str, work: Callable[[], object]) -> int:
    """Do the work; the exit code. Bad input and Ctrl-C are one line."""
    try:
        with stops_recognised():
            work()
    except BlenderLidarError as error:
        print(f"{name}: {' '.join(str(error).split())}", file=sys.stderr)
        return error.exit_code
    except ModuleNotFoundError as error:
        print(f'{name}: {error}: pip install -e ".[fast,plots,study,detect]"', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"{name}: stopped", file=sys.stderr)
        return 1
    return 0


class Silent:
    """A `run.replay.Listener` that shows nothing."""

    def searching(self, search: Search) -> None:
        """Nothing is shown."""

    def mapping(self, points: int) -> None:
        """Nothing is shown."""
