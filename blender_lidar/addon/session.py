"""What the panel keeps in memory of scenes: their traffic, its clock, and frames ready to be seen by their LiDARs."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import bpy

from ..casting import resolve
from ..casting.instances import OwnBodies
from ..casting.protocol import StandingScenery
from ..clouds.live import DRAG_M, FusedScores, LiveFrame, Look
from ..errors import InputError
from ..scene.mounting import Mounting
from ..scene.observation import of_scored_class, vehicle_weights
from ..scene.region import region_of
from ..scene.scenario import Scenario
from ..scene.site import observation_of, read_recordings, scoring_of, standing_scenery
from ..traffic import Recording, joined_recordings
from ..traffic.boxes import Boxes, no_boxes
from ..traffic.vehicles import FLEET_KINDS, SAME_S
from ..world.blender.bodies import OwnBody, body_of
from ..world.blender.objects import is_shown
from ..world.blender.road import hidden_ground
from ..world.blender.site import open_scenery
from ..world.blender.traffic import show_recording, starts_at, traffic_object
from . import properties, scenarios

CLIP = "i80_sample.csv.gz", "i80_drive.csv.gz"  # what is searched, and 20 s of the same that are played
_SAME_FRAME = 1e-3  # of the timeline
_DIGITS_S = 6
_OF_SEARCH = ("frames", "holdout", "block_s")  # fields of [traffic] that one scan does not depend on
_RECORDINGS: dict[str, tuple[str, list[Recording], Recording]] = {}  # by scene: what they were read with, and as one
_OBJECTS: dict[str, tuple[tuple[str, str], StandingScenery]] = {}  # by scene: the user's own
_BODIES: dict[str, tuple[object, dict[str, OwnBody], OwnBodies | None]] = {}  # by scene: vehicles' bodies of their own
_FRAMES: dict[str, tuple[str, str, Mounting, LiveFrame]] = {}  # by LiDAR: what and where it was made for
_FUSED: dict[str, tuple[list[LiveFrame], FusedScores | None]] = {}  # by scene: of the LiDARs that hang together


# --- Traffic ----------------------------------------------------------------------------------------------------------


def recordings_of(scene: bpy.types.Scene) -> list[Recording]:
    """The recordings that are searched, read again where settings have changed or the file was opened again.

    Raises
    ------
    BlenderLidarError
        Where none is chosen, or one cannot be read.
    """
    scenario = scenarios.scenario_from(scene)
    return _read(scene, scenario, searched=with_clip(scenario, scene.blender_lidar.clip) is not scenario)[0]


def recording_of(scene: bpy.types.Scene) -> Recording:
    """The traffic that the timeline plays, as one recording; read again like `recordings_of`."""
    return _read(scene, with_clip(scenarios.scenario_from(scene), scene.blender_lidar.clip))[1]


def with_clip(scenario: Scenario, clip: bool) -> Scenario:
    """Settings with the traffic that the timeline plays, in the example, with `clip`, the 20 s beside its own."""
    first, *others = scenario.recordings
    path = Path(first.path)
    if not clip or path.name != CLIP[0]:
        return scenario
    return replace(scenario, recordings=(replace(first, path=str(path.with_name(CLIP[1]))), *others))


def _read(scene, scenario, *, searched=False):
    key, of = f"{scenarios.uid_of(scene)}{' searched' if searched else ''}", _read_with(scenario)
    if key not in _RECORDINGS or _RECORDINGS[key][0] != of:
        _keep(key, scenario, read_recordings(scenario))
        if not searched:
            show_traffic(scene, again=True)
    return _RECORDINGS[key][1:]


def keep(scene: bpy.types.Scene, recordings: list[Recording]) -> Recording:
    """Keep the traffic that the timeline plays, which has just been read; returns it as one recording."""
    return _keep(
        scenarios.uid_of(scene), with_clip(scenarios.scenario_from(scene), scene.blender_lidar.clip), recordings
    )


def _keep(key, scenario, recordings):
    joined = joined_recordings(recordings, [one.name or "" for one in scenario.recordings])
    _RECORDINGS[key] = _read_with(scenario), recordings, joined
    return joined


def _read_with(scenario: Scenario) -> str:
    stamps, world = [stamp(one.path) for one in scenario.recordings], replace(scenario.world, ground=True)
    return repr((scenario.recordings, scenario.road, scenario.region, world, stamps))


def stamp(path: str) -> tuple[int, int] | None:
    try:
        status = Path(path).stat()
    except OSError:
        return None
    return status.st_size, status.st_mtime_ns


# --- The clock: the timeline ------------------------------------------------------------------------------------------


def seconds_of(scene: bpy.types.Scene) -> float:
    """The time that a scene's timeline shows [s], as the node *Scene Time* has it."""
    return scene.frame_current_final * scene.render.fps_base / scene.render.fps


