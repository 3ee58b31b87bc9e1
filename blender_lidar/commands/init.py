"""``blender-lidar init``: a scene for a recording of one's own, proposed from where its vehicles drive."""

from __future__ import annotations

import argparse
import importlib.util
import os
import shlex
import shutil
import subprocess
from pathlib import Path

from ..csv_header import is_parquet
from ..errors import InputError, MissingExtraError, MissingFileError, one_line, unknown_name
from ..files import check_folder, check_unused, make_folder, whole_file, write_text
from ..names import TRAFFIC_FORMATS
from ..road.settings import RoadSettings
from ..scene.plausibility import checked_recording
from ..scene.scenario import load_scenario, shipped_scenes
from ..traffic import Recording, format_of, read_traffic, write_table
from ..traffic.layout import propose_layout
from ..traffic.site_layout import is_crossing, propose_site
from ..traffic.sumo_types import SumoConfig, is_config, read_config
from .init_scene import PICTURE, POLES, SCENE, Proposal, filled, site_scene, straight_scene, traffic_fields
from .options import check_scipy
from .parsers import given_options
from .report import note

RECORDING, TABLE = "run.fcd.xml.gz", "traffic.csv"
EXAMPLE = "example"
_SAMPLE = "i80_sample.csv.gz"
_FCD_PERIOD_S = 0.5


def run(args: argparse.Namespace) -> int:
    """Read the traffic, propose a scene, write it with its picture; returns the exit code."""
    check_scipy("init")
    folder = Path(args.folder)
    kind, path = _source(args)
    given = given_options(args, ("period", "location", "vehicle_types"))
    settings, types = _map_of(args), ()
    if is_config(path):
        config = read_config(path)
        _check(folder, [path, *config.types])
        if config.net is not None and settings.driven:  # a map that is given counts before
            settings = RoadSettings(net=str(config.net))
        path, types = _recorded(path, config, folder), config.types
    if types and "vehicle_types" not in given:
        given["vehicle_types"] = types
    for file in [one for one in given.get("vehicle_types", ()) if is_config(one)]:
        given["vehicle_types"] = [*read_config(file).types, *(one for one in given["vehicle_types"] if one != file)]
    maps = [Path(settings.path)] if settings.path else []
    _check(folder, [path, *map(Path, given.get("vehicle_types", ())), *maps])
    kind = format_of(path) if kind == TRAFFIC_FORMATS[0] else kind
    unplaced = RoadSettings(station_m=0.0, right_edge_m=0.0, setback_m=0.0)
    recording = read_traffic(path, format=kind, road=unplaced, **given)
    is_ngsim, kerb_lane = kind == "ngsim", kind == "sumo"
    if is_parquet(path):  # which Blender does not read
        if (folder / TABLE).exists():
            raise InputError(f"FOLDER: {folder}: holds a {TABLE} already, and nothing is overwritten; give another one")
        make_folder(folder, "FOLDER")
        path, kind, given = folder / TABLE, "table", {}
        write_table(path, recording)
        note(f"{path} holds the recording as Blender reads it too")
    recording = recording.vehicles_alone
    asked = not settings.driven or args.at or args.junction
    if asked and is_ngsim:
        raise InputError("--net, --road, --at and --junction: do not apply to NGSIM, whose roads are straight")
    is_site = asked or (not is_ngsim and is_crossing(recording))
    if is_site:
        found = site_scene(propose_site(recording, settings, args.junction, args.at), kind, folder)
    else:
        found = straight_scene(recording, propose_layout(recording, follows_x=is_ngsim, kerb_lane=kerb_lane), kind)
    report = recording.report
    parts = {"period": report.periods, "location": report.locations} if is_ngsim else {}
    several = {key: getattr(report, key) for key, known in parts.items() if len(known) > 1}
    _write(found, traffic_fields({"path": path, **several, **given}, kind, folder), folder, straight=not is_site)
    return 0


def _write(found: Proposal, traffic: dict[str, object], folder: Path, *, straight: bool) -> None:
    """Write a scene with its poles and picture, and say what it is and how to go on."""
    make_folder(folder, "FOLDER")
    scene, written = folder / SCENE, [SCENE]
    if found.poles:
        write_text(folder / POLES, found.poles)
        written.append(POLES)
    write_text(scene, filled({**found.fields, **traffic}))
    check = "Next:"
    try:
        found.draw(folder)
        written.append(PICTURE)
        check = f"Look at {folder / PICTURE}, then:"
    except MissingExtraError as error:
        note(f"no picture: {error}")
    rows = [*found.rows, ("Written", ", ".join(str(folder / name) for name in written))]
    quoted = shlex.quote(str(scene))
    commands = [f"evaluate {quoted} --height 4 --tilt-x 15"] if straight else []
    commands = [f"  blender-lidar {command}" for command in (*commands, f"optimise {quoted}")]
    print("\n".join([*(f"{name:<10} {text}" for name, text in rows), "", check, *commands]))
    _tell_suspicious(found.placed, scene)


