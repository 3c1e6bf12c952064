"""A Surface as a Blender material: a Principled BSDF, a pattern or picture in it, fine noise on its roughness."""

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


def make_material(name: str, surface: Surface, mesh: Any) -> Any:
    """A new material for a Blender mesh; patterns live in object coordinates, so they move with the thing."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    shader = nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*surface.color, 1.0)
    shader.inputs["Metallic"].default_value = surface.metallic
    shader.inputs["Roughness"].default_value = surface.roughness
    own = _own_color(nodes, mesh) if surface.original else None
    if own is not None:
        link(_product(nodes, link, own, surface.color), shader.inputs["Base Color"])
    elif surface.picture is not None:
        # Generated coordinates go from 0 to 1 over the thing's box.
        box = nodes.new("ShaderNodeTexCoord").outputs["Generated"]
        link(pattern_color(nodes, link, box, surface), shader.inputs["Base Color"])
    elif surface.pattern != "plain":
        _add_pattern(nodes, link, shader, _metres(nodes, link), surface)
    if surface.roughness_spread > 0:
        _add_wear(nodes, link, shader, _metres(nodes, link), surface)
    return material


def pattern_color(nodes: Any, link: Any, where: Any, surface: Surface) -> Any:
    """The colour socket of a surface's picture or pattern at the coordinates of the socket `where`."""
    if surface.picture is not None:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image, picture.extension = bpy.data.images.load(surface.picture, check_existing=True), "EXTEND"
        link(where, picture.inputs["Vector"])
        return picture.outputs["Color"]
    return _two_colors(nodes, link, _pattern(nodes, link, where, surface), surface)


def _own_color(nodes: Any, mesh: Any) -> Any | None:
    """The colour socket of a mesh's texture or vertex colours; None if it has neither."""
    if "texture" in mesh:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(mesh["texture"], check_existing=True)
        return picture.outputs["Color"]
    if "Color" in mesh.color_attributes:
        attribute = nodes.new("ShaderNodeVertexColor")
        attribute.layer_name = "Color"
        return attribute.outputs["Color"]
    return None


def _product(nodes: Any, link: Any, socket: Any, tint: tuple[float, float, float]) -> Any:
    product = nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    link(socket, product.inputs[0])
    product.inputs[1].default_value = tint
    return product.outputs["Vector"]


def _metres(nodes: Any, link: Any) -> Any:
    """The geometry's position is in metres whatever the scale of the thing; a vector turned back into its frame."""
    where, frame = nodes.new("ShaderNodeNewGeometry"), nodes.new("ShaderNodeVectorTransform")
    frame.vector_type, frame.convert_from, frame.convert_to = "POINT", "WORLD", "OBJECT"
    link(where.outputs["Position"], frame.inputs["Vector"])
    return frame.outputs["Vector"]


def _pattern(nodes: Any, link: Any, where: Any, surface: Surface) -> Any:
    """The socket of a pattern's values, 0 to 1."""
    kind, output = _PATTERNS[surface.pattern]
    pattern = nodes.new(kind)
    pattern.inputs["Scale"].default_value = surface.scale
    link(where, pattern.inputs["Vector"])
    return pattern.outputs[output]


def _two_colors(nodes: Any, link: Any, value: Any, surface: Surface) -> Any:
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    factor = next(s for s in mix.inputs if s.identifier == "Factor_Float")
    first = next(s for s in mix.inputs if s.identifier == "A_Color")
    second = next(s for s in mix.inputs if s.identifier == "B_Color")
    first.default_value, second.default_value = (*surface.color, 1.0), (*surface.second, 1.0)
    link(value, factor)
    return next(s for s in mix.outputs if s.identifier == "Result_Color")


def _add_pattern(nodes: Any, link: Any, shader: Any, where: Any, surface: Surface) -> None:
    value = _pattern(nodes, link, where, surface)
    link(_two_colors(nodes, link, value, surface), shader.inputs["Base Color"])
    if surface.bump > 0:
        bump = nodes.new("ShaderNodeBump")
        bump.inputs["Strength"].default_value = surface.bump
        bump.inputs["Distance"].default_value = 0.2 / surface.scale
        link(value, bump.inputs["Height"])
        link(bump.outputs["Normal"], shader.inputs["Normal"])


def _add_wear(nodes: Any, link: Any, shader: Any, where: Any, surface: Surface) -> None:
    noise, spread = nodes.new("ShaderNodeTexNoise"), nodes.new("ShaderNodeMapRange")
    noise.inputs["Scale"].default_value = _WEAR_SCALE
    link(where, noise.inputs["Vector"])
    link(noise.outputs["Fac"], spread.inputs["Value"])
    spread.inputs["From Min"].default_value, spread.inputs["From Max"].default_value = 0.3, 0.7
    spread.inputs["To Min"].default_value = max(0.02, surface.roughness - surface.roughness_spread)
    spread.inputs["To Max"].default_value = min(1.0, surface.roughness + surface.roughness_spread)
    link(spread.outputs["Result"], shader.inputs["Roughness"])
