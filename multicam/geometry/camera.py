"""Pinhole camera with OpenCV distortion. Pixel (0, 0) is the centre of the top-left pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics of one picture.

    Attributes:
        matrix: (3, 3) pixels; after an affine image warp M it is M @ K, so skew and a rotated block are allowed.
        width, height: pixels.
        distortion: OpenCV coefficients k1 k2 p1 p2 [k3 [k4 k5 k6]]; empty for none.
    """

    matrix: np.ndarray
    width: int
    height: int
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        matrix = np.asarray(self.matrix, dtype=np.float64)
        if matrix.shape != (3, 3) or not np.all(np.isfinite(matrix)) or abs(np.linalg.det(matrix)) < 1e-9:
            raise ValueError(f"camera matrix must be 3x3, finite and invertible; got {matrix.tolist()}")
        if len(self.distortion) not in (0, 4, 5, 8):
            raise ValueError(f"distortion needs 0, 4, 5 or 8 coefficients; got {len(self.distortion)}")
        object.__setattr__(self, "matrix", matrix)

    @classmethod
    def from_focal(cls, focal: float, width: int, height: int) -> Camera:
        """Square pixels and a centred principal point; focal length in pixels."""
        matrix = [[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]
        return cls(np.array(matrix, dtype=np.float64), width, height)

    def project(self, points_in_camera: Float64[np.ndarray, "*batch 3"]) -> Float64[np.ndarray, "*batch 2"]:
        """Pixels of points (metres) in front of the camera; the caller checks z > 0."""
        normalized = points_in_camera[..., :2] / points_in_camera[..., 2:]
        distorted = distort(normalized, self.distortion)
        return distorted @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    def unproject(
        self, pixels: Float64[np.ndarray, "*batch 2"], depth: Float64[np.ndarray, "*batch"] | float = 1.0
    ) -> Float64[np.ndarray, "*batch 3"]:
        """Points (metres) at the given depth along the optical axis whose images are the pixels."""
        normalized = undistort(self._normalized(pixels), self.distortion)
        homogeneous = np.concatenate((normalized, np.ones((*pixels.shape[:-1], 1))), axis=-1)
        return homogeneous * np.asarray(depth, dtype=np.float64)[..., None]

    def undistort_pixels(self, pixels: Float64[np.ndarray, "*batch 2"]) -> Float64[np.ndarray, "*batch 2"]:
        """Where the pixels would lie if the lens had no distortion, same camera matrix."""
        if not self.distortion:
            return pixels
        normalized = undistort(self._normalized(pixels), self.distortion)
        return normalized @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    def without_distortion(self) -> Camera:
        """The same camera with an ideal lens; pair it with `undistort_pixels`."""
        return replace(self, distortion=())

    def projection_jacobian(
        self, points_in_camera: Float64[np.ndarray, "*batch 3"]
    ) -> Float64[np.ndarray, "*batch 2 3"]:
        """d pixel / d point of the undistorted projection.

        Raises:
            ValueError: the camera has distortion; undistort the pixels first.
        """
        if self.distortion:
            raise ValueError("the projection Jacobian is that of an ideal lens; undistort the pixels first")
        x, y, z = np.moveaxis(points_in_camera, -1, 0)
        zero = np.zeros_like(x)
        rows = np.stack((1 / z, zero, -x / z**2, zero, 1 / z, -y / z**2), axis=-1)
        return self.matrix[:2, :2] @ rows.reshape(*x.shape, 2, 3)

    def warped(self, pixel_from_pixel: Float64[np.ndarray, "3 3"], width: int, height: int) -> Camera:
        """The camera of an image warped by an affine map of pixels: K' = M K.

        Raises:
            ValueError: the lens has distortion, which an affine map does not keep.
        """
        if self.distortion:
            raise ValueError("undistort before warping: K' = M K holds for an ideal lens only")
        return Camera(pixel_from_pixel @ self.matrix, width, height)

    def scaled(self, factor: float) -> Camera:
        """The camera of the same picture resized; half-pixel centres are kept aligned."""
        shift = (factor - 1) / 2
        warp = np.array([[factor, 0, shift], [0, factor, shift], [0, 0, 1.0]])
        size = round(self.width * factor), round(self.height * factor)
        return Camera(warp @ self.matrix, *size, self.distortion)

    def contains(self, pixels: Float64[np.ndarray, "*batch 2"]) -> np.ndarray:
        """Whether pixels lie on the sensor."""
        x, y = pixels[..., 0], pixels[..., 1]
        return np.asarray((x >= -0.5) & (y >= -0.5) & (x < self.width - 0.5) & (y < self.height - 0.5))

    def _normalized(self, pixels: np.ndarray) -> np.ndarray:
        return (pixels - self.matrix[:2, 2]) @ np.linalg.inv(self.matrix[:2, :2]).T


def distort(normalized: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """Applies the Brown-Conrady (4, 5) or rational (8 coefficients) model of OpenCV; (..., 2) to (..., 2)."""
    if not coefficients:
        return normalized
    k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *(0.0,) * (8 - len(coefficients)))
    x, y = normalized[..., 0], normalized[..., 1]
    r2 = x * x + y * y
    radial = (1 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    dx = 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack((x * radial + dx, y * radial + dy), axis=-1)


def undistort(distorted: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """Inverse of `distort` by Newton steps with a numerical Jacobian; exact to 1e-12 inside the model's range.

    Far outside the image a model may reach no such point, or several; the answer there means nothing.
    """
    if not coefficients:
        return distorted
    estimate, step = distorted.copy(), 1e-7
    for _ in range(12):
        error = distort(estimate, coefficients) - distorted
        x_axis, y_axis = (
            (distort(estimate + step * axis, coefficients) - distort(estimate - step * axis, coefficients)) / (2 * step)
            for axis in np.eye(2)
        )
        determinant = _cross(x_axis, y_axis)
        # Where the model folds over, a full step would know no bounds.
        determinant = np.where(np.abs(determinant) > 1e-3, determinant, 1.0)
        change = np.stack((_cross(error, y_axis), _cross(x_axis, error)), axis=-1) / determinant[..., None]
        estimate = estimate - change
    return estimate


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