def since_of(scene: bpy.types.Scene) -> float:
    """The time since the recording's first instant that the timeline shows [s]."""
    return round(seconds_of(scene) - scene.blender_lidar.starts_s, _DIGITS_S) + 0.0


def vehicles_of(scene: bpy.types.Scene) -> Boxes:
    """The vehicles at the timeline's time: a recorded instant's, or between two; none in a gap, or without traffic.

    There are none either where the object that shows them was hidden or deleted.

    Raises
    ------
    BlenderLidarError
        Where the traffic cannot be read.
    """
    if not scene.blender_lidar.loaded:
        return no_boxes(shown_frame(scene), seconds_of(scene))
    found = recording_of(scene).moment(since_of(scene))
    return found if is_traffic_shown(scene) else found.select([])


def is_traffic_shown(scene: bpy.types.Scene) -> bool:
    """Whether a scene shows its vehicles, in views and in renders."""
    item = traffic_object(scene)
    return item is not None and is_shown(scene, scenarios.view_layer_of(scene), item)


def check_traffic_is_shown(scene: bpy.types.Scene) -> None:
    """Refuse to search or judge traffic that is not shown."""
    if not is_traffic_shown(scene):
        what = "deleted; Load brings it back" if traffic_object(scene) is None else "hidden; show it"
        raise InputError(f"Vehicles: the traffic was {what}: what is not shown is not scanned")


def show_traffic(scene: bpy.types.Scene, *, again: bool = False) -> None:
    """Let what shows the traffic have that of the timeline's time; `again` where anything but the time has changed.

    Raises
    ------
    BlenderLidarError
        Where the traffic cannot be read.
    """
    group, item = scene.blender_lidar, traffic_object(scene)
    if item is not None and (again or not starts_at(item, since_of(scene), group.starts_s)):
        place = group.world.detail, since_of(scene), group.starts_s
        show_recording(scene, recording_of(scene), *place, bodies_shown(scene))


def shown_frame(scene: bpy.types.Scene) -> int:
    """Number of the instant nearest to the timeline; of traffic that has not been read yet the last one known.

    Without traffic that of the timeline's frame.
    """
    group = scene.blender_lidar
    if not group.loaded:
        return max(scene.frame_current, 0)
    if scenarios.uid_of(scene) in _RECORDINGS:
        return _RECORDINGS[scenarios.uid_of(scene)][-1].moment(since_of(scene)).frame
    return group.known_frame


def show_frame(scene: bpy.types.Scene, frame: int) -> None:
    """Move the timeline to the recorded instant whose number is nearest.

    Raises
    ------
    BlenderLidarError
        Where the traffic cannot be read.
    """
    group = scene.blender_lidar
    if group.loaded:
        recording = recording_of(scene)
        at = abs(recording.frames - frame).argmin()
        number = (group.starts_s + recording.since_s[at]) * scene.render.fps / scene.render.fps_base
        whole = math.floor(number + _SAME_FRAME)
        scene.frame_set(whole, subframe=max(number - whole, 0.0))
        frame = int(recording.frames[at])
    group.known_frame = frame


def start_clock(scene: bpy.types.Scene, recording: Recording, frame: int) -> None:
    """Let the timeline's present time be that of the instant of a recording whose number is nearest."""
    at = abs(recording.frames - frame).argmin()
    with properties.silently():
        scene.blender_lidar.starts_s = seconds_of(scene) - recording.since_s[at]
    scene.blender_lidar.known_frame = int(recording.frames[at])


def time_text(scene: bpy.types.Scene) -> str:
    """What the panel says of the timeline's time: whether an instant is there, or any traffic."""
    since_s = since_of(scene)
    text = f"At {since_s:.2f} s"
    if scenarios.uid_of(scene) not in _RECORDINGS:
        return text
    recording = _RECORDINGS[scenarios.uid_of(scene)][-1]
    if abs(recording.since_s - since_s).min() <= SAME_S:
        return text
    return f"{text}, {'between instants' if len(recording.moment(since_s)) else 'no traffic at this time'}"


