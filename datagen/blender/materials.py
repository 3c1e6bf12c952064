"""A Surface as a Blender material: a Principled BSDF, a procedural pattern in it, fine noise on its roughness."""

from __future__ import annotations

from typing import Any

import bpy

from datagen.scenes.spec import Surface

_PATTERNS = {
    "noise": ("ShaderNodeTexNoise", "Fac"),
    "voronoi": ("ShaderNodeTexVoronoi", "Distance"),
    "brick": ("ShaderNodeTexBrick", "Fac"),
    "wave": ("ShaderNodeTexWave", "Fac"),
    "checker": ("ShaderNodeTexChecker", "Fac"),
}
"""Node type and the output that goes from one colour to the other."""
_WEAR_SCALE = 400.0
"""Repeats per metre of the noise on the roughness: scratches and finger marks."""


def make_material(name: str, surface: Surface) -> Any:
    """A new material; patterns live in object coordinates, so they move with the thing."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    shader = nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*surface.color, 1.0)
    shader.inputs["Metallic"].default_value = surface.metallic
    shader.inputs["Roughness"].default_value = surface.roughness
    if surface.pattern == "plain" and surface.roughness_spread == 0:
        return material
    # The geometry's position is in metres whatever the scale of the thing; a vector turned back into its frame.
    where, frame = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeVectorTransform")
    frame.vector_type, frame.convert_from, frame.convert_to = "POINT", "WORLD", "OBJECT"
    link(where.outputs["Position"], frame.inputs["Vector"])
    if surface.pattern != "plain":
        _add_pattern(nodes, link, shader, frame.outputs["Vector"], surface)
    if surface.roughness_spread > 0:
        _add_wear(nodes, link, shader, frame.outputs["Vector"], surface)
    return material


def _add_pattern(nodes: Any, link: Any, shader: Any, vector: Any, surface: Surface) -> None:
    kind, output = _PATTERNS[surface.pattern]
    pattern, mix = nodes.new(kind), nodes.new("ShaderNodeMix")
    pattern.inputs["Scale"].default_value = surface.scale
    link(vector, pattern.inputs["Vector"])
    mix.data_type = "RGBA"
    factor = next(s for s in mix.inputs if s.identifier == "Factor_Float")
    first = next(s for s in mix.inputs if s.identifier == "A_Color")
    second = next(s for s in mix.inputs if s.identifier == "B_Color")
    mixed = next(s for s in mix.outputs if s.identifier == "Result_Color")
    first.default_value, second.default_value = (*surface.color, 1.0), (*surface.second, 1.0)
    link(pattern.outputs[output], factor)
    link(mixed, shader.inputs["Base Color"])
    if surface.bump > 0:
        bump = nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = surface.bump
        bump.inputs["Distance"].default_value = 0.2 / surface.scale
        link(pattern.outputs[output], bump.inputs["Height"])
        link(bump.outputs["Normal"], shader.inputs["Normal"])


def _add_wear(nodes: Any, link: Any, shader: Any, vector: Any, surface: Surface) -> None:
    noise, spread = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeMapRange")
    noise.inputs["Scale"].default_value = _WEAR_SCALE
    link(vector, noise.inputs["Vector"])
    link(noise.outputs["Fac"], spread.inputs["Value"])
    spread.inputs["From Min"].default_value, spread.inputs["From Max"].default_value = 0.3, 0.7
    spread.inputs["To Min"].default_value = max(0.02, surface.roughness - surface.roughness_spread)
    spread.inputs["To Max"].default_value = min(1.0, surface.roughness + surface.roughness_spread)
    link(spread.outputs["Result"], shader.inputs["Roughness"])
