"""What the verbs chart and stability share: how a study is carried out in its folder."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace

from ..report.study import StudyReport
from ..scene.site import Site
from ..signals import stops_recognised
from ..studies.driver import StudyFolder
from .optimise import say
from .options import default_folder
from .progress import Progress
from .report import describe_site


def effort_of(args: argparse.Namespace, full, quick):
    """How much is done; where frames are asked for, none of them is left out."""
    effort = quick if args.quick else full
    asked = args.frames is not None or args.frame_ids is not None
    return replace(effort, frames=None) if asked else effort


def carry_out(
    args: argparse.Namespace,
    verb: str,
    site: Site,
    identity: Mapping[str, object],
    report: StudyReport,
    study: Callable[[StudyFolder], dict],
) -> int:
    """Make a study in its folder, write what it leaves and tell of it; returns the exit code.

    Without --out the folder is named after the scene and the verb.
    """
    folder = StudyFolder(args.out or default_folder(site.scenario, verb), identity, report.files, Progress)
    with folder.locked(resume=args.resume):
        say(args, describe_site(site, verbose=args.verbose) + "\n")
        try:
            with stops_recognised():
                result = study(folder)
        except KeyboardInterrupt:
            print(f"blender-lidar: stopped; go on with: --out {folder.path} --resume", file=sys.stderr)
            return 1
        written = report.write(folder, result)
    say(args, f"{report.text(result)}\n\nResults in {folder.path}: {', '.join(written)}")
    if args.json:
        print(json.dumps(result, indent=2))
    return 0
