"""What the Python interface returns: runs, scores and scans, with their tables and pictures."""

from __future__ import annotations

import html
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .clouds.files import LIDARS, write_cloud
from .clouds.scan import PointCloud, class_names
from .document import ANSWER, DOUBT
from .errors import InputError, unknown_name
from .files import write_bytes
from .report.text import document_text
from .run.folder import RunFolder
from .run.words import each_lidar
from .scene.mounting import COORDINATES
from .scene.site import Site
from .traffic.boxes import Boxes


def table_of(columns: Mapping[str, np.ndarray]):
    """A DataFrame where pandas is installed, else the dictionary."""
    try:
        from pandas import DataFrame
    except ImportError:
        return dict(columns)
    return DataFrame(dict(columns))


class Run(RunFolder):
    """What a run came to; as text it is its answer, in a notebook a table of that.

    Parameters
    ----------
    site : Site
        What the mounting is judged on.
    path : path, optional
        Its folder; one that nobody asked for lives as long as this object.

    Attributes
    ----------
    result : dict
        The content of result.json.
    complete : bool
        False where the run was stopped: its best mounting so far is judged.
    """

    def __init__(self, site: Site, path: str | Path | None = None) -> None:
        super().__init__(tempfile.mkdtemp(prefix="blender_lidar-") if path is None else path)
        if path is None:
            weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)
        self.site, self.complete = site, True

    @property
    def mounting(self) -> dict[str, float] | dict[str, dict[str, float]]:
        """The six coordinates [m, degrees]; of several LiDARs those of each by its name."""
        found = {
            name: {key: one["deployment"][key] for key in COORDINATES} for name, one in each_lidar(self.result).items()
        }
        return found.get("", found)

    @property
    def vehicles(self):
        """What the mounting sees of each vehicle in each frame: a table in the columns of vehicles.csv."""
        return table_of(self.optimised)

    @property
    def baseline_vehicles(self):
        """The same vehicles under the baseline."""
        return table_of(self.baseline)

    @property
    def history(self):
        """Every evaluation of the search, a table in the columns of history.csv; None for a given mounting."""
        return None if self.result["search"] is None else table_of(self.read_columns())

    @property
    def score_map(self):
        """Objective and detectable share over heights and tilts, a table; None where the run has no map.

        Of several LiDARs such a table of each by its name, the others held.
        """
        found = {name: self._map_of(name) for name in each_lidar(self.result)}
        return found.get("", found)

    def _map_of(self, lidar: str):
        """The table of a LiDAR's score map; None where it has none."""
        if (found := self.read_score_map(lidar)) is None:
            return None
        height, tilt = np.meshgrid(found.height_m, found.tilt_deg, indexing="ij")
        scores = {"objective_per_vehicle": found.per_vehicle, "detectable_share": found.detectable_share}
        columns = {"height_m": height, found.tilt: tilt, **scores}
        return table_of({name: values.ravel() for name, values in columns.items()})

    @property
    def plot(self) -> Plots:
        """Its pictures, each drawn when it is called."""
        return Plots(self)

    def report(self) -> str:
        """All that is told of it, as ``blender-lidar report RUN --all`` prints it."""
        return document_text(self.document, every=True)

    def __repr__(self) -> str:
        return f"<Run: {self}>"

    def __str__(self) -> str:
        doubts = (one.text for one in self.document.of(DOUBT))
        return " ".join([*doubts, *(f"{one.label}: {one.text}." for one in self.document.of(ANSWER, first=True))])

    def _repr_html_(self) -> str:
        lines = "".join(
            f"<tr><th>{html.escape(one.label)}</th><td>{html.escape(one.text)}</td></tr>"
            for one in self.document.of(DOUBT, ANSWER, first=True)
        )
        stopped = "" if self.complete else "<p>The run was stopped; this is its best so far.</p>"
        return f"<p>{html.escape(self.document.title)}</p>{stopped}<table>{lines}</table>"


class Picture(bytes):
    """A picture as PNG, which a notebook shows."""

    def _repr_png_(self) -> bytes:
        return bytes(self)

    def write(self, path: str | Path) -> None:
        """Write it, whole or not at all."""
        write_bytes(path, bytes(self))


@dataclass(frozen=True)
class Plots:
    """The pictures of a run; they need matplotlib (the extra "plots")."""

    run: Run

    def score_map(self, lidar: str = "") -> Picture:
        """Objective over height and tilt, with the optimum, and the baseline on its pole; of several LiDARs of one."""
        names = each_lidar(self.run.result)
        if lidar not in names:
            raise unknown_name(lidar, names, "LiDAR", "score_map")
        if (found := self.run.read_score_map(lidar)) is None:
            raise InputError("score_map: the run has none: it was no full search, or it was stopped")
        return self._drawn("plot_score_map", score_map=found, lidar=lidar)

    def search(self) -> Picture:
        """How the best objective rose with the number of mountings tried."""
        if self.run.result["search"] is None:
            raise InputError("search: the run has no history: its mounting was given, or it was stopped")
        return self._drawn("plot_convergence", history=self.run.read_columns(of_search=True))

    def by_distance(self) -> Picture:
        """Scores and detectable shares by distance, before and after."""
        return self._drawn("plot_by_distance")

    def blind_zones(self) -> Picture:
        """Where on the road vehicles are not detectable, and how far half of them are, before and after."""
        scenario = self.run.site.scenario
        return self._drawn("plot_blind_zones", road=scenario.road_map, zones=scenario.objective.zones)

    def _drawn(self, name: str, **settings) -> Picture:
        from .report import run_figures

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "picture.png")
            getattr(run_figures, name)(path, run=self.run, **settings)
            return Picture(path.read_bytes())


@dataclass(frozen=True, eq=False)
class Score:
    """What a mounting comes to on a site's frames.

    Attributes
    ----------
    mounting : dict of str to float
        The six coordinates [m, degrees]; of several LiDARs such a dict of each, by name.
    objective, objective_per_vehicle : float
        Eq. 10, in the metric's unit: its sum, and its mean over the vehicles.
    detectable_share : float
        Share of the vehicles at or above the threshold.
    vehicles : DataFrame or dict of ndarray
        What it sees of each vehicle in each frame, in the columns of vehicles.csv.
    alone : dict of str to Score
        Of a layout of several LiDARs the same of each alone, by name.
    """

    mounting: dict[str, Any]
    objective: float
    objective_per_vehicle: float
    detectable_share: float
    vehicles: Any
    alone: dict[str, Score] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution over a frame.

    Attributes
    ----------
    cloud : PointCloud
        The returns, ground included [m, road frame].
    vehicles : Boxes
        The boxes of the frame.
    header : dict
        Sensor, pose and settings, as files of clouds keep them.
    """

    cloud: PointCloud
    vehicles: Boxes
    header: dict[str, object]

    @property
    def points(self):
        """A row for each return: x, y, z and range [m], ring, time [s], vehicle, class and intensity."""
        cloud = self.cloud
        columns = dict(zip(("x_m", "y_m", "z_m"), cloud.xyz.T, strict=True))
        columns |= {"range_m": cloud.range_m, "ring": cloud.ring, "time_s": cloud.time_s}
        columns |= {"vehicle_id": cloud.vehicle_id, "class": class_names(cloud.class_index)}
        columns |= {"lidar": cloud.lidar} if LIDARS in self.header else {}
        return table_of({**columns, "intensity": cloud.intensity})

    def write(self, path: str | Path) -> None:
        """Write it as the suffix says: .npz, .pcd, .ply, .bin, .las or .laz."""
        write_cloud(path, self.cloud, self.header)