# --- Frames kept ready ------------------------------------------------------------------------------------------------


def live_frame(
    scene: bpy.types.Scene,
    lidar: bpy.types.Object,
    *,
    exact: bool = False,
    bodies: OwnBodies | None = None,
    depsgraph: bpy.types.Depsgraph | None = None,
) -> LiveFrame:
    """The frame that a scene shows, ready to be seen by one of its LiDARs; kept until something changes.

    It is ready for wherever the LiDAR is dragged within 60 m; `exact` has clutter kept clear of where it hangs now,
    and own bodies read again unless they are given. With a `depsgraph` LiDARs hang as that has evaluated them.

    Raises
    ------
    BlenderLidarError
        For settings, traffic or a frame that cannot be used.
    """
    hung, vehicles, key = scenarios.layout_of(scene, lidar), vehicles_of(scene), scenarios.uid_of(lidar)
    bodies = bodies or own_bodies(scene, again=exact)
    whole, layout = (
        scenarios.layout_scenario(scene, hung),
        [properties.mounting_of(one, depsgraph=depsgraph) for one in hung],
    )
    number = hung.index(lidar)
    scenario, mounting = whole.with_lidars(whole.lidars[number]), layout[number]
    tables, stamps = scenario.as_tables(), [stamp(path) for path in scenario.files.values()]
    tables = {name: tables[name] for name in tables if name not in ("search", "lidar")}
    own = scenario.lidar.name, scenario.lidar.baseline
    of = repr((tables, own, bodies and bodies.digests, moment_key(vehicles), stamps))
    about = repr((layout, [one.deployment for one in whole.lidars])) if exact and scenario.world.clutter else ""
    before = _FRAMES.get(key)
    if before is None or before[0] != of or (about and before[1] != about) or dragged_off(lidar, mounting):
        _FRAMES[key] = of, about, mounting, _made_ready(scenario, vehicles, whole, layout, bodies)
    return _FRAMES[key][-1]


def moment_key(vehicles: Boxes) -> tuple[int, float, int]:
    """What tells moments of a recording apart."""
    return vehicles.frame, vehicles.time_s, len(vehicles)


def dragged_off(lidar: bpy.types.Object, mounting: Mounting) -> bool:
    """Whether a LiDAR is so far from where its frame was made ready that scenery and crown may end too soon."""
    before = _FRAMES.get(scenarios.uid_of(lidar))
    return before is not None and any(
        abs(now - then) > DRAG_M for now, then in zip(mounting.xy, before[2].xy, strict=True)
    )


def _made_ready(scenario: Scenario, vehicles: Boxes, whole: Scenario, layout: list[Mounting], bodies) -> LiveFrame:
    caster, region = resolve(scenario.model.caster, "caster"), region_of(scenario.region, scenario.road_map)
    counted = region.holds(vehicles) & of_scored_class(vehicles, scenario.objective)
    frame = replace(vehicles, counted=counted, weight=vehicle_weights(vehicles, scenario.objective))
    scenery = standing_scenery(whole, caster, layout, margin_m=2.0 * DRAG_M)
    observation = observation_of(scenario, caster, scenery, bodies=bodies)
    scoring = scoring_of(scenario) if frame.counted.any() else None
    return LiveFrame(frame, observation, scoring, ground=scenario.plane_returns)


def bodies_shown(scene: bpy.types.Scene, *, again: bool = False) -> dict[str, OwnBody]:
    """Vehicles' bodies of the user's own by kind, as their collections were last; as they are now if read `again`.

    Raises
    ------
    InputError
        For a collection that is no body.
    """
    chosen, key = chosen_bodies(scene), scenarios.uid_of(scene)
    uids, before = {kind: scenarios.uid_of(of) for kind, of in chosen.items()}, _BODIES.get(key)
    if before is None or again or before[0] != uids:
        found = {kind: body_of(of, properties.where("vehicles", kind)) for kind, of in chosen.items()}
        own = OwnBodies({kind: body.shape for kind, body in found.items()}) if found else None
        if before and before[2] and own and before[2].digests == own.digests:
            own = before[2]  # with its trees
        _BODIES[key] = uids, found, own
        if before and before[2] is not own:
            show_traffic(scene, again=True)
    return _BODIES[key][1]


