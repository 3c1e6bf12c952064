"""Steps of cameras and objects: search, a few damped Gauss-Newton steps over all poses, search again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multicam.bundle.adjustment.config import AdjustmentConfig
from multicam.bundle.adjustment.scene import Scene
from multicam.bundle.adjustment.search import Found, edge_poses, search_pictures
from multicam.bundle.factor import EdgeFactor, Linearization
from multicam.bundle.normal import NormalEquations
from multicam.bundle.occlusion import Occluders
from multicam.bundle.problem import Problem, State
from multicam.bundle.region.colors import ColorModel
from multicam.bundle.robust import Student
from multicam.geometry import se3
from multicam.matching.arrays import BoolArray, IntArray
from multicam.matching.linear import apply, inverse, squared_norm
from multicam.types import FloatArray

UNKNOWN = 1.0
"""Information, per squared radian or metre, about every edge: nothing is off by more than about one of them."""


@dataclass(frozen=True, eq=False)
class Participants:
    """Who takes part: a camera that does not stays, an object that does not is left out.

    Attributes:
        camera: (c,); fixed ones take part unless what they see is not to be believed.
        object: (o,).
        fixed: (c,) cameras that do not move.
    """

    camera: BoolArray
    object: BoolArray
    fixed: BoolArray

    def both(self, camera: IntArray, obj: IntArray) -> BoolArray:
        """(e,) whether camera (e,) and object (e,) of an edge take part."""
        return self.camera[camera] & self.object[obj]


@dataclass(frozen=True, eq=False)
class Descent:
    """Where searches and steps ended.

    Attributes:
        weight: (e,) of the edges in the last step.
        seen: what lines and points of the last search say of the edges (e,) there.
    """

    state: State
    weight: FloatArray
    seen: Linearization


@dataclass(frozen=True, eq=False)
class System:
    """Scene, participants and configuration: from what a search found to a step.

    Attributes:
        colors: (e,) of each object in each picture.
        occluders: (c,).
        believed: (e,) greatest weights of the edges; None for 1 each.
    """

    scene: Scene
    participants: Participants
    occluders: Sequence[Occluders]
    colors: Sequence[ColorModel]
    config: AdjustmentConfig
    believed: FloatArray | None = None

    def descend(self, state: State, searches: Sequence[int]) -> Descent:
        """The state after searches of these numbers."""
        weight = np.ones(len(self.scene.camera)) if self.believed is None else self.believed
        found = Found.nothing(len(weight))
        for search in searches:
            found = self.search(state, search)
            for update in range(self.config.updates):
                state, weight = self.step(found.in_update(update, self.config), state, weight)
        return Descent(state, weight, found.linearize(edge_poses(self.scene, state)))

    def search(self, state: State, search: int) -> Found:
        """Lines and points at a state."""
        return search_pictures(self.scene, state, self.occluders, self.colors, search, self.config)

    def step(self, found: Found, state: State, weight: FloatArray) -> tuple[State, FloatArray]:
        """One step of everything, or of the objects and then of the cameras; and the weights that it leaves."""
        if self.config.joint:
            return self._step(found, state, weight, self.participants.fixed)
        state, weight = self._step(found, state, weight, np.ones_like(self.participants.fixed))
        moved, _ = self._step(found, state, weight, self.participants.fixed, objects=False)
        return moved, weight

    def _step(
        self, found: Found, state: State, weight: FloatArray, fixed: BoolArray, objects: bool = True
    ) -> tuple[State, FloatArray]:
        """A step, taken again with weights by what it would leave of each edge's disagreement."""
        pose = edge_poses(self.scene, state)
        local = found.linearize(pose)
        weight = self.revised(local, pose, self._moved(local, pose, state, weight, fixed, objects))
        return self._moved(local, pose, state, weight, fixed, objects), weight

    def _moved(
        self, local: Linearization, pose: FloatArray, state: State, weight: FloatArray, fixed: BoolArray, objects: bool
    ) -> State:
        """The state after a damped Gauss-Newton step; without `objects`, of the cameras alone."""
        system = self.assemble(local, pose, state, weight)
        if not objects:
            system.coupling[:] = 0
            system.object_gradient[:] = 0
        return Problem((), fixed).retract(state, system.without(fixed).solve(0.0))

    def revised(self, local: Linearization, pose: FloatArray, moved: State) -> FloatArray:
        """(e,) weights of edges by how far from its own minimum, by its own measure, a state leaves each."""
        shift = se3.minus(edge_poses(self.scene, moved), pose)
        rest = local.gradient + apply(local.hessian, shift)
        squared = squared_norm(rest, inverse(local.hessian + UNKNOWN * np.eye(6)))
        return np.minimum(1 if self.believed is None else self.believed, Student(self.config.tail, 6).weight(squared))

    def assemble(
        self, local: Linearization, pose: FloatArray, state: State, weight: FloatArray, damped: bool = True
    ) -> NormalEquations:
        """The system of all cameras and objects from what is measured (e,), the priors and the motions."""
        scene, taking = self.scene, self.participants
        system = NormalEquations.zeros(len(scene.pictures), len(scene.bodies))
        config = self.config
        still = (
            np.diag([config.rotation_damping] * 3 + [config.translation_damping] * 3) if damped else np.zeros((6, 6))
        )
        taken = taking.both(scene.camera, scene.object)
        held = replace(local, hessian=weight[:, None, None] * local.hessian + still + UNKNOWN * np.eye(6))
        held = replace(held, gradient=weight[:, None] * local.gradient)
        system.add_edges(scene.camera, scene.object, pose, held, taken.astype(np.float64))
        for prior, at, terms in self._priors(state):
            kernel, squared = prior.kernel, 2 * terms.energy
            share = kernel.weight(squared) if damped else kernel.information(squared)
            system.add_edges(prior.camera, prior.object, at, terms, share * taking.both(prior.camera, prior.object))
        for motion in scene.ties:
            system.add_motions(motion.first, motion.second, motion.linearize(state.world_from_camera))
        # An object that takes no part has no gradient and stays, whatever stands here.
        system.object_hessian[~taking.object] += np.eye(6)
        return system

    def energy(self, found: Found, state: State, weight: FloatArray) -> float:
        """Energy of a state by lines and points found somewhere, edges weighted (e,), with priors and motions."""
        scene, taking = self.scene, self.participants
        weight = weight * taking.both(scene.camera, scene.object)
        total = float(weight @ found.linearize(edge_poses(scene, state)).energy)
        for prior, _, terms in self._priors(state):
            total += float(taking.both(prior.camera, prior.object) @ prior.kernel.energy(2 * terms.energy))
        return total + sum(float(each.linearize(state.world_from_camera).energy.sum()) for each in scene.ties)

    def _priors(self, state: State) -> Iterator[tuple[EdgeFactor, FloatArray, Linearization]]:
        """What was estimated before, with the poses of its edges at a state and its energy there."""
        for prior in self._estimates:
            at = state.camera_from_object(prior.camera, prior.object)
            yield prior, at, prior.linearize(at)

    @cached_property
    def _estimates(self) -> tuple[EdgeFactor, ...]:
        return self.scene.priors(self.config.tail)

    def covariances(self, state: State, local: Linearization, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of cameras (c, 6, 6; zero where fixed) and objects (o, 6, 6) at a minimum, given what is measured there."""
        fixed, pose = self.participants.fixed, edge_poses(self.scene, state)
        free, objects = self.assemble(local, pose, state, weight, damped=False).without(fixed).covariances()
        cameras = np.zeros((len(fixed), 6, 6))
        cameras[~fixed] = free
        return cameras, objects
