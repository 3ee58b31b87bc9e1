"""Coverage of chosen objects: which share of their surface each LiDAR and all together see at this moment."""

import csv
import io
import json

import bpy
import numpy as np
from bpy.props import FloatProperty

from ..casting import resolve
from ..casting.protocol import StandingScenery
from ..errors import InputError
from ..metrics.surface_cells import cells_with_points, surface_cells
from ..world.blender.site import is_own, scanned, visible_triangles
from . import operators, panels, properties, scenarios, session

_TEXT = "LiDAR coverage.csv"


class BLENDER_LIDAR_OT_coverage(operators.NeedsLidar, bpy.types.Operator):
    """Share of the surface of the selected objects that each LiDAR and all together see at this moment"""

    bl_idname, bl_label, bl_options = "blender_lidar.coverage", "Coverage of Selection", {"REGISTER", "UNDO"}
    edge_m: FloatProperty(
        name="Cell", default=0.1, min=0.001, unit="LENGTH", description="Edge of the cubes that surfaces are counted in"
    )

    @operators.one_line_errors
    def execute(self, context):
        """Scan exactly with each, and count cells."""
        scene, layer = context.scene, context.view_layer
        chosen = {item for item in context.selected_objects if is_own(item)}
        wanted, edge_m = scanned(scene, layer), properties.exact(self.edge_m)

        def is_chosen(item, by):
            return item.original in chosen or by.original in chosen

        mine = visible_triangles(scene, lambda *of: not is_chosen(*of), layer=layer)
        if not len(mine):
            raise InputError("no object with faces is selected and visible; allowed: objects of your own")
        rest = visible_triangles(scene, lambda *of: is_chosen(*of) or not wanted(*of), layer=layer)
        mine.label[:] = 0
        cells, found = surface_cells(mine.corners, edge_m), scenarios.lidars_of(scene)
        caster, manager = resolve(scene.blender_lidar.model.caster, "caster"), context.window_manager
        standing = [StandingScenery(part, caster) for part in (mine, rest) if len(part)]
        seen, points = np.zeros((len(found) + 1, len(cells)), bool), []
        manager.progress_begin(0, len(found))
        try:
            for number, lidar in enumerate(found):
                frame, pose = session.live_frame(scene, lidar, exact=True), properties.mounting_of(lidar).pose
                cloud = frame.look(pose, standing).cloud
                points.append(int((cloud.label == 0).sum()))
                seen[number] = cells_with_points(cells, cloud.xyz[cloud.label == 0], edge_m)
                manager.progress_update(number)
        finally:
            manager.progress_end()
        seen[-1] = seen.any(axis=0)
        names, counts = [*(lidar.name for lidar in found), "All"], seen.sum(axis=1).tolist()
        shares = seen.mean(axis=1).round(4).tolist()
        rows = list(zip(names, [*points, sum(points)], counts, shares, strict=True))
        of = ", ".join(sorted(set(mine.names))) if len(chosen) < 5 else f"{len(chosen)} objects"
        scene.blender_lidar.covered = json.dumps({"of": of, "cells": len(cells), "edge_m": edge_m, "rows": rows})
        written = io.StringIO()
        csv.writer(written, lineterminator="\n").writerows([("lidar", "points", "cells", "share"), *rows])
        (bpy.data.texts.get(_TEXT) or bpy.data.texts.new(_TEXT)).from_string(written.getvalue())
        self.report({"INFO"}, f"{100 * rows[-1][-1]:.1f} % of {len(cells):,} cells of {of}; text {_TEXT}")
        return {"FINISHED"}


@panels.panel("Coverage", panels.BLENDER_LIDAR_PT_main.__name__, bl_options={"DEFAULT_CLOSED"}, bl_order=8)
class BLENDER_LIDAR_PT_coverage(panels.OfLidar, bpy.types.Panel):
    """Which share of chosen objects the LiDARs see."""

    def draw_for(self, layout, scene, lidar):
        """The button, and a row for each LiDAR."""
        layout.operator("blender_lidar.coverage", icon="MESH_GRID", translate=False)
        told = json.loads(scene.blender_lidar.covered or "{}")
        if not told:
            return
        panels.say(layout, f"Of all {told['cells']:,} surface cells of {told['edge_m']:g} m of {told['of']}:")
        for name, points, _, share in told["rows"]:
            panels.say(layout, f"{name}: {100 * share:.1f} %, {points:,} points")


classes = (BLENDER_LIDAR_OT_coverage, BLENDER_LIDAR_PT_coverage)