def _tell_suspicious(placed: Recording, scene: Path) -> None:
    """Say, while it is the file's turn to be put right, what would stop a run of the scene, and what is suspicious."""
    try:
        checked = checked_recording(placed, load_scenario(scene))
    except InputError as error:
        note(f"a run will stop: {one_line(str(error))}")
        return
    for text in checked.report.notes[len(placed.report.notes) :]:
        note(text)


def _source(args: argparse.Namespace) -> tuple[str, Path]:
    """The format, perhaps ``"auto"``, and the file."""
    words = [*(args.source or ()), *([args.file] if args.file is not None else ())]
    kinds = (*TRAFFIC_FORMATS, EXAMPLE)
    kind = words.pop(0) if words and args.source and words[0] in kinds else TRAFFIC_FORMATS[0]
    if kind == EXAMPLE and not words:
        return "ngsim", shipped_scenes()["i80"].with_name(_SAMPLE)
    if len(words) == 1 and kind != EXAMPLE:
        return kind, Path(words[0])
    if len(words) > 1 and args.source and kind == TRAFFIC_FORMATS[0]:
        raise unknown_name(words[0], kinds, "format", "--from")
    wanted = "no FILE" if kind == EXAMPLE else "one FILE of trajectories, or --from example"
    raise InputError(f"init: {len(words)} files given; allowed: {wanted}")


def _recorded(config: Path, named: SumoConfig, folder: Path) -> Path:
    """The recording that SUMO's configuration has written; where there is none yet, SUMO is run."""
    if named.data is not None and named.data.exists():
        return named.data
    program = _sumo()
    if program is None:
        missing = "names no fcd-output" if named.data is None else f"names {named.data}, which is not there"
        raise InputError(
            f"{config}: {missing}; write it with SUMO: sumo -c {shlex.quote(str(config))} --fcd-output run.fcd.xml; "
            f"then: blender-lidar init FOLDER --from sumo run.fcd.xml --vehicle-types {shlex.quote(str(config))}"
        )
    make_folder(folder, "FOLDER")
    path = folder / RECORDING
    note(f"SUMO writes {path}")
    with whole_file(path) as temporary:
        written = temporary.with_name(f"{temporary.name}.xml.gz")  # SUMO packs what ends so
        options = ["--fcd-output", written, "--device.fcd.period", _FCD_PERIOD_S, "--xml-validation", "never"]
        words = [str(program), "-c", str(config), *map(str, options), "--no-step-log", "--no-warnings"]
        try:
            done = subprocess.run(words, capture_output=True, text=True, check=False)
            if done.returncode:
                told = [line for line in done.stderr.splitlines() if line.startswith("Error")] or ["no reason given"]
                raise InputError(f"{config}: SUMO stopped: {one_line(told[0])}")
            written.replace(temporary)
        finally:
            written.unlink(missing_ok=True)
    return path


def _sumo() -> Path | None:
    """The program of SUMO: of the package eclipse-sumo, else of ``SUMO_HOME``, else on the path."""
    homes = [os.environ.get("SUMO_HOME", "")]
    if importlib.util.find_spec("sumo") is not None:
        homes.insert(0, getattr(importlib.import_module("sumo"), "SUMO_HOME", ""))
    folders = [str(Path(home, "bin")) for home in homes if home]
    found = shutil.which("sumo", path=os.pathsep.join([*folders, os.environ.get("PATH", "")]))
    return Path(found) if found else None


def _map_of(args: argparse.Namespace) -> RoadSettings:
    """[road] of the map that is given; without one the road is where vehicles drive."""
    if args.net and args.road:
        raise InputError(f"--net {args.net} and --road {args.road}: two maps; allowed: one")
    for path in filter(None, (args.net, args.road)):
        if not Path(path).exists():
            raise MissingFileError(f"{path}: there is no such file")
    return RoadSettings(net=args.net, opendrive=args.road, driven=not (args.net or args.road))


def _check(folder: Path, inputs: list[Path]) -> None:
    """Refuse a folder with a scene, or with anything but the files that the scene will name."""
    check_folder(folder, "FOLDER")
    if (folder / SCENE).exists():
        raise InputError(f"FOLDER: {folder}: holds a {SCENE} already, and nothing is overwritten; give another folder")
    parts = [Path(os.path.relpath(path.absolute(), folder.absolute())).parts[0] for path in inputs]
    check_unused(folder, "FOLDER", "init", lambda path: path.name in parts)
