"""Every LiDAR of a .blend file scanned over a range of frames, from within Blender, into NAME_bake beside the file:

blender --background FILE.blend --python-exit-code 1 --python scripts/bake.py -- --start 1 --end 48 --format ply

The module bpy takes the file after the script. Frames that are baked already, of the same settings, are kept.
"""

import argparse
import importlib
import signal
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # Blender's own Python need not have the package installed

import bpy


def package():
    """Name of the package whose add-on is enabled, else of ours, whose add-on is enabled then."""
    group = getattr(bpy.context.scene, "blender_lidar", None)
    if group is not None:
        return type(group).__module__.rpartition(".addon.")[0]
    import blender_lidar
    from blender_lidar.addon import handlers

    blender_lidar.register()
    handlers.on_load()
    return "blender_lidar"


def main(words):
    """Bake as the arguments say; returns the exit code: 0 good, 1 failed, 2 wrong input."""
    parser = argparse.ArgumentParser(prog="bake.py", description=__doc__.partition(":")[0])
    parser.add_argument("file", nargs="?", help=".blend file; the open one if left out")
    parser.add_argument("--start", type=int, help="first frame; the scene's if left out")
    parser.add_argument("--end", type=int, help="last frame; the scene's if left out")
    parser.add_argument("--step", type=int, default=1, help="from frame to frame; 1 if left out")
    parser.add_argument("--format", choices=("ply", "pcd"), default="ply", help="of the files; ply if left out")
    args = parser.parse_args(words)
    errors, files, stops, progress, baking = (
        importlib.import_module(f"{package()}.{name}")
        for name in ("errors", "files", "signals", "commands.progress", "addon.baking")
    )
    signal.signal(signal.SIGINT, signal.default_int_handler)  # Blender has one of its own
    try:
        with stops.stops_watched():
            if args.file is not None:
                with files.reading(args.file, "a .blend file"):
                    files.read_file(args.file, 1)
                try:
                    bpy.ops.wm.open_mainfile(filepath=str(Path(args.file).resolve()))
                except RuntimeError as error:
                    raise errors.InputError(f"{args.file}: this Blender cannot read it") from error
            bake(args, baking, progress, errors, stops)
    except errors.BlenderLidarError as error:
        print(f"blender-lidar: {errors.one_line(str(error))}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("blender-lidar: stopped; start it again to go on", file=sys.stderr)
        return 1
    return 0


def bake(args, baking, progress, errors, stops):
    """Bake the open file."""
    scene = bpy.context.scene
    if args.step < 1:
        raise errors.InputError(f"--step: is {args.step}; allowed: at least 1")
    own = scene.frame_start, scene.frame_end
    first, last = (of if given is None else given for given, of in zip((args.start, args.end), own, strict=True))
    if first > last:
        raise errors.InputError(f"frames {first} to {last}; allowed: a first one that is not after the last")
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, first, last
    scene.frame_step, scene.blender_lidar.bake_format = args.step, f".{args.format}"
    steps = baking.steps(scene)
    shown = progress.Progress(int(next(steps).split()[0]), "bake")
    line = ""
    while line is not None:
        with stops.stops_deferred():  # Blender swallows what is raised within its handlers
            line = next(steps, None)
        if line is not None:
            shown.advance(1, line)
    shown.close()
    print(f"{Path(bpy.data.filepath).stem}_bake: frames {first} to {last}")


if __name__ == "__main__":
    sys.exit(main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]))
