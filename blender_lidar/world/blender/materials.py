"""Materials: plain ones by name, and the one that colours a point cloud by its attributes."""

from __future__ import annotations

import bpy

from ..shapes import GLASS, PAINT, ROAD, STRUCTURE
from .roles import KEY, of_ours

# Linear RGB. Classes are told apart by lightness too.
CLASS_COLOURS = {
    "car": (0.10, 0.23, 0.48),
    "van": (0.16, 0.42, 0.40),
    "truck": (0.72, 0.36, 0.08),
    "bus": (0.70, 0.58, 0.10),
    "motorcycle": (0.50, 0.06, 0.10),
}
GLASS_COLOUR = (0.012, 0.016, 0.02)
ASPHALT, VERGE, LINE = (0.045, 0.047, 0.05), (0.10, 0.125, 0.07), (0.75, 0.75, 0.72)
CONCRETE, METAL, HEAD, BEAM = (0.34, 0.33, 0.31), (0.30, 0.31, 0.33), (0.02, 0.02, 0.025), (0.9, 0.12, 0.08)

SURFACE_KEY = "blender_lidar_surface"  # custom property: index into `shapes.SURFACES`


def plain(name: str, colour: tuple[float, float, float], surface: int = STRUCTURE, roughness: float = 0.7):
    """A material of one colour, (r, g, b) linear; the one that we made of that name before is used again."""
    material = of_ours(bpy.data.materials, name)
    if material is not None:
        return material
    material = bpy.data.materials.new(name)
    material[KEY], material[SURFACE_KEY] = name, surface
    material.diffuse_color = (*colour, 1.0)
    material.roughness = roughness
    if bpy.app.version < (5, 0):  # from then on they always do
        material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = (*colour, 1.0)
    shader.inputs["Roughness"].default_value = roughness
    return material


def paint_of(vehicle_class: str) -> bpy.types.Material:
    """The paint of a class of vehicles."""
    return plain(f"Paint {vehicle_class}", CLASS_COLOURS[vehicle_class], PAINT, 0.35)


def glass() -> bpy.types.Material:
    """Windows: dark and glossy."""
    return plain("Glass", GLASS_COLOUR, GLASS, 0.05)


def asphalt() -> bpy.types.Material:
    """The carriageway."""
    return plain("Asphalt", ASPHALT, ROAD, 0.9)


def point_material(name: str, bits: tuple[float, float]) -> bpy.types.Material:
    """Colours points on vehicles by their vehicle's `entropy` over a range of bits, and all others faintly by `range`.

    The points shine by themselves, so that their colours are those of the ramps under any light.
    """
    material = bpy.data.materials.new(name)
    material[KEY] = name
    material.diffuse_color = (0.9, 0.6, 0.1, 1.0)
    if bpy.app.version < (5, 0):  # from then on they always do
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    on_vehicle = _ramp(tree, "entropy", bits, ((0.85, 0.05, 0.02), (0.95, 0.55, 0.02), (0.55, 0.95, 0.25)))
    elsewhere = _ramp(tree, "range", (0.0, 100.0), ((0.16, 0.20, 0.26), (0.08, 0.10, 0.14)))
    is_vehicle = tree.nodes.new("ShaderNodeMath")
    is_vehicle.operation = "GREATER_THAN"
    is_vehicle.inputs[1].default_value = -0.5
    tree.links.new(_attribute(tree, "vehicle"), is_vehicle.inputs[0])
    mix, output = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(is_vehicle.outputs[0], mix.inputs[0])
    tree.links.new(elsewhere, mix.inputs[1])
    tree.links.new(on_vehicle, mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    for column, node in enumerate(tree.nodes):
        node.location = (220.0 * (column % 5), -260.0 * (column // 5))
    return material


def _attribute(tree, name):
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    return node.outputs["Fac"]


def _ramp(tree, attribute, bounds, colours):
    """A shining colour that runs through `colours` as an attribute goes from one bound to the other."""
    scaled = tree.nodes.new("ShaderNodeMapRange")
    scaled.inputs["From Min"].default_value, scaled.inputs["From Max"].default_value = bounds
    tree.links.new(_attribute(tree, attribute), scaled.inputs["Value"])
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    elements = ramp.color_ramp.elements
    elements[0].color, elements[-1].color = (*colours[0], 1.0), (*colours[-1], 1.0)
    for place, colour in enumerate(colours[1:-1], start=1):
        elements.new(place / (len(colours) - 1)).color = (*colour, 1.0)
    tree.links.new(scaled.outputs[0], ramp.inputs["Fac"])
    shine = tree.nodes.new("ShaderNodeEmission")
    tree.links.new(ramp.outputs["Color"], shine.inputs["Color"])
    return shine.outputs[0]
