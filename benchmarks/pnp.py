"""PnP on eight keypoints of which none to three are grossly wrong, and on ones at random: time, error, honesty.

    python benchmarks/pnp.py --count 300

Pixels have Gaussian noise of 1 px, wrong ones are 15 to 60 px off; the object is about 17 cm across, at 0.4 to 1 m, in
pictures of 640 x 480. The time is the processor's. NEES, the squared error by the stated covariance, is 6 in the mean
where that is honest.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import tyro

from multicam.geometry import se3, so3
from multicam.geometry.camera import Camera
from multicam.inference.pnp import PnpConfig, PnpSolution, solve_pnp
from multicam.types import FloatArray

CAMERA = Camera.from_focal(610.0, 640, 480)
BOX = np.array([[x, y, z] for x in (-0.05, 0.05) for y in (-0.04, 0.04) for z in (-0.06, 0.06)])
STD = np.ones((8, 2))
MOST_NEES = 100.0


@dataclass(frozen=True)
class Config:
    count: int = 300
    """Objects of each row."""


def problem(rng: np.random.Generator, wrong: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True camera_from_object (4, 4), keypoints of the object (8, 3) and where they are seen (8, 2)."""
    points = BOX + rng.uniform(-0.015, 0.015, BOX.shape)
    pose = se3.from_parts(so3.random(rng), rng.uniform([-0.15, -0.1, 0.4], [0.15, 0.1, 1.0]))
    pixels = CAMERA.project(se3.act(pose, points)) + rng.normal(size=(8, 2))
    chosen, angle = rng.choice(8, wrong, replace=False), rng.uniform(0, 2 * np.pi, wrong)
    off = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    pixels[chosen] += rng.uniform(15, 60, (wrong, 1)) * off
    return pose, points, pixels


def row(name: str, problems: list[tuple[FloatArray, FloatArray, FloatArray]]) -> str:
    """Time and errors of the answers to some problems."""
    solved: list[tuple[float, float]] = []
    began = time.process_time()
    answers = [solve_pnp(p, STD, np.ones(8), points, CAMERA, PnpConfig()) for _, points, p in problems]
    each = (time.process_time() - began) / len(problems)
    for (pose, _, _), answer in zip(problems, answers, strict=True):
        if isinstance(answer, PnpSolution):
            error = se3.minus(pose, answer.camera_from_object)
            nees = min(float(error @ np.linalg.solve(answer.covariance, error)), MOST_NEES)
            solved.append((float(np.linalg.norm(error[3:])), nees))
    text = f"{name:10} {1000 * each:5.2f} ms  solved {len(solved) / len(problems):6.1%}"
    if solved:
        shift, nees = np.array(solved).T
        text += f"  off by {1000 * np.median(shift):6.2f} mm (mean {1000 * shift.mean():6.2f})  NEES {nees.mean():5.1f}"
    return text


def main(config: Config) -> None:
    rng = np.random.default_rng(0)
    # The kernels are compiled at their first call.
    row("", [problem(rng, wrong) for wrong in (0, 3)])
    for wrong in range(4):
        print(row(f"{wrong} wrong", [problem(rng, wrong) for _ in range(config.count)]))
    scattered = [
        (pose, points, rng.uniform(0, 300, (8, 2)))
        for pose, points, _ in (problem(rng, 0) for _ in range(config.count))
    ]
    print(row("scattered", scattered))


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
