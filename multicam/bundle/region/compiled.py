# pyright: basic, reportUntypedFunctionDecorator=false
# Numba ships no types; colors, lines and factor, which wrap these kernels, are strict.
"""Correspondence lines, compiled: counting colours, searching the contour, and its energy.

The mathematics is that of Stoiber et al., "SRT3D: A sparse region-based 3D object tracking approach for the real world"
(IJCV 2022) and "Iterative corresponding geometry" (CVPR 2022): a line crosses the contour along its normal; segments of
some pixels along it belong to the object or to the background with probabilities that their colours tell; a smoothed
step slid along them gives the posterior of where the contour lies.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from multicam.bundle.occlusion_compiled import find_visible
from multicam.bundle.pixels import focal_length, inside, projected, transformed
from multicam.bundle.viewpoints.compiled import closest_view

STEP = 8
"""Segments over which the step from object to background is smoothed."""

SHIFTS = 12
"""Shifts of the contour, one segment apart and centred on zero, of which a line knows the posterior."""

SEGMENTS = STEP + SHIFTS - 1
MIDDLE = (SHIFTS - 1) / 2

AMPLITUDE, SLOPE = 0.43, 0.5
"""Of the smoothed step: it leaves room for noise, and for a contour that is not quite the model's."""

OBJECT_STEP = 0.5 - AMPLITUDE * np.tanh((np.arange(STEP) - (STEP - 1) / 2) / (2 * SLOPE))
"""Share of object in each of its segments, from the inside to the outside."""

LEAST_VARIANCE = max(1 / (2 * math.atanh(2 * AMPLITUDE) ** 2), SLOPE)
"""Squared segments: the variance of the posterior of a perfect line."""

LINE = np.dtype(
    [
        ("point", np.float64, 3),
        ("direction", np.float64, 2),
        ("origin", np.float64),
        ("mean", np.float64),
        ("variance", np.float64),
        ("weight", np.float64),
        ("likelihood", np.float64, SHIFTS),
    ]
)
"""A line: point of the contour in the object frame; the shift, in segments, of a pixel p is direction . p - origin;
mean and variance of its posterior; weight in the energy; posterior of each shift, relative to the likeliest."""


@njit(cache=True, nogil=True, error_model="numpy")
def color_bin(flat, pixel):
    """Index among 16 x 16 x 16 of the RGB colour whose bytes begin at `pixel`."""
    return (flat[pixel] >> 4) << 8 | (flat[pixel + 1] >> 4) << 4 | flat[pixel + 2] >> 4


