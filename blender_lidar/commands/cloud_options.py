"""The options of verbs that take clouds: score, compare, commission, and detect on recordings; each declared once.

The standard library alone, so that help opens at once.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..names import CASTERS, DEFAULT_CELL_M, FRAMES, METRIC_NAMES, VIEWS
from ..toml_table import Setting, setting, settings_of

_METRIC = "a further metric beside PE-VGOP; may be repeated: all, FILE.py:NAME, "
_METRIC += ", ".join(METRIC_NAMES)


@dataclass(frozen=True, slots=True)
class ScoreOptions:
    """What `score` scores, and how.

    Attributes
    ----------
    points : str
        The cloud: .npz with xyz, .pcd, .ply, .las, .laz, KITTI's .bin, .csv or .xyz.
    boxes : str
        The boxes, in the columns of vehicles.csv and the frame of the cloud.
    frame : int or None
        Number of the frame, if the boxes are of several frames.
    axes : str
        Where x, y and z of the cloud point: r(ight) or l(eft), f(orward) or b(ack), u(p) or d(own); flu for KITTI's.
    pose : (float, ...) or None
        Where the sensor hangs whose frame the cloud is in: x, y and height [m], tilts and yaw [degrees].
    accept : tuple of str or None
        Go on though cloud and boxes do not fit, which is then told with the results: frames.
    assign : str
        How points are assigned to vehicles: id, by their vehicle_id; box, by the box they lie in.
    clearance_m : float
        With --assign box, points up to this height above a box's floor are ground.
    cell_m : float
        Side of an occupancy cell.
    threshold : float
        Least occupancy of a detectable vehicle.
    view : str
        Which of the three occupancies must reach the threshold.
    metrics : tuple of str or None
        A further metric beside PE-VGOP, or all; may be repeated.
    lidar_xy : (float, float) or None
        Place of the LiDAR in the frame of the cloud [m], for metrics that need its distance.
    out : str or None
        Write one row for each vehicle.
    json : bool
        Print only the scores, as JSON, on stdout.
    """

    points: str = setting(option="--points", metavar="CLOUD")
    boxes: str = setting(option="--boxes", metavar="BOXES.csv")
    frame: int | None = setting(None, option="--frame", metavar="K")
    axes: str = setting("rfu", option="--axes", metavar="XYZ")
    pose: tuple[float, float, float, float, float, float] | None = setting(
        None, low=-1e9, high=1e9, option="--pose", metavar=("X", "Y", "HEIGHT", "TILT_X", "TILT_Y", "YAW")
    )
    accept: tuple[str, ...] | None = setting(None, allowed=(FRAMES,), option="--accept")
    assign: str = setting("id", allowed=("id", "box"), option="--assign")
    clearance_m: float = setting(0.1, low=0.0, option="--ground-clearance", metavar="M")
    cell_m: float = setting(DEFAULT_CELL_M, low=0.001, option="--cell", metavar="M")
    threshold: float = setting(0.005, low=0.0, option="--threshold")
    view: str = setting("mean", allowed=VIEWS, option="--view")
    metrics: tuple[str, ...] | None = setting(None, option="--metric", metavar="NAME", help=_METRIC)
    lidar_xy: tuple[float, float] | None = setting(None, option="--lidar", metavar=("X", "Y"))
    out: str | None = setting(None, option="--out", metavar="CSV")
    json: bool = setting(False, option="--json")


@dataclass(frozen=True, slots=True)
class CompareOptions:
    """What `compare` compares, and how it is simulated.

    Attributes
    ----------
    points : tuple of str
        A recorded cloud, in a format that score reads; may be repeated.
    boxes : str
        The labelled boxes, in the columns of vehicles.csv and the frame that the clouds are in or brought to; or
        SUSTechPOINTS' JSON or KITTI's label texts, a file or a folder, in the frame of the clouds.
    frames : tuple of int or None
        For each cloud the number of its frame, if the boxes are of several frames.
    accept : tuple of str or None
        Go on though cloud and boxes do not fit, which is then told with the results: frames.
    classes : tuple of str or None
        Label of the vehicles to compare; may be repeated; by default all classes that can be simulated.
    distance_m : (float, float) or None
        Leave out vehicles nearer or farther than this.
    commission : str or None
        Folder or commission.json of commission: sensor, axes and pose, which no other option may give beside it.
    sensor : str or None
        Sensor model, or path of a beam table.
    rotation_hz : float or None
        Rotation rate of the sensor.
    x_m, y_m, height_m : float
        Place of the sensor in the frame of the clouds.
    tilt_x_deg, tilt_y_deg, yaw_deg : float
        Orientation of the sensor in the frame of the clouds.
    details : str
        Levels of detail of the simulated vehicles, separated by commas.
    losses : tuple of str or None
        Lost returns of the simulated sensor, by the keys of a scene's [sensor], such as dropout=0.05, or none, which is
        the default; may be repeated to compare them.
    label_margin_m : (float, float, float) or None
        How much longer, wider and higher the labels are than their vehicles; by default 0.
    clearance_m : float
        Recorded and simulated points up to this height above a box's floor are left out.
    caster : str
        Ray caster.
    out : str or None
        Folder of the results; by default a new one under runs/.
    json : bool
        Print only the content of the result file, on stdout.
    """

    points: tuple[str, ...] = setting(option="--points", metavar="CLOUD")
    boxes: str = setting(option="--boxes", metavar="BOXES")
    commission: str | None = setting(None, option="--commission", metavar="DIR")
    sensor: str | None = setting(None, option="--sensor", metavar="NAME")
    frames: tuple[int, ...] | None = setting(None, option="--frame", metavar="K")
    accept: tuple[str, ...] | None = setting(None, allowed=(FRAMES,), option="--accept")
    classes: tuple[str, ...] | None = setting(None, option="--class", metavar="NAME")
    distance_m: tuple[float, float] | None = setting(None, low=0.0, option="--distance", metavar=("NEAR", "FAR"))
    rotation_hz: float | None = setting(None, above=0.0, option="--rotation")
    x_m: float = setting(0.0, option="--x", metavar="M")
    y_m: float = setting(0.0, option="--y", metavar="M")
    height_m: float = setting(0.0, option="--height", metavar="M")
    tilt_x_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-x", metavar="DEG")
    tilt_y_deg: float = setting(0.0, low=-90.0, high=90.0, option="--tilt-y", metavar="DEG")
    yaw_deg: float = setting(0.0, low=-360.0, high=360.0, option="--yaw", metavar="DEG")
    details: str = setting("body", option="--details", metavar="NAMES")
    losses: tuple[str, ...] | None = setting(None, option="--losses", metavar="NAME=VALUE,...")
    label_margin_m: tuple[float, float, float] | None = setting(
        None, low=0.0, high=1.0, option="--label-margin", metavar=("L", "W", "H")
    )
    clearance_m: float = setting(0.15, low=0.0, high=1.0, option="--ground-clearance", metavar="M")
    caster: str = setting("auto", allowed=("auto", *CASTERS), option="--caster")
    out: str | None = setting(None, option="--out", metavar="DIR")
    json: bool = setting(False, option="--json")


@dataclass(frozen=True, slots=True)
class CommissionOptions:
    """How `commission` reads clouds, and where its results go.

    Attributes
    ----------
    sensor : str or None
        Sensor model, or path of a beam table; by default found from the cloud, or the plan's.
    axes : str
        Where x, y and z of the clouds point: r(ight) or l(eft), f(orward) or b(ack), u(p) or d(own), such as flu.
    origin : (float, float, float) or None
        Place of the sensor in the clouds [m], where they are in another frame with the sensor's axes.
    drives_on : str
        The side of traffic, by which fitted boxes head on two carriageways; the plan's with --run.
    out : str or None
        Folder of the results; by default a new one under runs/.
    json : bool
        Print only the content of the result file, on stdout.
    """

    sensor: str | None = setting(None, option="--sensor", metavar="NAME")
    axes: str = setting("rfu", option="--axes", metavar="XYZ")
    origin: tuple[float, float, float] | None = setting(
        None, low=-1e9, high=1e9, option="--origin", metavar=("X", "Y", "Z")
    )
    drives_on: str = setting("right", allowed=("right", "left"), option="--drives-on")
    out: str | None = setting(None, option="--out", metavar="DIR")
    json: bool = setting(False, option="--json")


_REGION = Setting(
    kind=tuple[float, float, float, float],
    low=-1e6,
    high=1e6,
    fits=lambda corners: corners[0] < corners[2] and corners[1] < corners[3],
    form="two corners, the lower x and y first",
    option="--region",
    metavar=("X0", "Y0", "X1", "Y1"),
    help="rectangle to look at [m, road frame]; by default 100 m all round; vehicles only on known carriageways",
)


def recorded_settings() -> dict[str, Setting]:
    """The options of recorded clouds, by key."""
    placed, compared = settings_of(ScoreOptions), settings_of(CompareOptions)
    keys = "axes", "pose", "commission", "boxes"
    return {"region": _REGION, **{key: (placed if key in ("axes", "pose") else compared)[key] for key in keys}}
