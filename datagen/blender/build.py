"""A SceneSpec as Blender data. Meshes are made once and kept; everything else is rebuilt for every scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from datagen.blender.materials import make_material
from datagen.scenes.primitives import primitive
from datagen.scenes.spec import Light, SceneSpec, Surroundings
from multicam.geometry.mesh import Mesh

_SMOOTH_BELOW = np.deg2rad(35)
"""Edges sharper than this stay edges."""
_CLEAR_OF_TABLE = 1e-4
"""Metres by which the table's top sinks, so that it never lies in the plane of an object's face."""


class Builder:
    """Holds the meshes and the current scene."""

    def __init__(self, meshes: dict[int, Mesh]) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._meshes = {obj_id: _make_mesh(f"object {obj_id}", mesh) for obj_id, mesh in meshes.items()}
        self._primitives: dict[str, Any] = {}
        self._instances: list[Any] = []
        self._world = bpy.data.worlds.new("world")
        bpy.context.scene.world = self._world

    def build(self, scene: SceneSpec) -> None:
        """Replaces the scene; the pass index of object i is i + 1, and 0 means everything unlabelled."""
        _clear()
        self._instances = []
        for index, item in enumerate(scene.objects):
            thing = _add(f"instance {index}", self._meshes[item.obj_id], item.world_from_object)
            thing.pass_index = index + 1
            self._instances.append(thing)
            _dress(thing, make_material(f"instance {index}", item.surface))
        for index, solid in enumerate(scene.solids):
            pose = solid.world_from_solid @ np.diag([*solid.size, 1.0])
            pose[2, 3] -= _CLEAR_OF_TABLE
            thing = _add(f"solid {index}", self._primitive(solid.shape), pose)
            _dress(thing, make_material(f"solid {index}", solid.surface))
        for index, light in enumerate(scene.lights):
            _add(f"light {index}", _make_light(f"light {index}", light), light.world_from_light)
        _surround(self._world, scene.surroundings)

    def arrange(self, scene: SceneSpec, shot: int) -> None:
        """Puts every labelled object where it stands in a shot."""
        for thing, item in zip(self._instances, scene.objects_in(shot), strict=True):
            thing.matrix_world = Matrix(item.world_from_object)

    def _primitive(self, shape: str) -> Any:
        if shape not in self._primitives:
            self._primitives[shape] = _make_mesh(shape, primitive(shape))
        return self._primitives[shape]


def _clear() -> None:
    for thing in list(bpy.data.objects):
        if thing.type != "CAMERA":
            bpy.data.objects.remove(thing)
    for collection in (bpy.data.materials, bpy.data.lights, bpy.data.images):
        for block in list(collection):
            collection.remove(block)


def _make_mesh(name: str, mesh: Mesh) -> Any:
    made = bpy.data.meshes.new(name)
    made.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    made.shade_smooth()
    made.set_sharp_from_angle(angle=_SMOOTH_BELOW)
    # A slot for the material, which belongs to the object: instances of a class look different.
    made.materials.append(None)
    made.use_fake_user = True
    return made


def _add(name: str, data: Any, world_from_thing: np.ndarray) -> Any:
    thing = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(thing)
    # A bare list would be taken as columns.
    thing.matrix_world = Matrix(world_from_thing)
    return thing


def _dress(thing: Any, material: Any) -> None:
    thing.material_slots[0].link = "OBJECT"
    thing.material_slots[0].material = material


def _make_light(name: str, light: Light) -> Any:
    made = bpy.data.lights.new(name, "POINT" if light.point else "AREA")
    made.energy, made.color = light.watts, light.color
    if light.point:
        made.shadow_soft_size = light.radius
    else:
        made.shape, made.size = "DISK", 2 * light.radius
    return made


def _surround(world: Any, surroundings: Surroundings) -> None:
    world.use_nodes = True
    # The importance map of the environment is the largest cost of a small picture; 256 is enough.
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    nodes, link = world.node_tree.nodes, world.node_tree.links.new
    nodes.clear()
    output, background = nodes.new("ShaderNodeOutputWorld"), nodes.new("ShaderNodeBackground")
    where, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    link(where.outputs["Generated"], turn.inputs["Vector"])
    link(background.outputs["Background"], output.inputs["Surface"])
    turn.inputs["Rotation"].default_value = (0.0, 0.0, surroundings.turn)
    background.inputs["Strength"].default_value = surroundings.strength
    if surroundings.hdri is not None:
        picture = nodes.new("ShaderNodeTexEnvironment")
        folder = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world"
        picture.image = bpy.data.images.load(str(folder / f"{surroundings.hdri}.exr"))
        link(turn.outputs["Vector"], picture.inputs["Vector"])
        link(picture.outputs["Color"], background.inputs["Color"])
        return
    ramp, split = nodes.new("ShaderNodeValToRGB"), nodes.new("ShaderNodeSeparateXYZ")
    link(turn.outputs["Vector"], split.inputs["Vector"])
    link(split.outputs["Z"], ramp.inputs["Fac"])
    ramp.color_ramp.elements[0].color = (*surroundings.horizon, 1.0)
    ramp.color_ramp.elements[1].color = (*surroundings.zenith, 1.0)
    link(ramp.outputs["Color"], background.inputs["Color"])
