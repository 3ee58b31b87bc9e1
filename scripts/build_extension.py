"""Build the Blender extension: one zip for the installer of Blender 4.2 and later, and for 3.4's add-ons.

    python scripts/build_extension.py --out dist
    python scripts/build_extension.py --out dist --fast --platform linux-x64 --python 3.11

The light one needs nothing but the NumPy that Blender has, on every platform. A fast one brings the wheels of numba and
embreex for one platform and one Python: 3.11 for Blender 4.2 to 5.0, 3.13 from 5.1 on. Where bpy is installed,
Blender's own tool validates what is built.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import zipfile
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from blender_lidar import __version__, bl_info  # noqa: E402
from blender_lidar.toml_table import to_toml  # noqa: E402

NAME = "blender_lidar"
KEPT = (".py", ".toml", ".css", ".gz", ".npz")
WHEELS = ("numba", "llvmlite", "embreex")
# What pip calls each of Blender's platforms, the newest first.
PLATFORMS = {
    "linux-x64": [f"manylinux_2_{minor}_x86_64" for minor in (34, 28, 27, 17)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{major}_0_arm64" for major in (14, 13, 12, 11)],
}


def manifest(wheels: list[Path], platform: str | None) -> str:
    """The content of blender_manifest.toml, whose keys all stand before its one table."""
    keys = {
        "schema_version": "1.0.0",
        "id": NAME,
        "version": __version__,
        "name": bl_info["name"],
        "tagline": "Finds where a roadside LiDAR should hang",
        "maintainer": bl_info["author"],
        "type": "add-on",
        "website": bl_info["doc_url"],
        "copyright": [f"2026 {bl_info['author']}"],
        "license": ["SPDX:GPL-3.0-or-later"],
        "blender_version_min": "4.2.0",
        "tags": ["3D View", "Object"],
    }
    if wheels:
        keys |= {"platforms": [platform], "wheels": [f"./wheels/{wheel.name}" for wheel in wheels]}
    lines = to_toml({"keys": keys}).partition("\n")[2]
    permissions = {"files": "Read traffic and beam tables, write clouds and results"}
    return f"{lines}\n{to_toml({'permissions': permissions})}"


def package_files() -> dict[str, Path]:
    """What goes into the zip from the checkout, by path within it: the package as the wheel has it."""
    found = {
        f"{NAME}/{path.relative_to(ROOT / NAME).as_posix()}": path
        for path in sorted((ROOT / NAME).rglob("*"))
        if path.suffix in KEPT and "__pycache__" not in path.parts
    }
    scenes = sorted(path for path in (ROOT / "scenes").iterdir() if path.suffix in KEPT)
    return found | {f"{NAME}/scenes/{path.name}": path for path in scenes} | {f"{NAME}/LICENSE": ROOT / "LICENSE"}


def wheels_for(platform: str, python: str, folder: Path) -> list[Path]:
    """The wheels of a fast extension, downloaded into a folder."""
    tags = [part for tag in PLATFORMS[platform] for part in ("--platform", tag)]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
    command += ["--python-version", python, *tags, "--dest", str(folder), *WHEELS]
    if subprocess.run(command, check=False).returncode:
        raise SystemExit(f"no wheels of {', '.join(WHEELS)} for {platform} and Python {python}")
    return sorted(folder.glob("*.whl"))


def build(out: Path, fast: bool, platform: str, python: str) -> Path:
    """Write the zip; returns its path."""
    out.mkdir(parents=True, exist_ok=True)
    suffix = f"-fast-{platform}-py{python.replace('.', '')}" if fast else ""
    made = out / f"{NAME}-{__version__}{suffix}.zip"
    with tempfile.TemporaryDirectory() as folder:
        wheels = wheels_for(platform, python, Path(folder)) if fast else []
        part = made.with_suffix(".part")
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as packed:
            packed.writestr(f"{NAME}/blender_manifest.toml", manifest(wheels, platform))
            for name, path in package_files().items():
                packed.write(path, name)
            for wheel in wheels:
                packed.write(wheel, f"{NAME}/wheels/{wheel.name}", zipfile.ZIP_STORED)
        part.replace(made)
    return made


def validated(made: Path) -> str:
    """What Blender's own tool says of the zip; empty where bpy is not installed."""
    spec = find_spec("bpy")
    tools = (
        [] if spec is None else sorted(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    )
    if not tools:
        return ""
    run = subprocess.run([sys.executable, tools[0], "validate", made], capture_output=True, text=True, check=False)
    text = re.sub(r"\s+", " ", f"{run.stdout} {run.stderr}").strip()
    if run.returncode:
        raise SystemExit(f"{made}: Blender's tool refuses it: {text}")
    return text


def main(argv: list[str] | None = None) -> int:
    """Build, validate, and say what was made."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the zip")
    parser.add_argument("--fast", action="store_true", help="with the wheels of numba and embreex")
    parser.add_argument("--platform", choices=PLATFORMS, default="linux-x64", help="of the wheels")
    parser.add_argument("--python", choices=("3.11", "3.13"), default="3.11", help="of the wheels")
    args = parser.parse_args(argv)
    made = build(args.out, args.fast, args.platform, args.python)
    found = validated(made)
    print(f"{made}: {made.stat().st_size / 1e6:.1f} MB; {found or 'not validated: bpy is not installed'}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
