"""Every verb of the command line, declared: what it is called, what carries it out, and its options.

The docstring of its options is its help: what it does, in a line and in a paragraph, and examples.
The standard library alone, so that help opens at once.
"""

from __future__ import annotations

from functools import partial

from ..names import CLOUD_SUFFIXES, DATASET_LAYOUTS
from ..scene.settings import TrafficSettings
from .cloud_options import CommissionOptions, CompareOptions, Output, RecordedOptions, ScoreOptions
from .parsers import Verb, option, option_of, options, parse_frames, parse_place, parse_range, parse_share

SUSTECHPOINTS = "sustechpoints"
_HIGHEST_M, _FARTHEST_M = 30.0, 60.0  # of a table
_FORMATS = (*(suffix.removeprefix(".") for suffix in CLOUD_SUFFIXES), SUSTECHPOINTS)

# --- What verbs share -------------------------------------------------------------------------------------


@options
class OfScene:
    """The scene, whose settings further options replace."""

    scene: str = option(
        "SCENE.toml", "scene file, or the name of a shipped scene: i80; options replace what the file says", ...
    )


@options
class OfFrames(OfScene):
    """Frames of its traffic."""

    frame: int | None = option("--frame K", "number of the frame in the recording", group="frames, one or many")
    sequence: list[int] | None = option(
        "--frame-ids IDS", "many frames: 100,150 or 100:160:5 (its end included)", read=parse_frames
    )


@options
class OfMounting(OfScene):
    """Where its LiDARs hang, besides by coordinates."""

    pole: str | None = option("--pole NAME", "candidate pole of the scene on which the LiDAR hangs", group="mounting")
    lidar: tuple[str, ...] | None = option(
        "--lidar NAME,...",
        "of a scene with several LiDARs, where one hangs: its name and coordinates, north,height_m=4.1,pole=NE; "
        "what is not given is as its table fixes it, else its baseline's; may be repeated",
    )
    of_run: str | None = option("--run DIR", "folder of a run whose mountings are taken, in place of coordinates")


@options
class Resumed(Output):
    """Results that a stopped run has begun."""

    resume: bool = option("--resume", "go on with what was stopped in --out DIR", False)


@options
class Detected:
    """A detector."""

    detector: str | None = option(
        "--detector NAME",
        "detector to judge on clouds of the held-out frames: pillars, a neural network (PointPillars, trained in "
        "simulated roadsides); classical, which is not trained (background subtraction, DBSCAN, L-shapes); "
        "FILE.npz, the network with weights of your own; or FILE, detections of your own: CSV, or a folder of "
        "KITTI's label texts",
        group="detector",
    )


# --- A scene of one's own, one mounting, and the best one -------------------------------------------------


@options
class InitOptions:
    """Propose a scene for a recording of your own.

    Propose road, lanes, region and places for poles from where the vehicles of a recording drive, at an intersection on
    its map where there is one. Write the scene to FOLDER/scene.toml, and a picture to check it by eye to
    FOLDER/scene.png.

    Examples
    --------
    my_site --from sumo run.fcd.xml --net site.net.xml --vehicle-types cars.rou.xml
    my_site site.sumocfg
    my_site trajectories.csv
    my_site --from example
    """

    folder: str = option("FOLDER", "a new folder, or one that holds only the recording; nothing is overwritten", ...)
    file: str | None = option("FILE", "the recording, if it is not given with --from")
    source: tuple[str, ...] | None = option(
        "--from FORMAT FILE",
        "format of the recording: ngsim; sumo, the output of --fcd-output, with x and y in metres; table, a CSV "
        "with the columns frame, vehicle_id, class, x_m, y_m, length_m, width_m, height_m, heading_deg and "
        "optionally z_m, time_s, lane; highd, ind, k733 (INTERACTION too) or tgsim, a data set's own table; auto "
        "(default) finds it from the file; example, without FILE, takes the shipped sample",
    )
    net: str | None = option(
        "--net", "SUMO net of the site (.net.xml), in the recording's metres; needs sumolib", is_path=True
    )
    road: str | None = option("--road", "OpenDRIVE of the site (.xodr), in the recording's metres", is_path=True)
    junction: str | None = option(
        "--junction ID", "the map's junction to take (default: the one that most vehicles cross)"
    )
    at: tuple[float, float] | None = option(
        "--at X,Y", "the place to take, in the map's metres: the junction about it, or the stretch", read=parse_place
    )
    period: str | None = option_of(TrafficSettings, "period")
    location: str | None = option_of(TrafficSettings, "location")
    vehicle_types: tuple[str, ...] | None = option_of(TrafficSettings, "vehicle_types")


