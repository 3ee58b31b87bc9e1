"""The user's own objects as the scan knows them: labels, reflectivity and glass by their materials."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from blender_lidar.addon.preview import VisibleObjects
from blender_lidar.casting.protocol import StandingScenery
from blender_lidar.clouds.files import LABELS, read_cloud, write_cloud
from blender_lidar.sensors.beams import beam_lattice
from blender_lidar.sensors.imperfections import Imperfections
from blender_lidar.sensors.model import load_model
from blender_lidar.sensors.pose import Pose
from blender_lidar.world.blender.objects import new_mesh, nodes_of, plain
from blender_lidar.world.blender.scene import empty_scene
from blender_lidar.world.blender.site import LABELS_BY, Labels, open_scenery, read_site, visible_triangles
from blender_lidar.world.meshes import (
    BUILDING,
    GLASS,
    OWN_SURFACE,
    REFLECTIVITY,
    ROAD,
    STRUCTURE,
    SURFACE_CLASS,
    VEGETATION,
    surface_of,
)
from tests.sample_traffic import dense_traffic, scan

pytestmark = pytest.mark.versions

QUAD = np.array([(-1.0, -1.0, 0.0), (1.0, -1.0, 0.0), (1.0, 1.0, 0.0), (-1.0, 1.0, 0.0)])
FACES = np.array([(0, 1, 2), (0, 2, 3)])


@pytest.fixture
def scene():
    yield empty_scene()
    empty_scene()


def labels_by(by):
    """As of a scene that says so."""
    return Labels(SimpleNamespace(blender_lidar=SimpleNamespace(label_by=by)))


def material(name, **inputs):
    made = bpy.data.materials.new(name)
    shader = next(node for node in nodes_of(made).nodes if node.type == "BSDF_PRINCIPLED")
    shader.name = shader.label = "Prinzipielle BSDF"  # as a German Blender calls it
    for key, value in inputs.items():
        names = {"colour": ("Base Color",), "through": ("Transmission Weight", "Transmission")}[key]
        next(shader.inputs[name] for name in names if name in shader.inputs).default_value = value
    return made


def standing(scene, name, *materials, slots=None, into=None, **place):
    item = bpy.data.objects.new(name, new_mesh(name, QUAD, FACES, materials, slots))
    item.location = place.get("at", (0.0, 0.0, 0.0))
    (into or scene.collection).objects.link(item)
    return item


def test_reflectivity_and_glass_are_those_of_principled_bsdf(scene):
    linked = material("textured", colour=(1.0, 1.0, 1.0, 1.0))
    tree = linked.node_tree
    texture = tree.nodes.new("ShaderNodeTexChecker")
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    linked.diffuse_color = (0.25, 0.25, 0.25, 1.0)
    known = {
        "grey": (material("grey", colour=(0.35, 0.35, 0.35, 1.0)), 0.35),
        "red": (material("red", colour=(1.0, 0.0, 0.0, 1.0)), 0.2126),
        "brighter than white": (material("lamp", colour=(3.0, 3.0, 3.0, 1.0)), 1.0),
        "black": (material("black", colour=(0.0, 0.0, 0.0, 1.0)), 0.0),
        "frosted": (material("frosted", colour=(0.6, 0.6, 0.6, 1.0), through=0.4), 0.6),
        "textured": (linked, 0.25),
        "nothing": (None, REFLECTIVITY[STRUCTURE]),
        "ours": (plain("ours", (0.9, 0.9, 0.9), ROAD), REFLECTIVITY[ROAD]),
        "pane": (material("pane", colour=(1.0, 1.0, 1.0, 1.0), through=1.0), REFLECTIVITY[GLASS]),
    }
    for name, (of, _) in known.items():
        standing(scene, name, of)
    found = open_scenery(scene, scene.view_layers[0])
    assert sorted(found.names) == sorted(known)
    for row, name in enumerate(found.names):
        (surface,) = set(found.surface[found.owner == row].tolist())
        assert abs(REFLECTIVITY[surface] - known[name][1]) <= 0.0026, name
        assert (surface == GLASS) == (name == "pane"), name
    assert all(REFLECTIVITY[surface_of(value)] == pytest.approx(value) for value in np.arange(0, 1.001, 0.01))


def test_kinds_come_from_a_property_or_a_name_of_the_object_or_else_of_its_collection(scene, tmp_path):
    white, pane = material("white", colour=(0.8, 0.8, 0.8, 1.0)), material("pane", through=1.0)
    street, trees, inner = (bpy.data.collections.new(name) for name in ("Street", "Vegetation.001", "Houses"))
    scene.collection.children.link(street)
    street.children.link(trees)
    trees.children.link(inner)
    inner["kind"] = "Building"
    standing(scene, "Oak", white, into=trees)
    standing(scene, "House", white, pane, slots=np.array([0, 1]), into=inner)
    hedges, bower = (bpy.data.collections.new(name) for name in ("vegetations.002", "Buildings.002"))
    scene.collection.children.link(hedges)  # holds as many objects as the one in it
    hedges.children.link(bower)
    standing(scene, "Bower", white, into=bower)
    standing(scene, "Kiosk", into=trees)["kind"] = "structure"
    standing(scene, "buildings.002")
    standing(scene, "Sign", white)["kind"] = "traffic sign"
    bpy.data.libraries.write(str(tmp_path / "site.blend"), {scene}, fake_user=True)
    kinds = {"Oak": [VEGETATION] * 2, "House": [BUILDING, GLASS], "Kiosk": [STRUCTURE] * 2, "Sign": [OWN_SURFACE] * 2}
    kinds |= {"buildings.002": [BUILDING] * 2, "Bower": [BUILDING] * 2}
    reflects = {
        "Oak": [0.8] * 2,
        "House": [0.8, 0.1],
        "Bower": [0.8] * 2,
        "Kiosk": [0.3] * 2,
        "Sign": [0.8] * 2,
        "buildings.002": [0.3] * 2,
    }
    for found in (open_scenery(scene, scene.view_layers[0]), read_site(tmp_path / "site.blend")):
        assert sorted(found.names) == sorted(kinds)
        for row, name in enumerate(found.names):
            surface = found.surface[found.owner == row]
            assert SURFACE_CLASS[surface].tolist() == kinds[name], name
            np.testing.assert_allclose(REFLECTIVITY[surface], reflects[name], atol=0.0026, err_msg=name)


def test_a_cloud_and_its_files_say_the_kinds_of_objects(scene, tmp_path):
    laspy, plyfile = pytest.importorskip("laspy"), pytest.importorskip("plyfile")
    for name, x_m, of in (("Building", -4.0, None), ("Hedge", 0.0, "vegetation"), ("Sculpture", 4.0, None)):
        item = standing(scene, name, material(name, colour=(0.8, 0.8, 0.8, 1.0)))
        item.location, item.rotation_euler, item.scale = (x_m, 5.0, 2.0), (np.pi / 2, 0.0, 0.0), (1.5, 2.0, 1.0)
        if of:
            item["kind"] = of
    layer, pose = scene.view_layers[0], Pose(0.0, 0.0, 2.0)
    layer.update()
    objects, live = open_scenery(scene, layer), VisibleObjects()
    live.refresh(scene, layer.depsgraph)
    traffic, lattice = dense_traffic(vehicles=0, length_m=30.0), beam_lattice(load_model("RS-16"), stride=4)
    cloud = scan(traffic, lattice, pose, caster="exact", max_range_m=50.0, scenery=StandingScenery(objects, "exact"))
    ray, _, surface, *_ = live.met(pose.position, pose.to_world(lattice.components.reshape(3, -1).T), 50.0)
    assert {*SURFACE_CLASS[surface].tolist()} == {BUILDING, VEGETATION, OWN_SURFACE}
    assert len(ray) == (cloud.label >= 0).sum()
    header = {"sensor": "RS-16", "pose": pose.as_table(), "frame": 1, "rotation_hz": 10.0, LABELS: objects.labels}
    for suffix in (".npz", ".ply", ".pcd", ".las", ".bin"):
        write_cloud(tmp_path / f"cloud{suffix}", cloud, header)
    middle = np.rint(cloud.xyz[:, 0] / 4.0)[cloud.label >= 0]
    expected = np.array([BUILDING, VEGETATION, OWN_SURFACE])[(middle + 1).astype(int)]
    written = plyfile.PlyData.read(tmp_path / "cloud.ply")["vertex"]["surface"]
    np.testing.assert_array_equal(written[cloud.label >= 0], expected)
    assert (written[cloud.label < 0] == ROAD).all()
    assert b" class surface label\n" in (tmp_path / "cloud.pcd").read_bytes()
    names = np.load(tmp_path / "cloud.npz")["surface"]
    assert {*names[cloud.label >= 0].tolist()} == {"building", "vegetation", "own"}
    classes = np.asarray(laspy.read(tmp_path / "cloud.las").classification)[cloud.label >= 0]
    np.testing.assert_array_equal(classes, np.array([6, 5, 1])[(middle + 1).astype(int)])
    semantic = np.fromfile(tmp_path / "cloud.label", "<u4")[cloud.label >= 0] & 0xFFFF
    np.testing.assert_array_equal(semantic, np.array([50, 70, 99])[(middle + 1).astype(int)])


def test_a_file_says_of_its_materials_what_the_open_scene_does(scene, tmp_path):
    dark = material("dunkel", colour=(0.05, 0.05, 0.05, 1.0))
    standing(scene, "Bühne", dark, material("Scheibe", through=1.0), slots=np.array([0, 1]))
    bpy.data.libraries.write(str(tmp_path / "site.blend"), {scene}, fake_user=True)
    assert sorted(read_site(tmp_path / "site.blend").surface.tolist()) == sorted([GLASS, surface_of(0.05)])


def test_labels_come_from_object_collection_pass_index_or_material(scene):
    roofs = bpy.data.collections.new("Dächer")
    scene.collection.children.link(roofs)
    paints = [material("Ziegel"), material("Blech")]
    roof = standing(scene, "Dach", *paints, slots=np.array([0, 1]), into=roofs)
    standing(scene, "Mauer", paints[0]).pass_index = 7
    roof.pass_index = 3
    tree = bpy.data.collections.new("Baum")  # of instances the collection that they show
    standing(scene, "Krone", into=tree)
    copse = bpy.data.objects.new("Hain", None)
    copse.instance_type, copse.instance_collection, copse.location = "COLLECTION", tree, (9.0, 0.0, 0.0)
    scene.collection.objects.link(copse)
    expected = {
        "object": {"Dach": ["Dach", "Dach"], "Mauer": ["Mauer", "Mauer"], "Krone": ["Krone", "Krone"]},
        "collection": {"Dach": ["Dächer", "Dächer"], "Mauer": [None, None], "Krone": ["Baum", "Baum"]},
        "pass_index": {"Dach": ["3", "3"], "Mauer": ["7", "7"], "Krone": ["0", "0"]},
        "material": {"Dach": ["Ziegel", "Blech"], "Mauer": ["Ziegel", "Ziegel"], "Krone": [None, None]},
    }
    assert expected.keys() == LABELS_BY.keys()
    for by, names in expected.items():
        found = visible_triangles(scene, labels=labels_by(by))
        for row, name in enumerate(found.names):
            label = found.label[found.owner == row].tolist()
            assert [found.labels.get(number) for number in label] == names[name], (by, name)
            assert [number for number in label if number not in found.labels] in ([], [-1, -1])


def test_a_number_stays_while_other_objects_are_hidden(scene):
    for name in ("Auto", "Baum", "Zaun"):
        standing(scene, name)
    before = open_scenery(scene, scene.view_layers[0]).labels
    scene.objects["Auto"].hide_viewport = True
    after = open_scenery(scene, scene.view_layers[0]).labels
    assert after.items() < before.items()
    assert set(after.values()) == {"Baum", "Zaun"}


def test_a_cloud_is_labelled_and_as_bright_as_its_materials_and_files_keep_it(scene, tmp_path):
    item = standing(scene, "Tür", material("weiß", colour=(0.8, 0.8, 0.8, 1.0)))
    item.location, item.rotation_euler, item.scale = (0.0, 5.0, 2.0), (np.pi / 2, 0.0, 0.0), (3.0, 2.0, 1.0)
    objects, pose = open_scenery(scene, scene.view_layers[0]), Pose(0.0, 0.0, 2.0)

    def seen(scenery, **more):
        lattice, traffic = beam_lattice(load_model("RS-16"), stride=4), dense_traffic(vehicles=0, length_m=30.0)
        more |= {"caster": "exact", "max_range_m": 50.0, "scenery": StandingScenery(scenery, "exact")}
        return scan(traffic, lattice, pose, **more)

    cloud = seen(objects)
    mine = cloud.label >= 0
    assert mine.sum() > 50
    np.testing.assert_array_equal(mine, np.isclose(cloud.xyz[:, 1], 5.0))
    np.testing.assert_allclose(cloud.intensity[mine], 0.8 * 5.0 / cloud.range_m[mine], rtol=1e-6)
    header = {"sensor": "RS-16", "pose": pose.as_table(), "frame": 1, "rotation_hz": 10.0, LABELS: objects.labels}
    for suffix in (".npz", ".ply", ".pcd", ".las"):
        pytest.importorskip("laspy") if suffix == ".las" else None
        write_cloud(tmp_path / f"cloud{suffix}", cloud, header)
    back, told = read_cloud(tmp_path / "cloud.npz")
    np.testing.assert_array_equal(back.label, cloud.label)
    assert told[LABELS] == {str(number): "Tür" for number in objects.labels}
    body = (tmp_path / "cloud.ply").read_bytes()
    assert b"property int label\n" in body
    assert json.loads(body.split(b"comment ")[1].split(b"\n")[0])[LABELS] == told[LABELS]
    assert b" label\n" in (tmp_path / "cloud.pcd").read_bytes()
    pane = replace(objects, surface=np.full(len(objects), GLASS, np.uint8))
    assert (seen(pane).label >= 0).sum() == mine.sum()
    assert not (seen(pane, imperfections=Imperfections(glass_dropout=1.0)).label >= 0).any()


def test_linked_libraries_and_geometry_nodes_are_labelled_by_what_they_show(scene, tmp_path):
    tree = bpy.data.collections.new("Baum")
    standing(scene, "Krone", material("Laub", colour=(0.1, 0.1, 0.1, 1.0)), into=tree).pass_index = 5
    bpy.data.libraries.write(str(tmp_path / "trees.blend"), {tree}, fake_user=True)
    scene = empty_scene()
    with bpy.data.libraries.load(str(tmp_path / "trees.blend"), link=True) as (_, here):
        here.collections = ["Baum"]
    forest = bpy.data.objects.new("Wald", None)
    forest.instance_type, forest.instance_collection = "COLLECTION", here.collections[0]
    scene.collection.objects.link(forest)
    meadow, group = standing(scene, "Wiese"), bpy.data.node_groups.new("Streu", "GeometryNodeTree")
    group.interface.new_socket(name="Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    kinds = ("GeometryNodeMeshGrid", "GeometryNodeObjectInfo", "GeometryNodeInstanceOnPoints", "NodeGroupOutput")
    grid, shown, placed, out = map(group.nodes.new, kinds)
    shown.inputs["Object"].default_value, shown.inputs["As Instance"].default_value = bpy.data.objects["Krone"], True
    group.links.new(grid.outputs["Mesh"], placed.inputs["Points"])
    group.links.new(shown.outputs["Geometry"], placed.inputs["Instance"])
    group.links.new(placed.outputs["Instances"], out.inputs[0])
    meadow.modifiers.new("Streu", "NODES").node_group = group
    for by, name in (("object", "Krone"), ("collection", "Baum"), ("pass_index", "5"), ("material", "Laub")):
        found = visible_triangles(scene, labels=labels_by(by))
        assert set(found.labels.values()) == {name}, by
        assert (found.label >= 0).all()
        assert len(found.names) == 10  # one of the library, nine of the nodes
    assert set(found.surface.tolist()) == {surface_of(0.1)}
