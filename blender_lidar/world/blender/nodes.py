"""Nodes of Blender's node trees, made and joined in a line each: for geometry, materials and worlds."""

from __future__ import annotations

import bpy
import numpy as np


def node(tree, kind, inputs=None, **settings):
    """A new node, with settings, and its inputs, by index or name, joined to an output or set."""
    made = tree.nodes.new(kind)
    made.location = (200.0 * (len(tree.nodes) % 8), -300.0 * (len(tree.nodes) // 8))
    for name, value in settings.items():
        setattr(made, name, value)
    sockets = [one for one in made.inputs if one.enabled]
    for key, value in (inputs or {}).items():
        into = sockets[key] if isinstance(key, int) else next(one for one in sockets if one.name == key)
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, into)
        else:
            into.default_value = value
    return made


def output(tree, kind, inputs=None, **settings):
    """The first output of a new node, as `node` makes it."""
    return next(one for one in node(tree, kind, inputs, **settings).outputs if one.enabled)


def math_of(tree, operation, *values):
    """A number made of others."""
    return output(tree, "ShaderNodeMath", dict(enumerate(values)), operation=operation)


def ramp_of(tree, value, colours):
    """A color ramp: linear RGB between colours that are evenly apart, of a value from 0 to 1."""
    made = node(tree, "ShaderNodeValToRGB", {0: value})
    stops = made.color_ramp.elements
    for place in np.linspace(0.0, 1.0, len(colours))[1:-1]:
        stops.new(place)
    for stop, colour in zip(stops, colours, strict=True):
        stop.color = (*colour, 1.0)
    return made.outputs[0]


def light_nothing(material):
    """Let Cycles not look for light from what shines only to be seen: it would make noise and take time."""
    settings = getattr(material, "cycles", None)  # of Cycles' add-on; the second one before Blender 3.5
    for name, value in (("emission_sampling", "NONE"), ("sample_as_light", False)):
        if hasattr(settings, name):
            setattr(settings, name, value)
    return material