@njit(cache=True, nogil=True, error_model="numpy")
def image_normal(pose, normal):
    """Direction in the image of a normal (3,) of the contour; zero if it points along the optical axis."""
    x = pose[0, 0] * normal[0] + pose[0, 1] * normal[1] + pose[0, 2] * normal[2]
    y = pose[1, 0] * normal[0] + pose[1, 1] * normal[1] + pose[1, 2] * normal[2]
    length = math.sqrt(x * x + y * y)
    return (x / length, y / length) if length > 1e-9 else (0.0, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def count_colors(image, matrix, pose, point, normal, foreground, background, seen, nearest, farthest, counts):
    """See ColorModel: adds to counts (2, 4096) the colours inside and outside of the contour at a pose (4, 4)."""
    focal, flat = focal_length(matrix), np.ascontiguousarray(image).reshape(-1)
    for i in range(len(point)):
        x, y, z = transformed(pose, point[i, 0], point[i, 1], point[i, 2])
        if not seen[i] or z <= 0:
            continue
        u, v = projected(matrix, x, y, z)
        if not inside(u, v, image.shape):
            continue
        nu, nv = image_normal(pose, normal[i])
        main = max(abs(nu), abs(nv))
        if main == 0:
            continue
        for side in range(2):
            reach, sign = (foreground[i], -1.0) if side == 0 else (background[i], 1.0)
            length = min(farthest, reach * focal / z - 2 * nearest)
            for k in range(int(length * main + 0.5)):
                column = math.floor(u + sign * nu * (nearest + k / main) + 0.5)
                row = math.floor(v + sign * nv * (nearest + k / main) + 0.5)
                if not (0 <= column < image.shape[1] and 0 <= row < image.shape[0]):
                    break
                counts[side, color_bin(flat, 3 * (row * image.shape[1] + column))] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def search_contour(
    image, matrix, pose, posterior, images, radius, threshold, direction, length, point, normal, foreground, background,
    offset, offset_step, scales, deviations, clear, lines,
):  # fmt: skip
    """See find_lines: writes `lines`, at the first scale at which there are enough, and returns how many there are."""
    view, n = closest_view(direction, pose), len(lines)
    if length[view] == 0:
        return 0
    seen = find_visible(images, radius, threshold, point[view, :n], offset[view, :n], offset_step, pose)
    count = 0
    for scale, deviation in zip(scales, deviations):  # noqa: B905 - not in compiled code
        count = search_lines(
            image, matrix, pose, posterior, point[view, :n], normal[view, :n], foreground[view, :n],
            background[view, :n], seen, scale, deviation, clear, lines,
        )  # fmt: skip
        if 2 * count >= n:
            break
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def search_lines(
    image, matrix, pose, posterior, point, normal, foreground, background, seen, scale, deviation, clear, lines
):  # fmt: skip
    """Writes `lines` of a view at one scale and returns how many there are; `seen` tells which may be looked for."""
    focal = focal_length(matrix)
    # One index into the picture, not three, takes a fifth of the time off a line.
    flat, (height, width) = np.ascontiguousarray(image).reshape(-1), image.shape[:2]
    on_object = np.empty(SEGMENTS)
    count = 0
    for i in range(len(point)):
        x, y, z = transformed(pose, point[i, 0], point[i, 1], point[i, 2])
        if not seen[i] or z <= 0 or min(foreground[i], background[i]) * focal < clear * scale * z:
            continue
        u, v = projected(matrix, x, y, z)
        nu, nv = image_normal(pose, normal[i])
        main = max(abs(nu), abs(nv))
        if main == 0 or not inside(u, v, image.shape):
            continue
        if abs(nu) > abs(nv):
            rounding = read_segments(flat, 3, 3 * width, width, height, posterior, u, v, nu, nv, scale, on_object)
        else:
            rounding = read_segments(flat, 3 * width, 3, height, width, posterior, v, u, nv, nu, scale, on_object)
        if math.isnan(rounding):
            continue
        line = lines[count]
        per_pixel = main / scale
        line.point[0], line.point[1], line.point[2] = point[i, 0], point[i, 1], point[i, 2]
        line.direction[0], line.direction[1] = nu * per_pixel, nv * per_pixel
        line.origin = (nu * u + nv * v + rounding) * per_pixel
        line.weight = LEAST_VARIANCE / (per_pixel * deviation) ** 2
        line.mean, line.variance = slide_step(on_object, line.likelihood)
        count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def read_segments(flat, along, across, length, breadth, posterior, u, v, nu, nv, scale, on_object):
    """Probability that each segment is of the object, from inside to outside, of a line through (u, v).

    The line is followed along the axis of u, of `length` pixels that lie `along` bytes apart in the picture, whose
    other axis has `breadth` pixels, `across` bytes apart.

    Returns:
        Pixels along the normal by which rounding to whole pixels moved the line; NaN if it leaves the image.
    """
    span = SEGMENTS * scale
    half = (span - 1) / 2
    start = math.floor(u - half + 0.5)
    slope = nv / nu
    first = v + slope * (start - u) + 0.5
    last = first + slope * (span - 1)
    if not (start >= 0 and start + span <= length):
        return math.nan
    if not (min(first, last) >= 0 and max(first, last) < breadth):
        return math.nan
    for segment in range(SEGMENTS):
        a = b = 1.0
        for k in range(segment * scale, (segment + 1) * scale):
            p = posterior[color_bin(flat, (start + k) * along + int(first + slope * k) * across)]
            a *= p
            b *= 1 - p
        place = segment if nu > 0 else SEGMENTS - 1 - segment
        # Colours that contradict each other entirely say nothing.
        on_object[place] = a / (a + b) if a + b > 0 else 0.5
    return (start + half - u) / nu


@njit(cache=True, nogil=True, error_model="numpy")
def slide_step(on_object, likelihood):
    """Writes the posterior of each shift, relative to the likeliest; returns its mean and variance, segments."""
    total = mean = square = most = 0.0
    for d in range(SHIFTS):
        p = 1.0
        for r in range(STEP):
            p *= 1 - OBJECT_STEP[r] + (2 * OBJECT_STEP[r] - 1) * on_object[d + r]
        likelihood[d] = p
        most = max(most, p)
        total += p
        mean += p * (d - MIDDLE)
        square += p * (d - MIDDLE) ** 2
    mean /= total
    for d in range(SHIFTS):
        likelihood[d] /= most
    return mean, max(square / total - mean * mean, LEAST_VARIANCE)


@njit(cache=True, nogil=True, error_model="numpy")
def linearize_lines(lines, start, matrix, pose, local, gain, energy, gradient, hessian):
    """See RegionFactor: writes energies (e,), gradients (e, 6) and Hessians (e, 6, 6) at poses (e, 4, 4)."""
    energy[:], gradient[:], hessian[:] = 0.0, 0.0, 0.0
    jacobian = np.empty(6)
    for e in range(len(pose)):
        k, t = matrix[e], pose[e]
        for i in range(start[e], start[e + 1]):
            line = lines[i]
            px, py, pz = line.point[0], line.point[1], line.point[2]
            x, y, z = transformed(t, px, py, pz)
            if z <= 0:
                energy[e] = math.inf
                continue
            u, v = projected(k, x, y, z)
            nu, nv = line.direction[0], line.direction[1]
            shift = nu * u + nv * v - line.origin

            place = min(max(shift + MIDDLE, 0.0), SHIFTS - 1.0)
            lower = min(int(place), SHIFTS - 2)
            low, high = math.log(line.likelihood[lower]), math.log(line.likelihood[lower + 1])
            energy[e] -= line.weight * (low + (place - lower) * (high - low))
            if not local:
                slope = (line.mean - shift) / line.variance
            elif 0 <= shift + MIDDLE < SHIFTS - 1:
                slope = gain / line.variance * (high - low)
            else:
                continue

            # Derivative of the shift by the point, in the camera's frame and then in the object's.
            a = (nu * k[0, 0] + nv * k[1, 0]) / z
            b = (nu * k[0, 1] + nv * k[1, 1]) / z
            c = -(a * x + b * y) / z
            jx = a * t[0, 0] + b * t[1, 0] + c * t[2, 0]
            jy = a * t[0, 1] + b * t[1, 1] + c * t[2, 1]
            jz = a * t[0, 2] + b * t[1, 2] + c * t[2, 2]
            jacobian[0], jacobian[1], jacobian[2] = py * jz - pz * jy, pz * jx - px * jz, px * jy - py * jx
            jacobian[3], jacobian[4], jacobian[5] = jx, jy, jz
            curvature = line.weight / line.variance
            for row in range(6):
                gradient[e, row] -= line.weight * slope * jacobian[row]
                for column in range(row + 1):
                    hessian[e, row, column] += curvature * jacobian[row] * jacobian[column]
        for row in range(6):
            for column in range(row):
                hessian[e, column, row] = hessian[e, row, column]
