import numpy as np
import pytest

from multicam.dataset.bop_reader import read_image
from multicam.geometry import se3
from multicam.visualization.page import true_world
from multicam.visualization.topview import TopView, floor_axes
from tests.toy_recording import truthful_run
from tests.toy_walk import LEFT
from tests.toy_world import looking_at


@pytest.mark.parametrize("elevation_deg", [20, 45, 70])
def test_the_floor_is_found_from_cameras_looking_down(elevation_deg):
    elevation = np.radians(elevation_deg)
    poses = [
        looking_at(
            np.array([np.cos(a) * np.cos(elevation), np.sin(a) * np.cos(elevation), np.sin(elevation)]), np.zeros(3)
        )
        for a in (-2.0, -1.5, -1.0)
    ]
    np.testing.assert_allclose(floor_axes(np.stack(poses)), [[1, 0, 0], [0, 1, 0]], atol=1e-12)


def test_another_upward_axis_is_found_too():
    y_up_from_z_up = se3.from_parts(np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]), np.zeros(3))
    poses = np.stack([y_up_from_z_up @ looking_at(np.array([0.5, -1, 1]), np.zeros(3))])
    first, second = floor_axes(poses)
    np.testing.assert_allclose(np.cross(first, second), [0, 1, 0], atol=1e-12)


def test_a_step_is_drawn_with_and_without_truth(toy_recording, tmp_path):
    run = truthful_run(toy_recording, placed_from=2)
    for truth in (None, true_world(run, toy_recording)):
        view = TopView(run, truth)
        path = tmp_path / "top.png"
        path.write_bytes(view.draw(run.steps[3]))
        image = read_image(path)
        assert image.std() > 5


def test_truth_is_shown_in_the_frame_of_the_tracking(toy_recording):
    truth = true_world(truthful_run(toy_recording), toy_recording)
    np.testing.assert_allclose(truth.statics[LEFT], toy_recording.truth_of(LEFT, 0), atol=1e-9)
    assert len(truth.headset) == 6