@options
class OptimiseOptions(Detected, Resumed, OfScene):
    """Find the best mounting for a scene.

    Search the mounting from which the LiDAR perceives the vehicles best, judge it on held-out traffic beside the
    baseline, and write a folder of results.

    Examples
    --------
    i80
    i80 --sensor RS-80 --fidelity auto --out runs/rs80
    i80 --installer tilt_deg=1,height_m=0.1
    """


@options
class EvaluateOptions(Detected, Output, OfMounting):
    """Score one mounting.

    Score one mounting beside the scene's baseline, on the searched and the held-out frames, and write a folder of
    results.

    Examples
    --------
    i80 --height 4.1 --tilt-x 19
    """


@options
class ReportOptions:
    """Print what a finished run has come to.

    Print the answer of a finished run again: where to hang the LiDAR, what that is worth and what to know first.

    Examples
    --------
    runs/i80_rs-16
    runs/i80_rs-16 --all
    """

    folder: str = option("RUN", "folder of a run", ...)
    all: bool = option("--all", "also all tables, notes, assumptions and meanings of words", False)
    json: bool = option("--json", "print only the content of the result file, on stdout", False)


@options
class TableOptions(Output, OfScene):
    """Best tilt and detectable share by setback and height.

    Tabulate the best tilt and the detectable share of the held-out vehicles for masts at several setbacks from the
    road's edge and LiDARs at several heights, one table for each sensor.

    Examples
    --------
    i80 --setback 2:10:2 --height 3,4.5,6,8
    i80 --setback 2,6 --height 4.5 --sensor RS-16,RS-80
    """

    setback: tuple[float, ...] = option(
        "--setback METRES",
        "from the road's edge, in metres: 3,4.5,6, or a range 2:10:2, its end included",
        ...,
        read=partial(parse_range, most=_FARTHEST_M),
        group="table",
    )
    heights: tuple[float, ...] = option(
        "--height METRES",
        "of the LiDAR, in metres: 3,4.5,6, or a range 2:10:2, its end included",
        ...,
        read=partial(parse_range, most=_HIGHEST_M),
    )
    sensors: str | None = option("--sensor NAMES", "models or beam tables, divided by commas (default: the scene's)")


# --- Studies ----------------------------------------------------------------------------------------------


@options
class StabilityOptions(Resumed, OfMounting):
    """How far to trust a mounting: vary one thing at a time.

    Find out how far a mounting can be trusted, the one that the search finds or the one that is given: change traffic,
    installation, metric, sensor and random seed one at a time, and say what the mounting then loses to the best one.

    Examples
    --------
    i80 --quick
    i80 --height 4.1 --tilt-x 19
    """

    rivals: tuple[str, ...] | None = option(
        "--rival FILE.py:NAME",
        "a metric of yours to choose in the scene's metric's place, as the catalogue's do; may be repeated",
        group="",
    )
    quick: bool = option("--quick", "few frames, coarse grids, short searches", False, group="output")


@options
class ChartOptions(Resumed, OfScene):
    """Speed and accuracy of cheaper models of a scene, for developers.

    Compare cheaper models of a scene (less vehicle detail, fewer beams and frames) with the full one, in time and in
    the mounting that they choose; name the cheapest one within --max-regret, and the parts of the model that change the
    choice. For developers of the model: nobody needs it to hang a LiDAR.

    Examples
    --------
    i80 --quick
    i80 --max-regret 0.5% --sensor RS-80
    """

    pole: str | None = option(
        "--pole NAME", "of a scene with candidate poles, the one that the study is about", group=""
    )
    of_run: str | None = option("--run DIR", "of several LiDARs, folder of a run on whose poles the study has them")
    max_regret: float = option(
        "--max-regret SHARE",
        "share of the gain over the baseline that a cheaper model may cost, above 0 up to 100%: 1% or 0.01",
        0.01,
        read=parse_share,
        group="chart",
    )
    quick: bool = option("--quick", "ten frames, fewer mountings and draws", False, group="output")


