"""The verbs that take clouds, declared: score, compare, commission, and detect on recordings.

The standard library alone, so that help opens at once.
"""

from __future__ import annotations

from ..names import CASTERS, DEFAULT_CELL_M, FRAMES, METRIC_NAMES, VIEWS
from .parsers import option, option_of, options

_METRIC = f"a further metric beside PE-VGOP; may be repeated: all, FILE.py:NAME, {', '.join(METRIC_NAMES)}"


@options
class Output:
    """Where results go."""

    out: str | None = option("--out DIR", "folder of the results; by default a new one under runs/", group="output")
    json: bool = option("--json", "print only the content of the result file, on stdout", False)


@options
class ScoreOptions:
    """Score the vehicles of a labelled cloud.

    Score the vehicles of a point cloud with known boxes: PE-VGOP of each vehicle, and other metrics on request.

    Examples
    --------
    --points cloud.npz --boxes runs/i80_rs-16/vehicles.csv --frame 1000
    --points sweep.pcd --boxes boxes.csv --assign box --metric all
    """

    points: str = option(
        "--points CLOUD",
        "the cloud: .npz with xyz, .pcd, .ply, .las, .laz, KITTI's .bin, .csv or .xyz",
        ...,
        group="what is scored",
    )
    boxes: str = option(
        "--boxes BOXES.csv", "the boxes, in the columns of vehicles.csv and the frame of the cloud", ...
    )
    frame: int | None = option("--frame K", "number of the frame, if the boxes are of several frames")
    axes: str = option(
        "--axes XYZ",
        "where x, y and z of the cloud point: r(ight) or l(eft), f(orward) or b(ack), u(p) or d(own); flu for KITTI's",
        "rfu",
    )
    pose: tuple[float, float, float, float, float, float] | None = option(
        "--pose X Y HEIGHT TILT_X TILT_Y YAW",
        "where the sensor hangs whose frame the cloud is in: x, y and height [m], tilts and yaw [degrees]",
        low=-1e9,
        high=1e9,
    )
    accept: tuple[str, ...] | None = option(
        "--accept",
        "go on though cloud and boxes do not fit, which is then told with the results: frames",
        allowed=(FRAMES,),
    )
    assign: str = option(
        "--assign",
        "how points are assigned to vehicles: id, by their vehicle_id; box, by the box they lie in",
        "id",
        allowed=("id", "box"),
    )
    clearance_m: float = option(
        "--ground-clearance M",
        "with --assign box, points up to this height above a box's floor are ground",
        0.1,
        low=0.0,
    )
    lidar_xy: tuple[float, float] | None = option(
        "--lidar X Y", "place of the LiDAR in the frame of the cloud [m], for metrics that need its distance"
    )
    cell_m: float = option("--cell M", "side of an occupancy cell", DEFAULT_CELL_M, low=0.001, group="metric")
    threshold: float = option("--threshold", "least occupancy of a detectable vehicle", 0.005, low=0.0)
    view: str = option("--view", "which of the three occupancies must reach the threshold", "mean", allowed=VIEWS)
    metrics: tuple[str, ...] | None = option("--metric NAME", _METRIC)
    out: str | None = option("--out CSV", "write one row for each vehicle", group="output")
    json: bool = option("--json", "print only the scores, as JSON, on stdout", False)


