"""Objects fall and come to rest: Bullet's rigid bodies, as Blender has them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

_FRAMES = 100
"""Four seconds at Blender's 24 frames a second; the damping below brings everything to rest by then."""
_DAMPING = 0.3
_FRICTION = 0.8
_MARGIN = 5e-4
"""Metres that Bullet keeps between shapes; its default would leave objects floating visibly."""


_DIRECTIONS = 300
"""In which a hull's vertices are looked for: scans have thousands, which take Bullet a minute a scene. What is cut off
is at most half a percent of the radius."""


def settle(movable: Sequence[Any], mounted: Sequence[Any], solids: Sequence[Any]) -> NDArray[np.float64]:
    """World poses (n, 4, 4) of Blender objects after they fell onto each other and onto what is fixed.

    Bodies of triangle meshes are unstable when they move and slow in any case, so all but mounted groups are convex
    hulls.
    """
    scene = bpy.context.scene
    bpy.ops.rigidbody.world_add()
    world = scene.rigidbody_world
    world.collection = bpy.data.collections.new("bodies")
    world.substeps_per_frame, world.solver_iterations = 20, 25
    world.point_cache.frame_start, world.point_cache.frame_end = 1, _FRAMES
    hulls, ground = [_hull(thing) for thing in movable], [_hull(thing) for thing in solids]
    try:
        for hull in hulls:
            _make_body(hull, world, "ACTIVE", "CONVEX_HULL")
        for hull in ground:
            _make_body(hull, world, "PASSIVE", "CONVEX_HULL")
        for thing in mounted:
            _make_body(thing, world, "PASSIVE", "MESH")
        for frame in range(1, _FRAMES + 1):
            scene.frame_set(frame)
        return np.array([hull.matrix_world for hull in hulls], dtype=np.float64).reshape(-1, 4, 4)
    finally:
        bodies = world.collection
        bpy.ops.rigidbody.world_remove()
        bpy.data.collections.remove(bodies)
        for hull in hulls + ground:
            bpy.data.meshes.remove(hull.data)
        scene.frame_set(1)


def _hull(thing: Any) -> Any:
    """A stand-in made of the outermost vertices of a thing."""
    vertices = np.empty((len(thing.data.vertices), 3), dtype=np.float32)
    thing.data.vertices.foreach_get("co", vertices.reshape(-1))
    number = np.arange(_DIRECTIONS) + 0.5
    height, turn = 1 - 2 * number / _DIRECTIONS, np.pi * (1 + np.sqrt(5)) * number
    flat = np.sqrt(1 - height**2)
    directions = np.stack((flat * np.cos(turn), flat * np.sin(turn), height))
    mesh = bpy.data.meshes.new("hull")
    mesh.from_pydata(vertices[np.unique(np.argmax(vertices @ directions, axis=0))].tolist(), [], [])
    hull = bpy.data.objects.new("hull", mesh)
    bpy.context.scene.collection.objects.link(hull)
    hull.matrix_world = thing.matrix_world
    return hull


def _make_body(thing: Any, world: Any, kind: str, shape: str) -> None:
    world.collection.objects.link(thing)
    body = thing.rigid_body
    body.type, body.collision_shape, body.mesh_source = kind, shape, "BASE"
    body.friction, body.restitution = _FRICTION, 0.0
    body.linear_damping = body.angular_damping = _DAMPING
    body.use_margin, body.collision_margin = True, _MARGIN
