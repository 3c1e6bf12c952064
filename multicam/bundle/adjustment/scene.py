"""What an adjustment is given: pictures, bodies, who sees what, and what was known before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from multicam.bundle.adjustment.keypoints import EdgeKeypoints
from multicam.bundle.bearing import BearingFactor
from multicam.bundle.depth_image import DepthImage
from multicam.bundle.factor import EdgeFactor
from multicam.bundle.ideal import require_ideal
from multicam.bundle.odometry import OdometryFactor
from multicam.bundle.pair import PairFactor
from multicam.bundle.pose import PoseFactor
from multicam.bundle.robust import Student
from multicam.bundle.viewpoints.model import ViewpointModel
from multicam.geometry.camera import Camera
from multicam.geometry.mesh import Mesh
from multicam.matching.arrays import BoolArray, IntArray
from multicam.types import FloatArray, ImageArray


@dataclass(frozen=True, eq=False)
class Picture:
    """What one camera took.

    Attributes:
        image: (height, width, 3) RGB.
        camera: its intrinsics, without distortion.
        depth: the picture of the depth camera fixed to it, or None.
    """

    image: ImageArray
    camera: Camera
    depth: DepthImage | None = None

    def __post_init__(self) -> None:
        require_ideal(self.image, self.camera)


@dataclass(frozen=True, eq=False)
class Body:
    """One object: its sparse viewpoint model and the mesh that hides others."""

    model: ViewpointModel
    mesh: Mesh


@dataclass(frozen=True, eq=False)
class Scene:
    """Cameras (c), objects (o) and edges (e) between them.

    Attributes:
        pictures: (c,) one of each camera.
        bodies: (o,).
        camera, object: (e,) which camera sees which object; edges that were found not to belong are left out.
        estimated: (e, 4, 4) camera_from_object as that camera alone has it, the symmetric twin that fits the others.
            Colours are learnt there, for it lies on the contour better than a pose that all agree on.
        information: (e, 6, 6) inverse covariances of the right perturbations of `estimated`.
        fixed: (c,) cameras that do not move. Each set of cameras that hang together needs one.
        motions: measured motions between cameras.
        kinship: how much larger the variances of the estimates are than their agreement shows, for they err alike.
        bearings: motions whose lengths nobody measured, as the pictures show them beside the objects.
        keypoints: what a detector saw of some edges. There they say what the estimate would, and their reprojection
            holds further from it than a covariance does.
        camera_covariance, object_covariance: (c, 6, 6) and (o, 6, 6) of the poses to begin with (right tangents); none
            of them moves beyond what these allow. Zero for fixed cameras.
    """

    pictures: Sequence[Picture]
    bodies: Sequence[Body]
    camera: IntArray
    object: IntArray
    estimated: FloatArray
    information: FloatArray
    fixed: BoolArray
    camera_covariance: FloatArray
    object_covariance: FloatArray
    motions: Sequence[OdometryFactor] = ()
    kinship: float = 1.0
    bearings: Sequence[BearingFactor] = ()
    keypoints: EdgeKeypoints = field(default_factory=EdgeKeypoints.none)

    def priors(self, tail: float) -> tuple[EdgeFactor, ...]:
        """Keypoints, and the estimated poses of edges without, as observations with Student noise."""
        bare = np.setdiff1d(np.arange(len(self.camera)), self.keypoints.edge)
        poses = PoseFactor(
            self.camera[bare], self.object[bare], self.estimated[bare], self.information[bare], Student(tail, 6)
        )
        keypoints = self.keypoints.factor(self.camera, self.object, Student(tail, 2))
        return tuple(factor for factor in (poses, keypoints) if len(factor.camera))

    @property
    def ties(self) -> tuple[PairFactor, ...]:
        """All that ties two cameras each."""
        return (*self.motions, *self.bearings)

    def trusted(self, share: float) -> Scene:
        """The same with a share of the information of the estimates."""
        wider = self.keypoints.widened(np.full(len(self.camera), share**-0.5))
        return replace(self, information=share * self.information, keypoints=wider)

    def unrelated(self, cameras: BoolArray, objects: BoolArray) -> BoolArray:
        """(c,) cameras that no object seen by two of them, nor a measured motion, ties to a fixed one.

        Args:
            cameras, objects: (c,) and (o,) which of them are to be believed.
        """
        ties = np.zeros((len(self.pictures), len(self.bodies)), dtype=np.bool_)
        ties[self.camera, self.object] = True
        ties &= cameras[:, None] & objects
        ties[:, ties.sum(axis=0) < 2] = False
        motion = np.zeros((len(self.pictures), len(self.pictures)), dtype=np.bool_)
        for each in self.motions:
            motion[each.first, each.second] = motion[each.second, each.first] = True
        reached = self.fixed.copy()
        while True:
            wider = reached | (ties @ (reached @ ties)) | (reached @ motion)
            if np.array_equal(wider, reached):
                return ~reached
            reached = wider