@options
class CompareOptions(Output):
    """A recorded, labelled cloud beside its simulation.

    Compare recorded vehicles with simulated ones: the points of each labelled vehicle in a recorded cloud, and the
    points that the simulated sensor gets from it at the same place.

    Examples
    --------
    --points sweep.pcd --boxes boxes.csv --sensor RS-80 --height 4.1 --tilt-x 9
    --points sweep.pcd --boxes boxes.csv --sensor RS-80 --height 4.1 --distance 10 50 --losses dropout=0.05
    --points sweep.pcd --boxes labels --commission found --losses none --losses range_at_10_percent_m=160
    """

    points: tuple[str, ...] = option(
        "--points CLOUD",
        "a recorded cloud, in a format that score reads; may be repeated",
        ...,
        group="what is compared",
    )
    boxes: str = option(
        "--boxes BOXES",
        "the labelled boxes, in the columns of vehicles.csv and the frame that the clouds are in or brought to; "
        "or SUSTechPOINTS' JSON or KITTI's label texts, a file or a folder, in the frame of the clouds",
        ...,
    )
    commission: str | None = option(
        "--commission DIR",
        "folder or commission.json of commission: sensor, axes and pose, which no other option may give beside it",
    )
    frames: tuple[int, ...] | None = option(
        "--frame K", "for each cloud the number of its frame, if the boxes are of several frames"
    )
    accept: tuple[str, ...] | None = option(
        "--accept",
        "go on though cloud and boxes do not fit, which is then told with the results: frames",
        allowed=(FRAMES,),
    )
    classes: tuple[str, ...] | None = option(
        "--class NAME",
        "label of the vehicles to compare; may be repeated; by default all classes that can be simulated",
    )
    distance_m: tuple[float, float] | None = option(
        "--distance NEAR FAR", "leave out vehicles nearer or farther than this", low=0.0
    )
    sensor: str | None = option("--sensor NAME", "sensor model, or path of a beam table", group="sensor")
    rotation_hz: float | None = option("--rotation", "rotation rate of the sensor", above=0.0)
    x_m: float = option("--x M", "place of the sensor in the frame of the clouds", 0.0)
    y_m: float = option("--y M", "place of the sensor in the frame of the clouds", 0.0)
    height_m: float = option("--height M", "place of the sensor in the frame of the clouds", 0.0)
    tilt_x_deg: float = option(
        "--tilt-x DEG", "orientation of the sensor in the frame of the clouds", 0.0, low=-90.0, high=90.0
    )
    tilt_y_deg: float = option(
        "--tilt-y DEG", "orientation of the sensor in the frame of the clouds", 0.0, low=-90.0, high=90.0
    )
    yaw_deg: float = option(
        "--yaw DEG", "orientation of the sensor in the frame of the clouds", 0.0, low=-360.0, high=360.0
    )
    details: str = option(
        "--details NAMES", "levels of detail of the simulated vehicles, separated by commas", "body", group="simulation"
    )
    losses: tuple[str, ...] | None = option(
        "--losses NAME=VALUE,...",
        "lost returns of the simulated sensor, by the keys of a scene's [sensor], such as dropout=0.05, or none, "
        "which is the default; may be repeated to compare them",
    )
    label_margin_m: tuple[float, float, float] | None = option(
        "--label-margin L W H",
        "how much longer, wider and higher the labels are than their vehicles; by default 0",
        low=0.0,
        high=1.0,
    )
    clearance_m: float = option(
        "--ground-clearance M",
        "recorded and simulated points up to this height above a box's floor are left out",
        0.15,
        low=0.0,
        high=1.0,
    )
    caster: str = option("--caster", "ray caster", "auto", allowed=("auto", *CASTERS))


@options
class CommissionOptions(Output):
    """Sensor and mounting of a LiDAR that hangs, from its own clouds.

    Tell from recorded clouds of a LiDAR at a straight road which sensor it is, how high it hangs, how it leans against
    the road, and what that costs beside the plan.

    Examples
    --------
    revolution.pcd
    frame_*.bin --axes flu --run runs/i80_rs-16
    """

    clouds: tuple[str, ...] = option("CLOUD", "clouds of one mounting, each in its own file", ..., group="")
    of_run: str | None = option(
        "--run RUN_DIR",
        "folder of the run that planned the mounting: tell how the LiDAR hangs beside its plan, and what that costs",
        group="plan",
    )
    lidar: str | None = option("--lidar NAME", "which LiDAR of a run of several it is")
    sensor: str | None = option(
        "--sensor NAME",
        "sensor model, or path of a beam table; by default found from the cloud, or the plan's",
        group="cloud",
    )
    axes: str = option(
        "--axes XYZ",
        "where x, y and z of the clouds point: r(ight) or l(eft), f(orward) or b(ack), u(p) or d(own), such as flu",
        "rfu",
    )
    origin: tuple[float, float, float] | None = option(
        "--origin X Y Z",
        "place of the sensor in the clouds [m], where they are in another frame with the sensor's axes",
        low=-1e9,
        high=1e9,
    )
    drives_on: str = option(
        "--drives-on",
        "the side of traffic, by which fitted boxes head on two carriageways; the plan's with --run",
        "right",
        allowed=("right", "left"),
    )


@options
class RecordedOptions:
    """How a folder of recorded clouds is read, of which `detect` has others' options too."""

    region: tuple[float, float, float, float] | None = option(
        "--region X0 Y0 X1 Y1",
        "rectangle to look at [m, road frame]; by default 100 m all round; vehicles only on known carriageways",
        low=-1e6,
        high=1e6,
        fits=lambda corners: corners[0] < corners[2] and corners[1] < corners[3],
        form="two corners, the lower x and y first",
        group="a folder of recorded clouds, whose names end with the numbers of their frames; --sensor names theirs",
    )
    axes: str | None = option_of(ScoreOptions, "axes", default=None)
    pose: tuple[float, float, float, float, float, float] | None = option_of(ScoreOptions, "pose")
    commission: str | None = option_of(CompareOptions, "commission")
    boxes: str | None = option_of(CompareOptions, "boxes", default=None)
