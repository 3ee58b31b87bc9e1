"""blender-lidar render: pictures of a run's mountings, each with the cloud that it sees."""

from __future__ import annotations

import argparse
from contextlib import closing

import numpy as np

from ..errors import InputError
from ..moments import mounted_sensor
from ..provenance import check_same_inputs
from ..reporting.page import write_report
from ..reporting.pictures import RENDER_VIEWS, render_file
from ..reporting.stored_run import read_run
from ..results import VEHICLES, RunFolder
from ..scenario import load_scenario
from ..study.site import frame_of, read_recording
from ..world.needs_blender import blender_room
from .progress import Progress

_MOST_SAMPLES = 4096


def add_parser(subparsers) -> None:
    """Describe the verb to argparse."""
    parser = subparsers.add_parser(
        "render",
        help="pictures of a run's mountings with their clouds, by Cycles",
        description="Render the baseline and the mounting of a run with the clouds that they see, from above and from "
        "the pole, into the run's folder, and gather them in its report.html. Points on a vehicle go from red to green "
        "with the vehicle's entropy.",
    )
    parser.add_argument("folder", metavar="RUN_DIR", help="folder of a run that has ended")
    parser.add_argument("--frame", type=int, metavar="K", help="frame number; by default the fullest searched one")
    parser.add_argument("--samples", type=int, metavar="N", help="light paths per pixel; more is smoother and slower")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Carry it out; returns the exit code."""
    folder = RunFolder(args.folder)
    result = read_run(folder).result
    building, rendering = (blender_room(name, "render") for name in ("scene", "render"))
    samples = rendering.SAMPLES if args.samples is None else args.samples
    if not 1 <= samples <= _MOST_SAMPLES:
        raise InputError(f"--samples: is {samples}; allowed: 1 to {_MOST_SAMPLES}")
    scenario = load_scenario(folder.scene)
    check_same_inputs(scenario, result["identity"])
    recording = read_recording(scenario)
    number = _fullest_frame(folder) if args.frame is None else args.frame
    vehicles = frame_of(recording, number, "--frame")
    mounts = {"baseline": result["baseline"]["deployment"], "optimised": result["deployment"]}
    written = []
    with folder.locked(), closing(Progress(len(mounts) * len(RENDER_VIEWS), "render")) as progress:
        for name, mount in mounts.items():
            scene = building.empty_scene()
            building.build_scene(scene, mounted_sensor(scenario, mount).moment(vehicles))
            for view in RENDER_VIEWS:
                written.append(folder.file(render_file(name, view)))
                rendering.render_picture(
                    written[-1], scene, rendering.CAMERAS[view], size=rendering.SIZE, samples=samples
                )
                progress.advance(1)
        written.append(write_report(folder))
    print(f"frame {number}: " + ", ".join(map(str, written)))
    return 0


def _fullest_frame(folder: RunFolder) -> int:
    """The searched frame with the most counted vehicles."""
    table = folder.read_vehicles(VEHICLES)
    frames, counts = np.unique(table["frame"][table["split"] == "search"], return_counts=True)
    return int(frames[counts.argmax()])