# --- Frames as clouds, in Blender and as pictures ---------------------------------------------------------


@options
class ScanOptions(OfMounting, OfFrames):
    """Write the point clouds of frames.

    Simulate one revolution of the LiDAR in a frame and write the point cloud: .npz (all attributes), .pcd, .ply, .las,
    .laz, or KITTI's .bin with its .label. With --frame-ids write a folder of clouds, one for each frame. Of several
    LiDARs write the fused cloud, and beside it CLOUD_NAME of each in its own frame; .bin and sustechpoints, whose frame
    is a sensor's, have the fused cloud in that of the first LiDAR.

    Examples
    --------
    i80 --frame 1000 --height 4.1 --tilt-x 19 --out cloud.pcd
    i80 --frame-ids 100:1000:100 --format sustechpoints --out clouds
    """

    out: str = option(
        "--out CLOUD", "file to write, its suffix is the format; with --frame-ids a folder", ..., group="output"
    )
    format: str | None = option(
        "--format", "format of the files in the folder (default npz); sustechpoints adds labels", allowed=_FORMATS
    )


@options
class DetectOptions(RecordedOptions, Detected, Output, OfMounting):
    """Judge a detector at a mounting.

    Let a detector find the vehicles of the held-out frames at a mounting and at the baseline, and write recall,
    precision and average precision with paired intervals, the boxes as CSV and as KITTI's labels, and a picture of one
    frame; of several LiDARs each one alone, their boxes merged, and their points merged. Given a data set, judge the
    detector on its validation scans, each from its mounting. Given a folder of clouds, those of scan or with --pose or
    --commission of a recording, write the boxes that the detector finds, and with --boxes judge them.

    Examples
    --------
    i80 --height 4.5 --tilt-x 23
    i80 --height 4.5 --tilt-x 23 --detector classical
    i80 --height 4.5 --tilt-x 23 --detector my_detections.csv
    i80_set --detector my_label_2
    clouds --out boxes
    sweeps --axes flu --pose 0 0 4.1 0 0 0 --out boxes
    sweeps --commission found --detector classical --boxes boxes.csv
    """

    detector: str = option_of(Detected, "detector", default="pillars")


@options
class DatasetOptions(Output, OfScene):
    """Labelled clouds to train and judge detectors with.

    Scan frames of the traffic from random mountings, at random places along the road, half of them mirrored, and write
    clouds with boxes, point counts and visibility. Searched frames are for training, held-out ones for validation; no
    vehicle is labelled in both. To continue after a stop give the same command again.

    Examples
    --------
    i80 --mountings 20 --out i80_set
    i80 --frames 50 --mountings 50 --scans 2500 --layout kitti --layout nuscenes --out i80_set
    """

    mountings: int = option(
        "--mountings N", "number of random mountings within [deployment]", 20, low=1, high=100_000, group="data set"
    )
    scans: int | None = option(
        "--scans N", "number of scans; by default each frame once from each mounting", low=1, high=1_000_000
    )
    layouts: tuple[str, ...] | None = option(
        "--layout", "layout of the files (default npz); may be repeated", allowed=DATASET_LAYOUTS
    )
    as_recorded: bool = option(
        "--as-recorded", "leave the traffic where it was recorded: neither move it along the road nor mirror it", False
    )


@options
class BuildOptions(OfMounting, OfFrames):
    """Write a scene as a .blend file.

    Build one frame's road, vehicles, LiDAR and point cloud in Blender and write them as a .blend file. With --frame-ids
    make an animation of these frames, with the cloud of the first.

    Examples
    --------
    i80 --frame 1000 --height 4.1 --tilt-x 19 --out scene.blend
    """

    no_cloud: bool = option("--no-cloud", "leave the point cloud out", False, group="output")
    detections: str | None = option(
        "--detections",
        "show these detections as wire boxes: CSV, or a folder of KITTI's label texts",
        is_path=True,
    )
    out: str = option("--out FILE.blend", "the file to write", ...)


