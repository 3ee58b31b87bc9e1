"""Every verb of the command line and its options, for argparse; the standard library alone, so that help opens at once.

A parser names the function of its verb as ``module.function`` of this room, which is imported when it is run.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

from ..names import CLOUD_SUFFIXES, DATASET_LAYOUTS
from ..scene.settings import TrafficSettings
from ..toml_table import setting, settings_of
from .cloud_options import CommissionOptions, CompareOptions, ScoreOptions, recorded_settings
from .options import SEARCH_OPTIONS, Once, add_moments, add_option, add_options, add_pose, add_scene

SUSTECHPOINTS = "sustechpoints"
_CLOUD_FORMATS = [*(suffix.removeprefix(".") for suffix in CLOUD_SUFFIXES), SUSTECHPOINTS]


def add_verbs(subparsers) -> None:
    """Describe all verbs to argparse."""
    for add in (
        _init,
        _optimise,
        _evaluate,
        _table,
        _stability,
        _chart,
        _scan,
        _detect,
        _dataset,
        _build,
        _render,
        _score,
        _compare,
        _commission,
        _sensors,
        _doctor,
    ):
        add(subparsers)


def _verb(subparsers, words, what, description, *examples, run="") -> argparse.ArgumentParser:
    """The parser of a verb: `words` are its name and what has to follow it, `examples` what may.

    `run` is what carries it out, the function of its module that is called so unless said.
    """
    name, _, must = words.partition(" ")
    usage = f"%(prog)s {must} [options]".replace("  ", " ")
    lines = "".join(f"\n  blender-lidar {name} {example}" for example in examples)
    epilog = f"examples:{lines}" if examples else ""
    also = ["optimize"] if name == "optimise" else []
    parser = subparsers.add_parser(name, aliases=also, help=what, usage=usage, description=description, epilog=epilog)
    parser.set_defaults(run=run or f"{name}.run")
    return parser


def _output(parser: argparse.ArgumentParser, *, resumed: str = "", quick: str = "") -> None:
    """Where results go; whether a run can go on, and what a quick form of it is."""
    add = parser.add_argument_group("output").add_argument
    add("--out", metavar="DIR", help="folder of the results; by default a new one under runs/")
    add("--json", action="store_true", help="print only the content of the result file, on stdout")
    if resumed:
        add("--resume", action="store_true", help=f"go on with the stopped {resumed} in --out DIR")
    if quick:
        add("--quick", action="store_true", help=quick)


# --- A scene of one's own ---------------------------------------------------------------------------------------------


def _init(subparsers) -> None:
    parser = _verb(
        subparsers,
        "init FOLDER --from FORMAT [FILE]",
        "propose a scene for a recording of your own",
        "Propose road, lanes, region and places for poles from where the vehicles of a recording drive, at an "
        "intersection on its map where there is one. Write the scene to FOLDER/scene.toml, and a picture to check it "
        "by eye to FOLDER/scene.png.",
        "my_site --from sumo run.fcd.xml --net site.net.xml --vehicle-types cars.rou.xml",
        "my_site site.sumocfg",
        "my_site trajectories.csv",
        "my_site --from example",
    )
    add = parser.add_argument
    add("folder", metavar="FOLDER", help="a new folder, or one that holds only the recording; nothing is overwritten")
    add("file", nargs="?", metavar="FILE", help="the recording, if it is not given with --from")
    kinds = (
        "format of the recording: ngsim; sumo, the output of --fcd-output, with x and y in metres; table, a CSV with "
        "the columns frame, vehicle_id, class, x_m, y_m, length_m, width_m, height_m, heading_deg and optionally z_m, "
        "time_s, lane; highd, ind, k733 (INTERACTION too) or tgsim, a data set's own table; auto (default) finds it "
        "from the file; example, without FILE, takes the shipped sample"
    )
    add("--from", dest="source", nargs="+", metavar=("FORMAT", "FILE"), help=kinds)
    add("--net", metavar="FILE", help="SUMO net of the site (.net.xml), in the recording's metres; needs sumolib")
    add("--road", metavar="FILE", help="OpenDRIVE of the site (.xodr), in the recording's metres")
    add("--junction", metavar="ID", help="the map's junction to take (default: the one that most vehicles cross)")
    add("--at", metavar="X,Y", help="the place to take, in the map's metres: the junction about it, or the stretch")
    settings = settings_of(TrafficSettings)
    for key in ("period", "location", "vehicle_types"):
        add_option(parser, settings[key], key)


# --- One mounting, or the best one ------------------------------------------------------------------------------------


def _optimise(subparsers) -> None:
    parser = _verb(
        subparsers,
        "optimise SCENE.toml",
        "find the best mounting for a scene",
        "Search the mounting from which the LiDAR perceives the vehicles best, judge it on held-out traffic beside the "
        "baseline, and write a folder of results.",
        "i80",
        "i80 --sensor RS-80 --fidelity auto --out runs/rs80",
        "i80 --installer tilt_deg=1,height_m=0.1",
        run="optimise.run_optimise",
    )
    add_scene(parser)
    _detector(parser)
    _output(parser, resumed="run")


_DETECTIONS = "CSV, or a folder of KITTI's label texts"


def _detector(parser: argparse.ArgumentParser, default: str | None = None) -> None:
    text = "detector to judge on clouds of the held-out frames: pillars, a neural network (PointPillars, trained in "
    text += "simulated roadsides); classical, which is not trained (background subtraction, DBSCAN, L-shapes); "
    text += "FILE.npz, the network with weights of your own; or FILE, detections of your own: "
    text += _DETECTIONS
    text += "" if default is None else " (default %(default)s)"
    parser.add_argument_group("detector").add_argument("--detector", default=default, metavar="NAME", help=text)


def _evaluate(subparsers) -> None:
    parser = _verb(
        subparsers,
        "evaluate SCENE.toml",
        "score one mounting",
        "Score one mounting beside the scene's baseline, on the searched and the held-out frames, and write a folder "
        "of results.",
        "i80 --height 4.1 --tilt-x 19",
        run="optimise.run_evaluate",
    )
    add_scene(parser, leave_out=SEARCH_OPTIONS)
    add_pose(parser)
    _detector(parser)
    _output(parser)


def _table(subparsers) -> None:
    parser = _verb(
        subparsers,
        "table SCENE.toml --setback METRES --height METRES",
        "best tilt and detectable share by setback and height",
        "Tabulate the best tilt and the detectable share of the held-out vehicles for masts at several setbacks from "
        "the road's edge and LiDARs at several heights, one table for each sensor.",
        "i80 --setback 2:10:2 --height 3,4.5,6,8",
        "i80 --setback 2,6 --height 4.5 --sensor RS-16,RS-80",
    )
    add_scene(parser, leave_out=(*SEARCH_OPTIONS, "--pose-error", "--sensor"))
    group = parser.add_argument_group("table")
    values = "metres: 3,4.5,6, or a range 2:10:2, its end included"
    for option, dest, what in (
        ("--setback", "setback", "from the road's edge"),
        ("--height", "heights", "of the LiDAR"),
    ):
        group.add_argument(option, dest=dest, required=True, action=Once, metavar="METRES", help=f"{what}, in {values}")
    names = "models or beam tables, divided by commas (default: the scene's)"
    group.add_argument("--sensor", action=Once, dest="sensors", metavar="NAMES", help=names)
    _output(parser)


# --- Studies ----------------------------------------------------------------------------------------------------------


def _stability(subparsers) -> None:
    parser = _verb(
        subparsers,
        "stability SCENE.toml",
        "how far to trust a mounting: vary one thing at a time",
        "Find out how far a mounting can be trusted, the one that the search finds or the one that is given: change "
        "traffic, installation, metric, sensor and random seed one at a time, and say what the mounting then loses to "
        "the best one.",
        "i80 --quick",
        "i80 --height 4.1 --tilt-x 19",
        run="studies.run_stability",
    )
    add_scene(parser, leave_out=("--fidelity", "--seeds", "--pose-error"))  # it has fidelities and seeds of its own
    add_pose(parser, on_poles=False)
    _add_pole(parser)
    rival = "a metric of yours to choose in the scene's metric's place, as the catalogue's do; may be repeated"
    parser.add_argument("--rival", dest="rivals", action="append", metavar="FILE.py:NAME", help=rival)
    _output(parser, resumed="study", quick="few frames, coarse grids, short searches")


def _add_pole(parser) -> None:
    parser.add_argument(
        "--pole", metavar="NAME", help="of a scene with candidate poles, the one that the study is about"
    )


def _chart(subparsers) -> None:
    parser = _verb(
        subparsers,
        "chart SCENE.toml",
        "speed and accuracy of cheaper models of a scene, for developers",
        "Compare cheaper models of a scene (less vehicle detail, fewer beams and frames) with the full one, in time "
        "and in the mounting that they choose; name the cheapest one within --max-regret, and the parts of the model "
        "that change the choice. For developers of the model: nobody needs it to hang a LiDAR.",
        "i80 --quick",
        "i80 --max-regret 0.5% --sensor RS-80",
        run="studies.run_chart",
    )
    add_scene(parser, leave_out=(*SEARCH_OPTIONS, "--installer", "--pose-error"))
    _add_pole(parser)
    said = "of several LiDARs, folder of a run on whose poles the study has them"
    parser.add_argument("--run", dest="of_run", action=Once, metavar="DIR", help=said)
    add = parser.add_argument_group("chart").add_argument
    regret = "share of the gain over the baseline that a cheaper model may cost, above 0 up to 100%%: 1%% or 0.01 "
    regret += "(default 1%%)"
    add("--max-regret", default="1%", metavar="SHARE", help=regret)
    _output(parser, resumed="study", quick="ten frames, fewer mountings and draws")


# --- Frames as clouds, in Blender and as pictures ---------------------------------------------------------------------


def _scan(subparsers) -> None:
    parser = _verb(
        subparsers,
        "scan SCENE.toml --frame K --out CLOUD",
        "write the point clouds of frames",
        "Simulate one revolution of the LiDAR in a frame and write the point cloud: .npz (all attributes), .pcd, .ply, "
        ".las, .laz, or KITTI's .bin with its .label. With --frame-ids write a folder of clouds, one for each frame. "
        "Of several LiDARs write the fused cloud, and beside it CLOUD_NAME of each in its own frame; .bin and "
        "sustechpoints, whose frame is a sensor's, have the fused cloud in that of the first LiDAR.",
        "i80 --frame 1000 --height 4.1 --tilt-x 19 --out cloud.pcd",
        "i80 --frame-ids 100:1000:100 --format sustechpoints --out clouds",
        run="scan.run_scan",
    )
    add_moments(parser, many="many frames")
    add = parser.add_argument_group("output").add_argument
    out = "file to write, its suffix is the format; with --frame-ids a folder"
    add("--out", required=True, metavar="CLOUD", help=out)
    of_folder = f"format of the files in the folder (default npz); {SUSTECHPOINTS} adds labels"
    add("--format", choices=_CLOUD_FORMATS, help=of_folder)


def _detect(subparsers) -> None:
    parser = _verb(
        subparsers,
        "detect SCENE.toml|DATASET|CLOUDS",
        "judge a detector at a mounting",
        "Let a detector find the vehicles of the held-out frames at a mounting and at the baseline, and write recall, "
        "precision and average precision with paired intervals, the boxes as CSV and as KITTI's labels, and a picture "
        "of one frame; of several LiDARs each one alone, their boxes merged, and their points merged. Given a data "
        "set, judge the detector on its validation scans, each from its mounting. Given a "
        "folder of clouds, those of scan or with --pose or --commission of a recording, write the boxes that the "
        "detector finds, and with --boxes judge them.",
        "i80 --height 4.5 --tilt-x 23",
        "i80 --height 4.5 --tilt-x 23 --detector classical",
        "i80 --height 4.5 --tilt-x 23 --detector my_detections.csv",
        "i80_set --detector my_label_2",
        "clouds --out boxes",
        "sweeps --axes flu --pose 0 0 4.1 0 0 0 --out boxes",
        "sweeps --commission found --detector classical --boxes boxes.csv",
    )
    add_scene(parser, leave_out=(*SEARCH_OPTIONS, "--metric", "--reading", "--cluster", "--installer"))
    add_pose(parser)
    _detector(parser, "pillars")
    clouds = parser.add_argument_group(
        "a folder of recorded clouds, whose names end with the numbers of their frames; --sensor names theirs"
    )
    for key, declared in recorded_settings().items():
        add_option(clouds, declared, key)
    _output(parser)


@dataclass(frozen=True, slots=True)
class DatasetOptions:
    """Which scans a data set has, and in which layouts it is written.

    Attributes
    ----------
    mountings : int
        Number of random mountings within [deployment].
    scans : int or None
        Number of scans; by default each frame once from each mounting.
    layouts : tuple of str or None
        Layout of the files (default npz); may be repeated.
    as_recorded : bool
        Leave the traffic where it was recorded: neither move it along the road nor mirror it.
    """

    mountings: int = setting(20, low=1, high=100_000, option="--mountings", metavar="N")
    scans: int | None = setting(None, low=1, high=1_000_000, option="--scans", metavar="N")
    layouts: tuple[str, ...] | None = setting(None, allowed=DATASET_LAYOUTS, option="--layout")
    as_recorded: bool = setting(False, option="--as-recorded")


def _dataset(subparsers) -> None:
    parser = _verb(
        subparsers,
        "dataset SCENE.toml",
        "labelled clouds to train and judge detectors with",
        "Scan frames of the traffic from random mountings, at random places along the road, half of them mirrored, and "
        "write clouds with boxes, point counts and visibility. Searched frames are for training, held-out ones for "
        "validation; no vehicle is labelled in both. To continue after a stop give the same command again.",
        "i80 --mountings 20 --out i80_set",
        "i80 --frames 50 --mountings 50 --scans 2500 --layout kitti --layout nuscenes --out i80_set",
    )
    add_scene(parser, leave_out=(*SEARCH_OPTIONS, "--metric", "--reading", "--cluster", "--installer"))
    add_options(parser, DatasetOptions, {"data set": tuple(settings_of(DatasetOptions))})
    _output(parser)


def _build(subparsers) -> None:
    parser = _verb(
        subparsers,
        "build SCENE.toml --frame K --out FILE.blend",
        "write a scene as a .blend file",
        "Build one frame's road, vehicles, LiDAR and point cloud in Blender and write them as a .blend file. With "
        "--frame-ids make an animation of these frames, with the cloud of the first.",
        "i80 --frame 1000 --height 4.1 --tilt-x 19 --out scene.blend",
        run="scan.run_build",
    )
    add_moments(parser, many="an animation")
    add = parser.add_argument_group("output").add_argument
    add("--no-cloud", action="store_true", help="leave the point cloud out")
    add("--detections", metavar="FILE", help=f"show these detections as wire boxes: {_DETECTIONS}")
    add("--out", required=True, metavar="FILE.blend", help="the file to write")


def _render(subparsers) -> None:
    parser = _verb(
        subparsers,
        "render RUN_DIR",
        "render a run's mountings with their clouds, by Cycles",
        "Render the baseline and the mounting of a run with their point clouds, from above and from the pole, into the "
        "run's folder, and add the pictures to its report.html. Points on a vehicle go from red to green with the "
        "vehicle's entropy.",
        "runs/i80_rs-16",
        run="scan.run_render",
    )
    parser.add_argument("folder", metavar="RUN_DIR", help="folder of a run that has ended")
    frame = "number of the frame; by default the searched one with the most vehicles, or the most detections"
    parser.add_argument("--frame", type=int, metavar="K", help=frame)
    samples = "light paths per pixel, 1 to 4096; more is smoother and slower"
    parser.add_argument("--samples", type=int, metavar="N", help=samples)
    style = "day, the scene; points, the clouds alone on black; both (default)"
    parser.add_argument("--style", choices=("day", "points", "both"), default="both", help=style)
    shown = "show these detections as wire boxes, and those of the baseline if NAME_baseline is in the same folder: "
    parser.add_argument("--detections", metavar="FILE", help=shown + _DETECTIONS)


# --- Clouds and metrics without a simulation, and beside reality ------------------------------------------------------


def _score(subparsers) -> None:
    parser = _verb(
        subparsers,
        "score --points CLOUD --boxes BOXES.csv",
        "score the vehicles of a labelled cloud",
        "Score the vehicles of a point cloud with known boxes: PE-VGOP of each vehicle, and other metrics on request.",
        "--points cloud.npz --boxes runs/i80_rs-16/vehicles.csv --frame 1000",
        "--points sweep.pcd --boxes boxes.csv --assign box --metric all",
    )
    groups = {
        "what is scored": ("points", "boxes", "frame", "axes", "pose", "accept", "assign", "clearance_m", "lidar_xy"),
        "metric": ("cell_m", "threshold", "view", "metrics"),
        "output": ("out", "json"),
    }
    add_options(parser, ScoreOptions, groups)


def _compare(subparsers) -> None:
    parser = _verb(
        subparsers,
        "compare --points CLOUD --boxes BOXES --sensor NAME",
        "a recorded, labelled cloud beside its simulation",
        "Compare recorded vehicles with simulated ones: the points of each labelled vehicle in a recorded cloud, and "
        "the points that the simulated sensor gets from it at the same place.",
        "--points sweep.pcd --boxes boxes.csv --sensor RS-80 --height 4.1 --tilt-x 9",
        "--points sweep.pcd --boxes boxes.csv --sensor RS-80 --height 4.1 --distance 10 50 --losses dropout=0.05",
        "--points sweep.pcd --boxes labels --commission found --losses none --losses range_at_10_percent_m=160",
    )
    groups = {
        "what is compared": ("points", "boxes", "commission", "frames", "accept", "classes", "distance_m"),
        "sensor": ("sensor", "rotation_hz", "x_m", "y_m", "height_m", "tilt_x_deg", "tilt_y_deg", "yaw_deg"),
        "simulation": ("details", "losses", "label_margin_m", "clearance_m", "caster"),
        "output": ("out", "json"),
    }
    add_options(parser, CompareOptions, groups)


def _commission(subparsers) -> None:
    parser = _verb(
        subparsers,
        "commission CLOUD",
        "sensor and mounting of a LiDAR that hangs, from its own clouds",
        "Tell from recorded clouds of a LiDAR at a straight road which sensor it is, how high it hangs, how it leans "
        "against the road, and what that costs beside the plan.",
        "revolution.pcd",
        "frame_*.bin --axes flu --run runs/i80_rs-16",
    )
    parser.add_argument("clouds", nargs="+", metavar="CLOUD", help="clouds of one mounting, each in its own file")
    plan = parser.add_argument_group("plan").add_argument
    said = "folder of the run that planned the mounting: tell how the LiDAR hangs beside its plan, and what that costs"
    plan("--run", dest="of_run", action=Once, metavar="RUN_DIR", help=said)
    plan("--lidar", action=Once, metavar="NAME", help="which LiDAR of a run of several it is")
    add_options(
        parser, CommissionOptions, {"cloud": ("sensor", "axes", "origin", "drives_on"), "output": ("out", "json")}
    )


# --- What there is ----------------------------------------------------------------------------------------------------


def _sensors(subparsers) -> None:
    parser = _verb(
        subparsers,
        "sensors [NAME]",
        "list the LiDAR models, or show one with its beam fan",
        "List the LiDAR models; with NAME show one in full, with its beam fan and its table of rings.",
        "RS-16",
        "own_sensor.csv --out fan.png",
    )
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="a model's name or alias, or the path of a .toml or .csv"
    )
    add = parser.add_argument_group("output").add_argument
    add("--json", action="store_true", help="print only JSON, on stdout")
    add("--out", metavar="PNG", help="draw NAME's beam fan into this file")


def _doctor(subparsers) -> None:
    _verb(
        subparsers,
        "doctor",
        "check the installation",
        "Show what is installed, and check every ray caster on a wall at known distances.",
    )