def chosen_bodies(scene: bpy.types.Scene) -> dict[str, bpy.types.Collection]:
    """The collections that stand for vehicles, by kind."""
    group = scene.blender_lidar.vehicles
    return {kind: of for kind in FLEET_KINDS if (of := getattr(group, kind)) is not None}


def own_bodies(scene: bpy.types.Scene, *, again: bool = False) -> OwnBodies | None:
    """The meshes of `bodies_shown`, None without any, ready to be cast against."""
    bodies_shown(scene, again=again)
    return _BODIES[scenarios.uid_of(scene)][2]


def exact_objects(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, scenario: Scenario) -> list[StandingScenery]:
    """The visible objects of the user's as exact triangles, for `LiveFrame.look`; made ready once while they stay.

    Raises
    ------
    InputError
        For a vertex that is not finite.
    """
    scenery, caster, key = open_scenery(scene, layer), resolve(scenario.model.caster, "caster"), scenarios.uid_of(scene)
    of = caster, scenery.digest, scenery.label.tobytes(), scenery.labels
    if key not in _OBJECTS or _OBJECTS[key][0] != of:
        _OBJECTS[key] = of, StandingScenery(scenery, caster)
    return [_OBJECTS[key][1]] if len(scenery) else []


def settings_digest(lidar: bpy.types.Object) -> str:
    """A digest of what a LiDAR's cloud and score are made with, but for its pose, the time and the user's own objects.

    That is its sensor, its baseline and the scene's settings, and whether traffic and ground are shown.
    """
    scene = properties.scene_of(lidar)
    group, fields = (
        scene.blender_lidar,
        {name: of for name, of in scenarios.fields_of(scene).items() if name != "search"},
    )
    fields["traffic"] = {key: value for key, value in fields["traffic"].items() if key not in _OF_SEARCH}
    fields["traffic"]["path"] = group.traffic.path  # stays what it is where the file is moved with its traffic
    own = group.kept, [getattr(group.vehicles, kind) for kind in FLEET_KINDS]
    shown = is_traffic_shown(scene), hidden_ground(scene, scenarios.view_layer_of(scene))
    made_with = scenarios.sensor_table(lidar), lidar.blender_lidar.baseline, fields, own, shown
    return hashlib.sha256(repr(made_with).encode()).hexdigest()


def store(lidar: bpy.types.Object, vehicles: Boxes, look: Look, baseline: Look) -> None:
    """Keep with a LiDAR, unless it is linked, what the panel says of a scan: its size and score, and the baseline's."""
    group = lidar.blender_lidar
    if lidar.library is not None:
        return
    group.points, group.scanned_frame = len(look.cloud), vehicles.frame
    group.scanned_s = since_of(properties.scene_of(lidar))
    group.scanned_at, group.scanned_with = list(look.pose.as_table().values()), settings_digest(lidar)
    group.vehicles = 0 if look.scored is None else look.scored.values.shape[1]
    for scored, objective, share in (
        (look.scored, "objective", "detectable_share"),
        (baseline.scored, "baseline_objective", "baseline_share"),
    ):
        setattr(group, objective, 0.0 if scored is None else float(scored.objective.sum()))
        setattr(group, share, 0.0 if scored is None else float(scored.detectable.mean()))


def store_layout(scene, hung: list[bpy.types.Object], frames: list[LiveFrame], looks: list[tuple[Look, Look]]) -> None:
    """Keep with a scene what its layout is worth, fused of what each LiDAR sees now and as its baseline."""
    told, key = (
        {"lidars": [one.name_full for one in hung], "vehicles": int(frames[0].frame.counted.sum())},
        scenarios.uid_of(scene),
    )
    if key not in _FUSED or _FUSED[key][0] != frames:
        _FUSED[key] = frames, FusedScores(frames) if frames[0].scoring else None
    for name, of in zip(("now", "baseline"), zip(*looks, strict=True), strict=True) if _FUSED[key][1] else ():
        scored = _FUSED[key][1].of(of)
        told[name] = {"objective": float(scored.objective.sum()), "share": float(scored.detectable.mean())}
    scene.blender_lidar.fused = json.dumps(told) if "now" in told else ""


def forget() -> None:
    """Let go of all that is kept."""
    for kept in (_RECORDINGS, _FRAMES, _OBJECTS, _BODIES, _FUSED):
        kept.clear()