@options
class RenderOptions:
    """Render a run's mountings with their clouds, by Cycles.

    Render the baseline and the mounting of a run with their point clouds, from above and from the pole, into the run's
    folder, and add the pictures to its report.html. Points on a vehicle go from red to green with the vehicle's
    entropy.

    Examples
    --------
    runs/i80_rs-16
    """

    folder: str = option("RUN_DIR", "folder of a run that has ended", ...)
    frame: int | None = option(
        "--frame K", "number of the frame; by default the searched one with the most vehicles, or the most detections"
    )
    samples: int | None = option("--samples N", "light paths per pixel; more is smoother and slower", low=1, high=4096)
    style: str = option(
        "--style", "day, the scene; points, the clouds alone on black", "both", allowed=("day", "points", "both")
    )
    detections: str | None = option(
        "--detections",
        "show these detections as wire boxes, and those of the baseline if NAME_baseline is in the same folder: "
        "CSV, or a folder of KITTI's label texts",
        is_path=True,
    )


# --- What there is ----------------------------------------------------------------------------------------


@options
class SensorsOptions:
    """List the LiDAR models, or show one with its beam fan.

    List the LiDAR models; with NAME show one in full, with its beam fan and its table of rings.

    Examples
    --------
    RS-16
    own_sensor.csv --out fan.png
    """

    name: str | None = option("NAME", "a model's name or alias, or the path of a .toml or .csv")
    json: bool = option("--json", "print only JSON, on stdout", False, group="output")
    out: str | None = option("--out PNG", "draw NAME's beam fan into this file")


@options
class DoctorOptions:
    """Check the installation.

    Show what is installed, and check every ray caster on a wall at known distances.
    """


# --- All of them ------------------------------------------------------------------------------------------

_SEARCH = ("--search", "--fidelity", "--particles", "--iterations", "--seeds")
_MANY = (*_SEARCH, "--metric", "--reading", "--cluster", "--installer")
_ONE = (*_MANY, "--frames", "--frame-ids", "--workers", "--seed", "--pose-error")

VERBS = (
    Verb("init FOLDER --from FORMAT [FILE]", "init.run", InitOptions),
    Verb("optimise SCENE.toml", "optimise.run_optimise", OptimiseOptions, without=()),
    Verb("evaluate SCENE.toml", "optimise.run_evaluate", EvaluateOptions, without=_SEARCH),
    Verb("report RUN", "report.run_report", ReportOptions),
    Verb(
        "table SCENE.toml --setback METRES --height METRES",
        "table.run",
        TableOptions,
        without=(*_SEARCH, "--pose-error", "--sensor"),
    ),
    Verb(
        "stability SCENE.toml",
        "studies.run_stability",
        StabilityOptions,
        without=("--fidelity", "--seeds", "--pose-error"),  # it has fidelities and seeds of its own
    ),
    Verb("chart SCENE.toml", "studies.run_chart", ChartOptions, without=(*_SEARCH, "--installer", "--pose-error")),
    Verb("scan SCENE.toml --frame K --out CLOUD", "scan.run_scan", ScanOptions, without=_ONE),
    Verb("detect SCENE.toml|DATASET|CLOUDS", "detect.run", DetectOptions, without=_MANY),
    Verb("dataset SCENE.toml", "dataset.run", DatasetOptions, without=_MANY),
    Verb("build SCENE.toml --frame K --out FILE.blend", "scan.run_build", BuildOptions, without=_ONE),
    Verb("render RUN_DIR", "scan.run_render", RenderOptions),
    Verb("score --points CLOUD --boxes BOXES.csv", "score.run", ScoreOptions),
    Verb("compare --points CLOUD --boxes BOXES --sensor NAME", "compare.run", CompareOptions),
    Verb("commission CLOUD", "commission.run", CommissionOptions),
    Verb("sensors [NAME]", "sensors.run", SensorsOptions),
    Verb("doctor", "doctor.run", DoctorOptions),
)
