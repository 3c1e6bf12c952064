"""A SceneSpec as Blender data. Meshes are made once and kept; everything else is rebuilt for every scene."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from datagen.blender.materials import make_material, pattern_color
from datagen.blender.settle import settle
from datagen.scenes.looks import HDRIS
from datagen.scenes.primitives import unit_shape
from datagen.scenes.spec import Light, SceneSpec, Surroundings
from multicam.geometry.mesh import Mesh

_SMOOTH_BELOW = np.deg2rad(35)
"""Edges sharper than this stay edges."""
_CLEAR_OF_TABLE = 1e-4
"""Metres by which tables and floors sink, so that their tops never lie in the plane of an object's face."""


class Builder:
    """Holds the meshes and the current scene."""

    def __init__(self, meshes: dict[int, Mesh]) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._meshes = {obj_id: _make_mesh(f"object {obj_id}", mesh) for obj_id, mesh in meshes.items()}
        self._primitives: dict[str, Any] = {}
        self._instances: list[Any] = []
        self._solids: list[Any] = []
        self._world = bpy.data.worlds.new("world")
        bpy.context.scene.world = self._world

    def build(self, scene: SceneSpec) -> None:
        """Replaces the scene; the pass index of object i is i + 1, and 0 means everything unlabelled."""
        _clear()
        self._instances, self._solids = [], []
        for index, item in enumerate(scene.objects):
            thing = _add(f"instance {index}", self._meshes[item.obj_id], item.world_from_object)
            thing.pass_index = index + 1
            self._instances.append(thing)
            _dress(thing, make_material(f"instance {index}", item.surface, thing.data))
        for index, solid in enumerate(scene.solids):
            pose = solid.world_from_solid @ np.diag([*solid.size, 1.0])
            if pose[2, 3] < 0:
                pose[2, 3] -= _CLEAR_OF_TABLE
            thing = _add(f"solid {index}", self._primitive(solid.shape), pose)
            self._solids.append(thing)
            _dress(thing, make_material(f"solid {index}", solid.surface, thing.data))
        for index, light in enumerate(scene.lights):
            _add(f"light {index}", _make_light(f"light {index}", light), light.world_from_light)
        _surround(self._world, scene.surroundings)

    def arrange(self, scene: SceneSpec, shot: int) -> None:
        """Puts every labelled object where it stands in a shot."""
        for thing, item in zip(self._instances, scene.objects_in(shot), strict=True):
            thing.matrix_world = Matrix(item.world_from_object)

    def settle(self, scene: SceneSpec) -> NDArray[np.float64]:
        """World poses (n, 4, 4) of all labelled objects after the loose ones fell; mounted groups stay."""
        poses = np.stack([item.world_from_object for item in scene.objects])
        loose = np.array([not item.mounted for item in scene.objects])
        movable, mounted = ([self._instances[i] for i in np.flatnonzero(which)] for which in (loose, ~loose))
        poses[loose] = settle(movable, mounted, self._solids)
        return poses

    def _primitive(self, shape: str) -> Any:
        if shape not in self._primitives:
            self._primitives[shape] = _make_mesh(shape, unit_shape(shape))
        return self._primitives[shape]


def _clear() -> None:
    for thing in list(bpy.data.objects):
        if thing.type != "CAMERA":
            bpy.data.objects.remove(thing)
    for collection in (bpy.data.materials, bpy.data.lights, bpy.data.images, bpy.data.actions):
        for block in list(collection):
            collection.remove(block)
    # Between the pictures of a scene persistent data save time; beyond it Cycles would never forget what is gone,
    # 0.3 MB a scene. Switching them off frees them.
    bpy.context.scene.render.use_persistent_data = False
    bpy.context.scene.render.use_persistent_data = True


def _make_mesh(name: str, mesh: Mesh) -> Any:
    made = bpy.data.meshes.new(name)
    made.from_pydata(mesh.vertices.tolist(), [], mesh.faces.tolist())
    _paint(made, mesh)
    made.shade_smooth()
    made.set_sharp_from_angle(angle=_SMOOTH_BELOW)
    # A slot for the material, which belongs to the object: instances of a class look different.
    made.materials.append(None)
    made.use_fake_user = True
    return made


def _paint(made: Any, mesh: Mesh) -> None:
    """Vertex colours as the attribute "Color", the texture's coordinates as "UVMap"; its file stays with the mesh."""
    if mesh.colors is not None:
        linear = np.ones((len(mesh.vertices), 4), dtype=np.float32)
        linear[:, :3] = (mesh.colors / 255.0) ** 2.2
        made.color_attributes.new("Color", "FLOAT_COLOR", "POINT").data.foreach_set("color", linear.reshape(-1))
    if mesh.uv is not None and mesh.texture is not None:
        corners = np.empty(len(made.loops), dtype=np.int32)
        made.loops.foreach_get("vertex_index", corners)
        made.uv_layers.new(name="UVMap").uv.foreach_set("vector", mesh.uv[corners].astype(np.float32).reshape(-1))
        made["texture"] = str(mesh.texture.resolve())


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
    output, light = nodes.new("ShaderNodeOutputWorld"), nodes.new("ShaderNodeBackground")
    link(_environment(nodes, link, surroundings), light.inputs["Color"])
    light.inputs["Strength"].default_value = surroundings.strength
    seen = light
    if surroundings.backdrop is not None:
        # Rays from the camera see the backdrop; all others still meet the environment.
        seen, picture, ray = (
            nodes.new("ShaderNodeMixShader"),
            nodes.new("ShaderNodeBackground"),
            nodes.new("ShaderNodeLightPath"),
        )
        where = nodes.new("ShaderNodeTexCoord").outputs["Window"]
        link(pattern_color(nodes, link, where, surroundings.backdrop), picture.inputs["Color"])
        picture.inputs["Strength"].default_value = surroundings.strength
        link(ray.outputs["Is Camera Ray"], seen.inputs["Fac"])
        link(light.outputs["Background"], seen.inputs[1])
        link(picture.outputs["Background"], seen.inputs[2])
    link(seen.outputs[0], output.inputs["Surface"])


def _environment(nodes: Any, link: Any, surroundings: Surroundings) -> Any:
    """The socket of the light's colour by its direction."""
    where, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    link(where.outputs["Generated"], turn.inputs["Vector"])
    turn.inputs["Rotation"].default_value = (0.0, 0.0, surroundings.turn)
    if surroundings.hdri is not None:
        picture = nodes.new("ShaderNodeTexEnvironment")
        bundled = Path(bpy.utils.system_resource("DATAFILES")) / "studiolights" / "world" / f"{surroundings.hdri}.exr"
        picture.image = bpy.data.images.load(str(bundled if surroundings.hdri in HDRIS else surroundings.hdri))
        link(turn.outputs["Vector"], picture.inputs["Vector"])
        return picture.outputs["Color"]
    ramp, split = nodes.new("ShaderNodeValToRGB"), nodes.new("ShaderNodeSeparateXYZ")
    link(turn.outputs["Vector"], split.inputs["Vector"])
    link(split.outputs["Z"], ramp.inputs["Fac"])
    ramp.color_ramp.elements[0].color = (*surroundings.horizon, 1.0)
    ramp.color_ramp.elements[1].color = (*surroundings.zenith, 1.0)
    return ramp.outputs["Color"]
